"""What every topic and service of the bridge is made with, and the two shapes that a feature has.

The law of the file: publishing is done on the bridge's own thread, when the robot has sent something; callbacks of ROS
run on the spinner's thread, and only hand over.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.ros.asker import Answer
    from canopen_control.ros.conversions import ControllerView
    from canopen_control.ros.rcl import Node
    from canopen_control.ros.service import Handler

__all__ = ["Endpoint", "Ros"]


class Ros(Protocol):
    """What an endpoint is given.

    `command` hands a command to the robot, `warn` says a sentence once per second at most; both from any thread.
    """

    node: Node
    robot: str
    controllers: dict[str, ControllerView]

    def command(self, controller: str, method: str, params: dict[str, Any]) -> None:
        """Send the newest command of a controller."""

    def warn(self, key: str, text: str) -> None:
        """Tell the user, rarely."""

    def hand_over(self, function: Callable[[], object]) -> None:
        """Have a function called on the reactor's thread; from any thread."""

    def subscribe(self, message: type, topic: str, callback: Callable[[Any], object], qos: object) -> object:
        """Make a subscription; an exception of the callback becomes a warning."""

    def unsubscribe(self, subscription: object) -> None:
        """Leave a topic."""

    def serve(self, kind: type, name: str, handler: Handler) -> object:
        """Make a service; `handler(request, response, reply)` is called on the reactor's thread and never blocks."""

    def unserve(self, service: object) -> None:
        """Leave a service."""

    def watch_process_data(self, watcher: object, wanted: bool) -> None:
        """Have the robot tell what its TPDOs carry, to `on_process_data`, while anybody wants it."""

    def ask(self, method: str, params: dict[str, Any], answer: Answer) -> None:
        """Ask the robot, and have `answer(result, error)` called on the reactor's thread, where this is called too."""


class Endpoint:
    """Topics of one controller, or of the whole robot; what it does not override it does not care for."""

    def on_controller(self, controller: ControllerView) -> None:
        """Learn that the controller it belongs to has changed."""

    def on_state(self, state: dict[str, Any]) -> None:
        """Take a sample of the state stream."""

    def on_event(self, event: dict[str, Any]) -> None:
        """Learn that something has happened."""

    def on_process_data(self, nodes: dict[str, Any]) -> None:
        """Take what has come in TPDOs: `{node: [[index, subindex, hex], ...]}`."""

    def close(self) -> None:
        """Leave the graph."""
