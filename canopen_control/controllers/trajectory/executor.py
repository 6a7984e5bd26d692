"""Command of the joints from cycle to cycle: a trajectory, a hold, or a ramp to standstill.

Rules (ros2_controllers jazzy): a queued trajectory begins in the next cycle; the command is its sample one
period ahead. Safer than upstream: a stop is computed as it is sampled, and a hold is one point.
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


# A new trajectory that takes over from the one that is followed: blended in at its start, for the joints it names.
#
# Rules (ros2_controllers rolling, allow_trajectory_replacement): until the start of the new trajectory the joints
# follow the old one; the new one then continues from the sample of the old one, with its velocity and acceleration;
# joints that it does not name follow the old one to its end. Different from upstream: they follow its own points, where
# upstream takes samples of it.


MOST_WAITING: Final = 8
"""So many trajectories may wait for their start; one more takes the place of the last."""


class _Track:
    """Motion and its joints; `sample` is its last sample."""

    __slots__ = ("joints", "motion", "sample")

    def __init__(self, motion: JointSetpoint, joints: list[int]) -> None:
        self.motion, self.joints, self.sample = motion, joints, Point()


class _Waiting:
    """Trajectory that takes over some joints at `handoff`, in ns of the follower's time."""

    __slots__ = ("handoff", "joints", "trajectory")

    def __init__(self, trajectory: ActiveTrajectory, handoff: int, joints: list[int]) -> None:
        self.trajectory, self.handoff, self.joints = trajectory, handoff, joints


class Blend(JointSetpoint):
    """Joints that follow one or several trajectories, and the waiting ones that will take over joints."""

    def __init__(self, old: JointSetpoint, wrap: Sequence[bool]) -> None:
        super().__init__(old.start, 1)
        self.sampled, self._wrap = True, wrap
        self._tracks = [_Track(old, list(range(len(wrap))))]
        self._waiting: list[_Waiting] = []
        if isinstance(old, Blend):
            self._tracks, self._waiting = old._tracks, old._waiting  # noqa: SLF001 - it goes on in its place
        self._end = 0

    def take(self, trajectory: ActiveTrajectory, handoff: int, joints: Sequence[int]) -> None:
        """Queue a trajectory that takes over these joints at `handoff`; one queued for later is dropped."""
        remaining = [queued for queued in self._waiting if queued.handoff < handoff][: MOST_WAITING - 1]
        self._waiting = [*remaining, _Waiting(trajectory, handoff, list(joints))]
        self.start = trajectory.start or handoff
        trajectory.begin(handoff)

    def set_before(self, time: int, point: Point, wrap: Sequence[bool]) -> None:
        """Do nothing: the trajectory continues from its own state."""

    def time_of(self, index: int) -> int:
        """Return the time of the end of all trajectories, from the start in ns."""
        del index
        motions = [part.motion for part in self._tracks] + [part.trajectory for part in self._waiting]
        return max(motion.start + motion.time_of(motion.size - 1) for motion in motions) - self.start

    def end_point(self) -> Point:
        """Return the final point."""
        point = Point()
        self._mix(self.start + self.time_of(0), point, ahead=True)
        return point

    def sample(self, t: int, out: Point, *, ahead: bool = False) -> bool:
        """Write the point at `t` to `out`, see `JointSetpoint`; queued trajectories have taken over by then."""
        while self._waiting and self._waiting[0].handoff <= t:
            self._hand_over(self._waiting.pop(0))
        result = self._mix(t, out, ahead=ahead)
        over = not self._waiting
        for track in self._tracks:
            over = over and track.motion.is_over
        self.first, self.following = 0, 1 if over else 0
        return result

    def query(self, t: int, out: Point) -> bool:
        """Write the state at any time to `out`; before the first point of a queued trajectory that of the old one."""
        later = [queued for queued in self._waiting if queued.trajectory.start + queued.trajectory.time_of(0) <= t]
        result = self._mix(t, out, ahead=True, query=True)
        for queued in later:
            point = Point()
            self._lead(queued)
            if queued.trajectory.query(t, point):
                _copy(point, out, queued.joints)
        return result

    def _hand_over(self, coming: _Waiting) -> None:
        """Switch joints to another trajectory, from their present commanded state."""
        self._lead(coming)
        tracks = []
        for track in self._tracks:
            remaining = [joint for joint in track.joints if joint not in coming.joints]
            if remaining:
                tracks.append(_Track(track.motion, remaining))
        self._tracks = [*tracks, _Track(coming.trajectory, coming.joints)]

    def _lead(self, coming: _Waiting) -> None:
        """Start a trajectory from the state of the joints at its takeover."""
        before = Point()
        self._mix(coming.handoff, before, ahead=True)
        coming.trajectory.set_before(coming.handoff, before, self._wrap)

    def _mix(self, t: int, out: Point, *, ahead: bool, query: bool = False) -> bool:
        """Write each joint's state at `t`; joints without a trajectory are unchanged."""
        joints = len(self._wrap)
        if len(out.positions) != joints or len(out.effort) != joints or len(out.velocities) != joints:
            out.positions[:] = out.velocities[:] = out.accelerations[:] = out.effort[:] = [0.0] * joints
        if len(out.accelerations) != joints:
            out.accelerations[:] = [0.0] * joints
        complete = True
        for track in self._tracks:
            motion, point = track.motion, track.sample
            said_it = motion.query(t, point) if query else motion.sample(t, point, ahead=ahead)
            if said_it:
                _copy(point, out, track.joints)
            complete = complete and said_it
        out.time = t - self.start
        return complete


