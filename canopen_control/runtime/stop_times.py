"""How long an axis takes to stand: the time until each reason to stop is noticed, and the ramp from its greatest speed.

Pure computation of what a robot's files say: `check` prints it, and the invariants of simulations hold the shafts
against it. Detection is by heartbeat or guarding, by TPDOs that stay away, by the drive's own watch of its master, and
by the end of a controller's command. The ramp is 0x6084 where the master stops the axis, and what 0x6007, 0x605A and
0x605E choose where the drive stops by itself (CiA 402-2, 6.3.5). Seconds; speeds in the drive's units.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from canopen_control.cia402 import objects as o
from canopen_control.cia402.options import ABORT_CONNECTION, DEFAULTS, OPTION_CODES, Reaction
from canopen_control.cia402.state import Command, State

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

__all__ = ["AxisFacts", "StopCase", "StopTime", "stop_time"]

DEFAULT_RAMP_S: Final = 0.5  # of a master's ramp where the drive has no 0x6084, as `hardware.joint_targets` makes it
_RAMPS: Final = {Reaction.SLOW_DOWN_RAMP: o.PROFILE_DECELERATION, Reaction.QUICK_STOP_RAMP: o.QUICK_STOP_DECELERATION}

_LOST: Final[Mapping[Command | State | None, int]] = {
    State.FAULT: o.FAULT_REACTION_OPTION,
    Command.QUICK_STOP: o.QUICK_STOP_OPTION,
}


@dataclass(frozen=True, slots=True)
class AxisFacts:
    """What the files say of one axis; `speed` is inf where nothing limits it, a time 0 where nobody watches.

    `objects` are values of its dictionary by index of the first axis; `lives` how long a command of each controller
    holds.
    """

    joint: str
    node: str
    node_id: int
    speed: float
    cycle_s: float
    silence_s: float = 0.0
    data_s: float = 0.0
    master_s: float = 0.0
    axis: int = 0
    objects: Mapping[int, int] = field(default_factory=dict)
    lives: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class StopCase:
    """One reason to stop: until it is noticed, and how long the ramp takes then; `by` says which.

    `ramp_s` is inf where nothing bounds it: without a ramp (`bound` False), or from a speed without a limit.
    """

    cause: str
    detection_s: float
    ramp_s: float
    by: str
    bound: bool = True

    @property
    def total_s(self) -> float:
        """Until the shaft stands, in s."""
        return self.detection_s + self.ramp_s


@dataclass(frozen=True, slots=True)
class StopTime:
    """The stop times of one axis, a case for each reason."""

    facts: AxisFacts
    cases: tuple[StopCase, ...]

    @property
    def longest(self) -> StopCase:
        """The reason after which it takes longest."""
        return max(self.cases, key=lambda case: (case.total_s, not case.bound, case.detection_s))

    @property
    def longest_s(self) -> float:
        """The longest stop in s; inf where nothing bounds it."""
        return self.longest.total_s

    @property
    def words(self) -> str:
        """The longest stop in one line."""
        facts, case = self.facts, self.longest
        where = f"stop of {facts.joint} ({facts.node})"
        if math.isinf(facts.speed) and case.bound:
            noticed = f"{case.cause} {case.detection_s:.3f} s"
            return f"{where}: {noticed}, then {case.by} from a speed that the files do not limit"
        if math.isinf(case.total_s):
            return f"{where}: nothing bounds it when {case.cause}: {case.by}"
        total = f"{case.total_s:.3f} s at most from {facts.speed:.0f} units/s"
        return f"{where}: {total}: {case.cause} {case.detection_s:.3f} s, {case.by} {case.ramp_s:.3f} s"


def stop_time(facts: AxisFacts) -> StopTime:
    """Return how long an axis takes to stand after each reason to stop."""
    return StopTime(facts, tuple(_cases(facts)))


def ramp_s(speed: float, deceleration: float | None) -> float:
    """Return how long a ramp from a speed takes; inf without a deceleration."""
    return speed / deceleration if deceleration else (0.0 if speed == 0 else math.inf)


def _cases(facts: AxisFacts) -> Iterator[StopCase]:
    ramp, by = _masters_ramp(facts)
    yield StopCase("a stop is asked", facts.cycle_s, ramp, by)
    for name, life in facts.lives.items():
        yield StopCase(f"the command of {name} ends", life + facts.cycle_s, ramp, by)
    if facts.silence_s:
        yield StopCase("a node of its group is silent", facts.silence_s + facts.cycle_s, ramp, by)
    if facts.data_s:
        yield StopCase("the TPDOs of a node of its group stay away", facts.data_s + facts.cycle_s, ramp, by)
    if facts.master_s:
        yield StopCase("the master is silent", facts.master_s, *_drives_ramp(facts, _on_lost_master(facts)))
    yield StopCase("it has a fault", 0.0, *_drives_ramp(facts, o.FAULT_REACTION_OPTION))


def _masters_ramp(facts: AxisFacts) -> tuple[float, str]:
    """Return how long the ramp after the master's word takes, and what makes it."""
    slope = facts.objects.get(o.PROFILE_DECELERATION)
    if not slope:
        return DEFAULT_RAMP_S, "the master's ramp"
    return ramp_s(facts.speed, slope), _named(o.PROFILE_DECELERATION, slope)


def _on_lost_master(facts: AxisFacts) -> int | None:
    """Return the option code that a lost master leads to by 0x6007; None: the axis goes on, or coasts."""
    action = ABORT_CONNECTION.get(_option(facts, o.ABORT_CONNECTION_OPTION))
    return _LOST.get(action)


def _drives_ramp(facts: AxisFacts, option: int | None) -> tuple[float, str, bool]:
    """Return how long the drive's own stop takes, by which object, and whether that is a ramp."""
    if option is None:
        return math.inf, f"0x6007 is {_option(facts, o.ABORT_CONNECTION_OPTION)}, with which no ramp stops it", False
    code = _option(facts, option)
    chosen = OPTION_CODES[option].get(code)
    reaction = None if chosen is None else chosen.reaction
    index = _RAMPS.get(reaction)  # type: ignore[arg-type]
    if index is None:
        why = "is the manufacturer's own" if chosen is None else f"means: {chosen.reaction.value}"
        return math.inf, f"0x{option:04X} is {code}, which {why}", False
    slope = facts.objects.get(index)
    if not slope:
        return math.inf, f"0x{index:04X} is not known", False
    return ramp_s(facts.speed, slope), _named(index, slope), True


def _option(facts: AxisFacts, index: int) -> int:
    return facts.objects.get(index, DEFAULTS[index])


def _named(index: int, slope: float) -> str:
    return f"ramp of 0x{index:04X} ({slope:g})"
