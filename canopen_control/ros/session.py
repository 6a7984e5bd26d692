"""Session of a running robot in ROS.

There are two threads. The reactor's thread owns the connection to the robot and publishes the messages that it
receives; the spinner's thread receives messages from ROS and passes them on through the mailbox. An error of a message,
a topic or a controller is reported and the session continues; only the end of the connection ends the session.
"""

from __future__ import annotations

import contextlib
import threading
import time
from functools import partial
from typing import TYPE_CHECKING, Final, Generic, TypeVar

from canopen_control.client.robot_client import outpaced, stream_rate
from canopen_control.errors import RemoteError, UnreadableMessage
from canopen_control.host.sockets import socket_path
from canopen_control.ros.base_topics import Frames, SharedTwist
from canopen_control.ros.controller_endpoints import endpoints_for
from canopen_control.ros.controller_nodes import ControllerNodes
from canopen_control.ros.drive_services import DriveServices, DriveTargets, MasterServices
from canopen_control.ros.drive_topics import DriveTopics
from canopen_control.ros.endpoint import Endpoint, NodeContext, PublisherWatch, Refusals, Throttle
from canopen_control.ros.interfaces import MissingInterface
from canopen_control.ros.manager_services import ControllerManagerServices, LifecycleServices
from canopen_control.ros.nodes import RosNode, nodes_of
from canopen_control.ros.rcl import Spinner, ros_seconds
from canopen_control.ros.robot_topics import (
    Activity,
    Diagnostics,
    Events,
    GroundTruth,
    LaserScans,
    RobotDescription,
    Rosout,
    SimClock,
    SimulationServices,
    TopicHardware,
)
from canopen_control.rpc.client import ENDLESS, ReactorClient
from canopen_control.rpc.messages.parameters import MANAGER, GetParameters
from canopen_control.rpc.messages.robot import (
    ROBOT,
    AxisRequest,
    GetDescription,
    GetLayout,
    GetNodes,
    GetStatus,
    ListControllers,
    ProcessData,
    PublishEvent,
    Subscribe,
)
from canopen_control.rpc.messages.samples import stamped
from canopen_control.rpc.messages.state import RobotEvent, StateSample

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.client import RobotClient
    from canopen_control.host.reactor import Reactor
    from canopen_control.ros.bridge_options import BridgeOptions
    from canopen_control.ros.rcl import Context, Node
    from canopen_control.rpc.messages.declare import Request
    from canopen_control.rpc.messages.robot import (
        CommandController,
        CommandDone,
        RobotPush,
        TwistController,
    )
    from canopen_control.rpc.messages.state import ControllerReading

    Command = CommandController | TwistController


# Transfer of commands from ROS to the robot: the newest command of each controller, at most one per cycle.
#
# A publisher may be faster than that: a new command replaces a waiting one and is never queued, so that the robot gets
# the latest command once per `interval_ns`. The first command after a pause is sent at once.


T = TypeVar("T")


class Mailbox(Generic[T]):
    """Store of the latest value per name; any thread may call `put`, but only the reading thread `take`."""

    def __init__(self, interval_ns: int) -> None:
        self.interval_ns = interval_ns
        self._lock = threading.Lock()
        self._waiting: dict[str, T] = {}
        self._sent: dict[str, int] = {}
        self._woken = False

    def put(self, name: str, value: T) -> bool:
        """Store a value, replacing a waiting value of that name; return True if the reading thread must be woken."""
        with self._lock:
            self._waiting[name] = value
            wake, self._woken = not self._woken, True
            return wake

    def take(self, now: int) -> tuple[dict[str, T], int | None]:
        """Return the values due at `now` in ns, and the time when the next value is due (None if no value waits)."""
        with self._lock:
            ready = {name: value for name, value in self._waiting.items() if self._due_at(name) <= now}
            for name in ready:
                del self._waiting[name]
                self._sent[name] = now
            later = min(map(self._due_at, self._waiting), default=None)
            self._woken = later is not None
            return ready, later

    def forget(self, name: str) -> None:
        """Drop the waiting value of `name`, and the time of the last transfer."""
        with self._lock:
            self._waiting.pop(name, None)
            self._sent.pop(name, None)

    def _due_at(self, name: str) -> int:
        return self._sent[name] + self.interval_ns if name in self._sent else 0


