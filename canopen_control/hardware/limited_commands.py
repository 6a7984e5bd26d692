"""Commands that are limited together: those of one joint, or one with bounds of its own.

The law of this file: most commands lead on by less than the limits allow. `passes` finds that out by a few comparisons,
where one quantity of a joint is commanded and it has no soft limits; only what does not pass is judged in full
(`enforce`), with the same result for what would have passed. What is told of a limit is told where that begins, see
`command_limits`.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

from canopen_control.hardware.interfaces import POSITION, VELOCITY
from canopen_control.hardware.joint_limiter import ACC, EFF, NOTHING, POS, QUANTITIES, VEL, JointLimiter
from canopen_control.hardware.soft_limiter import SoftLimiter

if TYPE_CHECKING:
    from collections.abc import Mapping

    from canopen_control.hardware.interfaces import CommandInterface, StateInterface
    from canopen_control.urdf.joint_element import HardLimits, Joint

__all__ = ["Commands", "JointCommands", "Limited", "PlainCommand", "States", "limited_joint"]

QUIET_S: Final = 1.0  # without a limited command, and the next one is told again
_UNITS: Final = ("", "/s", None, "/s²", "/s³")  # after rad or m; an effort has its own
_ALMOST: Final = 1.0 - 1e-9  # what rounding leaves of a step
_MOST: Final = sys.float_info.max  # what is infinite is looked at closer

Commands = Sequence["CommandInterface"]
States = Sequence["StateInterface"]


class Limited:
    """Commands that are limited together; they are judged in full only where `passes` does not let them through."""

    __slots__ = ()

    def passes(self, period: float) -> bool:  # noqa: ARG002 - the verb of all of them
        """Whether the commands of this cycle are within every limit, known by a few comparisons; False: look closer."""
        return False

    def enforce(self, period: float, clock: float) -> str | None:
        """Clamp the commands; return what was asked for and what limits it, where that begins.

        `clock` is how much time has passed in the cycles until the end of this one, in s.
        """
        raise NotImplementedError


class JointCommands(Limited):
    """The commands of one joint, its limiter, and what was told of them."""

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
        self._commands = [(QUANTITIES.index(each.interface), each) for each in commands]
        self._states = [(QUANTITIES.index(each.interface), each) for each in states]
        self._actual, self._desired = list(NOTHING), list(NOTHING)
        self._limited_at = [-math.inf] * len(QUANTITIES)  # when a command had to be changed last
        self._starts = [math.nan, math.nan]

    def passes(self, period: float) -> bool:  # noqa: ARG002 - the verb of all of them
        """See `Limited`; only what is not commanded passes."""
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
            value, wanted = desired[at], command.value
            if math.isnan(value):
                continue
            value = self._bounded(at, command, value) if at > VEL else self._changed(at, value, period)
            limiter.before[at] = command.value = value
            if value != wanted and (text := self._told(at, command, wanted, value, period, clock)) is not None:
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
        most = (self._limits.max_velocity if at == POS else self._limits.max_acceleration) * period
        start = self._starts[at]
        return min(max(value, start - most), start + most) if math.isfinite(start) else value

    # ------------------------------------------------------------------------------------------------- what is told

    def _told(
        self, at: int, command: CommandInterface, wanted: float, value: float, period: float, clock: float
    ) -> str | None:
        """Return the limits that made `value` of what was wanted, where that begins."""
        begins, self._limited_at[at] = clock - self._limited_at[at] > QUIET_S, clock
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


class JointPosition(JointCommands):
    """The position of a joint of which nothing else is commanded, and that has no soft limits."""

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
        told = super().enforce(period, clock)
        self._before = before[POS]
        return told


class JointVelocity(JointCommands):
    """The velocity of a joint of which nothing else is commanded, and that has no soft limits."""

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
        told = super().enforce(period, clock)
        self._before = before[VEL]
        return told


class JointSeveral(Limited):
    """Several commands of a joint that has no soft limits: none of them changes what another one may be."""

    __slots__ = ("_parts",)

    def __init__(self, parts: Sequence[Limited]) -> None:
        self._parts = parts

    def passes(self, period: float) -> bool:
        """See `Limited`."""
        for each in self._parts:  # noqa: SIM110 - `all` would make a generator in the cycle
            if not each.passes(period):
                return False
        return True

    def enforce(self, period: float, clock: float) -> str | None:
        """See `Limited`."""
        told: str | None = None
        for each in self._parts:
            if period > 0.0 and each.passes(period):  # once more is no difference
                continue
            if (text := each.enforce(period, clock)) is not None:
                told = text if told is None else f"{told}; {text}"
        return told


class PlainCommand(Limited):
    """A command of another quantity, with its own bounds."""

    __slots__ = ("_command", "_limited_at")

    def __init__(self, command: CommandInterface) -> None:
        self._command, self._limited_at = command, -math.inf

    def enforce(self, period: float, clock: float) -> str | None:  # noqa: ARG002 - the verb of all of them
        """See `Limited`."""
        command, wanted = self._command, self._command.value
        if command.owner is None or command.minimum <= wanted <= command.maximum or math.isnan(wanted):
            return None
        command.value = min(max(wanted, command.minimum), command.maximum)
        begins, self._limited_at = clock - self._limited_at > QUIET_S, clock
        return f"{command.name}: {wanted:g} is limited to {command.value:g}" if begins else None


def _state(states: States, interface: str) -> StateInterface | None:
    return next((each for each in states if each.interface == interface), None)


_KINDS: Final[Mapping[str, type[JointCommands]]] = MappingProxyType({POSITION: JointPosition, VELOCITY: JointVelocity})


def limited_joint(joint: Joint, limits: HardLimits, commands: Commands, states: States) -> Limited:
    """Return what limits these commands of a joint with the least work."""
    if joint.soft is not None:
        return JointCommands(joint, limits, commands, states)
    parts = [_KINDS.get(each.interface, JointCommands)(joint, limits, [each], states) for each in commands]
    return parts[0] if len(parts) == 1 else JointSeveral(parts)
