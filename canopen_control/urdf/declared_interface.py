"""Command and state interfaces as a description declares them: their standard names, bounds and initial values."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from canopen_control.urdf.document import Document, Element

__all__ = ["ACCELERATION", "EFFORT", "POSITION", "VELOCITY", "InterfaceInfo", "read_interfaces"]

POSITION: Final = "position"
VELOCITY: Final = "velocity"
EFFORT: Final = "effort"
ACCELERATION: Final = "acceleration"


@dataclass(frozen=True)
class InterfaceInfo:
    """A <command_interface> or <state_interface>: bounds and initial value in SI units, infinite or nan if absent.

    `limited` is False where `<limits enable="false"/>` stands, at it or at its joint.
    """

    name: str
    minimum: float = -math.inf
    maximum: float = math.inf
    initial_value: float = math.nan
    parameters: dict[str, str] = field(default_factory=dict)
    limited: bool = True


def read_interfaces(document: Document, element: Element, tag: str) -> dict[str, InterfaceInfo]:
    """Return the interfaces of a <joint>, <sensor> or <gpio>; `tag` is command_interface or state_interface."""
    found: dict[str, InterfaceInfo] = {}
    for each in element.children:
        if each.tag != tag:
            continue
        name, parameters = document.name(each), each.parameters()
        if name in found:
            document.error(each, f"{element.attributes.get('name')}: {tag} {name!r} is given twice")
        low = document.decimal(each, parameters, "min", -math.inf)
        high = document.decimal(each, parameters, "max", math.inf)
        initial = document.decimal(each, parameters, "initial_value", math.nan)
        limited = _limited(element) and _limited(each)
        found[name] = InterfaceInfo(name, low, high, initial, parameters, limited)
    return found


def _limited(element: Element) -> bool:
    limits = element.child("limits")
    return limits is None or limits.attributes.get("enable", "true").strip().lower() != "false"
