"""The lines of an EDS or DCF file as sections of keys (CiA 306-1, 4.2), forgiving what editors do to files.

UTF-8, UTF-16 and Windows-1252; CR, LF and CRLF, also mixed; an end-of-file character of DOS; any case of sections and
keys. Of two sections or keys with one name the first counts, and the second is an issue.

Large files have hundreds of thousands of lines, nearly all of them plain: those of a section of nothing but different
keys are not counted before somebody asks for the number of one. Any other section is read line by line.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

from canopen_control.errors import EdsError
from canopen_control.od.eds_values import parse_number

if TYPE_CHECKING:
    from collections.abc import Iterator

    from canopen_control.od.issues import Report

__all__ = [
    "Pair",
    "Section",
    "Sections",
    "clip",
    "decode_text",
    "optional_number",
    "read_number",
    "split_sections",
    "what_else",
]

_COMMENT = ";#"
_BLANK = " \t\r\n\x00\x1a\ufeff"
_NOT_CANOPEN = (  # what the file begins with, and what it is then
    ("<", "is XML, a device description of CiA 311 (XDD or XDC), and no EDS; ask the vendor for the EDS"),
    ("$", "is an EtherNet/IP EDS (ODVA) and no CANopen one"),
    ("version https://git-lfs", "is a pointer of git-lfs; fetch the file itself: git lfs pull"),
)


class Pair(NamedTuple):
    """One ``key=value`` line."""

    key: str  # as written
    value: str
    line: int


@dataclass(slots=True)
class Section:
    """One section; `values` by lower-case key, `written` by the key as written, both in the order of the file."""

    name: str  # lower case
    title: str  # as written
    line: int
    values: dict[str, str] = field(default_factory=dict)
    written: dict[str, str] = field(default_factory=dict)
    body: str = ""  # what follows the line of the section, where `lines` is still to be made of it
    lines: dict[str, int] | None = None  # by lower-case key

    def get(self, key: str) -> str:
        """Return the text of a lower-case key, empty where it is absent."""
        return self.values.get(key, "")

    def pair(self, key: str) -> Pair | None:
        """Return the line of a lower-case key, or None."""
        return Pair(self.spelled(key), self.values[key], self.line_of(key)) if key in self.values else None

    def spelled(self, key: str) -> str:
        """Return a lower-case key that is there as it is written."""
        return next(written for lower, written in zip(self.values, self.written, strict=True) if lower == key)

    def line_of(self, key: str) -> int:
        """Return the line of a key, or the section's where it is absent."""
        return self.line_numbers().get(key, self.line)

    def line_numbers(self) -> dict[str, int]:
        """Return the line of each key, by lower-case key."""
        if self.lines is None:
            self.lines = _lines_of_keys(self.body, self.line)
        return self.lines

    def texts(self) -> dict[str, str]:
        """Return the section as written."""
        return self.written

    def numbered(self) -> Iterator[Pair]:
        """Yield the pairs whose key is a number, as in the object lists."""
        pairs = zip(self.values, self.written.items(), strict=True)
        return (
            Pair(written, value, self.line_of(key))
            for key, (written, value) in pairs
            if key.isascii() and key.isdigit()
        )


def _lines_of_keys(body: str, line: int) -> dict[str, int]:
    """Return the line of each key of a section of plain lines, which begins in `line`."""
    numbered = enumerate(body.split("\n"), line + 1)
    return {raw.partition("=")[0].strip().lower(): number for number, raw in numbered if _says(raw)}


def _says(raw: str) -> bool:
    """Whether a line is neither blank nor a comment."""
    line = raw.lstrip()
    return bool(line) and line[0] not in _COMMENT


Sections = dict[str, Section]


def decode_text(data: bytes) -> tuple[str, str]:
    """Return the text of a file and the name of its encoding; every byte string has one."""
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
    """Return the number of a lower-case key, or `default`; a text that is empty or no number is reported."""
    if key not in section.values:
        return default
    number = _number(section, key, report, default)
    return default if number is None else number


def optional_number(section: Section, key: str, report: Report) -> int | None:
    """Return the number of a lower-case key, or None; a text that is empty or no number is reported."""
    return _number(section, key, report) if key in section.values else None


def _number(section: Section, key: str, report: Report, default: int | None = None) -> int | None:
    text = section.values[key]
    try:
        number, _, issue = parse_number(text)
    except ValueError as problem:
        written, line = section.spelled(key), section.line_of(key)
        what = f"{clip(text)} is {problem}" if text else "is empty"
        instead = "absent" if default is None else default
        report.warning(line, "key-number", f"{clip(written)} {what}; taken as {instead}")
        return None
    if issue is not None:
        written, line = section.spelled(key), section.line_of(key)
        report.add(line, issue.code, issue.severity, f"{clip(written)}={clip(text)}: {issue.text}")
    return number


