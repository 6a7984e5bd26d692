"""Action servers for goals that the robot accepts, executes and times.

The robot accepts or refuses a goal; a cancellation is always accepted. The robot executes and times the goal; this
module only reports to the client. Every goal has its own connection to the robot, so that the goal ends with this
bridge. It also ends when the action client that sent it leaves the graph, unless the controller lets the goal continue.
A request for the result of a refused goal is answered with the reason.
"""

from __future__ import annotations

import contextlib
import importlib
import math
import time
from abc import ABC, abstractmethod
from collections import OrderedDict
from functools import partial
from typing import TYPE_CHECKING, Any, Final, Generic, NamedTuple, TypeVar

from canopen_control.errors import CanopenError
from canopen_control.ros.endpoint import ActionClients, Endpoint, NewSamples, client_of, without_numbers
from canopen_control.rpc.client import ENDLESS
from canopen_control.rpc.messages.samples import GripperSample, TrajectorySample
from canopen_control.rpc.messages.trajectory import TrajectoryData, TrajectoryHeartbeat

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from canopen_control.ros.endpoint import NodeContext, RosMessage
    from canopen_control.ros.rcl import Node
    from canopen_control.rpc.client import ReactorClient
    from canopen_control.rpc.messages.declare import Done, Request
    from canopen_control.rpc.messages.gripper import GripperResult, GripperVerdict
    from canopen_control.rpc.messages.samples import TrajectoryPoint
    from canopen_control.rpc.messages.state import ControllerReading, StateSample
    from canopen_control.rpc.messages.trajectory import TrajectoryResult, TrajectoryVerdict

    Points = list[TrajectoryPoint]


# Action server that accepts or refuses goals asynchronously, and reports which client sent a goal.
#
# rclpy's own server answers a goal when its callback returns, and waits for the end of a goal in a coroutine, in which
# its EventsExecutor spins without a pause. Here goals are passed on, and `answer` and `finish` are called in the
# executor's thread. In addition a request for the result of a refused goal gets the reason, where rclpy's server
# reports an unknown goal.


_rclpy = importlib.import_module("rclpy.action.server")
_ActionServer: Any = _rclpy.ActionServer
_ACCEPTED: Final = 1  # action_msgs/msg/GoalStatus
_ABORTED: Final = 6
_MAX_RESULTS: Final = 64
"""Number of refusals kept for clients that request the result."""


class GoalRequest(NamedTuple):
    """Goal that has not been answered yet; `client` is the DDS participant that sent it, or None if unknown."""

    uuid: bytes
    goal: RosMessage
    client: bytes | None


