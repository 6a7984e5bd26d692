"""Limiter of commands by the description: the controller_manager's `enforce_command_limits`.

Rules (ros2_control jazzy): a URDF <limit>, tightened by `min` and `max` of the command interfaces, is
enforced; a <safety_controller> adds soft limits. Accelerations and jerks are limited by
their <command_interface name="acceleration"> and "jerk" alone. Nothing is limited where `<limits enable="false"/>`
stands. A command that is nan stays nan.

Ours, and safer: a joint outside of its range is led back by its velocity limit and not at once, and a velocity may lead
it back too; one that has no velocity state begins from standstill; no velocity changes by more than the acceleration.

A limited command is reported once per occasion, with the desired value and the limit of the description. An occasion
ends when nothing has been limited for a second, which is the report interval of ros2_control.
"""

from __future__ import annotations

import math
import sys
from abc import ABCMeta, abstractmethod
from collections.abc import Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

from mypy_extensions import mypyc_attr

from canopen_control.errors import ControlError
from canopen_control.urdf.joint_element import ACCELERATION, EFFORT, POSITION, VELOCITY, HardLimits, InterfaceInfo

if TYPE_CHECKING:
    from collections.abc import Mapping

    from canopen_control.hardware.interfaces import CommandInterface, InterfaceRegistry, StateInterface
    from canopen_control.urdf.description import UrdfDescription
    from canopen_control.urdf.joint_element import Joint, SoftLimits
    from canopen_control.urdf.ros2_control import ControlJoint


# Joint limiter: clamps the commands of one joint to its limits of position, velocity, effort, acceleration and jerk.
#
# Rules (joint_limits of ros2_control jazzy, JointSaturationLimiter): the quantities are judged in their
# order; a position moves by what the velocity, and that by what the acceleration allows since the command before; a
# velocity does not lead past the end of the joint within the cycle; an effort does not push beyond the end, nor what is
# too fast further. What is nan is not given. All in SI units (rad or m).


POS: Final = 0
VEL: Final = 1
EFF: Final = 2
ACC: Final = 3
JERK: Final = 4
QUANTITIES: Final = (POSITION, VELOCITY, EFFORT, ACCELERATION, "jerk")
"""The quantities of a joint in the order in which they are judged; POS to JERK are their places."""
NOTHING: Final = (math.nan,) * len(QUANTITIES)

_FAR_OUT: Final = 0.0087  # rad or m: a joint that is this far outside of its range is an error
NEAR: Final = 0.002  # rad or m: so far outside it may still move back


