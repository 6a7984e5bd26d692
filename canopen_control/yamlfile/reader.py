"""Reader that turns YAML text into frozen dataclasses, or raises one error with all problems and their positions.

Only this module imports `yaml`. Any text gives either a value or the error class of the caller, never another
exception. Nothing is dropped silently: repeated keys, unknown keys and values of another type are reported. Scalars
have the values of YAML 1.1 as resolved by PyYAML (`010` is 8 and `off` is false, as in other tools for the same files),
except that dates remain text; positions count from 1.
"""

from __future__ import annotations

import re
import typing
from pathlib import Path
from typing import TYPE_CHECKING, Final, TypeVar

import yaml

from canopen_control.data_files import foreign_format, read_limited
from canopen_control.errors import BusConfigError
from canopen_control.yamlfile.convert import INVALID, convert
from canopen_control.yamlfile.node import LINE_END, Node, Problems

if TYPE_CHECKING:
    import os
    from collections.abc import Callable, Mapping

    from canopen_control.errors import ConfigError
    from canopen_control.yamlfile.node import Problem


T = TypeVar("T")

MAX_NODES: Final = 100_000
"""Maximum number of nodes when aliases are followed, so that a file that multiplies itself does not fill the memory."""
MAX_DEPTH: Final = 64
MAX_BYTES: Final = 8_000_000
"""Maximum length of a file in bytes: a hundred times the largest file in use, read in seconds."""

_FAST_LOADER: Final = getattr(yaml, "CSafeLoader", None)  # PyYAML may be built without libyaml
#: Texts that libyaml accepts and PyYAML's own parser does not, or for which it reports other places: control characters
#: and Unicode line ends, `?`, `!` and `%` outside of comments, a key of a flow mapping without a value.
_NOT_ALIKE: Final = re.compile(r"[\x00-\x09\x0b-\x1f\x7f-\xa0\u2028\u2029\ufeff]|^[^#\n]*[?!%]|:\s*[],}]", re.MULTILINE)

_TAG: Final = "tag:yaml.org,2002:"
_MERGE: Final = _TAG + "merge"
_CONSTRUCTOR: Final = yaml.constructor.SafeConstructor()
_CONSTRUCTORS: Final[Mapping[str, Callable[[yaml.ScalarNode], object]]] = {
    _TAG + "bool": _CONSTRUCTOR.construct_yaml_bool,
    _TAG + "int": _CONSTRUCTOR.construct_yaml_int,
    _TAG + "float": _CONSTRUCTOR.construct_yaml_float,
}


def _value(node: yaml.ScalarNode) -> object:
    """Return the value of a scalar; a scalar that does not match its tag remains text."""
    if node.tag == _TAG + "null":
        return None
    make = _CONSTRUCTORS.get(node.tag)
    try:
        return make(node) if make else node.value
    except (ValueError, KeyError, OverflowError, IndexError):  # `!!int "x"`, `0x_`, ten thousand digits
        return node.value


def _place(node: yaml.Node, place: str, problems: Problems) -> Node:
    kind = "null" if node.tag == _TAG + "null" else "scalar"
    if isinstance(node, yaml.CollectionNode):
        kind = "mapping" if isinstance(node, yaml.MappingNode) else "sequence"
    return Node(kind, node.start_mark.line + 1, node.start_mark.column + 1, place, problems)


def _build(node: yaml.Node, dotted: str, problems: Problems) -> Node:
    """Convert a PyYAML node, with all its children, to a `Node`."""
    place = _place(node, dotted, problems)
    if isinstance(node, yaml.ScalarNode):
        return Node.scalar(place, node.value, _value(node), quoted=bool(node.style))
    if isinstance(node, yaml.SequenceNode):
        return Node.sequence(place, [_build(item, f"{dotted}[{at}]", problems) for at, item in enumerate(node.value)])
    raw: dict[str, list[tuple[yaml.Node, yaml.Node]]] = {}
    _flatten(node, raw)
    pairs: dict[str, tuple[Node, Node]] = {}
    for name, repeated in raw.items():
        below = f"{dotted}.{name}" if dotted else name
        for key, value in repeated if problems.strict else repeated[-1:]:
            built = _build(value, below, problems)
            if name in pairs:  # reported: both mappings are read, so that nothing is missing in addition
                built = built.merged_over(pairs[name][1])
            pairs[name] = (_build(key, below, problems), built)
    return Node.mapping(place, pairs)


def _flatten(node: yaml.Node, entries: dict[str, list[tuple[yaml.Node, yaml.Node]]]) -> None:
    """Add the pairs of a mapping by key: own keys first, then new keys from merge keys (YAML 1.1).

    A repeated key has several pairs.
    """
    merged: list[yaml.Node] = []
    pairs: dict[str, list[tuple[yaml.Node, yaml.Node]]] = {}
    for key, value in node.value:
        if key.tag == _MERGE:
            merged += value.value if isinstance(value, yaml.SequenceNode) else [value]
        elif isinstance(key, yaml.ScalarNode):
            pairs.setdefault(key.value, []).append((key, value))
    for name, repeated in pairs.items():
        entries.setdefault(name, repeated)
    for mapping in merged:
        if isinstance(mapping, yaml.MappingNode):
            _flatten(mapping, entries)


