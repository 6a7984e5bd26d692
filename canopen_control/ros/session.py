"""One robot shown to ROS, from the connection to its API until either is gone.

The law of this file: two threads. The reactor's owns the connection to the robot and publishes what comes over it; the
spinner's takes what ROS sends and hands it over through the mailbox. Whatever is wrong with a message, a topic or a
controller is told and the rest goes on; only the end of the connection ends the session.
"""

from __future__ import annotations

import contextlib
import time
from functools import partial
from typing import TYPE_CHECKING, Final, TypeVar

from canopen_control.client.subscriptions import outpaced, stream_rate
from canopen_control.errors import RemoteError, UnreadableMessage
from canopen_control.host.sockets import socket_path
from canopen_control.ros.activity import Activity
from canopen_control.ros.controller_manager import ControllerManagerServices
from canopen_control.ros.controller_nodes import ControllerNodes
from canopen_control.ros.diagnostics import Diagnostics, Events
from canopen_control.ros.drive_services import DriveServices, MasterServices, Targets
from canopen_control.ros.drive_topics import DriveTopics
from canopen_control.ros.frames import Frames
from canopen_control.ros.ground_truth import GroundTruth
from canopen_control.ros.interfaces import MissingInterface
from canopen_control.ros.laser_scans import LaserScans
from canopen_control.ros.lifecycle_services import Lifecycle
from canopen_control.ros.mailbox import Mailbox
from canopen_control.ros.nodes import NodeView, nodes_of
from canopen_control.ros.on_node import OnNode
from canopen_control.ros.rcl import ros_seconds
from canopen_control.ros.robot_description import RobotDescription
from canopen_control.ros.ros_time import RosTime, wants_sim_time
from canopen_control.ros.rosout import Rosout
from canopen_control.ros.shared_twist import SharedTwist
from canopen_control.ros.sim_clock import SimClock
from canopen_control.ros.simulation_services import SimulationServices
from canopen_control.ros.spinner import Spinner
from canopen_control.ros.table import endpoints_for
from canopen_control.ros.throttle import Refusals, Throttle
from canopen_control.ros.topic_hardware import TopicHardware
from canopen_control.rpc.messages.parameters import MANAGER
from canopen_control.rpc.messages.robot import (
    ROBOT,
    GetDescription,
    GetLayout,
    GetNodes,
    GetStatus,
    ListControllers,
    ProcessData,
    Subscribe,
    Tell,
)
from canopen_control.rpc.messages.state import RobotEvent, StateSample
from canopen_control.rpc.reactor_client import ReactorClient

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.client import RobotClient
    from canopen_control.host.reactor import Reactor
    from canopen_control.ros.bridge_options import Options
    from canopen_control.ros.endpoint import Endpoint
    from canopen_control.ros.rcl import Context, Node
    from canopen_control.rpc.messages.declare import Request
    from canopen_control.rpc.messages.robot import CommandController, RobotPush, TwistController
    from canopen_control.rpc.messages.state import ControllerReading

    Command = CommandController | TwistController

__all__ = ["Session"]

A = TypeVar("A")
_JOIN_S: Final = 1.0
_LONGEST_TOLD: Final = 500  # characters, as the robot takes them
_LACKING_NS: Final = 1_000_000_000


