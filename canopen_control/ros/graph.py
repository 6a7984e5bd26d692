"""ROS node through which the command line accesses topics and services.

Every wait has a timeout, and ends at once when its thread is interrupted. A new node has not discovered the graph yet,
so the first query waits a moment.
"""

from __future__ import annotations

import contextlib
import math
import os
import re
import sys
import time
from typing import TYPE_CHECKING, Any, Final

from canopen_control.errors import CanopenError, ConfigError
from canopen_control.ros.installation import from_wheels, prepare, require_ros
from canopen_control.ros.interfaces import MissingInterface, interface

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    ClassOf = Callable[[str], type]
    Names = list[tuple[str, list[str]]]


# Conversion of YAML data to ROS messages and of messages to text, for users without ros2cli; ROS is imported on use.
#
# Data is the content of a YAML document, with fields by name; fields that are not named keep their defaults. An unknown
# field or a value of the wrong type is reported in one sentence with the path of the field. Text is YAML as printed by
# `ros2 topic echo`; plain data can be written as JSON, with null for a number that is not finite.


_INTEGERS: Final = re.compile(r"u?int(8|16|32|64)")
_SEQUENCE: Final = re.compile(r"sequence<(.+?)(?:, *(\d+))?>|(.+)\[(\d+)\]")
_EXPONENT: Final = re.compile(r"[-+]?\d+[eE][-+]?\d+")
_SHORT: Final = re.compile(r"([a-z][a-z0-9_]*)/(?:(msg|srv)/)?([A-Za-z][A-Za-z0-9]*)")


def full_name(text: str, kind: str) -> str:
    """Expand "std_msgs/String" to "std_msgs/msg/String"; `kind` is "msg" or "srv".

    Raise ConfigError if `text` is not the name of an interface.
    """
    match = _SHORT.fullmatch(text)
    if match is None or match[2] not in (None, kind):
        raise ConfigError(
            f"{text!r} is not an interface; write PACKAGE/{kind}/NAME, such as std_msgs/msg/Float64MultiArray"
        )
    return f"{match[1]}/{kind}/{match[3]}"


def fill(message: Any, data: object, class_of: ClassOf, place: str = "") -> Any:  # noqa: ANN401 - generated
    """Set the fields in `data` on a message, and return the message; raise ConfigError for invalid data.

    `class_of` returns the class of a nested message.
    """
    types = message.get_fields_and_field_types()
    if not isinstance(data, dict):
        raise ConfigError(f"{place or 'the message'} has fields ({', '.join(types)}), not {data!r}")
    for name, value in data.items():
        path = f"{place}.{name}" if place else str(name)
        if name not in types:
            raise ConfigError(f"{path} is not a field of the message; the fields are: {', '.join(types)}")
        setattr(message, name, _field_value(value, types[name], class_of, path))
    return message


def _field_value(value: object, kind: str, class_of: ClassOf, path: str) -> Any:  # noqa: ANN401 - what the field holds
    match = _SEQUENCE.fullmatch(kind)
    if match is None:
        return _scalar(value, kind, class_of, path)
    if not isinstance(value, list):
        raise ConfigError(f"{path} is a list of {match[1] or match[3]}, not {value!r}")
    length = int(match[4] or len(value))
    if len(value) != length or len(value) > int(match[2] or len(value)):
        raise ConfigError(f"{path} has {match[4] or f'at most {match[2]}'} elements, not {len(value)}")
    return [_scalar(item, match[1] or match[3], class_of, f"{path}[{at}]") for at, item in enumerate(value)]


def _scalar(value: object, kind: str, class_of: ClassOf, path: str) -> Any:  # noqa: ANN401 - what the field holds
    if "/" in kind:
        package, _, short = kind.partition("/")
        return fill(class_of(f"{package}/msg/{short}")(), value, class_of, path)
    for fits, make in _SCALARS:
        scalar = make(value) if fits(kind) else None
        if scalar is not None:
            return scalar
    raise ConfigError(f"{path} is a {kind}, not {value!r}")


def _integer(value: object) -> int | None:
    return value if isinstance(value, int) and not isinstance(value, bool) else None


def _number(value: object) -> float | None:
    if isinstance(value, str) and _EXPONENT.fullmatch(value):
        return float(value)  # YAML 1.1 reads 1e-06 as text
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else None


