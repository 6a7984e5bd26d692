"""Active trajectory: states of the joints over time, and the progress of the motion.

Rules (ros2_controllers jazzy, Trajectory): a trajectory starts at its stamp or, for a stamp of 0, at its first sample.
Until the time of its first point, it leads from the present state to this point. Missing quantities of a point are
deduced from its derivatives and then stored; after the end the last point is held. Safer than upstream: sampling a
future time never changes the progress, and earlier times can still be sampled.

Upstream wraps only the state before the first point, so that the drive of a continuous joint is suddenly commanded to
another turn. Here the samples are shifted by whole turns instead: the motion begins at the joint's position. Packed
points are unpacked one by one, when the motion reaches them. A sample of a future time is stored for that time, usually
the next cycle, and not computed again.
"""

from __future__ import annotations

import math
from abc import ABCMeta, abstractmethod
from bisect import bisect_right
from typing import TYPE_CHECKING, Final

from canopen_control.controllers.trajectory.point import Point, Points, whole_turns

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.controllers.trajectory.point import Arrangement, JointTrajectory


# The polynomials between two points of a trajectory: linear, cubic through velocities, quintic through accelerations.
#
# Rules (ros2_controllers jazzy): the quantities that both points have determine the degree. Safer than upstream: points
# with accelerations and without velocities are joined by a line, where upstream commands zeros.


