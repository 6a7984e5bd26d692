"""Cyclic execution of trajectories, including stops, holds, blending and speed scaling.

Rules (ros2_controllers jazzy): a queued trajectory begins in the next cycle; the command is its sample one period
ahead. Difference from upstream: a stop is computed when it is sampled, and a hold is a single point.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from canopen_control.controllers.trajectory.active_trajectory import ActiveTrajectory, JointSetpoint
from canopen_control.controllers.trajectory.joint_group import Loops
from canopen_control.controllers.trajectory.point import Arrangement, JointTrajectory, Point
from canopen_control.controllers.trajectory.validation import SurveyedPoints
from canopen_control.rpc.messages.samples import TrajectoryPoint, TrajectorySample
from canopen_control.rpc.messages.trajectory import TrajectoryAt
from canopen_control.urdf.joint_element import ACCELERATION, EFFORT, POSITION, VELOCITY

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.controllers.limiters import PointLimiter
    from canopen_control.controllers.trajectory.joint_group import JointGroup
    from canopen_control.controllers.trajectory.params import TrajectoryParams
    from canopen_control.hardware.interfaces import CommandInterface, StateInterface


# A new trajectory that is blended in at its start, for the joints it names, while another trajectory is executed.
#
# Rules (ros2_controllers rolling, allow_trajectory_replacement): until the start of the new trajectory the joints
# follow the old one; the new trajectory then continues from the sample of the old one, with its velocity and
# acceleration. Joints that the new trajectory does not name follow the old one to its end. Difference from upstream:
# they follow the points of the old trajectory, where upstream uses samples of it.


MAX_WAITING: Final = 8
"""Maximum number of trajectories that wait for their start; a further trajectory replaces the last."""


class _Track:
    """Trajectory with the indices of the joints that follow it; `sample` is its last sample."""

    __slots__ = ("joints", "motion", "sample")

    def __init__(self, motion: JointSetpoint, joints: list[int]) -> None:
        self.motion, self.joints, self.sample = motion, joints, Point()


class _Waiting:
    """Queued trajectory that takes over some joints at `handoff`, in ns of the executor's time."""

    __slots__ = ("handoff", "joints", "trajectory")

    def __init__(self, trajectory: ActiveTrajectory, handoff: int, joints: list[int]) -> None:
        self.trajectory, self.handoff, self.joints = trajectory, handoff, joints


