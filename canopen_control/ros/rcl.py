"""Parts of rclpy that the bridge uses, without types: quality of service, nodes, and the thread of the callbacks.

rclpy is partly typed, differently in each release, and may be missing where types are checked; so the names that are
imported from here have the type Any.

Quality of service is as in ros2_control and robot_state_publisher. Measured with Fast DDS: with the system default, a
publisher is reliable and transient local, and a subscription is best effort and volatile. So such a publisher matches
every subscription, and such a subscription matches every publisher.

The executor of `Spinner` is an EventsExecutor if available, else single-threaded; every wait is finite, because the
endless wait of EventsExecutor.spin() is broken in the wheels (a busy loop without callbacks). A multi-threaded executor
is never used, because it loses messages.
"""

from __future__ import annotations

import importlib
import threading
from collections import deque
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence


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

SYSTEM_DEFAULT = _qos.qos_profile_system_default
#: also receives the last message before the subscription: rclcpp::SystemDefaultsQoS().transient_local()
KEPT_DEFAULT = QoSProfile(
    depth=1,
    reliability=ReliabilityPolicy.SYSTEM_DEFAULT,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
#: transient local with the last message, for later subscribers: robot_description, /tf_static
LATCHED = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)
#: only the newest message, reliable: as joint_state_topic_hardware_interface publishes its commands
LATEST = QoSProfile(depth=1)
#: only the newest message of any publisher: as chainable controllers subscribe to references
REFERENCE = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT, durability=DurabilityPolicy.SYSTEM_DEFAULT)
TF = QoSProfile(depth=100)
TF_STATIC = LATCHED
EVENTS = QoSProfile(depth=50)
#: depth as in rcl for the log of every node
ROSOUT = QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL, lifespan=Duration(seconds=10))


def quality_of(publishers: Sequence[Any]) -> Any:  # noqa: ANN401 - rclpy's, without types
    """Return a subscription profile that matches all these publishers; transient local if all of them are."""
    profiles = [publisher.qos_profile for publisher in publishers]
    reliable = all(profile.reliability == ReliabilityPolicy.RELIABLE for profile in profiles)
    is_latched = bool(profiles) and all(profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for profile in profiles)
    return QoSProfile(
        depth=50,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if is_latched else DurabilityPolicy.VOLATILE,
    )


def error_text(error: Exception) -> str:
    """Return the message of an rclpy exception on one line."""
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


_WAIT_S: Final = 1.0


class Spinner:
    """Thread that runs the callbacks of `node` and of added nodes, and calls `on_error` with their exceptions."""

    def __init__(self, node: Node, context: Context, on_error: Callable[[Exception], object]) -> None:
        self._executor = make_executor(context)
        self._executor.add_node(node)
        self._nodes, self._on_error = [node], on_error
        self._calls: deque[Callable[[], object]] = deque()
        self._ending = threading.Event()
        self._end = Future()
        self._thread = threading.Thread(target=self._run, name="ros", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def stop(self, timeout: float) -> bool:
        """Run the functions of earlier `call`s, stop the thread and remove all nodes.

        Return False if a callback blocks the thread for `timeout` s.
        """
        if self._thread.ident is not None:
            self.call(self._end_run)
            self._executor.wake()
            self._thread.join(timeout)
        self._ending.set()
        if self._thread.is_alive():
            return False
        for node in self._nodes:
            self._executor.remove_node(node)
        self._executor.shutdown(timeout)
        return True

    def add(self, node: Node) -> None:
        """Add a node; call only from the thread that calls `stop`."""
        self._nodes.append(node)
        self._executor.add_node(node)

    def remove(self, node: Node) -> None:
        """Remove and destroy a node between two callbacks, or at once after `stop`."""
        self._nodes.remove(node)

        def end() -> None:
            self._executor.remove_node(node)
            node.destroy_node()

        if self._ending.is_set():
            node.destroy_node()
        else:
            self.call(end)

    def call(self, function: Callable[[], object]) -> None:
        """Run a function on the spinning thread, between callbacks; may be called from any thread."""
        self._calls.append(function)
        self._executor.create_task(self._run_call)

    def _run_call(self) -> None:
        """Run the oldest function; some executors of rclpy run the newest task first."""
        self._calls.popleft()()

    def _end_run(self) -> None:
        self._ending.set()
        self._end.set_result(None)

    def _run(self) -> None:
        while not self._ending.is_set():
            try:
                self._executor.spin_until_future_complete(self._end, timeout_sec=_WAIT_S)
            except ExternalShutdownException:
                return
            except Exception as error:  # noqa: BLE001 - an error in a callback is reported, and spinning continues
                self._on_error(error)
