"""Planning of a node's PDOs: enabled PDOs, mappings and the necessary writes (CiA 301, 7.5.2.35 to 38).

A PDO is made invalid before it is changed, and valid at the end; bit 30 of the COB-ID belongs to the device. Settings
that bus.yml does not give are written as in the EDS, because a device may have stored other values. If bus.yml lists
PDOs, all others are disabled, even if they are valid in a file or in the device, because a second valid RPDO with a
controlword could also command the drive. If bus.yml lists no PDO, those of the file are used, and without PDOs in a
file those of the device. An entry of `sdo:` lists a PDO just as `rpdo` and `tpdo` do.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from canopen_control.cia301.pdo import (
    DUMMY_TYPES,
    INVALID_BIT,
    MAX_BITS,
    NO_RTR_BIT,
    MappedObject,
    mapping_entry,
    parse_mapping_entry,
)
from canopen_control.cia402 import objects
from canopen_control.cia402.objects import MOTION, axis_of
from canopen_control.frame import EXTENDED_BIT, is_restricted, rpdo_cob_id, tpdo_cob_id
from canopen_control.master.keys import PdoConfig, PdoObjectKeys
from canopen_control.master.plan_builder import STORED, PlannedPdo
from canopen_control.od.model import SIGNED_TYPES
from canopen_control.od.pdos import COMMUNICATION, COUNT, MAPPING, pdo_of

if TYPE_CHECKING:
    from canopen_control.master.plan_builder import PlanBuilder
    from canopen_control.od.model import DataType, Entry


_A: Final = {"rpdo": "an RPDO", "tpdo": "a TPDO"}
_PREDEFINED = {"rpdo": rpdo_cob_id, "tpdo": tpdo_cob_id}
_PREDEFINED_COUNT = 4
_LAST_SPARE = 0x6DF
_NOT_ALLOWED = "not allowed for PDOs (CiA 301, table 40)"
_SETTINGS = (2, 3, 5, 6)  # subindices: transmission type, inhibit time, event timer, SYNC start value
_SIGNED = frozenset(
    (
        *(MOTION - {objects.CONTROLWORD}),
        objects.MODES_OF_OPERATION_DISPLAY,
        objects.POSITION_ACTUAL,
        objects.POSITION_DEMAND,
        objects.VELOCITY_ACTUAL,
        objects.VELOCITY_DEMAND,
        objects.TORQUE_ACTUAL,
        objects.TORQUE_DEMAND,
        objects.VL_VELOCITY_ACTUAL,
        objects.FOLLOWING_ERROR_ACTUAL,
    )
)
_RELIED_ON = (2, 5)  # the master depends on these, and writes them even without a request
_EVENT_TIMER = _SETTINGS.index(5)


@dataclass(frozen=True, slots=True)
class _Requested:
    """Requested configuration of a PDO; `settings` are (subindex, value or None) of the communication record."""

    kind: str
    number: int
    key: str
    cob_id: int
    settings: tuple[tuple[int, int | None], ...]
    reason: str = ""

    @property
    def communication(self) -> int:
        return COMMUNICATION[self.kind] + self.number - 1

    @property
    def mapping(self) -> int:
        return MAPPING[self.kind] + self.number - 1


def is_pdo_record(index: int) -> bool:
    """Whether an index is the communication or mapping record of a PDO."""
    return pdo_of(index) is not None


def plan_pdos(builder: PlanBuilder, kind: str) -> None:
    """Plan the PDOs listed in bus.yml, in the order of the file; use or disable the others."""
    configured, listed = builder.node.boot.pdos(kind), builder.listed_pdos(kind)
    downloaded = _downloaded(builder, kind)
    for number, pdo in configured.items():
        _plan_pdo(builder, kind, number, pdo)
    for number in range(1, COUNT + 1):
        index = COMMUNICATION[kind] + number - 1
        if number in configured or (index, 1) not in builder.od:
            continue
        cob_id = builder.default(index, 1)
        live = cob_id is not None and not cob_id & INVALID_BIT
        used = number in (listed if configured or listed else downloaded or (number,))
        if live and used and _usable(cob_id or 0):
            if number in listed or number in downloaded:
                _adopt(builder, kind, number, cob_id or 0)
            elif wrong := _wrong_default(builder, kind, number, cob_id or 0):
                builder.warn(kind, f"{kind.upper()} {number} is disabled, because of {wrong}")
                _switch_off(builder, kind, number, cob_id, in_file=False)
            else:
                _plan_pdo(builder, kind, number, PdoConfig(), STORED)
        elif number not in listed and not (number in downloaded and not live and not configured and not listed):
            _switch_off(builder, kind, number, cob_id, in_file=number in downloaded)
    for number in listed & configured.keys():
        _compare_listed(builder, kind, number)


def _wrong_default(builder: PlanBuilder, kind: str, number: int, cob_id: int) -> str:
    """Return why a PDO enabled by the EDS cannot stay enabled, with the remedy, or "" if it can."""
    same = (
        f"{other.upper()} {layout.number}"
        for other, layouts in builder.layouts.items()
        for layout in layouts
        if layout.cob_id == cob_id & 0x7FF
    )
    if owner := next(same, ""):
        text = f"its COB-ID in {builder.file}, 0x{cob_id & 0x7FF:03X}, which {owner} also uses"
        return f"{text}; correct the file, or set {kind}.{number}.cob_id in bus.yml"
    mapping = _default_mapping(builder, kind, number)
    problems = (_unmappable(builder, kind, index, subindex) for index, subindex, _ in mapping)
    if wrong := next((text for text in problems if text), ""):
        return f"its mapping in {builder.file}: {wrong}; correct the file, or set {kind}.{number}.mapping in bus.yml"
    return ""


def _switch_off(builder: PlanBuilder, kind: str, number: int, cob_id: int | None, *, in_file: bool) -> None:
    """Plan to invalidate a PDO that is not listed or has no valid COB-ID, even if it is invalid in the EDS."""
    reason = STORED
    if cob_id is None or not (cob_id & INVALID_BIT or _usable(cob_id)):
        builder.remark(kind, f"{kind.upper()} {number} has no valid COB-ID in {builder.file}; it is disabled")
        reason = f"its COB-ID in {builder.file} is not allowed for PDOs" if cob_id else "it has no COB-ID by default"
    elif not cob_id & INVALID_BIT:
        reason = "valid by default, but not configured"
        if in_file:
            reason = f"valid {builder.download_reason}, but bus.yml lists other PDOs"
            builder.remark(
                kind,
                f"{kind.upper()} {number} is valid {builder.download_reason}, but not in bus.yml; it is disabled",
            )
    index = COMMUNICATION[kind] + number - 1
    off = (cob_id or 0) & ~EXTENDED_BIT | INVALID_BIT
    builder.write(index, 1, off, kind, reason, optional=True, pdo=(kind, number))


def _usable(cob_id: int) -> bool:
    """Whether a COB-ID is valid for a PDO (CiA 301, table 40)."""
    return not cob_id & EXTENDED_BIT and not is_restricted(cob_id & 0x7FF)


def _downloaded(builder: PlanBuilder, kind: str) -> set[int]:
    pdos = (pdo_of(index) for index, _, _ in builder.downloads)
    return {pdo[1] for pdo in pdos if pdo is not None and pdo[0] == kind}


def _compare_listed(builder: PlanBuilder, kind: str, number: int) -> None:
    """Report entries of `sdo:` that contradict the same PDO under `rpdo` or `tpdo`."""
    for address, (place, data) in builder.listed_records(kind, number).items():
        final, listed = builder.final(*address), int.from_bytes(data, "little")
        same = final is not None and (final ^ listed) & (~NO_RTR_BIT if address[1] == 1 else -1) == 0
        if not same and not (address[0] >= MAPPING[kind] and not address[1] and not listed):
            where = f"0x{address[0]:04X}:{address[1]:02X}"
            text = f"{where} = 0x{listed:X} differs from {kind}.{number} (0x{final or 0:X}); keep one of the two"
            builder.complain(f"sdo[{place}]", text)


def plan_downloaded_pdos(builder: PlanBuilder) -> None:
    """Plan the PDO records of a file and of `sdo:`, in an order that devices accept.

    Records of a file are used if bus.yml lists no PDO of the same kind, records of `sdo:` if `rpdo` or `tpdo` does not
    list the PDO.
    """
    records: dict[tuple[str, int], dict[tuple[int, int], bytes]] = {}
    for index, subindex, data in builder.downloads:
        pdo = pdo_of(index)
        if pdo is not None and not builder.node.boot.pdos(pdo[0]) and not builder.listed_pdos(pdo[0]):
            records.setdefault(pdo, {})[index, subindex] = data  # the last of several writes counts
    for (kind, number), values in records.items():
        _plan_record(builder, kind, number, values, builder.download_reason)
    for kind in COMMUNICATION:
        for number in sorted(builder.listed_pdos(kind) - builder.node.boot.pdos(kind).keys()):
            listed = builder.listed_records(kind, number)
            cob_id = builder.default(COMMUNICATION[kind] + number - 1, 1) or 0
            if not cob_id & INVALID_BIT and not _usable(cob_id):
                place = next(iter(listed.values()))[0]
                builder.complain(
                    f"sdo[{place}]", f"{kind.upper()} {number} would have COB-ID 0x{cob_id:X}, which is {_NOT_ALLOWED}"
                )
            _plan_record(builder, kind, number, {address: data for address, (_, data) in listed.items()}, "")


def _plan_record(
    builder: PlanBuilder, kind: str, number: int, values: dict[tuple[int, int], bytes], reason: str
) -> None:
    """Plan the records of a PDO in the right order: invalid, settings, mapping, then valid if enabled."""
    communication, mapping, pdo = COMMUNICATION[kind] + number - 1, MAPPING[kind] + number - 1, (kind, number)
    cob_id = builder.default(communication, 1) or 0

    def put(index: int, subindex: int, data: bytes) -> None:
        builder.write_raw(index, subindex, data, reason, pdo=pdo)

    # CiA 301, 7.5.2.36 and 7.5.2.38: invalid, number of objects 0, entries, number of objects, valid
    put(communication, 1, (cob_id | INVALID_BIT).to_bytes(4, "little"))
    for (index, subindex), data in values.items():
        if index == communication and subindex > 1:
            put(index, subindex, data)
    slots = {subindex: data for (index, subindex), data in values.items() if index == mapping and subindex}
    if slots or (mapping, 0) in values:
        count = builder.default(mapping, 0) or 0
        put(mapping, 0, b"\0")
        for slot in sorted(slots):
            if slot <= count:
                put(mapping, slot, slots[slot])
        put(mapping, 0, bytes((count & 0xFF,)))
    if not cob_id & INVALID_BIT and _usable(cob_id):
        put(communication, 1, cob_id.to_bytes(4, "little"))


def _adopt(builder: PlanBuilder, kind: str, number: int, cob_id: int) -> None:
    """Use a PDO as configured in the device, in a file or by `sdo:`, without further writes."""
    objects = _mapped(builder, kind, number, None)
    if objects:
        communication = COMMUNICATION[kind] + number - 1
        transmission, timer = builder.default(communication, 2), builder.default(communication, 5) or 0
        builder.layouts[kind].append(PlannedPdo(number, cob_id & 0x7FF, _or_255(transmission), objects, timer))


def _plan_pdo(builder: PlanBuilder, kind: str, number: int, pdo: PdoConfig, reason: str = "") -> None:
    """Plan a PDO; `reason` is why a PDO that bus.yml does not list is written, else ""."""
    key, index = f"{kind}.{number}", COMMUNICATION[kind] + number - 1
    if 1 <= number <= COUNT and (index, 1) not in builder.od and not pdo.is_on:
        return  # a PDO that the device does not have is off
    if not 1 <= number <= COUNT or (index, 1) not in builder.od:
        count = sum((COMMUNICATION[kind] + index, 1) in builder.od for index in range(COUNT))
        builder.complain(key, f"{builder.file} has no {kind.upper()} {number} (0x{index:04X}); it has {count}")
        return
    off = not pdo.is_on and (builder.default(index, 1) or 0) & INVALID_BIT
    settings = _settings(builder, kind, number, pdo)
    planned = _Requested(kind, number, key, _cob_id(builder, kind, number, pdo), settings, reason)
    # CiA 301, 7.5.2.35 and 7.5.2.37: bit 31 of subindex 1 makes the PDO invalid before it is changed
    if not builder.is_fixed_cob_id(index, 1, planned.cob_id) or not pdo.is_on:
        _check_fixed(builder, planned, pdo)
        _write(builder, planned, 1, planned.cob_id | INVALID_BIT, STORED if off else reason)
    if not pdo.is_on:
        return
    objects = _mapped(builder, kind, number, pdo)
    if not objects and pdo.mapping is None:
        text = f"{kind.upper()} {number} has no mapping in bus.yml and none in {builder.file}; it is disabled"
        (builder.remark if reason else builder.warn)(key, text)
        return
    _plan_live(builder, planned, objects, stored_mapping=pdo.mapping is None)
    if not reason:
        _check_fixed_mapping(builder, planned, objects)
    transmission = pdo.transmission if pdo.transmission is not None else builder.default(index, 2)
    timer = planned.settings[_EVENT_TIMER][1]
    timer = builder.default(index, 5) or 0 if timer is None else timer
    builder.layouts[kind].append(PlannedPdo(number, planned.cob_id & 0x7FF, _or_255(transmission), objects, timer))


def _check_fixed(builder: PlanBuilder, planned: _Requested, pdo: PdoConfig) -> None:
    """Warn about a COB-ID that is read-only in the EDS and whose EDS value differs from the planned value.

    The write is planned anyway, because some EDS declare writable COB-IDs `ro` or `const`.
    """
    entry, default = builder.od.get(planned.communication, 1), builder.default(planned.communication, 1)
    if entry is None or entry.writable or default is None or (default & INVALID_BIT and not pdo.is_on):
        return
    name = f"{planned.kind.upper()} {planned.number}"
    problem = f"0x{planned.communication:04X}:01 is {entry.access} in {builder.file}, so the COB-ID of {name} "
    if not pdo.is_on:
        builder.remark(planned.key, f"{problem}may be impossible to make invalid; its mapping is then cleared")
    elif default & INVALID_BIT:
        builder.warn(planned.key, f"{problem}may be impossible to make valid; use another {planned.kind.upper()}")
    else:
        text = f"{problem}may remain 0x{default & 0x7FF:03X}, but 0x{planned.cob_id & 0x7FF:03X} is requested"
        builder.warn(f"{planned.key}.cob_id", f"{text}; set `cob_id: 0x{default & 0x7FF:03X}`")


def _check_fixed_mapping(builder: PlanBuilder, planned: _Requested, objects: tuple[MappedObject, ...]) -> None:
    """Warn about a mapping or transmission type that is read-only in the EDS and has a different value there."""
    mapping = {0: len(objects), **{slot: mapping_entry(entry) for slot, entry in enumerate(objects, 1)}}
    differs = any(builder.default(planned.mapping, subindex) != value for subindex, value in mapping.items())
    for subindex, value in mapping.items():
        entry, held = builder.od.get(planned.mapping, subindex), builder.default(planned.mapping, subindex)
        fixed = entry is not None and not entry.writable and held is not None
        if entry is not None and fixed and (held != value or (differs and not subindex)):
            default = _default_mapping(builder, planned.kind, planned.number)
            current = ", ".join(f"0x{index:04X}:{sub:02X}" for index, sub, _ in default) or "empty"
            text = f"0x{planned.mapping:04X}:{subindex:02X} is {entry.access} in {builder.file}"
            builder.warn(
                f"{planned.key}.mapping", f"{text}: the drive may keep its own mapping ({current}); use that mapping"
            )
            break
    (_, transmission), *_ = planned.settings
    entry, held = builder.od.get(planned.communication, 2), builder.default(planned.communication, 2)
    if entry is not None and not entry.writable and None not in (transmission, held) and transmission != held:
        text = f"0x{planned.communication:04X}:02 is {entry.access} in {builder.file}: the drive may keep type"
        builder.warn(f"{planned.key}.transmission", f"{text} {held}; use that type")


def _plan_live(
    builder: PlanBuilder, planned: _Requested, objects: tuple[MappedObject, ...], *, stored_mapping: bool
) -> None:
    for subindex, value in planned.settings:
        default = builder.default(planned.communication, subindex)
        if value is not None:
            _write(builder, planned, subindex, value, STORED if value == default else planned.reason)
        elif subindex in _RELIED_ON and default is not None and (planned.communication, subindex) in builder.od:
            _write(builder, planned, subindex, default, STORED, optional=True)
    pdo, mapping = (planned.kind, planned.number), planned.mapping
    # CiA 301, 7.5.2.36 and 7.5.2.38: number of objects 0, entries, number of objects
    if (mapping, 0) in builder.od:
        reason = STORED if stored_mapping else planned.reason
        builder.write(mapping, 0, 0, planned.key, reason, pdo=pdo)
        slots = _slots(builder, mapping) or len(objects)
        for slot, mapped in enumerate(objects[:slots], 1):  # more objects than that were reported
            builder.write(mapping, slot, mapping_entry(mapped), f"{planned.key}.mapping[{slot - 1}]", reason, pdo=pdo)
        builder.write(mapping, 0, len(objects), planned.key, reason, pdo=pdo)
    elif not stored_mapping:
        builder.complain(f"{planned.key}.mapping", f"0x{mapping:04X} is not in {builder.file}")
    _write(builder, planned, 1, planned.cob_id, planned.reason)


def _write(
    builder: PlanBuilder, planned: _Requested, subindex: int, value: int, reason: str = "", *, optional: bool = False
) -> None:
    pdo = planned.kind, planned.number
    builder.write(planned.communication, subindex, value, planned.key, reason, optional=optional, pdo=pdo)


def _settings(builder: PlanBuilder, kind: str, number: int, pdo: PdoConfig) -> tuple[tuple[int, int | None], ...]:
    """Return the settings of a PDO in bus.yml as (subindex, value or None).

    The event timer of an RPDO is its deadline. A setting whose object is missing is ignored if it has no effect: a time
    of 0, or in an RPDO a setting for TPDOs only (CiA 301, 7.5.2.35: inhibit time and SYNC start value do not apply to
    RPDOs), which ros2_canopen's generator also ignores.
    """
    timer = pdo.event_timer if pdo.event_timer is not None else pdo.event_deadline
    values = dict(zip(_SETTINGS, (pdo.transmission, pdo.inhibit_time, timer, pdo.sync_start), strict=True))
    of_tpdos = {3: ("inhibit_time", pdo.inhibit_time), 5: ("event_timer", pdo.event_timer)}
    of_tpdos[6] = ("sync_start", pdo.sync_start)
    for subindex, value in values.items():
        if value is None or (COMMUNICATION[kind] + number - 1, subindex) in builder.od:
            continue
        key, listed = of_tpdos.get(subindex, ("", None))
        place = f"0x{COMMUNICATION[kind] + number - 1:04X}:{subindex:02X}"
        if kind == "tpdo" and key and value:
            # HBM MP85 and others have the subindices 1 and 2 alone (canopen-python, issues 37, 327 and 616)
            name = key if listed is not None else "event_deadline"
            text = f"{builder.file} has no such setting of this TPDO ({place}); remove {name}"
            builder.complain(f"{kind}.{number}.{name}", text)
            values[subindex] = None
        elif kind == "rpdo" and listed is not None:
            builder.note(
                f"{kind}.{number}.{key}", f"the setting is for TPDOs, and {builder.file} has no such object here"
            )
            values[subindex] = None
        elif key and not value:
            values[subindex] = None
    return tuple(values.items())


def _cob_id(builder: PlanBuilder, kind: str, number: int, pdo: PdoConfig) -> int:
    """Return the COB-ID of a PDO, without bit 31: from bus.yml, else from the EDS, else predefined or spare.

    Bit 30 is as in the EDS.
    """
    default, key = builder.default(COMMUNICATION[kind] + number - 1, 1) or 0, f"{kind}.{number}"
    if isinstance(pdo.cob_id, int):
        # CiA 301, 7.3.5: restricted identifiers
        if pdo.cob_id & EXTENDED_BIT or is_restricted(pdo.cob_id & 0x7FF):
            builder.complain(f"{key}.cob_id", f"COB-ID 0x{pdo.cob_id:X} is {_NOT_ALLOWED}")
        return (pdo.cob_id & ~INVALID_BIT) | default & NO_RTR_BIT
    if pdo.cob_id is None and _usable(default):
        return default & ~INVALID_BIT
    # CiA 301, 7.3.3: the predefined connection set has COB-IDs for four PDOs in each direction
    if number > _PREDEFINED_COUNT:
        return _spare(builder, key, pdo) | default & NO_RTR_BIT
    predefined = _PREDEFINED[kind](number, builder.node.node_id)
    if pdo.cob_id is None and pdo.is_on:
        builder.warn(
            key,
            f"no cob_id in bus.yml, and no valid one in {builder.file}; the predefined 0x{predefined:03X} is used",
        )
    return predefined | default & NO_RTR_BIT


def _spare(builder: PlanBuilder, key: str, pdo: PdoConfig) -> int:
    """Return the next COB-ID for a PDO above 4 with `cob_id: auto`, as ros2_canopen's generator does.

    Return 0 if the PDO is off or has no `cob_id`.
    """
    if not pdo.is_on:
        return 0
    if pdo.cob_id is None:
        builder.complain(key, "only PDO 1 to 4 have a predefined COB-ID; set cob_id to a number, or to auto")
        return 0
    if (spare := next(builder.spare_cob_ids)) > _LAST_SPARE:
        builder.complain(key, "no COB-ID is available for auto; set cob_id to a number")
    return spare


def _mapped(builder: PlanBuilder, kind: str, number: int, pdo: PdoConfig | None) -> tuple[MappedObject, ...]:
    """Return the mapped objects of a PDO, from bus.yml or as in the device, with the data types of the EDS."""
    key = f"{kind}.{number}.mapping"
    mapping = _default_mapping(builder, kind, number)
    if pdo is not None and pdo.mapping is not None:
        mapping = [(entry.index, entry.sub_index, 0) for entry in pdo.mapping]
        for slot, entry in enumerate(pdo.mapping):
            _check_bits(builder, f"{key}[{slot}].bits", entry)
    addresses = [_map_one(builder, kind, f"{key}[{slot}]", *fields) for slot, fields in enumerate(mapping)]
    objects = tuple(mapped for mapped in addresses if mapped is not None)
    # the data of a classic CAN frame
    if (bits := sum(mapped.bits for mapped in objects)) > MAX_BITS:
        builder.complain(key, f"the mapping has {bits} bits, a PDO at most {MAX_BITS}")
    slots = _slots(builder, MAPPING[kind] + number - 1)
    if pdo is not None and pdo.mapping is not None and 0 < slots < len(objects):
        builder.complain(
            key, f"the mapping has {len(objects)} objects, {kind.upper()} {number} of {builder.file} at most {slots}"
        )
    return objects


def _slots(builder: PlanBuilder, mapping: int) -> int:
    return sum((mapping, slot) in builder.od for slot in range(1, 65))


def _check_bits(builder: PlanBuilder, key: str, mapped: PdoObjectKeys) -> None:
    """Warn if `bits` in bus.yml differs from the length of the object; ros2_canopen's dcfgen ignores `bits`."""
    entry = builder.od.get(mapped.index, mapped.sub_index)
    if entry is None or mapped.bits in (None, entry.data_type.bits):
        return
    text = f"0x{mapped.index:04X}:{mapped.sub_index:02X} has {entry.data_type.bits} bits in {builder.file}"
    builder.warn(key, f"{text}, which replace the {mapped.bits} here; correct or remove `bits`")


