"""Read an EDS or DCF file (CiA 306-1) into an object dictionary, forgiving what real files get wrong.

Only what is no CANopen EDS at all raises `EdsError`. Everything else loads, and every doubt becomes an `Issue` with
its line: no value is lost or replaced silently. The text of each key stays with its entry, so that a writer gives it
back as it was. The work is proportional to the lines and entries of the file.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from canopen_control.data_files import read_limited
from canopen_control.errors import EdsError
from canopen_control.od.checks import check_dictionary
from canopen_control.od.compact_pdo import expand_compact_pdos
from canopen_control.od.concise import decode_concise
from canopen_control.od.eds_device import check_lists, read_device
from canopen_control.od.eds_entry import EntryReader, RangeType
from canopen_control.od.eds_sections import (
    Pair,
    Section,
    Sections,
    clip,
    decode_text,
    optional_number,
    read_number,
    split_sections,
    what_else,
)
from canopen_control.od.eds_values import parse_number
from canopen_control.od.issues import Issue, Report, Severity
from canopen_control.od.model import SCALAR_CODES, DataType, Entry, ObjectCode, ObjectDictionary, ObjectInfo

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = ["EdsFile", "Issue", "Severity", "parse_eds", "read_eds"]

MAX_BYTES = 32_000_000
"""Of a file: the largest in use have a few MB."""
_OBJECT = re.compile(r"([0-9a-f]{4})(?: ?sub ?([0-9a-f]{1,2}))?")
_RANGE_SUB = re.compile(r"([0-9a-f]{2,4}) ?sub ?0?1")
_RANGES = range(0x40, 0x260)  # data types of a device's own (CiA 301, 7.4.7)
_COMPACT = re.compile(r"([0-9a-f]{4})(name|value)")
_LOOKS_LIKE_OBJECT = re.compile(r"[0-9][0-9a-f]{3}(?!denotation\Z)")
_MODULE = re.compile(r"m[0-9]+moduleinfo")
_HIGHEST_SUB = 0xFE
_TYPES: dict[int | None, DataType] = {int(data_type): data_type for data_type in DataType}
_CODES: dict[int, ObjectCode] = {int(code): code for code in ObjectCode}
_REGENERATED = frozenset(("mandatoryobjects", "optionalobjects", "manufacturerobjects"))  # by whoever writes the file


@dataclass(frozen=True, slots=True)
class EdsFile:
    """What a file holds, and what is odd about it."""

    path: str
    od: ObjectDictionary
    issues: list[Issue]
    encoding: str = "utf-8-sig"


def read_eds(path: str | Path, node_id: int | None = None) -> EdsFile:
    """Read the file at `path`; `node_id` (1 to 127) stands for $NODEID and goes before the file's own.

    Raises EdsError where the file cannot be read or is no CANopen EDS.
    """
    try:
        data = read_limited(Path(path), MAX_BYTES)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise EdsError(str(path), 0, f"cannot be read: {reason}") from None
    return parse_eds(data, node_id, name=str(path))


def parse_eds(data: bytes, node_id: int | None = None, *, name: str = "<eds>") -> EdsFile:
    """Parse the bytes of a file; `name` is what issues and errors call it."""
    report = Report(name)
    if _is_concise(data):
        text = "is a concise DCF: what is written to a device, and no EDS; give it as configuration_file in bus.yml"
        raise EdsError(name, 0, text)
    text, encoding = decode_text(data)
    sections = split_sections(text, report)
    if not any(_OBJECT.fullmatch(section) for section in sections):
        raise EdsError(name, 1, what_else(text) or _why_not(sections))
    od = read_device(sections, node_id, report)
    _Reader(od, sections, report).run()
    check_lists(od, sections, report)
    expand_compact_pdos(od, report)
    check_dictionary(od, report)
    report.issues.sort(key=lambda issue: issue.line)
    return EdsFile(name, od, report.issues, encoding)


def _is_concise(data: bytes) -> bool:
    """Whether the bytes are those of a concise DCF, which an EDS never is by chance: each size in it is right."""
    try:
        return bool(decode_concise(data))
    except ValueError:
        return False


def _why_not(sections: Sections) -> str:
    if "topology" in sections:
        return "is a CANopen project (.cpj, CiA 306-3) and no EDS; give the DCF files that it names"
    if "device" in sections and "deviceinfo" not in sections:
        return "is an EtherNet/IP EDS (ODVA) and no CANopen one"
    first = next(iter(sections.values()))
    return f"has no object sections such as [1000], so it is no CANopen EDS; it begins with [{clip(first.title)}]"


def _range_types(sections: Sections) -> Iterator[tuple[int, RangeType]]:
    """Yield the types that editors make of a basic type and its limits, in sections such as [A0]: by their index.

    Sub 1 holds the index of the basic type, sub 2 the least value, sub 3 the greatest.
    """
    for name in sections:
        match = _RANGE_SUB.fullmatch(name)
        if match is None or (index := int(match[1], 16)) not in _RANGES:
            continue
        parts = [sections.get(f"{match[1]}sub{number}") for number in (1, 2, 3)]
        try:
            numbers = [None if each is None else parse_number(each.get("defaultvalue"))[0] for each in parts]
        except ValueError:
            continue
        if numbers[0] in _TYPES:
            yield index, RangeType(_TYPES[numbers[0]], numbers[1], numbers[2])


@dataclass(slots=True)
class _Reader:
    """Object sections to objects and entries; parents come before their subs, wherever the file puts them."""

    od: ObjectDictionary
    sections: Sections
    report: Report
    has_subs: set[int] = field(default_factory=set)
    entry_reader: EntryReader = field(init=False)

    def __post_init__(self) -> None:
        self.entry_reader = EntryReader(self.od.node_id, self.report)

    def run(self) -> None:
        """Read all object sections, keep the others."""
        self.entry_reader.ranges.update(_range_types(self.sections))
        found: list[tuple[int, int, Section]] = []  # subindex -1 is the object itself
        for name, section in self.sections.items():
            match = _OBJECT.fullmatch(name)
            if match is None:
                self._keep(section)
                continue
            subindex = -1 if match[2] is None else int(match[2], 16)
            found.append((int(match[1], 16), subindex, section))
            if subindex > 0:
                self.has_subs.add(int(match[1], 16))
        found.sort(key=lambda item: item[:2])
        for index, subindex, section in found:
            if subindex < 0:
                self._object(section, index)
            else:
                self._sub(section, index, subindex)

    def _keep(self, section: Section) -> None:
        name = section.name
        if (match := _COMPACT.fullmatch(name)) is not None:
            parent = self.sections.get(match[1])
            if parent is None or not parent.get("compactsubobj"):
                self.report.warning(section.line, "compact-unused", f"[{section.title}] has no CompactSubObj to fill")
        elif _LOOKS_LIKE_OBJECT.match(name):
            self.report.warning(section.line, "section-unknown", f"[{clip(section.title)}] is no object; not used")
        elif _MODULE.fullmatch(name):
            text = f"[{section.title}]: a module's objects are kept as text and are not part of the dictionary"
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
                text = f"[{section.title}] has no ObjectType; taken as RECORD"
                self.report.warning(section.line, "object-type", text)
            return ObjectCode.RECORD if is_list else ObjectCode.VAR
        code = _CODES.get(number)
        if code is None:
            code = ObjectCode.RECORD if is_list else ObjectCode.VAR
            text = f"ObjectType {number:#x} is unknown; taken as {code.name}"
            self.report.warning(section.line_of("objecttype"), "object-type", text)
        elif is_list and code is ObjectCode.VAR and index not in self.has_subs:
            text = f"[{section.title}] is a VAR with CompactSubObj; taken as ARRAY, which it is"
            self.report.warning(section.line_of("objecttype"), "object-type", text)
            code = ObjectCode.ARRAY
        elif is_list and code is ObjectCode.VAR:
            text = f"[{section.title}] is a VAR with subindices; both are kept"
            self.report.warning(section.line, "object-type", text)
        return code

    def _compact_count(self, section: Section, *, quiet: bool = False) -> int:
        if "compactsubobj" not in section.values:
            return 0
        report = Report(self.report.path) if quiet else self.report
        count = read_number(section, "compactsubobj", 0, report)
        if not 0 <= count <= _HIGHEST_SUB:
            text = f"CompactSubObj={clip(section.get('compactsubobj'))} is not 0 to 254; cut to that"
            report.error(section.line_of("compactsubobj"), "compact-count", text)
        return min(max(count, 0), _HIGHEST_SUB)

    def _name(self, section: Section, fallback: str) -> str:
        name = section.get("parametername")
        if not name:
            text = f"[{section.title}] has no ParameterName; now {fallback!r}"
            self.report.warning(section.line, "name-missing", text)
        return name or fallback

    def _sub(self, section: Section, index: int, subindex: int) -> None:
        if index not in self.od.objects:
            text = f"[{section.title}] has no object section [{index:04X}]; taken as a RECORD"
            self.report.warning(section.line, "object-missing", text)
            self.od.objects[index] = ObjectInfo(index, f"Object {index:04X}", ObjectCode.RECORD, section.line)
        if (index, subindex) in self.od.entries:
            text = f"[{section.title}] describes again what [{index:04X}] does; the subindex's own section counts"
            self.report.warning(section.line, "entry-repeated", text)
        name = self._name(section, f"Subindex {subindex}")
        code = read_number(section, "objecttype", ObjectCode.VAR, self.report)
        self.od.entries[index, subindex] = self.entry_reader.read(section, index, subindex, name, code)

    def _expand(self, section: Section, index: int, count: int) -> None:
        """Make the entries that CompactSubObj stands for (CiA 306-1, 4.6.3.4)."""
        label = self.od.objects[index].name
        entries = self.od.entries
        entries[index, 0] = Entry(
            index, 0, "Highest sub-index supported", DataType.UNSIGNED8, "ro", default=count, line=section.line
        )
        names = self._compact_pairs(f"{index:04x}name", count)
        values = self._compact_pairs(f"{index:04x}value", count)
        values_section = self.sections.get(f"{index:04x}value")
        model = self.entry_reader.read(section, index, 1, label, ObjectCode.VAR)
        for subindex in range(1, count + 1):
            name = names[subindex].value if subindex in names else f"{label}{subindex}"
            pair = values.get(subindex)
            if pair is None:
                entries[index, subindex] = self.entry_reader.like(model, subindex, name)
            else:
                entries[index, subindex] = self.entry_reader.like(model, subindex, name, values_section, pair.key)

    def _compact_pairs(self, name: str, count: int) -> dict[int, Pair]:
        """Return by subindex what a [xxxxName] or [xxxxValue] section says of it."""
        section = self.sections.get(name)
        if section is None:
            return {}
        pairs: dict[int, Pair] = {}
        for pair in section.numbered():
            subindex = int(pair.key) if len(pair.key) < 5 else -1
            if 0 < subindex <= count and subindex not in pairs:
                pairs[subindex] = pair
            else:
                text = f"[{section.title}] names {clip(pair.key)}, which is not 1 to {count} or comes again; ignored"
                self.report.warning(pair.line, "compact-unused", text)
        return pairs