class _Walk:
    """Check of all nodes for invalid keys and endless aliases, before aliases are followed."""

    def __init__(self, problems: Problems) -> None:
        self._problems = problems
        self._sizes: dict[int, tuple[int, int]] = {}
        self._open: set[int] = set()
        self.endless = False

    def measure(self, node: yaml.Node, place: str = "") -> tuple[int, int]:
        """Return the number and depth of the nodes in a tree, following aliases; report invalid keys and loops."""
        if id(node) in self._open:
            _place(node, place, self._problems).error("an alias refers to its own anchor")
            self.endless = True
            return 1, 1
        if id(node) not in self._sizes:
            self._open.add(id(node))
            below = [self.measure(child, name) for child, name in self._children(node, place)]
            self._open.discard(id(node))
            self._sizes[id(node)] = 1 + sum(size for size, _ in below), 1 + max((deep for _, deep in below), default=0)
        return self._sizes[id(node)]

    def _children(self, node: yaml.Node, where: str) -> list[tuple[yaml.Node, str]]:
        if isinstance(node, yaml.SequenceNode):
            return [(element, f"{where}[{number}]") for number, element in enumerate(node.value)]
        if isinstance(node, yaml.ScalarNode):
            return []
        dotted = f"{where}." if where else ""
        self._check_keys(node, dotted)
        return [
            (value, f"{dotted}{key.value if isinstance(key, yaml.ScalarNode) else '?'}") for key, value in node.value
        ]

    def _check_keys(self, node: yaml.Node, dotted: str) -> None:
        first: dict[str, int] = {}
        for key, value in node.value:
            where = f"{dotted}{key.value if isinstance(key, yaml.ScalarNode) else '?'}"
            here = _place(key, where, self._problems)
            if not isinstance(key, yaml.ScalarNode):
                here.error("a key must be a single word")
            elif key.tag == _MERGE:
                _check_merge(here, value)
            elif key.value in first:
                text = f"duplicate key {key.value!r} (first at line {first[key.value]}); rename or remove one"
                self._problems.deviation(here, text)
                self._problems.repeated.append(self._problems.at(here.line, here.column, where, text))
            else:
                first[key.value] = here.line


def _check_merge(here: Node, value: yaml.Node) -> None:
    elements = value.value if isinstance(value, yaml.SequenceNode) else [value]
    if not all(isinstance(element, yaml.MappingNode) for element in elements):
        here.error("<< merges only mappings; give an alias of a mapping, or a list of aliases")


def _root(text: str) -> yaml.Node | None:
    """Return the root node, parsed by libyaml if the text is safe for it, otherwise by PyYAML."""
    if _FAST_LOADER is not None and text.endswith("\n") and not _NOT_ALIKE.search(text):
        try:
            return yaml.compose(text, Loader=_FAST_LOADER)
        except (yaml.YAMLError, ValueError):
            pass  # message and position differ from those of PyYAML, which are used below
    return yaml.compose(text, Loader=yaml.SafeLoader)


#: texts of PyYAML's errors -> what to do; its words are those of the grammar
_HINTS: Final = {
    "mapping values are not allowed here": "indent it like its neighbours; put a text with a colon in quotes",
    r"found character '\\t'": "indent with spaces instead of tabs",
    "found character '[@`%]'": "put a text that begins with this character in quotes",
    "expected (<block end>|'<document start>'), but found": "indent it like its neighbours",
    "sequence entries are not allowed here": "begin a list in a new line",
    "could not find expected ':'": "a key ends with a colon and a space; put a text of several lines in quotes",
    "found undefined alias": "put a text that begins with * in quotes",
    "found unexpected end of stream": "close the quotes",
    "but found another document": "remove the line ---, or the second part of the file",
    r"expected ',' or '[\]}]'": "separate the entries with commas, and close the bracket",
}
#: Lines that git writes around two versions of some lines that it could not merge
_CONFLICT: Final = re.compile(r"^<{7} \S.*$", re.MULTILINE)


def _report_conflicts(problems: Problems, text: str) -> bool:
    """Report unresolved merge conflicts, one for each; return whether there are any."""
    places = [text.count("\n", 0, match.start()) + 1 for match in _CONFLICT.finditer(text)]
    for line in places:
        problems.file_error(line, 1, "a merge conflict: keep one of the versions, and remove the lines with <, = and >")
    return bool(places)


