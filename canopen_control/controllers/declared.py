"""Parameters that a controller declares, derived from its dataclass for the parameter services of ROS 2.

Name, type, default, bounds and choices are those of the dataclass, see `yamlfile.convert`; the description is its help
text. The class attribute `settable` lists the parameters that may be set after configuration; the others are read-only,
as most parameters are upstream.
"""

from __future__ import annotations

import enum
import types
import typing
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from canopen_control.errors import ControlError, nearest
from canopen_control.rpc.messages.parameters import SCALARS, ParameterReading, plain_value
from canopen_control.yamlfile.convert import fields_of, help_of, key_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from canopen_control.controllers.params import Params
    from canopen_control.rpc.messages.parameters import ParameterValue, PlainValue


_HIDDEN: Final = frozenset({"type"})  # the manager's parameter of a controller
_NO_METADATA: Final[Mapping[str, Any]] = types.MappingProxyType({})


def declared_by(params: object, settable: Iterable[str] = (), **effective: PlainValue) -> tuple[ParameterReading, ...]:
    """Return the parameters of a dataclass, sorted by name; names that match a `settable` pattern are writable.

    `effective` are values that differ from the file, such as an `update_rate` that the manager determines.
    """
    patterns = tuple(settable)
    rows = sorted(_rows(params, ""), key=lambda row: row.name)
    return tuple(_reading(row, effective.get(row.name, row.value), patterns) for row in rows if row.name not in _HIDDEN)


def _reading(row: _Row, value: object, patterns: Iterable[str]) -> ParameterReading:
    name, metadata = row.name, row.metadata
    kind, (low, high) = _kind(row.value_type, value), metadata.get("range") or (None, None)
    plain = value.value if isinstance(value, enum.Enum) else value
    return ParameterReading(
        name=name,
        kind=kind,
        value=plain_value([plain] if kind.endswith("_array") and isinstance(plain, str) else plain),
        read_only=not any(fnmatchcase(name, pattern) for pattern in patterns),
        low=low,
        high=high,
        choices=tuple(map(str, metadata.get("choices") or ())),
        text=row.help,
    )


def given_in(params: Params) -> tuple[ParameterReading, ...]:
    """Return the parameters that the file gives to a controller that is not yet configured; they are read-only."""
    values = {key.text: value.value for key, value in params.flat.pairs()}
    return tuple(
        ParameterReading(name=name, kind=_kind_of(value), value=plain_value(value), read_only=True)
        for name, value in sorted(values.items())
        if name not in _HIDDEN
    )


def checked(
    owner: str, declared: Sequence[ParameterReading], parameters: Sequence[ParameterValue]
) -> dict[str, PlainValue]:
    """Return the values to set, by parameter name; raise ControlError, worded as by rclcpp, if one is invalid."""
    rows = {reading.name: reading for reading in declared}
    values: dict[str, PlainValue] = {}
    for parameter in parameters:
        row = rows.get(parameter.name)
        if row is None:
            hint = near if "mean" in (near := nearest(parameter.name, rows)) else ""
            raise ControlError(f"{owner}: parameter '{parameter.name}' cannot be set because it was not declared{hint}")
        if row.read_only:
            raise ControlError(
                f"{owner}: parameter '{parameter.name}' cannot be set because it is read-only; "
                f"change it in ros2_controllers.yaml, and load the controller again"
            )
        if row.kind not in (parameter.kind, "not_set"):
            raise ControlError(
                f"{owner}: wrong parameter type, parameter '{parameter.name}' is of type {row.kind}, "
                f"setting it to {parameter.kind} is not allowed"
            )
        try:
            values[parameter.name] = parameter.plain
        except ValueError as error:
            raise ControlError(f"{owner}: parameter '{parameter.name}': {error}") from None
    return values


class _Row(NamedTuple):
    """Parameter of a dataclass, with its full dotted name, annotation, value, metadata and help text."""

    name: str
    value_type: Any
    value: Any
    metadata: Mapping[str, Any]
    help: str


def _rows(params: Any, prefix: str) -> Iterator[_Row]:  # noqa: ANN401 - a dataclass
    owner = type(params)
    for entry, annotation in fields_of(owner):
        value, metadata, key = getattr(params, entry.name), entry.metadata or _NO_METADATA, key_of(entry)
        help_text = help_of(owner, entry)
        if metadata.get("here") or metadata.get("derived"):
            continue
        if metadata.get("part"):
            yield from _rows(value, prefix)
        elif metadata.get("section") and isinstance(value, dict):  # the keys are names from the file
            inner = typing.get_args(annotation)[-1]
            yield from (_Row(f"{prefix}{key}.{name}", inner, one, metadata, help_text) for name, one in value.items())
        elif metadata.get("section"):
            yield from _rows(value, f"{prefix}{key}.")
        else:
            yield _Row(f"{prefix}{key}", annotation, value, metadata, help_text)


def _kind(annotation: Any, value: object) -> str:  # noqa: ANN401 - types without a common base
    """Return the ROS type of a parameter, derived from its annotation or, if that is ambiguous, from its value."""
    origin, inner = typing.get_origin(annotation), typing.get_args(annotation)
    if origin in (typing.Union, types.UnionType):
        kinds = [_kind(member, value) for member in inner if member is not type(None)]
        return next((kind for kind in kinds if kind.endswith("_array")), kinds[0])
    if origin in (tuple, list) and inner:
        return f"{SCALARS.get(inner[0], 'string')}_array"
    if origin is typing.Literal or (isinstance(annotation, type) and issubclass(annotation, enum.Enum)):
        return "string"
    return SCALARS.get(annotation) or _kind_of(value)


def _kind_of(value: object) -> str:
    if isinstance(value, list | tuple):
        kinds = {_kind_of(element) for element in value}
        first = "double" if kinds == {"integer", "double"} else min(kinds, default="string")
        return f"{first}_array" if first in SCALARS.values() else "string_array"
    return SCALARS.get(type(value), "not_set")