@mypyc_attr(allow_interpreted_subclasses=True)
class JointLimiter:
    """Limiter of one joint's commands; `before` are the last ones, nan without one since `reset`."""

    def __init__(self, limits: HardLimits) -> None:
        self.limits = limits
        self.before: list[float] = list(NOTHING)
        self._low = self._high = 0.0

    def reset(self) -> None:
        """Clear the previous commands; the next one is compared with the joint's state."""
        self.before[:] = NOTHING

    def enforce(self, actual: list[float], desired: list[float], period: float) -> bool:
        """Clamp the desired values by quantity and return whether any was clamped; `period` in s.

        Raises ControlError for a position command to a joint that is far outside of its range.
        """
        if period <= 0.0:
            return False
        self._begin(actual, desired)
        limited = False
        for at in range(len(desired)):
            target = desired[at]
            if math.isnan(target):
                continue
            self._bound(at, target, actual, period)
            if target < self._low or target > self._high:
                limited = True
                desired[at] = target = min(max(target, self._low), self._high)
            self.before[at] = target
        return limited

    def _begin(self, actual: list[float], desired: list[float]) -> None:
        """Start from the measured state, else from the first command, if no previous command is known."""
        before = self.before
        for limited in before:
            if limited == limited:  # is not nan
                return
        for at in range(len(desired)):
            if not math.isnan(desired[at]):
                before[at] = desired[at] if math.isnan(actual[at]) else actual[at]

    def _bound(self, at: int, target: float, actual: list[float], period: float) -> None:
        """Set the range of a quantity; bounds in the wrong order are exchanged."""
        if at == POS:
            self._bound_position(actual, period)
        elif at == VEL:
            self._bound_velocity(target, actual, period)
        elif at == EFF:
            self._bound_effort(actual)
        else:
            most = self.limits.max_jerk if at == JERK else self._most_acceleration(target, actual[VEL])
            self._low, self._high = -most, most
        if self._low > self._high:
            self._low, self._high = self._high, self._low

    def _bound_position(self, actual: list[float], period: float) -> None:
        limits = self.limits
        low, high, here = limits.min_position, limits.max_position, actual[POS]
        if here < low - _FAR_OUT or here > high + _FAR_OUT:
            raise ControlError(f"it is at {here:g}, outside of its range from {low:g} to {high:g}; check its limits")
        start = here if math.isnan(self.before[POS]) else self.before[POS]
        if math.isfinite(limits.max_velocity) and math.isfinite(start):
            fastest = limits.max_velocity
            if math.isfinite(limits.max_acceleration):
                speed = 0.0 if math.isnan(actual[VEL]) else abs(actual[VEL])
                fastest = min(fastest, speed + limits.max_acceleration * period)
            step = fastest * period
            low = max(min(start - step, high), low)
            high = min(max(start + step, low), high)
        self._low, self._high = low, high

    def _bound_velocity(self, target: float, actual: list[float], period: float) -> None:
        limits, here, before = self.limits, actual[POS], self.before[VEL]
        low, high = -limits.max_velocity, limits.max_velocity
        if limits.has_ends and not math.isnan(here):
            low, high = (
                max((limits.min_position - here) / period, low),
                min((limits.max_position - here) / period, high),
            )
            if self._may_not_move(target, here):
                low = high = 0.0
        if math.isfinite(limits.max_acceleration) and not math.isnan(before):
            change = limits.max_acceleration * period
            low, high = max(before - change, low), min(before + change, high)
        self._low, self._high = low, high

    def _may_not_move(self, target: float, here: float) -> bool:
        """Whether the joint is outside its range and the command would move it further out."""
        low, high = self.limits.min_position, self.limits.max_position
        if low <= here <= high:
            return False
        above = low < here < high + NEAR and target >= 0.0
        below = low - NEAR < here < high and target <= 0.0
        return above or below or here > high + NEAR or here < low - NEAR

    def _bound_effort(self, actual: list[float]) -> None:
        limits, here, speed = self.limits, actual[POS], actual[VEL]
        low, high = -limits.max_effort, limits.max_effort
        if here <= limits.min_position and speed <= 0.0:  # False for nan
            low = 0.0
        elif here >= limits.max_position and speed >= 0.0:
            high = 0.0
        if speed < -limits.max_velocity:
            low = 0.0
        elif speed > limits.max_velocity:
            high = 0.0
        self._low, self._high = low, high

    def _most_acceleration(self, target: float, speed: float) -> float:
        slows_down = target * speed < 0.0
        if slows_down and math.isfinite(self.limits.max_deceleration):
            return self.limits.max_deceleration
        return self.limits.max_acceleration


# Soft joint limiter: slows a joint down before its soft limits, those of a URDF's <safety_controller>.
#
# Rules (joint_limits of ros2_control jazzy, JointSoftLimiter): towards a soft limit the velocity is at
# most `k_position` times the distance to it, beyond it leads back at one degree per second (of a prismatic joint: as
# many m/s), and an effort is at most `k_velocity` times what the velocity may still grow by. The hard limits
# hold besides.


_RETURN: Final = math.pi / 180.0
_NO_RANGE: Final = 1e-10


