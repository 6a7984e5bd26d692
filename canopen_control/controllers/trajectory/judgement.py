"""Whether the joints are within the tolerances of a trajectory, on the way and at its end, and what is said if not.

The law of the file (ros2_controllers jazzy): on the way, and in the first cycle, the path tolerances count, at the end
those of the goal; a goal that is missed is late `goal_time` after the end, and never where that is 0.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from canopen_control.controllers.trajectory.goal import GoalState, ResultCode
from canopen_control.controllers.trajectory.tolerances import within

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.controllers.trajectory.follower import Follower
    from canopen_control.controllers.trajectory.joint_group import JointGroup
    from canopen_control.controllers.trajectory.point import Point
    from canopen_control.controllers.trajectory.tolerances import SegmentTolerances, StateTolerance

__all__ = ["Judgement", "Verdict"]

_NOBODY = -1


@dataclass(frozen=True)
class Verdict:
    """How a goal ends, and the sentence that says why."""

    state: GoalState
    code: ResultCode
    text: str


class _Tolerated:
    """Tolerances of all joints, laid out for a look in every cycle: positions first, which often are all there is."""

    __slots__ = ("_all", "_more", "_positions")

    def __init__(self, tolerances: Sequence[StateTolerance]) -> None:
        self._all = tolerances
        self._positions = [each.position if each.position > 0.0 else math.inf for each in tolerances]
        self._more = any(each.velocity > 0.0 or each.acceleration > 0.0 for each in tolerances)

    def exceeded(self, error: Point) -> int:
        """Return the last joint whose error is beyond its tolerance, or nobody."""
        found, off, most = _NOBODY, error.positions, self._positions
        for joint in range(len(most)):
            if abs(off[joint]) > most[joint] or (self._more and not within(self._all[joint], error, joint)):
                found = joint
        return found


class Judgement:
    """What was found in one cycle of the joints of a group: who `left` the path, who is `outside` at the end."""

    def __init__(self, group: JointGroup) -> None:
        self._group = group
        self.left = self.outside = _NOBODY
        self.over = self.late = False
        self._path, self._goal = _Tolerated(()), _Tolerated(())
        self._known: SegmentTolerances | None = None

    @property
    def stops(self) -> bool:
        """Whether nothing more is to be commanded of the trajectory."""
        return self.left >= 0 or self.late

    def look(self, tolerances: SegmentTolerances, follower: Follower, *, over: bool, past: float) -> None:
        """Compare the errors of this cycle with the tolerances; `past` is how long it is over, in s."""
        self.left, self.outside, self.over, self.late = _NOBODY, _NOBODY, over, False
        if follower.holding:
            return
        if tolerances is not self._known:
            self._known = tolerances
            self._path, self._goal = _Tolerated(tolerances.path), _Tolerated(tolerances.goal)
        if follower.fresh or not over:
            self.left = self._path.exceeded(self._group.error)
        if over:
            self.outside = self._goal.exceeded(self._group.error)
        self.late = self.outside >= 0 and 0.0 < tolerances.goal_time < past

    def verdict(self, tolerances: SegmentTolerances) -> Verdict | None:
        """Return how the trajectory ends by what was found, None if it goes on."""
        joints, errors = self._group.joints, self._group.error.positions
        if self.left >= 0:
            off, allowed = errors[self.left], tolerances.path[self.left].position
            who = f"{joints[self.left]} is {off:g} off its path, and {allowed:g} is its tolerance"
            return Verdict(GoalState.ABORTED, ResultCode.PATH_TOLERANCE_VIOLATED, f"{who}; see what holds it back")
        if self.over and self.outside < 0:
            return _REACHED
        if self.late:
            off, time = errors[self.outside], tolerances.goal_time
            who = f"{joints[self.outside]} is {off:g} off its goal {time:g} s after the end"
            return Verdict(GoalState.ABORTED, ResultCode.GOAL_TOLERANCE_VIOLATED, f"{who}; see what holds it back")
        return None


_REACHED = Verdict(GoalState.SUCCEEDED, ResultCode.SUCCESSFUL, "the goal was reached")
