"""Conversion of a recording to a scenario with the client requests and bus faults at their times.

Commands are the recorded requests (of a flight recording); faults are derived from the frames. In a scenario the robot
boots first: if a recording begins later than its robot, one second is inserted for the boot.
"""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Final

from canopen_control.errors import ConfigError
from canopen_control.rpc.messages import robot as messages
from canopen_control.rpc.messages.robot import ROBOT
from canopen_control.rpc.messages.trajectory import FollowTrajectory, SendTrajectory, SetTrajectory, TrajectoryData
from canopen_control.rpc.wire import decode
from canopen_control.simulation.motions import SampleMotion, motions_of
from canopen_control.simulation.robot_under_test import MASTER
from canopen_control.simulation.scenario_steps import ACTIONS, Scenario
from canopen_control.virtual.scenario import ScenarioEvent

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from canopen_control.frame import CanFrame
    from canopen_control.master.config import BusConfig
    from canopen_control.master.plan import NodePlan
    from canopen_control.rpc.messages.robot import RequestSeen
    from canopen_control.rpc.messages.state import RobotEvent
    from canopen_control.runtime.setup import RobotSetup

    Frames = Sequence[tuple[int, CanFrame]]


# Bus faults from recorded frames. A recording shows effects, not causes: a silent node becomes a cut cable, a node that
# boots afterwards a supply failure, an EMCY a fault with this code or, without such a fault, the over-temperature
# fault; a silent master is stalled, or killed if it boots its nodes again. Times are Unix times in ns.


_MS: Final = 1_000_000
_S: Final = 1_000_000_000
_NMT_STOP, _NMT_PRE_OPERATIONAL = 0x02, 0x80
_NMT_RESETS: Final = (0x81, 0x82)
_RESET_NS: Final = 6 * _S  # time in which a node boots after a reset command
_QUIET_NS: Final = 1 * _S  # silence of a node without a heartbeat
_FAULTS: Final = {
    0x2320: "short_circuit",
    0x3220: "undervoltage",
    0x4310: "drive_fault",
    0x5000: "device_error",
    0x5441: "fault_on_enable",
    0x8120: "error_passive",
    0x8611: "following_error",
}
# faults whose end is reported by EMCY "no error" without a fault reset
_PASSING: Final = ("device_error", "error_passive")
_OTHER: Final = "drive_fault"


@dataclass(slots=True)
class _Receptions:
    """Reception times of a node's frames: any frame, heartbeats, boot-ups, and EMCY with error codes."""

    any: list[int]
    alive: list[int]
    boots: list[int]
    emcy: list[tuple[int, int]]


