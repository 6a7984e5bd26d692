"""Joint trajectory controller: executes trajectories as MoveIt expects.

Rules (ros2_controllers jazzy, joint_trajectory_controller/JointTrajectoryController): a trajectory is accepted between
two cycles and begins in the next one; the command is its sample one period ahead; during the motion and at the end the
joints are checked against the tolerances of the goal. Safer than upstream: while a joint does not follow commands, no
joint is commanded, and the goal ends with a text that names the joint; once all joints follow again, they are held at
their positions.
"""

from __future__ import annotations

import copy
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Final, overload

from canopen_control.controllers.base import Controller
from canopen_control.controllers.command_timeout import GoalState
from canopen_control.controllers.limiters import IMMOBILE, SLOW_STOP
from canopen_control.controllers.trajectory.executor import SpeedScaling, TrajectoryExecutor
from canopen_control.controllers.trajectory.goal import ResultCode, TrajectoryGoal
from canopen_control.controllers.trajectory.joint_group import JointGroup
from canopen_control.controllers.trajectory.params import (
    JointConstraints,
    JointGains,
    LimitParams,
    SegmentTolerances,
    TrajectoryParams,
    read_params,
    resolve,
    within,
)
from canopen_control.controllers.trajectory.point import JointTrajectory, Point, Points
from canopen_control.controllers.trajectory.validation import (
    NONE,
    Acceptance,
    PointBuffer,
    SurveyedPoints,
    TrajectorySummary,
    survey_of,
)
from canopen_control.errors import ControlError, RobotConfigError, TrajectoryRefused
from canopen_control.hardware.interfaces import OK, ReturnType
from canopen_control.rpc.messages.samples import TrajectorySample
from canopen_control.rpc.messages.trajectory import TrajectoryAt
from canopen_control.urdf.joint_element import POSITION

if TYPE_CHECKING:
    from canopen_control.controllers.params import Params
    from canopen_control.controllers.trajectory.active_trajectory import JointSetpoint
    from canopen_control.controllers.trajectory.params import StateTolerance
    from canopen_control.hardware.interfaces import CommandInterface, StateInterface
    from canopen_control.rpc.messages.samples import Sample


# Check of the tolerances of a trajectory, during the motion and at its end, and the reports of violations.
#
# Rules (ros2_controllers jazzy): during the motion, and in the first cycle, the path tolerances apply, at the end the
# goal tolerances. A missed goal is aborted `goal_time` after the end; with a `goal_time` of 0 there is no time limit.


_NOBODY = -1


@dataclass(frozen=True)
class ToleranceResult:
    """Result of a tolerance check, with an explanation for the client."""

    state: GoalState
    code: ResultCode
    text: str


class _Tolerated:
    """Tolerances of all joints, prepared for a fast check in every cycle.

    Positions are checked first, because often they are the only ones with a tolerance.
    """

    __slots__ = ("_all", "_more", "_positions")

    def __init__(self, tolerances: Sequence[StateTolerance]) -> None:
        self._all = tolerances
        self._positions = [tolerance.position if tolerance.position > 0.0 else math.inf for tolerance in tolerances]
        self._more = any(tolerance.velocity > 0.0 or tolerance.acceleration > 0.0 for tolerance in tolerances)

    def exceeded(self, error: Point) -> int:
        """Return the index of the last joint whose error exceeds its tolerance, or `_NOBODY`."""
        last, off, most = _NOBODY, error.positions, self._positions
        for joint in range(len(most)):
            if abs(off[joint]) > most[joint] or (self._more and not within(self._all[joint], error, joint)):
                last = joint
        return last


