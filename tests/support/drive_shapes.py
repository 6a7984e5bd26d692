"""Drives as vendors' EDS files describe them: dictionaries that lack, fix or change what one or another maker does."""

from __future__ import annotations

import dataclasses

from support.virtualbench import pdo_entries, servo_od

from canopen_control.od.dcf import eds_text
from canopen_control.od.model import DataType, Entry, ObjectCode, ObjectInfo

NODE = 5
PDOS = (0x1400, 0x1401, 0x1600, 0x1601, 0x1800, 0x1801, 0x1A00, 0x1A01)
WORD, MODE, POSITION, SPEED = 0x60400010, 0x60600008, 0x607A0020, 0x60FF0020
STATUS, SHOWN, PLACE, ACTUAL = 0x60410010, 0x60610008, 0x60640020, 0x606C0020
FOUR_PAIRS = [
    *((True, number, 0x200 + 0x100 * number, mapping) for number, mapping in enumerate(
        ([WORD], [WORD, MODE], [WORD, POSITION], [WORD, SPEED]))),
    *((False, number, 0x180 + 0x100 * number, mapping) for number, mapping in enumerate(
        ([STATUS], [STATUS, SHOWN], [STATUS, PLACE], [STATUS, ACTUAL]))),
]  # fmt: skip


def shape(drop=(), pdos=None, device=None, extra=(), axes=1, access="rw", cob_access="rw", **changes):
    """Return a servo's dictionary without `drop`, with other `pdos` and `extra` entries, and `sIIII_SS={field: value}`.

    `access` is that of the mapping entries, `cob_access` that of COB-IDs.
    """
    od = servo_od(NODE, axes)
    od.device = dataclasses.replace(od.device, vendor_name="Vendor", **(device or {}))
    _drop(od, drop if pdos is None else (*drop, *PDOS))
    for is_rpdo, number, cob_id, mapping in pdos or ():
        for entry in pdo_entries(number, is_rpdo, mapping, cob_id + NODE, 255 if is_rpdo else 1):
            od.add(entry)
    for entry in extra:
        od.add(entry)
    for address, entry in list(od.entries.items()):
        if _maps(address[0]):
            od.entries[address] = dataclasses.replace(entry, access=access)
        elif (0x1400 <= address[0] < 0x1600 or 0x1800 <= address[0] < 0x1A00) and address[1] == 1:
            od.entries[address] = dataclasses.replace(entry, access=cob_access)
    for name, fields in changes.items():
        address = int(name[1:5], 16), int(name[6:8], 16)
        od.entries[address] = dataclasses.replace(od.entries[address], **fields)
    return od


def _drop(od, drop):
    for address in [entry for entry in od.entries if entry in drop or entry[0] in drop]:
        del od.entries[address]
    for index in [entry for entry in od.objects if not od.subindices(entry)]:
        del od.objects[index]


def _maps(index):
    return 0x1600 <= index < 0x1800 or 0x1A00 <= index < 0x1C00


def slots_of(od, count):
    """Leave `count` entries in each mapping."""
    for index, sub in list(od.entries):
        if _maps(index) and sub > count:
            del od.entries[index, sub]
        elif _maps(index) and sub == 0:
            entry = od.entries[index, 0]
            od.entries[index, 0] = dataclasses.replace(entry, default=min(entry.default, count))
    return od


def record(index, name, *subs):
    """Return the entries of a record of UNSIGNED32 with these defaults."""
    types = [DataType.UNSIGNED8, *[DataType.UNSIGNED32] * len(subs)]
    return [
        Entry(index, sub, name, data_type, "rw", default=default)
        for sub, (data_type, default) in enumerate(zip(types, (len(subs), *subs), strict=True))
    ]


def guarded(**how):
    """Return a drive with node guarding in place of heartbeats."""
    return shape(drop=(0x1016, 0x1017), **how)


def modes(bits):
    return {"s6502_00": {"default": bits}}


UNMAPPABLE = {"pdo_mappable": False}
TWO_MORE = [(True, 2, 0x400, []), (True, 3, 0x500, []), (False, 2, 0x380, []), (False, 3, 0x480, [])]
TWO_PAIRS = [
    (True, 0, 0x200, [WORD, MODE]),
    (True, 1, 0x300, [POSITION, SPEED]),
    (False, 0, 0x180, [STATUS, SHOWN]),
    (False, 1, 0x280, [PLACE, ACTUAL]),
]

