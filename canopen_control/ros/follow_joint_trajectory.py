"""`~/follow_joint_trajectory`: the action by which MoveIt and others have a joint trajectory controller follow a path.

The law of the file (joint_trajectory_controller, Jazzy): a goal is accepted or refused by what the robot says of it, a
newer one takes the place of the one that runs, cancelling is always accepted, feedback is sent at the controller's
`action_monitor_rate`. The trajectory and its time are the robot's; here is only who is to be told. Ours, and safer: a
goal ends when this bridge does, and when the action client that sent it leaves the graph, unless the controller's
`continue_without_client` is true. Who asks for the result of a refused goal is told which rule it breaks.
"""

from __future__ import annotations

import math
from functools import partial
from typing import TYPE_CHECKING, Any, Final

from canopen_control.ros.action_server import JudgedActionServer
from canopen_control.ros.endpoint import COMMANDER, Endpoint, NewSamples
from canopen_control.ros.interfaces import interface
from canopen_control.ros.joint_states import time_message
from canopen_control.ros.participants import ActionClients
from canopen_control.ros.throttle import without_numbers
from canopen_control.ros.trajectory_messages import (
    fill_point,
    goal_refusal,
    pieces_of,
    seconds,
    stamp_of,
    tolerances_of,
)
from canopen_control.ros.trajectory_sender import HEARTBEAT_S, TrajectorySender
from canopen_control.rpc.messages.samples import TrajectorySample
from canopen_control.rpc.messages.trajectory import (
    CancelTrajectory,
    SendTrajectory,
    TrajectoryEnd,
    TrajectoryResult,
)
from canopen_control.rpc.reactor_client import ENDLESS

if TYPE_CHECKING:
    from canopen_control.ros.action_server import GoalRequest
    from canopen_control.ros.endpoint import Ros, RosMessage
    from canopen_control.rpc.messages.samples import TrajectoryPoint
    from canopen_control.rpc.messages.state import ControllerReading, StateSample
    from canopen_control.rpc.messages.trajectory import TrajectoryVerdict

__all__ = ["FollowJointTrajectory"]

_INVALID_GOAL: Final = -1
_WATCH_S: Final = 0.25
"""How often it is looked whether the clients are still there."""
_CLIENT_GONE: Final = "the action client that sent it is gone"


class _Followed:
    """A goal that came from ROS: who sent it, the connection it lives by, and what the robot said when it took it."""

    def __init__(self, request: GoalRequest, sender: TrajectorySender, clients: ActionClients) -> None:
        self.uuid, self.client, self.sender = request.uuid, request.client, sender
        self.verdict: TrajectoryVerdict | None = None
        self.is_to_end = False
        self.cancelled = False
        self.told = -math.inf
        self._clients = clients
        self._was_present = False
        self._ran_here = self.client is not None and clients.runs_here(self.client)

    def is_alone(self, present: set[bytes]) -> bool:
        """Whether its client has been there and is no more; where it cannot be told from others, all of them."""
        if self._ran_here and self.client is not None and not self._clients.runs_here(self.client):
            return True
        here = bool(present) if self.client is None else self.client in present
        self._was_present |= here
        return self._was_present and not here


