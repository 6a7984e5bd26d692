"""Enforcement of the joint limits of a robot description on all commands (parameter `enforce_command_limits`).

Rules (ros2_control jazzy): a URDF <limit>, tightened by `min` and `max` of the command interfaces, is enforced; a
<safety_controller> adds soft limits. Accelerations and jerks are limited only by their <command_interface
name="acceleration"> and "jerk". Nothing is limited for an interface with `<limits enable="false"/>`. A command that is
nan stays nan.

Safer than upstream: a joint outside its range stays there until a command leads into the range, so that it does not
move without a command; it returns at no more than the velocity limit, instead of in one step, and a velocity command
may also move it back; a joint without a velocity state is assumed to start from standstill; no
velocity changes by more than the acceleration limit allows.

A limited command is reported once per occasion, with the desired value and the limit of the description. An occasion
ends when nothing has been limited for a second, the report interval of ros2_control.
"""

from __future__ import annotations

import math
import sys
from abc import ABCMeta, abstractmethod
from collections.abc import Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

from canopen_control.controllers.limiters import (
    ACC,
    EFF,
    JERK,
    NOTHING,
    POS,
    QUANTITIES,
    VEL,
    JointLimiter,
    SoftLimiter,
)
from canopen_control.urdf.joint_element import ACCELERATION, POSITION, VELOCITY, HardLimits, InterfaceInfo

if TYPE_CHECKING:
    from collections.abc import Mapping

    from canopen_control.hardware.interfaces import CommandInterface, InterfaceRegistry, StateInterface
    from canopen_control.urdf.description import UrdfDescription
    from canopen_control.urdf.joint_element import Joint
    from canopen_control.urdf.ros2_control import ControlJoint


# Commands that are limited together: those of one joint, or a single command with bounds of another quantity.
#
# Most commands change by less than the limits allow. If one quantity of a joint without soft limits is commanded,
# `passes` detects this with a few comparisons. All other commands are processed in full by `enforce`, which would not
# change a command that passes. A limit is reported when limiting begins, see the module's docstring.


QUIET_S: Final = 1.0  # time without limiting after which a limited command is reported again
_UNITS: Final = ("", "/s", None, "/s²", "/s³")  # after rad or m; an effort has its own unit
_ALMOST: Final = 1.0 - 1e-9  # tolerance for the rounding of a step
_MAX: Final = sys.float_info.max  # infinite commands fail the short check

Commands = Sequence["CommandInterface"]
States = Sequence["StateInterface"]


class Limited(metaclass=ABCMeta):
    """Base class of limiters for commands that are limited together; run `enforce` if `passes` returns False."""

    __slots__ = ()

    def passes(self, period: float) -> bool:  # noqa: ARG002 - the verb of all of them
        """Return True if a quick check shows that all commands are within the limits; else `enforce` must run."""
        return False

    @abstractmethod
    def enforce(self, period: float, clock: float) -> str | None:
        """Clamp the commands to the limits; return a report of newly limited commands, or None.

        `clock` is the sum of all periods up to and including this cycle, in s.
        """


