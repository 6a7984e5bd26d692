"""joint_trajectory_controller/JointTrajectoryController: arms that move as MoveIt expects.

The law of the file (ros2_controllers jazzy): a trajectory is taken between two cycles and begins in the next one; the
command is what it says one period ahead; on the way and at the end the joints are held against the tolerances of the
goal. Ours, and safer: while a joint does not follow commands nothing is commanded to any, and its goal ends with a
sentence that names it; once all follow again they are held where they are, never where they were going.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, ClassVar

from canopen_control.controllers.base import Controller
from canopen_control.controllers.trajectory.followed import Motion, Trajectory
from canopen_control.controllers.trajectory.goal import Goal, GoalState, ResultCode
from canopen_control.controllers.trajectory.joint_group import JointGroup
from canopen_control.controllers.trajectory.loops import Loops
from canopen_control.controllers.trajectory.params import TrajectoryParams, read_params
from canopen_control.controllers.trajectory.partial_goal import fill_up, put_in_order
from canopen_control.controllers.trajectory.point import JointTrajectory, Point
from canopen_control.controllers.trajectory.stop import Stop
from canopen_control.controllers.trajectory.tolerances import SegmentTolerances, resolve, within
from canopen_control.controllers.trajectory.upsampling import fill_velocities, time_points
from canopen_control.controllers.trajectory.validation import JointLimits, Rules, beyond, broken_rule, column, far_start
from canopen_control.errors import RobotConfigError, TrajectoryRefused
from canopen_control.hardware.interfaces import ACCELERATION, EFFORT, OK, POSITION, VELOCITY, ReturnType
from canopen_control.rpc.messages.samples import TrajectoryPoint, TrajectorySample
from canopen_control.rpc.messages.trajectory import TrajectoryAt

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.controllers.params import Params
    from canopen_control.errors import ControlError
    from canopen_control.hardware.interfaces import CommandInterface, StateInterface
    from canopen_control.rpc.messages.samples import Sample
    from canopen_control.urdf.joint import Joint

__all__ = ["JointTrajectoryController"]

NS = 1_000_000_000


class JointTrajectoryController(Controller):
    """Follows trajectories of positions, velocities, accelerations or efforts of several joints.

    `holding` says that it stays where it is; `goal` is the one that is being executed, `tolerances` those that count.
    `desired`, `output`, `actual` and `error` are those of the last cycle.
    """

    tells: ClassVar[type[Sample] | None] = TrajectorySample

    def __init__(self, name: str, type_name: str = "joint_trajectory_controller/JointTrajectoryController") -> None:
        super().__init__(name, type_name)
        self.params = TrajectoryParams()
        self.holding = False
        self.goal: Goal | None = None
        self.scaling = 1.0
        self.desired, self.output = Point(), Point()
        self.refused_tolerances: str | None = None
        self._group = JointGroup((), (), (), ())
        self._limits: dict[str, JointLimits] = {}
        self._changed: TrajectoryParams | None = None
        self._queued: JointTrajectory | Stop | None = None
        self._taken: JointTrajectory | Stop | None = None
        self._hold = JointTrajectory((), ())
        self._motion: Motion | None = None
        self._loops: Loops | None = None
        self._waiting: str | None = None
        self._time = self._last_time = 0
        self._last = Point()
        self._period_ns = NS // 100
        self._timeout = 0.0
        self._wanted_scaling = 1.0
        self._default = self.tolerances = SegmentTolerances((), ())
        self._scaling_state: StateInterface | None = None
        self._scaling_command: CommandInterface | None = None

    # ------------------------------------------------------------------------------------------------- lifecycle

    def on_configure(self, params: Params) -> None:
        """Read the parameters, see `params`; what cannot be together is an error."""
        self.params = given = read_params(params, self.name)
        self.update_rate = given.update_rate
        if self.cycle_rate <= 0:
            raise RobotConfigError(f"{self.name}: the update_rate is {self.cycle_rate} Hz; give one above 0")
        self._group = JointGroup(given.joints, given.commanded, given.command_interfaces, given.state_interfaces)
        self._hold = JointTrajectory(given.joints, [Point()])
        self.joints, self.interface = given.commanded, ", ".join(given.command_interfaces)
        self._period_ns = NS // min(given.update_rate or self.cycle_rate, self.cycle_rate)
        self._limits = {each: _limits_of(self.description.get(each)) for each in given.joints}
        self._group.wrap[:] = [self._limits[each].continuous for each in given.joints]
        self._default = self.tolerances = given.tolerances()
        alone = len(given.command_interfaces) == 1
        looped = (self._group.has_velocity and not given.open_loop_control) or self._group.has_effort
        self._loops = (
            Loops(given.gains, self._group.places, with_effort=self._group.has_effort) if alone and looped else None
        )
        self.scaling = given.initial_scaling_factor if self.scalable else 1.0
        self._wanted_scaling = self.scaling

    @property
    def scalable(self) -> bool:
        """Whether its speed can be scaled: positions alone are commanded."""
        return tuple(self.params.command_interfaces) == (POSITION,)

    def command_interface_names(self) -> list[str]:
        """Return those of each commanded joint, and that of the speed scaling."""
        return self._group.command_names + ([self.params.scaling_command] if self.params.scaling_command else [])

    def state_interface_names(self) -> list[str]:
        """Return those of each joint, and that of the speed scaling."""
        return self._group.state_names + ([self.params.scaling_state] if self.params.scaling_state else [])

    def on_activate(self, commands: list[CommandInterface], states: list[StateInterface], now: int) -> None:
        """Take the interfaces and hold the joints where they are."""
        super().on_activate(commands, states, now)
        group = self._group
        group.take(commands[: len(group.command_names)], states[: len(group.state_names)])
        self._scaling_command = commands[-1] if self.params.scaling_command else None
        self._scaling_state = states[-1] if self.params.scaling_state else None
        self._take_limits()
        self._last_time = self.stamp = 0
        self._motion = self._queued = self._taken = self.goal = None
        self.life.end()
        group.actual = group.blank()
        group.read()
        if self.params.set_last_command_interface_value_as_state_on_activation:
            group.begin_with_commands()
        self._last = group.actual.copy()
        self.desired, self.output = group.blank(), group.blank()
        if self._loops is not None:
            self._loops.reset()
        self._waiting = group.waits_for()
        self._hold_here()

    def on_deactivate(self, now: int) -> None:
        """Stop: the goal is aborted, positions stay as they are, all other targets become 0."""
        self._end(
            GoalState.ABORTED, ResultCode.INVALID_GOAL, f"{self.name} was deactivated; activate it and send again"
        )
        super().on_deactivate(now)
        self._motion = self._queued = self._taken = None
        self.holding = False

    def forget(self, now: int) -> None:
        """Give up what was commanded: joints that do not follow end the goal, where all do they brake."""
        del now
        self._waiting = self._group.waits_for()
        self.life.end()
        if self._waiting is not None:
            self._give_up(self._waiting)
            return
        who = self.life.source or "who commanded"
        self._end(GoalState.ABORTED, ResultCode.INVALID_GOAL, f"the command of {who} was taken back; send it again")
        self._brake()

    def change(self, params: TrajectoryParams) -> None:
        """Take other parameters in the next cycle: tolerances of trajectories to come, and the gains."""
        self._changed = params

    # -------------------------------------------------------------------------------------------------- commands

    def set_trajectory(self, message: JointTrajectory, now: int) -> None:
        """Follow a trajectory from the next cycle on; ControlError, and nothing changes, if it is refused.

        A goal that is being executed is judged by it from then on.
        """
        upsampled = self.params.upsampling and self.params.interpolation_method == "splines"
        upsampled = upsampled and _positions_alone(message)
        if upsampled:
            time_points(message.points, self.params.policy_frequency)
        self._check(message, now)
        if upsampled:
            fill_velocities(message.points)
        self._queue(message, now)

    def send_goal(self, goal: Goal | JointTrajectory, now: int) -> None:
        """Execute a goal from the next cycle on, in the place of the one before; ControlError if it is refused.

        A trajectory alone is set, see `set_trajectory`.
        """
        if isinstance(goal, JointTrajectory):
            self.set_trajectory(goal, now)
            return
        self._check(goal.trajectory, now)
        self._end(GoalState.ABORTED, ResultCode.INVALID_GOAL, "another goal has taken its place")
        self.tolerances, self.refused_tolerances = resolve(goal.tolerances, self.params.joints, self._default)
        if self.refused_tolerances is not None:
            self.tell("tolerances", self.refused_tolerances)
        self.goal = goal
        goal.feedback_rate, goal.outlives_client = self.params.action_monitor_rate, self.params.continue_without_client
        self._queue(goal.trajectory, now)

    def set_command(self, values: Sequence[float], now: int, stamp: int | None = None) -> None:
        """Refuse numbers: it takes trajectories."""
        del values, now, stamp
        raise self.refusal("takes trajectories and no numbers; send it one, or a goal")

    def cancel(self, goal: Goal, why: str | None = None) -> None:
        """Cancel a goal: if it is the one that is being executed, the joints brake and hold; `why` is told."""
        if goal is self.goal:
            text = "the goal was cancelled" if why is None else f"the goal was cancelled: {why}"
            self._end(GoalState.CANCELED, ResultCode.SUCCESSFUL, text)
            self._brake()

    def cancel_goal(self, why: str | None = None, only: Goal | None = None) -> None:
        """Cancel whatever goal is being executed, or `only` this one."""
        goal = only or self.goal
        if goal is not None:
            self.cancel(goal, why)

    def set_speed_scaling(self, factor: float) -> None:
        """Let the time of trajectories run slower or faster; ControlError below 0 and where it cannot be scaled."""
        if not self.scalable:
            raise self.refusal("cannot scale its speed: it commands more than positions")
        if not 0.0 <= factor < math.inf:
            raise self.refusal(f"cannot scale its speed by {factor:g}; give 0 or more")
        self._wanted_scaling = self.scaling = factor

    def query(self, t: int, out: Point) -> bool:
        """Write what the trajectory says at `t`, in ns, into `out`; False, with where the joints are, if nothing."""
        motion = self._motion
        if motion is None or not motion.query(t, out):
            out.take(self._group.actual)
            return False
        return not motion.is_over

    def trajectory_at(self, t: int) -> TrajectoryAt:
        """Return what the trajectory says at `t`, in ns; where it says nothing, where the joints are."""
        if self.state.value != "active":
            return TrajectoryAt(known=False, text=f"{self.name} is {self.state.value}; activate it first")
        point = Point()
        known = self.query(t, point)
        text = "" if known else f"{self.name} follows nothing at that time; this is where the joints are, or are to end"
        return TrajectoryAt(known=known, text=text, joints=list(self.params.joints), point=_told(point))

    def sample(self, wall_offset_ns: int) -> TrajectorySample | None:
        """Return where the joints were to be and where they were, in the last cycle that moved or held them."""
        if not self.stamp:
            return None
        return TrajectorySample(
            time=self.published(wall_offset_ns),
            joints=self.params.joints,
            executing=self.goal is not None,
            holding=self.holding,
            reference=_told(self.desired),
            feedback=_told(self.actual),
            error=_told(self.error),
            output=_told(self.output),
            speed_scaling_factor=self.scaling,
        )

    @property
    def actual(self) -> Point:
        """Where the joints were in the last cycle."""
        return self._group.actual

    @property
    def error(self) -> Point:
        """By how much the joints were off what was desired."""
        return self._group.error

    def _check(self, message: JointTrajectory, now: int) -> None:
        if self.state.value != "active":
            raise self.refusal(f"is {self.state.value}; activate it before sending it trajectories")
        if self._waiting is not None:
            raise self.refusal(f"cannot move: {self._why(self._waiting)}, then send it again")
        given = self.params
        rules = Rules(
            given.joints,
            given.allow_partial_joints_goal,
            given.allow_nonzero_velocity_at_trajectory_end,
            given.allow_integration_in_goal_trajectories,
            self._group.has_effort,
        )
        if (refused := broken_rule(message, rules, now)) is not None:
            raise self._refused(refused.text, refused.rule.code)
        here = dict(zip(given.joints, self._group.actual.positions, strict=True))
        wrong = beyond(message, self._limits)
        if wrong is None:
            wrong = far_start(message, here, self._limits, given.allowed_start_tolerance)
        wrong = wrong or self._misfit(message)
        if wrong is not None:
            raise self._refused(wrong)

    def _misfit(self, message: JointTrajectory) -> str | None:
        """Say which position the object behind a command cannot hold, None if it holds all."""
        joints, group = self.params.joints, self._group
        for index, command in enumerate(group.commands.get(POSITION, ())):
            joint = joints[group.places[index]]
            if joint not in message.joint_names:
                continue
            place = message.joint_names.index(joint)
            found = column([each.positions for each in message.points], place)
            for value in (min(found), max(found)) if found else ():
                if (fits := command.misfit(value)) is not None:
                    return f"it leads {joint} to {value:g}, and {fits}; plan within that"
        return None

    def _refused(self, text: str, code: ResultCode = ResultCode.INVALID_GOAL) -> ControlError:
        return TrajectoryRefused(str(self.refusal(f"refuses the trajectory: {text}")), code)

    def _queue(self, message: JointTrajectory, now: int) -> None:
        self._queued = message
        self.holding = False
        self.life.give(now)

    # ----------------------------------------------------------------------------------------------------- cycle

    def update(self, now: int, period: float) -> ReturnType:
        """Command what the trajectory says one period ahead, and judge where the joints are."""
        if self._scaling_state is not None:
            factor = self._scaling_state.value
            self.scaling = (
                factor if 0.0 <= factor < math.inf else 0.0
            )  # time stands while nobody knows how fast it runs
        if self._scaling_command is not None:
            self._scaling_command.value = self._wanted_scaling
        if self._changed is not None:
            self._take_changes(self._changed)
        group = self._group
        waiting = group.waits_for()
        if waiting is not None:
            self._give_up(waiting)
            return OK
        if self._waiting is not None:
            self._rise()
        if self._queued is not self._taken:
            self._take_queued()
        group.read()
        motion = self._motion
        if motion is None:
            return OK
        fresh = not motion.sampled
        if fresh:
            self._begin(motion, now)
        else:
            self._time += int(round(period * 1e9) * self.scaling)
        motion.sample(self._time, self.desired)
        self.desired.time = self._time - motion.start
        ok = motion.sample(self._time + self._period_ns, self.output, ahead=True)
        group.actual.time, self.stamp = now - motion.start, now
        if ok:
            self._follow(motion, now, period, fresh)
        return OK

    def _begin(self, motion: Motion, now: int) -> None:
        """Take where the joints are, or were to be, before the first point."""
        if self.params.from_desired and self._last.positions:
            self._last_time = self._last_time or now
            motion.set_before(self._last_time, self._last, self._group.wrap)
        else:
            motion.set_before(now, self._group.actual, self._group.wrap)
        self._time = now

    def _follow(self, motion: Motion, now: int, period: float, fresh: bool) -> None:
        group, tolerances = self._group, self.tolerances
        over = motion.is_over
        past = self._time / 1e9 - (motion.start + motion.time_of(motion.first)) / 1e9
        if over and not self.holding and 0.0 < self._timeout < past:
            text = f"no other trajectory came for {past:.2f} s after the end"
            self._end(GoalState.ABORTED, ResultCode.GOAL_TOLERANCE_VIOLATED, text)
            self._brake()
        group.compare(self.desired)
        left, outside = -1, -1
        if not self.holding:
            for joint in range(len(group.joints)):
                if (fresh or not over) and not within(tolerances.path[joint], group.error, joint):
                    left = joint
                if over and not within(tolerances.goal[joint], group.error, joint):
                    outside = joint
        late = outside >= 0 and 0.0 < tolerances.goal_time < past
        if left < 0 and not late:
            self._write(period)
            self._last.take(self.output)
            self._last_time = now
        self._judge(over, left, outside, late)

    def _write(self, period: float) -> None:
        group, output, loops = self._group, self.output, self._loops
        if group.has_position:
            group.write(POSITION, output.positions)
        if loops is not None:
            kind = VELOCITY if group.has_velocity else EFFORT
            commands = group.commands[kind]
            for index in range(len(commands)):
                commands[index].value = loops.compute(index, output, group.error, period)
            return
        if group.has_velocity:
            group.write(VELOCITY, output.velocities)
        if group.has_acceleration:
            group.write(ACCELERATION, output.accelerations)
        if group.has_effort:
            group.write(EFFORT, self.desired.effort)

    def _judge(self, over: bool, left: int, outside: int, late: bool) -> None:
        """End the goal, or the trajectory, by what was found: who left the path, who is outside at the end."""
        if self.holding:
            return
        joints = self._group.joints
        if left >= 0:
            off, allowed = self._group.error.positions[left], self.tolerances.path[left].position
            text = f"{joints[left]} is {off:g} off its path, and {allowed:g} is its tolerance; see what holds it back"
            self._end(GoalState.ABORTED, ResultCode.PATH_TOLERANCE_VIOLATED, text)
            self._brake()
        elif over and self.goal is not None and outside < 0:
            self._end(GoalState.SUCCEEDED, ResultCode.SUCCESSFUL, "the goal was reached")
            self._hold_at_end()
        elif late:
            off, time = self._group.error.positions[outside], self.tolerances.goal_time
            text = f"{joints[outside]} is {off:g} off its goal {time:g} s after the end; see what holds it back"
            self._end(GoalState.ABORTED, ResultCode.GOAL_TOLERANCE_VIOLATED, text)
            self._brake()

    # ----------------------------------------------------------------------------------------------------- inside

    def _take_changes(self, given: TrajectoryParams) -> None:
        self.params, self._changed = given, None
        self._default = given.tolerances()
        if self._loops is not None:
            self._loops.set_gains(given.gains)

    def _take_limits(self) -> None:
        """Take the limits that the hardware interfaces know beside the description's."""
        given, group = self.params, self._group
        self._default = given.tolerances()
        self._timeout = given.cmd_timeout if given.cmd_timeout > given.goal_time else 0.0
        for index, command in enumerate(group.commands.get(POSITION, ())):
            joint = given.joints[group.places[index]]
            known = self._limits[joint]
            lower, upper = max(known.lower, command.minimum), min(known.upper, command.maximum)
            self._limits[joint] = JointLimits(lower, upper, known.velocity, known.continuous)

    def _take_queued(self) -> None:
        """Begin what was queued; joints that it does not name stay."""
        message, group = self._queued, self._group
        self._taken = message
        if message is None or isinstance(message, Stop):
            self._motion = message
            return
        if message is not self._hold:
            if len(message.joint_names) != len(group.joints):
                group.read()
                fill_up(message, group.joints, group.targets(), group.actual.positions)
            put_in_order(message, group.joints)
        self._motion = Trajectory(message, self.params.interpolation_method == "splines")

    def _give_up(self, joint: str) -> None:
        """Command nothing while a joint does not follow; the goal ends with its name."""
        self._waiting = joint
        if self.goal is not None:
            text = f"{self._why(joint)}, then send the goal again"
            self._end(GoalState.ABORTED, ResultCode.INVALID_GOAL, text)
        self._motion = self._queued = self._taken = None
        self.holding = True
        self._group.let_go()

    def _why(self, joint: str) -> str:
        """Say why a joint does not follow, and what to do."""
        waiting = [each for each in self.commands if not each.enabled]
        return self.explain(waiting) if waiting else f"{joint}: nobody knows its position; wait for its feedback"

    def _rise(self) -> None:
        """Hold the joints where they are, now that all follow."""
        self._waiting = None
        self._group.read()
        self._last.take(self._group.actual)
        if self._loops is not None:
            self._loops.reset()
        self._hold_here()

    def _hold_here(self) -> None:
        """Stay where the joints are; one point that is rewritten, since a hold has no course to jump on."""
        self._set_hold(self._group.actual)
        point, group = self._hold.points[0], self._group
        zeros = [0.0] * len(group.joints)
        point.velocities[:] = zeros if group.has_velocity or group.has_acceleration else ()
        point.accelerations[:] = zeros if group.has_acceleration else ()
        point.effort[:] = zeros if group.has_effort else ()

    def _hold_at_end(self) -> None:
        """Stay at the last point, with all that it says."""
        motion = self._motion
        if isinstance(motion, Trajectory) and motion.points:
            self._set_hold(motion.points[-1])

    def _set_hold(self, point: Point) -> None:
        self._hold.points[0].take(point)
        self._hold.points[0].time = 0
        self._queued, self.holding = self._hold, True

    def _brake(self) -> None:
        """Come to rest: with the deceleration of each joint where all have one, else at once; then stay."""
        self.life.end()
        given, group = self.params, self._group
        slopes = [each.max_deceleration_on_cancel for each in given.constraints]
        known = all(0.0 < self._limits[each].velocity < math.inf for each in given.joints)
        if not (given.decelerate_on_cancel and group.knows_velocity and known and all(slopes)):
            self._hold_here()
            return
        self._queued, self.holding = Stop(slopes), True

    def _end(self, state: GoalState, code: ResultCode, text: str) -> None:
        """Give the goal its result, where there is one."""
        goal, self.goal = self.goal, None
        if goal is None:
            if code in (ResultCode.PATH_TOLERANCE_VIOLATED, ResultCode.GOAL_TOLERANCE_VIOLATED):
                self.tell("trajectory_ended", f"{text}; the joints are held")
            return
        goal.end(state, code, text)
        self.life.end()
        if state is not GoalState.SUCCEEDED:
            self.tell(f"goal_{state.value}", text)


def _limits_of(joint: Joint | None) -> JointLimits:
    if joint is None:
        return JointLimits()
    limits = joint.limits
    return JointLimits(limits.lower, limits.upper, limits.velocity, joint.type == "continuous")


def _told(point: Point) -> TrajectoryPoint:
    return TrajectoryPoint(
        positions=list(point.positions),
        velocities=list(point.velocities),
        accelerations=list(point.accelerations),
        effort=list(point.effort),
        time_from_start=point.time / 1e9,
    )


def _positions_alone(message: JointTrajectory) -> bool:
    return not any(each.velocities or each.accelerations or each.effort for each in message.points)
