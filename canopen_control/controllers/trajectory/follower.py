"""What the joints are commanded from cycle to cycle: a trajectory, a hold, or the way to rest.

The law of the file (ros2_controllers jazzy): what is queued begins in the next cycle; the command is what it says one
period ahead. Ours, and safer: a stop is computed as it is sampled, and a hold is one point.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from canopen_control.controllers.trajectory.blend import Blend
from canopen_control.controllers.trajectory.followed import Motion, Trajectory
from canopen_control.controllers.trajectory.joint_group import Loops
from canopen_control.controllers.trajectory.packed import SurveyedPoints
from canopen_control.controllers.trajectory.point import Arrangement, JointTrajectory, Point
from canopen_control.controllers.trajectory.scaling import scaled
from canopen_control.controllers.trajectory.stop import Stop
from canopen_control.hardware.interfaces import ACCELERATION, EFFORT, POSITION, VELOCITY
from canopen_control.rpc.messages.samples import TrajectoryPoint, TrajectorySample
from canopen_control.rpc.messages.trajectory import TrajectoryAt

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.controllers.trajectory.joint_group import JointGroup
    from canopen_control.controllers.trajectory.params import TrajectoryParams
    from canopen_control.controllers.trajectory.point_limiter import PointLimiter

__all__ = ["Follower"]

NS: Final = 1_000_000_000


class Follower:
    """Moves a group of joints; `holding` says that it stays, or comes to rest, where it is.

    `desired` is what was to be in the last cycle, `output` what was commanded for the next one; `limiter` keeps that
    within limits, None for none, and `limited` is the joint that it has held back first. `motion` is what is
    followed, `fresh` whether it began in this cycle.
    """

    def __init__(self, params: TrajectoryParams, group: JointGroup, period_ns: int) -> None:
        self.holding = self.fresh = False
        self.desired, self.output = Point(), Point()
        self.motion: Motion | None = None
        self.limiter: PointLimiter | None = None
        self.limited: str | None = None
        self._params, self._group, self._period_ns = params, group, period_ns
        self._splines = params.interpolation_method == "splines"
        self._queued: JointTrajectory | Stop | None = None
        self._taken: JointTrajectory | Stop | None = None
        self._hold = JointTrajectory(params.joints, [Point()])
        self._stay = Point()
        self._hold.points = [self._stay]
        self._time = self._now = self._last_time = 0
        self._last = Point()
        looped = (group.has_velocity and not params.open_loop_control) or group.has_effort
        alone = len(params.command_interfaces) == 1
        self._loops = Loops(params.gains, group.places, with_effort=group.has_effort) if alone and looped else None

    # ------------------------------------------------------------------------------------------- what is followed

    def begin(self) -> None:
        """Begin anew where the group was read; `hold` tells it to stay there."""
        group = self._group
        self.motion = self._queued = self._taken = None
        self._last_time = 0
        self._last = group.actual.copy()
        self.desired, self.output = group.blank(), group.blank()
        if self._loops is not None:
            self._loops.reset()

    def rise(self) -> None:
        """Hold the joints where they are, now that all follow again."""
        self._group.read()
        self._last.take(self._group.actual)
        if self._loops is not None:
            self._loops.reset()
        self.hold()

    def drop(self, *, holding: bool) -> None:
        """Follow nothing more."""
        self.motion = self._queued = self._taken = None
        self.holding = holding

    def set_gains(self, params: TrajectoryParams) -> None:
        """Go on with the gains of other parameters."""
        self._params = params
        if self._loops is not None:
            self._loops.set_gains(params.gains)

    def follow(self, message: JointTrajectory) -> None:
        """Begin with a trajectory in the next cycle."""
        if isinstance(message.points, SurveyedPoints) and 0 in message.points.survey.sizes[0]:
            message.points = list(message.points)  # what is deduced of a point has to stay with it
        self._queued, self.holding = message, False

    def hold(self) -> None:
        """Stay where the joints are; one point that is rewritten, since a hold has no course to jump on."""
        self._hold_at(self._group.actual)
        point, group = self._stay, self._group
        zeros = [0.0] * len(group.joints)
        point.velocities[:] = zeros if group.has_velocity or group.has_acceleration else ()
        point.accelerations[:] = zeros if group.has_acceleration else ()
        point.effort[:] = zeros if group.has_effort else ()

    def hold_at_end(self) -> None:
        """Stay at the last point, with all that it says."""
        end = None if self.motion is None else self.motion.end_point()
        if end is not None:
            self._hold_at(end)

    def brake(self, decelerations: Sequence[float]) -> None:
        """Come to rest with these decelerations, in rad/s2 or m/s2."""
        self._queued, self.holding = Stop(decelerations), True

    def _hold_at(self, point: Point) -> None:
        self._stay.take(point)
        self._stay.time = 0
        self._queued, self.holding = self._hold, True

    # ----------------------------------------------------------------------------------------------------- cycle

    def take_queued(self) -> None:
        """Begin what was queued; joints that it does not name stay, or go on where it is blended in."""
        message, group = self._queued, self._group
        if message is self._taken:
            return
        follows, self._taken = self.follows, message
        if message is None or isinstance(message, Stop):
            self.motion = message
            return
        arrangement = None
        if message is not self._hold:
            group.read()
            arrangement = Arrangement(message.joint_names, group.joints, group.targets(), group.actual.positions)
        made = Trajectory(message, self._splines, arrangement)
        if follows is None or arrangement is None:
            self.motion = made
            return
        begin = self._start_of(message.stamp)
        made.start = begin
        self.motion = blend = Blend(follows, group.wrap)
        named = [index for index, joint in enumerate(group.joints) if joint in message.joint_names]
        blend.take(made, max(begin, self._commanded_until), named)

    @property
    def follows(self) -> Motion | None:
        """The trajectory that a new one would be blended into, None where it would take its place at once."""
        taken, motion = self._taken, self.motion
        if not (self._params.allow_trajectory_replacement and self._splines) or motion is None or motion.is_over:
            return None
        return motion if taken is not None and taken is not self._hold and not isinstance(taken, Stop) else None

    def where_it_begins(self, stamp: int) -> Sequence[float]:
        """Return the positions from which a trajectory with this stamp would lead on."""
        follows, out = self.follows, Point()
        if follows is not None and follows.query(max(self._start_of(stamp), self._commanded_until), out):
            return out.positions
        return self._group.actual.positions

    def _start_of(self, stamp: int) -> int:
        """Return when a trajectory with this stamp starts, in the time that passes as it is scaled."""
        return self._commanded_until if stamp == 0 else self._time + stamp - self._now

    @property
    def _commanded_until(self) -> int:
        """The time whose positions the drives have already: what takes over leads on from there."""
        return self._time + self._period_ns

    def sample(self, now: int, period: float, scaling: float) -> bool:
        """Work out what is desired and what to command; False where nothing is to be commanded. Period in s."""
        motion = self.motion
        if motion is None:
            return False
        self.fresh = not motion.sampled
        if self.fresh:
            self._begin(motion, now, scaling)
        else:
            self._time += scaled(round(period * 1e9), 1.0 if isinstance(motion, Stop) else scaling)
        motion.sample(self._time, self.desired)
        self.desired.time = self._time - motion.start
        found = motion.sample(self._time + self._period_ns, self.output, ahead=True)
        self._group.actual.time = now - motion.start
        self._now = now
        return found

    def write(self, now: int, period: float) -> None:
        """Command what was worked out; `group.error` is that of this cycle.

        A limiter measures from what was commanded last, which the joints reach some cycles later.
        """
        group, output, loops = self._group, self.output, self._loops
        if self.limiter is not None and self.limiter.enforce(self._last, output, period) and self.limited is None:
            self.limited = group.joints[self.limiter.joint]
        if group.has_position:
            group.write(POSITION, output.positions)
        if loops is not None:
            commands = group.commands[VELOCITY if group.has_velocity else EFFORT]
            for index in range(len(commands)):
                value = loops.compute(index, output, group.error, period)
                commands[index].value = value if math.isfinite(value) else 0.0  # a velocity that nobody knows
        else:
            if group.has_velocity:
                group.write(VELOCITY, output.velocities)
            if group.has_acceleration:
                group.write(ACCELERATION, output.accelerations)
            if group.has_effort:
                group.write(EFFORT, self.desired.effort)
        self._last.take(output)
        self._last_time = now

    @property
    def past(self) -> float:
        """How long ago the point was at which it is, in s; once it is over, how long it is over."""
        motion = self.motion
        return 0.0 if motion is None else self._time / 1e9 - (motion.start + motion.time_of(motion.first)) / 1e9

    def query(self, t: int, out: Point) -> bool:
        """Write what is said of `t`, in ns, into `out`; False, with where the joints are, if nothing."""
        motion = self.motion
        if motion is None or not motion.query(t, out):
            out.take(self._group.actual)
            return False
        return not motion.is_over

    def told(self, t: int, name: str) -> TrajectoryAt:
        """Return what is said of `t`, in ns; where nothing is, where the joints of controller `name` are."""
        point = Point()
        known = self.query(t, point)
        text = "" if known else f"{name} follows nothing at that time; this is where the joints are, or are to end"
        return TrajectoryAt(known=known, text=text, joints=list(self._group.joints), point=_told(point))

    def sample_of(self, time: float, executing: bool, factor: float) -> TrajectorySample:
        """Return what the last cycle was, of `time` in Unix seconds."""
        return TrajectorySample(
            time=time,
            joints=self._group.joints,
            executing=executing,
            holding=self.holding,
            reference=_told(self.desired),
            feedback=_told(self._group.actual),
            error=_told(self._group.error),
            output=_told(self.output),
            speed_scaling_factor=factor,
        )

    def _begin(self, motion: Motion, now: int, scaling: float) -> None:
        """Take where the joints are, or were to be, before the first point; a hold is where they are, on that turn."""
        wrap = () if self._taken is self._hold else self._group.wrap
        if self._params.from_desired and self._last.positions:
            self._last_time = self._last_time or now
            if isinstance(motion, Stop):
                motion.pace = scaling  # what was commanded last ran so slowly; what is measured is real
            motion.set_before(self._last_time, self._last, wrap)
        else:
            motion.set_before(now, self._group.actual, wrap)
        self._time = now


def _told(point: Point) -> TrajectoryPoint:
    return TrajectoryPoint(
        positions=list(point.positions),
        velocities=list(point.velocities),
        accelerations=list(point.accelerations),
        effort=list(point.effort),
        time_from_start=point.time / 1e9,
    )
