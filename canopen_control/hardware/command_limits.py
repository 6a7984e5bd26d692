"""Keeps commands within the limits of the description: the controller_manager's `enforce_command_limits`.

The law of the file (ros2_control jazzy): a URDF <limit>, tightened by `min` and `max` of the command interfaces, is
enforced by a `joint_limiter`, with a <safety_controller> by a `soft_limiter`. Accelerations and jerks are limited by
their <command_interface name="acceleration"> and "jerk" alone. Nothing is limited where `<limits enable="false"/>`
stands. A command that is nan stays nan.

Ours, and safer: a joint outside of its range is led back by its velocity limit and not at once, and a velocity may lead
it back too; one that has no velocity state begins from standstill; no velocity changes by more than the acceleration.

What is limited is told once for each occasion: what was asked for, and the limit as the description has it. An occasion
goes on until nothing has been limited for a second, which is how often ros2_control tells it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

from canopen_control.hardware.interfaces import ACCELERATION, POSITION, VELOCITY
from canopen_control.hardware.joint_limiter import (
    ACC,
    EFF,
    JERK,
    NOTHING,
    POS,
    QUANTITIES,
    VEL,
    JointLimiter,
)
from canopen_control.hardware.soft_limiter import SoftLimiter
from canopen_control.urdf.declared_interface import InterfaceInfo
from canopen_control.urdf.joint_element import HardLimits

if TYPE_CHECKING:
    from canopen_control.hardware.interfaces import CommandInterface, InterfaceRegistry, StateInterface
    from canopen_control.urdf.description import Description
    from canopen_control.urdf.joint_element import Joint
    from canopen_control.urdf.ros2_control import ControlJoint

__all__ = ["CommandLimits", "hard_limits"]

_QUIET_S = 1.0  # without a limited command, and the next one is told again
_TOLD_AT_ONCE = 3  # joints named in a sentence
_UNITS: Final = ("", "/s", None, "/s²", "/s³")  # after rad or m; an effort has its own
_ALMOST: Final = 1.0 - 1e-9  # what rounding leaves of a step
_NO_BOUNDS: Final = InterfaceInfo("")

Commands = Sequence["CommandInterface"]
States = Sequence["StateInterface"]


class _JointCommands:
    """The commands of one joint, its limiter, and what was told of them."""

    __slots__ = ("_actual", "_commands", "_desired", "_joint", "_limiter", "_limits", "_quiet", "_starts", "_states")

    def __init__(self, joint: Joint, limits: HardLimits, commands: Commands, states: States) -> None:
        self._joint, self._limits = joint, limits
        self._limiter = JointLimiter(limits) if joint.soft is None else SoftLimiter(limits, joint.soft)
        self._commands = [(QUANTITIES.index(each.interface), each) for each in commands]
        self._states = [(QUANTITIES.index(each.interface), each) for each in states]
        self._actual, self._desired = list(NOTHING), list(NOTHING)
        self._quiet = [math.inf] * len(QUANTITIES)  # s since a command had to be changed
        self._starts = [math.nan, math.nan]

    def enforce(self, period: float) -> str | None:
        """Clamp the commands; return what was asked for and what limits it, where that begins."""
        actual, desired, limiter = self._actual, self._desired, self._limiter
        for at, state in self._states:
            actual[at] = state.value
        for at, command in self._commands:
            desired[at] = math.nan if command.owner is None else command.value
            if math.isnan(desired[at]):
                limiter.before[at] = math.nan
        self._begin(actual, limiter.before)
        limiter.enforce(actual, desired, period)
        told: str | None = None
        for at, command in self._commands:
            value, wanted = desired[at], command.value
            self._quiet[at] += period
            if math.isnan(value):
                continue
            value = self._bounded(at, command, value) if at > VEL else self._changed(at, value, period)
            limiter.before[at] = command.value = value
            if value != wanted and (text := self._told(at, command, wanted, value, period)) is not None:
                told = text if told is None else f"{told}; {text}"
        return told

    def _begin(self, actual: list[float], before: list[float]) -> None:
        """Measure changes from the last commands, else from what is measured; a joint outside is at its end then."""
        limits, here = self._limits, actual[POS]
        self._starts[POS] = before[POS] if math.isfinite(before[POS]) else here
        if here < limits.min_position or here > limits.max_position:
            actual[POS] = min(max(here, limits.min_position), limits.max_position)
        if math.isnan(before[VEL]):
            before[VEL] = actual[VEL] if math.isfinite(actual[VEL]) else 0.0
        self._starts[VEL] = before[VEL]

    def _changed(self, at: int, value: float, period: float) -> float:
        """Return a position or velocity that has changed by no more than its rate allows, whatever is ahead."""
        most = (self._limits.max_velocity, self._limits.max_acceleration)[at] * period
        start = self._starts[at]
        return min(max(value, start - most), start + most) if math.isfinite(start) else value

    # ------------------------------------------------------------------------------------------------- what is told

    def _told(self, at: int, command: CommandInterface, wanted: float, value: float, period: float) -> str | None:
        """Return the limits that made `value` of what was wanted, where that begins."""
        begins, self._quiet[at] = self._quiet[at] > _QUIET_S, 0.0
        if not begins:
            return None
        short = self._stopped_short(wanted, period) if at == VEL else wanted
        bounded = self._bounded(at, command, short)
        reasons, soft = [], self._joint.soft
        if at == POS and soft is not None and soft.lower < soft.upper and not soft.lower <= bounded <= soft.upper:
            bounded = min(max(bounded, soft.lower), soft.upper)
            reasons.append(f"its soft limit {self._quantity(POS, bounded)}")
        elif bounded != short:
            reasons.append(self._quantity(at, bounded))
        elif short != wanted:
            end = self._limits.max_position if wanted > 0.0 else self._limits.min_position
            reasons.append(f"what ends at {self._quantity(POS, end)}")
        if value != bounded:
            reasons.append(self._by_state(at, value, period))
        return f"{command.name}: {self._quantity(at, wanted)} is limited to {' and to '.join(reasons)}"

    def _bounded(self, at: int, command: CommandInterface, value: float) -> float:
        """Return a command within the limits that are always the same."""
        limits = self._limits
        if at == POS:
            return min(max(value, limits.min_position), limits.max_position)
        most = (math.inf, limits.max_velocity, limits.max_effort, limits.max_acceleration, limits.max_jerk)[at]
        return min(max(value, -most, command.minimum), most, command.maximum)

    def _by_state(self, at: int, value: float, period: float) -> str:
        """Say which limit it is that depends on where the joint is and how it moves."""
        soft, limits = self._joint.soft, self._limits
        at_step = abs(value - self._starts[POS]) >= limits.max_velocity * period * _ALMOST
        if soft is not None and soft.lower < soft.upper and not (at == POS and at_step):
            return f"its soft limits, {soft.lower:g} to {self._quantity(POS, soft.upper)}"
        if at == EFF:
            return "what drives it no further out and no faster"
        if at == POS and at_step:
            return f"changes of {self._quantity(VEL, limits.max_velocity)}"
        return f"changes of {self._quantity(ACC, limits.max_acceleration)}"

    def _stopped_short(self, value: float, period: float) -> float:
        here = self._actual[POS]
        if math.isnan(here) or period <= 0.0:
            return value
        ahead = max(0.0, (self._limits.max_position - here) / period)
        behind = min(0.0, (self._limits.min_position - here) / period)
        return min(max(value, behind), ahead)

    def _quantity(self, at: int, value: float) -> str:
        """Return a value with the unit that it has in the description."""
        length = "m" if self._joint.type == "prismatic" else "rad"
        if at == EFF:
            return f"{value:g} {'N' if length == 'm' else 'Nm'}"
        return f"{value:g} {length}{_UNITS[at]}"


class _Plain:
    """A command of another quantity, with its own bounds."""

    __slots__ = ("_command", "_quiet")

    def __init__(self, command: CommandInterface) -> None:
        self._command, self._quiet = command, math.inf

    def enforce(self, period: float) -> str | None:
        """Clamp the command; return what was asked for and what limits it, where that begins."""
        command, wanted = self._command, self._command.value
        self._quiet += period
        if command.owner is None or command.minimum <= wanted <= command.maximum or math.isnan(wanted):
            return None
        command.value = min(max(wanted, command.minimum), command.maximum)
        begins, self._quiet = self._quiet > _QUIET_S, 0.0
        return f"{command.name}: {wanted:g} is limited to {command.value:g}" if begins else None


class CommandLimits:
    """The limits of all joints of a description."""

    def __init__(self, description: Description, registry: InterfaceRegistry) -> None:
        self._limited: list[_JointCommands | _Plain] = []
        states = {each.name: each for each in registry.state_interfaces}
        commands = {each.name: each for each in registry.command_interfaces}
        for part in (one for tag in description.hardware for one in tag.joints):
            limited = []
            for name, info in part.command_interfaces.items():
                command = commands.get(f"{part.name}/{name}")
                if command is not None and info.limited:
                    command.minimum, command.maximum = info.minimum, info.maximum
                    limited.append(command)
            found = [states[each] for name in QUANTITIES if (each := f"{part.name}/{name}") in states]
            self._add(description.joints[part.name], part, limited, found)

    def _add(self, joint: Joint, part: ControlJoint, commands: Commands, states: States) -> None:
        known = [each for each in commands if each.interface in QUANTITIES]
        self._limited += [_Plain(each) for each in commands if each.interface not in QUANTITIES]
        if known:
            speeds = VELOCITY in {each.interface for each in states} | {each.interface for each in known}
            self._limited.append(_JointCommands(joint, hard_limits(joint, part, speeds=speeds), known, states))

    def enforce(self, period: float) -> str | None:
        """Change commands that exceed a limit; return which, when that begins. `period` in s."""
        told: list[str] | None = None
        for each in self._limited:
            if (text := each.enforce(period)) is not None:
                told = [text] if told is None else [*told, text]
        return None if told is None else _summary(told)


def _summary(told: list[str]) -> str:
    more = [f"and {len(told) - _TOLD_AT_ONCE} more"] if len(told) > _TOLD_AT_ONCE else []
    return "; ".join(told[:_TOLD_AT_ONCE] + more)


def hard_limits(joint: Joint, part: ControlJoint, *, speeds: bool = True) -> HardLimits:
    """Return the limits of a joint by its <limit> and its command interfaces.

    Without `speeds` nobody knows how fast it is, and no acceleration of its positions can be limited.
    """
    limits, interfaces = joint.limits, part.command_interfaces
    position = interfaces.get(POSITION, _NO_BOUNDS)
    lower, upper = (position.minimum, position.maximum) if position.limited else (-math.inf, math.inf)
    faster, slower = _accelerations(interfaces.get(ACCELERATION, _NO_BOUNDS)) if speeds else (math.inf, math.inf)
    return HardLimits(
        max(limits.lower, lower),
        min(limits.upper, upper),
        min(limits.velocity, _smaller(interfaces.get(VELOCITY, _NO_BOUNDS))),
        limits.effort,
        faster,
        slower,
        _smaller(interfaces.get(QUANTITIES[JERK], _NO_BOUNDS)),
    )


def _smaller(info: InterfaceInfo) -> float:
    """Return the smaller one of the magnitudes that an interface bounds."""
    return min(abs(info.minimum), info.maximum)


def _accelerations(info: InterfaceInfo) -> tuple[float, float]:
    """Return what speeds up and what slows down at most: `max` and |`min`|, each for both where it stands alone."""
    faster, slower = info.maximum, abs(info.minimum)
    return (faster if math.isfinite(faster) else slower), (slower if math.isfinite(slower) else faster)
