"""Coming to rest: each joint with its own deceleration from the speed that it has, or at once where it is.

The law of the file (ros2_controllers jazzy, decelerate_on_cancel): the way is that of a constant deceleration. Ours,
and safer: a new stop begins with itself, where upstream rewrites the one that runs and jumps to where its time is; and
it is computed when it is sampled, so that the cycle in which it begins makes no list of points.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from canopen_control.controllers.trajectory.followed import Motion

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.controllers.trajectory.point import Point

__all__ = ["Stop"]

_AT_REST: Final = 2.0**-23
"""Below this a joint is at rest, in rad/s."""


class Stop(Motion):
    """The way to rest of all joints from where they are with `set_before`; `decelerations` in rad/s2, above 0.

    Its time is real, however slowly trajectories run; `pace` is by how much they did, where it begins from what was
    commanded and not from what is measured.
    """

    def __init__(self, decelerations: Sequence[float]) -> None:
        super().__init__(0, 1)
        joints, self.pace = len(decelerations), 1.0
        self._decelerations, self.duration = list(decelerations), 0
        self._positions, self._velocities = [0.0] * joints, [0.0] * joints
        self._slopes, self._times, self._targets = [0.0] * joints, [0.0] * joints, [0.0] * joints

    def set_before(self, time: int, point: Point, wrap: Sequence[bool]) -> None:
        """Take where the joints are and how fast they go: from there they come to rest."""
        del time, wrap
        self._positions[:] = point.positions
        self._velocities[:] = point.velocities or [0.0] * len(self._decelerations)
        for index, deceleration in enumerate(self._decelerations):
            known = self._velocities[index]
            velocity = self._velocities[index] = known * self.pace if math.isfinite(known) else 0.0
            sign = 1.0 if velocity >= 0.0 else -1.0
            self._slopes[index] = -sign * deceleration
            self._times[index] = abs(velocity) / deceleration
            self._targets[index] = self._positions[index] + sign * velocity * velocity / (2.0 * deceleration)
        self.duration = int(max(self._times, default=0.0) * 1e9)

    def time_of(self, index: int) -> int:
        """Return when all are at rest, from start in ns."""
        del index
        return self.duration

    def sample(self, t: int, out: Point, *, ahead: bool = False) -> bool:
        """Write the point at `t` into `out`, see `Motion`."""
        del ahead
        self.begin(t)
        elapsed = max((t - self.start) / 1e9, 0.0)
        joints = len(self._positions)
        if len(out.velocities) != joints or len(out.accelerations) != joints or len(out.effort) != joints:
            zeros = [0.0] * joints
            out.velocities[:] = out.accelerations[:] = out.effort[:] = zeros
        if len(out.positions) != joints:
            out.positions[:] = self._positions
        for i in range(joints):
            velocity, slope, out.effort[i] = self._velocities[i], self._slopes[i], 0.0
            if elapsed < self._times[i] and abs(velocity) > _AT_REST:
                out.positions[i] = self._positions[i] + velocity * elapsed + slope * elapsed * elapsed / 2.0
                out.velocities[i] = velocity + slope * elapsed
                out.accelerations[i] = slope
            else:
                out.positions[i], out.velocities[i], out.accelerations[i] = self._targets[i], 0.0, 0.0
        out.time = t - self.start
        self.first, self.following = 0, 0 if t - self.start < self.duration else 1
        return True
