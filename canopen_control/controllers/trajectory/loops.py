"""The loops that make velocities or efforts of a trajectory, where no position is commanded: one PID for each joint."""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.controllers.pid import Pid

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.controllers.trajectory.params import JointGains
    from canopen_control.controllers.trajectory.point import Point

__all__ = ["Loops"]


class Loops:
    """A PID for each commanded joint; `joints` are their places among the joints of the trajectory."""

    def __init__(self, gains: Sequence[JointGains], joints: Sequence[int], *, with_effort: bool) -> None:
        self._joints, self._with_effort = list(joints), with_effort
        self._pids = [Pid(gains[joint].pid()) for joint in joints]
        self._forward = [gains[joint].ff_velocity_scale for joint in joints]

    def set_gains(self, gains: Sequence[JointGains]) -> None:
        """Go on with other gains."""
        for index, joint in enumerate(self._joints):
            self._pids[index].set_gains(gains[joint].pid())
            self._forward[index] = gains[joint].ff_velocity_scale

    def reset(self) -> None:
        """Forget the past."""
        for each in self._pids:
            each.reset()

    def compute(self, index: int, wanted: Point, error: Point, period: float) -> float:
        """Return the command to the commanded joint `index`: feed-forward of what is wanted, and the loop's."""
        joint = self._joints[index]
        forward = self._forward[index] * wanted.velocities[joint] if joint < len(wanted.velocities) else 0.0
        if self._with_effort and joint < len(wanted.effort):
            forward += wanted.effort[joint]
        return forward + self._pids[index].compute_with_rate(error.positions[joint], error.velocities[joint], period)
