"""Stopping times of an axis: detection time of each stop reason plus the ramp from maximum speed.

The times are computed from a robot's files, printed by `check`, and compared with the simulated shafts by the
invariants of simulations. A stop is detected by heartbeat or guarding, by missing TPDOs, by the drive's monitoring of
the master, or by the end of a controller's command. The ramp is 0x6084 if the master stops the axis, and is selected by
0x6007, 0x605A and 0x605E if the drive stops by itself (CiA 402-2, 6.3.5). Times are in s, speeds in drive units.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from canopen_control.cia301.heartbeat import parse_consumer_entry
from canopen_control.cia402 import objects as o
from canopen_control.cia402.objects import ABORT_CONNECTION, DEFAULTS, OPTION_CODES, Reaction
from canopen_control.cia402.state import Command, State
from canopen_control.cia402.units import Scale
from canopen_control.controllers.limiters import LONGEST_STOP_S
from canopen_control.errors import CanopenError
from canopen_control.hardware.axis_parameters import planned_scales
from canopen_control.master.cycle import CYCLIC_SYNCHRONOUS
from canopen_control.od.indices import GUARD_TIME, HEARTBEAT_CONSUMER, LIFE_FACTOR
from canopen_control.runtime.sync_choice import axis_number, node_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from canopen_control.controllers.manager import ControllerManager
    from canopen_control.master.config import BusConfig
    from canopen_control.master.keys import NodeConfig
    from canopen_control.runtime.setup import RobotSetup
    from canopen_control.urdf.ros2_control import ControlJoint


DEFAULT_RAMP_S: Final = 0.5  # master's ramp for a drive without 0x6084, as in `hardware.mode_targets`
_RAMPS: Final = {Reaction.SLOW_DOWN_RAMP: o.PROFILE_DECELERATION, Reaction.QUICK_STOP_RAMP: o.QUICK_STOP_DECELERATION}

_LOST: Final[Mapping[Command | State | None, int]] = {
    State.FAULT: o.FAULT_REACTION_OPTION,
    Command.QUICK_STOP: o.QUICK_STOP_OPTION,
}


@dataclass(frozen=True, slots=True)
class AxisFacts:
    """Stop parameters of one axis; `speed` is inf if unlimited; a time is 0 if its supervision is not used.

    `objects` are object values by the index for the first axis; `lives` are command timeouts by controller,
    `brakes` the times that controllers take to brake from their velocity limits by their own deceleration.
    `own_unit` means that velocities have another unit than position units per s, and ramps possibly a third.
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
    brakes: Mapping[str, float] = field(default_factory=dict)
    own_unit: bool = False


@dataclass(frozen=True, slots=True)
class StopCase:
    """Stop for one reason, with the detection time and the ramp time in s; `by` names the ramp.

    `ramp_s` is inf if there is no ramp (`bound` is False), or if the speed has no limit.
    """

    cause: str
    detection_s: float
    ramp_s: float
    by: str
    bound: bool = True

    @property
    def total_s(self) -> float:
        """Time from the stop reason to standstill in s."""
        return self.detection_s + self.ramp_s


@dataclass(frozen=True, slots=True)
class StopTime:
    """Stopping times of one axis, with one case for each stop reason."""

    facts: AxisFacts
    cases: tuple[StopCase, ...]

    @property
    def longest(self) -> StopCase:
        """Case with the longest stopping time."""
        return max(self.cases, key=lambda case: (case.total_s, not case.bound, case.detection_s))

    @property
    def longest_s(self) -> float:
        """Longest stopping time in s; inf if unlimited."""
        return self.longest.total_s

    @property
    def slow_ramp(self) -> StopCase | None:
        """Case with the longest finite ramp, or None unless it is longer than `LONGEST_STOP_S`."""
        slow = [case for case in self.cases if case.bound and LONGEST_STOP_S < case.ramp_s < math.inf]
        return max(slow, key=lambda case: case.ramp_s, default=None)

    @property
    def words(self) -> str:
        """Longest stopping time as a line of text."""
        facts, case = self.facts, self.longest
        title = f"stop of {facts.joint}" + (f" ({facts.node})" if facts.node != facts.joint else "")
        if math.isinf(facts.speed) and case.bound:
            noticed = f"{case.cause} {case.detection_s:.3f} s"
            return f"{title}: {noticed}, then {case.by} from an unlimited speed"
        if math.isinf(case.total_s):
            return f"{title}: no limit if {case.cause}: {case.by}"
        total = f"{case.total_s:.3f} s at most from {facts.speed:.0f} units/s"
        return f"{title}: {total}: {case.cause} {case.detection_s:.3f} s, {case.by} {case.ramp_s:.3f} s"