class JointCommands(Limited):
    """Limiter of the commands of one joint; every command goes through the full check."""

    __slots__ = (
        "_actual",
        "_commands",
        "_desired",
        "_joint",
        "_limited_at",
        "_limiter",
        "_limits",
        "_starts",
        "_states",
    )

    def __init__(self, joint: Joint, limits: HardLimits, commands: Commands, states: States) -> None:
        self._joint, self._limits = joint, limits
        self._limiter = JointLimiter(limits) if joint.soft is None else SoftLimiter(limits, joint.soft)
        self._commands = [(QUANTITIES.index(command.interface), command) for command in commands]
        self._states = [(QUANTITIES.index(state.interface), state) for state in states]
        self._actual, self._desired = list(NOTHING), list(NOTHING)
        self._limited_at = [-math.inf] * len(QUANTITIES)  # time of the last change of a command
        self._starts = [math.nan, math.nan]

    def passes(self, period: float) -> bool:  # noqa: ARG002 - the verb of all of them
        if self._joint.soft is not None:
            return False
        for _, command in self._commands:
            if command.owner is not None and command.value == command.value:  # is not nan
                return False
        before = self._limiter.before
        for at, _ in self._commands:
            before[at] = math.nan
        return True

    def enforce(self, period: float, clock: float) -> str | None:
        actual, desired, limiter = self._actual, self._desired, self._limiter
        for at, state in self._states:
            actual[at] = state.value
        for at, command in self._commands:
            desired[at] = math.nan if command.owner is None else command.value
            if math.isnan(desired[at]):
                limiter.before[at] = math.nan
        self._begin(actual, limiter.before)
        limiter.enforce(actual, desired, period)
        sentence: str | None = None
        for at, command in self._commands:
            value, target = desired[at], command.value
            if math.isnan(value):
                continue
            if at == POS:
                value = self._outside(target, value)
            value = self._bounded(at, command, value) if at > VEL else self._changed(at, value, period)
            limiter.before[at] = command.value = value
            if value == target and not (at == POS and self._holds_outside(value)):
                continue
            if (text := self._limit_text(at, command, target, value, period, clock)) is not None:
                sentence = text if sentence is None else f"{sentence}; {text}"
        return sentence

    def _begin(self, actual: list[float], before: list[float]) -> None:
        """Set the start values to the last commands or the measured state, and clamp the measured position."""
        limits, here = self._limits, actual[POS]
        self._starts[POS] = before[POS] if math.isfinite(before[POS]) else here
        if here < limits.min_position or here > limits.max_position:
            actual[POS] = min(max(here, limits.min_position), limits.max_position)
        if math.isnan(before[VEL]):
            before[VEL] = actual[VEL] if math.isfinite(actual[VEL]) else 0.0
        self._starts[VEL] = before[VEL]

    def _ends(self) -> tuple[float, float]:
        """Return the range of positions, narrowed by the soft limits."""
        soft, limits = self._joint.soft, self._limits
        if soft is None or soft.lower >= soft.upper:
            return limits.min_position, limits.max_position
        return max(limits.min_position, soft.lower), min(limits.max_position, soft.upper)

    def _outside(self, target: float, value: float) -> float:
        """Return the limited position: that of a joint outside its range stays for a command that is outside too."""
        start, (low, high) = self._starts[POS], self._ends()
        if start > high and target > high:
            return min(start, target)
        if start < low and target < low:
            return max(start, target)
        return value

    def _holds_outside(self, value: float) -> bool:
        low, high = self._ends()
        return self._starts[POS] == value and not low <= value <= high

    def _changed(self, at: int, value: float, period: float) -> float:
        """Clamp a position or velocity command to one rate-limited step from the start value."""
        most = (self._limits.max_velocity if at == POS else self._limits.max_acceleration) * period
        start = self._starts[at]
        return min(max(value, start - most), start + most) if math.isfinite(start) else value

    # ------------------------------------------------------------------------------------------------- reports

    def _limit_text(
        self, at: int, command: CommandInterface, target: float, value: float, period: float, clock: float
    ) -> str | None:
        """Return a report of the limits that changed the command; None within `QUIET_S` of the last limited command."""
        begins, self._limited_at[at] = clock - self._limited_at[at] > QUIET_S, clock
        if not begins:
            return None
        if at == POS and self._holds_outside(value):
            low, high = self._ends()
            return (
                f"{command.name}: the joint is at {self._quantity(POS, value)}, outside its range from {low:g} to "
                f"{self._quantity(POS, high)}, and is held there; a position within the range moves it back"
            )
        short = self._stopped_short(target, period) if at == VEL else target
        bounded = self._bounded(at, command, short)
        reasons, soft = [], self._joint.soft
        if at == POS and soft is not None and soft.lower < soft.upper and not soft.lower <= bounded <= soft.upper:
            bounded = min(max(bounded, soft.lower), soft.upper)
            reasons.append(f"its soft limit {self._quantity(POS, bounded)}")
        elif bounded != short:
            reasons.append(self._quantity(at, bounded))
        elif short != target:
            end = self._limits.max_position if target > 0.0 else self._limits.min_position
            reasons.append(f"a velocity that ends at {self._quantity(POS, end)}")
        if value != bounded:
            reasons.append(self._by_state(at, value, period))
        return f"{command.name}: {self._quantity(at, target)} is limited to {' and to '.join(reasons)}"

    def _bounded(self, at: int, command: CommandInterface, value: float) -> float:
        """Clamp a command to the limits that do not depend on the joint's state."""
        limits = self._limits
        if at == POS:
            return min(max(value, limits.min_position), limits.max_position)
        most = (math.inf, limits.max_velocity, limits.max_effort, limits.max_acceleration, limits.max_jerk)[at]
        return min(max(value, -most, command.minimum), most, command.maximum)

    def _by_state(self, at: int, value: float, period: float) -> str:
        """Describe the limit that depends on the position and velocity of the joint."""
        soft, limits = self._joint.soft, self._limits
        at_step = abs(value - self._starts[POS]) >= limits.max_velocity * period * _ALMOST
        if soft is not None and soft.lower < soft.upper and not (at == POS and at_step):
            return f"its soft limits, {soft.lower:g} to {self._quantity(POS, soft.upper)}"
        if at == EFF:
            return "an effort that drives the joint neither further out nor faster"
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
        """Format a value with its unit: rad or m, Nm or N, and their derivatives."""
        length = "m" if self._joint.type == "prismatic" else "rad"
        if at == EFF:
            return f"{value:g} {'N' if length == 'm' else 'Nm'}"
        return f"{value:g} {length}{_UNITS[at]}"


