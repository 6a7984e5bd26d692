# ruff: noqa: ANN401 - values of a file, and their target types, are of any type
"""Conversion of YAML nodes to the types declared by a dataclass, with bounds and choices.

A conversion returns the value, or reports an error at the node and returns INVALID; a structure with an invalid part
is invalid too. An integer is accepted for a float, and so is an unquoted `1e3`, which is text in YAML 1.1 and a number
for rcl.

A dataclass is the schema. Field types: bool, int, float, str, enums, Literal, Any, Node, unions, list[X], tuple[X,
...], dict[str | int, X] and other dataclasses; they must be importable at run time. `setting()` declares a field with
another key, bounds and choices; `position()` declares a field for the node of the mapping, for later checks.
"""

from __future__ import annotations

import collections.abc
import dataclasses
import enum
import functools
import math
import re
import types
import typing
from dataclasses import MISSING
from typing import TYPE_CHECKING, Any, Final

from canopen_control.errors import closest, nearest
from canopen_control.yamlfile.node import NOWHERE, Node

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping


_NUMBER: Final = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")
_HEX: Final = re.compile(r"[-+]?0[xX][0-9a-fA-F]+")
_OTHER_BASE: Final = re.compile(r"[-+]?(0+[1-7][0-7]+|[1-9]\d*(:[0-5]?\d)+)")
"""Integers that YAML 1.1 reads in another base: `010` is 8 (also for dcfgen, yaml-cpp and rcl), and `1:30` is 90."""
_WITH_UNIT: Final = re.compile(
    rf"({_NUMBER.pattern})\s*(%|\u00b0|([mu\u00b5nk]?(s|m|g|N|Nm|A|V|W|Hz|rad)|min|h|deg|rpm|rps|turns?|counts?|bits?|[kM]bit)"
    r"(/(s|min|rev)(\^?2|\u00b2)?)?)"
)
_SI_UNIT: Final = re.compile(r"(m|s|rad|N|Nm|A|V|W|Hz)(/s(\^?2|\u00b2)?)?")
_DASHES: Final = str.maketrans(dict.fromkeys("\u2010\u2011\u2012\u2013\u2014\u2212\ufe63\uff0d", "-"))
_Values: typing.TypeAlias = dict[str, Any]  # converted values of a dataclass by field
_KINDS: Final[dict[Any, str]] = {
    bool: "true or false",
    int: "an integer",
    float: "a number",
    str: "text",
    type(None): "nothing",
}


class _Invalid(enum.Enum):
    """Result of a failed conversion whose error was reported; a structure containing it is invalid too."""

    INVALID = 0


INVALID: Final = _Invalid.INVALID


def setting(
    default: Any = MISSING,
    *,
    key: str | None = None,
    low: float | None = None,
    high: float | None = None,
    choices: tuple[Any, ...] | None = None,
    nan: bool = False,
    section: bool = False,
    off: bool = False,
    factory: Any = MISSING,
    hint: str = "",
    help: str = "",  # noqa: A002 - the word of argparse and click
) -> Any:
    """Return a dataclass field; `key` is the key in YAML, `low` and `high` are bounds of numbers.

    `choices` lists the valid values. Bounds and choices apply to the elements of a list, tuple or dict; with `nan`, the
    value nan is within any bounds. A list default is given as `factory=list`. A `section` contains the parameters whose
    dotted names begin with `key`. With `off`, false is read as 0, with a warning. `hint` ends the message about a wrong
    type or choice; `help` is the description of the parameter.
    """
    bounds = (low, high) if (low, high) != (None, None) else None
    metadata = {
        "key": key,
        "range": bounds,
        "choices": choices,
        "nan": nan,
        "section": section,
        "off": off,
        "hint": hint,
        "help": help,
    }
    if factory is not MISSING:
        return dataclasses.field(default_factory=factory, metadata=metadata)
    return dataclasses.field(default=default, metadata=metadata)