def stop_time(facts: AxisFacts) -> StopTime:
    """Return the stopping times of an axis for all stop reasons."""
    return StopTime(facts, tuple(_cases(facts)))


def ramp_s(speed: float, deceleration: float | None) -> float:
    """Return the duration in s of a ramp from a speed to 0; inf without a deceleration."""
    return speed / deceleration if deceleration else (0.0 if speed == 0 else math.inf)


def _cases(facts: AxisFacts) -> Iterator[StopCase]:
    ramp, by = _masters_ramp(facts)
    yield StopCase("a stop is requested", facts.cycle_s, ramp, by)
    for name, life in facts.lives.items():
        brake = facts.brakes.get(name, 0.0)  # of the controller; the drive follows, or takes longer
        slowest = (brake, "its deceleration limit") if brake > ramp else (ramp, by)
        yield StopCase(f"the command of {name} ends", life + facts.cycle_s, *slowest)
    if facts.silence_s:
        yield StopCase("a node of its group is silent", facts.silence_s + facts.cycle_s, ramp, by)
    if facts.data_s:
        yield StopCase("the TPDOs of a node of its group are missing", facts.data_s + facts.cycle_s, ramp, by)
    if facts.master_s:
        yield StopCase("the master is silent", facts.master_s, *_drives_ramp(facts, _on_lost_master(facts)))
    yield StopCase("it has a fault", 0.0, *_drives_ramp(facts, o.FAULT_REACTION_OPTION))


def _masters_ramp(facts: AxisFacts) -> tuple[float, str]:
    """Return the duration in s and the name of the master's ramp."""
    slope = facts.objects.get(o.PROFILE_DECELERATION)
    if not slope:
        return DEFAULT_RAMP_S, "the master's ramp"
    return ramp_s(facts.speed, slope), _named(o.PROFILE_DECELERATION, slope)


def _on_lost_master(facts: AxisFacts) -> int | None:
    """Return the index of the option code for a lost master (0x6007), or None for a reaction without a ramp."""
    action = ABORT_CONNECTION.get(_option(facts, o.ABORT_CONNECTION_OPTION))
    return _LOST.get(action)


def _drives_ramp(facts: AxisFacts, option: int | None) -> tuple[float, str, bool]:
    """Return the duration in s and the name of the drive's own ramp, and whether it has one."""
    if option is None:
        return math.inf, f"0x6007 is {_option(facts, o.ABORT_CONNECTION_OPTION)}, a reaction without a ramp", False
    code = _option(facts, option)
    chosen = OPTION_CODES[option].get(code)
    reaction = None if chosen is None else chosen.reaction
    index = _RAMPS.get(reaction)  # type: ignore[arg-type]
    if index is None:
        why = "is manufacturer-specific" if chosen is None else f"means: {chosen.reaction.value}"
        return math.inf, f"0x{option:04X} is {code}, which {why}", False
    slope = facts.objects.get(index)
    if not slope:
        return math.inf, f"0x{index:04X} is unknown", False
    return ramp_s(facts.speed, slope), _named(index, slope), True


def _option(facts: AxisFacts, index: int) -> int:
    return facts.objects.get(index, DEFAULTS[index])


def _named(index: int, slope: float) -> str:
    return f"ramp of 0x{index:04X} ({slope:g})"


# The stop parameters in a robot's files: supervision times, decelerations, option codes, maximum speeds.
#
# The value of an object is written by bus.yml at the boot, or is the value in the DCF or EDS. The maximum speed is the
# lower of the joint's velocity limit and 0x607F.


