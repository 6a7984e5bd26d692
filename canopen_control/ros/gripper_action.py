"""`~/gripper_cmd` of the gripper action controllers: a position with the most effort, and whether it was reached.

The law of the file (gripper_controllers and parallel_gripper_controller, Jazzy): the action is a GripperCommand, or a
ParallelGripperCommand whose `command` is a JointState with one position and, where they are given, one velocity and one
effort. What a goal lives by, and how it ends, is in `action_goals`. Ours: feedback is sent at `action_monitor_rate`
(upstream sends none), and an effort of 0 is that of the parameters.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

from canopen_control.ros.action_goals import ActionGoals
from canopen_control.ros.conversions import unknown_as_nan
from canopen_control.ros.endpoint import COMMANDER
from canopen_control.ros.interfaces import interface
from canopen_control.ros.joint_states import time_message
from canopen_control.ros.trajectory_sender import HEARTBEAT_S
from canopen_control.rpc.messages.gripper import (
    CancelGripper,
    GripperEnd,
    GripperResult,
    GripperVerdict,
    SendGripper,
)
from canopen_control.rpc.messages.samples import GripperSample

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.ros.endpoint import Ros, RosMessage
    from canopen_control.ros.trajectory_sender import TrajectorySender
    from canopen_control.rpc.messages.declare import Done, Request
    from canopen_control.rpc.messages.state import ControllerReading

__all__ = ["GripperAction", "ParallelGripperAction"]


class GripperAction(ActionGoals[GripperVerdict, GripperResult, GripperSample]):
    """The action server of one controller, with GripperCommand."""

    name: ClassVar[str] = "control_msgs/action/GripperCommand"

    def __init__(self, ros: Ros, controller: ControllerReading) -> None:
        self._action: Any = interface(self.name)
        self._joint = next(iter(controller.joints), "")
        super().__init__(ros, controller, self._action, "gripper_cmd", GripperSample)

    def on_controller(self, controller: ControllerReading) -> None:
        """Know its joint."""
        self._joint = next(iter(controller.joints), "")

    def request(self, goal: RosMessage) -> SendGripper:
        """Return what a goal is to the robot; ValueError with why it is none."""
        command = goal.command
        return self._wanted(command.position, command.max_effort)

    def result(self, told: GripperResult | GripperSample, into: RosMessage) -> RosMessage:
        """Fill a result or a feedback with where the gripper is."""
        into.position, into.effort = unknown_as_nan(told.position), unknown_as_nan(told.effort)
        into.stalled, into.reached_goal = told.stalled, told.reached_goal
        return into

    def feedback(self, sample: GripperSample) -> RosMessage:
        """Return the feedback of a sample."""
        return self.result(sample, self._action.Feedback())

    def send(
        self,
        sender: TrajectorySender,
        goal: RosMessage,
        answer: Callable[[GripperVerdict | None, str | None], object],
    ) -> None:
        """Send a goal on its own connection."""
        sender.client.ask(self.request(goal), answer)

    def refused(self, verdict: GripperVerdict | None, text: str) -> RosMessage:
        """Return an empty result: there is no room for the reason, which is logged."""
        del verdict, text
        return self.result(self.failed(""), self._action.Result())

    def asks_for_end(self) -> Request[GripperResult]:
        """Return `gripper_end`."""
        return GripperEnd()

    def cancels(self, why: str | None) -> Request[Done]:
        """Return `cancel_gripper`."""
        return CancelGripper(controller=self._controller, own=True, why=why)

    def failed(self, text: str) -> GripperResult:
        """Return an end without the robot's word."""
        return GripperResult(state="aborted", text=text)

    def told(self, result: GripperResult, *, by_others: bool) -> RosMessage:
        """Return the result for the client, and log why, where it did not succeed: it has no room for words."""
        del by_others
        if result.state != "succeeded":
            self._ros.warn(self._topic, f"{self._topic}: {result.text}")
        return self.result(result, self._action.Result())

    def _wanted(self, position: float, effort: float, velocity: float = 0.0) -> SendGripper:
        for what, value in (("position", position), ("max_effort", effort), ("max_velocity", velocity)):
            if value - value != 0.0:  # nan, infinite
                raise ValueError(f"its {what} is {value}; give finite numbers")
        return SendGripper(
            controller=self._controller,
            position=position,
            max_effort=effort or None,
            max_velocity=velocity or None,
            source=COMMANDER,
            heartbeat=HEARTBEAT_S,
        )


class ParallelGripperAction(GripperAction):
    """The action server of one controller, with ParallelGripperCommand."""

    name: ClassVar[str] = "control_msgs/action/ParallelGripperCommand"

    def request(self, goal: RosMessage) -> SendGripper:
        """Return what a goal is to the robot; ValueError with why it is none."""
        command = goal.command
        if len(command.position) != 1:
            raise ValueError(f"it has {len(command.position)} positions; give one")
        effort, velocity = (next(iter(each), 0.0) for each in (command.effort, command.velocity))
        return self._wanted(float(command.position[0]), float(effort), float(velocity))

    def result(self, told: GripperResult | GripperSample, into: RosMessage) -> RosMessage:
        """Fill a result with where the gripper is."""
        self._put(told, into.state)
        into.stalled, into.reached_goal = told.stalled, told.reached_goal
        return into

    def feedback(self, sample: GripperSample) -> RosMessage:
        """Return the feedback of a sample: its state alone."""
        into = self._action.Feedback()
        self._put(sample, into.state)
        into.state.header.stamp = time_message(sample.time)
        into.state.velocity = [unknown_as_nan(sample.velocity)]
        return into

    def _put(self, told: GripperResult | GripperSample, state: RosMessage) -> None:
        state.name = [self._joint]
        state.position, state.effort = [unknown_as_nan(told.position)], [unknown_as_nan(told.effort)]