def _map_one(builder: PlanBuilder, kind: str, key: str, index: int, subindex: int, part: int) -> MappedObject | None:
    """Return a mapped object, or None after an error; `part` is the number of bits in a default mapping, 0 for all."""
    if wrong := _unmappable(builder, kind, index, subindex):
        builder.complain(key, wrong)
    if index in DUMMY_TYPES and not subindex:  # a dummy entry of an RPDO
        return MappedObject(index, 0, DUMMY_TYPES[index].bits or 0, DUMMY_TYPES[index])
    entry = builder.od.get(index, subindex)
    bits = None if entry is None else entry.data_type.bits
    if entry is None or bits is None:
        return None
    return MappedObject(index, subindex, part or bits, _signed(index, entry.data_type))


def _unmappable(builder: PlanBuilder, kind: str, index: int, subindex: int) -> str:
    """Return why an object cannot be mapped, or "" if it can; dummy entries need an RPDO and [DummyUsage]."""
    # CiA 306, [DummyUsage]: the dummy entries that a device accepts, in RPDOs only
    if index in DUMMY_TYPES and not subindex:
        allowed = kind == "rpdo" and index in builder.od.dummy_usage
        return "" if allowed else f"{builder.file} does not allow the dummy entry 0x{index:04X} in {_A[kind]}"
    place, entry = f"0x{index:04X}:{subindex:02X}", builder.od.get(index, subindex)
    if entry is None:
        return f"{place} is not in {builder.file}"
    if not _mappable(entry, kind):
        # a public file for a CiA 401 module has the inputs under `rpdo`, seen from the master
        other, does = ("tpdo", "sends") if kind == "rpdo" else ("rpdo", "receives")
        remark = f", but into {_A[other]}, which the device {does}" if _mappable(entry, other) else ""
        return f"{place} {entry.name} cannot be mapped into {_A[kind]}{remark}"
    return "" if entry.data_type.bits is not None else f"{place} {entry.name} has no fixed length"


def _signed(index: int, data_type: DataType) -> DataType:
    """Return the data type of an object, signed if CiA 402 defines it as signed and the EDS does not."""
    return SIGNED_TYPES.get(data_type, data_type) if axis_of(index)[0] in _SIGNED else data_type


def _mappable(entry: Entry, kind: str) -> bool:
    return entry.rpdo_mappable if kind == "rpdo" else entry.tpdo_mappable


def _default_mapping(builder: PlanBuilder, kind: str, number: int) -> list[tuple[int, int, int]]:
    mapping = MAPPING[kind] + number - 1
    count = builder.default(mapping, 0) or 0
    entries = [builder.default(mapping, slot) or 0 for slot in range(1, min(count, 64) + 1)]
    return [parse_mapping_entry(value) for value in entries if value]


def _or_255(transmission: int | None) -> int:
    return 255 if transmission is None else transmission