_OBJECTS: Final = (
    o.PROFILE_DECELERATION,
    o.QUICK_STOP_DECELERATION,
    o.ABORT_CONNECTION_OPTION,
    o.QUICK_STOP_OPTION,
    o.FAULT_REACTION_OPTION,
)
_UNLIMITED: Final = 0x7FFFFFFF


def axis_facts(setup: RobotSetup, manager: ControllerManager | None = None) -> list[AxisFacts]:
    """Return the stop parameters of each joint with a drive; `manager` has the controllers that command the joints."""
    lives = {} if manager is None else command_timeouts(manager)
    brakes = {} if manager is None else {name: manager.get(name).brake_s for name in manager.states}
    return [
        _facts(setup, config, joint, node, lives.get(joint.name, {}), brakes)
        for config in setup.buses.values()
        for tag in setup.description.hardware
        for joint in tag.joints
        if (node := node_of(config, joint)) is not None and config.plans[node.name].axes
    ]


def command_timeouts(manager: ControllerManager) -> dict[str, dict[str, float]]:
    """Return the command timeouts in s by joint and loaded controller, except unlimited ones."""
    timeouts: dict[str, dict[str, float]] = {}
    for name in manager.states:
        controller = manager.get(name)
        try:
            interfaces = controller.command_interface_names()
        except CanopenError:
            continue
        if controller.command_timeout.limit_ns:
            for joint in {interface.partition("/")[0] for interface in interfaces}:
                timeouts.setdefault(joint, {})[name] = controller.command_timeout.limit_ns / 1e9
    return timeouts


def _facts(
    setup: RobotSetup,
    config: BusConfig,
    joint: ControlJoint,
    node: NodeConfig,
    lives: Mapping[str, float],
    brakes: Mapping[str, float],
) -> AxisFacts:
    number, cycle_s = axis_number(joint), setup.cycle_ns / 1e9
    value = _Values(config, node.name)
    objects = {
        index: number_read for index in _OBJECTS if (number_read := value(o.axis_index(index, number))) is not None
    }
    limits = setup.description.joints[joint.name].limits if joint.name in setup.description.joints else None
    most = math.inf if limits is None else limits.speed * abs(planned_scales(config, node.name, number)["vel_to_dev"])
    profile = value(o.axis_index(o.MAX_PROFILE_VELOCITY, number))
    if profile and profile < _UNLIMITED:
        most = min(most, profile)
    _, consumer_ms = parse_consumer_entry(value(HEARTBEAT_CONSUMER, 1) or 0)
    guarded_ms = (value(GUARD_TIME) or 0) * (value(LIFE_FACTOR) or 0)
    return AxisFacts(
        joint.name,
        node.name,
        node.node_id,
        most,
        cycle_s,
        silence_s=max(plan.supervision_ns for plan in config.plans.values()) / 1e9,
        data_s=max(_data_s(config, name, cycle_s) for name in config.plans),
        master_s=(consumer_ms or guarded_ms) / 1e3,
        axis=number,
        objects=objects,
        lives=lives,
        brakes={name: brakes[name] for name in lives},
        own_unit=Scale(**node.units.of_axis(number)).has_own_velocity_unit,
    )


def _data_s(config: BusConfig, name: str, cycle_s: float) -> float:
    """Return the time in s until missing synchronous TPDOs are detected; 0 without any, or without SYNC."""
    if not config.master.sync_period:
        return 0.0
    every = [tpdo.transmission_type for tpdo in config.plans[name].tpdos]
    missed = config.nodes[name].supervision.missed_syncs
    return max((missed * factor * cycle_s for factor in every if factor in CYCLIC_SYNCHRONOUS), default=0.0)


class _Values:
    """Values of a node's objects after the boot, from bus.yml, DCF or EDS; None if unknown."""

    def __init__(self, config: BusConfig, name: str) -> None:
        self._od, self._address = config.dictionaries[name], config.plans[name].address
        self._written = {(write.index, write.subindex): write.data for write in config.plans[name].writes}

    def __call__(self, index: int, subindex: int = 0) -> int | None:
        data = self._written.get(self._address(index, subindex))
        if data is not None:
            return int.from_bytes(data, "little", signed=index & 0x7FF in _CODES)
        return self._od.number(index, subindex)


_CODES: Final = tuple(index & 0x7FF for index in _OBJECTS[2:])
