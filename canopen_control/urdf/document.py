"""XML elements with their places, and the mistakes found at them.

A number that is none, or a name that is missing, is a mistake with its place and a default that
lets the reading go on, so that all of them are told at once. Lines and columns count from 1.
"""

from __future__ import annotations

import math
import re
import xml.parsers.expat
from typing import TYPE_CHECKING, NamedTuple, Protocol, TypeVar

from canopen_control.errors import RobotConfigError

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping


T = TypeVar("T")


class ElementPlace(NamedTuple):
    """Where something begins in the file."""

    line: int
    column: int


NOWHERE = ElementPlace(0, 0)


class Placed(Protocol):
    """What has a place in the file: an element, or what was read of one."""

    @property
    def place(self) -> ElementPlace:
        """Where it begins."""


class Element:
    """An XML element: its tag, attributes, children, the text directly in it without outer blanks, and its place."""

    __slots__ = ("attributes", "children", "place", "tag", "text")

    def __init__(self, tag: str, attributes: dict[str, str], place: ElementPlace) -> None:
        self.tag, self.attributes, self.place = tag, attributes, place
        self.children: list[Element] = []
        self.text = ""

    def child(self, tag: str) -> Element | None:
        """Return the first child of a tag."""
        return next((each for each in self.children if each.tag == tag), None)

    def parameters(self) -> dict[str, str]:
        """Return the `<param name=...>text</param>` children."""
        return {each.attributes.get("name", ""): each.text for each in self.children if each.tag == "param"}


class UrdfDocument:
    """A description's elements, and the collector of its mistakes."""

    def __init__(self, root: Element, path: str) -> None:
        self.root, self._path = root, path
        self._problems: dict[tuple[ElementPlace, str], None] = {}

    def error(self, where: Placed, message: str) -> None:
        """Add a mistake at an element, or at what was read of one."""
        self._problems[where.place, message] = None

    def raise_if_any(self) -> None:
        """Raise RobotConfigError with every mistake, if there is one."""
        if self._problems:
            found = sorted(self._problems)
            raise RobotConfigError("\n".join(f"{self._path}:{p.line}:{p.column}: {message}" for p, message in found))

    def name(self, element: Element) -> str:
        """Return the name of an element, which it must have."""
        if not element.attributes.get("name"):
            self.error(element, f"<{element.tag}> has no name")
        return element.attributes.get("name", "")

    def by_name(self, found: Iterable[tuple[Element, T]]) -> dict[str, T]:
        """Return what was read of elements by their names, no two of which may be the same."""
        firsts: dict[str, Element] = {}
        kept: dict[str, T] = {}
        for element, read in found:
            name = element.attributes.get("name", "")
            first = firsts.setdefault(name, element)
            if first is element:
                kept[name] = read
            elif name:
                self.error(element, f"{element.tag} {name!r} stands twice, {self._where_first(first, element)}")
        return kept

    def _where_first(self, first: Element, second: Element) -> str:
        if first.place == second.place:  # as far as can be seen in a xacro file
            return "both are made here: call the macro with another name"
        return f"first at {self._path}:{first.place.line}:{first.place.column}; rename one"

    def number(self, element: Element, attribute: str, default: float) -> float:
        """Return a number attribute; infinity and nan are none."""
        return self.decimal(element, element.attributes, attribute, default)

    def decimal(self, element: Element, values: Mapping[str, str], key: str, default: float) -> float:
        """Return a number of a mapping that belongs to an element."""
        text = values.get(key)
        if text is None:
            return default
        number = finite_number(text)
        if number is None:
            self.error(element, f"{key}={text!r} of <{element.tag}> is no number")
        return default if number is None else number

    def vector(
        self, element: Element | None, attribute: str, default: tuple[float, float, float]
    ) -> tuple[float, float, float]:
        """Return three numbers of an attribute."""
        if element is None or attribute not in element.attributes:
            return default
        numbers = [finite_number(each) for each in element.attributes[attribute].split()]
        if len(numbers) != 3 or None in numbers:
            text = element.attributes[attribute]
            self.error(element, f"{attribute}={text!r} of <{element.tag}> is no three numbers")
            return default
        x, y, z = (each or 0.0 for each in numbers)
        return x, y, z


