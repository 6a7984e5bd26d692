"""What a base publishes of its odometry, and when: the copy that all who look see until the next one."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from canopen_control.rpc.messages.samples import OdometrySample

if TYPE_CHECKING:
    from canopen_control.controllers.base_params import BaseParams
    from canopen_control.controllers.planar_pose import PlanarPose

__all__ = ["OdometryPublication"]

NS: Final = 1_000_000_000
_AT_ONCE: Final = -1  # before any cycle


class OdometryPublication:
    """Pose, velocity and limited twist as of the last publication; `count` is how many there were."""

    def __init__(self, axes: int) -> None:
        self.count = 0
        self._x = self._y = self._heading = 0.0
        self._linear = self._lateral = self._angular = 0.0
        self._limited = [0.0] * axes
        self._period = 0
        self._due = _AT_ONCE

    def set_rate(self, rate: float) -> None:
        """Publish at `rate` in Hz, 0 for at every update; the first one is at once."""
        self._period = round(NS / rate) if rate else 0
        self._due = _AT_ONCE

    def is_due(self, now: int) -> bool:
        """Count one that is due; the next is due at the next step of the period on a fixed grid, without a burst."""
        due, period = self._due, self._period
        if now <= due:
            return False
        self._due = (now if due == _AT_ONCE else max(due, now - period)) + period
        self.count += 1
        return True

    def take(self, pose: PlanarPose, velocities: tuple[float, float, float], limited: list[float]) -> None:
        """Put down what is so now; `velocities` forward, to the left and turning."""
        self._x, self._y, self._heading = pose.x, pose.y, pose.heading
        self._linear, self._lateral, self._angular = velocities
        for index in range(len(limited)):
            self._limited[index] = limited[index]

    def sample(self, time: float, given: BaseParams, limited: bool) -> OdometrySample | None:
        """Return it, stamped with `time` in Unix seconds and in the frames of the parameters; None before the first."""
        if not self.count:
            return None
        frame, child = given.frame_ids()
        return OdometrySample(
            time=time,
            x=self._x,
            y=self._y,
            heading=self._heading,
            linear=self._linear,
            lateral=self._lateral,
            angular=self._angular,
            frame_id=frame,
            child_frame_id=child,
            pose_covariance=list(given.pose_covariance_diagonal),
            twist_covariance=list(given.twist_covariance_diagonal),
            enable_odom_tf=given.enable_odom_tf,
            limited=(self._limited[0], self._limited[-1]) if limited else None,
        )
