"""Keeps commands within the limits of the description: the controller_manager's `enforce_command_limits`.

The law of the file (ros2_control jazzy): a URDF <limit> tightened by `min` and `max` of the command interface; of a
velocity, max is the smaller of |min| and max, it never leads past a position limit within the cycle, and changes by the
`max` of an <command_interface name="acceleration"> at most; a position moves by the velocity limit at most. Nothing is
limited where `<limits enable="false"/>` stands. A command that is nan stays nan.

What is limited is told once for each occasion: what was asked for, and the limit as the description has it. An occasion
goes on until nothing has been limited for a second, which is how often ros2_control tells it.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from canopen_control.hardware.interfaces import ACCELERATION, EFFORT, POSITION, VELOCITY

if TYPE_CHECKING:
    from canopen_control.hardware.interfaces import CommandInterface, InterfaceRegistry, StateInterface
    from canopen_control.urdf.description import Description
    from canopen_control.urdf.joint_element import Limits
    from canopen_control.urdf.ros2_control import ControlJoint

__all__ = ["CommandLimits"]

_QUIET_S = 1.0  # without a limited command, and the next one is told again
_TOLD_AT_ONCE = 3  # joints named in a sentence
_UNITS = {POSITION: "", VELOCITY: "/s", ACCELERATION: "/s²"}  # after rad or m


class _Bounds:
    """One command interface with its bounds; `step` is the largest change per second."""

    __slots__ = ("_length", "_quiet", "command", "high", "last", "low", "lower", "position", "step", "upper")

    def __init__(
        self, command: CommandInterface, position: StateInterface | None, limits: Limits, step: float, length: str
    ) -> None:
        self.command, self.position, self.step = command, position, step
        self.low, self.high = _bounds(command, limits)
        self.lower, self.upper = limits.lower, limits.upper
        self.last = math.nan
        self._length = length
        self._quiet = math.inf  # s since a command had to be changed

    def enforce(self, period: float) -> str | None:
        """Clamp the command; return what was asked for and what limits it, where that begins."""
        wanted = self.command.value
        self._quiet += period
        if math.isnan(wanted) or self.command.owner is None:
            self.last = math.nan
            return None
        short = self._stopped_short(wanted, period) if self.command.interface == VELOCITY else wanted
        bounded = min(max(short, self.low), self.high)
        value = self._stepped(bounded, period)
        self.last = self.command.value = value
        if value == wanted:
            return None
        begins, self._quiet = self._quiet > _QUIET_S, 0.0
        return self._why(wanted, short, bounded, value) if begins else None

    def _why(self, wanted: float, short: float, bounded: float, value: float) -> str:
        """Return the limits that made `value` of what was wanted, from the values in between."""
        limits = []
        if bounded != short:
            limits.append(self._quantity(bounded))
        elif short != wanted:
            limits.append(f"what ends at {self._quantity(self.upper if wanted > 0.0 else self.lower, POSITION)}")
        if value != bounded:
            rate = VELOCITY if self.command.interface == POSITION else ACCELERATION
            limits.append(f"changes of {self._quantity(self.step, rate)}")
        return f"{self.command.name}: {self._quantity(wanted)} is limited to {' and to '.join(limits)}"

    def _stepped(self, value: float, period: float) -> float:
        start = self._start()
        if not (math.isfinite(self.step) and math.isfinite(start)):
            return value
        return min(max(value, start - self.step * period), start + self.step * period)

    def _quantity(self, value: float, interface: str | None = None) -> str:
        """Return a value with the unit that it has in the description."""
        interface = interface or self.command.interface
        if interface == EFFORT:
            return f"{value:g} {'N' if self._length == 'm' else 'Nm'}"
        return f"{value:g} {self._length}{_UNITS[interface]}" if interface in _UNITS else f"{value:g}"

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
            joint = description.joints[part.name]
            limits, length = joint.limits, "m" if joint.type == "prismatic" else "rad"
            for name, info in part.command_interfaces.items():
                command = commands.get(f"{part.name}/{name}")
                if command is None or not info.limited:
                    continue
                position = states.get(f"{part.name}/{POSITION}")
                command.minimum, command.maximum = info.minimum, info.maximum
                self._bounds.append(_Bounds(command, position, limits, _step(part, name, limits), length))

    def enforce(self, period: float) -> str | None:
        """Change commands that exceed a limit; return which, when that begins. `period` in s."""
        told: list[str] | None = None
        for each in self._bounds:
            if (text := each.enforce(period)) is not None:
                told = [text] if told is None else [*told, text]
        return None if told is None else _summary(told)


def _summary(told: list[str]) -> str:
    more = [f"and {len(told) - _TOLD_AT_ONCE} more"] if len(told) > _TOLD_AT_ONCE else []
    return "; ".join(told[:_TOLD_AT_ONCE] + more)


def _step(part: ControlJoint, interface: str, limits: Limits) -> float:
    """Return the largest change per second: of a position the velocity, of a velocity the acceleration."""
    if interface == POSITION:
        velocity = part.command_interfaces.get(VELOCITY)
        return min(limits.velocity, velocity.maximum if velocity is not None else math.inf)
    acceleration = part.command_interfaces.get(ACCELERATION)
    return acceleration.maximum if interface == VELOCITY and acceleration is not None else math.inf