# ROS time that differs from the system time: with `use_sim_time` of the bridge, stamps follow a `/clock` topic.
#
# Messages of the robot are stamped with the ROS time at which they arrived, and keep that stamp; before the first
# message on `/clock` the time is 0. Only the difference between a command's stamp and the present ROS time is used.
# Timeouts are measured by the robot in its own time, so that a stopped `/clock` does not extend them. A simulated robot
# publishes `/clock` itself: with `use_sim_time` of its controller manager, or of the bridge, stamps are simulated time,
# else system time. A command's stamp is interpreted as the closer one of these two times.


_DIGITS: Final = 6  # decimal places of seconds: the resolution of a Unix time in a double


def uses_sim_time(client: RobotClient) -> bool:
    """Whether the robot's controller manager has `use_sim_time` set; False if the request fails."""
    try:
        parameters = client.ask(GetParameters(controller=MANAGER))
    except RemoteError:
        return False
    return any(parameter.name == "use_sim_time" and parameter.value is True for parameter in parameters)


class RosTime:
    """Conversion of time stamps between the robot and ROS.

    `clock` returns the ROS time in s, None if it is the system time; `wall` returns Unix time in s. `state` and `event`
    are for the reactor's thread, `unix` for any thread. `in_simulation` is True if the stamps of a simulated robot are
    simulated time.
    """

    def __init__(self, clock: Callable[[], float | None], wall: Callable[[], float]) -> None:
        self._clock, self._wall = clock, wall
        self._known: dict[str, tuple[float, float]] = {}  # by controller: sample time, in robot and ROS time
        self.in_simulation = False
        self._simulated = False
        self._epoch: float | None = None  # start of the simulation as Unix time in s
        self._reached = 0.0  # simulated time in s

    def state(self, message: StateSample) -> StateSample:
        """Return a state sample with all stamps converted to ROS time."""
        self._simulated = message.sim_time is not None
        self._epoch, self._reached = self._epoch_of(message), message.sim_time or 0.0
        if (epoch := self._epoch) is not None:
            restamped = {
                name: stamped(sample, round(sample.time - epoch, _DIGITS)) for name, sample in message.samples.items()
            }
            return stamped(message, self._reached, samples=restamped)
        now = self._now()
        if now is None:
            return message
        self._known = {name: self._of(name, sample.time, now) for name, sample in message.samples.items()}
        samples = {name: stamped(sample, self._known[name][1]) for name, sample in message.samples.items()}
        return stamped(message, now, samples=samples)

    def event(self, message: RobotEvent) -> RobotEvent:
        """Return an event with the current ROS time as its stamp."""
        now = self._now() if self._epoch is None else self._reached
        return message if now is None else stamped(message, now)

    def unix(self, stamp: float | None) -> float | None:
        """Convert a ROS time stamp to the robot's Unix time in s; None remains None."""
        if stamp is not None and (epoch := self._epoch) is not None:
            wall = self._wall()
            return stamp if abs(stamp - wall) < abs(stamp - (wall - epoch)) else stamp + epoch
        now = self._now()
        return stamp if stamp is None or now is None else self._wall() + stamp - now

    def _now(self) -> float | None:
        return None if self._simulated else self._clock()

    def _epoch_of(self, message: StateSample) -> float | None:
        """Return the start of the simulation as Unix time in s, or None if stamps are not simulated time."""
        return message.sim_epoch if self.in_simulation or self._clock() is not None else None

    def _of(self, name: str, time: float, now: float) -> tuple[float, float]:
        endpoints = self._known.get(name)
        return endpoints if endpoints is not None and endpoints[0] == time else (time, now)


A = TypeVar("A")
_JOIN_S: Final = 1.0
_LOOK_S: Final = 0.02
# Fast DDS: a message is read from the sender's shared memory, which disappears with the sender
_SENT_S: Final = 0.5
_MAX_EVENT_LENGTH: Final = 500  # characters, the limit of the robot's API
_LACKING_NS: Final = 1_000_000_000


