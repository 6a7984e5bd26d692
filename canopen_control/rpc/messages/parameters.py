"""Parameters of controllers and their manager as in ROS 2: read, and set while the robot runs.

A double that is not finite is the text that YAML has for it (`.nan`, `.inf`, `-.inf`), since JSON has no number for it.
"""

from __future__ import annotations

import math
from typing import Final

import msgspec

from canopen_control.rpc.messages.declare import Done, Effect, Request

MANAGER: Final = "controller_manager"
#: the types of a parameter, each with that of its elements where it is a list
KINDS: Final = {
    "not_set": None, "bool": None, "integer": None, "double": None, "string": None,
    "bool_array": "bool", "integer_array": "integer", "double_array": "double", "string_array": "string",
}  # fmt: skip

#: what they are in Python
SCALARS: Final = {bool: "bool", int: "integer", float: "double", str: "string"}

Scalar = bool | int | float | str
PlainValue = Scalar | list[Scalar] | None
_SPECIAL: Final = {".nan": math.nan, ".inf": math.inf, "-.inf": -math.inf}


def plain_value(value: object) -> PlainValue:
    """Return a value in its form on the wire; None for a value that cannot be a parameter."""
    if isinstance(value, list | tuple):
        elements = [plain_value(item) for item in value]
        return [element for element in elements if element is not None and not isinstance(element, list)]
    if isinstance(value, float) and not math.isfinite(value):
        return ".nan" if math.isnan(value) else ".inf" if value > 0.0 else "-.inf"
    return value if isinstance(value, bool | int | float | str) else None


def number_of(value: Scalar) -> float:
    """Return a double in its form on the wire as a number; ValueError if it is invalid."""
    if isinstance(value, bool):
        raise ValueError(f"{value} is not a number")
    return _SPECIAL[value] if isinstance(value, str) and value in _SPECIAL else float(value)


class ParameterValue(msgspec.Struct, frozen=True, kw_only=True):
    """Parameter by its dotted name; `kind` is one of `KINDS`."""

    name: str
    kind: str
    value: PlainValue = None

    @property
    def plain(self) -> PlainValue:
        """Value in Python, including doubles that are not finite; ValueError if it does not match its kind."""
        element = KINDS.get(self.kind)
        if self.kind == "double" and not isinstance(self.value, list | None):
            return number_of(self.value)
        if element == "double" and isinstance(self.value, list):
            return [number_of(text) for text in self.value]
        return self.value


class ParameterReading(ParameterValue, frozen=True, kw_only=True, omit_defaults=True):
    """Parameter and its valid values: `low` and `high` bound a number, `choices` are the valid texts.

    A `read_only` one cannot change after its controller was configured. `text` is its description.
    """

    read_only: bool = False
    low: float | None = None
    high: float | None = None
    choices: tuple[str, ...] = ()
    text: str = ""


class GetParameters(Request[tuple[ParameterReading, ...]], frozen=True, kw_only=True):
    """Return the parameters of a loaded controller, or of the `controller_manager`."""

    controller: str


class SetParameters(Request[Done], frozen=True, kw_only=True):
    """Set parameters of a controller or of the `controller_manager`: all, or none with an error."""

    controller: str
    values: tuple[ParameterValue, ...]


PARAMETER_METHODS: Final = (
    ("parameters", Effect.READS, GetParameters),
    ("set_parameters", Effect.CHANGES, SetParameters),
)