class Segment:
    """Polynomial between two points, for all joints.

    `fit` computes the coefficients; `evaluate` does not allocate memory.
    """

    def __init__(self) -> None:
        self._begin, self._duration = 0, 0.0
        self._joints = self._degree = 0
        self._has_effort = False
        self._start: list[float] = []
        self._slope: list[float] = []
        self._end: list[float] = []
        self._effort: list[float] = []
        self._effort_slope: list[float] = []
        self._c1: list[float] = []
        self._c2: list[float] = []
        self._c3: list[float] = []
        self._c4: list[float] = []
        self._c5: list[float] = []

    def fit(self, begin: int, a: Point, end: int, b: Point) -> None:
        """Compute the polynomial from point `a` at time `begin` to point `b` at time `end`; times are in ns."""
        self._begin, self._duration = begin, (end - begin) / 1e9
        joints, time = len(a.positions), self._duration
        self._joints = joints
        self._start[:] = a.positions
        self._end[:] = b.positions
        self._slope[:] = [(b.positions[i] - a.positions[i]) / time if time else 0.0 for i in range(joints)]
        has_effort = self._has_effort = bool(a.effort) and bool(b.effort) and (any(a.effort) or any(b.effort))
        self._effort[:] = a.effort if has_effort else [0.0] * joints
        rise = [(b.effort[i] - a.effort[i]) / time for i in range(joints)] if has_effort and time else [0.0] * joints
        self._effort_slope[:] = rise
        if not (a.velocities and b.velocities):
            self._degree = 1
        elif a.accelerations and b.accelerations:
            self._degree = 5
            self._fit_quintic(a, b, time)
        else:
            self._degree = 3
            self._fit_cubic(a, b, time)

    def evaluate(self, t: int, out: Point) -> None:
        """Write the state at `t`, in ns, into `out`.

        Before the first point and after the second point, the position is that of the nearer point, and the velocity is
        the mean velocity of the segment.
        """
        joints = self._joints
        if len(out.positions) != joints or len(out.effort) != joints or len(out.velocities) != joints:
            _resize(out, joints)
        if len(out.accelerations) != joints:
            _resize(out, joints)
        s, degree = (t - self._begin) / 1e9, self._degree
        if s < 0.0:
            s, degree = 0.0, 1
        if s > self._duration:
            s, degree = self._duration, 1
        out.effort[:] = self._effort
        if self._has_effort:
            for i in range(joints):
                out.effort[i] += s * self._effort_slope[i]
        if degree == 1:
            for i in range(joints):
                out.positions[i] = self._start[i] + s * self._slope[i]
                out.velocities[i] = self._slope[i]
                out.accelerations[i] = 0.0
        elif degree == 3:
            self._cubic(s, out)
        else:
            self._quintic(s, out)

    def _cubic(self, s: float, out: Point) -> None:
        positions, velocities, accelerations = out.positions, out.velocities, out.accelerations
        for i in range(self._joints):
            c1, c2, c3 = self._c1[i], self._c2[i], self._c3[i]
            positions[i] = self._start[i] + s * (c1 + s * (c2 + s * c3))
            velocities[i] = c1 + s * (2.0 * c2 + s * 3.0 * c3)
            accelerations[i] = 2.0 * c2 + s * 6.0 * c3

    def _quintic(self, s: float, out: Point) -> None:
        positions, velocities, accelerations = out.positions, out.velocities, out.accelerations
        s2 = s * s  # the same order of operations as upstream: in a segment of hours the rounding matters
        s3 = s2 * s
        s4 = s3 * s
        s5 = s4 * s
        v2, v3, v4, v5 = 2.0 * s, 3.0 * s2, 4.0 * s3, 5.0 * s4
        a3, a4, a5 = 6.0 * s, 12.0 * s2, 20.0 * s3
        starts, c1s, c2s, c3s, c4s, c5s = self._start, self._c1, self._c2, self._c3, self._c4, self._c5
        # joints without a position are not used, even if other vectors have values for them
        for i in range(min(len(starts), len(c1s), len(c2s), len(c3s))):
            c1, c2, c3, c4, c5 = c1s[i], c2s[i], c3s[i], c4s[i], c5s[i]
            positions[i] = starts[i] + s * c1 + s2 * c2 + s3 * c3 + s4 * c4 + s5 * c5
            velocities[i] = c1 + v2 * c2 + v3 * c3 + v4 * c4 + v5 * c5
            accelerations[i] = 2.0 * c2 + a3 * c3 + a4 * c4 + a5 * c5

    def _fit_cubic(self, a: Point, b: Point, time: float) -> None:
        self._c1[:] = a.velocities
        self._c2[:] = self._c3[:] = [0.0] * self._joints
        if time:
            for i in range(self._joints):
                distance, v0, v1 = b.positions[i] - a.positions[i], a.velocities[i], b.velocities[i]
                self._c2[i] = (3.0 * distance - (2.0 * v0 + v1) * time) / time**2
                self._c3[i] = (-2.0 * distance + (v0 + v1) * time) / time**3

    def _fit_quintic(self, a: Point, b: Point, time: float) -> None:
        self._c1[:] = a.velocities
        self._c2[:] = [0.5 * acceleration for acceleration in a.accelerations]
        self._c3[:] = self._c4[:] = self._c5[:] = [0.0] * self._joints
        if not time:
            return
        t2 = time * time
        t3 = t2 * time
        t4 = t3 * time
        t5 = t4 * time
        for i in range(self._joints):
            p0, v0, a0 = a.positions[i], a.velocities[i], a.accelerations[i] * t2
            p1, v1, a1 = b.positions[i], b.velocities[i], b.accelerations[i] * t2
            c3 = -20.0 * p0 + 20.0 * p1 - 3.0 * a0 + a1 - 12.0 * v0 * time - 8.0 * v1 * time
            c4 = 30.0 * p0 - 30.0 * p1 + 3.0 * a0 - 2.0 * a1 + 16.0 * v0 * time + 14.0 * v1 * time
            c5 = -12.0 * p0 + 12.0 * p1 - a0 + a1 - 6.0 * v0 * time - 6.0 * v1 * time
            self._c3[i], self._c4[i], self._c5[i] = c3 / (2.0 * t3), c4 / (2.0 * t4), c5 / (2.0 * t5)


def _resize(out: Point, joints: int) -> None:
    out.positions[:] = out.velocities[:] = out.accelerations[:] = out.effort[:] = [0.0] * joints


_BEFORE: Final = -1
"""Index of the segment that leads to the first point."""
_NONE: Final = -2
_FEW: Final = 8
"""Number of segments that are searched linearly before a binary search."""