#: habit of a manufacturer: the dictionary, and the interface and mode that are chosen
SHAPES = {
    "every mode": (lambda: shape(), "velocity", "PV"),
    "profile modes alone": (lambda: shape(**modes(0x25)), "velocity", "PV"),
    "cyclic modes alone": (lambda: shape(**modes(0x3E0)), "velocity", "CSV"),
    "no cyclic velocity": (lambda: shape(**modes(0xA5)), "velocity", "PV"),
    "positions alone": (lambda: shape(drop=(0x60FF,), **modes(0x81)), "position", "CSP"),
    "profile position alone": (lambda: shape(drop=(0x60FF,), **modes(0x21)), "position", "PP"),
    "interpolated position alone": (lambda: shape(drop=(0x60FF, 0x607A), **modes(0x60)), "position", "IP"),
    "a frequency converter": (lambda: shape(drop=(0x60FF, 0x607A), **modes(0x02)), "velocity", "VL"),
    "modes not told": (lambda: shape(drop=(0x6502,)), "velocity", "PV"),
    "modes told as 0": (lambda: shape(**modes(0)), "velocity", "PV"),
    "mappings fixed, each with a controlword": (lambda: shape(pdos=FOUR_PAIRS, access="const"), "velocity", "PV"),
    "mappings fixed, in pairs": (lambda: shape(pdos=TWO_PAIRS, access="ro"), "velocity", "PV"),
    "granularity 0": (lambda: shape(device={"granularity": 0}), "velocity", "PV"),
    "identifiers fixed as well": (
        lambda: shape(pdos=TWO_PAIRS, access="const", cob_access="const"), "velocity", "PV"),
    "three slots": (lambda: slots_of(shape(), 3), "velocity", "PV"),
    "no feedback": (lambda: shape(drop=(0x606C,), s6064_00=UNMAPPABLE), "velocity", "PV"),
    "one slot and four PDOs": (lambda: slots_of(shape(pdos=[*TWO_PAIRS, *TWO_MORE]), 1), "velocity", "PV"),
    "mode of operation not mappable": (lambda: shape(s6060_00=UNMAPPABLE), "velocity", "PV"),
    "mode display not mappable": (lambda: shape(s6061_00=UNMAPPABLE), "velocity", "PV"),
    "no actual velocity": (lambda: shape(drop=(0x606C,)), "velocity", "PV"),
    "target velocity not mappable": (lambda: shape(s60FF_00=UNMAPPABLE, **modes(0xA5)), "position", "CSP"),
    "modes unsigned": (
        lambda: shape(s6060_00={"data_type": DataType.UNSIGNED8}, s6061_00={"data_type": DataType.UNSIGNED8}),
        "velocity", "PV"),
    "target velocity unsigned": (lambda: shape(s60FF_00={"data_type": DataType.UNSIGNED32}), "velocity", "PV"),
    "statusword signed": (lambda: shape(s6041_00={"data_type": DataType.INTEGER16}), "velocity", "PV"),
    "node guarding, no heartbeat": (guarded, "velocity", "PV"),
    "TPDOs that SYNC does not trigger": (
        lambda: shape(s1800_02={"low": 254, "high": 255}, s1801_02={"low": 254, "high": 255}), "velocity", "PV"),
    "encoder and gear told": (
        lambda: shape(extra=[*record(0x608F, "Resolution", 10000, 1), *record(0x6091, "Gear", 1, 1)]),
        "velocity", "PV"),
    "velocities in rpm": (
        lambda: shape(extra=[Entry(0x60A9, 0, "SI unit velocity", DataType.UNSIGNED32, "ro", default=0x00B44700)]),
        "velocity", "PV"),
    "encoder not told": (lambda: shape(drop=(0x608F,)), "velocity", "PV"),
    "two axes": (lambda: shape(axes=2), "velocity", "PV"),
    "bit rates up to 250 kbit/s": (
        lambda: shape(device={"bit_rates": frozenset((125_000, 250_000))}), "velocity", "PV"),
}  # fmt: skip


def as_maker(od, slots=None, timers=True, counts=True):
    """Change PDOs: `slots` by mapping, no event `timers`, no `counts` of what is mapped."""
    for index, sub in list(od.entries):
        communication = 0x1400 <= index < 0x1600 or 0x1800 <= index < 0x1A00
        if (communication and sub > 3 and not timers) or (slots and sub > slots.get(index, sub)):
            del od.entries[index, sub]
        elif _maps(index) and sub == 0 and not counts:
            od.entries[index, 0] = dataclasses.replace(od.entries[index, 0], default=None)
    return od


def more_slots(od, count):
    """Let each mapping have `count` entries."""
    for index in [number for number, sub in od.entries if _maps(number) and not sub]:
        od.entries[index, 0] = dataclasses.replace(od.entries[index, 0], low=0, high=count)
        for sub in range(9, count + 1):
            od.add(dataclasses.replace(od.entries[index, 8], subindex=sub))
    return od


def commissioned(od, values):
    """Give entries values beside their defaults, as a DCF does."""
    for address, value in values.items():
        od.entries[address] = dataclasses.replace(od.entries[address], parameter_value=value)
    return od


