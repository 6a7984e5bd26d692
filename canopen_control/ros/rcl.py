"""Parts of rclpy used by the bridge, without types.

rclpy is partly typed, differently in each release, and may be missing where types are checked; so the names that are
imported from here have the type Any.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Sequence


Node = Any
Context = Any

_executors = importlib.import_module("rclpy.executors")
_qos = importlib.import_module("rclpy.qos")

Duration = importlib.import_module("rclpy.duration").Duration
DurabilityPolicy = _qos.DurabilityPolicy
ExternalShutdownException: type[Exception] = _executors.ExternalShutdownException
Future = importlib.import_module("rclpy.task").Future
QoSProfile = _qos.QoSProfile
ReliabilityPolicy = _qos.ReliabilityPolicy
qos_profile_system_default = _qos.qos_profile_system_default


def error_text(error: Exception) -> str:
    """Return the message of an rclpy exception in one line."""
    text = " ".join(str(error).split())
    return f"unknown arguments: {text}" if type(error).__name__ == "UnknownROSArgsError" else text


def start(name: str, namespace: str, arguments: list[str]) -> tuple[Context, Node]:
    """Create a context without signal handlers, and a node; may raise any exception of rclpy."""
    rclpy = importlib.import_module("rclpy")
    context = importlib.import_module("rclpy.context").Context()
    if namespace.strip("/"):  # errors are reported before a node is partly created
        importlib.import_module("rclpy.validate_namespace").validate_namespace(f"/{namespace.strip('/')}")
    signals = importlib.import_module("rclpy.signals").SignalHandlerOptions
    rclpy.init(args=arguments, context=context, signal_handler_options=signals.NO)
    return context, rclpy.create_node(name, context=context, namespace=namespace)


def further_node(name: str, context: Context, namespace: str, arguments: Sequence[str] = ()) -> Node:
    """Return another node in the same context, without parameter services; may raise any exception of rclpy.

    `arguments` are the node's own arguments after `--ros-args`, and override the arguments of all nodes. A remapping of
    the node name applies only to the first node; remappings of topics apply to all nodes.
    """
    rclpy = importlib.import_module("rclpy")
    importlib.import_module("rclpy.validate_node_name").validate_node_name(name)  # it becomes an argument below
    parameter = importlib.import_module("rclpy.parameter").Parameter
    return rclpy.create_node(
        name,
        context=context,
        namespace=namespace,
        cli_args=[
            "--ros-args",
            "-r",
            f"__node:={name}",
            *(argument for argument in arguments if argument != "--ros-args"),
        ],
        start_parameter_services=False,
        parameter_overrides=[
            parameter("start_type_description_service", value=False),
            parameter("use_sim_time", value=False),  # only the first node subscribes to /clock
        ],
    )


def ros_seconds(node: Node) -> float | None:
    """Return a node's time in s from `/clock`, 0 before the first message; None if the node uses the system clock."""
    clock = node.get_clock()
    return clock.now().nanoseconds / 1e9 if clock.ros_time_is_active else None


def make_executor(context: Context) -> Any:  # noqa: ANN401 - see above
    """Return an EventsExecutor if this rclpy has it, else a single-threaded executor."""
    try:
        events = importlib.import_module("rclpy.experimental.events_executor")
    except ImportError:
        return _executors.SingleThreadedExecutor(context=context)
    return events.EventsExecutor(context=context)


def single_threaded_executor(context: Context) -> Any:  # noqa: ANN401 - see above
    """Return a single-threaded executor, for a thread that does other things between spins."""
    return _executors.SingleThreadedExecutor(context=context)
