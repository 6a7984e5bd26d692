"""Base class of the bridge's topics, services and actions, and their access to ROS and to the robot.

Messages are published on the bridge's own thread, when the robot has sent something; callbacks of ROS run on the
spinner's thread, and only pass on what they receive. Log messages that repeat are throttled.

The ROS program that sent a request is identified by its DDS participant. Rules (DDS, Fast DDS): the first twelve bytes
of a GUID identify the participant; usually a process has one. A participant that ends announces this; one that was
killed is detected when its lease expires, after 20 s by default. Fast DDS composes these bytes from vendor, host and
process, so that a participant on the same host can be checked at once.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import re
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Generic, NamedTuple, Protocol, TypeVar

from canopen_control.ros.interfaces import MissingInterface, interface
from canopen_control.rpc.messages.samples import Sample

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from canopen_control.ros.rcl import Node
    from canopen_control.rpc.client import ReactorClient
    from canopen_control.rpc.messages.declare import Request
    from canopen_control.rpc.messages.robot import CommandController, MappedValue, TwistController
    from canopen_control.rpc.messages.state import ControllerReading, RobotEvent, StateSample

    Reply = Callable[[Any], object]
    #: called with a request, a response to be filled, and the callable that sends the response, to be called once
    Handler = Callable[[Any, Any, Reply], object]


_PREFIX: Final = 12
_VENDOR: Final = b"\x01\x0f"  # eProsima
_PROCFS: Final = Path("/proc")
_PIDS: Final = 1 << 22  # the upper limit of process ids in Linux


def client_of(header: RosMessage) -> bytes | None:
    """Return the DDS participant that sent a request, or None if unknown.

    The header is an rmw_request_id_t of C: a GUID of 16 bytes and the sequence number of the request. rclpy exposes
    only the number; pybind11 stores the structure's address after the head of the Python object. The number confirms
    the address.
    """
    pointer = ctypes.c_size_t.from_address(id(header) + object.__basicsize__).value
    if not pointer or pointer % 8:
        return None
    if ctypes.c_int64.from_address(pointer + 16).value != header.sequence_number:
        return None
    return ctypes.string_at(pointer, _PREFIX)


class ActionClients:
    """DDS participants that have a client of one action; `action` is the full name of the action."""

    def __init__(self, node: Node, action: str) -> None:
        self._node, self._action = node, action

    def present(self) -> set[bytes]:
        """Return the participants whose clients DDS has discovered."""
        publishers = self._node.get_publishers_info_by_topic(
            f"rq{self._action}/_action/send_goalRequest", no_mangle=True
        )
        return set(map(_participant, publishers))

    def runs_here(self, participant: bytes) -> bool:
        """Whether a participant belongs to a running process on this host; False for one in another container."""
        host = _host_of(self._node.get_publishers_info_by_topic(f"rt{self._action}/_action/status", no_mangle=True))
        return host is not None and participant[:4] == _VENDOR + host and runs(_process(participant))


def folder_of(node: Node, participant: bytes | None) -> Path | None:
    """Return the working directory of a participant's process; None if unreadable or on another host."""
    host = _host_of(node.get_publishers_info_by_topic("/rosout"))
    if participant is None or host is None or participant[:4] != _VENDOR + host:
        return None
    numbers = range(_process(participant), _PIDS, 65536)
    pids = [number for number in numbers if number and (_PROCFS / str(number)).exists()]
    if len(pids) != 1:
        return None
    try:
        return (_PROCFS / str(pids[0]) / "cwd").readlink()
    except OSError:  # the process belongs to another user, or has ended
        return None


def _host_of(publishers: Iterable[RosMessage]) -> bytes | None:
    """Return the two bytes that identify this host in a participant, from the publisher of this process, or None."""
    own = map(_participant, publishers)
    return next((gid[2:4] for gid in own if gid[:2] == _VENDOR and _process(gid) == os.getpid() % 65536), None)


def _participant(endpoint: RosMessage) -> bytes:
    return bytes(endpoint.endpoint_gid[:_PREFIX])


def _process(participant: bytes) -> int:
    return int.from_bytes(participant[4:6], "little")


