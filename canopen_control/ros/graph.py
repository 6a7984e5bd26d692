"""What the command line needs of the ROS graph: who is there, listening, publishing, calling, on a node of its own.

The law of the file: everything waits for a finite time, and ends at once when its thread is interrupted. A fresh node
does not know the graph yet, so it is given a moment before it is asked.
"""

from __future__ import annotations

import contextlib
import os
import sys
import time
from typing import TYPE_CHECKING, Any, Final

from canopen_control.errors import CanopenError, ConfigError
from canopen_control.ros.installation import from_wheels, prepare, require_ros
from canopen_control.ros.interfaces import MissingInterface, interface
from canopen_control.ros.message_text import fill

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    Names = list[tuple[str, list[str]]]

__all__ = ["Graph", "open_graph"]

_STEP_S: Final = 0.05
MOMENT_S: Final = 1.0


@contextlib.contextmanager
def open_graph(arguments: Sequence[str] = ()) -> Iterator[Graph]:
    """Make a node; raises ConfigError when there is no ROS, CanopenError when it does not start."""
    require_ros()
    prepare(os.environ, wheels=from_wheels(), prefix=sys.prefix)
    try:
        from canopen_control.ros.rcl import start

        context, node = start(f"canopen_control_cli_{os.getpid()}", "", list(arguments))
    except Exception as error:
        raise CanopenError(f"ROS 2 could not be started: {error}") from error
    graph = Graph(context, node)
    try:
        yield graph
    finally:
        graph.close()


class Graph:
    """One node; times are seconds."""

    def __init__(self, context: Any, node: Any) -> None:  # noqa: ANN401 - rclpy's
        from canopen_control.ros.rcl import single_threaded_executor

        self._context, self._node = context, node
        self._executor = single_threaded_executor(context)
        self._executor.add_node(node)

    def close(self) -> None:
        """Leave the graph."""
        self._executor.shutdown()
        self._node.destroy_node()
        self._context.try_shutdown()

    def spin(self, seconds: float, until: Callable[[], object] = lambda: False) -> bool:
        """Serve callbacks until a condition holds; whether it does."""
        deadline = time.monotonic() + seconds
        while not until():
            left = deadline - time.monotonic()
            if left <= 0:
                return False
            self._executor.spin_once(timeout_sec=min(left, _STEP_S))
        return True

    def topics(self) -> Names:
        """Return (name, types) of what is published or subscribed to by others."""
        self.spin(MOMENT_S)
        return sorted(self._node.get_topic_names_and_types())

    def services(self) -> Names:
        """Return (name, types) of the services of others."""
        self.spin(MOMENT_S)
        own = f"/{self._node.get_name()}/"
        return sorted(each for each in self._node.get_service_names_and_types() if not each[0].startswith(own))

    def type_of(self, topic: str, seconds: float) -> str:
        """Return the type of a topic; CanopenError when nobody has it in time, or with several types."""
        return self._only(topic, self._node.get_topic_names_and_types, "topic", seconds)

    def _only(self, name: str, names: Callable[[], Names], what: str, seconds: float) -> str:
        absolute = name if name.startswith("/") else f"/{name}"
        self.spin(seconds, lambda: absolute in dict(names()))
        types = dict(names()).get(absolute, [])
        if not types:
            raise CanopenError(f"there is no {what} {absolute}; canopen-control ros {what} list shows which there are")
        if len(types) > 1:
            raise CanopenError(f"{absolute} has several types ({', '.join(types)}); say which one is meant")
        return types[0]

    def subscribe(self, topic: str, kind: str, callback: Callable[[Any], object]) -> None:
        """Subscribe with a quality that fits those who publish now."""
        from canopen_control.ros.qos import quality_of

        infos = self._node.get_publishers_info_by_topic(topic)
        self._node.create_subscription(class_of(kind), topic, callback, quality_of(infos))

    def publisher(self, topic: str, kind: str, data: object) -> Publication:
        """Return what publishes a message made of data; raises ConfigError."""
        message = _filled(class_of(kind)(), data)
        publisher = self._node.create_publisher(type(message), topic, 10)
        return Publication(
            lambda: _sent(publisher, message), publisher.get_subscription_count, lambda data: _filled(message, data)
        )

    def call(self, service: str, kind: str, data: object, seconds: float) -> Any:  # noqa: ANN401 - a response
        """Call a service and return its response; raises ConfigError or CanopenError."""
        found = class_of(kind)
        request = _filled(found.Request(), data)  # type: ignore[attr-defined] # every service class has one
        client = self._node.create_client(found, service)
        if not self.spin(seconds, client.service_is_ready):
            raise CanopenError(
                f"nobody serves {service} as {kind}; canopen-control ros service list shows who serves what"
            )
        future = client.call_async(request)
        if not self.spin(seconds, future.done):
            raise CanopenError(f"{service} has not answered within {seconds:g} s")
        return future.result()


class Publication:
    """A message that can be published again and again; `subscribers` tells how many get it, `fill` changes fields."""

    def __init__(
        self, publish: Callable[[], object], subscribers: Callable[[], int], fill: Callable[[object], object]
    ) -> None:
        self.publish, self.subscribers, self.fill = publish, subscribers, fill


def class_of(name: str) -> type:
    """Return the class of an interface; ConfigError when there is none."""
    try:
        found: type = interface(name)
    except (ImportError, AttributeError, MissingInterface):
        raise ConfigError(f"this ROS has no interface {name}") from None
    return found


def _filled(message: Any, data: object) -> Any:  # noqa: ANN401 - somebody's generator's class
    try:
        return fill(message, data, class_of)
    except (TypeError, ValueError, AssertionError, OverflowError) as error:
        raise ConfigError(f"the message cannot be made: {error}") from error


def _sent(publisher: Any, message: Any) -> None:  # noqa: ANN401 - rclpy's, and somebody's generator's
    try:
        publisher.publish(message)
    except Exception as error:
        raise ConfigError(f"the message cannot be sent: {error}") from error
