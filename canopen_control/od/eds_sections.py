"""Sections, keys and entries of EDS and DCF files (CiA 306-1, 4.2 to 4.6).

The reader accepts UTF-8, UTF-16 and Windows-1252; LF, CR and CRLF, even mixed; a DOS end-of-file character; and any
letter case of sections and keys. If a section or key is repeated, the first is used and the second is reported.

Large files have hundreds of thousands of lines, nearly all of them plain. In a section of plain lines with different
keys the line numbers are computed only on request; any other section is read line by line.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, NamedTuple

from canopen_control.errors import EdsError
from canopen_control.od.eds_values import Parsed, parse_number, parse_value
from canopen_control.od.issues import Report
from canopen_control.od.model import (
    ACCESS_TYPES,
    Address,
    Commissioning,
    DataType,
    DeviceInfo,
    Entry,
    ObjectCode,
    ObjectDictionary,
    communication_type,
    profile_type,
)

if TYPE_CHECKING:
    from collections.abc import Iterator


_COMMENT = ";#"
_BLANK = " \t\r\n\x00\x1a\ufeff"
_NOT_CANOPEN = (  # beginning of the file, and the format it indicates
    ("$", "is an EtherNet/IP EDS (ODVA), not a CANopen EDS"),
    ("version https://git-lfs", "is a Git LFS pointer; fetch the file with: git lfs pull"),
)


class Pair(NamedTuple):
    """Line ``key=value`` of a section."""

    key: str  # spelled as in the file
    value: str
    line: int


@dataclass(slots=True)
class Section:
    """One [section] of an EDS or DCF file, with its keys and their lines.

    `values` contains the texts by lower-case key, `written` by the key as in the file, both in the order of the file.
    """

    name: str  # in lower case
    title: str  # spelled as in the file
    line: int
    values: dict[str, str] = field(default_factory=dict)
    written: dict[str, str] = field(default_factory=dict)
    body: str = ""  # text after the line of the section, until `lines` is computed from it
    lines: dict[str, int] | None = None  # line of each lower-case key

    def get(self, key: str) -> str:
        """Return the text of a lower-case key; empty if absent."""
        return self.values.get(key, "")

    def pair(self, key: str) -> Pair | None:
        """Return the pair of a lower-case key, or None if absent."""
        return Pair(self.spelled(key), self.values[key], self.line_of(key)) if key in self.values else None

    def spelled(self, key: str) -> str:
        """Return a lower-case key as spelled in the file."""
        return next(written for lower, written in zip(self.values, self.written, strict=True) if lower == key)

    def line_of(self, key: str) -> int:
        """Return the line of a lower-case key, or of the section if the key is absent."""
        return self.line_numbers().get(key, self.line)

    def line_numbers(self) -> dict[str, int]:
        """Return the line of each lower-case key."""
        if self.lines is None:
            self.lines = _lines_of_keys(self.body, self.line)
        return self.lines

    def texts(self) -> dict[str, str]:
        """Return the texts by key, with keys as spelled in the file."""
        return self.written

    def pairs(self) -> Iterator[Pair]:
        """Yield all pairs."""
        pairs = zip(self.values, self.written.items(), strict=True)
        return (Pair(written, value, self.line_of(key)) for key, (written, value) in pairs)

    def numbered(self) -> Iterator[Pair]:
        """Yield the pairs with a numeric key, as in object lists."""
        return (pair for pair in self.pairs() if pair.key.isascii() and pair.key.isdigit())


def _lines_of_keys(body: str, line: int) -> dict[str, int]:
    """Return the line of each key in a section that starts at `line` and contains only plain lines."""
    numbered = enumerate(body.split("\n"), line + 1)
    return {raw.partition("=")[0].strip().lower(): number for number, raw in numbered if _has_content(raw)}


def _has_content(raw: str) -> bool:
    line = raw.lstrip()
    return bool(line) and line[0] not in _COMMENT


Sections = dict[str, Section]


def decode_text(data: bytes) -> tuple[str, str]:
    """Decode a file; return the text and the name of the encoding. Every byte string can be decoded."""
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return data.decode("utf-16", errors="replace"), "utf-16"
    if data[1:2] == b"\0" and data[:1] != b"\0":
        return data.decode("utf-16-le", errors="replace"), "utf-16"
    for encoding in ("utf-8-sig", "cp1252"):
        try:
            return data.decode(encoding), encoding
        except UnicodeDecodeError:
            continue
    return data.decode("latin-1"), "latin-1"


def read_number(section: Section, key: str, default: int, report: Report) -> int:
    """Return the number of a lower-case key, or `default` if absent; report an invalid text."""
    if key not in section.values:
        return default
    number = _number(section, key, report, default)
    return default if number is None else number


def optional_number(section: Section, key: str, report: Report) -> int | None:
    """Return the number of a lower-case key, or None; report an empty or invalid text."""
    return _number(section, key, report) if key in section.values else None


def _number(section: Section, key: str, report: Report, default: int | None = None) -> int | None:
    text = section.values[key]
    try:
        number, _, issue = parse_number(text)
    except ValueError as problem:
        written, line = section.spelled(key), section.line_of(key)
        description = f"{clip(text)} is {problem}" if text else "is empty"
        instead = "absent" if default is None else default
        report.warning(line, "key-number", f"{clip(written)} {description}; treated as {instead}")
        return None
    if issue is not None:
        written, line = section.spelled(key), section.line_of(key)
        report.add(line, issue.code, issue.severity, f"{clip(written)}={clip(text)}: {issue.text}")
    return number


def clip(text: str) -> str:
    """Shorten a text from the file to at most 60 characters for a message."""
    return text if len(text) <= 60 else f"{text[:57]}..."


def split_sections(text: str, report: Report) -> Sections:
    """Split the text of a file into sections; raise EdsError if it has none."""
    splitter = _Splitter(report)
    before, *sections = f"\n{_with_plain_ends(text)}".split("\n[")
    number = splitter.read_lines(None, before.split("\n"), 0)
    for section in sections:
        number = splitter.read_section(section, number)
    if not splitter.sections:
        raise EdsError(report.path, 1, what_else(text) or _why_none(text.strip(_BLANK)))
    return splitter.sections


def _with_plain_ends(text: str) -> str:
    """Return the text with LF line ends; DOS end-of-file characters, zeros and byte order marks become blanks."""
    for odd, plain in (("\r\n", "\n"), ("\r", "\n"), ("\x1a", " "), ("\0", " "), ("\ufeff", " ")):
        text = text.replace(odd, plain)
    return text


def what_else(text: str) -> str:
    """Return the format indicated by the beginning of a text, or "" if unknown or possibly an EDS."""
    begin = text[:1000].lstrip(_BLANK)
    return next((meaning for start, meaning in _NOT_CANOPEN if begin.startswith(start)), "")


def _why_none(text: str) -> str:
    if not text:
        return "is empty"
    if "\n" not in text and len(text) < 1000:
        return f"contains only {clip(text)!r}; if that is a symbolic link stored as text, use the file with this path"
    return "has no sections, so it is not an EDS"


class _Keys(dict[str, tuple[str, str]]):
    """Cache of stripped and lower-case keys, by the text before the equals sign."""

    def __missing__(self, raw: str) -> tuple[str, str]:
        key = raw.strip()
        if key[:1] in ("[", ";", "#"):
            raise ValueError("no key")
        self[raw] = keys = key, key.lower()
        return keys


class _Splitter:
    """Splitter of a file into sections; reports lines that are not plain ``key=value``."""

    def __init__(self, report: Report) -> None:
        self.report = report
        self.sections: Sections = {}
        self._keys = _Keys()

    def read_section(self, text: str, number: int) -> int:
        """Read a section whose header is in line `number`; return the number of the line after it."""
        head, newline, body = text.partition("\n")
        section = self.open(f"[{head.rstrip()}", number)
        lines = body.split("\n") if newline else []
        if self._read_plain(section, lines):
            section.body, section.lines = body, None
            return number + 1 + len(lines)
        return self.read_lines(section, lines, number + 1)

    def _read_plain(self, section: Section, lines: list[str]) -> bool:
        """Read the lines of a section; return False, with no effect, if a line is not plain or a key is repeated."""
        keys, values, written, count = self._keys, dict[str, str](), dict[str, str](), 0
        for line in lines:
            raw, equals, value = line.partition("=")
            if equals:
                try:
                    key, lower = keys[raw]
                except ValueError:  # a comment, or a section header after blanks
                    return False
                values[lower] = written[key] = value.strip()
                count += 1
            elif line and line[0] not in _COMMENT:
                return False
        if len(values) < count:
            return False
        section.values, section.written = values, written
        return True

    def read_lines(self, section: Section | None, lines: list[str], first: int) -> int:
        """Read lines one by one, starting with number `first`; return the number of the next line."""
        for number, raw in enumerate(lines, first):
            line = raw.strip()
            if not line or line[0] in _COMMENT:
                continue
            if line[0] == "[":
                section = self.open(line, number)
                continue
            key, equals, value = line.partition("=")
            if not equals or section is None:
                self.stray(line, number)
            else:
                self._add(section, Pair(key.rstrip(), value.lstrip(), number))
        return first + len(lines)

    def _add(self, section: Section, pair: Pair) -> None:
        lower = pair.key.lower()
        first = section.pair(lower)
        if first is not None:
            self.repeated(pair, first)
            return
        section.values[lower] = section.written[pair.key] = pair.value
        section.line_numbers()[lower] = pair.line

    def open(self, line: str, number: int) -> Section:
        """Open a section; a repeated section is reported, and its content is discarded."""
        title, closed, rest = line[1:].partition("]")
        title, rest = title.strip(), rest.strip()
        if not closed or (rest and rest[0] not in _COMMENT):
            text = f"section line {clip(line)!r} is malformed; read as [{clip(title)}]"
            self.report.warning(number, "section-form", text)
        section = Section(title.lower(), title, number, lines={})
        first = self.sections.setdefault(section.name, section)
        if first is not section:
            text = f"section [{clip(title)}] is repeated; only the first, in line {first.line}, is used"
            self.report.warning(number, "section-repeated", text)
        return section

    def stray(self, line: str, number: int) -> None:
        """Report a line outside all sections, or without a key."""
        text = f"line {clip(line)!r} is not key=value in a section; ignored"
        self.report.warning(number, "stray-line", text)

    def repeated(self, pair: Pair, first: Pair) -> None:
        lost = "with the same value" if pair.value == first.value else f"with {clip(pair.value)!r}, which is ignored"
        text = f"{clip(pair.key)} is repeated {lost}; line {first.line} is used"
        self.report.warning(pair.line, "key-repeated", text)


# Entry described by one section (CiA 306-1, 4.6.3). Errors are reported and replaced by the least harmful value: an
# unknown type is treated as bytes of any length, an unreadable access is rw, swapped limits are dropped. A value that
# does not fit its type is omitted; its text stays in the entry's `texts`.


_TYPES: dict[int, DataType] = {int(data_type): data_type for data_type in DataType}
_TYPE_NAMES = {data_type.name: data_type for data_type in DataType}
_ACCESS = {name: name for name in ACCESS_TYPES}
_ACCESS_ALIASES = {
    "r": "ro",
    "w": "wo",
    "wr": "rw",
    "readonly": "ro",
    "writeonly": "wo",
    "readwrite": "rw",
    "constant": "const",
}
_SEPARATORS = re.compile(r"[\s/_-]+")
_VALUE_KEYS = ("defaultvalue", "parametervalue")


class RangeType(NamedTuple):
    """Manufacturer-specific data type: a basic type with limits of the values."""

    base: DataType
    low: int | None
    high: int | None


class _Limit(NamedTuple):
    value: int | float | None = None
    relative: bool = False


class _Traits(NamedTuple):
    """Attributes shared by all entries with the same texts.

    `defaults` contains the values that were parsed without an issue, by text.
    """

    data_type: DataType
    known: bool
    access: str
    pdo_mappable: bool
    low: _Limit
    high: _Limit
    obj_flags: int
    defaults: dict[str, Parsed]


_NO_LIMIT = _Limit()
_NO_VALUE = Parsed(None)


@dataclass(frozen=True, slots=True)
class EntryReader:
    """Reader of the entries of a file; `node_id` replaces $NODEID, None if unknown.

    A file with thousands of entries repeats few texts, so that results without an issue are cached. `ranges` contains
    the manufacturer-specific data types by index. `is_drive` is True if the device type (0x1000) is CiA 402.
    """

    node_id: int | None
    report: Report
    is_drive: bool = False
    traits: dict[tuple[str | int | None, ...], _Traits] = field(default_factory=dict)
    ranges: dict[int, RangeType] = field(default_factory=dict)

    def read(self, section: Section, index: int, subindex: int, name: str, code: int) -> Entry:
        """Return the entry described by `section`; `code` is the object code."""
        traits = self._traits(section, code, (index, subindex))
        data_type, is_known, access, pdo_mappable, low, high, obj_flags, _ = traits
        default = self._parsed(section, "defaultvalue", traits) if is_known else _NO_VALUE
        parameter = self._parsed(section, "parametervalue", traits) if is_known else _NO_VALUE
        return Entry(
            index,
            subindex,
            name,
            data_type,
            access,
            pdo_mappable,
            default.value,
            low.value,
            high.value,
            default.relative,
            low.relative,
            high.relative,
            parameter.value,
            parameter.relative,
            obj_flags,
            section.line,
            section.texts(),
        )

    def like(self, model: Entry, subindex: int, name: str) -> Entry:
        """Return a copy of `model` for another subindex."""
        return replace(model, subindex=subindex, name=name, texts={})

    def with_value(self, entry: Entry, values: Section, key: str, *, is_dcf: bool) -> Entry:
        """Return a copy of an entry with the value of `key` as its ParameterValue in a DCF, else as its default."""
        parsed = self._read_value(values, key, entry.data_type)
        if parsed is _NO_VALUE:
            return entry
        if is_dcf:
            return replace(entry, parameter_value=parsed.value, parameter_relative=parsed.relative)
        return replace(entry, default=parsed.value, relative=parsed.relative)

    def _traits(self, section: Section, code: int, address: Address) -> _Traits:
        text = section.values.get
        key = (
            code,
            text("datatype"),
            text("accesstype"),
            text("pdomapping"),
            text("lowlimit"),
            text("highlimit"),
            text("objflags"),
        )
        traits = self.traits.get(key)
        if traits is not None:
            return traits
        issues = len(self.report.issues)
        data_type, is_known = self._data_type(section, code, address)
        low, high = self._limits(section, data_type)
        access = self._access(section)
        pdo_mappable = read_number(section, "pdomapping", 0, self.report) != 0
        obj_flags = read_number(section, "objflags", 0, self.report)
        traits = _Traits(data_type, is_known, access, pdo_mappable, low, high, obj_flags, {})
        if len(self.report.issues) == issues:
            self.traits[key] = traits
        return traits

    def _data_type(self, section: Section, code: int, address: Address) -> tuple[DataType, bool]:
        if "datatype" not in section.values and code == ObjectCode.DOMAIN:
            return DataType.DOMAIN, True
        named = _TYPE_NAMES.get(section.get("datatype").partition(";")[0].strip().upper())
        if named is not None:
            text = f"DataType={clip(section.get('datatype'))} is a name; treated as 0x{named:04X}, its number"
            self.report.warning(section.line_of("datatype"), "data-type", text)
            return named, True
        report = Report(self.report.path)
        number = optional_number(section, "datatype", report)
        if number is not None:
            self.report.issues += report.issues  # the issue below is enough if it is not a number
        ranged = self.ranges.get(number) if number is not None else None
        if ranged is not None:
            return ranged.base, True
        data_type = _TYPES.get(number) if number is not None else None
        if data_type is not None:
            return data_type, True
        description = (
            f"DataType={clip(section.get('datatype'))} is not a basic type"
            if "datatype" in section.values
            else f"[{section.title}] has no DataType"
        )
        standard, profile = communication_type(*address), 301
        if standard is None and self.is_drive and number is None:  # as in Kinco's FD124S (ros2_canopen, issue 202)
            standard, profile = next(iter(profile_type(*address)), None), 402
        if standard is not None:
            place = f"0x{address[0]:04X}:{address[1]:02X}"
            text = f"{description}; treated as {standard.name}, the type in CiA {profile} of {place}"
            self.report.warning(section.line_of("datatype"), "data-type", text)
            return standard, True
        remark = "; its values are kept as text" if any(section.get(key) for key in _VALUE_KEYS) else ""
        self.report.warning(
            section.line_of("datatype"), "data-type", f"{description}; treated as bytes of any length{remark}"
        )
        return DataType.DOMAIN, False

    def _range_type(self, section: Section) -> RangeType | None:
        if not self.ranges or "datatype" not in section.values:
            return None
        number = optional_number(section, "datatype", Report(self.report.path))
        return self.ranges.get(number) if number is not None else None

    def _access(self, section: Section) -> str:
        plain = section.get("accesstype").partition(";")[0]  # an ordinary comment (CiA 306-1, 4.2)
        text, _, comment = (part.strip() for part in plain.lower().partition("#"))
        access = _ACCESS.get(text)
        if access is not None and comment:
            message = (
                f"AccessType={clip(section.get('accesstype'))}: the comment after # is ignored; CiA 306 allows only ;"
            )
            self.report.warning(section.line_of("accesstype"), "number-comment", message)
        if access is None:
            access = _ACCESS_ALIASES.get(_SEPARATORS.sub("", text), "rw")
            description = f"AccessType={clip(text)} is unknown" if text else f"[{section.title}] has no AccessType"
            self.report.warning(section.line_of("accesstype"), "access-type", f"{description}; treated as {access}")
        return access

    def _parsed(self, section: Section, key: str, traits: _Traits) -> Parsed:
        text = section.values.get(key)
        if not text:
            return _NO_VALUE  # many tools write an empty DefaultValue= for "no default"
        parsed = traits.defaults.get(text)
        if parsed is None:
            parsed = self._read_value(section, key, traits.data_type)
            if parsed.issue is None and parsed is not _NO_VALUE:
                traits.defaults[text] = parsed
        return parsed

    def _read_value(self, section: Section, key: str, data_type: DataType) -> Parsed:
        text = section.get(key)
        if not text:
            return _NO_VALUE
        try:
            parsed = parse_value(text, data_type, self.node_id)
        except ValueError as problem:
            reason = f"{section.spelled(key)}={clip(text)} is not a valid {data_type.name} ({problem}); value ignored"
            self.report.error(section.line_of(key), "value-form", reason)
            return _NO_VALUE
        if parsed.issue is not None:
            issue = parsed.issue
            message = f"{section.spelled(key)}={clip(text)}: {issue.text}"
            self.report.add(section.line_of(key), issue.code, issue.severity, message)
        return parsed

    def _limits(self, section: Section, data_type: DataType) -> tuple[_Limit, _Limit]:
        if "lowlimit" not in section.values and "highlimit" not in section.values:
            ranged = self._range_type(section)
            return (_NO_LIMIT, _NO_LIMIT) if ranged is None else (_Limit(ranged.low), _Limit(ranged.high))
        low, high = self._limit(section, "lowlimit", data_type), self._limit(section, "highlimit", data_type)
        if low.value is not None and high.value is not None and low.value > high.value:
            self.report.warning(section.line_of("lowlimit"), "limit-order", _order_text(section, data_type, low, high))
            return _NO_LIMIT, _NO_LIMIT
        return low, high

    def _limit(self, section: Section, key: str, data_type: DataType) -> _Limit:
        text = section.get(key)
        if not text or data_type.bits is None:
            return _NO_LIMIT
        try:
            parsed = parse_value(text, data_type, self.node_id)
        except ValueError as problem:
            message = f"{section.spelled(key)}={clip(text)} is not a valid {data_type.name} ({problem}); ignored"
            self.report.warning(section.line_of(key), "limit-form", message)
            return _NO_LIMIT
        return _Limit(parsed.value, parsed.relative) if isinstance(parsed.value, int | float) else _NO_LIMIT


def _order_text(section: Section, data_type: DataType, low: _Limit, high: _Limit) -> str:
    """Return the message for limits in the wrong order, with their numbers if the texts differ (0xFF is -1)."""
    texts = [clip(section.get(key)) for key in ("lowlimit", "highlimit")]
    numbers = [str(limit.value) for limit in (low, high) if limit.value is not None]
    shown = f" ({' > '.join(numbers)} as {data_type.name})" if texts != numbers else ""
    return f"LowLimit={texts[0]} is above HighLimit={texts[1]}{shown}; both are ignored"


# Device sections (CiA 306-1, 4.4 to 4.6.2): [DeviceInfo], [DummyUsage], [Comments], [DeviceComissioning] (with one m,
# as in the standard, or two) and the three object lists. The objects can be used without them, so that errors here are
# at most warnings.


DEVICE_TEXTS = {"vendorname": "vendor_name", "productname": "product_name", "ordercode": "order_code"}
DEVICE_NUMBERS = {
    "vendornumber": "vendor_number",
    "productnumber": "product_number",
    "revisionnumber": "revision_number",
}
DEVICE_FLAGS = {
    "simplebootupmaster": "simple_boot_up_master",
    "simplebootupslave": "simple_boot_up_slave",
    "groupmessaging": "group_messaging",
    "lss_supported": "lss_supported",
}
DEVICE_COUNTS = {
    "granularity": "granularity",
    "dynamicchannelssupported": "dynamic_channels",
    "nrofrxpdo": "rpdo_count",
    "nroftxpdo": "tpdo_count",
    "compactpdo": "compact_pdo",
}
COMMISSIONING = ("devicecomissioning", "devicecommissioning")
OBJECT_LISTS = ("mandatoryobjects", "optionalobjects", "manufacturerobjects")
_COUNT_DEFAULTS = {"granularity": 8}
_BIT_RATE = re.compile(r"baudrate_([0-9]{1,5})")
_DUMMY = re.compile(r"dummy([0-9a-f]{4})")
_COMMENT_KEY = re.compile(r"line([0-9]{1,9})")
_HIGHEST_KBITS = 10_000  # a larger Baudrate is in bit/s, a smaller Baudrate in kbit/s as in CiA 306-1


def read_device(sections: Sections, node_id: int | None, report: Report) -> ObjectDictionary:
    """Return a dictionary with the device sections but no objects; `node_id` overrides the node-ID in the file."""
    od = ObjectDictionary(node_id=node_id)
    info = sections.get("deviceinfo")
    if info is None:
        report.warning(0, "device-info", "section [DeviceInfo] is missing; vendor, product and bit rates are unknown")
    else:
        od.device = _device_info(info, report)
    od.dummy_usage = frozenset(_dummies(sections.get("dummyusage"), report))
    od.comments = _comments(sections.get("comments"))
    for name in COMMISSIONING:
        if (section := sections.get(name)) is not None:
            _commission(od, section, report)
            break
    return od


def _device_info(section: Section, report: Report) -> DeviceInfo:
    fields: dict[str, Any] = {field: section.get(key) for key, field in DEVICE_TEXTS.items()}
    fields |= {field: optional_number(section, key, report) for key, field in DEVICE_NUMBERS.items()}
    fields |= {field: read_number(section, key, 0, report) != 0 for key, field in DEVICE_FLAGS.items()}
    for key, name in DEVICE_COUNTS.items():
        fields[name] = read_number(section, key, _COUNT_DEFAULTS.get(key, 0), report)
    rates = [(key, match) for key in section.values if (match := _BIT_RATE.fullmatch(key)) is not None]
    fields["bit_rates"] = frozenset(
        int(match[1]) * 1000 for key, match in rates if read_number(section, key, 0, report)
    )
    return DeviceInfo(**fields)


def _dummies(section: Section | None, report: Report) -> list[int]:
    if section is None:
        return []
    matches = [(key, match) for key in section.values if (match := _DUMMY.fullmatch(key)) is not None]
    return [int(match[1], 16) for key, match in matches if read_number(section, key, 0, report)]


def _comments(section: Section | None) -> tuple[str, ...]:
    if section is None:
        return ()
    lines = [(int(match[1]), key) for key in section.values if (match := _COMMENT_KEY.fullmatch(key)) is not None]
    return tuple(section.get(key) for _, key in sorted(lines))


def _commission(od: ObjectDictionary, section: Section, report: Report) -> None:
    node_id = optional_number(section, "nodeid", report)
    if node_id is not None and not 1 <= node_id <= 127:
        text = f"NodeID={clip(section.get('nodeid'))} is not 1 to 127; ignored"
        report.warning(section.line_of("nodeid"), "commissioning", text)
    elif od.node_id is None:
        od.node_id = node_id
    od.bitrate = _bitrate(section, report)
    od.commissioning = Commissioning(
        node_name=section.get("nodename"),
        network_number=optional_number(section, "netnumber", report),
        network_name=section.get("networkname"),
        canopen_manager=read_number(section, "canopenmanager", 0, report) != 0,
        lss_serial_number=optional_number(section, "lss_serialnumber", report),
    )


def saved_node_id(od: ObjectDictionary) -> int:
    """Return the node-ID for which a DCF was saved, from its section [DeviceComissioning]; 0 if it has none."""
    titles = {title.lower(): texts for title, texts in od.sections.items()}
    section = next((titles[name] for name in COMMISSIONING if name in titles), {})
    text = next((value for key, value in section.items() if key.lower() == "nodeid"), "")
    try:
        return parse_number(text).value
    except ValueError:
        return 0


def _bitrate(section: Section, report: Report) -> int | None:
    number = optional_number(section, "baudrate", report)
    if number is None or number <= 0:
        return None
    if number > _HIGHEST_KBITS:
        text = f"Baudrate={number} is treated as bit/s; CiA 306 specifies kbit/s"
        report.warning(section.line_of("baudrate"), "commissioning", text)
        return number
    return number * 1000


def check_lists(od: ObjectDictionary, sections: Sections, report: Report) -> None:
    """Report differences between the three object lists and the objects in the file."""
    lists = [section for name in OBJECT_LISTS if (section := sections.get(name)) is not None]
    if not lists:
        report.warning(0, "list-missing", "the object lists are missing; only the object sections are used")
        return
    listed: dict[int, Pair] = {}
    for section in lists:
        _read_list(section, listed, report)
    for index, pair in listed.items():
        if index not in od.objects:
            report.warning(pair.line, "list-object", f"0x{index:04X} is listed but has no section")
    for index, info in od.objects.items():
        if index not in listed:
            report.note(info.line, "list-absent", f"0x{index:04X} ({clip(info.name)}) is in none of the object lists")


def _read_list(section: Section, listed: dict[int, Pair], report: Report) -> None:
    count = 0
    for pair in section.numbered():
        count += 1
        try:
            index = parse_number(pair.value)[0]
        except ValueError:
            report.warning(pair.line, "list-object", f"{pair.key}={clip(pair.value)} is not an index; ignored")
            continue
        first = listed.setdefault(index, pair)
        if first is not pair:
            report.warning(pair.line, "list-object", f"0x{index:04X} is listed twice, first in line {first.line}")
    declared = optional_number(section, "supportedobjects", report)
    if declared != count:
        declaration = "absent" if declared is None else declared
        text = f"[{section.title}] has {count} entries, but SupportedObjects is {declaration}"
        report.warning(section.line_of("supportedobjects"), "list-count", text)