def _octet(value: object) -> bytes | None:
    return bytes([value]) if isinstance(value, int) and 0 <= value < 256 else None


_SCALARS: Final[tuple[tuple[Callable[[str], object], Callable[[object], object]], ...]] = (
    (lambda kind: kind in ("double", "float", "float32", "float64"), _number),
    (_INTEGERS.fullmatch, _integer),
    (lambda kind: kind == "boolean", lambda value: value if isinstance(value, bool) else None),
    (lambda kind: kind == "octet", _octet),
    (lambda kind: kind.startswith(("string", "wstring")), lambda value: value if isinstance(value, str) else None),
)


def plain(value: Any) -> Any:  # noqa: ANN401 - a message, or what one of its fields holds
    """Convert a message to dicts, lists, numbers, booleans and text; None for a number that is not finite."""
    if hasattr(value, "get_fields_and_field_types"):
        return {name: plain(getattr(value, name)) for name in value.get_fields_and_field_types()}
    if isinstance(value, bytes):
        return int.from_bytes(value, "little")
    if isinstance(value, bool | int | str):
        return value
    if hasattr(value, "__len__"):
        return [plain(item) for item in value]
    number = value.item() if hasattr(value, "item") else value  # numpy's scalars
    return None if isinstance(number, float) and not math.isfinite(number) else number


def lines(message: Any, indent: str = "") -> Iterator[str]:  # noqa: ANN401 - a generated class
    """Yield a message as lines of YAML."""
    for name in message.get_fields_and_field_types():
        value = getattr(message, name)
        if hasattr(value, "get_fields_and_field_types"):
            yield f"{indent}{name}:"
            yield from lines(value, indent + "  ")
        elif isinstance(value, str | bytes) or not hasattr(value, "__len__"):
            yield f"{indent}{name}: {_text(value)}"
        elif not len(value):
            yield f"{indent}{name}: []"
        else:
            yield f"{indent}{name}:"
            yield from _elements(value, indent)


def _elements(values: Any, indent: str) -> Iterator[str]:  # noqa: ANN401 - list, tuple, array or numpy's
    for value in values:
        if hasattr(value, "get_fields_and_field_types"):
            first, *others = list(lines(value, indent + "  ")) or [f"{indent}  {{}}"]
            yield f"{indent}- {first.lstrip()}"
            yield from others
        else:
            yield f"{indent}- {_text(value)}"


def _text(value: Any) -> str:  # noqa: ANN401 - what a field holds
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, bytes):
        return str(int.from_bytes(value, "little"))
    if isinstance(value, str):
        return "'" + value.replace("'", "''") + "'" if "\n" not in value else repr(value)
    number = float(value) if type(value).__module__ == "numpy" and "float" in type(value).__name__ else value
    return {"nan": ".nan", "inf": ".inf", "-inf": "-.inf"}.get(str(number), str(number))


_STEP_S: Final = 0.05
MOMENT_S: Final = 1.0


@contextlib.contextmanager
def open_graph() -> Iterator[Graph]:
    """Open a node that is closed on exit; raise ConfigError without ROS, CanopenError if ROS 2 cannot be started."""
    require_ros()
    prepare(os.environ, wheels=from_wheels(), prefix=sys.prefix)
    try:
        from canopen_control.ros.rcl import start

        context, node = start(f"canopen_control_cli_{os.getpid()}", "", [])
    except Exception as error:
        raise CanopenError(f"ROS 2 could not be started: {error}") from error
    graph = Graph(context, node)
    try:
        yield graph
    finally:
        graph.close()