class BusHistory:
    """Faults on one bus, inferred from its frames; `resets` are the times of fault reset requests in Unix ns."""

    def __init__(self, config: BusConfig, frames: Frames, resets: Sequence[int] = ()) -> None:
        self._config, self._frames, self._resets = config, frames, sorted(resets)
        self._plans = {plan.node_id: plan for plan in config.plans.values()}
        self._receptions = {node: _Receptions([], [], [], []) for node in self._plans}
        self._nmt: list[tuple[int, int, int]] = []  # time, command, node
        self._master: list[int] = []
        self._end = frames[-1][0] if frames else 0
        self._sort()

    def _sort(self) -> None:
        owners = {base + node: node for node in self._plans for base in (0x080, 0x580, 0x700)}
        for node, plan in self._plans.items():
            owners |= {tpdo.cob_id: node for tpdo in plan.tpdos}
        ours = (0x080, 0x700 + self._config.master.node_id)
        for now, frame in self._frames:
            can_id, data = frame.can_id, frame.data
            if can_id in ours:
                self._master.append(now)
            elif can_id == 0 and len(data) >= 2:
                self._nmt.append((now, data[0], data[1]))
            elif can_id in owners:
                self._note(owners[can_id], now, frame)

    def _note(self, node: int, now: int, frame: CanFrame) -> None:
        receptions, can_id, data = self._receptions[node], frame.can_id, frame.data
        receptions.any.append(now)
        if can_id == 0x080 + node and len(data) >= 2:
            receptions.emcy.append((now, int.from_bytes(data[:2], "little")))
        elif can_id == 0x700 + node:
            (receptions.boots if data[:1] == b"\0" else receptions.alive).append(now)

    def acts(self) -> Iterator[ScenarioEvent]:
        """Yield the events of faults, and of NMT commands that stop nodes; `at_ns` is Unix time."""
        yield from self._of_master()
        for now, command, node in self._nmt:
            if command in (_NMT_STOP, _NMT_PRE_OPERATIONAL):
                yield ScenarioEvent(now, "frame", values=(0.0, float(command), float(node)))
        for node, plan in self._plans.items():
            yield from self._of_node(node, plan, self._receptions[node])

    # -- the master

    def _of_master(self) -> Iterator[ScenarioEvent]:
        for begin, end in self._silences():
            booted = any(begin < now < (end or begin) + _S and command in _NMT_RESETS for now, command, _ in self._nmt)
            lasts = None if end is None else end - begin
            yield (
                ScenarioEvent(begin, "kill", for_ns=lasts)
                if booted or end is None
                else ScenarioEvent(begin, "stall", MASTER, for_ns=lasts)
            )

    def _silences(self) -> list[tuple[int, int | None]]:
        """Return the intervals without SYNC or heartbeat of the master; the end is None if none follows."""
        config = self._config.master
        period = max(config.sync_period * 1000, 0 if config.sync_period else config.heartbeat_ms * _MS)
        return _gaps(self._master, 5 * period, self._end) if period else []

    # -- a node

    def _of_node(self, node: int, plan: NodePlan, receptions: _Receptions) -> Iterator[ScenarioEvent]:
        limit = plan.heartbeat_timeout_ns or _QUIET_NS
        silences = _gaps(receptions.any, limit, self._end)
        for begin, end in silences:
            if end is None or end not in receptions.boots:
                yield ScenarioEvent(begin, "cut", str(node), for_ns=None if end is None else end - begin)
            elif not self._was_reset(node, end):
                yield ScenarioEvent(begin, "power", str(node), for_ns=end - begin)
        if plan.heartbeat_timeout_ns:
            for begin, end in _gaps(receptions.alive, limit, self._end):
                if not any(begin < (to or self._end) and at < (end or self._end) for at, to in silences):
                    lasts = None if end is None else end - begin
                    yield ScenarioEvent(begin, "fault", str(node), "heartbeat_lost", for_ns=lasts)
        ends = {end for _, end in silences}
        for boot in receptions.boots:
            if receptions.any[0] < boot and boot not in ends and not self._was_reset(node, boot):
                yield ScenarioEvent(boot, "fault", str(node), "spontaneous_reset")
        yield from self._emergencies(node, receptions.emcy)

    def _was_reset(self, node: int, boot: int) -> bool:
        """Whether a boot follows shortly after a reset command to the node."""
        return any(
            command in _NMT_RESETS and about in (0, node) and boot - _RESET_NS < now < boot
            for now, command, about in self._nmt
        )

    def _emergencies(self, node: int, emergencies: Sequence[tuple[int, int]]) -> Iterator[ScenarioEvent]:
        shown: str | None = None
        for number, (now, code) in enumerate(emergencies):
            if code == 0:
                shown = None
            elif shown is None and not _is_consequence(code):
                shown = _FAULTS.get(code, _OTHER)
                end = next((at for at, later in emergencies[number:] if later == 0), None)
                off = None if end is None else max(now + _MS, self._ended(end, shown))
                yield ScenarioEvent(now, "fault", str(node), shown, for_ns=None if off is None else off - now)

    def _ended(self, end: int, fault: str) -> int:
        """Return the estimated end of a fault's cause, shortly before the fault reset that led to `end`."""
        if fault in _PASSING:
            return end
        at = bisect_left(self._resets, end)
        return (self._resets[at - 1] if at and end - self._resets[at - 1] < _S else end) - 50 * _MS


