"""Targets for drives and arms from the sliders of a page.

A slider that the user has moved keeps its target until the motion to that target has ended. All other position sliders
follow their joints and move nothing: during the motion, a joint whose slider was not moved keeps its start position.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from canopen_control.rpc.messages.state import ControllerReading, StateSample


# Drives with a target controller, as on a bus without other controllers, and their present modes. No toolkit.


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
"""Quantity of the target for each mode of operation that has a target."""
_UNITS: Final = {_POSITION: "rad", _VELOCITY: "rad/s", _EFFORT: "effort"}


@dataclass(frozen=True, slots=True)
class DriveTarget:
    """Axis of a drive that a target controller commands, with its current state and mode.

    `mode` is "" if the current mode of operation takes no target.
    """

    controller: str
    node: str
    joint: str
    enabled: bool
    mode: str

    @property
    def quantity(self) -> str:
        """Quantity of the target, such as "velocity"; "" if the current mode takes no target."""
        return MODES.get(self.mode, "")

    @property
    def unit(self) -> str:
        """Unit of the target for the page."""
        return _UNITS.get(self.quantity, "")


def drive_targets(state: StateSample, controllers: Iterable[ControllerReading]) -> tuple[DriveTarget, ...]:
    """Return the axes that an active target controller commands, in the order of the controllers."""
    axes = {axis.joint: (node, axis) for node, reading in state.nodes.items() for axis in reading.axes}
    targets = []
    for controller in controllers:
        if controller.topic != _TOPIC or controller.state != "active":
            continue
        for joint in controller.joints:
            if joint in axes:
                node, axis = axes[joint]
                mode = axis.mode if axis.mode in MODES else ""
                targets.append(DriveTarget(controller.name, node, joint, axis.enabled, mode or ""))
    return tuple(targets)


_DRIVEN_S: Final = 0.5  # the button was released if it is not renewed for this time


class TargetSliders:
    """Position sliders of one controller; `limits` are the slider ranges in rad or m, `clock` returns seconds."""

    def __init__(self, limits: Mapping[str, tuple[float, float]], clock: Callable[[], float] = time.monotonic) -> None:
        self._limits, self._clock = limits, clock
        self.values = {joint: min(max(0.0, low), high) for joint, (low, high) in limits.items()}
        self._set: set[str] = set()
        self._rest: dict[str, float] = {}
        self._held_at: float | None = None

    def set(self, joint: str, value: float) -> None:
        """Set the target of a slider moved by the user."""
        low, high = self._limits[joint]
        self.values[joint] = min(max(value, low), high)
        self._set.add(joint)

    def follow(self, positions: Mapping[str, float | None]) -> dict[str, float]:
        """Return the new values of sliders whose joints have moved; empty while a button is held."""
        now = self._clock()
        if self._driven(now):
            return {}
        if self._held_at is not None:
            self._held_at = None
            self._set.clear()
        moved = {}
        for joint, (low, high) in self._limits.items():
            at = positions.get(joint)
            if at is None or joint in self._set:
                continue
            shown = min(max(at, low), high)
            if abs(shown - self.values[joint]) >= (high - low) / 400:  # smaller changes would not be visible
                self.values[joint] = moved[joint] = shown
        return moved

    def targets(self, positions: Mapping[str, float | None]) -> list[float]:
        """Return the targets for a held button, in the order of the sliders."""
        now = self._clock()
        if not self._driven(now):
            self._rest = {joint: at for joint, at in positions.items() if at is not None}
        self._held_at = now
        return [value if joint in self._set else self._rest.get(joint, value) for joint, value in self.values.items()]

    def rest(self, positions: Mapping[str, float | None]) -> list[float]:
        """Return the command that ends the motion: the current or last known position of each joint."""
        values = {**self.values, **self._rest}
        values |= {joint: at for joint, at in positions.items() if at is not None}
        return [values[joint] for joint in self.values]

    @property
    def driven(self) -> bool:
        return self._driven(self._clock())

    def _driven(self, now: float) -> bool:
        return self._held_at is not None and now - self._held_at < _DRIVEN_S
