"""Base of the topics and services of the bridge.

Publishing is done on the bridge's own thread, when the robot has sent something; callbacks of ROS
run on the spinner's thread, and only hand over.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, Generic, NamedTuple, Protocol, TypeVar

from canopen_control.rpc.messages.samples import Sample

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.ros.rcl import Node
    from canopen_control.rpc.client import ReactorClient
    from canopen_control.rpc.messages.declare import Request
    from canopen_control.rpc.messages.robot import CommandController, MappedValue, TwistController
    from canopen_control.rpc.messages.state import ControllerReading, RobotEvent, StateSample

    Reply = Callable[[Any], object]
    #: takes a request, a response to be filled, and what sends it; once
    Handler = Callable[[Any, Any, Reply], object]


A = TypeVar("A")
S = TypeVar("S", bound=Sample)
COMMANDER: Final = "ros"  # sender of commands, in the robot's status


class Ros(Protocol):
    """Context of an endpoint.

    `command` passes a command to the robot, `warn` logs a sentence once per second at most; both from any thread.
    """

    node: Node
    robot: str

    @property
    def controllers(self) -> dict[str, ControllerReading]:
        """Loaded controllers by name."""

    def command(self, request: CommandController | TwistController) -> None:
        """Send the newest command of a controller."""

    def unix(self, stamp: float | None) -> float | None:
        """Return a stamp of ROS in Unix s of the robot's clock; from any thread."""

    def warn(self, key: str, text: str) -> None:
        """Log a warning, rate-limited."""

    def frame(self, name: str) -> str:
        """Return the ROS name of a frame, with the robot's prefix."""

    def hand_over(self, function: Callable[[], object]) -> None:
        """Call a function on the reactor's thread; from any thread."""

    def subscribe(self, message: type, topic: str, callback: Callable[[Any], object], qos: object) -> object:
        """Create a subscription; an exception of the callback becomes a warning."""

    def unsubscribe(self, subscription: object) -> None:
        """Destroy a subscription."""

    def serve(self, kind: str, name: str, handler: Handler) -> object:
        """Create a service of the interface `kind`; omit it with a warning if ROS lacks the interface.

        `handler(request, response, reply)` is called on the reactor's thread and never blocks.
        """

    def leave_out(self, interface: str) -> None:
        """Report an interface that ROS lacks, once each."""

    def unserve(self, service: object) -> None:
        """Destroy a service."""

    def watch_process_data(self, watcher: object, on: bool) -> None:
        """Subscribe to TPDO contents for `on_process_data`, while they are needed."""

    def connect(self) -> ReactorClient:
        """Return a separate connection to the robot; RemoteError if the robot has ended."""

    def call(self, function: Callable[[], object]) -> None:
        """Call a function on the thread of ROS's callbacks; from any thread."""

    def ask(self, request: Request[A], answer: Callable[[A | None, str | None], object]) -> None:
        """Send a request to the robot; `answer(result, error)` is called on the reactor's thread, like this method."""


def success_of(response: RosMessage, reply: Reply) -> Callable[[object, str | None], None]:
    """Return a callback that fills `success` and `message` of a service's response."""

    def answer(_done: object, error: str | None) -> None:
        response.success, response.message = error is None, error or ""
        reply(response)

    return answer


class NewSamples(Generic[S]):
    """Samples of one kind, each once, so that a topic gets one message per publication of a controller."""

    def __init__(self, kind: type[S]) -> None:
        self._kind = kind
        self._times: dict[str, float] = {}

    def of(self, state: StateSample) -> dict[str, S]:
        """Return the samples published since the last call, by controller."""
        samples = state.samples_of(self._kind)
        new = {name: sample for name, sample in samples.items() if self._times.get(name) != sample.time}
        self._times = {name: sample.time for name, sample in samples.items()}
        return new


class Endpoint:
    """Topics of one controller, or of the robot; methods without an override do nothing."""

    def on_controller(self, controller: ControllerReading) -> None:
        """Process a change of the controller of the endpoint."""

    def on_state(self, state: StateSample) -> None:
        """Process a sample of the state stream."""

    def on_event(self, event: RobotEvent) -> None:
        """Process an event."""

    def on_process_data(self, nodes: dict[str, list[MappedValue]]) -> None:
        """Process TPDO contents by node."""

    def close(self) -> None:
        """Destroy the endpoint."""


RosMessage = Any
"""A message or what else rclpy hands over: generated classes, without types."""


class Answer:
    """Sends the response to a request, once; `request_id` is C's rmw_request_id_t, see `participants.client_of`."""

    def __init__(self, send: Callable[[object, object], object], header: object) -> None:
        self._send, self._header = send, header
        self.request_id: RosMessage = getattr(header, "request_id", header)

    def __call__(self, response: object) -> object:
        """Send the response."""
        return self._send(response, self._header)


class _TakenRequest(NamedTuple):
    request: RosMessage
    response: RosMessage


def serve(node: Node, kind: type, name: str, handler: Handler) -> RosMessage:
    """Create a service whose answer may come later, from another thread.

    `handler(request, response, reply)` is called on the executor's thread and must not block. rclpy answers a service
    when its callback returns, and its EventsExecutor takes no coroutine. So the callback here only collects the
    request, and what the executor then sends through the service's `send_response` starts the work.
    """
    service = node.create_service(kind, name, _TakenRequest)
    send = service.send_response

    def start(request: _TakenRequest, header: object) -> None:
        handler(request.request, request.response, Answer(send, header))

    service.send_response = start
    return service