def _gaps(times: Sequence[int], limit: int, end: int) -> list[tuple[int, int | None]]:
    """Return the intervals longer than `limit` without a frame; the end is None if no frame follows."""
    gaps: list[tuple[int, int | None]] = [
        (last + _MS, after) for last, after in pairwise(times) if after - last > limit
    ]
    return gaps + ([(times[-1] + _MS, None)] if times and end - times[-1] > limit else [])


def _is_consequence(code: int) -> bool:
    """Whether an EMCY reports the effect of a communication fault: 0x81xx or 0x82xx, but not error passive."""
    return code >> 8 in (0x81, 0x82) and code != 0x8120


_LED_NS: Final = 20 * _MS  # delay from the start of a simulation to the start of its robot
_BEFORE_NS: Final = 1 * _S
_TOGETHER_NS: Final = 250 * _MS  # two equal commands within this time are merged


@dataclass(slots=True)
class RecordedRobot:
    """Contents of a recording: frames, events, requests, and controllers active at its start."""

    frames: Sequence[tuple[int, str, CanFrame]]
    events: Sequence[RobotEvent] = ()
    requests: Sequence[RequestSeen] = ()
    active: Sequence[str] = field(default_factory=tuple)


def scenario_of_recording(recorded: RecordedRobot, setup: RobotSetup) -> Scenario:
    """Convert a recording to a scenario; raise ConfigError if it has no frames of the robot's buses."""
    known = [item for item in recorded.frames if item[1] in setup.buses]
    if not known:
        buses = ", ".join(sorted({bus for _, bus, _ in recorded.frames})) or "no bus"
        raise ConfigError(f"the recording has frames of {buses}, but the robot has the buses {', '.join(setup.buses)}")
    end = _end(recorded, known[-1][0])
    origin, early = _origin(recorded, known[0][0])
    requests = RequestActs(motions_of(setup))
    requested = [act for item in recorded.requests for act in requests.acts(item)]
    resets = [act.at_ns for act in requested if act.name == "fault-reset"]
    acts = [*_merged(requested), *(_initial(recorded, setup, origin) if early else ())]
    for name, config in setup.buses.items():
        frames = [(now, frame) for now, bus, frame in known if bus == name and now <= end]
        acts += BusHistory(config, frames, resets).acts()
    placed = [_placed(act, origin) for act in acts if origin <= act.at_ns <= end]
    return Scenario(tuple(sorted(placed, key=lambda act: act.at_ns)), _whole(end - origin), 0)


def _whole(time_ns: int) -> int:
    return max(_MS, round(time_ns / _MS) * _MS)


def _placed(act: ScenarioEvent, origin: int) -> ScenarioEvent:
    """Shift an event to a time relative to `origin`, in whole ms."""
    lasts = None if act.for_ns is None else _whole(act.for_ns)
    return replace(act, at_ns=round((act.at_ns - origin) / _MS) * _MS, for_ns=lasts)


def _end(recorded: RecordedRobot, last: int) -> int:
    """Return the end of the recording, or the time of the robot's shutdown if that is earlier."""
    ended = [round(event.time * 1e9) for event in recorded.events if event.kind == "stopping"]
    return min([last, *ended])


def _origin(recorded: RecordedRobot, first: int) -> tuple[int, bool]:
    """Return time 0 of the scenario, and whether the recording began after the robot's start."""
    began = min((round(event.first * 1e9) for event in recorded.events), default=0)
    return (began - _LED_NS, False) if began > first - _S else (first - _BEFORE_NS, True)


