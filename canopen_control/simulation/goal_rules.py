"""Invariants of goals and switches: a goal ends as its tolerances say, a refused switch of controllers changes nothing.

A goal that is told as reached has its joints at its last point, one that has missed it has one outside of its
tolerance, and one whose joints are there ends. After a goal that is told as cancelled the joints come to rest, with the
decelerations of the parameters or at once, unless something newer is asked for; one that a stop has ended says so. What
is judged are the shafts, of nodes that nobody has disturbed; the tolerances are those of the controller's parameters.
Times in ns.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from canopen_control.controllers.trajectory.goal import GoalState, ResultCode
from canopen_control.simulation.face_rules import LAG_NS

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.controllers.trajectory.goal import Goal
    from canopen_control.simulation.act_player import ActPlayer
    from canopen_control.simulation.acts import Act
    from canopen_control.simulation.face_rules import FaceRules
    from canopen_control.simulation.simulated_robot import SimulatedRobot

__all__ = ["GoalRules"]

_MS: Final = 1_000_000
_LATE_NS: Final = 500 * _MS  # after its time in which a goal ends that has been reached
_SLACK: Final = 2e-3  # rad or m: how far off a count may be read
_REST_NS: Final = 400 * _MS  # after a cancel, and the ramps, in which joints stand: some cycles, and how long one looks
_STOPPED_NS: Final = 100 * _MS  # after a stop in which it has ended every goal
_STOPS: Final = ("stop", "latch")
_STOP: Final = "stop was commanded"
_LEADS: Final = ("command", "trajectory", "activate", "deactivate")


class _Open:
    """A goal that was taken: its joints' last places and tolerances, and when it is to be over."""

    def __init__(self, act: Act, goal: Goal, places: dict[str, tuple[float, float]], over_ns: int) -> None:
        self.act, self.goal, self.places, self.over_ns = act, goal, places, over_ns
        self.there_since = self.rests_ns = 0  # rests_ns: by when its joints stand, once it was cancelled


class GoalRules:
    """Judges how goals end; `tell(rule, text)` takes breaches. `asked`, `taken` and `sampled` are called with time."""

    def __init__(
        self, robot: SimulatedRobot, player: ActPlayer, faces: FaceRules, tell: Callable[[str, str], None]
    ) -> None:
        self._robot, self._player, self._faces, self._tell = robot, player, faces, tell
        self._open: list[_Open] = []
        self._core: object = None
        self._torn = 0
        self._newest: Act | None = None  # of what has been asked that may move joints
        self._stopped_at = -1 << 62  # when a stop was asked, where nothing was asked since

    def asked(self, now: int, act: Act) -> None:
        """Take what a client asks for."""
        self._stopped_at = now if act.kind in _STOPS else -1 << 62
        if act.kind in _LEADS:
            self._newest = act

    def taken(self, now: int, act: Act, goal: Goal) -> None:
        """Take a goal that a controller has taken."""
        controller = self._robot.core.manager.get(act.target)
        tolerances = controller.params.tolerances()  # type: ignore[attr-defined]
        last = goal.trajectory.points[-1]
        allowed = dict(zip(controller.params.joints, tolerances.goal, strict=True))  # type: ignore[attr-defined]
        places = {
            joint: (place, allowed[joint].position)
            for joint, place in zip(goal.trajectory.joint_names, last.positions, strict=False)
            if joint in allowed and allowed[joint].position > 0.0
        }
        over = now + last.time + round(tolerances.goal_time * 1e9)
        self._core = self._robot.core
        self._open.append(_Open(act, goal, places, over))

    def sampled(self, now: int) -> None:
        """Judge the goals that have ended, or should have."""
        for text in self._player.torn[self._torn :]:
            self._tell("switch_torn", text)
        self._torn = len(self._player.torn)
        if not self._open:
            return
        if self._robot.core is not self._core:
            self._open.clear()
            return
        self._open = [each for each in self._open if self._is_open(each, now)]

    def _is_open(self, given: _Open, now: int) -> bool:
        """Judge a goal; return whether it is to be looked at again."""
        if given.goal.state is GoalState.CANCELED:
            return self._comes_to_rest(given, now)
        off = self._off(given)
        if not given.goal.ended:
            there = _are_there(off)
            given.there_since = (given.there_since or now) if there else 0
            if not (there and now > max(given.over_ns, given.there_since) + _LATE_NS):
                return now < given.over_ns + 10 * _LATE_NS
            self._tell("goal_wrong", f"the goal of {given.act.target} has been reached, and it does not end")
        elif given.goal.state is GoalState.SUCCEEDED:
            for joint, (_, least) in off.items():
                if least > _SLACK:
                    text = f"the goal of {given.act.target} is told as reached, {joint} is off by {least:.4f} more"
                    self._tell("goal_wrong", f"{text} than its tolerance")
        elif given.goal.code is ResultCode.GOAL_TOLERANCE_VIOLATED and _are_there(off):
            self._tell("goal_wrong", f"the goal of {given.act.target} is told as missed, and all joints are there")
        elif given.goal.code is ResultCode.INVALID_GOAL and off and self._hides_its_stop(given, now):
            told = f"a stop has ended the goal of {given.act.target}, which says: {given.goal.text}"
            self._tell("goal_wrong", told)
        return False

    def _hides_its_stop(self, given: _Open, now: int) -> bool:
        """Whether a goal that has just been ended by a stop says something else."""
        return now - self._stopped_at < _STOPPED_NS and _STOP not in given.goal.text

    def _comes_to_rest(self, given: _Open, now: int) -> bool:
        """Judge that joints stand after a cancel; return whether it is to be looked at again.

        Where they are disturbed, pulled by a floor, or led by something newer, nobody knows.
        """
        ways = {joint: self._faces.true_place(joint) for joint in given.places}
        known = [(joint, high - low) for joint, (low, high) in ((each, way) for each, way in ways.items() if way)]
        if len(known) < len(ways) or self._newest is not given.act or self._robot.floor is not None:
            return False
        if not given.rests_ns:
            given.rests_ns = now + _REST_NS + round(self._brake_s(given, dict(known)) * 1e9)
        if now < given.rests_ns:
            return True
        for joint, way in known:
            if way > _SLACK:
                text = f"the goal of {given.act.target} was cancelled, and {joint} moves on"
                self._tell("goal_wrong", text)
        return False

    def _brake_s(self, given: _Open, ways: dict[str, float]) -> float:
        """Return how long joints brake that have gone these ways in the last cycles, as the parameters say."""
        params = self._robot.core.manager.get(given.act.target).params  # type: ignore[attr-defined]
        slow = dict(zip(params.joints, (each.max_deceleration_on_cancel for each in params.constraints), strict=True))
        times = [way / (LAG_NS / 1e9) / slow[joint] for joint, way in ways.items() if slow[joint] > 0.0]
        return max(times, default=0.0)

    def _off(self, given: _Open) -> dict[str, tuple[float, float]]:
        """Return by how much more than its tolerance each joint was off its goal in the last cycles, most and least.

        Nothing where one of them is not known.
        """
        found = {}
        for joint, (place, tolerance) in given.places.items():
            between = self._faces.true_place(joint)
            if between is None:
                return {}
            low, high = between[0] - place, between[1] - place
            least = 0.0 if low <= 0.0 <= high else min(abs(low), abs(high))
            found[joint] = max(abs(low), abs(high)) - tolerance, least - tolerance
        return found


def _are_there(off: dict[str, tuple[float, float]]) -> bool:
    """Whether all joints are within their tolerances, for certain."""
    return bool(off) and all(most < -_SLACK for most, _ in off.values())