class Blend(JointSetpoint):
    """Trajectories followed by different joints, and queued trajectories that take over joints later."""

    def __init__(self, old: JointSetpoint, wrap: Sequence[bool]) -> None:
        super().__init__(old.start, 1)
        self.sampled, self._wrap = True, wrap
        self._tracks = [_Track(old, list(range(len(wrap))))]
        self._waiting: list[_Waiting] = []
        if isinstance(old, Blend):
            self._tracks, self._waiting = old._tracks, old._waiting  # noqa: SLF001 - this blend replaces it
        self._end = 0

    def queue(self, trajectory: ActiveTrajectory, handoff: int, joints: Sequence[int]) -> None:
        """Queue a trajectory that takes over the joints with these indices at `handoff`, in ns.

        Queued trajectories with the same or a later handoff are dropped.
        """
        remaining = [queued for queued in self._waiting if queued.handoff < handoff][: MAX_WAITING - 1]
        self._waiting = [*remaining, _Waiting(trajectory, handoff, list(joints))]
        self.start = trajectory.start or handoff
        trajectory.begin(handoff)

    def set_before(self, time: int, point: Point, wrap: Sequence[bool]) -> None:
        """Do nothing, since a blend continues from the states of its trajectories."""

    def time_of(self, index: int) -> int:
        """Return the end of the trajectory that ends last, in ns from the start."""
        del index
        motions = [part.motion for part in self._tracks] + [part.trajectory for part in self._waiting]
        return max(motion.start + motion.time_of(motion.size - 1) for motion in motions) - self.start

    def end_point(self) -> Point:
        """Return the state of all joints at the end of the trajectory that ends last."""
        point = Point()
        self._mix(self.start + self.time_of(0), point, ahead=True)
        return point

    def sample(self, t: int, out: Point, *, ahead: bool = False) -> bool:
        """Write the state at `t` to `out`, after trajectories with a handoff up to `t` have taken over."""
        while self._waiting and self._waiting[0].handoff <= t:
            self._hand_over(self._waiting.pop(0))
        result = self._mix(t, out, ahead=ahead)
        over = not self._waiting
        for track in self._tracks:
            over = over and track.motion.is_over
        self.first, self.following = 0, 1 if over else 0
        return result

    def query(self, t: int, out: Point) -> bool:
        """Write the state at any time to `out`; the progress of the motion is unchanged.

        Up to the first point of a queued trajectory, the state is that of the trajectories before it.
        """
        later = [queued for queued in self._waiting if queued.trajectory.start + queued.trajectory.time_of(0) <= t]
        result = self._mix(t, out, ahead=True, query=True)
        for queued in later:
            point = Point()
            self._lead(queued)
            if queued.trajectory.query(t, point):
                _copy(point, out, queued.joints)
        return result

    def _hand_over(self, coming: _Waiting) -> None:
        """Start a queued trajectory for its joints from their commanded state at the handoff."""
        self._lead(coming)
        tracks = []
        for track in self._tracks:
            remaining = [joint for joint in track.joints if joint not in coming.joints]
            if remaining:
                tracks.append(_Track(track.motion, remaining))
        self._tracks = [*tracks, _Track(coming.trajectory, coming.joints)]

    def _lead(self, coming: _Waiting) -> None:
        """Set the initial state of a queued trajectory to the state of the joints at its handoff."""
        before = Point()
        self._mix(coming.handoff, before, ahead=True)
        coming.trajectory.set_before(coming.handoff, before, self._wrap)

    def _mix(self, t: int, out: Point, *, ahead: bool, query: bool = False) -> bool:
        """Write the state of each joint at `t` to `out`; return False if a joint's state is missing."""
        joints = len(self._wrap)
        if len(out.positions) != joints or len(out.effort) != joints or len(out.velocities) != joints:
            out.positions[:] = out.velocities[:] = out.accelerations[:] = out.effort[:] = [0.0] * joints
        if len(out.accelerations) != joints:
            out.accelerations[:] = [0.0] * joints
        complete = True
        for track in self._tracks:
            motion, point = track.motion, track.sample
            is_known = motion.query(t, point) if query else motion.sample(t, point, ahead=ahead)
            if is_known:
                _copy(point, out, track.joints)
            complete = complete and is_known
        out.time = t - self.start
        return complete


def _copy(point: Point, out: Point, joints: Sequence[int]) -> None:
    """Copy the values of these joints from one point to another."""
    for joint in joints:
        out.positions[joint] = point.positions[joint]
        out.velocities[joint] = point.velocities[joint]
        out.accelerations[joint] = point.accelerations[joint]
        out.effort[joint] = point.effort[joint]


# Stop motion: each joint brakes from its velocity with its own deceleration.
#
# Rules (ros2_controllers jazzy, decelerate_on_cancel): the deceleration is constant. Safer than upstream: a new stop
# starts at its beginning, where upstream overwrites a running stop and jumps to the position of its current time; and a
# stop is computed when it is sampled, so that no list of points is created in the cycle in which it begins.


_AT_REST: Final = 2.0**-23
"""Maximum speed in rad/s (or m/s) of a joint at standstill."""