class ToleranceMonitor:
    """Tolerance check of the current cycle.

    `left` is the index of a joint outside its path tolerance, `outside` that of a joint outside its goal tolerance,
    both -1 if there is none. `over` is True at the end of the trajectory, `late` if the goal is not reached within
    `goal_time` after the end.
    """

    def __init__(self, group: JointGroup) -> None:
        self._group = group
        self.left = self.outside = _NOBODY
        self.over = self.late = False
        self._path, self._goal = _Tolerated(()), _Tolerated(())
        self._known: SegmentTolerances | None = None

    @property
    def stops(self) -> bool:
        """Whether the trajectory has failed and must not be commanded any longer."""
        return self.left >= 0 or self.late

    def check(
        self, tolerances: SegmentTolerances, follower: TrajectoryExecutor, *, over: bool, time_since_end: float
    ) -> None:
        """Compare the errors of this cycle with the tolerances; `time_since_end` is in s."""
        self.left, self.outside, self.over, self.late = _NOBODY, _NOBODY, over, False
        if follower.holding:
            return
        if tolerances is not self._known:
            self._known = tolerances
            self._path, self._goal = _Tolerated(tolerances.path), _Tolerated(tolerances.goal)
        if follower.fresh or not over:
            self.left = self._path.exceeded(self._group.error)
        if over:
            self.outside = self._goal.exceeded(self._group.error)
        self.late = self.outside >= 0 and 0.0 < tolerances.goal_time < time_since_end

    def verdict(self, tolerances: SegmentTolerances) -> ToleranceResult | None:
        """Return the result of the last check, or None while the trajectory continues."""
        joints, errors = self._group.joints, self._group.error.positions
        if self.left >= 0:
            off, allowed = errors[self.left], tolerances.path[self.left].position
            deviation = f"{joints[self.left]} is {off:g} off its path, with a tolerance of {allowed:g}"
            return ToleranceResult(
                GoalState.ABORTED, ResultCode.PATH_TOLERANCE_VIOLATED, f"{deviation}; check what blocks the joint"
            )
        if self.over and self.outside < 0:
            return _REACHED
        if self.late:
            off, time = errors[self.outside], tolerances.goal_time
            deviation = f"{joints[self.outside]} is {off:g} off its goal {time:g} s after the end"
            return ToleranceResult(
                GoalState.ABORTED, ResultCode.GOAL_TOLERANCE_VIOLATED, f"{deviation}; check what blocks the joint"
            )
        return None


_REACHED = ToleranceResult(GoalState.SUCCEEDED, ResultCode.SUCCESSFUL, "the goal was reached")


# Velocities for trajectories that contain positions only, as policies send them: a cubic spline through all points.
#
# Rules (ros2_controllers rolling, positions_upsampling): the spline has continuous accelerations and zero velocity at
# both ends. Difference from upstream: the velocities are computed in blocks of points when the motion reaches them, so
# that a long trajectory delays neither its acceptance nor a cycle. The influence of a point on a velocity decreases
# with every point in between, by a factor of 0.27 for equal time steps and 0.5 at worst: `_REACH` points away it is
# 1e-14, at worst 1e-7.


_REACH: Final = 24
_BLOCK: Final = 16  # points whose velocities are computed together

Block = list[list[float]]


def positions_alone(message: JointTrajectory) -> bool:
    """Whether the points of a trajectory have only positions."""
    return not any(set(size) - {0} for size in survey_of(message).sizes[1:])


def upsampled(message: JointTrajectory, frequency: float) -> UpsampledPoints | None:
    """Return the points of a trajectory with the velocities of a spline through their positions.

    The result is None if the positions are incomplete or the times do not increase. If all times are 0 and `frequency`
    (Hz) is not, the points get the times of a policy that runs at this frequency.
    """
    survey, points = survey_of(message), message.points
    if len(survey.sizes[0]) != 1 or 0 in survey.sizes[0]:
        return None
    times: Sequence[int] = points.times if isinstance(points, Points) else [point.time for point in points]
    if frequency > 0.0 and not any(times):
        times, survey = PolicyTimes(len(times), frequency), copy.copy(survey)
        survey.not_increasing = NONE
    return UpsampledPoints(points, times, survey) if survey.not_increasing == NONE else None


class PolicyTimes(Sequence[int]):
    """Times of a policy's points in ns: point `index` is `index` + 1 periods after the start."""

    def __init__(self, count: int, frequency: float) -> None:
        self._count, self._frequency = count, frequency

    def __len__(self) -> int:
        return self._count

    @overload
    def __getitem__(self, index: int) -> int: ...
    @overload
    def __getitem__(self, index: slice) -> list[int]: ...
    def __getitem__(self, index: int | slice) -> int | list[int]:
        if isinstance(index, slice):
            return [self[place] for place in range(*index.indices(self._count))]
        if not -self._count <= index < self._count:
            raise IndexError(index)
        return int((index % self._count + 1) / self._frequency * 1e9)