class SoftLimiter(JointLimiter):
    """Limiter of one joint's commands with hard and soft limits."""

    def __init__(self, limits: HardLimits, soft: SoftLimits) -> None:
        super().__init__(limits)
        self._soft = soft
        self._slowest = self._fastest = 0.0
        ends = math.isfinite(soft.lower) and math.isfinite(soft.upper)
        self._has_range = ends and soft.upper - soft.lower > _NO_RANGE
        slows = math.isfinite(soft.k_position) and abs(soft.k_position) > _NO_RANGE
        self._slows = self._has_range and slows and limits.has_ends and math.isfinite(limits.max_velocity)

    def _begin(self, actual: list[float], desired: list[float]) -> None:
        super()._begin(actual, desired)
        self._limit_speed(actual[POS])

    def _limit_speed(self, actual: float) -> None:
        """Compute the velocities permitted by the distances to the soft limits."""
        limits, soft, most = self.limits, self._soft, self.limits.max_velocity
        self._slowest, self._fastest = -most, most
        start = self._start(actual)
        if not (self._slows and math.isfinite(start)):
            return
        self._slowest = _clamp(-soft.k_position * (start - soft.lower), -most, most)
        self._fastest = _clamp(-soft.k_position * (start - soft.upper), -most, most)
        here = start if math.isnan(actual) else actual
        if here < limits.min_position - NEAR or here > limits.max_position + NEAR:
            self._slowest = self._fastest = 0.0
        elif here < soft.lower or here > soft.upper:
            self._slowest = math.copysign(_RETURN, self._slowest)
            self._fastest = math.copysign(_RETURN, self._fastest)

    def _start(self, actual: float) -> float:
        """Return the previous position command, else the joint's position."""
        before = self.before[POS]
        return before if math.isfinite(before) else actual

    def _bound(self, at: int, target: float, actual: list[float], period: float) -> None:
        super()._bound(at, target, actual, period)
        if at == POS:
            self._narrow_position(actual, period)
        elif at == VEL:
            self._narrow_velocity(actual, period)
        elif at == EFF:
            self._narrow_effort(actual)

    def _narrow_position(self, actual: list[float], period: float) -> None:
        low, high = (self._soft.lower, self._soft.upper) if self._has_range else (-math.inf, math.inf)
        start = self._start(actual[POS])
        if math.isfinite(self.limits.max_velocity) and math.isfinite(start):
            low = _clamp(start + self._slowest * period, low, high)
            high = _clamp(start + self._fastest * period, low, high)
        hard_low, hard_high = max(low, self._low), min(high, self._high)
        self._low, self._high = (hard_low, hard_high) if hard_low <= hard_high else (low, high)

    def _narrow_velocity(self, actual: list[float], period: float) -> None:
        limits, speed = self.limits, actual[VEL]
        if math.isfinite(limits.max_velocity) and math.isfinite(limits.max_acceleration) and not math.isnan(speed):
            change = limits.max_acceleration * period
            self._slowest, self._fastest = max(speed - change, self._slowest), min(speed + change, self._fastest)
        self._low = self._slowest = max(self._slowest, self._low)
        self._high = self._fastest = min(self._fastest, self._high)

    def _narrow_effort(self, actual: list[float]) -> None:
        most, k_velocity, speed = self.limits.max_effort, self._soft.k_velocity, actual[VEL]
        if not (math.isfinite(most) and math.isfinite(k_velocity)) or math.isnan(speed):
            return
        self._low = max(_clamp(-k_velocity * (speed - self._slowest), -most, most), self._low)
        self._high = min(_clamp(-k_velocity * (speed - self._fastest), -most, most), self._high)


def _clamp(value: float, low: float, high: float) -> float:
    return min(max(value, low), high)


# Commands that are limited together: those of one joint, or one with bounds of its own.
#
# Most commands advance by less than the limits allow. `passes` detects that with a few comparisons, if one quantity of
# a joint is commanded and it has no soft limits; only other commands are processed in full (`enforce`), with the same
# result for those that would have passed. The report of a limit comes at its begin, see `command_limits`.


QUIET_S: Final = 1.0  # without a limited command until the next one is reported again
_UNITS: Final = ("", "/s", None, "/s²", "/s³")  # after rad or m; an effort has its own
_ALMOST: Final = 1.0 - 1e-9  # what rounding leaves of a step
_MOST: Final = sys.float_info.max  # what is infinite is looked at closer

Commands = Sequence["CommandInterface"]
States = Sequence["StateInterface"]


class Limited(metaclass=ABCMeta):
    """Commands that are limited together; the full check runs only if `passes` is False."""

    __slots__ = ()

    def passes(self, period: float) -> bool:  # noqa: ARG002 - the verb of all of them
        """Whether the commands of this cycle are within every limit by a short check; False requires the full check."""
        return False

    @abstractmethod
    def enforce(self, period: float, clock: float) -> str | None:
        """Limit the commands; return commands and limits when limiting begins.

        `clock` is how much time has passed in the cycles until the end of this one, in s.
        """


