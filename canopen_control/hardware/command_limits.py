"""Keeps commands within the limits of the description: the controller_manager's `enforce_command_limits`.

The law of the file (ros2_control jazzy): a URDF <limit> tightened by `min` and `max` of the command interface; of a
velocity, max is the smaller of |min| and max, it never leads past a position limit within the cycle, and changes by the
`max` of an <command_interface name="acceleration"> at most; a position moves by the velocity limit at most. Nothing is
limited where `<limits enable="false"/>` stands. A command that is nan stays nan.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from canopen_control.hardware.interfaces import ACCELERATION, EFFORT, POSITION, VELOCITY

if TYPE_CHECKING:
    from canopen_control.hardware.description import ControlJoint, Description, Limits
    from canopen_control.hardware.interfaces import CommandInterface, InterfaceRegistry, StateInterface

__all__ = ["CommandLimits"]


class _Bounds:
    """One command interface with its bounds; `step` is the largest change per second."""

    __slots__ = ("command", "high", "last", "limited", "low", "lower", "position", "step", "upper")

    def __init__(self, command: CommandInterface, position: StateInterface | None, limits: Limits, step: float) -> None:
        self.command, self.position, self.step = command, position, step
        self.low, self.high = _bounds(command, limits)
        self.lower, self.upper = limits.lower, limits.upper
        self.last = math.nan
        self.limited = False

    def enforce(self, period: float) -> bool:
        """Clamp the command; return whether it had to be changed."""
        wanted = self.command.value
        if math.isnan(wanted) or self.command.owner is None:
            self.last = math.nan
            return False
        value = self._stopped_short(wanted, period) if self.command.interface == VELOCITY else wanted
        value = min(max(value, self.low), self.high)
        start = self._start()
        if math.isfinite(self.step) and math.isfinite(start):
            value = min(max(value, start - self.step * period), start + self.step * period)
        self.last = self.command.value = value
        return value != wanted

    def _start(self) -> float:
        """Return what the change is measured from: the last command, before it the position or standstill."""
        if math.isfinite(self.last):
            return self.last
        if self.command.interface == POSITION:
            return math.nan if self.position is None else self.position.value
        return 0.0

    def _stopped_short(self, value: float, period: float) -> float:
        here = math.nan if self.position is None else self.position.value
        if math.isnan(here) or period <= 0.0:
            return value
        ahead, behind = max(0.0, (self.upper - here) / period), min(0.0, (self.lower - here) / period)
        return min(max(value, behind), ahead)


def _bounds(command: CommandInterface, limits: Limits) -> tuple[float, float]:
    if command.interface == POSITION:
        return max(limits.lower, command.minimum), min(limits.upper, command.maximum)
    most = {VELOCITY: limits.velocity, EFFORT: limits.effort}.get(command.interface, math.inf)
    if command.interface == VELOCITY:
        most = min(most, abs(command.minimum), command.maximum)
        return -most, most
    return max(-most, command.minimum), min(most, command.maximum)


class CommandLimits:
    """The limits of all joints of a description."""

    def __init__(self, description: Description, registry: InterfaceRegistry) -> None:
        self._bounds: list[_Bounds] = []
        states = {each.name: each for each in registry.state_interfaces}
        commands = {each.name: each for each in registry.command_interfaces}
        for part in (one for tag in description.hardware for one in tag.joints):
            limits = description.joints[part.name].limits
            for name, info in part.command_interfaces.items():
                command = commands.get(f"{part.name}/{name}")
                if command is None or not info.limited:
                    continue
                position = states.get(f"{part.name}/{POSITION}")
                command.minimum, command.maximum = info.minimum, info.maximum
                self._bounds.append(_Bounds(command, position, limits, _step(part, name, limits)))

    def enforce(self, period: float) -> str | None:
        """Change commands that exceed a limit; return which, when that begins. `period` in s."""
        told: str | None = None
        for each in self._bounds:
            limited = each.enforce(period)
            if limited and not each.limited:
                more = f"{each.command.name} is limited to {each.command.value:g}"
                told = f"{told}, {more}" if told else more
            each.limited = limited
        return told


def _step(part: ControlJoint, interface: str, limits: Limits) -> float:
    """Return the largest change per second: of a position the velocity, of a velocity the acceleration."""
    if interface == POSITION:
        velocity = part.command_interfaces.get(VELOCITY)
        return min(limits.velocity, velocity.maximum if velocity is not None else math.inf)
    acceleration = part.command_interfaces.get(ACCELERATION)
    return acceleration.maximum if interface == VELOCITY and acceleration is not None else math.inf