class UpsampledPoints(SurveyedPoints):
    """Points with positions and spline velocities; `source` provides the positions, `times` are in ns."""

    def __init__(self, source: Sequence[Point] | Points, times: Sequence[int], survey: TrajectorySummary) -> None:
        self.times, self.survey = times, survey
        self._source = source
        self._blocks: dict[int, Block] = {}  # velocities of the last two blocks, by the index of their first point

    def __getitem__(self, index: int) -> Point:
        if index < 0:
            index += len(self)
        begin = index - index % _BLOCK
        block = self._blocks.get(begin)
        if block is None:
            block = self._block_velocities(begin)
            if len(self._blocks) > 1:
                del self._blocks[next(iter(self._blocks))]
            self._blocks[begin] = block
        return Point(self._source[index].positions, block[index - begin], time=self.times[index])

    def _block_velocities(self, begin: int) -> Block:
        """Compute the velocities of a block, assuming standstill `_REACH` points before and after it."""
        last = len(self) - 1
        first, end = max(0, begin - _REACH), min(last, begin + _BLOCK - 1 + _REACH)
        if not last:
            return [[]]
        source = self._source
        if isinstance(source, PointBuffer):
            positions = source.positions(first, end + 1)
        else:
            positions = [source[index].positions for index in range(first, end + 1)]
        times = [self.times[index] for index in range(first, end + 1)]
        velocities = _spline(positions, [(b - a) / 1e9 for a, b in itertools.pairwise(times)])
        return velocities[begin - first : begin - first + _BLOCK]


def _spline(positions: Sequence[Sequence[float]], steps: Sequence[float]) -> Block:
    """Return the velocities at all points, 0 at both ends, by the Thomas algorithm; `steps` are time steps in s."""
    still = [0.0] * len(positions[0])
    uppers, rows = [0.0], [still]
    for i, (h, k) in enumerate(itertools.pairwise(steps)):
        p0, p1, p2 = positions[i : i + 3]
        upper, before = uppers[-1], rows[-1]
        diagonal = (2.0 - upper) / h + 2.0 / k
        ahead, behind = 3.0 / (k * k), 3.0 / (h * h)
        rows.append(
            [
                (ahead * (c - b) + behind * (b - a) - r / h) / diagonal
                for a, b, c, r in zip(p0, p1, p2, before, strict=True)
            ]
        )
        uppers.append(1.0 / (k * diagonal))
    velocities = [still]
    for upper, row in zip(reversed(uppers), reversed(rows), strict=True):
        velocities.append([r - upper * v for r, v in zip(row, velocities[-1], strict=True)])
    velocities.reverse()
    velocities[0] = list(still)
    return velocities


NS = 1_000_000_000