def section(key: str, default: Any = MISSING, *, help: str = "") -> Any:  # noqa: A002 - as in `setting`
    """Return a field with the parameters whose dotted names start with `key`: a dataclass like `default`, or a dict."""
    return setting(default, key=key, section=True, factory=dict if default is MISSING else MISSING, help=help)


def position() -> Any:
    """Return a field of type Node that receives the node of the mapping; comparisons ignore the field."""
    return dataclasses.field(default=NOWHERE, compare=False, repr=False, metadata={"here": True})


def part() -> Any:
    """Return a field for a nested dataclass whose keys are in the mapping of its parent."""
    return dataclasses.field(metadata={"part": True})


def derived(default: Any) -> Any:
    """Return a field that is not read from the file, but set by the code that reads it."""
    return dataclasses.field(default=default, metadata={"derived": True})


def convert(node: Node, target: Any, default: Any = INVALID, *, ignored: Collection[str] = ()) -> Any:
    """Convert the node's value to the requested type; on failure, report an error and return `default`.

    `ignored` contains keys without a field that are not reported as unknown.
    """
    value = _dataclass(node, target, ignored) if ignored else _converted(node, target, {})
    return default if value is INVALID else value


@functools.cache  # evaluating the annotations of one class takes milliseconds; a bus has many nodes
def _hints(cls: type[Any]) -> Mapping[str, Any]:
    return typing.get_type_hints(cls)


def fields_of(cls: type[Any]) -> list[tuple[dataclasses.Field[Any], Any]]:
    """Return the fields of a dataclass, each with its type."""
    hints = _hints(cls)  # type: ignore[arg-type]  # as below
    return [(entry, hints[entry.name]) for entry in dataclasses.fields(cls)]


def key_of(entry: dataclasses.Field[Any]) -> str:
    """Return the YAML key from which a field is read."""
    return str(entry.metadata.get("key") or entry.name)


def help_of(cls: type[Any], entry: dataclasses.Field[Any]) -> str:
    """Return the help text of a field, which may be inherited from a base class, or ""."""
    fields = (base.__dict__.get("__dataclass_fields__", {}).get(entry.name) for base in cls.__mro__)
    return next((text for field in fields if field and (text := field.metadata.get("help"))), "")


def keys_of(cls: type[Any]) -> list[str]:
    """Return the YAML keys of a dataclass, including the keys of its parts."""
    hints, keys = _hints(cls), list[str]()  # type: ignore[arg-type]  # a class is hashable, which mypy does not see
    for entry in dataclasses.fields(cls):
        if entry.metadata.get("part"):
            keys += keys_of(hints[entry.name])
        elif not (entry.metadata.get("here") or entry.metadata.get("derived")):
            keys.append(key_of(entry))
    return keys


def _dotted_keys(cls: type[Any]) -> list[str]:
    """Return the keys in the sections of a dataclass, such as `linear.x.max_velocity`."""
    sections = [(key_of(entry), kind) for entry, kind in fields_of(cls) if entry.metadata.get("section")]
    return [
        f"{name}.{key}" for name, kind in sections if hasattr(kind, "__dataclass_fields__") for key in keys_of(kind)
    ]


def _converted(node: Node, target: Any, meta: Mapping[str, Any]) -> Any:
    """Convert the node's value to the requested type, or return INVALID; `meta` is the metadata of the field."""
    origin = typing.get_origin(target)
    if target in (Any, object, Node):
        return node if target is Node else node.value
    if origin in _CONTAINERS:
        return _CONTAINERS[origin](node, target, meta)
    if target in _CONTAINERS:
        return _CONTAINERS[target](node, target, meta)
    if dataclasses.is_dataclass(target) and isinstance(target, type):
        return _dataclass(node, target)
    if isinstance(target, type) and issubclass(target, enum.Enum):
        return _enum(node, target)
    return _plain(node, target, meta)


def _content(node: Node) -> str:
    """Return a description of the node's content, for messages."""
    if node.kind != "scalar":
        return {"mapping": "a mapping", "sequence": f"a list of {len(node.elements())}", "null": "nothing"}[node.kind]
    value = node.value
    name = {bool: "", int: "the integer ", float: "the number ", str: "the text "}.get(type(value), "")
    return f"{name}{node.text!r}" if isinstance(value, str) else f"{name}{node.text}"


