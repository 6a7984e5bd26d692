"""Checks an object dictionary for contradictions in itself and with the standards; finds issues.

Nothing is changed. PDO defaults: CiA 301, 7.5.2.35 to 7.5.2.38; number of subindices: 7.4.4 and CiA 306-1, 4.6.3.3;
mandatory objects: CiA 301, 7.5.1; COB-IDs: CiA 301, table 42; types of the drive profile: CiA 402-2 and -3 (the file's
types are used all the same: a device knows best what it sends).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.frame import EXTENDED_BIT, is_restricted
from canopen_control.od.eds_sections import clip
from canopen_control.od.eds_values import parse_number
from canopen_control.od.limits import forbidden_limit
from canopen_control.od.model import DataType, DeviceInfo, ObjectCode
from canopen_control.od.pdos import INVALID, MAX_BITS, is_cob_id, pdos_of
from canopen_control.od.profile402 import AXIS_STEP, DEVICE_PROFILE, TYPES

if TYPE_CHECKING:
    from canopen_control.od.issues import Report
    from canopen_control.od.model import Entry, ObjectDictionary, ObjectInfo
    from canopen_control.od.pdos import Mapped, Pdo

__all__ = ["check_dictionary"]

_MANDATORY = {0x1000: "device type", 0x1001: "error register", 0x1018: "identity"}
_SYNC, _EMCY = 0x1005, 0x1014
_LISTS = (ObjectCode.ARRAY, ObjectCode.RECORD, ObjectCode.DEFSTRUCT)
_PROFILE_START = 0x6000
_CODES_OF = {
    ObjectCode.ARRAY: (
        *(range(index, index + 1) for index in (0x1003, 0x1010, 0x1011, 0x1016, 0x1029)),
        *(range(index, index + 1) for index in (0x6046, 0x604C, 0x607B, 0x607D, 0x6099, 0x60E3, 0x60FE)),
        range(0x608F, 0x6098),
    ),
    ObjectCode.RECORD: (
        range(0x1018, 0x1019),
        range(0x1200, 0x1300),
        *(range(first, first + 0x200) for first in (0x1400, 0x1600, 0x1800, 0x1A00)),
        *(range(index, index + 1) for index in (0x6048, 0x6049, 0x604A, 0x60C2, 0x60C4)),
    ),
}
"""What the standards say of objects with subindices."""
_STRUCTURE_SUB = 0xFF  # holds the type of the object and is not counted


def check_dictionary(od: ObjectDictionary, report: Report) -> None:
    """Report everything that does not fit; `report` is of the file that `od` comes from."""
    subindices: dict[int, list[int]] = {index: [] for index in od.objects}
    for entry in od:
        subindices.setdefault(entry.index, []).append(entry.subindex)
        if entry.low is not None or entry.high is not None:
            _check_limits(entry, report)
        if is_cob_id(*entry.address) or entry.index in (_SYNC, _EMCY):
            _check_cob_id(entry, od.node_id or 1, report)
    for index, info in od.objects.items():
        _check_structure(od, info, subindices[index], report)
    for index, meaning in _MANDATORY.items():
        if index not in od.objects:
            report.warning(0, "object-mandatory", f"0x{index:04X} ({meaning}) is mandatory and not there")
    _check_pdos(od, report)
    _check_profile(od, report)


def _where(entry: Entry) -> str:
    return f"0x{entry.index:04X}:{entry.subindex:02X}"


def _check_limits(entry: Entry, report: Report) -> None:
    if wrong := forbidden_limit(entry):
        report.note(entry.line, "limit-forbidden", f"{_where(entry)} ({clip(entry.name)}): {wrong}")
        return
    for name, value in (("default", entry.default), ("parameter value", entry.parameter_value)):
        if not isinstance(value, int | float):
            continue
        if entry.low is not None and value < entry.low:
            text = f"{_where(entry)}: {name} {value} is below the LowLimit {entry.low}"
            report.warning(entry.line, "value-limit", text)
        if entry.high is not None and value > entry.high:
            text = f"{_where(entry)}: {name} {value} is above the HighLimit {entry.high}"
            report.warning(entry.line, "value-limit", text)


def _check_cob_id(entry: Entry, node_id: int, report: Report) -> None:
    """Look for a COB-ID that the file does not tell, or that no PDO, SYNC or EMCY may have; `node_id` for $NODEID."""
    value = entry.value
    if not isinstance(value, int):
        if is_cob_id(*entry.address) and "defaultvalue" not in {key.lower() for key in entry.texts}:
            text = f"{_where(entry)} ({clip(entry.name)}) has no DefaultValue: its COB-ID is not known, the PDO is off"
            report.warning(entry.line, "cob-id", f"{text} until one is written")
        return
    relative = entry.relative if entry.parameter_value is None else entry.parameter_relative
    identifier = value + (0 if not relative or value & 0x7F else node_id)
    off = EXTENDED_BIT if entry.index == _SYNC else EXTENDED_BIT | INVALID
    if not identifier & off and is_restricted(identifier & 0x7FF):
        text = f"{_where(entry)} ({clip(entry.name)}) is 0x{value:X}, which is no COB-ID that it may have"
        report.warning(entry.line, "cob-id", f"{text} (CiA 301, table 42); it can never become active")


def _check_structure(od: ObjectDictionary, info: ObjectInfo, subindices: list[int], report: Report) -> None:
    if info.code not in _LISTS:
        return
    where = f"0x{info.index:04X} ({clip(info.name)})"
    if not subindices:
        report.warning(info.line, "sub-missing", f"{where} is {info.code.name} and has no subindices")
        return
    if 0 not in subindices:
        report.warning(info.line, "sub0-missing", f"{where} has no subindex 0, which tells the highest one")
    else:
        _check_sub0(od[info.index, 0], max((sub for sub in subindices if sub != _STRUCTURE_SUB), default=0), report)
    _check_sub_number(info, len(subindices), where, report)
    _check_code(od, info, subindices, report)


def _check_code(od: ObjectDictionary, info: ObjectInfo, subindices: list[int], report: Report) -> None:
    """Look for an array that is a record and the other way round (CiA 301, 7.4.3, 7.5.2; CiA 402-2)."""
    where = f"0x{info.index:04X} ({clip(info.name)})"
    types = {od[info.index, sub].data_type for sub in subindices if sub not in (0, _STRUCTURE_SUB)}
    base = info.index
    if base >= _PROFILE_START:
        base = _PROFILE_START + (base - _PROFILE_START) % AXIS_STEP
    wanted = next((code for code, indices in _CODES_OF.items() if any(base in each for each in indices)), None)
    if info.code is ObjectCode.ARRAY and len(types) > 1:
        named = ", ".join(sorted(each.name for each in types))
        report.warning(info.line, "object-code", f"{where} is an ARRAY with entries of {named}; it is a RECORD")
    elif wanted is not None and info.code in (ObjectCode.ARRAY, ObjectCode.RECORD) and info.code is not wanted:
        report.note(info.line, "object-code", f"{where} is {info.code.name}; the standard has {wanted.name} there")


def _check_sub0(entry: Entry, highest: int, report: Report) -> None:
    if entry.data_type is not DataType.UNSIGNED8:
        text = f"{_where(entry)} is {entry.data_type.name}; the number of entries is UNSIGNED8"
        report.warning(entry.line, "sub0-type", text)
    if entry.writable or entry.index in range(0x1600, 0x1800) or entry.index in range(0x1A00, 0x1C00):
        return  # there it counts what is in use
    if isinstance(entry.value, int) and entry.value != highest:
        text = f"{_where(entry)} says {entry.value}, the highest subindex described is {highest}"
        report.warning(entry.line, "sub0-count", text)


def _check_sub_number(info: ObjectInfo, count: int, where: str, report: Report) -> None:
    texts = {key.lower(): value for key, value in info.texts.items()}
    text = texts.get("subnumber", "")
    if not text or "compactsubobj" in texts:
        return
    try:
        said = parse_number(text)[0]
    except ValueError:
        report.warning(info.line, "sub-number", f"{where}: SubNumber={clip(text)} is no number; ignored")
        return
    if said != count:
        report.warning(info.line, "sub-number", f"{where}: SubNumber says {said}, {count} subindices are described")


def _check_pdos(od: ObjectDictionary, report: Report) -> None:
    pdos = pdos_of(od)
    for pdo in pdos:
        _check_pdo(od, pdo, report)
        for mapped in pdo.mapped:
            _check_mapped(od, pdo, mapped, report)
    for name, said, is_rpdo in (("Rx", od.device.rpdo_count, True), ("Tx", od.device.tpdo_count, False)):
        present = sum(pdo.is_rpdo is is_rpdo for pdo in pdos)
        if present and present != said and od.device != DeviceInfo() and not od.device.compact_pdo:
            report.note(0, "pdo-number", f"NrOf{name}PDO says {said}, {present} are described")


def _check_pdo(od: ObjectDictionary, pdo: Pdo, report: Report) -> None:
    line = od.objects[pdo.mapping].line if pdo.mapping in od.objects else od.objects[pdo.communication].line
    for index, what in ((pdo.communication, "communication"), (pdo.mapping, "mapping")):
        if index not in od.objects:
            report.warning(line, "pdo-record", f"{pdo.name} has no {what} record 0x{index:04X}")
    if pdo.bits > MAX_BITS:
        report.error(line, "pdo-bits", f"{pdo.name} maps {pdo.bits} bits; a frame holds {MAX_BITS}")
    if pdo.count is None or pdo.count > MAX_BITS:
        return
    if pdo.count > pdo.slots:
        report.error(
            line, "pdo-count", f"{pdo.name} says {pdo.count} mapped objects and has {pdo.slots} mapping entries"
        )
    elif pdo.count != len(pdo.mapped):
        text = f"{pdo.name} says {pdo.count} mapped objects, {len(pdo.mapped)} of its entries have a default"
        report.warning(line, "pdo-count", text)


def _check_mapped(od: ObjectDictionary, pdo: Pdo, mapped: Mapped, report: Report) -> None:
    target = f"{pdo.name} maps 0x{mapped.index:04X}:{mapped.subindex:02X}"
    line = mapped.source.line
    if mapped.is_dummy:
        _check_dummy(od, pdo, mapped, report)
        return
    entry = mapped.entry
    if entry is None:
        report.error(line, "pdo-target", f"{target}, which is not in the dictionary")
        return
    if not entry.pdo_mappable:
        report.warning(line, "pdo-mappable", f"{target} ({clip(entry.name)}), whose PDOMapping is 0")
    elif not (entry.rpdo_mappable if pdo.is_rpdo else entry.tpdo_mappable):
        report.error(line, "pdo-direction", f"{target} ({clip(entry.name)}), whose access is {entry.access}")
    bits = entry.data_type.bits
    if bits is not None and mapped.bits not in (bits, 8 if entry.data_type is DataType.BOOLEAN else bits):
        text = f"{target} ({clip(entry.name)}) with {mapped.bits} bits, but {entry.data_type.name} has {bits}"
        report.error(line, "pdo-length", text)


def _check_dummy(od: ObjectDictionary, pdo: Pdo, mapped: Mapped, report: Report) -> None:
    what = f"{pdo.name} maps the dummy 0x{mapped.index:04X}"
    if not pdo.is_rpdo:
        report.error(mapped.source.line, "pdo-direction", f"{what}; only an RPDO may have gaps")
    elif mapped.index not in od.dummy_usage:
        report.error(mapped.source.line, "pdo-target", f"{what}, which [DummyUsage] does not allow")
    if mapped.bits != DataType(mapped.index).bits:
        report.error(mapped.source.line, "pdo-length", f"{what} with {mapped.bits} bits")


def _check_profile(od: ObjectDictionary, report: Report) -> None:
    device_type = od.get(0x1000)
    value = device_type.value if device_type is not None else None
    if not isinstance(value, int) or value & 0xFFFF != DEVICE_PROFILE:
        return
    for entry in od:
        if entry.index < _PROFILE_START:
            continue
        address = _PROFILE_START + (entry.index - _PROFILE_START) % AXIS_STEP, entry.subindex
        wanted = TYPES.get(address)
        if wanted is not None and entry.data_type not in wanted:
            names = " or ".join(data_type.name for data_type in wanted)
            text = f"{_where(entry)} ({clip(entry.name)}) is {entry.data_type.name}, {names} in CiA 402; kept"
            report.warning(entry.line, "profile-type", text)