class StopMotion(JointSetpoint):
    """Motion of all joints to standstill from the state in `set_before`.

    `decelerations` are in rad/s2 (or m/s2), above 0. The motion runs in real time, even with speed scaling; `pace` is
    the scaling factor of the initial velocities, which differs from 1 if they were commanded and not measured.
    """

    def __init__(self, decelerations: Sequence[float]) -> None:
        super().__init__(0, 1)
        joints, self.pace = len(decelerations), 1.0
        self._decelerations, self.duration = list(decelerations), 0
        self._positions, self._velocities = [0.0] * joints, [0.0] * joints
        self._slopes, self._times, self._targets = [0.0] * joints, [0.0] * joints, [0.0] * joints

    def set_before(self, time: int, point: Point, wrap: Sequence[bool]) -> None:
        """Set the initial positions and velocities, and compute the stop of each joint."""
        del time, wrap
        self._positions[:] = point.positions
        self._velocities[:] = point.velocities or [0.0] * len(self._decelerations)
        for index, deceleration in enumerate(self._decelerations):
            previous = self._velocities[index]
            velocity = self._velocities[index] = previous * self.pace if math.isfinite(previous) else 0.0
            sign = 1.0 if velocity >= 0.0 else -1.0
            self._slopes[index] = -sign * deceleration
            self._times[index] = abs(velocity) / deceleration
            self._targets[index] = self._positions[index] + sign * velocity * velocity / (2.0 * deceleration)
        self.duration = int(max(self._times, default=0.0) * 1e9)

    def time_of(self, index: int) -> int:
        """Return the time at which all joints are at standstill, in ns from the start."""
        del index
        return self.duration

    def sample(self, t: int, out: Point, *, ahead: bool = False) -> bool:
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


# Speed scaling: factor of the time of trajectories, set by a user or by a state interface.
#
# Rules (ros2_controllers jazzy): a factor set by a user is also written to the command interface; the factor of a state
# interface takes precedence. Safer than upstream: trajectories stop while the factor is unknown.


def scaled(time: int, factor: float) -> int:
    """Return a time in ns multiplied by a factor, truncated to ns.

    10 ms at 0.3 are 2,999,999 ns, because the double 0.3 is slightly less than 0.3. The product is exact, as upstream's
    is in extended precision; rounded to a double it would be 1 ns more.
    """
    if factor == 1.0:
        return time
    numerator, denominator = factor.as_integer_ratio()
    return time * numerator // denominator


class SpeedScaling:
    """Scaling factor for the time of trajectories: 1 is nominal speed, 0 stops them.

    `allowed` is True if users may set the factor: only with position commands, because other commands of a slower
    trajectory would have to be scaled too.
    """

    def __init__(self, factor: float = 1.0, *, allowed: bool = False) -> None:
        self.allowed = allowed
        self.factor = self._requested = factor if allowed else 1.0
        self._state: StateInterface | None = None
        self._command: CommandInterface | None = None

    def set_interfaces(self, state: StateInterface | None, command: CommandInterface | None) -> None:
        """Store the state and command interface of the factor (None: not configured)."""
        self._state, self._command = state, command

    def mistake(self, factor: float) -> str | None:
        """Return why a factor is refused, or None if it is valid."""
        if not self.allowed:
            return "cannot scale its speed: only position commands can be scaled"
        return None if 0.0 <= factor < math.inf else f"cannot scale its speed by {factor:g}; give 0 or more"

    def set(self, factor: float) -> None:
        self._requested = self.factor = factor

    def update(self) -> None:
        """Read the factor from the state interface and write the user's factor to the command interface, if any."""
        if self._state is not None:
            factor = self._state.value
            self.factor = factor if 0.0 <= factor < math.inf else 0.0
        if self._command is not None:
            self._command.value = self._requested


NS: Final = 1_000_000_000


