"""The polynomials between two points of a trajectory: linear, cubic through velocities, quintic through accelerations.

The law of the file (ros2_controllers jazzy): what stands in both points decides the degree. Ours, and safer: points
with accelerations and without velocities are joined by a line, where upstream commands zeros.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from canopen_control.controllers.trajectory.point import Point

__all__ = ["Segment"]


class Segment:
    """All joints between two points; the coefficients are made once by `fit`, `evaluate` allocates nothing."""

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
        """Join point `a` at `begin` with point `b` at `end`, in ns; the joints are those with a position in `a`."""
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
        """Write the point at `t`, in ns, into `out`; beyond its ends it stands there, with the slope of the line."""
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
        s2 = s * s  # powers summed as upstream sums them: in a segment of hours their rounding shows
        s3 = s2 * s
        s4 = s3 * s
        s5 = s4 * s
        v2, v3, v4, v5 = 2.0 * s, 3.0 * s2, 4.0 * s3, 5.0 * s4
        a3, a4, a5 = 6.0 * s, 12.0 * s2, 20.0 * s3
        starts, c1s, c2s, c3s, c4s, c5s = self._start, self._c1, self._c2, self._c3, self._c4, self._c5
        # nothing is made of joints without a position, whatever the other vectors say of them
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
                way, v0, v1 = b.positions[i] - a.positions[i], a.velocities[i], b.velocities[i]
                self._c2[i] = (3.0 * way - (2.0 * v0 + v1) * time) / time**2
                self._c3[i] = (-2.0 * way + (v0 + v1) * time) / time**3

    def _fit_quintic(self, a: Point, b: Point, time: float) -> None:
        self._c1[:] = a.velocities
        self._c2[:] = [0.5 * each for each in a.accelerations]
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