def runs(lowest: int, procfs: Path = _PROCFS) -> bool:
    """Whether a process exists whose id has `lowest` as its lower 16 bits; zombies do not count."""
    for number in range(lowest, _PIDS, 65536):
        try:
            text = (procfs / str(number) / "stat").read_text()
        except OSError:
            continue
        if text.rpartition(")")[2].split()[:1] != ["Z"]:
            return True
    return False


A = TypeVar("A")
S = TypeVar("S", bound=Sample)
COMMANDER: Final = "ros"  # sender of commands, in the robot's status
_NUMBERS: Final = re.compile(r"[-+]?[0-9]+(?:\.[0-9]+)?(?:e[-+]?[0-9]+)?")


def without_numbers(text: str) -> str:
    """Replace each number in a message with "#", so that messages of the same kind have the same key."""
    return _NUMBERS.sub("#", text)


class Throttle:
    """Rate limit of log messages: one per `interval_ns` for each key."""

    def __init__(self, interval_ns: int = 1_000_000_000) -> None:
        self.interval_ns = interval_ns
        self._last: dict[str, int] = {}

    def allows(self, key: str, now: int) -> bool:
        """Whether a message with this key may be logged at `now` in ns; if so, the key's next interval starts."""
        last = self._last.get(key)
        if last is not None and now - last < self.interval_ns:
            return False
        self._last[key] = now
        return True


class Refusals:
    """Refused commands of each controller; the first refusal is reported, and at the end the number of refusals.

    The commands of a publisher that continues while the drives are off are refused fifty times a second for the same
    reason. A new reason is reported again; a message in which only the numbers differ is not a new reason.
    """

    def __init__(self) -> None:
        self._reasons: dict[str, str] = {}
        self._counts: dict[str, int] = {}

    def answered(self, controller: str, error: str | None) -> str | None:
        """Record the reply to a command (None: accepted); return the message to log, if any."""
        if error is None:
            count = self._counts.pop(controller, 0)
            self._reasons.pop(controller, None)
            return f"{controller} accepts commands again; {count} were refused" if count > 1 else None
        self._counts[controller] = self._counts.get(controller, 0) + 1
        reason = without_numbers(error)
        if self._reasons.get(controller) == reason:
            return None
        self._reasons[controller] = reason
        return error


def success_of(response: RosMessage, reply: Reply) -> Callable[[object, str | None], None]:
    """Return a callback that sends a service's response with the fields `success` and `message` set."""

    def answer(_done: object, error: str | None) -> None:
        response.success, response.message = error is None, error or ""
        reply(response)

    return answer


class NewSamples(Generic[S]):
    """Filter that passes each sample of a kind only once, so that a topic has one message per publication."""

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
    """Base class of the topics, services and actions of a controller, a node or the robot; handlers are optional.

    `close` destroys what `publisher`, `subscribe` and `serve` have created.
    """

    def __init__(self, ros: NodeContext) -> None:
        self._ros = ros
        self._created = contextlib.ExitStack()

    def publisher(self, kind: type, topic: str, qos: object) -> RosMessage:
        """Create a publisher."""
        publisher = self._ros.node.create_publisher(kind, topic, qos)
        self._created.callback(self._ros.node.destroy_publisher, publisher)
        return publisher

    def subscribe(self, kind: type, topic: str, callback: Callable[[Any], object], qos: object) -> object:
        """Create a subscription; an exception in the callback is logged as a warning."""
        subscription = self._ros.subscribe(kind, topic, callback, qos)
        self._created.callback(self._ros.unsubscribe, subscription)
        return subscription

    def serve(self, kind: str, name: str, handler: Handler) -> None:
        """Create a service of the interface `kind`; see `NodeContext.serve`."""
        self._created.callback(self._ros.unserve, self._ros.serve(kind, name, handler))

    def report(self, name: str, error: str | None) -> None:
        """Log the error of the topic or service `name` as a warning; None is not an error."""
        if error is not None:
            self._ros.warn(name, f"{name}: {error}")

    def on_controller(self, controller: ControllerReading) -> None:
        """Handle a new reading of the endpoint's controller; called when this or another controller has changed."""

    def on_state(self, state: StateSample) -> None:
        """Handle a sample of the robot's state stream."""

    def on_event(self, event: RobotEvent) -> None:
        """Handle an event of the robot."""

    def on_process_data(self, nodes: dict[str, list[MappedValue]]) -> None:
        """Handle the objects received in TPDOs, by node name."""

    def abort_goals(self) -> bool:
        """Abort the active goals of an action server; return whether there were any."""
        return False

    def awaits_result_requests(self) -> bool:
        """Whether the client of an aborted goal has not requested the result, and may still do so."""
        return False

    def close(self) -> None:
        """Destroy the publishers, subscriptions, services and action servers."""
        self._created.close()