class TrajectoryExecutor:
    """Executor of trajectories for a group of joints; `holding` is True while they are held or brake.

    - `desired`: desired state of the last cycle; `output`: the state commanded for the next cycle.
    - `limiter`: limiter of `output`, None without one; `limited`: the first joint that it limited.
    - `motion`: the executed trajectory, hold or stop; `fresh`: whether it began in this cycle.
    """

    def __init__(self, params: TrajectoryParams, group: JointGroup, period_ns: int) -> None:
        self.holding = self.fresh = False
        self.desired, self.output = Point(), Point()
        self.motion: JointSetpoint | None = None
        self.limiter: PointLimiter | None = None
        self.limited: str | None = None
        self._params, self._group, self._period_ns = params, group, period_ns
        self._splines = params.interpolation_method == "splines"
        self._queued: JointTrajectory | StopMotion | None = None
        self._message: JointTrajectory | StopMotion | None = None
        self._hold = JointTrajectory(params.joints, [Point()])
        self._stay = Point()
        self._hold.points = [self._stay]
        self._time = self._now = self._last_time = 0
        self._last = Point()
        looped = (group.has_velocity and not params.open_loop_control) or group.has_effort
        alone = len(params.command_interfaces) == 1
        self._loops = Loops(params.gains, group.places, with_effort=group.has_effort) if alone and looped else None

    # ------------------------------------------------------------------------------------------------------ motions

    def begin(self) -> None:
        """Reset the executor to the measured state, without a motion."""
        group = self._group
        self.motion = self._queued = self._message = None
        self._last_time = 0
        self._last = group.actual.copy()
        self.desired, self.output = group.blank(), group.blank()
        if self._loops is not None:
            self._loops.reset()

    def resume_at_rest(self) -> None:
        """Hold the joints at their actual positions, with reset loops."""
        self._group.read()
        self._last.assign(self._group.actual)
        if self._loops is not None:
            self._loops.reset()
        self.hold()

    def clear(self, *, holding: bool) -> None:
        """Discard the motion and the queued motion, and set the attribute `holding`."""
        self.motion = self._queued = self._message = None
        self.holding = holding

    def set_gains(self, params: TrajectoryParams) -> None:
        self._params = params
        if self._loops is not None:
            self._loops.set_gains(params.gains)

    def follow(self, message: JointTrajectory) -> None:
        """Queue a trajectory, which starts in the next cycle."""
        if isinstance(message.points, SurveyedPoints) and 0 in message.points.survey.sizes[0]:
            message.points = list(message.points)  # keeps the quantities that are deduced for a point
        self._queued, self.holding = message, False

    def hold(self) -> None:
        """Queue a hold of the joints at their actual positions."""
        self._hold_at(self._group.actual)
        point, group = self._stay, self._group
        zeros = [0.0] * len(group.joints)
        point.velocities[:] = zeros if group.has_velocity or group.has_acceleration else ()
        point.accelerations[:] = zeros if group.has_acceleration else ()
        point.effort[:] = zeros if group.has_effort else ()

    def hold_at_end(self) -> None:
        """Queue a hold of the joints at the last point of the trajectory."""
        end = None if self.motion is None else self.motion.end_point()
        if end is not None:
            self._hold_at(end)

    def brake(self, decelerations: Sequence[float]) -> None:
        """Queue a stop of all joints with these decelerations, in rad/s2 or m/s2."""
        self._queued, self.holding = StopMotion(decelerations), True

    def _hold_at(self, point: Point) -> None:
        self._stay.assign(point)
        self._stay.time = 0
        self._queued, self.holding = self._hold, True

    # ----------------------------------------------------------------------------------------------------- cycle

    def start_queued(self) -> None:
        """Start the queued motion.

        Joints that a new trajectory does not name hold their position, or continue if it is blended in.
        """
        message, group = self._queued, self._group
        if message is self._message:
            return
        follows, self._message = self.follows, message
        if message is None or isinstance(message, StopMotion):
            self.motion = message
            return
        arrangement = None
        if message is not self._hold:
            group.read()
            arrangement = Arrangement(message.joint_names, group.joints, group.targets(), group.actual.positions)
        trajectory = ActiveTrajectory(message, self._splines, arrangement)
        if follows is None or arrangement is None:
            self.motion = trajectory
            return
        begin = self._start_of(message.stamp)
        trajectory.start = begin
        self.motion = blend = Blend(follows, group.wrap)
        named = [index for index, joint in enumerate(group.joints) if joint in message.joint_names]
        blend.queue(trajectory, max(begin, self._commanded_until), named)

    @property
    def follows(self) -> JointSetpoint | None:
        """Running trajectory into which a new trajectory would be blended, or None without blending."""
        message, motion = self._message, self.motion
        if not (self._params.allow_trajectory_replacement and self._splines) or motion is None or motion.is_over:
            return None
        return (
            motion
            if message is not None and message is not self._hold and not isinstance(message, StopMotion)
            else None
        )

    def start_positions(self, stamp: int) -> Sequence[float]:
        """Return the positions from which a trajectory with the start `stamp` would start."""
        follows, out = self.follows, Point()
        if follows is not None and follows.query(max(self._start_of(stamp), self._commanded_until), out):
            return out.positions
        return self._group.actual.positions

    def _start_of(self, stamp: int) -> int:
        """Return the start time of a trajectory by its stamp, in the scaled time of the executor."""
        return self._commanded_until if stamp == 0 else self._time + stamp - self._now

    @property
    def _commanded_until(self) -> int:
        """Time up to which positions have been commanded; a new trajectory can start from there."""
        return self._time + self._period_ns

    def sample(self, now: int, period: float, scaling: float) -> bool:
        """Compute the desired state of this cycle and the next command; return False if there is no command.

        `now` is in ns, `period` in s; `scaling` is the speed scaling factor.
        """
        motion = self.motion
        if motion is None:
            return False
        self.fresh = not motion.sampled
        if self.fresh:
            self._begin(motion, now, scaling)
        else:
            self._time += scaled(round(period * 1e9), 1.0 if isinstance(motion, StopMotion) else scaling)
        motion.sample(self._time, self.desired)
        self.desired.time = self._time - motion.start
        result = motion.sample(self._time + self._period_ns, self.output, ahead=True)
        self._group.actual.time = now - motion.start
        self._now = now
        return result

    def write(self, now: int, period: float) -> None:
        """Write the limited command, including the output of the loops for the errors of this cycle.

        The limiter compares with the last command, which the joints reach some cycles later.
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
                commands[index].value = value if math.isfinite(value) else 0.0  # not finite if a velocity is unknown
        else:
            if group.has_velocity:
                group.write(VELOCITY, output.velocities)
            if group.has_acceleration:
                group.write(ACCELERATION, output.accelerations)
            if group.has_effort:
                group.write(EFFORT, self.desired.effort)
        self._last.assign(output)
        self._last_time = now

    @property
    def time_since_end(self) -> float:
        """Time in s since the last passed point; after the trajectory has ended, since its end."""
        motion = self.motion
        return 0.0 if motion is None else self._time / 1e9 - (motion.start + motion.time_of(motion.first)) / 1e9

    def query(self, t: int, out: Point) -> bool:
        """Write the state at `t`, in ns, to `out`; return False if the motion has ended by then.

        Without a motion the actual state is written, and the result is also False.
        """
        motion = self.motion
        if motion is None or not motion.query(t, out):
            out.assign(self._group.actual)
            return False
        return not motion.is_over

    def state_reading(self, t: int, name: str) -> TrajectoryAt:
        """Return the state at `t`, in ns, as an answer to a client of controller `name`."""
        point = Point()
        is_known = self.query(t, point)
        text = (
            ""
            if is_known
            else f"{name} executes no trajectory at that time; the state is the actual or the final state"
        )
        return TrajectoryAt(known=is_known, text=text, joints=list(self._group.joints), point=_plain_point(point))

    def sample_of(self, time: float, executing: bool, factor: float) -> TrajectorySample:
        """Return a sample of the last cycle for publication; `time` is in Unix s."""
        return TrajectorySample(
            time=time,
            joints=self._group.joints,
            executing=executing,
            holding=self.holding,
            reference=_plain_point(self.desired),
            feedback=_plain_point(self._group.actual),
            error=_plain_point(self._group.error),
            output=_plain_point(self.output),
            speed_scaling_factor=factor,
        )

    def _begin(self, motion: JointSetpoint, now: int, scaling: float) -> None:
        """Set the state before the first point to the last command (`from_desired`) or to the actual state."""
        wrap = () if self._message is self._hold else self._group.wrap
        if self._params.from_desired and self._last.positions:
            self._last_time = self._last_time or now
            if isinstance(motion, StopMotion):
                motion.pace = scaling  # the last command is in scaled time, measured velocities are real
            motion.set_before(self._last_time, self._last, wrap)
        else:
            motion.set_before(now, self._group.actual, wrap)
        self._time = now


def _plain_point(point: Point) -> TrajectoryPoint:
    return TrajectoryPoint(
        positions=list(point.positions),
        velocities=list(point.velocities),
        accelerations=list(point.accelerations),
        effort=list(point.effort),
        time_from_start=point.time / 1e9,
    )