class JointCommands(Limited):
    """Commands of one joint with its limiter and the last reported text."""

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
        self._limited_at = [-math.inf] * len(QUANTITIES)  # when a command had to be changed last
        self._starts = [math.nan, math.nan]

    def passes(self, period: float) -> bool:  # noqa: ARG002 - the verb of all of them
        """Whether the joint has no command; see `Limited`."""
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
        """See `Limited`."""
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
            value, target = desired[at], command.value
            if math.isnan(value):
                continue
            value = self._bounded(at, command, value) if at > VEL else self._changed(at, value, period)
            limiter.before[at] = command.value = value
            if value != target and (text := self._limit_text(at, command, target, value, period, clock)) is not None:
                told = text if told is None else f"{told}; {text}"
        return told

    def _begin(self, actual: list[float], before: list[float]) -> None:
        """Start from the last commands, else from the measured state; a joint outside its range starts at its limit."""
        limits, here = self._limits, actual[POS]
        self._starts[POS] = before[POS] if math.isfinite(before[POS]) else here
        if here < limits.min_position or here > limits.max_position:
            actual[POS] = min(max(here, limits.min_position), limits.max_position)
        if math.isnan(before[VEL]):
            before[VEL] = actual[VEL] if math.isfinite(actual[VEL]) else 0.0
        self._starts[VEL] = before[VEL]

    def _changed(self, at: int, value: float, period: float) -> float:
        """Return a position or velocity changed by at most its rate limit."""
        most = (self._limits.max_velocity if at == POS else self._limits.max_acceleration) * period
        start = self._starts[at]
        return min(max(value, start - most), start + most) if math.isfinite(start) else value

    # ------------------------------------------------------------------------------------------------- reports

    def _limit_text(
        self, at: int, command: CommandInterface, target: float, value: float, period: float, clock: float
    ) -> str | None:
        """Return the limits that changed the desired value to `value`, once when limiting begins."""
        begins, self._limited_at[at] = clock - self._limited_at[at] > QUIET_S, clock
        if not begins:
            return None
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
            reasons.append(f"what ends at {self._quantity(POS, end)}")
        if value != bounded:
            reasons.append(self._by_state(at, value, period))
        return f"{command.name}: {self._quantity(at, target)} is limited to {' and to '.join(reasons)}"

    def _bounded(self, at: int, command: CommandInterface, value: float) -> float:
        """Return a command within the constant limits."""
        limits = self._limits
        if at == POS:
            return min(max(value, limits.min_position), limits.max_position)
        most = (math.inf, limits.max_velocity, limits.max_effort, limits.max_acceleration, limits.max_jerk)[at]
        return min(max(value, -most, command.minimum), most, command.maximum)

    def _by_state(self, at: int, value: float, period: float) -> str:
        """Return the limit that depends on position and velocity of the joint."""
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
        """Return a value with the unit of the description."""
        length = "m" if self._joint.type == "prismatic" else "rad"
        if at == EFF:
            return f"{value:g} {'N' if length == 'm' else 'Nm'}"
        return f"{value:g} {length}{_UNITS[at]}"


class JointPosition(JointCommands):
    """Limiter of a joint with only a position command and no soft limits."""

    __slots__ = ("_before", "_command", "_high", "_low", "_rate", "_slope", "_speed")

    def __init__(self, joint: Joint, limits: HardLimits, commands: Commands, states: States) -> None:
        super().__init__(joint, limits, commands, states)
        self._command, self._before = commands[0], math.nan
        self._low, self._high = max(limits.min_position, -_MOST), min(limits.max_position, _MOST)
        self._rate, self._slope = limits.max_velocity, limits.max_acceleration
        self._speed = _state(states, VELOCITY)

    def passes(self, period: float) -> bool:
        """See `Limited`."""
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
        """See `Limited`."""
        before = self._limiter.before
        before[POS] = self._before
        text = super().enforce(period, clock)
        self._before = before[POS]
        return text


