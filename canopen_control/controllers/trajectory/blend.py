"""A new trajectory that takes over from the one that is followed: blended in at its start, for the joints it names.

The law of the file (ros2_controllers rolling, allow_trajectory_replacement): until the start of the new trajectory the
joints follow the old one; there it goes on from what the old one says, with its velocity and acceleration; joints that
it does not name follow the old one to its end. Ours: they follow its own points, where upstream takes samples of it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from canopen_control.controllers.trajectory.followed import Motion
from canopen_control.controllers.trajectory.point import Point

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.controllers.trajectory.followed import Trajectory

__all__ = ["MOST_WAITING", "Blend"]

MOST_WAITING: Final = 8
"""So many trajectories may wait for their start; one more takes the place of the last."""


class _Track:
    """A motion, and the joints that follow it; `said` is its last sample."""

    __slots__ = ("joints", "motion", "said")

    def __init__(self, motion: Motion, joints: list[int]) -> None:
        self.motion, self.joints, self.said = motion, joints, Point()


class _Waiting:
    """A trajectory that takes over some joints at `handoff`, in ns of the follower's time."""

    __slots__ = ("handoff", "joints", "trajectory")

    def __init__(self, trajectory: Trajectory, handoff: int, joints: list[int]) -> None:
        self.trajectory, self.handoff, self.joints = trajectory, handoff, joints


class Blend(Motion):
    """Joints that follow one trajectory or several, each its own, and those that are to take over."""

    def __init__(self, old: Motion, wrap: Sequence[bool]) -> None:
        super().__init__(old.start, 1)
        self.sampled, self._wrap = True, wrap
        self._tracks = [_Track(old, list(range(len(wrap))))]
        self._waiting: list[_Waiting] = []
        if isinstance(old, Blend):
            self._tracks, self._waiting = old._tracks, old._waiting  # noqa: SLF001 - it goes on in its place
        self._end = 0

    def take(self, trajectory: Trajectory, handoff: int, joints: Sequence[int]) -> None:
        """Have a trajectory take over these joints at `handoff`; what was to begin later than that is dropped."""
        kept = [each for each in self._waiting if each.handoff < handoff][: MOST_WAITING - 1]
        self._waiting = [*kept, _Waiting(trajectory, handoff, list(joints))]
        self.start = trajectory.start or handoff
        trajectory.begin(handoff)

    def set_before(self, time: int, point: Point, wrap: Sequence[bool]) -> None:
        """Do nothing: it goes on from what it follows."""

    def time_of(self, index: int) -> int:
        """Return when all are over, from start in ns."""
        del index
        motions = [each.motion for each in self._tracks] + [each.trajectory for each in self._waiting]
        return max(each.start + each.time_of(each.size - 1) for each in motions) - self.start

    def end_point(self) -> Point:
        """Return the point at which all stay when it is over."""
        found = Point()
        self._mix(self.start + self.time_of(0), found, ahead=True)
        return found

    def sample(self, t: int, out: Point, *, ahead: bool = False) -> bool:
        """Write the point at `t` into `out`, see `Motion`; who begins by then takes over."""
        while self._waiting and self._waiting[0].handoff <= t:
            self._hand_over(self._waiting.pop(0))
        found = self._mix(t, out, ahead=ahead)
        over = not self._waiting
        for each in self._tracks:
            over = over and each.motion.is_over
        self.first, self.following = 0, 1 if over else 0
        return found

    def query(self, t: int, out: Point) -> bool:
        """Write what is said of any time into `out`; before the first point of one to come it is the old one's."""
        later = [each for each in self._waiting if each.trajectory.start + each.trajectory.time_of(0) <= t]
        found = self._mix(t, out, ahead=True, asked=True)
        for each in later:
            said = Point()
            self._lead(each)
            if each.trajectory.query(t, said):
                _copy(said, out, each.joints)
        return found

    def _hand_over(self, coming: _Waiting) -> None:
        """Let joints follow another trajectory, from where the one that they follow is then."""
        self._lead(coming)
        tracks = []
        for each in self._tracks:
            left = [joint for joint in each.joints if joint not in coming.joints]
            if left:
                tracks.append(_Track(each.motion, left))
        self._tracks = [*tracks, _Track(coming.trajectory, coming.joints)]

    def _lead(self, coming: _Waiting) -> None:
        """Let a trajectory lead on from where the joints are when it takes over."""
        before = Point()
        self._mix(coming.handoff, before, ahead=True)
        coming.trajectory.set_before(coming.handoff, before, self._wrap)

    def _mix(self, t: int, out: Point, *, ahead: bool, asked: bool = False) -> bool:
        """Write what each joint's motion says at `t`; where one says nothing, what stands stays."""
        joints = len(self._wrap)
        if len(out.positions) != joints or len(out.effort) != joints or len(out.velocities) != joints:
            out.positions[:] = out.velocities[:] = out.accelerations[:] = out.effort[:] = [0.0] * joints
        if len(out.accelerations) != joints:
            out.accelerations[:] = [0.0] * joints
        found = True
        for each in self._tracks:
            motion, said = each.motion, each.said
            said_it = motion.query(t, said) if asked else motion.sample(t, said, ahead=ahead)
            if said_it:
                _copy(said, out, each.joints)
            found = found and said_it
        out.time = t - self.start
        return found


def _copy(said: Point, out: Point, joints: Sequence[int]) -> None:
    """Copy the values of some joints."""
    for joint in joints:
        out.positions[joint] = said.positions[joint]
        out.velocities[joint] = said.velocities[joint]
        out.accelerations[joint] = said.accelerations[joint]
        out.effort[joint] = said.effort[joint]
