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

_BLANK = " \t\f\v\x00\x1a\ufeff\xa0"
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
    """One section; `pairs` by lower-case key."""

    name: str  # lower case
    title: str  # as written
    line: int
    pairs: dict[str, Pair] = field(default_factory=dict)

    def get(self, key: str) -> str:
        """Return the text of a lower-case key, empty where it is absent."""
        pair = self.pairs.get(key)
        return pair.value if pair is not None else ""

    def line_of(self, key: str) -> int:
        """Return the line of a key, or the section's where it is absent."""
        pair = self.pairs.get(key)
        return pair.line if pair is not None else self.line

    def texts(self) -> dict[str, str]:
        """Return the section as written."""
        return {pair.key: pair.value for pair in self.pairs.values()}

    def numbered(self) -> Iterator[Pair]:
        """Yield the pairs whose key is a number, as in the object lists."""
        return (pair for key, pair in self.pairs.items() if key.isascii() and key.isdigit())


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
    number = _number(section.pairs[key], f"taken as {default}", report)
    return default if number is None else number


def optional_number(section: Section, key: str, report: Report) -> int | None:
    """Return the number of a lower-case key, or None; a text that is empty or no number is reported."""
    return _number(section.pairs[key], "taken as absent", report) if key in section.pairs else None


def _number(pair: Pair, instead: str, report: Report) -> int | None:
    try:
        number, doubt = parse_number(pair.value)
    except ValueError as problem:
        what = f"{clip(pair.value)} is {problem}" if pair.value else "is empty"
        report.warning(pair.line, "key-number", f"{pair.key} {what}; {instead}")
        return None
    if doubt is not None:
        report.add(pair.line, doubt.code, doubt.severity, f"{pair.key}={clip(pair.value)}: {doubt.text}")
    return number


def clip(text: str) -> str:
    """Shorten what a file says to what fits a message."""
    return text if len(text) <= 60 else f"{text[:57]}..."


def split_sections(text: str, report: Report) -> Sections:
    """Split the text of a file; EdsError where it holds no section at all."""
    splitter = _Splitter(report)
    for number, raw in enumerate(text.replace("\r\n", "\n").replace("\r", "\n").split("\n"), 1):
        line = raw.strip(_BLANK)
        if line and line[0] not in ";#":
            splitter.take(line, number)
    if not splitter.sections:
        raise EdsError(report.path, 1, _what_else(text.lstrip(_BLANK + "\r\n")))
    return splitter.sections


def _what_else(text: str) -> str:
    if not text:
        return "is empty"
    for start, meaning in _NOT_CANOPEN:
        if text.startswith(start):
            return meaning
    if "\n" not in text.strip() and len(text) < 1000:
        return f"holds only {text.strip()[:60]!r}: a symbolic link stored as text? use the file that it names"
    return "has no sections, so it is no EDS"


class _Splitter:
    """Sections so far; `current` takes the keys and may be a repeated one that is not kept."""

    def __init__(self, report: Report) -> None:
        self.report = report
        self.sections: Sections = {}
        self.current: Section | None = None

    def take(self, line: str, number: int) -> None:
        """Take one line that is neither blank nor a comment."""
        if line[0] == "[":
            self._open(line, number)
            return
        key, equals, value = line.partition("=")
        if not equals or self.current is None:
            self.report.warning(number, "stray-line", f"line {clip(line)!r} is neither section nor key=value; ignored")
            return
        key, value = key.rstrip(_BLANK), value.lstrip(_BLANK)
        pairs, folded = self.current.pairs, key.lower()
        if folded in pairs:
            self.report.warning(number, "key-repeated", self._repeated(key, value, pairs[folded]))
        else:
            pairs[folded] = Pair(key, value, number)

    def _open(self, line: str, number: int) -> None:
        title, closed, rest = line[1:].partition("]")
        title = title.strip(_BLANK)
        if not closed or (rest.strip(_BLANK) and rest.strip(_BLANK)[0] not in ";#"):
            self.report.warning(
                number, "section-form", f"section line {clip(line)!r} is malformed; read as [{clip(title)}]"
            )
        self.current = Section(title.lower(), title, number)
        first = self.sections.setdefault(self.current.name, self.current)
        if first is not self.current:
            text = f"section [{clip(title)}] is repeated; the one in line {first.line} counts, this one is ignored"
            self.report.warning(number, "section-repeated", text)

    @staticmethod
    def _repeated(key: str, value: str, first: Pair) -> str:
        lost = "with the same value" if value == first.value else f"with {clip(value)!r}, which is ignored"
        return f"{clip(key)} is repeated {lost}; line {first.line} counts"