class JointSetpoint(metaclass=ABCMeta):
    """Base class of motions that provide set-points over time, with `size` points; `start` is in ns.

    `first` and `following` are the indices of the points around the last sample. Both are `size` without a sample, and
    `following` alone is `size` once the trajectory is over.
    """

    def __init__(self, stamp: int, size: int) -> None:
        self.start, self.size = stamp, size
        self.sampled = False
        self.first = self.following = size

    @abstractmethod
    def set_before(self, time: int, point: Point, wrap: Sequence[bool]) -> None:
        """Set the state of the joints before the first point, at a time in ns; `wrap` marks continuous joints."""

    @abstractmethod
    def sample(self, t: int, out: Point, *, ahead: bool = False) -> bool:
        """Write the state at `t`, in ns, to `out`; return False if there is no state.

        With `ahead` the sample is in the future and does not change the progress.
        """

    @abstractmethod
    def time_of(self, index: int) -> int:
        """Return the time of point `index` from the start, in ns."""

    def end_point(self) -> Point | None:
        """Return the last point, or None if there is none."""
        return None

    def begin(self, t: int) -> None:
        """Record that sampling has started, at `t` in ns; a trajectory without a stamp starts at this time."""
        if not self.sampled:
            if self.start == 0:
                self.start = t
            self.sampled = True

    def query(self, t: int, out: Point) -> bool:
        """Write the state at any time `t`, in ns, to `out`; return False if there is no state.

        The progress of the motion is unchanged.
        """
        return self.sampled and self.sample(t, out, ahead=True)

    @property
    def is_over(self) -> bool:
        """Whether the last sample was at or after the last point; True before the first sample."""
        return self.following == self.size


