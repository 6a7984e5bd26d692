"""The lines of an EDS or DCF file as sections of keys (CiA 306-1, 4.2), forgiving what editors do to files.

UTF-8, UTF-16 and Windows-1252; CR, LF and CRLF, also mixed; an end-of-file character of DOS; any case of sections and
keys. Of two sections or keys with one name the first counts, and the second is an issue. Every line is looked at once.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

from canopen_control.errors import EdsError
from canopen_control.od.eds_values import parse_number

if TYPE_CHECKING:
    from collections.abc import Iterator

    from canopen_control.od.issues import Report

__all__ = ["Pair", "Section", "Sections", "clip", "decode_text", "optional_number", "read_number", "split_sections"]

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
    """One section; `pairs` by lower-case key, plain tuples because there are thousands of them."""

    name: str  # lower case
    title: str  # as written
    line: int
    pairs: dict[str, tuple[str, str, int]] = field(default_factory=dict)  # each the fields of a Pair

    def get(self, key: str) -> str:
        """Return the text of a lower-case key, empty where it is absent."""
        pair = self.pairs.get(key)
        return pair[1] if pair is not None else ""

    def pair(self, key: str) -> Pair | None:
        """Return the line of a lower-case key, or None."""
        pair = self.pairs.get(key)
        return Pair(*pair) if pair is not None else None

    def line_of(self, key: str) -> int:
        """Return the line of a key, or the section's where it is absent."""
        pair = self.pairs.get(key)
        return pair[2] if pair is not None else self.line

    def texts(self) -> dict[str, str]:
        """Return the section as written."""
        return {key: value for key, value, _ in self.pairs.values()}

    def numbered(self) -> Iterator[Pair]:
        """Yield the pairs whose key is a number, as in the object lists."""
        return (Pair(*pair) for key, pair in self.pairs.items() if key.isascii() and key.isdigit())


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
    if key not in section.pairs:
        return default
    number = _number(section, key, report, default)
    return default if number is None else number


def optional_number(section: Section, key: str, report: Report) -> int | None:
    """Return the number of a lower-case key, or None; a text that is empty or no number is reported."""
    return _number(section, key, report) if key in section.pairs else None


def _number(section: Section, key: str, report: Report, default: int | None = None) -> int | None:
    written, text, line = section.pairs[key]
    try:
        number, _, issue = parse_number(text)
    except ValueError as problem:
        what = f"{clip(text)} is {problem}" if text else "is empty"
        instead = "absent" if default is None else default
        report.warning(line, "key-number", f"{clip(written)} {what}; taken as {instead}")
        return None
    if issue is not None:
        report.add(line, issue.code, issue.severity, f"{clip(written)}={clip(text)}: {issue.text}")
    return number


def clip(text: str) -> str:
    """Shorten what a file says to what fits a message."""
    return text if len(text) <= 60 else f"{text[:57]}..."


def split_sections(text: str, report: Report) -> Sections:
    """Split the text of a file; EdsError where it holds no section at all."""
    splitter = _Splitter(report)
    pairs: dict[str, tuple[str, str, int]] | None = None  # of the current section
    for number, raw in enumerate(_lines(text), 1):
        line = raw.strip()
        if not line or line[0] in ";#":
            continue
        if line[0] == "[":
            pairs = splitter.open(line, number)
            continue
        key, equals, value = line.partition("=")
        if not equals or pairs is None:
            splitter.stray(line, number)
            continue
        key = key.rstrip()
        pair = (key, value.lstrip(), number)
        first = pairs.setdefault(key.lower(), pair)
        if first is not pair:
            splitter.repeated(Pair(*pair), Pair(*first))
    if not splitter.sections:
        raise EdsError(report.path, 1, _what_else(text.strip(_BLANK)))
    return splitter.sections


def _lines(text: str) -> list[str]:
    """Split at CR, LF and CRLF; the end-of-file character of DOS and padding zeros are blanks."""
    for odd, plain in (("\r\n", "\n"), ("\r", "\n"), ("\x1a", " "), ("\0", " "), ("\ufeff", " ")):
        text = text.replace(odd, plain)
    return text.split("\n")


def _what_else(text: str) -> str:
    if not text:
        return "is empty"
    for start, meaning in _NOT_CANOPEN:
        if text.startswith(start):
            return meaning
    if "\n" not in text and len(text) < 1000:
        return f"holds only {clip(text)!r}: a symbolic link stored as text? use the file that it names"
    return "has no sections, so it is no EDS"


class _Splitter:
    """The sections so far, and what to do at the lines that are no plain ``key=value``."""

    def __init__(self, report: Report) -> None:
        self.report = report
        self.sections: Sections = {}

    def open(self, line: str, number: int) -> dict[str, tuple[str, str, int]]:
        """Open a section and return where its keys go; a repeated one's go nowhere."""
        title, closed, rest = line[1:].partition("]")
        title, rest = title.strip(), rest.strip()
        if not closed or (rest and rest[0] not in ";#"):
            text = f"section line {clip(line)!r} is malformed; read as [{clip(title)}]"
            self.report.warning(number, "section-form", text)
        section = Section(title.lower(), title, number)
        first = self.sections.setdefault(section.name, section)
        if first is not section:
            text = f"section [{clip(title)}] is repeated; the one in line {first.line} counts, this one is ignored"
            self.report.warning(number, "section-repeated", text)
        return section.pairs

    def stray(self, line: str, number: int) -> None:
        """Report a line that says nothing."""
        text = f"line {clip(line)!r} is not key=value in a section; ignored"
        self.report.warning(number, "stray-line", text)

    def repeated(self, pair: Pair, first: Pair) -> None:
        """Report a key that comes again."""
        lost = "with the same value" if pair.value == first.value else f"with {clip(pair.value)!r}, which is ignored"
        text = f"{clip(pair.key)} is repeated {lost}; line {first.line} counts"
        self.report.warning(pair.line, "key-repeated", text)
