"""A recording of a robot as a scenario: what clients asked for, and what went wrong on the buses, at the same times.

Commands are those that the recording holds (requests, of a flight recording); what broke is read off the frames. The
robot boots at the beginning of a scenario: where a recording begins later than its robot, a second goes before it.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Final

from canopen_control.errors import ConfigError
from canopen_control.rpc.messages import robot as messages
from canopen_control.rpc.messages.robot import ROBOT
from canopen_control.rpc.wire import decode
from canopen_control.simulation.acts import Act
from canopen_control.simulation.motions import Motion, motions_of
from canopen_control.simulation.recorded_faults import BusHistory
from canopen_control.simulation.scenario_steps import Scenario

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from canopen_control.frame import CanFrame
    from canopen_control.rpc.messages.robot import Asked
    from canopen_control.rpc.messages.state import RobotEvent
    from canopen_control.runtime.setup import RobotSetup

__all__ = ["RecordedRobot", "RequestActs", "scenario_of_recording"]

_MS: Final = 1_000_000
_S: Final = 1_000_000_000
_LED_NS: Final = 20 * _MS  # from the start of a simulation to that of its robot
_BEFORE_NS: Final = 1 * _S
_TOGETHER_NS: Final = 250 * _MS  # of two equal commands that are one
_ACTIONS: Final = {"enable", "disable", "halt", "quick-stop", "fault-reset"}


@dataclass(slots=True)
class RecordedRobot:
    """What a recording holds: frames by Unix ns and bus, events and requests; `active` controllers at its beginning."""

    frames: Sequence[tuple[int, str, CanFrame]]
    events: Sequence[RobotEvent] = ()
    requests: Sequence[Asked] = ()
    active: Sequence[str] = field(default_factory=tuple)


def scenario_of_recording(recorded: RecordedRobot, setup: RobotSetup) -> Scenario:
    """Return the scenario; ConfigError for a recording without a frame, or of other buses than the robot has."""
    known = [each for each in recorded.frames if each[1] in setup.buses]
    if not known:
        there = ", ".join(sorted({bus for _, bus, _ in recorded.frames})) or "no frame"
        raise ConfigError(f"the recording holds {there}, the robot has the buses {', '.join(setup.buses)}")
    end = _end(recorded, known[-1][0])
    origin, early = _origin(recorded, known[0][0])
    requests = RequestActs(motions_of(setup))
    asked = [act for each in recorded.requests for act in requests.acts(each)]
    resets = [act.at_ns for act in asked if act.name == "fault-reset"]
    acts = [*_merged(asked), *(_initial(recorded, setup, origin) if early else ())]
    for name, config in setup.buses.items():
        frames = [(now, frame) for now, bus, frame in known if bus == name and now <= end]
        acts += BusHistory(config, frames, resets).acts()
    placed = [_placed(act, origin) for act in acts if origin <= act.at_ns <= end]
    return Scenario(tuple(sorted(placed, key=lambda act: act.at_ns)), _whole(end - origin), 0)


def _whole(time_ns: int) -> int:
    return max(_MS, round(time_ns / _MS) * _MS)


def _placed(act: Act, origin: int) -> Act:
    """Return an act at whole ms after the beginning."""
    lasts = None if act.for_ns is None else _whole(act.for_ns)
    return replace(act, at_ns=round((act.at_ns - origin) / _MS) * _MS, for_ns=lasts)


def _end(recorded: RecordedRobot, last: int) -> int:
    """Return when the recording ends, or its robot was ended."""
    ended = [round(each.time * 1e9) for each in recorded.events if each.kind == "stopping"]
    return min([last, *ended])


def _origin(recorded: RecordedRobot, first: int) -> tuple[int, bool]:
    """Return what is time 0 of the scenario, and whether the robot ran before the recording began."""
    began = min((round(each.first * 1e9) for each in recorded.events), default=0)
    return (began - _LED_NS, False) if began > first - _S else (first - _BEFORE_NS, True)


def _initial(recorded: RecordedRobot, setup: RobotSetup, origin: int) -> Iterator[Act]:
    """Yield the switch to the controllers that were active when the recording began."""
    for name in recorded.active:
        config = setup.controllers.controllers.get(name)
        if config is not None and name not in setup.to_activate and "broadcaster" not in config.type.lower():
            yield Act(origin + _BEFORE_NS - 300 * _MS, "activate", name)


def _merged(acts: Iterable[Act]) -> list[Act]:
    """Return acts in order, with equal commands that follow each other as one that lasts."""
    merged: list[Act] = []
    latest: dict[str, tuple[int, int]] = {}  # controller -> which of them, and when it was renewed last
    for act in sorted(acts, key=lambda each: each.at_ns):
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
    """Makes acts of the requests of clients; points of a trajectory that came ahead are kept for it."""

    def __init__(self, motions: Sequence[Motion]) -> None:
        self._motions: Mapping[str, Motion] = {each.controller: each for each in motions}
        self._points: list[Any] = []

    def acts(self, asked: Asked) -> Iterator[Act]:
        """Yield what a request does, at Unix ns; nothing for one that moves nothing."""
        method = ROBOT.methods.get(asked.method)
        if method is None:
            return
        try:
            request = decode(asked.params, method.request)
        except ValueError:
            return  # of another version
        for act in self._of(request):
            yield replace(act, at_ns=round(asked.time * 1e9))

    def _of(self, request: object) -> Iterator[Act]:
        if isinstance(request, messages.CommandController):
            yield Act(0, "command", request.controller, values=tuple(request.values))
        elif isinstance(request, messages.TwistController):
            sideways = (
                len(self._motions[request.controller].ranges) > 2 if request.controller in self._motions else False
            )
            middle = (request.lateral,) if sideways else ()
            yield Act(0, "command", request.controller, values=(request.linear, *middle, request.angular))
        elif isinstance(request, messages.TrajectoryData):
            self._points += request.points
        elif isinstance(request, messages.FollowTrajectory | messages.SendTrajectory | messages.SetTrajectory):
            yield from self._trajectory(request)
        elif isinstance(request, messages.Stop):
            yield Act(0, "latch" if request.latch else "stop")
        elif isinstance(request, messages.Release):
            yield Act(0, "release")
        elif isinstance(request, messages.AxisRequest) and request.action in _ACTIONS:
            whole = str(request.node) == "all"
            yield Act(0, "axis", "" if whole else str(request.node), str(request.action))
        elif isinstance(request, messages.SwitchControllers):
            yield from (Act(0, "deactivate", name) for name in request.deactivate if not request.activate)
            yield from (Act(0, "activate", name) for name in request.activate)

    def _trajectory(
        self, request: messages.FollowTrajectory | messages.SendTrajectory | messages.SetTrajectory
    ) -> Iterator[Act]:
        points, self._points = [*self._points, *request.points], []
        motion = self._motions.get(request.controller)
        order = motion.joints if motion is not None and set(motion.joints) == set(request.joints) else request.joints
        places = [request.joints.index(joint) for joint in order]
        kept = [each for each in points if len(each.positions) == len(places) and each.time_from_start > 0]
        values = tuple(each.positions[place] for each in kept for place in places)
        if values:
            yield Act(0, "trajectory", request.controller, values=values, times=tuple(e.time_from_start for e in kept))