def finite_number(text: str) -> float | None:
    """Return the number that a text holds, None where it holds none or one that is not finite."""
    try:
        number = float(text)
    except ValueError:
        return None
    return number if math.isfinite(number) else None


class _Builder:
    """Makes elements from expat's calls; the parser itself is the C one and knows its line."""

    def __init__(self, source: _XacroLines | None) -> None:
        self._parser = xml.parsers.expat.ParserCreate()
        self._parser.StartElementHandler = self._start
        self._parser.EndElementHandler = self._end
        self._parser.CharacterDataHandler = self._text
        self._source = source
        self._open: list[Element] = []
        self.root: Element | None = None

    def read(self, text: str) -> None:
        """Parse the whole text; raises ExpatError."""
        self._parser.Parse(text, True)  # expat takes it by position: this is the last piece

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        element = Element(tag, attributes, self._place(tag, attributes))
        if self._open:
            self._open[-1].children.append(element)
        elif self.root is None:
            self.root = element
        self._open.append(element)

    def _end(self, _tag: str) -> None:
        element = self._open.pop()
        element.text = element.text.strip()

    def _text(self, text: str) -> None:
        if self._open:
            self._open[-1].text += text

    def _place(self, tag: str, attributes: dict[str, str]) -> ElementPlace:
        if self._source is not None:
            return self._source.place(tag, attributes.get("name", ""))
        return ElementPlace(self._parser.CurrentLineNumber, self._parser.CurrentColumnNumber + 1)


class _XacroLines:
    """Guesses where in a xacro file an element of its result comes from; `${...}` in a name fits anything."""

    def __init__(self, source: str) -> None:
        self._places: list[tuple[str, str, ElementPlace]] = []
        self._seen: dict[tuple[str, str], int] = {}
        for found in _OPENING.finditer(source):
            begin = found.start()
            place = ElementPlace(source.count("\n", 0, begin) + 1, begin - source.rfind("\n", 0, begin))
            self._places.append((found[1], found[2], place))

    def place(self, tag: str, name: str) -> ElementPlace:
        """Return the place of the next element of this tag and name, the beginning if nothing fits."""
        seen = self._seen.get((tag, name), 0)
        self._seen[tag, name] = seen + 1
        places = [place for its_tag, its_name, place in self._places if its_tag == tag and its_name == name]
        if not places:
            places = [place for its_tag, its_name, place in self._places if its_tag == tag and _fits(its_name, name)]
        return places[min(seen, len(places) - 1)] if places else ElementPlace(1, 1)


_OPENING = re.compile(r"<([\w:.-]+)\b[^<>]*?\bname=[\"']([^\"']*)[\"']")
_EXPRESSION = re.compile(r"\$\{[^}]*\}|\$\([^)]*\)")


def _fits(written: str, name: str) -> bool:
    pattern = ".*".join(re.escape(part) for part in _EXPRESSION.split(written))
    return re.fullmatch(pattern, name) is not None


def read_document(text: str, path: str, source: str | None = None) -> UrdfDocument:
    """Return the elements of an XML text, or raise RobotConfigError with the place where it is none.

    `source` is the xacro text that it was made of: lines are sought in it.
    """
    builder = _Builder(None if source is None else _XacroLines(source))
    try:
        builder.read(text)
    except xml.parsers.expat.ExpatError as error:
        reason = xml.parsers.expat.ErrorString(error.code)
        raise RobotConfigError(f"{path}:{error.lineno}:{error.offset + 1}: no XML: {reason}") from error
    except ValueError as error:  # a surrogate or another character that no encoding has
        raise RobotConfigError(f"{path}: no XML: {error}") from error
    if builder.root is None:
        raise RobotConfigError(f"{path}: no XML: there is no element in it")
    return UrdfDocument(builder.root, path)