class ActiveTrajectory(JointSetpoint):
    """Active trajectory, interpolated by `splines`; without splines each point is held until its time.

    An `arrangement` is applied to each point when it is created. `shift` is added to the positions of each joint, in
    whole turns: samples include the shift, the points do not.
    """

    def __init__(self, message: JointTrajectory, splines: bool = True, arrangement: Arrangement | None = None) -> None:
        super().__init__(message.stamp, len(message.points))
        self.splines = splines
        self.before_time, self.before = 0, Point()
        self.reached = 0
        points = message.points
        self._points, self._packed = points, isinstance(points, Points)
        self._times: Sequence[int] = points.times if isinstance(points, Points) else [point.time for point in points]
        self._arrangement = arrangement if arrangement is not None and arrangement.changes else None
        self._arranged = bytearray(self.size if self._arrangement is not None else 0)  # flags of the arranged points
        self._segment = Segment()
        self._fitted = _NONE
        self._from, self._to = Point(), Point()
        self._end: Point | None = None
        self._ahead: Point | None = None  # sample of the future time `_seen_at`
        self._seen_at = 0
        self.shift: list[float] = []
        self._shifted = False

    def set_before(self, time: int, point: Point, wrap: Sequence[bool]) -> None:
        self.before_time, self._fitted, self._ahead = time, _NONE, None
        before = self.before
        before.assign(point)
        if not all(map(math.isfinite, before.effort)):  # efforts commanded before the first cycle may be nan
            before.effort[:] = [effort if math.isfinite(effort) else 0.0 for effort in before.effort]
        self.shift, self._shifted = [], False
        if not self.size:
            return
        first = self.at(0)
        if not before.velocities and first.velocities:
            before.velocities[:] = [0.0] * len(first.velocities)
        if not before.accelerations and first.accelerations:
            before.accelerations[:] = [0.0] * len(first.accelerations)
        if any(wrap):
            self._wrap(wrap)

    def _wrap(self, wrap: Sequence[bool]) -> None:
        """Shift continuous joints by whole turns to within half a turn of the first point.

        If the first points have no positions, the shift is computed at the first point with positions, up to which the
        joints follow the velocities.
        """
        before = self.before.positions
        start, first = self._first_place()
        self.shift = [0.0] * len(before)
        for index in range(min(len(before), len(first), len(wrap))):
            if wrap[index]:
                self.shift[index] = whole_turns(start[index], first[index])
                before[index] -= self.shift[index]
        self._shifted = any(self.shift)

    def _first_place(self) -> tuple[Sequence[float], Sequence[float]]:
        """Return the positions before the first point with positions, and the positions of that point."""
        point, first = self.before, self.at(0)
        if first.positions:
            return point.positions, first.positions
        point, begin = point.copy(), self.before_time - (self.start or self.before_time)
        for index in range(self.size):
            following = self.at(index).copy()
            if following.positions:
                return point.positions, following.positions
            _deduce(point, following, (following.time - begin) / 1e9)
            point, begin = following, following.time
        return point.positions, ()

    def at(self, index: int) -> Point:
        """Return point `index`, with the values in the controller's order of joints."""
        if self._packed and self._fitted == index - 1 >= 0:
            return self._to  # includes the quantities deduced for the point
        point = self._points[index]
        if self._arrangement is not None and (self._packed or not self._arranged[index]):
            self._arrangement.apply(point)
            self._arranged[index] = 1
        return point

    def time_of(self, index: int) -> int:
        return self._times[index]

    def end_point(self) -> Point | None:
        end = self._last_point()
        if end is None or not self._shifted:
            return end
        shifted = end.copy()
        self._shift(shifted)
        return shifted

    def _last_point(self) -> Point | None:
        if self._end is None and self.size:
            self._end = self.at(self.size - 1)
        return self._end

    def _shift(self, point: Point) -> None:
        positions, shift = point.positions, self.shift
        for index in range(min(len(positions), len(shift))):
            positions[index] += shift[index]

    def sample(self, t: int, out: Point, *, ahead: bool = False) -> bool:
        times, size = self._times, self.size
        self.first = self.following = size
        if not size:
            return False
        self.begin(t)
        if t < self.before_time:
            return False
        elapsed = t - self.start
        if elapsed < times[0]:
            self.first = self.following = 0
            self._between(_BEFORE, t, out, ahead=ahead)
            return True
        index = self._segment_of(elapsed)
        if index < size - 1:
            if not ahead:
                self.reached = index
            self.first, self.following = index, index + 1
            self._between(index, t, out, ahead=ahead)
            return True
        if not ahead:
            self.reached = size - 1
        return self._last(out)

    def _segment_of(self, elapsed: int) -> int:
        """Return the index of the segment at a time from the start, searching from the current segment on."""
        times, index, last = self._times, self.reached, self.size - 1
        steps = 0
        while index < last and not times[index] <= elapsed < times[index + 1]:
            index += 1
            steps += 1
            if steps == _FEW and self._packed:  # packed points are accepted only with increasing times
                return min(max(bisect_right(times, elapsed) - 1, index), last)
        return index

    def query(self, t: int, out: Point) -> bool:
        reached, self.reached = self.reached, 0
        result = self.sampled and self.sample(t, out, ahead=True)
        self.reached, self._ahead = reached, None  # `out` belongs to the caller
        return result

    def _between(self, index: int, t: int, out: Point, *, ahead: bool) -> None:
        """Write the state at `t`, interpolated between point `index` and the next point."""
        sampled, self._ahead = self._ahead, None
        if sampled is not None and not ahead and t == self._seen_at and index == self._fitted:
            out.assign(sampled)
            return
        if index != self._fitted:
            self._fit(index)
        if not self.splines:
            out.assign(self._from if index == _BEFORE else self._to)
            if self._shifted:
                self._shift(out)
            return
        self._segment.evaluate(t, out)
        if self._shifted:
            self._shift(out)
        out.time = 0 if index == _BEFORE else self._to.time
        if ahead:
            self._ahead, self._seen_at = out, t

    def _fit(self, index: int) -> None:
        a = self.before if index == _BEFORE else self.at(index)
        b = self.at(index + 1)
        self._from, self._to, self._fitted = a, b, index
        if self.splines:
            begin = self.before_time if index == _BEFORE else self.start + a.time
            end = self.start + b.time
            _deduce(a, b, (end - begin) / 1e9)
            self._segment.fit(begin, a, end, b)

    def _last(self, out: Point) -> bool:
        last = self._last_point()
        if last is None:
            return False
        if not last.positions and self.size > 1 and (before := self.at(self.size - 2)).positions:
            _deduce(before, last, (last.time - before.time) / 1e9)
        if not last.positions:
            return False
        self.first = self.size - 1
        out.assign(last)
        if self._shifted:
            self._shift(out)
        if not (last.velocities and last.accelerations and last.effort):
            _fill(out)
        return True


def _fill(point: Point) -> None:
    """Set missing velocities, accelerations and efforts of a point to zeros."""
    zeros = [0.0] * len(point.positions)
    point.velocities[:] = point.velocities or zeros
    point.accelerations[:] = point.accelerations or zeros
    point.effort[:] = point.effort or zeros


def _deduce(a: Point, b: Point, time: float) -> None:
    """Compute missing velocities and positions of point `b` from its derivatives, over `time` s since point `a`."""
    joints = len(a.positions)
    zeros = [0.0] * joints
    a.effort[:] = a.effort or zeros
    b.effort[:] = b.effort or zeros
    if b.positions:
        return
    a.velocities[:] = a.velocities or zeros
    if not b.velocities:
        a.accelerations[:] = a.accelerations or zeros
        b.velocities[:] = [
            a.velocities[i] + (a.accelerations[i] + b.accelerations[i]) / 2.0 * time for i in range(joints)
        ]
    b.positions[:] = [a.positions[i] + (a.velocities[i] + b.velocities[i]) / 2.0 * time for i in range(joints)]