class JointVelocity(JointCommands):
    """Limiter of a joint with only a velocity command and no soft limits."""

    __slots__ = ("_before", "_command", "_here", "_high", "_low", "_rate", "_slope", "_speed")

    def __init__(self, joint: Joint, limits: HardLimits, commands: Commands, states: States) -> None:
        super().__init__(joint, limits, commands, states)
        self._command, self._before = commands[0], math.nan
        self._low, self._high, self._slope = limits.min_position, limits.max_position, limits.max_acceleration
        self._rate = min(limits.max_velocity, _MOST)
        self._here = _state(states, POSITION) if limits.has_ends else None
        self._speed = _state(states, VELOCITY)

    def passes(self, period: float) -> bool:
        """See `Limited`."""
        command, rate, before, change = self._command, self._rate, self._before, self._slope * period
        value = command.value
        if value != value or command.owner is None:
            speed = math.nan if self._speed is None else self._speed.value
            self._before = speed if -_MOST <= speed <= _MOST else 0.0
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
        """See `Limited`."""
        before = self._limiter.before
        before[VEL] = self._before
        text = super().enforce(period, clock)
        self._before = before[VEL]
        return text


class JointSeveral(Limited):
    """Limiter of a joint with several independent commands and no soft limits."""

    __slots__ = ("_parts",)

    def __init__(self, parts: Sequence[Limited]) -> None:
        self._parts = parts

    def passes(self, period: float) -> bool:
        """See `Limited`."""
        for part in self._parts:  # noqa: SIM110 - `all` would make a generator in the cycle
            if not part.passes(period):
                return False
        return True

    def enforce(self, period: float, clock: float) -> str | None:
        """See `Limited`."""
        told: str | None = None
        for part in self._parts:
            if period > 0.0 and part.passes(period):  # once more is not a difference
                continue
            if (text := part.enforce(period, clock)) is not None:
                told = text if told is None else f"{told}; {text}"
        return told


class PlainCommand(Limited):
    """Command of another quantity, with its own bounds."""

    __slots__ = ("_command", "_limited_at")

    def __init__(self, command: CommandInterface) -> None:
        self._command, self._limited_at = command, -math.inf

    def enforce(self, period: float, clock: float) -> str | None:  # noqa: ARG002 - the verb of all of them
        """See `Limited`."""
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
    """Return the fastest sufficient limiter for these commands of a joint."""
    if joint.soft is not None:
        return JointCommands(joint, limits, commands, states)
    parts = [_KINDS.get(command.interface, JointCommands)(joint, limits, [command], states) for command in commands]
    return parts[0] if len(parts) == 1 else JointSeveral(parts)


_TOLD_AT_ONCE = 3  # joints named in a sentence
_NO_BOUNDS: Final = InterfaceInfo("")


class CommandLimits:
    """Limits of all joints of a description."""

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
        """Limit commands; return the limited ones when limiting begins. `period` in s."""
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
    more = [f"and {len(texts) - _TOLD_AT_ONCE} more"] if len(texts) > _TOLD_AT_ONCE else []
    return "; ".join(texts[:_TOLD_AT_ONCE] + more)


def hard_limits(joint: Joint, part: ControlJoint, *, speeds: bool = True) -> HardLimits:
    """Return the limits of a joint by its <limit> and its command interfaces.

    Without `speeds` its velocity is unknown, and no acceleration of its positions can be limited.
    """
    limits, interfaces = joint.limits, part.command_interfaces
    position = interfaces.get(POSITION, _NO_BOUNDS)
    lower, upper = (position.minimum, position.maximum) if position.limited else (-math.inf, math.inf)
    faster, slower = _accelerations(interfaces.get(ACCELERATION, _NO_BOUNDS)) if speeds else (math.inf, math.inf)
    return HardLimits(
        max(limits.lower, lower),
        min(limits.upper, upper),
        min(limits.speed, _smaller(interfaces.get(VELOCITY, _NO_BOUNDS))),
        limits.effort,
        faster,
        slower,
        _smaller(interfaces.get(QUANTITIES[JERK], _NO_BOUNDS)),
    )


def _smaller(info: InterfaceInfo) -> float:
    """Return the smaller magnitude of the bounds of an interface."""
    return min(abs(info.minimum), info.maximum)


def _accelerations(info: InterfaceInfo) -> tuple[float, float]:
    """Return maximum acceleration and deceleration: `max` and |`min`|; a single value applies to both."""
    faster, slower = info.maximum, abs(info.minimum)
    return (faster if math.isfinite(faster) else slower), (slower if math.isfinite(slower) else faster)