def _expected(node: Node, expected: str, hint: str = "") -> Any:
    """Report that the node is not of the expected type; return INVALID."""
    node.error(f"expected {expected}, got {_content(node)}{hint}")
    return INVALID


def _plain(node: Node, target: Any, meta: Mapping[str, Any]) -> Any:
    value = node.value
    if target is float and type(value) is not float:
        value = _as_float(node, value)
    if value is False and target is int and meta.get("off"):
        node.warning("false is read as 0; write 0")
        value = 0
    if type(value) is not target or node.kind in ("mapping", "sequence"):
        expected = meta.get("expected") or _KINDS.get(target, getattr(target, "__name__", str(target)))
        quotes = "; put it in quotes" if target is str and node.kind == "scalar" else ""
        hint = meta.get("hint", "")
        own_hint = _bool_hint(node) if target is bool else ""
        if target in (int, float):  # integers of bus.yml are in ms, us or counts
            own_hint = _number_hint(node, hint, si=target is float)
        return _expected(node, expected, quotes or own_hint or hint)
    if target in (int, float) and node.kind == "scalar" and _OTHER_BASE.fullmatch(node.text):
        base = 60 if ":" in node.text else 8
        node.warning(f"{node.text} is a number of base {base} in YAML, and means {value:g}; write it in base 10 or 16")
    return _bounded(node, value, meta)


def _bool_hint(node: Node) -> str:
    return "; remove the quotes" if node.quoted and node.text.lower() in ("true", "false") else ""


def _number_hint(node: Node, unit_hint: str, *, si: bool) -> str:
    """Return how to write the number that a text seems to mean, or "".

    Copied from a data sheet or a web page, numbers have a decimal comma, a typographic minus or a unit. `unit_hint` is
    the hint of the key, which may name its unit; `si` means that its unit is probably one of the SI, without a prefix.
    """
    text = node.value
    if isinstance(text, float) and text.is_integer() and abs(text) < 1e15:  # where an integer is expected
        return f"; write {text:.0f}"
    if not isinstance(text, str):
        return ""
    text = text.strip()
    if node.quoted and (_NUMBER.fullmatch(text) or _HEX.fullmatch(text)):
        return "; remove the quotes"
    if _NUMBER.fullmatch(plain := text.translate(_DASHES)) and plain != text:
        return f"; its minus is another character, write {plain}"
    if re.fullmatch(r"[-+]?[\d.]+,\d+", plain):
        return "; write a decimal point, and no separator between thousands"
    if _NUMBER.fullmatch(text):  # where an integer is expected
        return f"; write {float(text):.0f}" if abs(float(text)) < 1e15 and float(text).is_integer() else ""
    if unit := _WITH_UNIT.fullmatch(plain):
        if si and _SI_UNIT.fullmatch(unit[4]):
            return f"; write the number without its unit, such as {unit[1]}"
        return unit_hint or "; write the number without a unit, converted to that of this key"
    return ""


def _as_float(node: Node, value: Any) -> Any:
    """Convert an integer or an unquoted text such as `1e3` to a float; return other values unchanged."""
    plain_text = type(value) is str and not node.quoted and _NUMBER.fullmatch(value)
    try:
        return float(value) if type(value) is int or plain_text else value
    except OverflowError:
        return value


def _bounded(node: Node, value: Any, meta: Mapping[str, Any]) -> Any:
    choices, (low, high) = meta.get("choices"), meta.get("range") or (None, None)
    if choices is not None and value not in choices:
        near = nearest(str(value), map(str, choices))
        hint = meta.get("hint", "") or (near if "mean" in near else "")
        node.error(f"{_content(node)} is not one of {', '.join(map(str, choices))}{hint}")
        return INVALID
    numeric = isinstance(value, int | float) and not isinstance(value, bool)
    lowest, highest = -math.inf if low is None else low, math.inf if high is None else high
    unbounded = (low, high) == (None, None) or not numeric or (meta.get("nan") and math.isnan(value))
    if not unbounded and not lowest <= value <= highest:
        node.error(f"{node.text} is out of range {'' if low is None else low}..{'' if high is None else high}")
        return INVALID
    return value