class JointTrajectoryController(Controller):
    """Controller that executes trajectories of several joints.

    Trajectories may command positions, velocities, accelerations or efforts. `goal` is the goal in execution,
    `tolerances` are the applied tolerances. `desired`, `output`, `actual` and `error` are those of the last cycle.
    """

    title: ClassVar[str] = "Joint trajectories"
    reads: ClassVar[type[TrajectoryParams]] = TrajectoryParams
    sections: ClassVar[dict[str, type[object]]] = {
        "Each joint: `gains.JOINT.KEY`": JointGains,
        "Each joint: `constraints.JOINT.KEY`": JointConstraints,
        "Each joint: `joint_limits.JOINT.KEY`": LimitParams,
    }
    sample_type: ClassVar[type[Sample] | None] = TrajectorySample
    settable: ClassVar[tuple[str, ...]] = (
        "gains.*.p", "gains.*.i", "gains.*.d", "gains.*.i_clamp*", "gains.*.u_clamp*",
        "gains.*.tracking_time_constant", "gains.*.error_deadband", "gains.*.ff_velocity_scale",
        "constraints.stopped_velocity_tolerance",
        "constraints.goal_time", "constraints.*.trajectory", "constraints.*.goal", "allow_partial_joints_goal",
        "allow_integration_in_goal_trajectories", "allow_nonzero_velocity_at_trajectory_end", "cmd_timeout",
        "set_last_command_interface_value_as_state_on_activation", "allow_trajectory_replacement",
        "allowed_start_tolerance", "continue_without_client", "unreachable_points",
    )  # fmt: skip

    def __init__(self, name: str, type_name: str = "") -> None:
        super().__init__(name, type_name)
        self.params = TrajectoryParams()
        self.goal: TrajectoryGoal | None = None
        self.speed = SpeedScaling()
        self.refused_tolerances: str | None = None
        self._group = JointGroup((), (), (), ())
        self._follower = TrajectoryExecutor(self.params, self._group, NS // 100)
        self._acceptance = Acceptance(self.params, self._group, {})
        self._monitor = ToleranceMonitor(self._group)
        self._changed: TrajectoryParams | None = None
        self._waiting: str | None = None
        self._timeout = 0.0
        self._default = self.tolerances = SegmentTolerances((), ())

    # ------------------------------------------------------------------------------------------------- lifecycle

    def on_configure(self, params: Params) -> None:
        self.params = settings = read_params(params, self.name)
        self._changed = None
        self.update_rate = settings.update_rate
        if self.cycle_rate <= 0:
            raise RobotConfigError(f"{self.name}: the update_rate is {self.cycle_rate} Hz; give one above 0")
        self._group = group = JointGroup(
            settings.joints, settings.commanded, settings.command_interfaces, settings.state_interfaces
        )
        self.joints, self.interface = settings.commanded, ", ".join(settings.command_interfaces)
        self._follower = TrajectoryExecutor(
            settings, group, NS // min(settings.update_rate or self.cycle_rate, self.cycle_rate)
        )
        self._acceptance = Acceptance(settings, group, self.description)
        self._monitor = ToleranceMonitor(group)
        group.wrap[:] = self._acceptance.continuous
        self._default = self.tolerances = settings.tolerances()
        if (reason := self._acceptance.cannot_brake()) is not None:
            self.report("decelerate_on_cancel", reason)
        elif (slow := self._acceptance.slow_brake()) is not None:
            self.report(SLOW_STOP, slow)
        positions = tuple(settings.command_interfaces) == (POSITION,)
        self.speed = SpeedScaling(settings.initial_scaling_factor, allowed=positions)
        for text in settings.immobile():
            self.report(IMMOBILE, text)

    def on_set(self, params: Params) -> None:
        self.change(read_params(params, self.name))

    def command_interface_names(self) -> list[str]:
        return self._group.command_names + ([self.params.scaling_command] if self.params.scaling_command else [])

    def state_interface_names(self) -> list[str]:
        return self._group.state_names + ([self.params.scaling_state] if self.params.scaling_state else [])

    def on_activate(self, commands: list[CommandInterface], states: list[StateInterface], now: int) -> None:
        super().on_activate(commands, states, now)
        if self._changed is not None:  # changed while the controller was inactive
            self._apply_changes(self._changed)
        group = self._group
        group.set_interfaces(commands[: len(group.command_names)], states[: len(group.state_names)])
        self.speed.set_interfaces(
            states[-1] if self.params.scaling_state else None, commands[-1] if self.params.scaling_command else None
        )
        params = self.params
        self._default = params.tolerances()
        self._timeout = params.cmd_timeout if params.cmd_timeout > params.goal_time else 0.0
        self._acceptance.apply_interface_limits()
        group.wrap[:] = self._acceptance.continuous
        self._follower.limiter = self._acceptance.point_limiter()
        self.stamp, self.goal = 0, None
        self.command_timeout.end()
        group.actual = group.blank()
        group.read()
        if params.set_last_command_interface_value_as_state_on_activation:
            group.begin_with_commands()
        self._follower.begin()
        self._waiting = group.waits_for()
        self._follower.hold()

    def on_deactivate(self, now: int) -> None:
        text = f"{self.name} was deactivated; activate it and send again"
        self._end(GoalState.ABORTED, ResultCode.INVALID_GOAL, text)
        super().on_deactivate(now)
        self._follower.clear(holding=False)

    def forget(self, now: int) -> None:
        """Abort the goal; the joints brake, or are released if a joint does not follow commands."""
        del now
        self._waiting = self._group.waits_for()
        why = self.command_timeout.ended_by or "a stop was requested"
        self.command_timeout.end()
        if self._waiting is not None:
            self._give_up(self._waiting)
            return
        client = self.command_timeout.source or "an unnamed client"
        text = f"{why}, so the command of {client} was aborted; send it again once the joints are enabled"
        self._end(GoalState.ABORTED, ResultCode.INVALID_GOAL, text)
        self._brake()

    def change(self, params: TrajectoryParams) -> None:
        """Apply changed gains and options in the next cycle; changed tolerances apply to later trajectories."""
        self._changed = params

    # -------------------------------------------------------------------------------------------------- commands

    def set_trajectory(self, message: JointTrajectory, now: int) -> None:
        """Follow a trajectory from the next cycle on; if refused, raise ControlError with no change.

        The tolerances of a goal in execution then apply to this trajectory.
        """
        params = self.params
        if params.upsampling and params.interpolation_method == "splines" and positions_alone(message):
            message.points = upsampled(message, params.policy_frequency) or message.points
        self._check(message, now)
        self._queue(message, now)

    def send_goal(self, goal: TrajectoryGoal | JointTrajectory, now: int) -> None:
        """Start a goal or a trajectory in the next cycle; a new goal aborts the previous goal.

        Raise ControlError on a refusal. See `set_trajectory` for a trajectory without a goal.
        """
        if isinstance(goal, JointTrajectory):
            self.set_trajectory(goal, now)
            return
        self._check(goal.trajectory, now)
        self._end(GoalState.ABORTED, ResultCode.INVALID_GOAL, "another goal has replaced it")
        self.tolerances, self.refused_tolerances = resolve(goal.tolerances, self.params.joints, self._default)
        if self.refused_tolerances is not None:
            self.report("tolerances", self.refused_tolerances)
        self.goal = goal
        goal.feedback_rate, goal.outlives_client = self.params.action_monitor_rate, self.params.continue_without_client
        self._queue(goal.trajectory, now)

    def set_command(self, values: Sequence[float], now: int, stamp: int | None = None) -> None:
        del values, now, stamp
        raise self.refusal("accepts only trajectories and goals; send one with canopen-control trajectory play FILE")

    @property
    def brake_s(self) -> float:
        return self._acceptance.brake_s

    def cancel(self, goal: TrajectoryGoal, why: str | None = None) -> None:
        """Cancel a goal if it is active; the joints then brake and are held. `why` is reported."""
        if goal is self.goal:
            text = "the goal was cancelled" if why is None else f"the goal was cancelled: {why}"
            self._end(GoalState.CANCELED, ResultCode.SUCCESSFUL, text)
            self._brake()

    def cancel_goal(self, why: str | None = None, only: TrajectoryGoal | None = None) -> None:
        goal = only or self.goal
        if goal is not None:
            self.cancel(goal, why)
        elif self.holding or self.state.value != "active":
            raise ControlError(f"{self.name} is not executing a trajectory; nothing was cancelled")
        else:
            self.report("trajectory_ended", "the trajectory was cancelled; the joints are held")
            self._brake()

    def set_speed_scaling(self, factor: float) -> None:
        if (wrong := self.speed.mistake(factor)) is not None:
            raise self.refusal(wrong)
        self.speed.set(factor)

    def query(self, t: int, out: Point) -> bool:
        """Write the trajectory's state at `t`, in ns, to `out`; return False if it has ended by then.

        Without a trajectory the actual state is written, and the result is also False.
        """
        return self._follower.query(t, out)

    def trajectory_at(self, t: int) -> TrajectoryAt:
        if self.state.value != "active":
            return TrajectoryAt(known=False, text=f"{self.name} is {self.state.value}; activate it first")
        return self._follower.state_reading(t, self.name)

    def sample(self, wall_offset_ns: int) -> TrajectorySample | None:
        if not self.stamp:
            return None
        return self._follower.sample_of(self.published(wall_offset_ns), self.goal is not None, self.speed.factor)

    @property
    def holding(self) -> bool:
        """Whether the joints are held, or brake to a standstill."""
        return self._follower.holding

    @property
    def desired(self) -> Point:
        return self._follower.desired

    @property
    def output(self) -> Point:
        """Commanded state for the next cycle."""
        return self._follower.output

    @property
    def actual(self) -> Point:
        return self._group.actual

    @property
    def error(self) -> Point:
        return self._group.error

    def _check(self, message: JointTrajectory, now: int) -> None:
        if self.state.value != "active":
            raise self.refusal(f"is {self.state.value}; activate it before sending it trajectories")
        if self._waiting is not None:
            self._resume_if_ready()
        if self._waiting is not None:
            raise self.refusal(f"cannot move: {self._why(self._waiting)}, then send it again")
        begin = self._follower.start_positions(message.stamp)
        if (wrong := self._acceptance.mistake(message, now, begin)) is not None:
            raise TrajectoryRefused(str(self.refusal(f"refuses the trajectory: {wrong.text}")), wrong.code)
        if (problem := self._acceptance.unreachable_part(message)) is not None:
            self.report("unreachable", f"{problem}; the joint will lag behind")

    def _queue(self, message: JointTrajectory, now: int) -> None:
        self._follower.follow(message)
        self._follower.limited = None
        self.command_timeout.start(now)

    # ----------------------------------------------------------------------------------------------------- cycle

    def update(self, now: int, period: float) -> ReturnType:
        self.speed.update()
        if self._changed is not None:
            self._apply_changes(self._changed)
        group, follower = self._group, self._follower
        waiting = group.waits_for()
        if waiting is not None:
            self._give_up(waiting)
            return OK
        if self._waiting is not None:
            self._resume_if_ready()
        follower.start_queued()
        group.read()
        if follower.motion is None:
            return OK
        has_command = follower.sample(now, period, self.speed.factor)
        self.stamp = now
        if has_command:
            self._follow(follower.motion, now, period)
        return OK

    def _resume_if_ready(self) -> None:
        """Accept trajectories again if all joints follow commands; a goal may arrive before the next update."""
        self._waiting = self._group.waits_for()
        if self._waiting is None:
            self._follower.resume_at_rest()

    def _follow(self, motion: JointSetpoint, now: int, period: float) -> None:
        """Check the tolerances, and write the computed command unless the trajectory has failed."""
        group, follower, monitor = self._group, self._follower, self._monitor
        over, past = motion.is_over, follower.time_since_end
        if over and not follower.holding and 0.0 < self._timeout < past:
            text = f"no new trajectory arrived within {past:.2f} s after the end"
            self._end(GoalState.ABORTED, ResultCode.GOAL_TOLERANCE_VIOLATED, text)
            self._brake()
        group.compare(follower.desired)
        monitor.check(self.tolerances, follower, over=over, time_since_end=past)
        if not monitor.stops:
            free = follower.limited is None
            follower.write(now, period)
            if free and follower.limited is not None:
                self.report(
                    "limited", f"{follower.limited} is slowed down by its limits; plan slower, or raise joint_limits"
                )
        if not follower.holding:
            self._apply_result(monitor.verdict(self.tolerances))

    def _apply_result(self, verdict: ToleranceResult | None) -> None:
        """End the goal or the trajectory according to the result of the tolerance check."""
        if verdict is None:
            return
        if verdict.state is GoalState.SUCCEEDED:
            if self.goal is not None:
                self._end(verdict.state, verdict.code, verdict.text)
                self._follower.hold_at_end()
            return
        self._end(verdict.state, verdict.code, verdict.text)
        self._brake()

    # ----------------------------------------------------------------------------------------------------- internal

    def _apply_changes(self, params: TrajectoryParams) -> None:
        self.params, self._changed = params, None
        self._default = params.tolerances()
        self._acceptance.set_params(params)
        self._follower.set_gains(params)

    def _give_up(self, joint: str) -> None:
        """Abort the goal and release all joints because `joint` does not follow commands."""
        self._waiting = joint
        if self.goal is not None:
            text = f"{self._why(joint)}, then send the goal again"
            self._end(GoalState.ABORTED, ResultCode.INVALID_GOAL, text)
        self._follower.clear(holding=True)
        self._group.release()

    def _why(self, joint: str) -> str:
        """Return the reason why a joint does not follow commands, with the remedy."""
        waiting = [command for command in self.commands if not command.enabled]
        if waiting:
            return self.enable_status.reason(waiting)
        return f"{joint}: its position is unknown; wait for its feedback"

    def _brake(self) -> None:
        """Brake with the configured decelerations, then hold; hold at once if braking is disabled or impossible."""
        self.command_timeout.end()
        if not self.params.decelerate_on_cancel or self._acceptance.cannot_brake() is not None:
            self._follower.hold()
            return
        self._follower.brake([constraint.max_deceleration_on_cancel for constraint in self.params.constraints])

    def _end(self, state: GoalState, code: ResultCode, text: str) -> None:
        """End the active goal, if any, with a result, and report a failure."""
        goal, self.goal = self.goal, None
        if goal is None:
            if code in (ResultCode.PATH_TOLERANCE_VIOLATED, ResultCode.GOAL_TOLERANCE_VIOLATED):
                self.report("trajectory_ended", f"{text}; the joints are held")
            return
        goal.end(state, code, text)
        self.command_timeout.end()
        if state is not GoalState.SUCCEEDED:
            self.report(f"goal_{state.value}", text)