OFF, NO_RTR = 0x80000000, 0x40000000
PAIRS_OFF = [
    (rpdo, number, cob_id | (OFF if number > 1 else 0), mapping) for rpdo, number, cob_id, mapping in FOUR_PAIRS
]
FIRST_ON = [
    (rpdo, number, cob_id | NO_RTR | (OFF if number else 0), mapping) for rpdo, number, cob_id, mapping in FOUR_PAIRS
]
FEW = {0x1600: 1, 0x1601: 2, 0x1602: 2, 0x1603: 2, 0x1A00: 1, 0x1A01: 2, 0x1A02: 2, 0x1A03: 2}
POINTS = [
    (True, 0, 0x200, [WORD, 0x60C10120]), (True, 1, 0x300, []), (False, 0, 0x180, [STATUS, 0x60770010, PLACE]),
    (False, 1, 0x280 | OFF, [0x606B0020, ACTUAL]), (False, 2, 0x380, []), (False, 3, 0x480, []),
]  # fmt: skip
TEXTS = [
    (True, 0, 0x200, [WORD]), (True, 1, 0x300, [0x20120020]), (True, 2, 0x400, []), (True, 3, 0x500, []),
    (False, 0, 0x180, [STATUS]), (False, 1, 0x280, [0x20130040]), (False, 2, 0x380, []), (False, 3, 0x480, []),
]  # fmt: skip
OWN_TARGET = [
    (True, 0, 0x200, [WORD]), (True, 1, 0x300, [WORD, POSITION]), (True, 2, 0x400, [WORD, SPEED]),
    (True, 3, 0x500, [WORD, 0x257A0020]), (False, 0, 0x180, [STATUS]), (False, 1, 0x280, [STATUS, PLACE]),
    (False, 2, 0x380, [STATUS, ACTUAL]), (False, 3, 0x480, [PLACE, ACTUAL]),
]  # fmt: skip
RAMPS = [
    (True, 0, 0x200, [WORD, SPEED, MODE]), (True, 1, 0x300, [POSITION, 0x60810020]),
    (True, 2, 0x400, [0x60830020, 0x60840020]), (True, 3, 0x500 | OFF, []), (False, 0, 0x180, [STATUS, PLACE]),
    (False, 1, 0x280, [ACTUAL]), (False, 2, 0x380 | OFF, []), (False, 3, 0x480 | OFF, []),
]  # fmt: skip

#: how the files of one manufacturer describe PDOs, modes and supervision: dictionary, interface and mode
MAKERS = {
    "maxon EPOS4": (lambda: more_slots(as_maker(shape(pdos=FIRST_ON), timers=False), 12), "velocity", "PV"),
    "Technosoft iPOS": (lambda: shape(pdos=PAIRS_OFF, **modes(0x6D)), "velocity", "PV"),
    "Technosoft IDM": (
        lambda: as_maker(guarded(pdos=FOUR_PAIRS, s6060_00={"access": "wo"}), slots=FEW), "velocity", "PV"),
    "Schunk PRL": (
        lambda: shape(drop=(0x60FF, 0x6502, 0x6042), pdos=POINTS, s607A_00=UNMAPPABLE, s6060_00=UNMAPPABLE,
                      s6061_00=UNMAPPABLE),
        "position", "IP"),
    "Pilz PRBT": (
        lambda: commissioned(
            shape(drop=(0x60FF,), pdos=POINTS, s6098_00={"access": "const"}, **modes(0x43)),
            {(0x1A00, 0): 2, (0x1A00, 2): 0x60610008, (0x1A02, 0): 2, (0x1A02, 1): PLACE, (0x1A02, 2): ACTUAL,
             (0x6060, 0): 7, (0x60C2, 1): 10}),
        "velocity", "VL"),
    "Elmo SimplIQ": (lambda: as_maker(shape(pdos=TEXTS), counts=False), "velocity", "PV"),
    "Faulhaber": (
        lambda: as_maker(
            slots_of(shape(pdos=OWN_TARGET, s6060_00={"low": -9, "high": 6}, s1016_01={"low": 0, "high": 0x7FFFFF},
                           **modes(0x25)), 4),
            timers=False),
        "velocity", "PV"),
    "Yiyou": (lambda: as_maker(shape(pdos=RAMPS), timers=False), "velocity", "PV"),
}  # fmt: skip

#: drives that do not stop when the master is lost
UNWATCHED = {"neither heartbeat nor guarding": lambda: shape(drop=(0x1016, 0x1017, 0x100C, 0x100D))}


def write_shape(folder, od, name="drive.eds"):
    """Write a dictionary as an EDS file; returns its path."""
    for index in {index for index, _ in od.entries} - set(od.objects):
        od.objects[index] = ObjectInfo(index, f"Object {index:04X}", ObjectCode.RECORD)
    path = folder / name
    path.write_text(eds_text(od), encoding="utf-8")
    return path