class Session:
    """Topics of one robot; `on_end(why)` is called once, on the loop, when the robot is gone.

    Its endpoints know it through the node that each is on, see `on_node`.
    """

    def __init__(
        self,
        node: Node,
        context: Context,
        reactor: Reactor,
        client: RobotClient,
        options: Options,
        on_end: Callable[[str], object],
    ) -> None:
        self._options = options
        self.node, self._reactor, self._client, self._on_end = node, reactor, client, on_end
        self.robot = client.robot
        self.controllers: dict[str, ControllerReading] = {}
        self._endpoints: dict[str, list[Endpoint]] = {}
        self._common: list[Endpoint] = []
        self._told: dict[str, str] = {}
        self._lacking: dict[str, bool] = {}  # interfaces that this ROS does not have, and whether that was told
        self._throttle = Throttle()
        self._rate = options.rate
        self._outpaced: str | None = None
        self._refusals = Refusals()
        self._mailbox: Mailbox[Command] = Mailbox(0)
        self._process_data_watchers: set[object] = set()
        self._ended = False
        self._time = RosTime(partial(ros_seconds, node), time.time)
        self._spinner = Spinner(node, context, self._on_callback_error)
        self._ros = OnNode(self, node)
        self._nodes = ControllerNodes(self, node, context, self._spinner)
        self._asker = self.connect()

    def _make_common(self, urdf: str, nodes: list[NodeView]) -> None:
        """Make the topics of the robot as a whole; what cannot be made is told, the others are there."""
        options, ros = self._options, self._ros
        wanted: list[Callable[[], Endpoint]] = [
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
            wanted.append(lambda: Frames(ros, urdf))
        if options.cmd_vel_type != "off":
            wanted.append(lambda: SharedTwist(ros, options.cmd_vel_topic, options.cmd_vel_type))
        if options.topic_hardware:
            wanted.append(lambda: TopicHardware(ros, options.joint_commands_topic, options.joint_states_topic))
        wanted += self._of_nodes(nodes) if options.drives else []
        for make in wanted:
            try:
                self._common.append(make())
            except MissingInterface as error:
                self.leave_out(error.name)
            except Exception as error:  # noqa: BLE001 - a name of bus.yml that ROS refuses, an interface it lacks
                self._warn(str(error), str(error))

    def _of_nodes(self, nodes: list[NodeView]) -> list[Callable[[], Endpoint]]:
        """Return what each node has, stop verbs and all."""
        ros, targets, lifecycles = self._ros, Targets(), list[Lifecycle]()

        def lifecycle(path: str, node: str | None = None) -> Endpoint:
            lifecycles.append(Lifecycle(ros, path, node))
            return lifecycles[-1]

        wanted: list[Callable[[], Endpoint]] = [lambda: MasterServices(ros)] if nodes else []
        for node in nodes:
            wanted.append(partial(DriveTopics, ros, node))
            wanted.append(partial(DriveServices, ros, node, targets))
            if node.lifecycle:
                wanted.append(partial(lifecycle, node.path(""), node.name))
        if self._options.lifecycle or any(node.lifecycle for node in nodes):
            wanted.append(partial(lifecycle, "master"))
            wanted.append(lambda: Lifecycle(ros, "/lifecycle_manager", members=lifecycles))
        return wanted

    def open(self) -> None:
        """Subscribe on both sides and begin; raises RemoteError."""
        client, status = self._client, self._client.ask(GetStatus())
        self._mailbox.interval_ns = round(status.cycle.period_s * 1e9)
        self._rate = stream_rate(status.cycle, self._options.rate)
        namespace = str(self.node.get_namespace())
        self._time.in_simulation = wants_sim_time(client)
        nodes = nodes_of(client.ask(GetNodes()), namespace, client.ask(GetLayout()), status.nodes)
        self._make_common(client.ask(GetDescription()).urdf, nodes)
        client.ask(Subscribe(state_rate=self._options.rate or self._rate, events=True))
        self._reactor.add_reader(client.fileno(), self._on_readable)
        self._reactor.call_soon(self._on_readable)  # what came together with an answer makes no descriptor readable
        self._spinner.start()

    def close(self) -> bool:
        """Leave both sides; False when a callback of ROS hangs. A second call does nothing."""
        self._ended = True
        self._reactor.remove_reader(self._client.fileno())
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
        """Send the newest command of a controller, at most one per cycle; from any thread."""
        if self._mailbox.put(request.controller, request):
            self._reactor.call_threadsafe(self._deliver)

    def unix(self, stamp: float | None) -> float | None:
        """Return a stamp of ROS in Unix seconds, the robot's time; from any thread."""
        return self._time.unix(stamp)

    def frame(self, name: str) -> str:
        """Return a frame with the prefix of the robot's frames, which one that has it already gets no second time."""
        prefix = self._options.frame_prefix
        has_it = prefix.endswith("/") and name.startswith(prefix)
        return name if has_it or not name else prefix + name

    def leave_out(self, interface: str) -> None:
        """Tell the run what this ROS does not have, all that comes up within a second in one sentence."""
        if all(self._lacking.values()):
            self._reactor.call_later(_LACKING_NS, self._tell_lacking)
        self._lacking.setdefault(interface, False)

    def _tell_lacking(self) -> None:
        new = sorted(name for name, told in self._lacking.items() if not told)
        self._lacking.update(dict.fromkeys(new, True))
        if new:
            self._tell_robot(
                f"what needs these is left out, which the packages of this host do not have: {', '.join(new)}"
            )

    def warn_of(self, node: Node, key: str, text: str) -> None:
        """Tell the user as a node, each key once per second at most; from any thread.

        Whoever runs the robot may not look at /rosout: its terminal and its status say it too.
        """
        if self._throttle.allows(key, self._reactor.now()):
            node.get_logger().warning(text)
            self.hand_over(lambda: self._tell_robot(text))

    def _tell_robot(self, text: str) -> None:
        """Have the robot tell a sentence as an event; on the reactor's thread."""
        told = "".join(letter if letter.isprintable() else " " for letter in f"ROS: {text}")[:_LONGEST_TOLD]
        if not self._ended:
            with contextlib.suppress(RemoteError):  # a robot that is gone tells nothing; its end is seen elsewhere
                self._client.notify(Tell(kind="ros_warning", text=told, level="warning"))

    def _warn(self, key: str, text: str) -> None:
        self.warn_of(self.node, key, text)

    def hand_over(self, function: Callable[[], object]) -> None:
        """Have a function called on the reactor's thread; from any thread."""
        self._reactor.call_threadsafe(function)

    def watch_process_data(self, watcher: object, wanted: bool) -> None:
        """Have the robot tell what its TPDOs carry while anybody wants it; on the reactor's thread.

        Whoever begins to want it has everything told that has come, which the others then get once more.
        """
        watchers = self._process_data_watchers
        (watchers.add if wanted else watchers.discard)(watcher)
        if (wanted or not watchers) and not self._ended:
            self._client.notify(Subscribe(state_rate=self._rate, events=True, pdos=wanted))

    def connect(self) -> ReactorClient:
        """Return a connection to the robot of its own, for what ends with it; RemoteError if the robot is gone."""
        path = socket_path("robot", self.robot)
        return ReactorClient(ROBOT, path, self._reactor, label=f"robot {self.robot}")

    def call(self, function: Callable[[], object]) -> None:
        """Have a function called in the thread of ROS's callbacks; in this one when that has ended."""
        if self._ended:
            function()
        else:
            self._spinner.call(function)

    def ask(self, request: Request[A], answer: Callable[[A | None, str | None], object]) -> None:
        """Ask the robot, and have `answer(result, error)` called; both on the reactor's thread."""
        self._asker.ask(request, answer)

    # ------------------------------------------------------------------------------------------- robot to ROS

    def _on_readable(self) -> None:
        if self._ended:
            return
        try:
            for message in self._client.messages(0):
                self._on_message(message)
        except UnreadableMessage as error:  # the next sample is read when it comes
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
        except Exception as error:  # noqa: BLE001 - one topic's trouble is not the others'
            name = type(endpoint).__name__
            self._warn(name, f"{name}: {type(error).__name__}: {error}")

    def _all(self) -> list[Endpoint]:
        return [*self._common, *(endpoint for group in self._endpoints.values() for endpoint in group)]

    def _follow(self, told: dict[str, str]) -> None:
        """Make and remove topics when a controller was loaded, switched or unloaded."""
        if told == self._told:
            return
        controllers = {each.name: each for each in self._client.ask(ListControllers())}
        for name in [name for name in self._endpoints if name not in controllers]:
            self._forget(name)
            self._nodes.forget(name)
        for name, controller in controllers.items():
            before = self.controllers.get(name)
            if before is not None and _topics(before) != _topics(controller):
                self._forget(name)
            if name not in self._endpoints:
                self._endpoints[name] = self._made(controller)
            for endpoint in self._endpoints[name]:
                endpoint.on_controller(controller)
        # what the answer says, which is newer than the sample that made us ask: they may have been switched in between
        self.controllers, self._told = controllers, {name: each.state for name, each in controllers.items()}
        self._tell_outpaced()

    def _tell_outpaced(self) -> None:
        """Tell once who publishes more often than ROS is given it."""
        text = outpaced(self.controllers.values(), self._rate)
        if text is not None and text != self._outpaced:
            self.ask(Tell(kind="ros_rate", text=f"ROS: {text}"), lambda _done, _error: None)
        self._outpaced = text

    def _made(self, controller: ControllerReading) -> list[Endpoint]:
        try:
            return endpoints_for(self._nodes.of(controller.name, controller.node_options), controller)
        except Exception as error:  # noqa: BLE001 - a name of ros2_controllers.yaml that ROS refuses
            reason = str(error).partition("\n")[0].rstrip(":")
            self._warn(controller.name, f"{controller.name} has no topics, ROS refuses them: {reason}")
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

    def _on_command_answered(self, controller: str, _result: object, error: str | None) -> None:
        said = None if self._ended else self._refusals.answered(controller, error)
        if said is not None:
            self.node.get_logger().warning(said)

    def _on_callback_error(self, error: Exception) -> None:
        self._warn("callback", f"a callback failed: {type(error).__name__}: {error}")

    def _end(self, error: RemoteError) -> None:
        if not self._ended:
            self._ended = True
            self._on_end(str(error))


def _topics(controller: ControllerReading) -> tuple[object, ...]:
    """Return what its topics follow from."""
    return controller.type, controller.topic, controller.publishes
