"""Parameters of controllers and of the controller manager as in ROS 2, which can be read and set while the robot runs.

A double that is not finite is the text that YAML has for it (`.nan`, `.inf`, `-.inf`), since JSON has no such numbers.
"""

from __future__ import annotations

import math
from typing import Final

import msgspec

from canopen_control.rpc.messages.declare import Done, Effect, Request

MANAGER: Final = "controller_manager"
#: parameter types, with the type of the elements for lists
KINDS: Final = {
    "not_set": None, "bool": None, "integer": None, "double": None, "string": None,
    "bool_array": "bool", "integer_array": "integer", "double_array": "double", "string_array": "string",
}  # fmt: skip

#: Python types of scalar parameters
SCALARS: Final = {bool: "bool", int: "integer", float: "double", str: "string"}

Scalar = bool | int | float | str
PlainValue = Scalar | list[Scalar] | None
_SPECIAL: Final = {".nan": math.nan, ".inf": math.inf, "-.inf": -math.inf}


def plain_value(value: object) -> PlainValue:
    """Convert a Python value to its form in messages; return None for a value that cannot be a parameter."""
    if isinstance(value, list | tuple):
        elements = [plain_value(item) for item in value]
        return [element for element in elements if element is not None and not isinstance(element, list)]
    if isinstance(value, float) and not math.isfinite(value):
        return ".nan" if math.isnan(value) else ".inf" if value > 0.0 else "-.inf"
    return value if isinstance(value, bool | int | float | str) else None


def number_of(value: Scalar) -> float:
    """Convert a double in a message, which may be `.nan` or `.inf`, to a float; raise ValueError for a bool or text."""
    if isinstance(value, bool):
        raise ValueError(f"{value} is not a number")
    return _SPECIAL[value] if isinstance(value, str) and value in _SPECIAL else float(value)


class ParameterValue(msgspec.Struct, frozen=True, kw_only=True):
    """Value of the parameter `name`, a dotted name; `kind` is one of `KINDS`."""

    name: str
    kind: str
    value: PlainValue = None

    @property
    def plain(self) -> PlainValue:
        """Python value of the parameter, with nan and infinite doubles; raise ValueError for an invalid double."""
        element = KINDS.get(self.kind)
        if self.kind == "double" and not isinstance(self.value, list | None):
            return number_of(self.value)
        if element == "double" and isinstance(self.value, list):
            return [number_of(text) for text in self.value]
        return self.value


class ParameterReading(ParameterValue, frozen=True, kw_only=True, omit_defaults=True):
    """Parameter with its limits; `low` and `high` are bounds of a number, `choices` are the valid texts.

    A `read_only` parameter cannot change after the controller was configured. `text` is the description.
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
    """Set parameters of a controller or of the `controller_manager`; if one is refused, none is changed."""

    controller: str
    values: tuple[ParameterValue, ...]


PARAMETER_METHODS: Final = (
    ("parameters", Effect.READS, GetParameters),
    ("set_parameters", Effect.CHANGES, SetParameters),
)