def _compose(problems: Problems, text: str) -> yaml.Node | None:
    """Return PyYAML's root node, or None if the text is empty or an error was reported."""
    if _report_conflicts(problems, text):
        return None
    try:
        root = _root(text)
        return None if root is None else _checked(problems, root)
    except yaml.MarkedYAMLError as error:
        mark, start = error.problem_mark or error.context_mark, error.context_mark
        context = f" ({error.context} at line {start.line + 1})" if error.context and start else ""
        line, column = (mark.line + 1, mark.column + 1) if mark else (0, 0)
        problem = error.problem or "invalid YAML"
        hint = next((f"; {hint}" for pattern, hint in _HINTS.items() if re.match(pattern, problem)), "")
        problems.file_error(line, column, f"{problem}{context}{hint}")
    except yaml.reader.ReaderError as error:
        before = LINE_END.split(text[: error.position])
        code = ord(text[error.position])
        problems.file_error(len(before), len(before[-1]) + 1, f"the character U+{code:04X} is not allowed")
    except (yaml.YAMLError, ValueError, OverflowError, IndexError) as error:
        problems.file_error(0, 0, f"invalid YAML: {error}")
    except RecursionError:
        problems.file_error(1, 1, f"nested too deeply, more than {MAX_DEPTH} levels")
    return None


def _checked(problems: Problems, root: yaml.Node) -> yaml.Node | None:
    """Return the root; if its number of nodes or its depth is too large, report an error and return None."""
    walk = _Walk(problems)
    size, depth = walk.measure(root)
    if size > MAX_NODES:
        problems.file_error(1, 1, f"its aliases expand to {size} values; the maximum is {MAX_NODES}")
    if depth > MAX_DEPTH:
        problems.file_error(1, 1, f"nested too deeply, more than {MAX_DEPTH} levels")
    return None if walk.endless or size > MAX_NODES or depth > MAX_DEPTH else root


def parse(
    text: str,
    cls: type[T],
    path: str = "<text>",
    *,
    error: type[ConfigError] = BusConfigError,
    check: Callable[[T, Problems], None] | None = None,
    warnings: list[Problem] | None = None,
    strict: bool = True,
) -> T:
    """Parse the text as `cls`; raise `error` with all problems if it is invalid.

    `check` receives the value and may add errors that concern several fields; `warnings` receives the warnings. If
    `strict` is False, repeated keys (the last one counts) and unknown keys are warnings.
    """
    root = read(text, path, error=error, strict=strict)
    value = convert(root, cls)
    if value is not INVALID and check is not None:
        check(value, root.problems)
    if warnings is not None:
        warnings += root.problems.warnings
    root.problems.raise_if_any(error)
    return typing.cast("T", value)


def load(
    path: str | os.PathLike[str],
    cls: type[T],
    *,
    error: type[ConfigError] = BusConfigError,
    check: Callable[[T, Problems], None] | None = None,
    warnings: list[Problem] | None = None,
    strict: bool = True,
) -> T:
    """Read and parse a file as `cls`, like `parse`; an unreadable file raises `error` too."""
    text = read_text(path, error)
    return parse(text, cls, str(path), error=error, check=check, warnings=warnings, strict=strict)


def tree(path: str | os.PathLike[str], *, error: type[ConfigError] = BusConfigError, strict: bool = True) -> Node:
    """Return the root node of a file; the caller must call `node.problems.raise_if_any(error)` at the end.

    A file that is not valid YAML raises `error` at once.
    """
    return read(read_text(path, error), str(path), error=error, strict=strict)


def read(text: str, path: str = "<text>", *, error: type[ConfigError] = BusConfigError, strict: bool = True) -> Node:
    """Return the root node of a text, like `tree` for a file; an empty text is an empty mapping."""
    text = text.removeprefix("\ufeff")
    problems = Problems(path, text, strict=strict)
    node = _compose(problems, text)
    if node is None:
        problems.raise_if_any(error)
        return Node("mapping", 1, 1, "", problems)
    return _build(node, "", problems)


def read_text(path: str | os.PathLike[str], error: type[ConfigError] = BusConfigError) -> str:
    """Return the text of a UTF-8 file; raise `error` if it cannot be read or has another format."""
    problems = Problems(str(path))
    try:
        data = read_limited(Path(path), MAX_BYTES)
        if foreign := foreign_format(data):
            problems.file_error(0, 0, f"is {foreign}")
        problems.raise_if_any(error)
        return data.decode("utf-8")
    except OSError as reason:
        problems.file_error(0, 0, f"cannot be read: {reason.strerror or reason}")
    except UnicodeDecodeError as reason:
        line = reason.object.count(b"\n", 0, reason.start) + 1
        problems.file_error(line, 1, f"byte 0x{reason.object[reason.start]:02X} is not UTF-8; save the file as UTF-8")
    except ValueError as reason:  # too large, missing, or a path with a zero byte
        problems.file_error(0, 0, f"cannot be read: {reason}")
    problems.raise_if_any(error)
    return ""
