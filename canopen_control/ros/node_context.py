"""Context in which the endpoints of one ROS node create topics and services and send requests to the robot.

Callbacks of subscriptions run on the spinner's thread, those of services on the reactor's thread. An exception in a
callback is logged as a warning of the node, since the executor would otherwise drop messages.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol, TypeVar

from canopen_control.ros.endpoint import serve as make_service
from canopen_control.ros.interfaces import MissingInterface, interface

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.ros.endpoint import Handler, Reply
    from canopen_control.ros.rcl import Node
    from canopen_control.rpc.client import ReactorClient
    from canopen_control.rpc.messages.declare import Request
    from canopen_control.rpc.messages.robot import CommandController, TwistController
    from canopen_control.rpc.messages.state import ControllerReading


A = TypeVar("A")


class SessionPort(Protocol):
    """Session of a robot as used by the contexts of all its ROS nodes; see `endpoint.Ros`."""

    robot: str
    controllers: dict[str, ControllerReading]

    def command(self, request: CommandController | TwistController) -> None:
        """Send a command, which replaces a waiting command to the same controller."""

    def unix(self, stamp: float | None) -> float | None:
        """Convert a stamp of ROS time to Unix time in s of the robot's clock."""

    def frame(self, name: str) -> str:
        """Return the ROS name of a frame, with the robot's prefix."""

    def leave_out(self, interface: str) -> None:
        """Report once for each interface that this ROS installation lacks it."""

    def warn_of(self, node: Node, key: str, text: str) -> None:
        """Log a warning as `node`, at most once per second for each key."""

    def hand_over(self, function: Callable[[], object]) -> None:
        """Call a function on the reactor's thread."""

    def watch_process_data(self, watcher: object, on: bool) -> None:
        """Start or stop calling `on_process_data` of `watcher` with TPDO contents."""

    def connect(self) -> ReactorClient:
        """Return a new connection to the robot."""

    def call(self, function: Callable[[], object]) -> None:
        """Call a function on the thread of ROS callbacks."""

    def ask(self, request: Request[A], answer: Callable[[A | None, str | None], object]) -> None:
        """Send a request to the robot."""


class NodeContext:
    """Implementation of `Ros` for the endpoints of one ROS node."""

    def __init__(self, shared: SessionPort, node: Node) -> None:
        self.node, self._shared = node, shared
        self.robot = shared.robot
        self.command, self.hand_over, self.connect = shared.command, shared.hand_over, shared.connect
        self.watch_process_data, self.call, self.ask = shared.watch_process_data, shared.call, shared.ask
        self.unix, self.frame, self.leave_out = shared.unix, shared.frame, shared.leave_out

    @property
    def controllers(self) -> dict[str, ControllerReading]:
        return self._shared.controllers

    def warn(self, key: str, text: str) -> None:
        self._shared.warn_of(self.node, key, text)

    def subscribe(self, message: type, topic: str, callback: Callable[[Any], object], qos: object) -> object:
        def guarded(each: object) -> None:
            try:
                callback(each)
            except Exception as error:  # noqa: BLE001 - see above
                self.warn(topic, f"{topic}: {type(error).__name__}: {error}")

        subscription: object = self.node.create_subscription(message, topic, guarded, qos)
        return subscription

    def unsubscribe(self, subscription: object) -> None:
        """Destroy a subscription on the callback thread, between two callbacks."""
        self.call(lambda: self.node.destroy_subscription(subscription))

    def serve(self, kind: str, name: str, handler: Handler) -> object:
        def guarded(request: object, response: object, reply: Reply) -> None:
            try:
                handler(request, response, reply)
            except Exception as error:  # noqa: BLE001 - the client gets a response in any case
                self.warn(name, f"{name}: {type(error).__name__}: {error}")
                reply(response)

        def on_request(request: object, response: object, reply: Reply) -> None:
            self.hand_over(lambda: guarded(request, response, reply))

        try:
            return make_service(self.node, interface(kind), name, on_request)
        except MissingInterface as error:
            self.leave_out(error.name)
            return None

    def unserve(self, service: object) -> None:
        """Destroy a service on the callback thread, between two callbacks; None is ignored."""
        if service is not None:
            self.call(lambda: self.node.destroy_service(service))