class JointPosition(JointCommands):
    """Limiter of a joint with one position command and no soft limits; uses a quick check."""

    __slots__ = ("_before", "_command", "_high", "_low", "_rate", "_slope", "_speed")

    def __init__(self, joint: Joint, limits: HardLimits, commands: Commands, states: States) -> None:
        super().__init__(joint, limits, commands, states)
        self._command, self._before = commands[0], math.nan
        self._low, self._high = max(limits.min_position, -_MAX), min(limits.max_position, _MAX)
        self._rate, self._slope = limits.max_velocity, limits.max_acceleration
        self._speed = _state(states, VELOCITY)

    def passes(self, period: float) -> bool:
        command, before, rate = self._command, self._before, self._rate
        value = command.value
        if self._slope != math.inf:
            speed = 0.0 if self._speed is None else abs(self._speed.value)
            rate = min(rate, (speed if speed == speed else 0.0) + self._slope * period)
        step = rate * period
        if before - step <= value <= before + step and self._low <= value <= self._high and command.owner is not None:
            self._before = value
            return True
        if value == value and command.owner is not None:
            return False
        self._before = math.nan
        return True

    def enforce(self, period: float, clock: float) -> str | None:
        before = self._limiter.before
        before[POS] = self._before
        text = super().enforce(period, clock)
        self._before = before[POS]
        return text


class JointVelocity(JointCommands):
    """Limiter of a joint with one velocity command and no soft limits; uses a quick check."""

    __slots__ = ("_before", "_command", "_here", "_high", "_low", "_rate", "_slope", "_speed")

    def __init__(self, joint: Joint, limits: HardLimits, commands: Commands, states: States) -> None:
        super().__init__(joint, limits, commands, states)
        self._command, self._before = commands[0], math.nan
        self._low, self._high, self._slope = limits.min_position, limits.max_position, limits.max_acceleration
        self._rate = min(limits.max_velocity, _MAX)
        self._here = _state(states, POSITION) if limits.has_ends else None
        self._speed = _state(states, VELOCITY)

    def passes(self, period: float) -> bool:
        command, rate, before, change = self._command, self._rate, self._before, self._slope * period
        value = command.value
        if value != value or command.owner is None:
            speed = math.nan if self._speed is None else self._speed.value
            self._before = speed if -_MAX <= speed <= _MAX else 0.0
            return True
        if not (-rate <= value <= rate and before - change <= value <= before + change):
            return False
        if self._here is not None:
            here = self._here.value
            if not self._low <= here <= self._high:
                return False
            if not (self._low - here) / period <= value <= (self._high - here) / period:
                return False
        self._before = value
        return True

    def enforce(self, period: float, clock: float) -> str | None:
        before = self._limiter.before
        before[VEL] = self._before
        text = super().enforce(period, clock)
        self._before = before[VEL]
        return text


class JointSeveral(Limited):
    """Limiter of a joint with several commands and no soft limits; each command has its own limiter."""

    __slots__ = ("_parts",)

    def __init__(self, parts: Sequence[Limited]) -> None:
        self._parts = parts

    def passes(self, period: float) -> bool:
        for part in self._parts:  # noqa: SIM110 - `all` would make a generator in the cycle
            if not part.passes(period):
                return False
        return True

    def enforce(self, period: float, clock: float) -> str | None:
        sentence: str | None = None
        for part in self._parts:
            if period > 0.0 and part.passes(period):  # a repeated check gives the same result
                continue
            if (text := part.enforce(period, clock)) is not None:
                sentence = text if sentence is None else f"{sentence}; {text}"
        return sentence


class PlainCommand(Limited):
    """Limiter of a command outside `QUANTITIES`; applies only the bounds of the command interface."""

    __slots__ = ("_command", "_limited_at")

    def __init__(self, command: CommandInterface) -> None:
        self._command, self._limited_at = command, -math.inf

    def enforce(self, period: float, clock: float) -> str | None:  # noqa: ARG002 - the verb of all of them
        command, target = self._command, self._command.value
        if command.owner is None or command.minimum <= target <= command.maximum or math.isnan(target):
            return None
        command.value = min(max(target, command.minimum), command.maximum)
        begins, self._limited_at = clock - self._limited_at > QUIET_S, clock
        return f"{command.name}: {target:g} is limited to {command.value:g}" if begins else None