class AsyncActionServer(_ActionServer):  # type: ignore[misc] # rclpy's, without types
    """Action server that answers goals asynchronously; callbacks run in the executor's thread.

    After `on_goal(request)`, call `answer`; after `on_cancel(uuid)`, call `finish` when the goal has ended.
    `on_lost(uuid)` reports an accepted goal whose client disconnected before the answer.
    """

    def __init__(
        self,
        node: Node,
        action: type,
        name: str,
        on_goal: Callable[[GoalRequest], object],
        on_cancel: Callable[[bytes], object],
        on_lost: Callable[[bytes], object],
    ) -> None:
        self._on_goal, self._on_lost = on_goal, on_lost
        self._accepted: dict[bytes, Any] = {}
        self._accepts = False
        self._requested: set[bytes] = set()  # goals whose result a client has requested
        self._refused: OrderedDict[bytes, RosMessage] = OrderedDict()

        def cancel(handle: RosMessage) -> RosMessage:
            on_cancel(bytes(handle.goal_id.uuid))
            return _rclpy.CancelResponse.ACCEPT

        super().__init__(
            node,
            action,
            name,
            lambda _handle: None,
            goal_callback=lambda _goal: _rclpy.GoalResponse.ACCEPT if self._accepts else _rclpy.GoalResponse.REJECT,
            handle_accepted_callback=_set_executing,
            cancel_callback=cancel,
        )

    def handle_of(self, uuid: bytes) -> RosMessage | None:
        """Return rclpy's handle of an accepted goal, or None if rclpy has discarded the goal."""
        return self._goal_handles.get(uuid)

    def answer(self, uuid: bytes, refusal: RosMessage | None) -> None:
        """Accept a goal if `refusal` is None; otherwise refuse the goal and keep `refusal` as its result."""
        waiting = self._accepted.pop(uuid, None)
        if waiting is None:
            return
        self._accepts = refusal is None
        if refusal is not None:
            self._refused[uuid] = refusal
            while len(self._refused) > _MAX_RESULTS:
                self._refused.popitem(last=False)
        with contextlib.suppress(StopIteration):
            super()._execute_goal_request(waiting).send(None)  # completes at once: no callback is a coroutine
        handle = self.handle_of(uuid)
        if handle is not None and handle.status == _ACCEPTED:  # no client could be informed
            _set_executing(handle)
            self._on_lost(uuid)

    def is_result_requested(self, uuid: bytes) -> bool:
        """Whether a client has requested the result of an accepted goal."""
        return uuid in self._requested

    def finish(self, uuid: bytes, state: str, result: RosMessage) -> None:
        """End a goal as "succeeded", "aborted" or "canceled", and send the result to waiting clients.

        A client that did not request the cancellation receives "aborted".
        """
        handle = self.handle_of(uuid)
        if handle is None or not handle.is_active:
            return
        if state == "succeeded":
            handle.succeed()
        elif state == "canceled" and handle.is_cancel_requested:
            handle.canceled()
        else:
            handle.abort()
        future = self._result_futures[uuid]
        future._set_executor(None)  # noqa: SLF001 - else the executor sends the result, which may have ended
        future.set_result(self._response(handle.status, result))

    def _response(self, status: int, result: RosMessage) -> RosMessage:
        response = self._action_type.Impl.GetResultService.Response()
        response.status, response.result = status, result
        return response

    async def _execute_goal_request(self, received: Any) -> None:  # noqa: ANN401 - rclpy's
        header, request = received
        uuid = bytes(request.goal_id.uuid)
        if uuid in self._accepted:
            return  # a repeated request; the first one has not been answered yet
        if uuid in self._goal_handles:
            await super()._execute_goal_request(received)  # refused without its callback
            return
        self._accepted[uuid] = received
        self._requested.intersection_update(self._goal_handles)
        self._on_goal(GoalRequest(uuid, request.goal, client_of(header)))

    async def _execute_get_result_request(self, received: Any) -> None:  # noqa: ANN401 - rclpy's
        header, request = received
        uuid = bytes(request.goal_id.uuid)
        refused = self._refused.get(uuid)
        if refused is None:
            await super()._execute_get_result_request(received)
            self._requested.add(uuid)
        else:
            self._handle.send_result_response(header, self._response(_ABORTED, refused))


def _set_executing(handle: RosMessage) -> None:
    """Set the state of a goal handle to executing, without an execute callback."""
    handle._update_state(_rclpy.GoalEvent.EXECUTE)  # noqa: SLF001 - else rclpy would wait for the end in a coroutine


# Transfer of one trajectory from ROS to the robot, on a separate connection and in as many requests as needed.
#
# The robot brakes when this connection is lost, so closing the connection ends the trajectory; the connection is also
# closed if the bridge crashes, and a bridge that hangs sends no more heartbeats. A request is sent only after the
# previous request has been answered, so that a large trajectory blocks neither side. All code runs on the reactor's
# thread.


HEARTBEAT_S: Final = 3.0
"""Value of `heartbeat` in goals from ROS, in s."""
_BEAT_NS: Final = 500_000_000

A = TypeVar("A")


class TrajectorySender:
    """Sender of trajectories on a separate connection to the robot, opened by `connect` on first use."""

    def __init__(self, connect: Callable[[], ReactorClient]) -> None:
        self._connect = connect
        self._client: ReactorClient | None = None

    @property
    def client(self) -> ReactorClient:
        """Connection to the robot, opened on first use; raise RemoteError if the robot has ended."""
        if self._client is None:
            self._client = self._connect()
            self._client.send_periodically(TrajectoryHeartbeat(), _BEAT_NS)
        return self._client

    def send(
        self,
        pieces: Iterator[Points],
        request: Callable[[Points], Request[A]],
        answer: Callable[[A | None, str | None], object],
    ) -> None:
        """Send a trajectory in pieces, the last one as `request(piece)`; `answer(result, reason)` is called once."""
        try:
            self._send(next(pieces), pieces, request, answer)
        except (CanopenError, ValueError) as error:  # nothing has been sent yet
            answer(None, str(error))

    def close(self) -> None:
        """Close the connection, which makes the robot brake; a second call does nothing."""
        client, self._client = self._client, None
        if client is not None:
            client.close()

    def _send(
        self,
        piece: Points,
        rest: Iterator[Points],
        request: Callable[[Points], Request[A]],
        answer: Callable[[A | None, str | None], object],
    ) -> None:
        following = next(rest, None)
        if following is None:
            self.client.ask(request(piece), answer)
            return

        def on_answer(_done: object, error: str | None) -> None:
            if error is not None:
                answer(None, error)
                return
            try:
                self._send(following, rest, request, answer)
            except (CanopenError, ValueError) as problem:
                self.close()  # the robot drops the pieces that it has received
                answer(None, str(problem))

        self.client.ask(TrajectoryData(points=piece), on_answer)