def _copy(point: Point, out: Point, joints: Sequence[int]) -> None:
    """Copy the values of some joints."""
    for joint in joints:
        out.positions[joint] = point.positions[joint]
        out.velocities[joint] = point.velocities[joint]
        out.accelerations[joint] = point.accelerations[joint]
        out.effort[joint] = point.effort[joint]


# Coming to rest: each joint with its own deceleration from the speed that it has, or at once where it is.
#
# Rules (ros2_controllers jazzy, decelerate_on_cancel): the way is that of a constant deceleration. Ours,
# and safer: a new stop begins with itself, where upstream rewrites the one that runs and jumps to where its time is;
# and it is computed when it is sampled, so that the cycle in which it begins makes no list of points.


_AT_REST: Final = 2.0**-23
"""Below this a joint is at rest, in rad/s."""


class StopMotion(JointSetpoint):
    """Motion of all joints to standstill from the state in `set_before`; `decelerations` in rad/s2, above 0.

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
        """Set the initial positions and velocities of the ramp to rest."""
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
        """Return the time at which all joints stand, from the start in ns."""
        del index
        return self.duration

    def sample(self, t: int, out: Point, *, ahead: bool = False) -> bool:
        """Write the point at `t` into `out`, see `JointSetpoint`."""
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


# Speed scaling: rate of the time of trajectories, set by a user or by a state interface.
#
# Rules (ros2_controllers jazzy): a value of a user also goes to the command interface, the value of a state
# interface is used. Safer than upstream: time stands while its speed is unknown.


def scaled(time: int, factor: float) -> int:
    """Return a time in ns at a speed, truncated to ns: 10 ms at 0.3 are 2,999,999 ns, because 0.3 is slightly less.

    The product is exact, as upstream's is in extended precision: rounded to a double it would be 1 ns more.
    """
    if factor == 1.0:
        return time
    numerator, denominator = factor.as_integer_ratio()
    return time * numerator // denominator


class SpeedScaling:
    """Factor of the time of trajectories: 1 is nominal, 0 stops it.

    `allowed` is True if users may set it: only with position commands, since the velocities of a slower trajectory
    would have to be scaled too.
    """

    def __init__(self, factor: float = 1.0, *, allowed: bool = False) -> None:
        self.allowed = allowed
        self.factor = self._requested = factor if allowed else 1.0
        self._state: StateInterface | None = None
        self._command: CommandInterface | None = None

    def take(self, state: StateInterface | None, command: CommandInterface | None) -> None:
        """Store the interfaces if they exist."""
        self._state, self._command = state, command

    def mistake(self, factor: float) -> str | None:
        """Return the reason why a factor is invalid, None if it is valid."""
        if not self.allowed:
            return "cannot scale its speed: it commands more than positions"
        return None if 0.0 <= factor < math.inf else f"cannot scale its speed by {factor:g}; give 0 or more"

    def set(self, factor: float) -> None:
        """Run at a factor from the next cycle on."""
        self._requested = self.factor = factor

    def update(self) -> None:
        """Read and write the interfaces, in the cycle."""
        if self._state is not None:
            factor = self._state.value
            self.factor = factor if 0.0 <= factor < math.inf else 0.0
        if self._command is not None:
            self._command.value = self._requested


NS: Final = 1_000_000_000


class TrajectoryExecutor:
    """Executor of a group of joints; `holding` while it holds or brakes.

    `desired` is what was to be in the last cycle, `output` what was commanded for the next one; `limiter` keeps that
    within limits, None for none, and `limited` is the joint that it has held back first. `motion` is what is
    followed, `fresh` whether it began in this cycle.
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

    # ------------------------------------------------------------------------------------------- what is followed

    def begin(self) -> None:
        """Begin with the measured state; `hold` keeps the group there."""
        group = self._group
        self.motion = self._queued = self._message = None
        self._last_time = 0
        self._last = group.actual.copy()
        self.desired, self.output = group.blank(), group.blank()
        if self._loops is not None:
            self._loops.reset()

    def resume_at_rest(self) -> None:
        """Hold the joints once all of them follow commands."""
        self._group.read()
        self._last.take(self._group.actual)
        if self._loops is not None:
            self._loops.reset()
        self.hold()

    def clear(self, *, holding: bool) -> None:
        """Clear the trajectory."""
        self.motion = self._queued = self._message = None
        self.holding = holding

    def set_gains(self, params: TrajectoryParams) -> None:
        """Set the gains of other parameters."""
        self._params = params
        if self._loops is not None:
            self._loops.set_gains(params.gains)

    def follow(self, message: JointTrajectory) -> None:
        """Start a trajectory in the next cycle."""
        if isinstance(message.points, SurveyedPoints) and 0 in message.points.survey.sizes[0]:
            message.points = list(message.points)  # what is deduced of a point has to stay with it
        self._queued, self.holding = message, False

    def hold(self) -> None:
        """Hold the joints at one point, which is rewritten in place."""
        self._hold_at(self._group.actual)
        point, group = self._stay, self._group
        zeros = [0.0] * len(group.joints)
        point.velocities[:] = zeros if group.has_velocity or group.has_acceleration else ()
        point.accelerations[:] = zeros if group.has_acceleration else ()
        point.effort[:] = zeros if group.has_effort else ()

    def hold_at_end(self) -> None:
        """Hold the last point, with all its values."""
        end = None if self.motion is None else self.motion.end_point()
        if end is not None:
            self._hold_at(end)

    def brake(self, decelerations: Sequence[float]) -> None:
        """Brake with these decelerations, in rad/s2 or m/s2."""
        self._queued, self.holding = StopMotion(decelerations), True

    def _hold_at(self, point: Point) -> None:
        self._stay.take(point)
        self._stay.time = 0
        self._queued, self.holding = self._hold, True

    # ----------------------------------------------------------------------------------------------------- cycle

    def take_queued(self) -> None:
        """Start the queued trajectory; joints outside it hold, or continue if it is blended in."""
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
        blend.take(trajectory, max(begin, self._commanded_until), named)

    @property
    def follows(self) -> JointSetpoint | None:
        """Trajectory into which a new one is blended, None if it replaces it at once."""
        message, motion = self._message, self.motion
        if not (self._params.allow_trajectory_replacement and self._splines) or motion is None or motion.is_over:
            return None
        return (
            motion
            if message is not None and message is not self._hold and not isinstance(message, StopMotion)
            else None
        )

    def start_positions(self, stamp: int) -> Sequence[float]:
        """Return the positions from which a trajectory with this stamp would continue."""
        follows, out = self.follows, Point()
        if follows is not None and follows.query(max(self._start_of(stamp), self._commanded_until), out):
            return out.positions
        return self._group.actual.positions

    def _start_of(self, stamp: int) -> int:
        """Return the start of a trajectory with this stamp, in scaled time."""
        return self._commanded_until if stamp == 0 else self._time + stamp - self._now

    @property
    def _commanded_until(self) -> int:
        """Time until which drives have received positions; the next trajectory starts there."""
        return self._time + self._period_ns

    def sample(self, now: int, period: float, scaling: float) -> bool:
        """Compute desired state and command; False without a command. Period in s."""
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
        """Write the command; `group.error` is that of this cycle.

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
                commands[index].value = value if math.isfinite(value) else 0.0  # an unknown velocity
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
    def time_since_end(self) -> float:
        """Time since the last point in s; after the trajectory's end, time since that end."""
        motion = self.motion
        return 0.0 if motion is None else self._time / 1e9 - (motion.start + motion.time_of(motion.first)) / 1e9

    def query(self, t: int, out: Point) -> bool:
        """Write the state at `t` in ns to `out`; False, with the actual state, if there is none."""
        motion = self.motion
        if motion is None or not motion.query(t, out):
            out.take(self._group.actual)
            return False
        return not motion.is_over

    def state_reading(self, t: int, name: str) -> TrajectoryAt:
        """Return the state at `t` in ns; the actual state of controller `name` if there is none."""
        point = Point()
        is_known = self.query(t, point)
        text = "" if is_known else f"{name} follows nothing at that time; this is where the joints are, or are to end"
        return TrajectoryAt(known=is_known, text=text, joints=list(self._group.joints), point=_plain_point(point))

    def sample_of(self, time: float, executing: bool, factor: float) -> TrajectorySample:
        """Return the sample of the last cycle, `time` in Unix s."""
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
        """Set the state before the first point: the desired one, or after a hold the actual one."""
        wrap = () if self._message is self._hold else self._group.wrap
        if self._params.from_desired and self._last.positions:
            self._last_time = self._last_time or now
            if isinstance(motion, StopMotion):
                motion.pace = scaling  # what was commanded last ran so slowly; what is measured is real
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