def _state(states: States, interface: str) -> StateInterface | None:
    return next((state for state in states if state.interface == interface), None)


_KINDS: Final[Mapping[str, type[JointCommands]]] = MappingProxyType({POSITION: JointPosition, VELOCITY: JointVelocity})


def limited_joint(joint: Joint, limits: HardLimits, commands: Commands, states: States) -> Limited:
    """Return the limiter with the cheapest check for the commands of a joint."""
    if joint.soft is not None:
        return JointCommands(joint, limits, commands, states)
    parts = [_KINDS.get(command.interface, JointCommands)(joint, limits, [command], states) for command in commands]
    return parts[0] if len(parts) == 1 else JointSeveral(parts)


_MAX_REPORTED: Final = 3  # limited commands that one report describes
_NO_BOUNDS: Final = InterfaceInfo("")


class CommandLimits:
    """Limiters of all commands to the joints of a robot description."""

    def __init__(self, description: UrdfDescription, registry: InterfaceRegistry) -> None:
        self._limited: list[Limited] = []
        self._clock = 0.0
        states = {state_interface.name: state_interface for state_interface in registry.state_interfaces}
        commands = {interface.name: interface for interface in registry.command_interfaces}
        for part in (joint for tag in description.hardware for joint in tag.joints):
            limited = []
            for name, info in part.command_interfaces.items():
                command = commands.get(f"{part.name}/{name}")
                if command is not None and info.limited:
                    command.minimum, command.maximum = info.minimum, info.maximum
                    limited.append(command)
            known_states = [
                states[name_of_state] for name in QUANTITIES if (name_of_state := f"{part.name}/{name}") in states
            ]
            self._add(description.joints[part.name], part, limited, known_states)

    def _add(self, joint: Joint, part: ControlJoint, commands: Commands, states: States) -> None:
        limitable = [command for command in commands if command.interface in QUANTITIES]
        bounded = (command for command in commands if command.interface not in QUANTITIES and _is_bounded(command))
        self._limited += [PlainCommand(command) for command in bounded]
        if limitable:
            speeds = VELOCITY in {state.interface for state in states} | {command.interface for command in limitable}
            limits = hard_limits(joint, part, speeds=speeds)
            if joint.soft is not None or limits != HardLimits() or any(map(_is_bounded, limitable)):
                self._limited.append(limited_joint(joint, limits, limitable, states))

    def enforce(self, period: float) -> str | None:
        """Limit all commands; `period` is in s. Return a report of newly limited commands, or None."""
        self._clock = clock = self._clock + period
        judged = period > 0.0
        texts: list[str] | None = None
        for limited in self._limited:
            if judged and limited.passes(period):
                continue
            if (text := limited.enforce(period, clock)) is not None:
                texts = [text] if texts is None else [*texts, text]
        return None if texts is None else _summary(texts)


def _is_bounded(command: CommandInterface) -> bool:
    return math.isfinite(command.minimum) or math.isfinite(command.maximum)


def _summary(texts: list[str]) -> str:
    more = [f"and {len(texts) - _MAX_REPORTED} more"] if len(texts) > _MAX_REPORTED else []
    return "; ".join(texts[:_MAX_REPORTED] + more)


def hard_limits(joint: Joint, part: ControlJoint, *, speeds: bool = True) -> HardLimits:
    """Return the limits of a joint, combined from its URDF <limit> and its command interfaces.

    Without `speeds` the velocity of the joint is unknown, so its acceleration cannot be limited.
    """
    limits, interfaces = joint.limits, part.command_interfaces
    position = interfaces.get(POSITION, _NO_BOUNDS)
    lower, upper = (position.minimum, position.maximum) if position.limited else (-math.inf, math.inf)
    faster, slower = _accelerations(interfaces.get(ACCELERATION, _NO_BOUNDS)) if speeds else (math.inf, math.inf)
    return HardLimits(
        max(limits.lower, lower),
        min(limits.upper, upper),
        min(limits.speed, _smaller(interfaces.get(VELOCITY, _NO_BOUNDS))),
        limits.max_effort,
        faster,
        slower,
        _smaller(interfaces.get(QUANTITIES[JERK], _NO_BOUNDS)),
    )


def _smaller(info: InterfaceInfo) -> float:
    """Return the smaller magnitude of the two bounds of an interface."""
    return min(abs(info.minimum), info.maximum)


def _accelerations(info: InterfaceInfo) -> tuple[float, float]:
    """Return the maximum acceleration and deceleration from `max` and |`min`|; a single bound applies to both."""
    faster, slower = info.maximum, abs(info.minimum)
    return (faster if math.isfinite(faster) else slower), (slower if math.isfinite(slower) else faster)