_RETURN: Final = 0.2  # share of a change that the next message has to take back
_RETURNS: Final = 4  # a single publisher may reverse a command twice
_GAP_S: Final = 2.0  # maximum time between two of them
_CALM_S: Final = 10.0  # time without one after which an alternation is reported again


class PublisherWatch:
    """Detection of publishers that command one controller alternately, on one topic or on several topics.

    The EventsExecutor of rclpy does not report the publisher of a message. So the detection uses the values: they
    repeatedly change and then return to the previous values, while the topics have several publishers. Several
    publishers are normal if they send the same values, or if only one of them is active.
    """

    def __init__(self) -> None:
        self._topics: dict[str, tuple[NodeContext, float]] = {}  # subscriber and time of the last message, by topic
        self._last: Sequence[float] = ()
        self._before: Sequence[float] = ()
        self._returns, self._return_at = 0, -_CALM_S
        self._reported = False

    def take(self, ros: NodeContext, topic: str, values: Sequence[float], now: float) -> None:
        """Record a command received at `now` in s; warn once when several publishers start to alternate."""
        self._topics[topic] = (ros, now)
        last, before = self._last, self._before
        self._before, self._last = last, values
        if not len(values) == len(last) == len(before) or not _returns(values, last, before):
            return
        since, self._return_at = now - self._return_at, now
        self._returns = self._returns + 1 if since <= _GAP_S else 1
        self._reported = self._reported and since <= _CALM_S
        if self._reported or self._returns < _RETURNS:
            return
        topics = {name: context for name, (context, at) in self._topics.items() if now - at <= _GAP_S}
        infos = [info for name, endpoint in topics.items() for info in endpoint.node.get_publishers_info_by_topic(name)]
        if len(infos) > 1:
            self._reported = True
            nodes = dict.fromkeys(f"{info.node_namespace.rstrip('/')}/{info.node_name}" for info in infos)
            names = " and ".join(nodes) if len(nodes) > 1 else f"{len(infos)} publishers of {next(iter(nodes))}"
            text = f"{' and '.join(topics)}: {names} publish alternately, so the motion jerks; each newer command"
            ros.warn(f"{topic} publishers", f"{text} applies; end all but one of them")


def _returns(values: Sequence[float], last: Sequence[float], before: Sequence[float]) -> bool:
    """Whether `values` reverse the change from `before` to `last`, at least nearly."""
    change = max((abs(value - other) for value, other in zip(values, last, strict=True)), default=0.0)
    back = max((abs(value - other) for value, other in zip(values, before, strict=True)), default=0.0)
    return change > 0.0 and back <= _RETURN * change


RosMessage = Any
"""Message or other object of rclpy, whose generated classes have no types."""


class Answer:
    """Callable that sends the response to a request; `request_id` is an rmw_request_id_t of C, see `client_of`."""

    def __init__(self, send: Callable[[object, object], object], header: object) -> None:
        self._send, self._header = send, header
        self.request_id: RosMessage = getattr(header, "request_id", header)

    def __call__(self, response: object) -> object:
        return self._send(response, self._header)


class _TakenRequest(NamedTuple):
    request: RosMessage
    response: RosMessage


def serve(node: Node, kind: type, name: str, handler: Handler) -> RosMessage:
    """Create a service whose response may be sent later, from another thread.

    `handler(request, response, reply)` is called on the executor's thread and must not block. rclpy sends a response
    when the service's callback returns, and its EventsExecutor does not support coroutines. So the callback here only
    returns the request, and the replaced `send_response` of the service, which the executor then calls, starts the
    handler.
    """
    service = node.create_service(kind, name, _TakenRequest)
    send = service.send_response

    def start(request: _TakenRequest, header: object) -> None:
        handler(request.request, request.response, Answer(send, header))

    service.send_response = start
    return service