def clip(text: str) -> str:
    """Shorten what a file says to what fits a message."""
    return text if len(text) <= 60 else f"{text[:57]}..."


def split_sections(text: str, report: Report) -> Sections:
    """Split the text of a file; EdsError where it holds no section at all."""
    splitter = _Splitter(report)
    before, *sections = f"\n{_with_plain_ends(text)}".split("\n[")
    number = splitter.read_lines(None, before.split("\n"), 0)
    for section in sections:
        number = splitter.read_section(section, number)
    if not splitter.sections:
        raise EdsError(report.path, 1, what_else(text) or _why_none(text.strip(_BLANK)))
    return splitter.sections


def _with_plain_ends(text: str) -> str:
    """Return the text with its lines ended by LF; the end-of-file character of DOS and padding zeros are blanks."""
    for odd, plain in (("\r\n", "\n"), ("\r", "\n"), ("\x1a", " "), ("\0", " "), ("\ufeff", " ")):
        text = text.replace(odd, plain)
    return text


def what_else(text: str) -> str:
    """Return what a text is by its beginning, if that is known and no EDS; else ""."""
    begin = text[:1000].lstrip(_BLANK)
    return next((meaning for start, meaning in _NOT_CANOPEN if begin.startswith(start)), "")


def _why_none(text: str) -> str:
    if not text:
        return "is empty"
    if "\n" not in text and len(text) < 1000:
        return f"holds only {clip(text)!r}: a symbolic link stored as text? use the file that it names"
    return "has no sections, so it is no EDS"


class _Keys(dict[str, tuple[str, str]]):
    """Keys as written and in lower case, by what stands before the equals sign: a file uses few, thousands of times."""

    def __missing__(self, raw: str) -> tuple[str, str]:
        key = raw.strip()
        if key[:1] in ("[", ";", "#"):
            raise ValueError("no key")
        self[raw] = found = key, key.lower()
        return found


class _Splitter:
    """The sections so far, and what to do at the lines that are no plain ``key=value``."""

    def __init__(self, report: Report) -> None:
        self.report = report
        self.sections: Sections = {}
        self._keys = _Keys()

    def read_section(self, text: str, number: int) -> int:
        """Read what begins behind the bracket of a section in line `number`; return the number of the line after it."""
        head, newline, body = text.partition("\n")
        section = self.open(f"[{head.rstrip()}", number)
        lines = body.split("\n") if newline else []
        if self._read_plain(section, lines):
            section.body, section.lines = body, None
            return number + 1 + len(lines)
        return self.read_lines(section, lines, number + 1)

    def _read_plain(self, section: Section, lines: list[str]) -> bool:
        """Read the lines of a section; return false, with nothing done, where one of them is not plain."""
        keys, values, written, count = self._keys, dict[str, str](), dict[str, str](), 0
        for line in lines:
            raw, equals, value = line.partition("=")
            if equals:
                try:
                    key, lower = keys[raw]
                except ValueError:  # a comment or a section after blanks
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
        """Read lines one by one, from number `first` on; return the number of the line after them."""
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
        """Open a section and return it; of a repeated one nothing is kept."""
        title, closed, rest = line[1:].partition("]")
        title, rest = title.strip(), rest.strip()
        if not closed or (rest and rest[0] not in _COMMENT):
            text = f"section line {clip(line)!r} is malformed; read as [{clip(title)}]"
            self.report.warning(number, "section-form", text)
        section = Section(title.lower(), title, number, lines={})
        first = self.sections.setdefault(section.name, section)
        if first is not section:
            text = f"section [{clip(title)}] is repeated; the one in line {first.line} counts, this one is ignored"
            self.report.warning(number, "section-repeated", text)
        return section

    def stray(self, line: str, number: int) -> None:
        """Report a line that says nothing."""
        text = f"line {clip(line)!r} is not key=value in a section; ignored"
        self.report.warning(number, "stray-line", text)

    def repeated(self, pair: Pair, first: Pair) -> None:
        """Report a key that comes again."""
        lost = "with the same value" if pair.value == first.value else f"with {clip(pair.value)!r}, which is ignored"
        text = f"{clip(pair.key)} is repeated {lost}; line {first.line} counts"
        self.report.warning(pair.line, "key-repeated", text)
