"""Gripper action controllers: move a gripper with limited effort, and detect success or a stall.

Rules (gripper_controllers and parallel_gripper_controller, Jazzy): a goal is reached within `goal_tolerance`, and ends
as stalled if the joint has not moved for `stall_timeout`, which is a success with `allow_stalling`. After a success the
position is held, or the object gripped, with the effort of the goal. Safer than upstream: any other end holds the joint
at its position without further effort against the object; a goal ends with its client; a joint that is not enabled
keeps no goal for later.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, TypeVar, cast

from canopen_control.controllers.base import Controller, ControllerState, finite
from canopen_control.controllers.command_timeout import GoalState
from canopen_control.controllers.limiters import IMMOBILE, immobile_text
from canopen_control.controllers.params import CommonParams, LoopGains, refuse
from canopen_control.controllers.pid import Pid
from canopen_control.controllers.request_protocols import GripperGoal, GripStatus, StallDetector
from canopen_control.hardware.interfaces import OK, ReturnType
from canopen_control.rpc.messages.samples import GripperSample
from canopen_control.rpc.messages.state import GRIPPER_GOALS, PARALLEL_GRIPPER_GOALS
from canopen_control.urdf.joint_element import EFFORT, POSITION, VELOCITY
from canopen_control.yamlfile.convert import derived, section, setting

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from canopen_control.controllers.params import Params
    from canopen_control.hardware.interfaces import CommandInterface, StateInterface
    from canopen_control.rpc.messages.samples import Sample


# The parameters of the gripper action controllers of jazzy.
#
# Keys, defaults and meaning are those of gripper_controllers and parallel_gripper_controller.


P = TypeVar("P", bound="GripperParams")


@dataclass(frozen=True)
class GripperParams(CommonParams):
    """Parameters of position_controllers/GripperActionController, in units of rad or m, Nm or N, and s."""

    joint: str = setting("", help="joint of the gripper")
    action_monitor_rate: float = setting(20.0, low=0.1, help="rate in Hz of the feedback to the action client")
    goal_tolerance: float = setting(
        0.01, low=0.0, help="distance to the goal in rad or m within which the goal is reached"
    )
    max_effort: float = setting(0.0, low=0.0, help="effort limit in Nm or N for goals without a limit or with 0")
    allow_stalling: bool = setting(
        False, help="true: a goal succeeds when the gripper stalls, and the gripper keeps its grip"
    )
    stall_velocity_threshold: float = setting(
        0.001, low=0.0, help="speed in rad/s or m/s up to which the gripper counts as stationary"
    )
    stall_timeout: float = setting(
        1.0, low=0.0, high=1e6, help="time in s without motion after which the gripper counts as stalled"
    )
    state_interfaces: tuple[str, ...] = setting(
        (POSITION, VELOCITY), help="state interfaces of the joint; `effort` adds the effort to the result of a goal"
    )
    max_effort_interface: str = setting(
        "", help="full name of the command interface that limits the effort; empty: none"
    )
    max_velocity_interface: str = setting(
        "", help="full name of the command interface that limits the velocity; empty: none"
    )
    max_velocity: float = setting(
        0.1,
        low=0.0,
        help="velocity limit in rad/s or m/s for goals without a limit or with 0; used by `max_velocity_interface`",
    )

    @property
    def limits(self) -> list[str]:
        """Configured command interfaces that limit effort and velocity."""
        return [name for name in (self.max_effort_interface, self.max_velocity_interface) if name]

    def mistakes(self) -> Iterator[str]:
        if not self.joint:
            yield "no 'joint'; give it under ros__parameters: joint: finger_joint"
        if missing := [kind for kind in (POSITION, VELOCITY) if kind not in self.state_interfaces]:
            yield f"state_interfaces lacks {missing[0]}; goals need position and velocity"
        if len(set(self.state_interfaces)) != len(self.state_interfaces) or len(set(self.limits)) != len(self.limits):
            yield "state_interfaces or the limits contain an interface twice; list each once"


@dataclass(frozen=True)
class ParallelGripperParams(GripperParams):
    """Parameters of parallel_gripper_action_controller/GripperActionController, with a different default effort."""

    max_effort: float = setting(10.0, low=0.0)


@dataclass(frozen=True)
class EffortGripperParams(GripperParams):
    """Parameters of effort_controllers/GripperActionController, with the `gains` of the position loop."""

    gains: LoopGains = derived(LoopGains())  # noqa: RUF009 - it is frozen


def read_params(params: Params, name: str, cls: type[P]) -> P:
    """Return the parameters of gripper controller `name`; raise RobotConfigError if they are invalid."""
    node = params.flat.get("joint")
    joint = "" if node is None else node.text
    settings = params.read(_with_gains(cls, joint))
    if isinstance(settings, EffortGripperParams):
        settings = dataclasses.replace(settings, gains=getattr(settings, "loop"))  # noqa: B009 - of the class that is made
    refuse(params, settings.mistakes(), name)
    return settings


def _with_gains(cls: type[P], joint: str) -> type[P]:
    """Return the class, with a section `gains.<joint>` added if it has gains."""
    if not issubclass(cls, EffortGripperParams):
        return cls
    loop = ("loop", LoopGains, section(f"gains.{joint}", LoopGains()))
    return cast("type[P]", dataclasses.make_dataclass(cls.__name__, [loop], bases=(cls,), frozen=True))


class PositionGripperActionController(Controller):
    """Controller that moves a gripper by position commands; `goal` is the active goal, or None."""

    title: ClassVar[str] = "Gripper, commanded by position"
    sample_type: ClassVar[type[Sample] | None] = GripperSample
    offers: ClassVar[tuple[str, ...]] = (GRIPPER_GOALS,)
    reads: ClassVar[type[GripperParams]] = GripperParams
    commanded: ClassVar[str] = POSITION

    def __init__(self, name: str, type_name: str = "") -> None:
        super().__init__(name, type_name)
        self.params = self.reads()
        self.goal: GripperGoal | None = None
        self._target = self._at = self._velocity = self._effort = math.nan
        self._limits = (0.0, 0.0)
        self._status = GripStatus.MOVING
        self._progress = StallDetector(0.0, 0.0, 0.0)
        self._is_limited = False

    def on_configure(self, params: Params) -> None:
        self.params = settings = read_params(params, self.name, self.reads)
        self.update_rate, self.joints, self.interface = settings.update_rate, (settings.joint,), self.commanded
        self._is_limited = self.commanded == EFFORT or bool(settings.max_effort_interface)
        given = params.flat.keys()
        if self._is_limited and settings.max_effort == 0.0 and "max_effort" in given:
            self.report(IMMOBILE, immobile_text("max_effort", "goals without an effort do not move the gripper"))
        if settings.max_velocity_interface and settings.max_velocity == 0.0:
            self.report(IMMOBILE, immobile_text("max_velocity", "goals without a velocity do not move the gripper"))
        self._progress = StallDetector(
            settings.goal_tolerance, settings.stall_velocity_threshold, settings.stall_timeout
        )

    def command_interface_names(self) -> list[str]:
        return [f"{self.params.joint}/{self.commanded}", *self.params.limits]

    def state_interface_names(self) -> list[str]:
        return [f"{self.params.joint}/{interface}" for interface in self.params.state_interfaces]

    def on_activate(self, commands: list[CommandInterface], states: list[StateInterface], now: int) -> None:
        super().on_activate(commands, states, now)
        self._target, self._status = math.nan, GripStatus.MOVING
        self.command_timeout.end()
        self._read()
        self.stamp = now

    def on_deactivate(self, now: int) -> None:
        self._end(GoalState.ABORTED, f"{self.name} was deactivated; activate it and send the goal again")
        super().on_deactivate(now)
        self._target = math.nan

    def forget(self, now: int) -> None:
        del now
        why, client = (
            self.command_timeout.ended_by or "a stop was requested",
            self.command_timeout.source or "an unnamed client",
        )
        self._end(GoalState.ABORTED, f"{why}, so the goal of {client} was aborted; send it again afterwards")
        self.command_timeout.end()
        self._hold()

    # -------------------------------------------------------------------------------------------------- goals

    def grip(self, goal: GripperGoal, now: int) -> None:
        params = self.params
        effort = params.max_effort if not goal.max_effort else goal.max_effort
        velocity = params.max_velocity if not goal.max_velocity else goal.max_velocity
        self._check(goal.position, effort, velocity)
        self._report_unlimited(goal)
        self._end(GoalState.ABORTED, "another goal has replaced it")
        goal.feedback_rate = params.action_monitor_rate
        self.goal, self._target, self._limits, self._status = goal, goal.position, (effort, velocity), GripStatus.MOVING
        self._progress.begin(now)
        self.command_timeout.start(now)

    def set_command(self, values: Sequence[float], now: int, stamp: int | None = None) -> None:
        del values, now, stamp
        raise self.refusal("accepts only goals; send one to ~/gripper_cmd or with canopen-control gripper POSITION")

    def cancel_grip(self, why: str | None = None, only: GripperGoal | None = None) -> None:
        if self.goal is not None and only in (None, self.goal):
            self._end(GoalState.CANCELED, "the goal was cancelled" if why is None else f"the goal was cancelled: {why}")
            self._hold()

    def _check(self, position: float, effort: float, velocity: float) -> None:
        if self.state is not ControllerState.ACTIVE:
            raise self.refusal(f"is {self.state.value}; activate it before sending it goals")
        joint = self.params.joint
        if not math.isfinite(position):
            raise self.refusal(f"cannot move {joint} to {position:g}; give a finite number")
        for key, value in (("max_effort", effort), ("max_velocity", velocity)):
            if not 0.0 <= value < math.inf:
                raise self.refusal(f"cannot move {joint} with a {key} of {value:g}; give a finite number of 0 or more")
        low, high = self.description[joint].range_of(POSITION) if joint in self.description else (-math.inf, math.inf)
        if not low <= position <= high:
            raise self.refusal(
                f"expects {low:g} to {high:g}, the limits of {joint}, got {position:g}; nothing was applied"
            )
        if self.commanded == POSITION and (problem := self.commands[0].range_error(position)) is not None:
            raise self.refusal(f"cannot send {position:g}: {problem}; nothing was applied")

    def _report_unlimited(self, goal: GripperGoal) -> None:
        """Report once that the effort of a goal has no effect because no interface limits the effort."""
        if goal.max_effort and not self._is_limited:
            self._is_limited = True
            text = "the max_effort of goals has no effect: set max_effort_interface, or limit the drive (0x6072)"
            self.report("max_effort", text)

    def _end(self, state: GoalState, text: str, status: GripStatus = GripStatus.MOVING) -> None:
        """End the active goal, if any, with a result, and report a failure."""
        goal, self.goal = self.goal, None
        if goal is not None:
            goal.end(state, text, self._at, self._effort, status)
            self.command_timeout.end()
            if state is not GoalState.SUCCEEDED:
                self.report(f"goal_{state.value}", text)

    # -------------------------------------------------------------------------------------------------- cycle

    def update(self, now: int, period: float) -> ReturnType:
        self._read()
        if self.goal is not None:
            self._update_status(now)
        if not self.commands[0].enabled:
            self._target = math.nan
        self._write(period)
        self.stamp = now
        return OK

    def sample(self, wall_offset_ns: int) -> GripperSample:
        return GripperSample(
            time=self.published(wall_offset_ns),
            joint=self.params.joint,
            position=finite(self._at),
            velocity=finite(self._velocity),
            effort=finite(self._effort),
            target=finite(self._target),
            executing=self.goal is not None,
            stalled=self._status is GripStatus.STALLED,
            reached_goal=self._status is GripStatus.REACHED,
        )

    def _read(self) -> None:
        index = 0
        for kind in self.params.state_interfaces:
            value = self.states[index].value
            if kind == POSITION:
                self._at = value
            elif kind == VELOCITY:
                self._velocity = value
            elif kind == EFFORT:
                self._effort = value
            index += 1  # noqa: SIM113 - enumerate makes a tuple per interface in the cycle

    def _update_status(self, now: int) -> None:
        self._status = status = self._progress.update(now, self._target - self._at, self._velocity)
        if status is GripStatus.REACHED:
            self._end(GoalState.SUCCEEDED, "the goal was reached", status)
        elif status is GripStatus.STALLED:
            text = f"{self.params.joint} has stalled at {self._at:g}, {self._target - self._at:g} before the goal"
            if self.params.allow_stalling:
                self._end(GoalState.SUCCEEDED, text, status)
            else:
                self._end(GoalState.ABORTED, f"{text}; it is held there", status)
                self._hold()

    def _write(self, period: float) -> None:
        del period
        if not math.isnan(self._target):
            self.commands[0].value = self._target
            self._write_limits()

    def _write_limits(self) -> None:
        place = 1
        if self.params.max_effort_interface:
            self.commands[place].value = self._limits[0]
            place += 1
        if self.params.max_velocity_interface:
            self.commands[place].value = self._limits[1]

    def _hold(self) -> None:
        """Release the position command, so that the hardware holds the actual position."""
        self._target = self.commands[0].value = math.nan


class ParallelGripperActionController(PositionGripperActionController):
    """Controller of a gripper that is commanded by a JointState.

    The type is parallel_gripper_action_controller/GripperActionController.
    """

    title: ClassVar[str] = "Parallel gripper"
    reads: ClassVar[type[GripperParams]] = ParallelGripperParams
    offers: ClassVar[tuple[str, ...]] = (PARALLEL_GRIPPER_GOALS,)


class EffortGripperActionController(PositionGripperActionController):
    """Controller that moves a gripper by the effort commands of a position loop."""

    title: ClassVar[str] = "Gripper, commanded by effort"
    reads: ClassVar[type[GripperParams]] = EffortGripperParams
    commanded: ClassVar[str] = EFFORT

    def __init__(self, name: str, type_name: str = "") -> None:
        super().__init__(name, type_name)
        self._loop = Pid(EffortGripperParams().gains.pid())

    def on_configure(self, params: Params) -> None:
        super().on_configure(params)
        if isinstance(self.params, EffortGripperParams):
            self._loop = Pid(self.params.gains.pid())

    def on_activate(self, commands: list[CommandInterface], states: list[StateInterface], now: int) -> None:
        super().on_activate(commands, states, now)
        self._loop.reset()

    def _check(self, position: float, effort: float, velocity: float) -> None:
        super()._check(position, effort, velocity)
        if effort == 0.0:
            raise self.refusal("cannot move: max_effort is 0; set it in the goal or in the parameters")

    def _write(self, period: float) -> None:
        if math.isnan(self._target):
            self.commands[0].value = 0.0
            self._loop.reset()
            return
        demand = self._loop.compute_with_rate(self._target - self._at, -self._velocity, period)
        most = self._limits[0]
        effort = 0.0 if math.isnan(demand) else min(max(demand, -most), most)
        self.commands[0].value = effort
        if EFFORT not in self.params.state_interfaces:
            self._effort = effort
        self._write_limits()

    def _hold(self) -> None:
        """Hold the joint at its actual position, with at most the effort of the last goal."""
        self._target = self._at if self.commands[0].enabled else math.nan