def _enum(node: Node, target: type[enum.Enum]) -> Any:
    """Return the enum member with this value, or with this name in any letter case; report an error if none has."""
    if node.kind == "scalar":
        value = node.value
        for member in target:
            if member.name.casefold() == node.text.casefold() or (type(value) is not bool and member.value == value):
                return member
        node.error(f"no {target.__name__} is called {node.text!r}{nearest(node.text, target.__members__)}")
        return INVALID
    return _expected(node, f"one of {', '.join(target.__members__)}")


def _literal(node: Node, target: Any, _meta: Mapping[str, Any]) -> Any:
    choices, value = typing.get_args(target), node.value
    if any(type(value) is type(choice) and value == choice for choice in choices):
        return value
    return _expected(node, " or ".join(str(choice) for choice in choices))


_FITS: Final = {"mapping": (dict, collections.abc.Mapping), "sequence": (list, tuple, collections.abc.Sequence)}


def _fits(node: Node, target: Any) -> bool:
    """Whether a type in a union accepts this kind of node."""
    if target in (Any, Node):
        return True
    origin = typing.get_origin(target) or target
    shape = "mapping" if dataclasses.is_dataclass(origin) or origin in _FITS["mapping"] else "scalar"
    shape = "sequence" if origin in _FITS["sequence"] else shape
    return shape == node.kind


def _union(node: Node, target: Any, meta: Mapping[str, Any]) -> Any:
    members = typing.get_args(target)
    if node.kind == "null" and type(None) in members:
        return None
    fitting = [member for member in members if member is not type(None) and _fits(node, member)]
    literals = [member for member in fitting if typing.get_origin(member) is typing.Literal]
    if any(node.value in typing.get_args(member) for member in literals):
        return node.value
    fitting = [member for member in fitting if member not in literals]
    same = [member for member in fitting if type(node.value) is member]
    tried = (
        same
        or [member for member in fitting if member not in _KINDS]
        or [member for member in fitting if member is float]
    )
    expected = " or ".join(dict.fromkeys(_shape(member) for member in members))
    if len(fitting) == 1 or tried:
        chosen = (fitting if len(fitting) == 1 else tried)[0]
        return _converted(node, chosen, {**meta, "expected": expected} if literals and chosen in _KINDS else meta)
    return _expected(node, expected)


def _shape(target: Any) -> str:
    """Return the words for a member of a union in a message."""
    if typing.get_origin(target) is typing.Literal:
        return " or ".join(map(str, typing.get_args(target)))
    return _KINDS.get(target, "a list" if _is_list(target) else "a mapping")


def _is_list(target: Any) -> bool:
    return (typing.get_origin(target) or target) in _FITS["sequence"]


def _list(node: Node, target: Any, meta: Mapping[str, Any]) -> Any:
    return _elements(node, (typing.get_args(target) or (Any,))[0], meta)


def _elements(node: Node, of: Any, meta: Mapping[str, Any]) -> Any:
    if node.kind != "sequence":
        return _expected(node, "a list")
    values = [_converted(element, of, meta) for element in node.elements()]
    return INVALID if any(element is INVALID for element in values) else values


def _tuple(node: Node, target: Any, meta: Mapping[str, Any]) -> Any:
    of = typing.get_args(target) or (Any, ...)
    if of[-1] is Ellipsis:
        values = _elements(node, of[0], meta)
        return INVALID if values is INVALID else tuple(values)
    elements = node.elements()
    if node.kind != "sequence" or len(elements) != len(of):
        return _expected(node, f"a list of {len(of)} values")
    values = [_converted(element, kind, meta) for element, kind in zip(elements, of, strict=True)]
    return INVALID if any(element is INVALID for element in values) else tuple(values)


