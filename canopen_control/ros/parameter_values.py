"""Parameters as ROS 2 has them (rcl_interfaces) and as the robot's socket tells them, into each other."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from canopen_control.ros.interfaces import interface
from canopen_control.rpc.messages.parameters import KINDS, ParameterValue, told

if TYPE_CHECKING:
    from collections.abc import Iterable

    from canopen_control.ros.endpoint import RosMessage
    from canopen_control.rpc.messages.parameters import ParameterReading

__all__ = ["TYPES", "descriptor_of", "matches", "value_of", "wanted_by"]

#: rcl_interfaces/msg/ParameterType
TYPES: Final = {
    "not_set": 0, "bool": 1, "integer": 2, "double": 3, "string": 4, "bool_array": 6, "integer_array": 7,
    "double_array": 8, "string_array": 9,
}  # fmt: skip
_KIND_OF: Final = {number: kind for kind, number in TYPES.items()}
_INTEGERS: Final = (-(1 << 63), (1 << 63) - 1)


def value_of(reading: ParameterReading) -> RosMessage:
    """Return a rcl_interfaces/msg/ParameterValue; of type 0 where nothing is set."""
    message = interface("rcl_interfaces/msg/ParameterValue")()
    value = reading.plain
    if value is not None and reading.kind != "not_set":
        message.type = TYPES[reading.kind]
        setattr(message, f"{reading.kind}_value", value)
    return message


def descriptor_of(reading: ParameterReading) -> RosMessage:
    """Return a rcl_interfaces/msg/ParameterDescriptor, with the range of a number and the choices of a text."""
    message = interface("rcl_interfaces/msg/ParameterDescriptor")()
    message.name, message.type, message.read_only = reading.name, TYPES[reading.kind], reading.read_only
    message.description = reading.text
    if reading.choices:
        message.additional_constraints = f"one of: {', '.join(reading.choices)}"
    element = KINDS[reading.kind] or reading.kind
    if reading.low is None and reading.high is None:
        return message
    if element == "double":
        limits = interface("rcl_interfaces/msg/FloatingPointRange")
        message.floating_point_range = [
            limits(
                from_value=-math.inf if reading.low is None else float(reading.low),
                to_value=math.inf if reading.high is None else float(reading.high),
            )
        ]
    elif element == "integer":
        limits, (lowest, highest) = interface("rcl_interfaces/msg/IntegerRange"), _INTEGERS
        low, high = reading.low, reading.high
        message.integer_range = [
            limits(
                from_value=lowest if low is None else math.ceil(low),
                to_value=highest if high is None else math.floor(high),
                step=1,
            )
        ]
    return message


def wanted_by(parameter: RosMessage) -> ParameterValue:
    """Return what a rcl_interfaces/msg/Parameter wants to be set; a type that no controller has is not set."""
    kind = _KIND_OF.get(parameter.value.type, "not_set")
    value = None if kind == "not_set" else getattr(parameter.value, f"{kind}_value")
    plain = value if isinstance(value, bool | int | float | str | None) else list(value)
    return ParameterValue(name=parameter.name, kind=kind, value=told(plain))


def matches(name: str, prefixes: Iterable[str], depth: int) -> bool:
    """Whether a parameter is listed below one of the prefixes, all where there is none; depth 0 is any (rclcpp)."""
    found = list(prefixes)
    if not found:
        return not depth or name.count(".") < depth
    return any(
        name == each or (name.startswith(f"{each}.") and (not depth or name[len(each) + 1 :].count(".") < depth))
        for each in found
    )