class Graph:
    """ROS node for the command line; all times are in s."""

    def __init__(self, context: Any, node: Any) -> None:  # noqa: ANN401 - rclpy's
        from canopen_control.ros.rcl import single_threaded_executor

        self._context, self._node = context, node
        self._executor = single_threaded_executor(context)
        self._executor.add_node(node)

    def close(self) -> None:
        self._executor.shutdown()
        self._node.destroy_node()
        self._context.try_shutdown()

    def spin(self, seconds: float, until: Callable[[], object] = lambda: False) -> bool:
        """Execute callbacks until a condition is true; return False if it is not true after `seconds`."""
        deadline = time.monotonic() + seconds
        while not until():
            remaining = deadline - time.monotonic()
            if remaining <= 0:
                return False
            self._executor.spin_once(timeout_sec=min(remaining, _STEP_S))
        return True

    def topics(self) -> Names:
        """Return the names and types of the topics in the graph, sorted by name."""
        self.spin(MOMENT_S)
        return sorted(self._node.get_topic_names_and_types())

    def services(self) -> Names:
        """Return the names and types of the services of other nodes, sorted by name."""
        self.spin(MOMENT_S)
        own_prefix = f"/{self._node.get_name()}/"
        return sorted(
            service for service in self._node.get_service_names_and_types() if not service[0].startswith(own_prefix)
        )

    def type_of(self, topic: str, seconds: float, chosen: str | None = None) -> str:
        """Return the type of a topic, or the full name of the `chosen` type if it is given.

        Raise CanopenError if the topic does not appear within `seconds`, or has several types and none is chosen;
        raise ConfigError if `chosen` is not the name of an interface.
        """
        absolute, names = topic if topic.startswith("/") else f"/{topic}", self._node.get_topic_names_and_types
        self.spin(seconds, lambda: absolute in dict(names()))
        types: list[str] = dict(names()).get(absolute, [])
        if not types:
            raise CanopenError(f"topic {absolute} does not exist; canopen-control ros topic list lists all topics")
        if chosen:
            return full_name(chosen, "msg")
        if len(types) > 1:
            raise CanopenError(f"{absolute} has several types ({', '.join(types)}); name the type after the topic")
        return types[0]

    def subscribe(self, topic: str, kind: str, callback: Callable[[Any], object]) -> None:
        """Subscribe to a topic with a quality of service that matches its present publishers."""
        from canopen_control.ros.rcl import quality_of

        infos = self._node.get_publishers_info_by_topic(topic)
        self._node.create_subscription(class_of(kind), topic, callback, quality_of(infos))

    def publisher(self, topic: str, kind: str, data: object) -> Publication:
        """Create a publisher of a message filled with `data`; raise ConfigError if the data is invalid."""
        message = _filled(class_of(kind)(), data)
        return Publication(self._node.create_publisher(type(message), topic, 10), message)

    def call(self, service: str, kind: str, data: object, seconds: float) -> Any:  # noqa: ANN401 - a response
        """Call a service and return the response; raise ConfigError for invalid data, CanopenError after a timeout."""
        service_class = class_of(kind)
        request = _filled(service_class.Request(), data)  # type: ignore[attr-defined] # every service class has one
        client = self._node.create_client(service_class, service)
        if not self.spin(seconds, client.service_is_ready):
            raise CanopenError(
                f"no node serves {service} as {kind}; canopen-control ros service list lists all services"
            )
        future = client.call_async(request)
        if not self.spin(seconds, future.done):
            raise CanopenError(f"{service} has not answered within {seconds:g} s")
        return future.result()


class Publication:
    """Message with its publisher; the message can be published repeatedly."""

    def __init__(self, publisher: Any, message: Any) -> None:  # noqa: ANN401 - rclpy's, and a generated class
        self._publisher, self._message = publisher, message

    def publish(self) -> None:
        """Send the message; raise ConfigError if rclpy cannot serialise a value."""
        try:
            self._publisher.publish(self._message)
        except Exception as error:
            raise ConfigError(f"the message cannot be sent: {error}") from error

    def fill(self, data: object) -> None:
        """Set the fields that `data` contains; raise ConfigError if the data is invalid."""
        _filled(self._message, data)

    def subscribers(self) -> int:
        """Return the number of matching subscriptions."""
        return int(self._publisher.get_subscription_count())


def class_of(name: str) -> type:
    """Return the class of a ROS interface; raise ConfigError if this ROS installation lacks it."""
    try:
        interface_class: type = interface(name)
    except (ImportError, AttributeError, MissingInterface):
        raise ConfigError(f"this ROS installation lacks the interface {name}") from None
    return interface_class


def _filled(message: Any, data: object) -> Any:  # noqa: ANN401 - a generated class
    try:
        return fill(message, data, class_of)
    except (TypeError, ValueError, AssertionError, OverflowError) as error:
        raise ConfigError(f"the message cannot be created: {error}") from error