def _dict(node: Node, target: Any, meta: Mapping[str, Any]) -> Any:
    if node.kind not in ("mapping", "null"):
        return _expected(node, "a mapping")
    key_type, of = typing.get_args(target) or (str, Any)
    result: dict[Any, Any] = {}
    bad = False
    for key, value in node.pairs():
        name = key.text if key_type is str else _converted(key, key_type, {})
        converted = INVALID if name is INVALID else _converted(value, of, meta)
        bad = bad or converted is INVALID
        if name in result and name is not INVALID:
            key.problems.deviation(key, f"duplicate key {name!r}, which was written differently before")
        result[name] = converted
    return INVALID if bad else result


_CONTAINERS: Final[dict[Any, Callable[[Node, Any, Mapping[str, Any]], Any]]] = {
    typing.Union: _union,
    types.UnionType: _union,
    typing.Literal: _literal,
    list: _list,
    collections.abc.Sequence: _list,
    tuple: _tuple,
    dict: _dict,
    collections.abc.Mapping: _dict,
}


def _dataclass(node: Node, cls: type[Any], ignored: Collection[str] = ()) -> Any:
    if node.kind not in ("mapping", "null"):
        return _expected(node, "a mapping")
    keys, respelled = keys_of(cls), dict[str, tuple[Node, Node]]()
    for key, value in node.pairs():
        if key.text in keys or key.text in ignored:
            continue
        hint = nearest(key.text, _dotted_keys(cls), listed=False) if "." in key.text else ""
        meant = "" if hint else _meant(key.text, keys)
        hint = f" (did you mean {meant!r}?)" if meant else hint or nearest(key.text, keys)
        key.problems.deviation(key, f"unknown key {key.text!r}{hint}")
        if meant and key.problems.strict and node.get(meant) is None:  # or errors would result from its absence
            respelled[meant] = key, value
    if respelled:
        pairs = {key.text: (key, value) for key, value in node.pairs()}
        place = Node("mapping", node.line, node.column, node.where, node.problems)
        node = Node.mapping(place, pairs | respelled)
    return _fields(node, cls)


def _meant(key: str, keys: Collection[str]) -> str:
    """Return the key that a misspelt or shortened key stands for, such as `sub_index` for `sub`, or ""."""
    longer = [known for known in keys if len(key) > 2 and known.startswith(key)]
    return longer[0] if len(longer) == 1 else closest(key, keys)


def _fields(node: Node, cls: type[Any]) -> Any:
    """Create a dataclass and its parts from a mapping; return INVALID if a field is invalid."""
    hints = _hints(cls)  # type: ignore[arg-type]  # as above
    values: _Values = {}
    for entry in dataclasses.fields(cls):
        if entry.metadata.get("here"):
            values[entry.name] = node
        elif entry.metadata.get("part"):
            values[entry.name] = _fields(node, hints[entry.name])
        elif not entry.metadata.get("derived"):
            _field(node, entry, hints[entry.name], values)
    return INVALID if any(value is INVALID for value in values.values()) else _construct(node, cls, values)


def _field(node: Node, entry: dataclasses.Field[Any], target: Any, values: _Values) -> None:
    """Add the value of a key to `values`, unless the key is absent or null and the field has a default."""
    value = node.get(key_of(entry))
    if value is not None and (value.kind != "null" or _required(entry) or type(None) in typing.get_args(target)):
        values[entry.name] = _converted(value, target, entry.metadata)
    elif _required(entry):
        values[entry.name] = INVALID
        node.error(f"missing key {key_of(entry)!r}")


def _required(entry: dataclasses.Field[Any]) -> bool:
    return entry.default is MISSING and entry.default_factory is MISSING


def _construct(node: Node, cls: type[Any], values: _Values) -> Any:
    """Create the dataclass; report a ValueError of its `__post_init__` as an error in the file."""
    try:
        return cls(**values)
    except ValueError as error:
        node.error(str(error))
        return INVALID