class SessionPort(Protocol):
    """Session of a robot as seen by the contexts of all ROS nodes and their endpoints."""

    robot: str
    controllers: dict[str, ControllerReading]
    publishers: dict[str, PublisherWatch]

    def command(self, request: CommandController | TwistController) -> None:
        """Send a command, replacing a waiting command to the same controller; may be called from any thread."""

    def unix(self, stamp: float | None) -> float | None:
        """Convert a ROS time stamp to Unix time in s of the robot's clock; may be called from any thread."""

    def frame(self, name: str) -> str:
        """Return the ROS name of a frame, with the robot's prefix."""

    def leave_out(self, interface: str) -> None:
        """Report once that this ROS installation lacks an interface."""

    def warn_of(self, node: Node, key: str, text: str) -> None:
        """Log a warning as `node`, at most once per second and key; may be called from any thread."""

    def hand_over(self, function: Callable[[], object]) -> None:
        """Call a function on the reactor's thread; may be called from any thread."""

    def watch_process_data(self, watcher: object, on: bool) -> None:
        """Add or remove a watcher of TPDO contents, which the robot sends only while a watcher is registered."""

    def connect(self) -> ReactorClient:
        """Return a new connection to the robot; raise RemoteError if the robot has ended."""

    def call(self, function: Callable[[], object]) -> None:
        """Call a function on the thread of ROS callbacks; may be called from any thread."""

    def ask(self, request: Request[A], answer: Callable[[A | None, str | None], object]) -> None:
        """Send a request to the robot; this call and `answer(result, error)` run on the reactor's thread."""


class NodeContext:
    """Access of endpoints to their ROS node and to the session of the robot.

    Callbacks of subscriptions run on the spinner's thread, those of services on the reactor's thread. An exception in a
    callback is logged as a warning, because the executor would otherwise drop messages.
    """

    def __init__(self, session: SessionPort, node: Node) -> None:
        self.node, self._session = node, session
        self.robot = session.robot
        self.command, self.hand_over, self.connect = session.command, session.hand_over, session.connect
        self.watch_process_data, self.call, self.ask = session.watch_process_data, session.call, session.ask
        self.unix, self.frame, self.leave_out = session.unix, session.frame, session.leave_out
        self._publishers = session.publishers

    @property
    def controllers(self) -> dict[str, ControllerReading]:
        return self._session.controllers

    def warn(self, key: str, text: str) -> None:
        """Log a warning of this node, at most once per second and key; may be called from any thread."""
        self._session.warn_of(self.node, key, text)

    def watch_publishers(self, commanded: str, topic: str, values: Sequence[float]) -> None:
        """Record a command to `commanded`, and warn about alternating publishers; call on the thread of ROS callbacks.

        Topics with the same `commanded` are watched together.
        """
        watch = self._publishers.setdefault(commanded, PublisherWatch())
        watch.take(self, topic, values, time.monotonic())

    def subscribe(self, kind: type, topic: str, callback: Callable[[Any], object], qos: object) -> object:
        """Create a subscription; an exception in the callback is logged as a warning."""

        def guarded(message: object) -> None:
            try:
                callback(message)
            except Exception as error:  # noqa: BLE001 - reported as a warning
                self.warn(topic, f"{topic}: {type(error).__name__}: {error}")

        subscription: object = self.node.create_subscription(kind, topic, guarded, qos)
        return subscription

    def unsubscribe(self, subscription: object) -> None:
        """Destroy a subscription on the callback thread, between two callbacks."""
        self.call(lambda: self.node.destroy_subscription(subscription))

    def serve(self, kind: str, name: str, handler: Handler) -> object:
        """Create a service of the interface `kind`; if ROS lacks it, report this and return None.

        `handler(request, response, reply)` is called on the reactor's thread and must not block.
        """

        def guarded(request: object, response: object, reply: Reply) -> None:
            try:
                handler(request, response, reply)
            except Exception as error:  # noqa: BLE001 - the client gets a response in any case
                self.warn(name, f"{name}: {type(error).__name__}: {error}")
                reply(response)

        def on_request(request: object, response: object, reply: Reply) -> None:
            self.hand_over(lambda: guarded(request, response, reply))

        try:
            return serve(self.node, interface(kind), name, on_request)
        except MissingInterface as error:
            self.leave_out(error.name)
            return None

    def unserve(self, service: object) -> None:
        """Destroy a service on the callback thread, between two callbacks; None is ignored."""
        if service is not None:
            self.call(lambda: self.node.destroy_service(service))