_WATCH_S: Final = 0.25
"""Interval in s between checks for clients that have left the graph."""
_REQUEST_S: Final = 3.5
"""Time in s within which a client requests the result of an accepted goal.

Clients do so at once; Fast DDS repeats a request that was lost after at most 3 s (WriterTimes.heartbeat_period).
"""
_CLIENT_GONE: Final = "the action client that sent the goal has left the ROS graph"


V = TypeVar("V", bound="GripperVerdict | TrajectoryVerdict")
E = TypeVar("E", bound="GripperResult | TrajectoryResult")
S = TypeVar("S", GripperSample, TrajectorySample)


class FollowedGoal(Generic[V]):
    """ROS goal with the connection on which the robot executes it, and the robot's reply."""

    def __init__(self, request: GoalRequest, sender: TrajectorySender, clients: ActionClients) -> None:
        self.uuid, self.client, self.sender = request.uuid, request.client, sender
        self.verdict: V | None = None
        self.accepted_at = -math.inf  # time.monotonic
        self.is_cancelling = False
        self.cancelled = False
        self.last_feedback = -math.inf
        self._clients = clients
        self._was_present = False
        self._ran_here = self.client is not None and clients.runs_here(self.client)

    def is_alone(self, present: set[bytes]) -> bool:
        """Whether the goal's client has left the graph; if the client is unknown, whether all clients have left."""
        if self._ran_here and self.client is not None and not self._clients.runs_here(self.client):
            return True
        is_present = bool(present) if self.client is None else self.client in present
        self._was_present |= is_present
        return self._was_present and not is_present

    def feedback_due(self, time: float) -> bool:
        """Whether feedback is due at `time` in s; if so, the next interval starts."""
        rate = self.verdict.feedback_rate if self.verdict is not None else math.inf
        if self.last_feedback <= time < self.last_feedback + 1.0 / rate:
            return False
        self.last_feedback = time
        return True


