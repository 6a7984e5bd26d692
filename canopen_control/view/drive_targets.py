"""Drives that take targets by themselves, as those of a bus without controllers do: what each is now. No toolkit."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Iterable

    from canopen_control.rpc.messages.state import ControllerReading, StateSample

__all__ = ["MODES", "DriveTarget", "drive_targets"]

_TOPIC: Final = "target"
_POSITION, _VELOCITY, _EFFORT = "position", "velocity", "effort"
MODES: Final = {
    "PP": _POSITION,
    "PV": _VELOCITY,
    "VL": _VELOCITY,
    "CSP": _POSITION,
    "CSV": _VELOCITY,
    "IP": _POSITION,
    "TQ": _EFFORT,
    "CST": _EFFORT,
}
"""What a target is in each mode of operation that takes one."""
_UNITS: Final = {_POSITION: "rad", _VELOCITY: "rad/s", _EFFORT: "effort"}


@dataclass(frozen=True, slots=True)
class DriveTarget:
    """A drive axis that takes targets: its controller, node and joint, whether it is enabled, and its mode.

    `mode` is "" where it is in none that takes a target.
    """

    controller: str
    node: str
    joint: str
    enabled: bool
    mode: str

    @property
    def quantity(self) -> str:
        """What a target is now, "" for none."""
        return MODES.get(self.mode, "")

    @property
    def unit(self) -> str:
        """The unit of a target now, as the page writes it."""
        return _UNITS.get(self.quantity, "")


def drive_targets(state: StateSample, controllers: Iterable[ControllerReading]) -> tuple[DriveTarget, ...]:
    """Return the drives whose active controller takes a target, in the order of the controllers."""
    axes = {axis.joint: (node, axis) for node, reading in state.nodes.items() for axis in reading.axes}
    found = []
    for controller in controllers:
        if controller.topic != _TOPIC or controller.state != "active":
            continue
        for joint in controller.joints:
            if joint in axes:
                node, axis = axes[joint]
                mode = axis.mode if axis.mode in MODES else ""
                enabled = axis.state == "OPERATION_ENABLED"
                found.append(DriveTarget(controller.name, node, joint, enabled, mode or ""))
    return tuple(found)