class FollowJointTrajectory(Endpoint):
    """The action server of one controller."""

    def __init__(self, ros: Ros, controller: ControllerReading) -> None:
        self._ros, self._controller = ros, controller.name
        self._topic = f"{controller.name}/follow_joint_trajectory"
        action: Any = interface("control_msgs/action/FollowJointTrajectory")
        self._feedback, self._result = action.Feedback, action.Result
        self._goals: dict[bytes, _Followed] = {}
        self._samples = NewSamples(TrajectorySample)
        self._watched = -math.inf
        self._server = JudgedActionServer(
            ros.node,
            action,
            self._topic,
            lambda request: ros.hand_over(lambda: self._begin(request)),
            lambda uuid: ros.hand_over(lambda: self._cancel(uuid)),
            lambda uuid: ros.hand_over(lambda: self._give_up(uuid, _CLIENT_GONE)),
        )
        self._clients = ActionClients(ros.node, ros.node.resolve_service_name(self._topic))

    # ------------------------------------------------------------------------------------------------ goals that come

    def _begin(self, request: GoalRequest) -> None:
        """Have the robot judge a goal."""
        followed = _Followed(request, TrajectorySender(self._ros.connect), self._clients)
        self._goals[request.uuid] = followed
        try:
            refusal = goal_refusal(request.goal)
            if refusal is not None:
                self._refuse(followed, _INVALID_GOAL, f"{self._controller} refuses the trajectory: {refusal}")
                return
            pieces = pieces_of(request.goal.trajectory)
            wanted = partial(self._request, request.goal)
            followed.sender.send(pieces, wanted, partial(self._on_verdict, followed))
        except Exception as error:  # noqa: BLE001 - whatever is in it, it is answered
            self._refuse(followed, _INVALID_GOAL, f"{type(error).__name__}: {error}")

    def _request(self, goal: RosMessage, points: list[TrajectoryPoint]) -> SendTrajectory:
        return SendTrajectory(
            controller=self._controller,
            joints=list(goal.trajectory.joint_names),
            points=points,
            stamp=stamp_of(goal.trajectory),
            path_tolerance=tolerances_of(goal.path_tolerance),
            goal_tolerance=tolerances_of(goal.goal_tolerance),
            goal_time_tolerance=seconds(goal.goal_time_tolerance),
            source=COMMANDER,
            heartbeat=HEARTBEAT_S,
        )

    def _on_verdict(self, followed: _Followed, verdict: TrajectoryVerdict | None, error: str | None) -> None:
        if verdict is None:
            self._refuse(followed, _INVALID_GOAL, f"{self._controller} refuses the trajectory: {error}")
        elif not verdict.accepted:
            self._refuse(followed, verdict.error_code, verdict.text)
        else:
            followed.verdict = verdict
            self._ros.call(partial(self._server.answer, followed.uuid, None))
            followed.sender.client.ask(TrajectoryEnd(), partial(self._on_end, followed), ENDLESS)

    def _refuse(self, followed: _Followed, code: int, text: str) -> None:
        self._goals.pop(followed.uuid, None)
        followed.sender.close()
        self._ros.warn(f"{self._topic}: {without_numbers(text)}", f"{self._topic}: {text}")
        self._ros.call(partial(self._server.answer, followed.uuid, self._result(error_code=code, error_string=text)))

    # --------------------------------------------------------------------------------------------- goals that end

    def _on_end(self, followed: _Followed, result: TrajectoryResult | None, error: str | None) -> None:
        self._end(followed, result or TrajectoryResult(state="aborted", error_code=_INVALID_GOAL, text=str(error)))

    def _end(self, followed: _Followed, result: TrajectoryResult) -> None:
        """Tell the client; only once."""
        if self._goals.pop(followed.uuid, None) is None:
            return
        followed.sender.close()
        by_others = result.state == "canceled" and not followed.cancelled
        code = _INVALID_GOAL if by_others else result.error_code
        told = self._result(error_code=code, error_string=result.text)
        self._ros.call(partial(self._server.finish, followed.uuid, result.state, told))

    def _cancel(self, uuid: bytes) -> None:
        """Have a goal cancelled, as its client wishes."""
        if uuid in self._goals:
            self._goals[uuid].cancelled = True
            self._give_up(uuid, None)

    def _give_up(self, uuid: bytes, why: str | None) -> None:
        followed = self._goals.get(uuid)
        if followed is None or followed.verdict is None or followed.is_to_end:
            return
        followed.is_to_end = True
        request = CancelTrajectory(controller=self._controller, own=True, why=why)
        followed.sender.client.ask(request, lambda _done, error: self._tell(error))

    def _tell(self, error: str | None) -> None:
        if error is not None:
            self._ros.warn(self._topic, f"{self._topic}: {error}")

    def close(self) -> None:
        """Leave the graph; goals end, and their clients are told."""
        for followed in list(self._goals.values()):
            text = "the ROS bridge leaves, and the goal ends with it"
            self._end(followed, TrajectoryResult(state="aborted", error_code=_INVALID_GOAL, text=text))
        self._ros.call(self._server.destroy)

    # ------------------------------------------------------------------------------------------ goals that are followed

    def on_state(self, state: StateSample) -> None:
        """Send feedback, and look whether the clients are still there."""
        followed = [each for each in self._goals.values() if each.verdict is not None]
        sample = self._samples.of(state).get(self._controller)
        if not followed:
            return
        if sample is not None and sample.executing:
            self._send_feedback(followed[-1], sample)
        if not self._watched <= state.time < self._watched + _WATCH_S:  # a clock that was set back does not silence it
            self._watched = state.time
            self._watch(followed)

    def _send_feedback(self, followed: _Followed, sample: TrajectorySample) -> None:
        handle = self._server.known(followed.uuid)
        rate = followed.verdict.feedback_rate if followed.verdict is not None else math.inf
        if handle is None or followed.told <= sample.time < followed.told + 1.0 / rate:
            return
        followed.told = sample.time
        feedback = self._feedback(joint_names=list(sample.joints))
        feedback.header.stamp = time_message(sample.time)
        fill_point(feedback.desired, sample.reference)
        fill_point(feedback.actual, sample.feedback)
        fill_point(feedback.error, sample.error)
        handle.publish_feedback(feedback)

    def _watch(self, followed: list[_Followed]) -> None:
        """End the goals whose client is gone."""
        watched = [each for each in followed if each.verdict is not None and not each.verdict.outlives_client]
        present = self._clients.present() if watched else set()
        for each in watched:
            if each.is_alone(present):
                self._give_up(each.uuid, _CLIENT_GONE)