class ActionGoals(Endpoint, ABC, Generic[V, E, S]):
    """Action server of one controller; subclasses convert goals, feedback and results of one action type.

    `kind` is the class of the controller's samples that are converted to feedback.
    """

    def __init__(self, ros: NodeContext, controller: ControllerReading, action: type, name: str, kind: type[S]) -> None:
        super().__init__(ros)
        self._controller = controller.name
        self._samples: NewSamples[S] = NewSamples(kind)
        self._topic = f"{controller.name}/{name}"
        self._goals: dict[bytes, FollowedGoal[V]] = {}
        self._aborted: list[FollowedGoal[V]] = []  # at the end of the bridge
        self._watched = -math.inf
        self._server = AsyncActionServer(
            ros.node,
            action,
            self._topic,
            lambda request: ros.hand_over(lambda: self._begin(request)),
            lambda uuid: ros.hand_over(lambda: self._cancel(uuid)),
            lambda uuid: ros.hand_over(lambda: self._give_up(uuid, _CLIENT_GONE)),
        )
        self._clients = ActionClients(ros.node, ros.node.resolve_service_name(self._topic))

    # ------------------------------------------------------------------------------------------------------- hooks

    @abstractmethod
    def send(
        self, sender: TrajectorySender, goal: RosMessage, answer: Callable[[V | None, str | None], object]
    ) -> None:
        """Send a goal to the robot; `answer` is called with the verdict or an error.

        Raise ValueError for an invalid goal.
        """

    @abstractmethod
    def refused(self, verdict: V | None, text: str) -> RosMessage:
        """Return the result message of a refused goal; `verdict` is None if the robot has not replied."""

    @abstractmethod
    def asks_for_end(self) -> Request[E]:
        """Return the request whose reply arrives when the goal of this connection has ended."""

    @abstractmethod
    def cancels(self, why: str | None) -> Request[Done]:
        """Return the request that cancels the connection's goal; `why` is None if the client requested this."""

    @abstractmethod
    def failed(self, text: str) -> E:
        """Return the result of a goal that ended without a result from the robot; `text` is the reason."""

    @abstractmethod
    def client_result(self, result: E, *, by_others: bool) -> RosMessage:
        """Return the result message for the client; `by_others` is True if another client cancelled the goal."""

    @abstractmethod
    def feedback(self, sample: S) -> RosMessage: ...

    # ------------------------------------------------------------------------------------------------------ new goals

    def _begin(self, request: GoalRequest) -> None:
        """Send a new goal to the robot; refuse the goal if sending raises an exception."""
        followed = FollowedGoal[V](request, TrajectorySender(self._ros.connect), self._clients)
        self._goals[request.uuid] = followed
        try:
            self.send(followed.sender, request.goal, partial(self._on_verdict, followed))
        except ValueError as error:
            self._refuse(followed, None, f"{self._controller} refuses the goal: {error}")
        except Exception as error:  # noqa: BLE001 - every request gets an answer
            self._refuse(followed, None, f"{type(error).__name__}: {error}")

    def _on_verdict(self, followed: FollowedGoal[V], verdict: V | None, error: str | None) -> None:
        if verdict is None:
            self._refuse(followed, None, f"{self._controller} refuses the goal: {error}")
        elif not verdict.accepted:
            self._refuse(followed, verdict, verdict.text)
        else:
            followed.verdict, followed.accepted_at = verdict, time.monotonic()
            self._ros.call(partial(self._server.answer, followed.uuid, None))
            followed.sender.client.ask(self.asks_for_end(), partial(self._on_end, followed), ENDLESS)

    def _refuse(self, followed: FollowedGoal[V], verdict: V | None, text: str) -> None:
        self._goals.pop(followed.uuid, None)
        followed.sender.close()
        self._ros.warn(f"{self._topic}: {without_numbers(text)}", f"{self._topic}: {text}")
        self._ros.call(partial(self._server.answer, followed.uuid, self.refused(verdict, text)))

    # ----------------------------------------------------------------------------------------------- end of goals

    def _on_end(self, followed: FollowedGoal[V], result: E | None, error: str | None) -> None:
        self._end(followed, result or self.failed(str(error)))

    def _end(self, followed: FollowedGoal[V], result: E) -> None:
        """Send the result of a goal to its client, unless the goal has already ended."""
        if self._goals.pop(followed.uuid, None) is None:
            return
        followed.sender.close()
        response = self.client_result(result, by_others=result.state == "canceled" and not followed.cancelled)
        self._ros.call(partial(self._server.finish, followed.uuid, result.state, response))

    def _cancel(self, uuid: bytes) -> None:
        if uuid in self._goals:
            self._goals[uuid].cancelled = True
            self._give_up(uuid, None)

    def _give_up(self, uuid: bytes, why: str | None) -> None:
        followed = self._goals.get(uuid)
        if followed is None or followed.verdict is None or followed.is_cancelling:
            return
        followed.is_cancelling = True
        followed.sender.client.ask(self.cancels(why), lambda _done, error: self.report(self._topic, error))

    def abort_goals(self) -> bool:
        active = list(self._goals.values())
        for followed in active:
            self._aborted.append(followed)
            self._end(followed, self.failed("the ROS bridge has ended, which aborts the goal"))
        return bool(active)

    def awaits_result_requests(self) -> bool:
        earliest = time.monotonic() - _REQUEST_S
        return any(
            goal.accepted_at > earliest and not self._server.is_result_requested(goal.uuid) for goal in self._aborted
        )

    def close(self) -> None:
        """Abort the active goals, send their results to the clients, and destroy the action server."""
        self.abort_goals()
        self._ros.call(self._server.destroy)

    # ---------------------------------------------------------------------------------------------------- running goals

    def on_state(self, state: StateSample) -> None:
        """Send feedback for the latest goal; cancel goals whose clients have left the graph."""
        sample = self._samples.of(state).get(self._controller)
        followed = self._followed(state)
        if followed and sample is not None and sample.executing:
            handle = self._handle(followed[-1], sample.time)
            if handle is not None:
                handle.publish_feedback(self.feedback(sample))

    def _followed(self, state: StateSample) -> list[FollowedGoal[V]]:
        """Return the accepted goals; every `_WATCH_S`, cancel goals whose clients have left the graph."""
        followed = [goal for goal in self._goals.values() if goal.verdict is not None]
        if followed and not self._watched <= state.time < self._watched + _WATCH_S:  # a clock may be set back
            self._watched = state.time
            self._watch(followed)
        return followed

    def _handle(self, followed: FollowedGoal[V], time: float) -> Any:  # noqa: ANN401 - rclpy's
        """Return rclpy's handle of a goal if feedback is due at `time` in s, else None."""
        handle = self._server.handle_of(followed.uuid)
        return handle if handle is not None and followed.feedback_due(time) else None

    def _watch(self, followed: list[FollowedGoal[V]]) -> None:
        """Cancel the goals whose clients have left the graph, except goals that outlive their clients."""
        watched = [goal for goal in followed if goal.verdict is not None and not goal.verdict.outlives_client]
        present = self._clients.present() if watched else set()
        for goal in watched:
            if goal.is_alone(present):
                self._give_up(goal.uuid, _CLIENT_GONE)
