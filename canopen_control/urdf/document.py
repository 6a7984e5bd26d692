"""XML elements with their positions in the file, and a collection of errors at these positions.

An invalid number or a missing name is recorded with its position and replaced by a default, so that all errors are
reported at once. Lines and columns count from 1.
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
    """Position of the start of an element in the file; line and column count from 1."""

    line: int
    column: int


NOWHERE = ElementPlace(0, 0)


class Placed(Protocol):
    """Object with a position in the file: an element, or an object created from one."""

    @property
    def place(self) -> ElementPlace:
        """Position of the start of the element."""


class Element:
    """XML element with its position; `text` is the stripped text directly inside the element."""

    __slots__ = ("attributes", "children", "place", "tag", "text")

    def __init__(self, tag: str, attributes: dict[str, str], place: ElementPlace) -> None:
        self.tag, self.attributes, self.place = tag, attributes, place
        self.children: list[Element] = []
        self.text = ""

    def child(self, tag: str) -> Element | None:
        """Return the first child with the tag `tag`, or None."""
        return next((child for child in self.children if child.tag == tag), None)

    def parameters(self) -> dict[str, str]:
        """Return the texts of the `<param name=...>` children, by name."""
        return {child.attributes.get("name", ""): child.text for child in self.children if child.tag == "param"}


class UrdfDocument:
    """Root element of a description, with methods that convert values and collect errors."""

    def __init__(self, root: Element, path: str) -> None:
        self.root, self._path = root, path
        self._problems: dict[tuple[ElementPlace, str], None] = {}
        self.notes: list[str] = []

    def error(self, element: Placed, message: str) -> None:
        """Record an error at the position of an element, or of an object created from an element."""
        self._problems[element.place, message] = None

    def note(self, element: Placed, message: str) -> None:
        """Add a note about an element that is valid but may be a mistake."""
        self.notes.append(f"{self._path}:{element.place.line}: {message}")

    def raise_if_any(self) -> None:
        """Raise RobotConfigError with all recorded errors, if any."""
        if self._problems:
            problems = sorted(self._problems)
            raise RobotConfigError("\n".join(f"{self._path}:{p.line}:{p.column}: {message}" for p, message in problems))

    def name(self, element: Element) -> str:
        """Return the name of an element; if it is missing, record an error and return ""."""
        if not element.attributes.get("name"):
            self.error(element, f"<{element.tag}> has no name")
        return element.attributes.get("name", "")

    def by_name(self, pairs: Iterable[tuple[Element, T]]) -> dict[str, T]:
        """Return the objects by the names of their elements; record an error for a duplicate name."""
        firsts: dict[str, Element] = {}
        named: dict[str, T] = {}
        for element, read in pairs:
            name = element.attributes.get("name", "")
            first = firsts.setdefault(name, element)
            if first is element:
                named[name] = read
            elif name:
                self.error(element, f"{element.tag} {name!r} is defined twice, {self._where_first(first, element)}")
        return named

    def _where_first(self, first: Element, second: Element) -> str:
        if first.place == second.place:  # compared as far as the line in a xacro file can be determined
            return "both are created here; call the macro with another name"
        return f"first at {self._path}:{first.place.line}:{first.place.column}; rename one"

    def number(self, element: Element, attribute: str, default: float) -> float:
        """Return the number in an attribute, or the default; record an error if the text is not a finite number."""
        return self.decimal(element, element.attributes, attribute, default)

    def decimal(self, element: Element, values: Mapping[str, str], key: str, default: float) -> float:
        """Return the number under `key` in a mapping that belongs to an element, or the default, like `number`."""
        text = values.get(key)
        if text is None:
            return default
        number = finite_number(text)
        if number is None:
            self.error(element, f"{key}={text!r} of <{element.tag}> is not a number")
        return default if number is None else number

    def vector(
        self, element: Element | None, attribute: str, default: tuple[float, float, float]
    ) -> tuple[float, float, float]:
        """Return the three numbers in an attribute, or the default; record an error for any other text."""
        if element is None or attribute not in element.attributes:
            return default
        numbers = [finite_number(word) for word in element.attributes[attribute].split()]
        if len(numbers) != 3 or None in numbers:
            text = element.attributes[attribute]
            self.error(element, f"{attribute}={text!r} of <{element.tag}> is not three numbers")
            return default
        x, y, z = (word or 0.0 for word in numbers)
        return x, y, z


def finite_number(text: str) -> float | None:
    """Return the number in a text, or None if the text is not a finite number."""
    try:
        number = float(text)
    except ValueError:
        return None
    return number if math.isfinite(number) else None


class _Builder:
    """Builder of a tree of elements with positions, from the callbacks of the expat parser."""

    def __init__(self, source: _XacroLines | None) -> None:
        self._parser = xml.parsers.expat.ParserCreate()
        self._parser.StartElementHandler = self._start
        self._parser.EndElementHandler = self._end
        self._parser.CharacterDataHandler = self._text
        self._source = source
        self._open: list[Element] = []
        self.root: Element | None = None

    def read(self, text: str) -> None:
        """Parse the whole text; raise ExpatError if it is not valid XML."""
        self._parser.Parse(text, True)  # positional in expat: this is the last piece

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
    """Estimator of the position in a xacro file from which an element of the result was generated.

    An expression `${...}` or `$(...)` in a name in the xacro file matches any text.
    """

    def __init__(self, source: str) -> None:
        self._places: list[tuple[str, str, ElementPlace]] = []
        self._lines: dict[tuple[str, str], int] = {}
        for match in _OPENING.finditer(source):
            begin = match.start()
            place = ElementPlace(source.count("\n", 0, begin) + 1, begin - source.rfind("\n", 0, begin))
            self._places.append((match[1], match[2], place))

    def place(self, tag: str, name: str) -> ElementPlace:
        """Return the position of the next element with this tag and name, or the start of the file if there is none."""
        count = self._lines.get((tag, name), 0)
        self._lines[tag, name] = count + 1
        places = [place for its_tag, its_name, place in self._places if its_tag == tag and its_name == name]
        if not places:
            places = [place for its_tag, its_name, place in self._places if its_tag == tag and _fits(its_name, name)]
        return places[min(count, len(places) - 1)] if places else ElementPlace(1, 1)


_OPENING = re.compile(r"<([\w:.-]+)\b[^<>]*?\bname=[\"']([^\"']*)[\"']")
_EXPRESSION = re.compile(r"\$\{[^}]*\}|\$\([^)]*\)")


def _fits(written: str, name: str) -> bool:
    pattern = ".*".join(re.escape(part) for part in _EXPRESSION.split(written))
    return re.fullmatch(pattern, name) is not None


def read_document(text: str, path: str, source: str | None = None) -> UrdfDocument:
    """Parse an XML text to elements; raise RobotConfigError with the position if it is not valid XML.

    `source` is the xacro text from which the XML was generated; positions refer to it.
    """
    builder = _Builder(None if source is None else _XacroLines(source))
    try:
        builder.read(text)
    except xml.parsers.expat.ExpatError as error:
        reason = xml.parsers.expat.ErrorString(error.code)
        raise RobotConfigError(f"{path}:{error.lineno}:{error.offset + 1}: not valid XML: {reason}") from error
    except ValueError as error:  # a surrogate or another character without an encoding
        raise RobotConfigError(f"{path}: not valid XML: {error}") from error
    if builder.root is None:
        raise RobotConfigError(f"{path}: not valid XML: the file has no element")
    return UrdfDocument(builder.root, path)
