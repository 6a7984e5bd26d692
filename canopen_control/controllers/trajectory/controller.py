"""joint_trajectory_controller/JointTrajectoryController: arms that move as MoveIt expects.

The law of the file (ros2_controllers jazzy): a trajectory is taken between two cycles and begins in the next one; the
command is what it says one period ahead; on the way and at the end the joints are held against the tolerances of the
goal. Ours, and safer: while a joint does not follow commands nothing is commanded to any, and its goal ends with a
sentence that names it; once all follow again they are held where they are, never where they were going.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

from canopen_control.controllers.base import Controller
from canopen_control.controllers.trajectory.acceptance import Acceptance
from canopen_control.controllers.trajectory.follower import Follower
from canopen_control.controllers.trajectory.goal import Goal, GoalState, ResultCode
from canopen_control.controllers.trajectory.joint_group import JointGroup
from canopen_control.controllers.trajectory.judgement import Judgement
from canopen_control.controllers.trajectory.params import TrajectoryParams, read_params
from canopen_control.controllers.trajectory.point import JointTrajectory, Point
from canopen_control.controllers.trajectory.scaling import SpeedScaling
from canopen_control.controllers.trajectory.tolerances import SegmentTolerances, resolve
from canopen_control.controllers.trajectory.upsampling import positions_alone, upsampled
from canopen_control.errors import ControlError, RobotConfigError, TrajectoryRefused
from canopen_control.hardware.interfaces import OK, POSITION, ReturnType
from canopen_control.rpc.messages.samples import TrajectorySample
from canopen_control.rpc.messages.trajectory import TrajectoryAt

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.controllers.params import Params
    from canopen_control.controllers.trajectory.followed import Motion
    from canopen_control.controllers.trajectory.judgement import Verdict
    from canopen_control.hardware.interfaces import CommandInterface, StateInterface
    from canopen_control.rpc.messages.samples import Sample

__all__ = ["JointTrajectoryController"]

NS = 1_000_000_000


class JointTrajectoryController(Controller):
    """Follows trajectories of positions, velocities, accelerations or efforts of several joints.

    `holding` says that it stays where it is; `goal` is the one that is being executed, `tolerances` those that count.
    `desired`, `output`, `actual` and `error` are those of the last cycle.
    """

    tells: ClassVar[type[Sample] | None] = TrajectorySample
    settable: ClassVar[tuple[str, ...]] = (
        "gains.*.p", "gains.*.i", "gains.*.d", "gains.*.i_clamp*", "gains.*.u_clamp*",
        "gains.*.tracking_time_constant", "gains.*.error_deadband", "gains.*.ff_velocity_scale",
        "constraints.stopped_velocity_tolerance",
        "constraints.goal_time", "constraints.*.trajectory", "constraints.*.goal", "allow_partial_joints_goal",
        "allow_integration_in_goal_trajectories", "allow_nonzero_velocity_at_trajectory_end", "cmd_timeout",
        "set_last_command_interface_value_as_state_on_activation", "allow_trajectory_replacement",
        "allowed_start_tolerance", "continue_without_client", "unreachable_points",
    )  # fmt: skip

    def __init__(self, name: str, type_name: str = "joint_trajectory_controller/JointTrajectoryController") -> None:
        super().__init__(name, type_name)
        self.params = TrajectoryParams()
        self.goal: Goal | None = None
        self.speed = SpeedScaling()
        self.refused_tolerances: str | None = None
        self._group = JointGroup((), (), (), ())
        self._follower = Follower(self.params, self._group, NS // 100)
        self._acceptance = Acceptance(self.params, self._group, {})
        self._judgement = Judgement(self._group)
        self._changed: TrajectoryParams | None = None
        self._waiting: str | None = None
        self._timeout = 0.0
        self._default = self.tolerances = SegmentTolerances((), ())

    # ------------------------------------------------------------------------------------------------- lifecycle

    def on_configure(self, params: Params) -> None:
        """Read the parameters, see `params`; what cannot be together is an error."""
        self.params = given = read_params(params, self.name)
        self._changed = None
        self.update_rate = given.update_rate
        if self.cycle_rate <= 0:
            raise RobotConfigError(f"{self.name}: the update_rate is {self.cycle_rate} Hz; give one above 0")
        self._group = group = JointGroup(
            given.joints, given.commanded, given.command_interfaces, given.state_interfaces
        )
        self.joints, self.interface = given.commanded, ", ".join(given.command_interfaces)
        self._follower = Follower(given, group, NS // min(given.update_rate or self.cycle_rate, self.cycle_rate))
        self._acceptance = Acceptance(given, group, self.description)
        self._judgement = Judgement(group)
        group.wrap[:] = self._acceptance.continuous
        self._default = self.tolerances = given.tolerances()
        if (useless := self._acceptance.cannot_brake()) is not None:
            self.tell("decelerate_on_cancel", useless)
        positions = tuple(given.command_interfaces) == (POSITION,)
        self.speed = SpeedScaling(given.initial_scaling_factor, allowed=positions)

    def on_set(self, params: Params) -> None:
        """Take other gains, and tolerances of trajectories to come, in the next cycle; a time-out once activated."""
        self.change(read_params(params, self.name))

    def command_interface_names(self) -> list[str]:
        """Return those of each commanded joint, and that of the speed scaling."""
        return self._group.command_names + ([self.params.scaling_command] if self.params.scaling_command else [])

    def state_interface_names(self) -> list[str]:
        """Return those of each joint, and that of the speed scaling."""
        return self._group.state_names + ([self.params.scaling_state] if self.params.scaling_state else [])

    def on_activate(self, commands: list[CommandInterface], states: list[StateInterface], now: int) -> None:
        """Take the interfaces and hold the joints where they are."""
        super().on_activate(commands, states, now)
        if self._changed is not None:  # while it was inactive
            self._take_changes(self._changed)
        group = self._group
        group.take(commands[: len(group.command_names)], states[: len(group.state_names)])
        self.speed.take(
            states[-1] if self.params.scaling_state else None, commands[-1] if self.params.scaling_command else None
        )
        given = self.params
        self._default = given.tolerances()
        self._timeout = given.cmd_timeout if given.cmd_timeout > given.goal_time else 0.0
        self._acceptance.take_limits()
        group.wrap[:] = self._acceptance.continuous
        self._follower.limiter = self._acceptance.point_limiter()
        self.stamp, self.goal = 0, None
        self.life.end()
        group.actual = group.blank()
        group.read()
        if given.set_last_command_interface_value_as_state_on_activation:
            group.begin_with_commands()
        self._follower.begin()
        self._waiting = group.waits_for()
        self._follower.hold()

    def on_deactivate(self, now: int) -> None:
        """Stop: the goal is aborted, positions stay as they are, all other targets become 0."""
        text = f"{self.name} was deactivated; activate it and send again"
        self._end(GoalState.ABORTED, ResultCode.INVALID_GOAL, text)
        super().on_deactivate(now)
        self._follower.drop(holding=False)

    def forget(self, now: int) -> None:
        """Give up what was commanded: joints that do not follow end the goal, where all do they brake."""
        del now
        self._waiting = self._group.waits_for()
        why = self.life.ended_by or "it was to stop"
        self.life.end()
        if self._waiting is not None:
            self._give_up(self._waiting)
            return
        who = self.life.source or "who commanded"
        text = f"{why}, so the command of {who} was taken back; send it again once the joints are enabled"
        self._end(GoalState.ABORTED, ResultCode.INVALID_GOAL, text)
        self._brake()

    def change(self, params: TrajectoryParams) -> None:
        """Take other parameters in the next cycle: tolerances of trajectories to come, and the gains."""
        self._changed = params

    # -------------------------------------------------------------------------------------------------- commands

    def set_trajectory(self, message: JointTrajectory, now: int) -> None:
        """Follow a trajectory from the next cycle on; ControlError, and nothing changes, if it is refused.

        A goal that is being executed is judged by it from then on.
        """
        given = self.params
        if given.upsampling and given.interpolation_method == "splines" and positions_alone(message):
            message.points = upsampled(message, given.policy_frequency) or message.points
        self._check(message, now)
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
        """Cancel what is followed, be it a goal or none, or `only` this goal; ControlError if nothing is."""
        goal = only or self.goal
        if goal is not None:
            self.cancel(goal, why)
        elif self.holding or self.state.value != "active":
            raise ControlError(f"{self.name} follows no trajectory; there is nothing to cancel")
        else:
            self.tell("trajectory_ended", "the trajectory was cancelled; the joints are held")
            self._brake()

    def set_speed_scaling(self, factor: float) -> None:
        """Let the time of trajectories run slower or faster; ControlError below 0 and where it cannot be scaled."""
        if (wrong := self.speed.mistake(factor)) is not None:
            raise self.refusal(wrong)
        self.speed.set(factor)

    def query(self, t: int, out: Point) -> bool:
        """Write what the trajectory says at `t`, in ns, into `out`; False, with where the joints are, if nothing."""
        return self._follower.query(t, out)

    def trajectory_at(self, t: int) -> TrajectoryAt:
        """Return what the trajectory says at `t`, in ns; where it says nothing, where the joints are."""
        if self.state.value != "active":
            return TrajectoryAt(known=False, text=f"{self.name} is {self.state.value}; activate it first")
        return self._follower.told(t, self.name)

    def sample(self, wall_offset_ns: int) -> TrajectorySample | None:
        """Return where the joints were to be and where they were, in the last cycle that moved or held them."""
        if not self.stamp:
            return None
        return self._follower.sample_of(self.published(wall_offset_ns), self.goal is not None, self.speed.factor)

    @property
    def holding(self) -> bool:
        """Whether the joints stay where they are, or come to rest."""
        return self._follower.holding

    @property
    def desired(self) -> Point:
        """Where the joints were to be in the last cycle."""
        return self._follower.desired

    @property
    def output(self) -> Point:
        """What they were commanded then, for the next one."""
        return self._follower.output

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
        begin = self._follower.where_it_begins(message.stamp)
        if (wrong := self._acceptance.mistake(message, now, begin)) is not None:
            raise TrajectoryRefused(str(self.refusal(f"refuses the trajectory: {wrong.text}")), wrong.code)
        if (doubt := self._acceptance.doubt(message)) is not None:
            self.tell("unreachable", f"{doubt}; until then it is behind")

    def _queue(self, message: JointTrajectory, now: int) -> None:
        self._follower.follow(message)
        self._follower.limited = None
        self.life.give(now)

    # ----------------------------------------------------------------------------------------------------- cycle

    def update(self, now: int, period: float) -> ReturnType:
        """Command what the trajectory says one period ahead, and judge where the joints are."""
        self.speed.update()
        if self._changed is not None:
            self._take_changes(self._changed)
        group, follower = self._group, self._follower
        waiting = group.waits_for()
        if waiting is not None:
            self._give_up(waiting)
            return OK
        if self._waiting is not None:
            self._waiting = None
            follower.rise()
        follower.take_queued()
        group.read()
        if follower.motion is None:
            return OK
        found = follower.sample(now, period, self.speed.factor)
        self.stamp = now
        if found:
            self._follow(follower.motion, now, period)
        return OK

    def _follow(self, motion: Motion, now: int, period: float) -> None:
        """Command what was worked out, unless a joint is off its path or late at its goal."""
        group, follower, judgement = self._group, self._follower, self._judgement
        over, past = motion.is_over, follower.past
        if over and not follower.holding and 0.0 < self._timeout < past:
            text = f"no other trajectory came for {past:.2f} s after the end"
            self._end(GoalState.ABORTED, ResultCode.GOAL_TOLERANCE_VIOLATED, text)
            self._brake()
        group.compare(follower.desired)
        judgement.look(self.tolerances, follower, over=over, past=past)
        if not judgement.stops:
            free = follower.limited is None
            follower.write(now, period)
            if free and follower.limited is not None:
                self.tell("limited", f"{follower.limited} is held back by its limits; plan slower, or see joint_limits")
        if not follower.holding:
            self._take_verdict(judgement.verdict(self.tolerances))

    def _take_verdict(self, verdict: Verdict | None) -> None:
        """End the goal, or the trajectory, by what was found."""
        if verdict is None:
            return
        if verdict.state is GoalState.SUCCEEDED:
            if self.goal is not None:
                self._end(verdict.state, verdict.code, verdict.text)
                self._follower.hold_at_end()
            return
        self._end(verdict.state, verdict.code, verdict.text)
        self._brake()

    # ----------------------------------------------------------------------------------------------------- inside

    def _take_changes(self, given: TrajectoryParams) -> None:
        self.params, self._changed = given, None
        self._default = given.tolerances()
        self._acceptance.take_params(given)
        self._follower.set_gains(given)

    def _give_up(self, joint: str) -> None:
        """Command nothing while a joint does not follow; the goal ends with its name."""
        self._waiting = joint
        if self.goal is not None:
            text = f"{self._why(joint)}, then send the goal again"
            self._end(GoalState.ABORTED, ResultCode.INVALID_GOAL, text)
        self._follower.drop(holding=True)
        self._group.let_go()

    def _why(self, joint: str) -> str:
        """Say why a joint does not follow, and what to do."""
        waiting = [each for each in self.commands if not each.enabled]
        return self.explain(waiting) if waiting else f"{joint}: nobody knows its position; wait for its feedback"

    def _brake(self) -> None:
        """Come to rest: with the deceleration of each joint where all have one, else at once; then stay."""
        self.life.end()
        if not self.params.decelerate_on_cancel or self._acceptance.cannot_brake() is not None:
            self._follower.hold()
            return
        self._follower.brake([each.max_deceleration_on_cancel for each in self.params.constraints])

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
