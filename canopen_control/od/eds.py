"""Reader of EDS and DCF files (CiA 306-1) and their XML forms (CiA 311), tolerant of the errors in real files.

`EdsError` is raised only if the file is not a CANopen EDS. Any other error becomes an `Issue` with its line, and no
value is lost or replaced silently. The text of each key is kept with its entry, so that a writer can reproduce it. The
run time is proportional to the number of lines and entries.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from itertools import takewhile
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

from canopen_control.data_files import BINARY, foreign_format, read_limited
from canopen_control.errors import EdsError
from canopen_control.frame import EXTENDED_BIT, is_restricted
from canopen_control.od.codec import forbidden_limit
from canopen_control.od.dcf import decode_concise
from canopen_control.od.eds_sections import (
    COMMISSIONING,
    EntryReader,
    Pair,
    RangeType,
    Section,
    Sections,
    check_lists,
    clip,
    decode_text,
    optional_number,
    read_device,
    read_number,
    split_sections,
    what_else,
)
from canopen_control.od.eds_values import parse_number
from canopen_control.od.indices import COB_ID_EMCY, COB_ID_SYNC
from canopen_control.od.issues import Issue, Report
from canopen_control.od.model import (
    AXIS_STEP,
    DEVICE_PROFILE,
    PROFILE_START,
    SCALAR_CODES,
    DataType,
    DeviceInfo,
    Entry,
    ObjectCode,
    ObjectDictionary,
    ObjectInfo,
    profile_type,
)
from canopen_control.od.pdos import COUNT, INVALID, MAPPING, MAX_BITS, is_cob_id, pdos_of
from canopen_control.od.xdd import is_xml, xdd_sections

if TYPE_CHECKING:
    from collections.abc import Iterator

    from canopen_control.od.pdos import Mapped, Pdo


# Checks of the dictionary for inconsistencies and deviations from the standards; nothing is changed. PDO defaults: CiA
# 301, 7.5.2.35 to 7.5.2.38; number of subindices: 7.4.4 and CiA 306-1, 4.6.3.3; mandatory objects: CiA 301, 7.5.1;
# COB-IDs: CiA 301, table 40; types of the drive profile: CiA 402-2 and -3 (the types of the file remain in use, because
# the device uses them).


_MANDATORY = {0x1000: "device type", 0x1001: "error register", 0x1018: "identity"}
_LISTS = (ObjectCode.ARRAY, ObjectCode.RECORD, ObjectCode.DEFSTRUCT)
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
"""Object codes that CiA 301 and CiA 402-2 specify for objects with subindices."""
_STRUCTURE_SUB = 0xFF  # describes the type of the object and is not counted (CiA 301, 7.4.4)


def check_dictionary(od: ObjectDictionary, report: Report) -> None:
    """Add an issue to `report` for every inconsistency in a dictionary."""
    subindices: dict[int, list[int]] = {index: [] for index in od.objects}
    for entry in od:
        subindices.setdefault(entry.index, []).append(entry.subindex)
        if entry.low is not None or entry.high is not None:
            _check_limits(entry, 0 if od.node_id else 1, report)
        if is_cob_id(*entry.address) or entry.index in (COB_ID_SYNC, COB_ID_EMCY):
            _check_cob_id(entry, od.node_id or 1, report)
    for index, info in od.objects.items():
        _check_structure(od, info, subindices[index], report)
    for index, meaning in _MANDATORY.items():
        if index not in od.objects:
            report.warning(0, "object-mandatory", f"0x{index:04X} ({meaning}) is mandatory, but missing")
    _check_pdos(od, report)
    _check_profile(od, report)


def _where(entry: Entry) -> str:
    return f"0x{entry.index:04X}:{entry.subindex:02X}"


def _check_limits(entry: Entry, node_id: int, report: Report) -> None:
    """Report values outside the limits, and limits that contradict CiA 301.

    `node_id` is added to relative values that were read without a node-ID.
    """
    low, high = (
        None if limit is None else limit + node_id * relative
        for limit, relative in ((entry.low, entry.low_relative), (entry.high, entry.high_relative))
    )
    if wrong := forbidden_limit(entry):
        report.note(entry.line, "limit-forbidden", f"{_where(entry)} ({clip(entry.name)}): {wrong}")
        return
    for name, number, relative in (
        ("default", entry.default, entry.relative),
        ("parameter value", entry.parameter_value, entry.parameter_relative),
    ):
        if not isinstance(number, int | float):
            continue
        value = number + node_id * relative  # Roboteq: $NODEID+0x200 with LowLimit=0x201
        if low is not None and value < low:
            report.warning(entry.line, "value-limit", f"{_where(entry)}: {name} {value} is below the LowLimit {low}")
        if high is not None and value > high:
            report.warning(entry.line, "value-limit", f"{_where(entry)}: {name} {value} is above the HighLimit {high}")


def _check_cob_id(entry: Entry, node_id: int, report: Report) -> None:
    """Report a restricted COB-ID of a PDO, SYNC or EMCY, and a PDO without COB-ID; `node_id` replaces $NODEID."""
    value = entry.value
    if not isinstance(value, int):
        if is_cob_id(*entry.address) and "defaultvalue" not in {key.lower() for key in entry.texts}:
            text = f"{_where(entry)} ({clip(entry.name)}) has no DefaultValue; the PDO is disabled"
            report.warning(entry.line, "cob-id", f"{text} until a COB-ID is written")
        return
    relative = entry.relative if entry.parameter_value is None else entry.parameter_relative
    identifier = value + (0 if not relative or value & 0x7F else node_id)
    # CiA 301, 7.3.5: restricted identifiers
    off = EXTENDED_BIT if entry.index == COB_ID_SYNC else EXTENDED_BIT | INVALID
    if not identifier & off and is_restricted(identifier & 0x7FF):
        text = f"{_where(entry)} ({clip(entry.name)}) is 0x{value:X}, a restricted CAN-ID"
        report.warning(entry.line, "cob-id", f"{text} (CiA 301, table 40); the object can never be active")


def _check_structure(od: ObjectDictionary, info: ObjectInfo, subindices: list[int], report: Report) -> None:
    if info.code not in _LISTS:
        return
    place = f"0x{info.index:04X} ({clip(info.name)})"
    if not subindices:
        report.warning(info.line, "sub-missing", f"{place} is {info.code.name}, but has no subindices")
        return
    # CiA 301, 7.4.4: subindex 0 of arrays and records is the highest subindex
    if 0 not in subindices:
        report.warning(info.line, "sub0-missing", f"{place} has no subindex 0 (highest subindex)")
    else:
        _check_sub0(od[info.index, 0], max((sub for sub in subindices if sub != _STRUCTURE_SUB), default=0), report)
    _check_sub_number(info, len(subindices), place, report)
    _check_code(od, info, subindices, report)


def _check_code(od: ObjectDictionary, info: ObjectInfo, subindices: list[int], report: Report) -> None:
    """Report an array that should be a record, or vice versa (CiA 301, 7.4.3, 7.5.2; CiA 402-2)."""
    place = f"0x{info.index:04X} ({clip(info.name)})"
    types = {od[info.index, sub].data_type for sub in subindices if sub not in (0, _STRUCTURE_SUB)}
    base = info.index
    if base >= PROFILE_START:
        base = PROFILE_START + (base - PROFILE_START) % AXIS_STEP
    expected = next((code for code, indices in _CODES_OF.items() if any(base in index for index in indices)), None)
    if info.code is ObjectCode.ARRAY and len(types) > 1:
        named = ", ".join(sorted(type_.name for type_ in types))
        report.warning(
            info.line, "object-code", f"{place} is an ARRAY with different data types ({named}); it should be a RECORD"
        )
    elif expected is not None and info.code in (ObjectCode.ARRAY, ObjectCode.RECORD) and info.code is not expected:
        report.note(info.line, "object-code", f"{place} is {info.code.name}; the standard specifies {expected.name}")


def _check_sub0(entry: Entry, highest: int, report: Report) -> None:
    if entry.data_type is not DataType.UNSIGNED8:
        text = f"{_where(entry)} is {entry.data_type.name}; subindex 0 should be UNSIGNED8"
        report.warning(entry.line, "sub0-type", text)
    if entry.writable or entry.index in range(0x1600, 0x1800) or entry.index in range(0x1A00, 0x1C00):
        return  # in these records subindex 0 is the number of entries in use
    if isinstance(entry.value, int) and entry.value != highest:
        text = f"{_where(entry)} is {entry.value}, but the highest subindex in the file is {highest}"
        report.warning(entry.line, "sub0-count", text)


def _check_sub_number(info: ObjectInfo, count: int, place: str, report: Report) -> None:
    texts = {key.lower(): value for key, value in info.texts.items()}
    text = texts.get("subnumber", "")
    if not text or "compactsubobj" in texts:
        return
    try:
        declared = parse_number(text)[0]
    except ValueError:
        report.warning(info.line, "sub-number", f"{place}: SubNumber={clip(text)} is not a number; ignored")
        return
    # CiA 306-1, 4.6.3.3
    if declared != count:
        report.warning(
            info.line, "sub-number", f"{place}: SubNumber is {declared}, but the file has {count} subindices"
        )


def _check_pdos(od: ObjectDictionary, report: Report) -> None:
    pdos = pdos_of(od)
    for pdo in pdos:
        _check_pdo(od, pdo, report)
        for mapped in pdo.mapped:
            _check_mapped(od, pdo, mapped, report)
    for name, declared, is_rpdo in (("RX", od.device.rpdo_count, True), ("TX", od.device.tpdo_count, False)):
        present = sum(pdo.is_rpdo is is_rpdo for pdo in pdos)
        if present and present != declared and od.device != DeviceInfo() and not od.device.compact_pdo:
            report.note(0, "pdo-number", f"NrOf{name}PDO is {declared}, but the file has {present}")


def _check_pdo(od: ObjectDictionary, pdo: Pdo, report: Report) -> None:
    line = od.objects[pdo.mapping].line if pdo.mapping in od.objects else od.objects[pdo.communication].line
    for index, record_name in ((pdo.communication, "communication"), (pdo.mapping, "mapping")):
        if index not in od.objects:
            report.warning(line, "pdo-record", f"{pdo.name} has no {record_name} record 0x{index:04X}")
    # CiA 301, 7.2.2: a PDO has at most 8 bytes
    if pdo.bits > MAX_BITS:
        report.error(line, "pdo-bits", f"{pdo.name} maps {pdo.bits} bits; a PDO has at most {MAX_BITS}")
    if pdo.count is None or pdo.count > MAX_BITS:
        return
    if pdo.count > pdo.slots:
        report.error(
            line,
            "pdo-count",
            f"{pdo.name} has {pdo.count} mapped objects in subindex 0, but only {pdo.slots} mapping entries",
        )
    elif pdo.count != len(pdo.mapped):
        text = f"{pdo.name} has {pdo.count} mapped objects in subindex 0, but only {len(pdo.mapped)} have a default"
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
    # CiA 306-1, 4.6.3: PDOMapping
    if not entry.pdo_mappable:
        report.warning(line, "pdo-mappable", f"{target} ({clip(entry.name)}), whose PDOMapping is 0")
    elif not (entry.rpdo_mappable if pdo.is_rpdo else entry.tpdo_mappable):
        report.error(line, "pdo-direction", f"{target} ({clip(entry.name)}), whose AccessType is {entry.access}")
    bits = entry.data_type.bits
    if bits is not None and mapped.bits not in (bits, 8 if entry.data_type is DataType.BOOLEAN else bits):
        text = f"{target} ({clip(entry.name)}) with {mapped.bits} bits, but {entry.data_type.name} has {bits}"
        report.error(line, "pdo-length", text)


def _check_dummy(od: ObjectDictionary, pdo: Pdo, mapped: Mapped, report: Report) -> None:
    subject = f"{pdo.name} maps the dummy object 0x{mapped.index:04X}"
    # CiA 301, 7.4.1.2: dummy entries
    if not pdo.is_rpdo:
        report.error(mapped.source.line, "pdo-direction", f"{subject}; only RPDOs can have gaps")
    elif mapped.index not in od.dummy_usage:
        report.error(mapped.source.line, "pdo-target", f"{subject}, which [DummyUsage] does not allow")
    if mapped.bits != DataType(mapped.index).bits:
        report.error(mapped.source.line, "pdo-length", f"{subject} with {mapped.bits} bits")


def _check_profile(od: ObjectDictionary, report: Report) -> None:
    device_type = od.get(0x1000)
    value = device_type.value if device_type is not None else None
    if not isinstance(value, int) or value & 0xFFFF != DEVICE_PROFILE:
        return
    for entry in od:
        expected = profile_type(*entry.address)
        if expected and entry.data_type not in expected:
            names = " or ".join(data_type.name for data_type in expected)
            text = (
                f"{_where(entry)} ({clip(entry.name)}) is {entry.data_type.name}, but {names} in CiA 402; not changed"
            )
            report.warning(entry.line, "profile-type", text)


# PDO records that an EDS omits with CompactPDO (CiA 306-1, 4.5). Bit k of CompactPDO means that every PDO has subindex
# k + 1 of the communication parameter; NrOfRXPDO and NrOfTXPDO are the numbers of PDOs. Records in the file are not
# changed.


_HIGHEST = 512  # maximum number of PDOs per direction
_SLOTS = 64
_PREDEFINED = 4  # number of PDOs in the predefined connection set
_COMMUNICATION = (  # subindices 1 to 6: name, type, default (that of the COB-ID depends on the PDO)
    ("COB-ID", DataType.UNSIGNED32, 0),
    ("Transmission type", DataType.UNSIGNED8, 255),
    ("Inhibit time", DataType.UNSIGNED16, 0),
    ("Reserved", DataType.UNSIGNED8, 0),
    ("Event timer", DataType.UNSIGNED16, 0),
    ("SYNC start value", DataType.UNSIGNED8, 0),
)


class _Direction(NamedTuple):
    name: str
    communication: int
    mapping: int
    cob_id: int  # COB-ID of the first PDO, without the node-ID


_RPDO = _Direction("RPDO", 0x1400, 0x1600, 0x200)
_TPDO = _Direction("TPDO", 0x1800, 0x1A00, 0x180)


def expand_compact_pdos(od: ObjectDictionary, report: Report) -> None:
    """Add the PDO records that CompactPDO implies, unless the file has sections for them."""
    mask = od.device.compact_pdo & 0x3F
    if not mask:
        return
    before = len(od.objects)
    for direction, count in ((_RPDO, od.device.rpdo_count), (_TPDO, od.device.tpdo_count)):
        if not 0 <= count <= _HIGHEST:
            report.warning(
                0, "compact-count", f"{count} {direction.name}s are not possible; at most {_HIGHEST} are created"
            )
        for offset in range(min(max(count, 0), _HIGHEST)):
            _add_communication(od, direction, offset, mask)
            _add_mapping(od, direction, offset)
    added = len(od.objects) - before
    if added:
        report.note(0, "compact-pdo", f"CompactPDO: {added} PDO records without a section were created")


def _add_communication(od: ObjectDictionary, direction: _Direction, offset: int, mask: int) -> None:
    index = direction.communication + offset
    if index in od.objects:
        return
    name = f"{direction.name}{offset + 1} communication parameter"
    od.objects[index] = ObjectInfo(index, name, ObjectCode.RECORD)
    _add_sub0(od, index, mask.bit_length(), "const")
    for subindex, (label, data_type, default) in enumerate(_COMMUNICATION, 1):
        if mask >> (subindex - 1) & 1:
            entry = Entry(index, subindex, label, data_type, "rw", default=default)
            od.entries[index, subindex] = entry if subindex > 1 else _cob_id(od, direction, offset, entry)


def _cob_id(od: ObjectDictionary, direction: _Direction, offset: int, model: Entry) -> Entry:
    predefined = offset < _PREDEFINED
    default = direction.cob_id + 0x100 * offset + (od.node_id or 0) if predefined else INVALID
    return replace(model, default=default, relative=predefined)


def _add_mapping(od: ObjectDictionary, direction: _Direction, offset: int) -> None:
    index = direction.mapping + offset
    if index in od.objects:
        return
    od.objects[index] = ObjectInfo(index, f"{direction.name}{offset + 1} mapping parameter", ObjectCode.RECORD)
    _add_sub0(od, index, 0, "rw")
    for subindex in range(1, _SLOTS + 1):
        name = f"Mapped object {subindex}"
        od.entries[index, subindex] = Entry(index, subindex, name, DataType.UNSIGNED32, "rw", default=0)


def _add_sub0(od: ObjectDictionary, index: int, count: int, access: str) -> None:
    od.entries[index, 0] = Entry(index, 0, "Highest sub-index supported", DataType.UNSIGNED8, access, default=count)


SUFFIXES = (".eds", ".dcf", ".xdd", ".xdc")
"""Suffixes of the files that `read_eds` reads."""
MAX_BYTES = 32_000_000
"""Maximum length of a file in bytes; the largest files in use have a few MB."""
_OBJECT = re.compile(r"([0-9a-f]{4})(?: ?sub ?([0-9a-f]{1,2}))?")
_SECTION = re.compile(r"^\s*\[[0-9A-Fa-f]{4}", re.MULTILINE)  # section of an object
_RANGE_SUB = re.compile(r"([0-9a-f]{2,4}) ?sub ?0?1")
_RANGES = range(0x40, 0x260)  # manufacturer-specific data types (CiA 301, 7.4.7)
_COMPACT = re.compile(r"([0-9a-f]{4})(name|value)")
_LOOKS_LIKE_OBJECT = re.compile(r"(?:0x)?[0-9][0-9a-f]{3}(?!denotation\Z|objectlinks\Z)")
_MODULE = re.compile(r"m[0-9]+moduleinfo")
_HIGHEST_SUB = 0xFE
_TYPES: dict[int | None, DataType] = {int(data_type): data_type for data_type in DataType}
_CODES: dict[int, ObjectCode] = {int(code): code for code in ObjectCode}
_REGENERATED = frozenset(("mandatoryobjects", "optionalobjects", "manufacturerobjects"))  # computed on writing


@dataclass(frozen=True, slots=True)
class EdsFile:
    """Object dictionary read from a file, with the issues found in it."""

    path: str
    od: ObjectDictionary
    issues: list[Issue]
    encoding: str = "utf-8-sig"


_State: TypeAlias = tuple[int, ...]  # identity, size and times of a file, which show a change
_cache: dict[str, tuple[_State, EdsFile]] | None = None


def keep_files() -> None:
    """Cache every parsed file until it changes, in this process and its forks."""
    global _cache
    _cache = {} if _cache is None else _cache


def forget_files() -> None:
    """Discard the cache of `keep_files`, and stop caching."""
    global _cache
    _cache = None


def read_eds(path: str | Path, node_id: int | None = None) -> EdsFile:
    """Read the file at `path`; `node_id` (1 to 127) replaces $NODEID and overrides the node-ID in the file.

    Raise EdsError if the file cannot be read or is not a CANopen EDS.
    """
    if _cache is None:
        return _read_file(path, node_id)
    try:
        status = Path(path).stat()
    except (OSError, ValueError):
        return _read_file(path, node_id)
    state = status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns, status.st_ctime_ns
    cached = _cache.get(str(path))
    if cached is None or cached[0] != state:
        cached = _cache[str(path)] = state, _read_file(path, None)
    file = cached[1]
    od = file.od
    if node_id is None:
        od = replace(od, entries=od.entries.copy(), objects=od.objects.copy(), sections=od.sections.copy())
    else:
        od = od.for_node(node_id)
    return replace(file, od=od, issues=[*file.issues])


def _read_file(path: str | Path, node_id: int | None) -> EdsFile:
    try:
        data = read_limited(Path(path), MAX_BYTES)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise EdsError(str(path), 0, f"cannot be read: {reason}") from None
    return parse_eds(data, node_id, name=str(path))


def parse_eds(data: bytes, node_id: int | None = None, *, name: str = "<eds>") -> EdsFile:
    """Parse the content of a file; `name` is the file name for messages. Raise EdsError as for `read_eds`."""
    report = Report(name)
    if _is_concise(data):
        text = "is a concise DCF (values to write), not an EDS; set it as configuration_file in bus.yml"
        raise EdsError(name, 0, text)
    text, encoding = decode_text(data)
    if (foreign := foreign_format(data)) and (foreign != BINARY or not _SECTION.search(text)):
        raise EdsError(name, 0, f"is {foreign}")
    sections = xdd_sections(text, report) if is_xml(text) else split_sections(text, report)
    if not any(_OBJECT.fullmatch(section) for section in sections):
        raise EdsError(name, 1, what_else(text) or _why_not(sections))
    od = read_device(sections, node_id, report)
    _Reader(od, sections, report).run()
    if not is_xml(text):
        check_lists(od, sections, report)
    expand_compact_pdos(od, report)
    check_dictionary(od, report)
    report.issues.sort(key=lambda issue: issue.line)
    return EdsFile(name, od, report.issues, encoding)


def _is_concise(data: bytes) -> bool:
    """Whether the bytes are a concise DCF, recognised by consistent sizes."""
    try:
        return bool(decode_concise(data))
    except ValueError:
        return False


def _why_not(sections: Sections) -> str:
    if "topology" in sections:
        return "is a CANopen project (.cpj, CiA 306-3), not an EDS; use the DCF files that are listed in it"
    if "device" in sections and "deviceinfo" not in sections:
        return "is an EtherNet/IP EDS (ODVA), not a CANopen EDS"
    first = next(iter(sections.values()))
    return (
        f"has no object sections such as [1000], so it is not a CANopen EDS; the first section is [{clip(first.title)}]"
    )


def _range_types(sections: Sections) -> Iterator[tuple[int, RangeType]]:
    """Yield the manufacturer-specific data types, such as section [A0], with their indices.

    Some editors define such a type by a basic type (sub 1), a minimum (sub 2) and a maximum (sub 3).
    """
    for name in sections:
        match = _RANGE_SUB.fullmatch(name)
        if match is None or (index := int(match[1], 16)) not in _RANGES:
            continue
        parts = [sections.get(f"{match[1]}sub{number}") for number in (1, 2, 3)]
        try:
            numbers = [None if section is None else parse_number(section.get("defaultvalue"))[0] for section in parts]
        except ValueError:
            continue
        if numbers[0] in _TYPES:
            yield index, RangeType(_TYPES[numbers[0]], numbers[1], numbers[2])


@dataclass(slots=True)
class _Reader:
    """Converter of the object sections of a file to objects and entries.

    Objects are read before their subindices, regardless of the order in the file.
    """

    od: ObjectDictionary
    sections: Sections
    report: Report
    has_subs: set[int] = field(default_factory=set)
    entry_reader: EntryReader = field(init=False)

    def __post_init__(self) -> None:
        device = self.sections.get("1000")
        number = 0 if device is None else read_number(device, "defaultvalue", 0, Report(self.report.path))
        self.entry_reader = EntryReader(self.od.node_id, self.report, number & 0xFFFF == DEVICE_PROFILE)

    def run(self) -> None:
        """Read all object sections, and store the texts of all other sections."""
        self.entry_reader.ranges.update(_range_types(self.sections))
        object_sections: list[tuple[int, int, Section]] = []  # subindex -1 denotes the object itself
        for name, section in self.sections.items():
            match = _OBJECT.fullmatch(name)
            if match is None:
                self._keep(section)
                continue
            subindex = -1 if match[2] is None else int(match[2], 16)
            object_sections.append((int(match[1], 16), subindex, section))
            if subindex > 0:
                self.has_subs.add(int(match[1], 16))
        object_sections.sort(key=lambda item: item[:2])
        for index, subindex, section in object_sections:
            if subindex < 0:
                self._object(section, index)
            else:
                self._sub(section, index, subindex)

    def _keep(self, section: Section) -> None:
        name = section.name
        if (match := _COMPACT.fullmatch(name)) is not None:
            parent = self.sections.get(match[1])
            if parent is None or not parent.get("compactsubobj"):
                self.report.warning(
                    section.line,
                    "compact-unused",
                    f"[{section.title}] is ignored, because [{match[1].upper()}] has no CompactSubObj",
                )
        elif _LOOKS_LIKE_OBJECT.match(name):
            self.report.warning(
                section.line, "section-unknown", f"[{clip(section.title)}] is not an object section; ignored"
            )
        elif _MODULE.fullmatch(name):
            text = f"[{section.title}]: objects of modules are kept as text and are not part of the dictionary"
            self.report.warning(section.line, "module", text)
        if name not in _REGENERATED:
            self.od.sections[section.title] = section.texts()

    def _object(self, section: Section, index: int) -> None:
        code = self._object_code(section, index)
        name = self._name(section, f"Object {index:04X}")
        self.od.objects[index] = ObjectInfo(index, name, code, section.line, section.texts())
        compact = self._compact_count(section)
        if compact:
            self._expand(section, index, compact)
        elif code in SCALAR_CODES:
            self.od.entries[index, 0] = self.entry_reader.read(section, index, 0, name, code)

    def _object_code(self, section: Section, index: int) -> ObjectCode:
        number = optional_number(section, "objecttype", self.report)
        is_list = index in self.has_subs or self._compact_count(section, quiet=True) > 0
        if number is None:
            if is_list:
                text = f"[{section.title}] has no ObjectType; treated as RECORD"
                self.report.warning(section.line, "object-type", text)
            return ObjectCode.RECORD if is_list else ObjectCode.VAR
        code = _CODES.get(number)
        if code is None:
            code = ObjectCode.RECORD if is_list else ObjectCode.VAR
            text = f"ObjectType {number:#x} is unknown; treated as {code.name}"
            self.report.warning(section.line_of("objecttype"), "object-type", text)
        elif is_list and code is ObjectCode.VAR and index not in self.has_subs:
            text = f"[{section.title}] is a VAR with CompactSubObj; treated as ARRAY"
            self.report.warning(section.line_of("objecttype"), "object-type", text)
            code = ObjectCode.ARRAY
        elif is_list and code is ObjectCode.VAR:
            text = f"[{section.title}] is a VAR with subindices; value and subindices are kept"
            self.report.warning(section.line, "object-type", text)
        return code

    def _compact_count(self, section: Section, *, quiet: bool = False) -> int:
        if "compactsubobj" not in section.values:
            return 0
        report = Report(self.report.path) if quiet else self.report
        count = read_number(section, "compactsubobj", 0, report)
        if not 0 <= count <= _HIGHEST_SUB:
            text = f"CompactSubObj={clip(section.get('compactsubobj'))} is not 0 to 254; limited to this range"
            report.error(section.line_of("compactsubobj"), "compact-count", text)
        return min(max(count, 0), _HIGHEST_SUB)

    def _name(self, section: Section, fallback: str) -> str:
        name = section.get("parametername")
        if not name:
            text = f"[{section.title}] has no ParameterName; named {fallback!r}"
            self.report.warning(section.line, "name-missing", text)
        return name or fallback

    def _sub(self, section: Section, index: int, subindex: int) -> None:
        if index not in self.od.objects:
            text = f"[{section.title}] has no object section [{index:04X}]; treated as part of a RECORD"
            self.report.warning(section.line, "object-missing", text)
            self.od.objects[index] = ObjectInfo(index, f"Object {index:04X}", ObjectCode.RECORD, section.line)
        if (index, subindex) in self.od.entries:
            text = f"[{section.title}] repeats the entry of [{index:04X}]; the section of the subindex is used"
            self.report.warning(section.line, "entry-repeated", text)
        name = self._name(section, f"Subindex {subindex}")
        code = read_number(section, "objecttype", ObjectCode.VAR, self.report)
        self.od.entries[index, subindex] = self.entry_reader.read(section, index, subindex, name, code)

    def _expand(self, section: Section, index: int, count: int) -> None:
        """Create the entries that CompactSubObj implies (CiA 306-1, 4.6.3.4).

        The section [xxxxValue] has the ParameterValues of the subindices in a DCF, and their defaults in an EDS.
        """
        label = self.od.objects[index].name
        names = self._compact_pairs(f"{index:04x}name", count)
        values = self._compact_pairs(f"{index:04x}value", count)
        values_section = self.sections.get(f"{index:04x}value")
        model = self.entry_reader.read(section, index, 1, label, ObjectCode.VAR)
        is_dcf = "parametervalue" in section.values or any(name in self.sections for name in COMMISSIONING)
        subs: list[Entry] = []
        for subindex in range(1, count + 1):
            name = (names[subindex].value if subindex in names else "") or f"{label}{subindex}"
            entry = self.entry_reader.like(model, subindex, name)
            if (pair := values.get(subindex)) is not None and values_section is not None:
                entry = self.entry_reader.with_value(entry, values_section, pair.key, is_dcf=is_dcf)
            subs.append(entry)
        for entry in (self._compact_sub0(model, subs, section.line), *subs):
            self.od.entries[entry.address] = entry

    @staticmethod
    def _compact_sub0(model: Entry, subs: list[Entry], line: int) -> Entry:
        """Return subindex 0 of an object with CompactSubObj: the number of subindices, which cannot be written.

        In a mapping record it is the number of mapped objects instead, and can be written as they can (CiA 301,
        7.5.2.36 and 7.5.2.38). dcfgen describes the mapping records of a file with CompactPDO in this way.
        """
        access, count = "ro", len(subs)
        if any(first <= model.index < first + COUNT for first in MAPPING.values()):
            access, count = model.access, sum(1 for _ in takewhile(lambda entry: entry.value, subs))
        name = "Highest sub-index supported"
        return Entry(model.index, 0, name, DataType.UNSIGNED8, access, default=count, line=line)

    def _compact_pairs(self, name: str, count: int) -> dict[int, Pair]:
        """Return the pairs of an [xxxxName] or [xxxxValue] section, by subindex."""
        section = self.sections.get(name)
        if section is None:
            return {}
        pairs: dict[int, Pair] = {}
        for pair in section.pairs():
            if pair.key.lower() == "nrofentries":
                continue
            subindex = int(pair.key) if pair.key.isascii() and pair.key.isdigit() and len(pair.key) < 5 else -1
            if 0 < subindex <= count and subindex not in pairs:
                pairs[subindex] = pair
            else:
                what = f"which is repeated or not a decimal number from 1 to {count}"
                text = f"[{section.title}] has the key {clip(pair.key)}, {what}; ignored"
                self.report.warning(pair.line, "compact-unused", text)
        return pairs