def _initial(recorded: RecordedRobot, setup: RobotSetup, origin: int) -> Iterator[ScenarioEvent]:
    """Yield activations of controllers that were active at the start of the recording, but are not by default."""
    for name in recorded.active:
        config = setup.controllers.controllers.get(name)
        if config is not None and name not in setup.to_activate and "broadcaster" not in config.type.lower():
            yield ScenarioEvent(origin + _BEFORE_NS - 300 * _MS, "activate", name)


def _merged(acts: Iterable[ScenarioEvent]) -> list[ScenarioEvent]:
    """Return the events in order of time, merging repeated equal commands into one."""
    merged: list[ScenarioEvent] = []
    latest: dict[str, tuple[int, int]] = {}  # controller -> its last command, and when it was renewed
    for act in sorted(acts, key=lambda act: act.at_ns):
        number, renewed = latest.get(act.target, (-1, 0))
        if act.kind == "command" and number >= 0:
            begun = merged[number]
            if begun.values == act.values and act.at_ns - renewed <= _TOGETHER_NS:
                merged[number] = replace(begun, for_ns=act.at_ns - begun.at_ns + 50 * _MS)
                latest[act.target] = (number, act.at_ns)
                continue
        if act.kind == "command":
            latest[act.target] = (len(merged), act.at_ns)
        merged.append(act)
    return merged


class RequestActs:
    """Converter of client requests to events; stores trajectory points that arrive before their request."""

    def __init__(self, motions: Sequence[SampleMotion]) -> None:
        self._motions: Mapping[str, SampleMotion] = {motion.controller: motion for motion in motions}
        self._points: list[Any] = []

    def acts(self, record: RequestSeen) -> Iterator[ScenarioEvent]:
        """Yield the events of a request, with Unix time as `at_ns`; none if the request has no effect on motion."""
        method = ROBOT.methods.get(record.method)
        if method is None:
            return
        try:
            request = decode(record.params, method.request)
        except ValueError:
            return  # file of another version
        for act in self._of(request):
            yield replace(act, at_ns=round(record.time * 1e9))

    def _of(self, request: object) -> Iterator[ScenarioEvent]:
        if isinstance(request, messages.CommandController):
            yield ScenarioEvent(0, "command", request.controller, values=tuple(request.values))
        elif isinstance(request, messages.TwistController):
            sideways = (
                len(self._motions[request.controller].ranges) > 2 if request.controller in self._motions else False
            )
            middle = (request.lateral,) if sideways else ()
            yield ScenarioEvent(0, "command", request.controller, values=(request.linear, *middle, request.angular))
        elif isinstance(request, TrajectoryData):
            self._points += request.points
        elif isinstance(request, FollowTrajectory | SendTrajectory | SetTrajectory):
            yield from self._trajectory(request)
        elif isinstance(request, messages.Stop):
            yield ScenarioEvent(0, "latch" if request.latch else "stop")
        elif isinstance(request, messages.Release):
            yield ScenarioEvent(0, "release")
        elif isinstance(request, messages.AxisRequest) and request.action in ACTIONS:
            all_nodes = str(request.node) == "all"
            yield ScenarioEvent(0, "axis", "" if all_nodes else str(request.node), str(request.action))
        elif isinstance(request, messages.SwitchControllers):
            yield from (ScenarioEvent(0, "deactivate", name) for name in request.deactivate if not request.activate)
            yield from (ScenarioEvent(0, "activate", name) for name in request.activate)

    def _trajectory(self, request: FollowTrajectory | SendTrajectory | SetTrajectory) -> Iterator[ScenarioEvent]:
        points, self._points = [*self._points, *request.points], []
        motion = self._motions.get(request.controller)
        order = motion.joints if motion is not None and set(motion.joints) == set(request.joints) else request.joints
        places = [request.joints.index(joint) for joint in order]
        valid = [point for point in points if len(point.positions) == len(places) and point.time_from_start > 0]
        values = tuple(point.positions[place] for point in valid for place in places)
        if values:
            yield ScenarioEvent(
                0, "trajectory", request.controller, values=values, times=tuple(e.time_from_start for e in valid)
            )