class RosSession:
    """Endpoints of one robot; `on_end(why)` is called once, on the reactor's thread, when the robot has ended.

    The endpoints access the session through the context of their node, see `SessionPort`.
    """

    def __init__(
        self,
        node: Node,
        context: Context,
        reactor: Reactor,
        client: RobotClient,
        options: BridgeOptions,
        on_end: Callable[[str], object],
    ) -> None:
        self._options = options
        self.node, self._reactor, self._client, self._on_end = node, reactor, client, on_end
        self.robot = client.robot
        self.controllers: dict[str, ControllerReading] = {}
        self.publishers: dict[str, PublisherWatch] = {}  # key: name of the commanded controller or joint
        self._endpoints: dict[str, list[Endpoint]] = {}
        self._common: list[Endpoint] = []
        self._published: dict[str, str] = {}
        self._lacking: dict[str, bool] = {}  # interfaces that this ROS does not have, and whether that was reported
        self._throttle = Throttle()
        self._rate = options.rate
        self._outpaced: str | None = None
        self._refusals = Refusals()
        self._idle: dict[str, frozenset[str]] = {}  # by controller: joints that did not follow the last command
        self._mailbox: Mailbox[Command] = Mailbox(0)
        self._process_data_watchers: set[object] = set()
        self._ended = False
        self._time = RosTime(partial(ros_seconds, node), time.time)
        self._spinner = Spinner(node, context, self._on_callback_error)
        self._ros = NodeContext(self, node)
        self._nodes = ControllerNodes(self, node, context, self._spinner)
        self._asker = self.connect()

    def _make_common(self, urdf: str, nodes: list[RosNode]) -> None:
        """Create the endpoints that no controller owns; an endpoint that cannot be created is reported and left out."""
        options, ros = self._options, self._ros
        factories: list[Callable[[], Endpoint]] = [
            lambda: RobotDescription(ros, urdf),
            lambda: Diagnostics(ros),
            lambda: Events(ros),
            lambda: Rosout(ros, nodes),
            lambda: SimClock(ros),
            lambda: SimulationServices(ros),
            lambda: LaserScans(ros),
            lambda: GroundTruth(ros),
            lambda: ControllerManagerServices(self._nodes.of(MANAGER)),
            lambda: Activity(self._nodes.of(MANAGER)),
        ]
        if options.tf:
            factories.append(lambda: Frames(ros, urdf))
        if options.cmd_vel_type != "off":
            factories.append(lambda: SharedTwist(ros, options.cmd_vel_topic, options.cmd_vel_type))
        if options.topic_hardware:
            factories.append(lambda: TopicHardware(ros, options.joint_commands_topic, options.joint_states_topic))
        factories += self._of_nodes(nodes) if options.drives else []
        for make in factories:
            try:
                self._common.append(make())
            except MissingInterface as error:
                self.leave_out(error.name)
            except Exception as error:  # noqa: BLE001 - such as a name in bus.yml that ROS refuses
                self._warn(str(error), str(error))

    def _of_nodes(self, nodes: list[RosNode]) -> list[Callable[[], Endpoint]]:
        """Return factories for the topics, services and lifecycle services of the nodes."""
        ros, targets, lifecycles = self._ros, DriveTargets(), list[LifecycleServices]()

        def lifecycle(path: str, node: str | None = None) -> Endpoint:
            lifecycles.append(LifecycleServices(ros, path, node))
            return lifecycles[-1]

        factories: list[Callable[[], Endpoint]] = [lambda: MasterServices(ros)] if nodes else []
        for node in nodes:
            factories.append(partial(DriveTopics, ros, node))
            factories.append(partial(DriveServices, ros, node, targets))
            if node.lifecycle:
                factories.append(partial(lifecycle, node.path(""), node.name))
        if self._options.lifecycle or any(node.lifecycle for node in nodes):
            factories.append(partial(lifecycle, "master"))
            factories.append(lambda: LifecycleServices(ros, "/lifecycle_manager", members=lifecycles))
        return factories

    def open(self) -> None:
        """Create the common endpoints, subscribe to the robot's stream and start the spinner; may raise RemoteError."""
        client, status = self._client, self._client.ask(GetStatus())
        self._mailbox.interval_ns = round(status.cycle.period_s * 1e9)
        self._rate = stream_rate(status.cycle, self._options.rate)
        namespace = str(self.node.get_namespace())
        self._time.in_simulation = uses_sim_time(client)
        nodes = nodes_of(client.ask(GetNodes()), namespace, client.ask(GetLayout()), status.nodes)
        self._make_common(client.ask(GetDescription()).urdf, nodes)
        client.ask(Subscribe(state_rate=self._options.rate or self._rate, events=True))
        self._reactor.add_reader(client.fileno(), self._on_readable)
        self._reactor.call_soon(self._on_readable)  # messages received together with an answer are already buffered
        self._spinner.start()

    def close(self) -> bool:
        """Close all endpoints and connections; return False if a callback of ROS blocks.

        Active goals are aborted first, while the ROS thread still answers requests: a client requests the result of
        its goal after the goal was accepted, and that request may not have been read yet.
        """
        self._reactor.remove_reader(self._client.fileno())
        aborted = [endpoint.abort_goals() for endpoint in self._all()]  # all of them, also after the first with goals
        while any(endpoint.awaits_result_requests() for endpoint in self._all()):
            time.sleep(_LOOK_S)
        if any(aborted):
            time.sleep(_SENT_S)
        self._ended = True
        done = self._spinner.stop(_JOIN_S)
        for name in list(self._endpoints):
            self._forget(name)
        for endpoint in self._common:
            endpoint.close()
        self._nodes.close()
        self._asker.close()
        self._client.close()
        return done

    # ------------------------------------------------------------------------------------------- for endpoints

    def command(self, request: Command) -> None:
        if self._mailbox.put(request.controller, request):
            self._reactor.call_threadsafe(self._deliver)

    def unix(self, stamp: float | None) -> float | None:
        return self._time.unix(stamp)

    def frame(self, name: str) -> str:
        """Return a frame name with the robot's prefix, which is added only once."""
        prefix = self._options.frame_prefix
        has_it = prefix.endswith("/") and name.startswith(prefix)
        return name if has_it or not name else prefix + name

    def leave_out(self, interface: str) -> None:
        """Report once that ROS lacks an interface; interfaces reported within a second share one message."""
        if all(self._lacking.values()):
            self._reactor.call_later(_LACKING_NS, self._report_lacking)
        self._lacking.setdefault(interface, False)

    def _report_lacking(self) -> None:
        new = sorted(name for name, is_reported in self._lacking.items() if not is_reported)
        self._lacking.update(dict.fromkeys(new, True))
        if new:
            self._publish_event(
                f"topics and services of these interfaces are left out, which ROS lacks on this host: {', '.join(new)}"
            )

    def warn_of(self, node: Node, key: str, text: str) -> None:
        """Log a warning as `node`, at most once per second and key; may be called from any thread.

        The warning is also an event of the robot, for its terminal and status, because the user may not read /rosout.
        """
        if self._throttle.allows(key, self._reactor.now()):
            node.get_logger().warning(text)
            self.hand_over(lambda: self._publish_event(text))

    def _publish_event(self, text: str) -> None:
        """Publish a text as an event of the robot; call on the reactor's thread."""
        sentence = "".join(letter if letter.isprintable() else " " for letter in f"ROS: {text}")[:_MAX_EVENT_LENGTH]
        if not self._ended:
            with contextlib.suppress(RemoteError):  # the robot has ended, which is detected elsewhere
                self._client.notify(PublishEvent(kind="ros_warning", text=sentence, level="warning"))

    def _warn(self, key: str, text: str) -> None:
        self.warn_of(self.node, key, text)

    def hand_over(self, function: Callable[[], object]) -> None:
        self._reactor.call_threadsafe(function)

    def watch_process_data(self, watcher: object, on: bool) -> None:
        """Add or remove a watcher of TPDO contents; the robot sends TPDO contents only while a watcher is registered.

        Call on the reactor's thread. When a watcher is added, the robot sends all values once, and the other watchers
        receive them again.
        """
        watchers = self._process_data_watchers
        (watchers.add if on else watchers.discard)(watcher)
        if (on or not watchers) and not self._ended:
            self._client.notify(Subscribe(state_rate=self._rate, events=True, pdos=on))

    def connect(self) -> ReactorClient:
        path = socket_path("robot", self.robot)
        return ReactorClient(ROBOT, path, self._reactor, label=f"robot {self.robot}")

    def call(self, function: Callable[[], object]) -> None:
        """Call a function on ROS's callback thread, or directly after the session has ended."""
        if self._ended:
            function()
        else:
            self._spinner.call(function)

    def ask(self, request: Request[A], answer: Callable[[A | None, str | None], object]) -> None:
        # the robot's own limits (homing_timeout_seconds, transition_timeouts_ms) may be longer than the usual timeout
        self._asker.ask(request, answer, ENDLESS if isinstance(request, AxisRequest) else None)

    # ------------------------------------------------------------------------------------------- robot to ROS

    def _on_readable(self) -> None:
        if self._ended:
            return
        try:
            for message in self._client.messages(0):
                self._on_message(message)
        except UnreadableMessage as error:  # skipped; later messages are still read
            self._warn("message", str(error))
        except RemoteError as error:
            self._end(error)

    def _on_message(self, message: RobotPush) -> None:
        if isinstance(message, StateSample):
            self._follow(message.controllers)
            sample = self._time.state(message)
            for endpoint in self._all():
                self._guarded(endpoint, endpoint.on_state, sample)
        elif isinstance(message, RobotEvent):
            event = self._time.event(message)
            for endpoint in self._all():
                self._guarded(endpoint, endpoint.on_event, event)
        elif isinstance(message, ProcessData):
            for endpoint in self._all():
                self._guarded(endpoint, endpoint.on_process_data, message.nodes)

    def _guarded(self, endpoint: Endpoint, action: Callable[[A], object], message: A) -> None:
        try:
            action(message)
        except Exception as error:  # noqa: BLE001 - other endpoints are not affected
            name = type(endpoint).__name__
            self._warn(name, f"{name}: {type(error).__name__}: {error}")

    def _all(self) -> list[Endpoint]:
        return [*self._common, *(endpoint for group in self._endpoints.values() for endpoint in group)]

    def _follow(self, states: dict[str, str]) -> None:
        """Update the controllers' endpoints after controllers were loaded, switched or unloaded."""
        if states == self._published:
            return
        controllers = {controller.name: controller for controller in self._client.ask(ListControllers())}
        for name in [name for name in self._endpoints if name not in controllers]:
            self._forget(name)
            self._nodes.forget(name)
        for name, controller in controllers.items():
            before = self.controllers.get(name)
            if before is not None and _topics(before) != _topics(controller):
                self._forget(name)
            if name not in self._endpoints:
                self._endpoints[name] = self._endpoints_of(controller)
            for endpoint in self._endpoints[name]:
                endpoint.on_controller(controller)
        # the answer is newer than the sample that caused the request: controllers may have been switched in between
        self.controllers, self._published = (
            controllers,
            {name: controller.state for name, controller in controllers.items()},
        )
        self._report_outpaced()

    def _report_outpaced(self) -> None:
        """Report which controllers publish faster than the state stream, if this has changed."""
        text = outpaced(self.controllers.values(), self._rate)
        if text is not None and text != self._outpaced:
            self.ask(PublishEvent(kind="ros_rate", text=f"ROS: {text}"), lambda _done, _error: None)
        self._outpaced = text

    def _endpoints_of(self, controller: ControllerReading) -> list[Endpoint]:
        try:
            return endpoints_for(self._nodes.of(controller.name, controller.node_options), controller)
        except Exception as error:  # noqa: BLE001 - such as a name in ros2_controllers.yaml that ROS refuses
            reason = str(error).partition("\n")[0].rstrip(":")
            self._warn(controller.name, f"{controller.name} has no topics, because ROS refuses them: {reason}")
            return []

    def _forget(self, name: str) -> None:
        for endpoint in self._endpoints.pop(name):
            endpoint.close()
        self._mailbox.forget(name)

    # ------------------------------------------------------------------------------------------- ROS to robot

    def _deliver(self) -> None:
        if self._ended:
            return
        commands, later = self._mailbox.take(self._reactor.now())
        for controller, request in commands.items():
            self._asker.ask(request, partial(self._on_command_answered, controller))
        if later is not None:
            self._reactor.call_at(later, self._deliver)

    def _on_command_answered(self, controller: str, result: CommandDone | None, error: str | None) -> None:
        sentence = None if self._ended else self._refusals.answered(controller, error)
        if sentence is not None:
            self.node.get_logger().warning(sentence)
        idle = {} if result is None else result.idle
        if not self._ended and idle.keys() - self._idle.get(controller, frozenset()):
            reasons = "; ".join(f"{joint} does not follow: {reason}" for joint, reason in idle.items())
            self.node.get_logger().warning(f"{controller}: {reasons}")
        self._idle[controller] = frozenset(idle)

    def _on_callback_error(self, error: Exception) -> None:
        self._warn("callback", f"a callback failed: {type(error).__name__}: {error}")

    def _end(self, error: RemoteError) -> None:
        if not self._ended:
            self._ended = True
            self._on_end(str(error))


def _topics(controller: ControllerReading) -> tuple[object, ...]:
    """Return the values that determine which endpoints a controller has."""
    return controller.type, controller.topic, controller.publishes
