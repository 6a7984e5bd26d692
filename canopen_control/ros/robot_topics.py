"""Topics and services of a robot as a whole: diagnostics, events, description, controllers, simulation, all joints.

`/diagnostics` is published once per second, and at once when a level changes; its name is absolute, and it has one
status per node, per controller, per status of a diagnostics broadcaster, and for the cycle. Events are
rcl_interfaces/msg/Log, the message of `/rosout`, with the name of the node or the robot; they include the EMCY messages
of the drives.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseStamped
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from canopen_control.ros.conversions import joint_arrays
from canopen_control.ros.diagnosis import Diagnosis, diagnose
from canopen_control.ros.endpoint import COMMANDER, Endpoint
from canopen_control.ros.interfaces import interface
from canopen_control.ros.manager_services import STATES
from canopen_control.ros.nodes import ros_name
from canopen_control.ros.rcl import EVENTS, LATCHED, LATEST, ROSOUT, SYSTEM_DEFAULT
from canopen_control.ros.sample_publisher import time_message
from canopen_control.rpc.messages.robot import CommandController, ListHardware
from canopen_control.rpc.messages.samples import OdometrySample
from canopen_control.rpc.messages.simulation import (
    MAX_STEPS,
    GetLaserScans,
    PauseSimulation,
    ResetSimulation,
    StepSimulation,
)
from canopen_control.urdf.geometry import from_rpy

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from canopen_control.ros.endpoint import Handler, NodeContext, Reply, RosMessage
    from canopen_control.ros.nodes import RosNode
    from canopen_control.rpc.messages.declare import Request
    from canopen_control.rpc.messages.robot import HardwareReading
    from canopen_control.rpc.messages.simulation import LaserScanReading, Simulation
    from canopen_control.rpc.messages.state import RobotEvent, StateSample, TruePose

    States = dict[str, str]


_PERIOD_S: Final = 1.0  # of `/diagnostics`, and of requests for hardware states, which may change without an event
_LEVELS: Final = {"debug": 10, "info": 20, "warning": 30, "error": 40, "fatal": 50}  # of rcl_interfaces/msg/Log


class Diagnostics(Endpoint):
    """Publisher of `/diagnostics`, once per second and when a level changes."""

    def __init__(self, ros: NodeContext) -> None:
        super().__init__(ros)
        self._publisher = self.publisher(DiagnosticArray, "/diagnostics", EVENTS)
        self._next, self._missed = 0.0, 0
        self._levels: dict[str, int] = {}

    def on_state(self, state: StateSample) -> None:
        diagnoses = diagnose(self._ros.robot, state, self._ros.controllers, self._missed)
        levels = {diagnosis.name: int(diagnosis.level) for diagnosis in diagnoses}
        time = state.time
        # publishing continues after the clock was set back
        if levels == self._levels and time < self._next <= time + _PERIOD_S:
            return
        self._next, self._levels = time + _PERIOD_S, levels
        self._missed = state.cycle.missed
        message = DiagnosticArray(status=[_status(diagnosis) for diagnosis in diagnoses])
        message.header.stamp = time_message(time)
        self._publisher.publish(message)


class Events(Endpoint):
    """Publisher of the robot's events on `~/events`."""

    def __init__(self, ros: NodeContext) -> None:
        super().__init__(ros)
        self._log = interface("rcl_interfaces/msg/Log")
        self._publisher = self.publisher(self._log, "~/events", EVENTS)

    def on_event(self, event: RobotEvent) -> None:
        self._publisher.publish(log_message(self._log, event, self._ros.robot))


def log_message(log: Any, event: RobotEvent, robot: str) -> Any:  # noqa: ANN401 - a generated class
    """Convert an API event to a message of the class `log`, which is rcl_interfaces/msg/Log."""
    message = log()
    message.stamp = time_message(event.time)
    message.level = _LEVELS.get(event.level, _LEVELS["info"])
    message.name = event.node or robot
    message.msg, message.function = event.text, event.kind
    return message


def _status(diagnosis: Diagnosis) -> DiagnosticStatus:
    return DiagnosticStatus(
        level=bytes([diagnosis.level]),
        name=diagnosis.name,
        message=diagnosis.message,
        hardware_id=diagnosis.hardware_id,
        values=[KeyValue(key=key, value=value) for key, value in diagnosis.values.items()],
    )


# `/rosout`: the events of a robot with their severity and the name of the node that they concern, for rqt_console.
#
# Rules (rcl): the name of a message is the logger name of its node, `NAMESPACE.NODE`; the quality of service is the
# same as for the log of every ROS node. The name is the node of the drive, the controller, or for the robot itself the
# bridge. The robot reports repeated events once, and then as a summary; an event that only repeats the reason of the
# previous event of the same node is omitted here, unless it is more severe. The bridge does not print these events to
# its standard error, because the robot's log contains them.


_SAME_S: Final = 1.0  # within this time an event may be a consequence of the previous one


class _Cause(NamedTuple):
    """Last published event of a node: time, level, and text without the node's name."""

    time: float
    level: int
    text: str


class Rosout(Endpoint):
    """Publisher of `/rosout`; `nodes` are the nodes of the bus, with their namespaces."""

    def __init__(self, ros: NodeContext, nodes: Iterable[RosNode]) -> None:
        super().__init__(ros)
        self._log = interface("rcl_interfaces/msg/Log")
        self._namespace = str(ros.node.get_namespace())
        self._of_nodes = {node.name: _logger(node.namespace, ros_name(node.name)) for node in nodes}
        self._own = _logger(self._namespace, str(ros.node.get_name()))
        self._publisher = self.publisher(self._log, "/rosout", ROSOUT)
        self._causes: dict[str, _Cause] = {}

    def on_event(self, event: RobotEvent) -> None:
        message = log_message(self._log, event, self._ros.robot)
        if event.controller is not None:
            message.name = _logger(self._namespace, event.controller)
        elif event.node is not None:
            message.name = self._of_nodes.get(event.node) or _logger(self._namespace, ros_name(event.node))
        else:
            message.name = self._own
        if not self._repeats_cause(event, message.name, int(message.level)):
            self._publisher.publish(message)

    def _repeats_cause(self, event: RobotEvent, name: str, level: int) -> bool:
        """Whether an event only repeats the cause of the node's previous event; if not, record it as that event."""
        last = self._causes.get(name)
        same = last is not None and abs(event.time - last.time) <= _SAME_S and level <= last.level
        if last is not None and same and event.kind != "stop" and event.text.endswith(last.text):
            return True
        self._causes[name] = _Cause(event.time, level, event.text.partition(": ")[2] or event.text)
        return False


def _logger(namespace: str, node: str) -> str:
    """Return the name of a node's logger: namespace and node, separated by dots."""
    return ".".join([*namespace.strip("/").split("/"), node]).lstrip(".")


# `/controller_manager/activity`: the lifecycle states of controllers and hardware components, after every change.
#
# Rules (controller_manager, Jazzy): reliable and transient local with a depth of one, so that later subscribers get the
# present states at once. The state stream contains the states of the controllers; the states of the hardware are
# requested after an event, one request at a time.


class Activity(Endpoint):
    """Publisher of `controller_manager/activity`, relative to the namespace."""

    def __init__(self, ros: NodeContext) -> None:
        super().__init__(ros)
        self._message = interface("controller_manager_msgs/msg/ControllerManagerActivity")
        self._named = interface("controller_manager_msgs/msg/NamedLifecycleState")
        self._state = interface("lifecycle_msgs/msg/State")
        self._publisher = self.publisher(self._message, "controller_manager/activity", LATCHED)
        self._controllers: States = {}
        self._published: tuple[States, States] | None = None
        self._is_waiting, self._changed = False, True
        self._next = self._time = 0.0

    def on_event(self, event: RobotEvent) -> None:
        """Request the hardware states again with the next sample, since an event may change them."""
        del event
        self._changed = True

    def on_state(self, state: StateSample) -> None:
        self._time = state.time
        controllers = dict(state.controllers)
        # requests continue after the clock was set back
        idle = (
            controllers == self._controllers and not self._changed and self._time < self._next <= self._time + _PERIOD_S
        )
        if self._is_waiting or idle:
            return
        self._controllers, self._next = controllers, self._time + _PERIOD_S
        self._is_waiting, self._changed = True, False
        self._ros.ask(ListHardware(), self._on_hardware)

    def _on_hardware(self, answer: list[HardwareReading] | None, error: str | None) -> None:
        self._is_waiting = False
        hardware = {component.name: component.state for component in answer or ()}
        if error is not None:
            self._ros.warn("activity", f"controller_manager/activity: {error}")
        elif (self._controllers, hardware) != self._published:
            self._published = (self._controllers, hardware)
            self._publish(*self._published)

    def _publish(self, controllers: States, hardware: States) -> None:
        message = self._message(
            controllers=self._lifecycles(controllers), hardware_components=self._lifecycles(hardware)
        )
        message.header.stamp = time_message(self._time)
        self._publisher.publish(message)

    def _lifecycles(self, states: States) -> list[Any]:
        return [
            self._named(name=name, state=self._state(id=STATES.get(label, 0), label=label))
            for name, label in states.items()
        ]


# `/robot_description` as in robot_state_publisher: the URDF, transient local for later subscribers.


class RobotDescription(Endpoint):
    """Publisher of the URDF on `robot_description`; it publishes once at the start, latched."""

    def __init__(self, ros: NodeContext, urdf: str) -> None:
        super().__init__(ros)
        self.publisher(String, "robot_description", LATCHED).publish(String(data=urdf))


# `/clock` of a simulated robot, for programs with `use_sim_time`.
#
# Published only if the robot reports simulated time; for a real robot there is not even a publisher of `/clock`,
# because programs with simulated time would wait for its messages.


class SimClock(Endpoint):
    """Publisher of `/clock`, created with the first state sample that has simulated time."""

    def __init__(self, ros: NodeContext) -> None:
        super().__init__(ros)
        self._publisher: RosMessage = None

    def on_state(self, state: StateSample) -> None:
        seconds = state.sim_time
        if seconds is None:
            return
        if self._publisher is None:
            self._publisher = self.publisher(Clock, "/clock", SYSTEM_DEFAULT)
        self._publisher.publish(Clock(clock=time_message(seconds)))


# Counterpart of joint_state_topic_hardware_interface: C++ controllers of another controller manager move our joints.
#
# Rules (joint_state_topic_hardware_interface 1.1): JointState in both directions. A message commands an active forward
# controller if it has a finite value for every joint of the controller in the array of the controller's interface; a
# NaN, which that package sends before one of its controllers is active, commands nothing. An array that is neither
# empty nor as long as `name` cannot be assigned to joints, and the whole message is refused. Without messages the
# controller's own timeout ends the command, so `trigger_joint_command_threshold` must be -1: otherwise that package
# sends nothing while the command does not change.


_INTERFACES: Final = ("position", "velocity", "effort")


class TopicHardware(Endpoint):
    """Topics for joint_state_topic_hardware_interface, with commands for the robot's joints and their states."""

    def __init__(self, ros: NodeContext, commands: str, states: str) -> None:
        super().__init__(ros)
        self._topic = commands
        self.subscribe(JointState, commands, self._on_message, LATEST)
        self._publisher = self.publisher(JointState, states, LATEST)
        self._message = JointState()

    def on_state(self, state: StateSample) -> None:
        """Publish the states of all joints; joint_state_topic_hardware_interface ignores nan."""
        message = self._message
        message.header.stamp = time_message(state.time)
        message.name, message.position, message.velocity, message.effort = joint_arrays(state.joints)
        self._publisher.publish(message)

    def _on_message(self, message: JointState) -> None:
        arrays = {name: list(getattr(message, name)) for name in _INTERFACES}
        try:
            values = commanded(list(message.name), arrays)
        except ValueError as error:
            self.report(self._topic, f"{error}; the message was dropped")
            return
        for controller in self._ros.controllers.values():
            if not controller.active or controller.topic != "commands" or controller.interface is None:
                continue
            positions = [values.get((joint, controller.interface)) for joint in controller.joints]
            command = [value for value in positions if value is not None]
            if len(command) == len(positions):
                self._ros.command(
                    CommandController(controller=controller.name, values=command, source=COMMANDER, dead_man=True)
                )


def commanded(names: list[str], arrays: dict[str, list[float]]) -> dict[tuple[str, str], float]:
    """Return the finite commands by joint and interface.

    Raise ValueError if the arrays cannot be assigned to joints.
    """
    if len(set(names)) != len(names):
        raise ValueError("a joint is named twice")
    values = {}
    for quantity, array in arrays.items():
        if len(array) not in (0, len(names)):
            raise ValueError(f"{quantity} has {len(array)} values for {len(names)} joints")
        pairs = zip(names, array, strict=False)
        values.update({(name, quantity): value for name, value in pairs if math.isfinite(value)})
    return values


# LaserScan of the lidars of a simulated robot, on the topics given in their tags (`/scan`), as in mujoco_ros2_control.
#
# Rays are cast on request, at the lidar's rate in simulated time; a robot without a lidar gets only one request.
# Nothing is published while the simulation is paused.


_CLOSE_S: Final = 1e-6


class LaserScans(Endpoint):
    """Publishers of laser scans, created with the first scan for their topic."""

    def __init__(self, ros: NodeContext) -> None:
        super().__init__(ros)
        self._publishers: dict[str, RosMessage] = {}
        self._is_waiting = self._has_no_lidar = False
        self._next_scan = 0.0  # simulated seconds of the next scan

    def on_state(self, state: StateSample) -> None:
        seconds = state.sim_time
        if seconds is None or state.sim_epoch is None or self._is_waiting or self._has_no_lidar:
            return
        if seconds < self._next_scan - _CLOSE_S:
            return
        self._is_waiting = True
        offset = state.time - seconds  # of ROS time from simulated time

        def answer(scans: tuple[LaserScanReading, ...] | None, error: str | None) -> None:
            self._is_waiting, self._has_no_lidar = False, error is None and not scans
            for scan in scans or ():
                self._publish(scan, offset)
            if scans:
                period = min(scan.scan_time for scan in scans)
                next_scan = self._next_scan + period  # periodic, unless the requests have fallen behind
                self._next_scan = next_scan if next_scan > seconds else seconds + period
            else:
                self._next_scan = seconds + 1.0

        self._ros.ask(GetLaserScans(), answer)

    def _publish(self, scan: LaserScanReading, offset: float) -> None:
        if scan.topic not in self._publishers:
            self._publishers[scan.topic] = self.publisher(
                interface("sensor_msgs/msg/LaserScan"), scan.topic, SYSTEM_DEFAULT
            )
        message = interface("sensor_msgs/msg/LaserScan")()
        message.header.stamp = time_message(scan.seconds + offset)
        message.header.frame_id = self._ros.frame(scan.frame_id)
        for field in ("angle_min", "angle_max", "angle_increment", "range_min", "range_max", "scan_time"):
            setattr(message, field, getattr(scan, field))
        message.ranges = scan.ranges
        self._publishers[scan.topic].publish(message)


# `ground_truth`: the true pose of the base of a simulated robot, in the odometry frame (PoseStamped).
#
# Every new true pose is published with its stamp, once a base controller has reported the name of its odometry frame,
# so that RViz shows the pose in the same fixed frame as `odom`; a robot without a known true pose has no such
# publisher. The pose is not a transform, because a frame has one parent, and the parent of the base is the odometry
# frame.


class GroundTruth(Endpoint):
    """Publisher of `ground_truth`, created with the first true pose that is known in the odometry frame."""

    def __init__(self, ros: NodeContext) -> None:
        super().__init__(ros)
        self._publisher: RosMessage = None
        self._frame, self._last = "", 0.0

    def on_state(self, state: StateSample) -> None:
        for sample in state.samples_of(OdometrySample).values():
            self._frame = sample.frame_id
        truth = state.true_pose
        if truth is None or truth.odom is None or not self._frame or truth.time == self._last:
            return
        if self._publisher is None:
            self._publisher = self.publisher(PoseStamped, "ground_truth", SYSTEM_DEFAULT)
        self._last = truth.time
        self._publisher.publish(pose_message(truth, self._ros.frame(self._frame)))


def pose_message(truth: TruePose, frame: str) -> PoseStamped:
    """Return a true pose as a PoseStamped message in the odometry frame `frame`."""
    message = PoseStamped()
    message.header.stamp, message.header.frame_id = time_message(truth.time), frame
    position, orientation = message.pose.position, message.pose.orientation
    position.x, position.y, _ = truth.in_odometry or (0.0, 0.0, 0.0)
    position.z = truth.z
    orientation.w, orientation.x, orientation.y, orientation.z = from_rpy(truth.rpy or (0.0, 0.0, 0.0))
    return message


# `~/set_pause`, `~/step_simulation` and `~/reset_world` of a simulated robot, as in mujoco_ros2_control.
#
# Names and types are the same as upstream (mujoco_ros2_control_msgs), below the node that runs the controllers there,
# `ros2_control_node`, and below the plugin's own node, `mujoco_ros2_control_node`. A step is a cycle of the robot here,
# in which controllers and hardware run once; upstream it is a physics step. The services exist once the robot reports
# simulated time; a real robot has none of them.


_NODES: Final = ("ros2_control_node", "mujoco_ros2_control_node")
_SERVICES: Final[dict[str, tuple[str, Callable[[RosMessage], Request[Simulation]]]]] = {
    "set_pause": ("SetPause", lambda request: PauseSimulation(paused=request.paused)),
    "step_simulation": ("StepSimulation", lambda request: StepSimulation(steps=request.steps)),
    "reset_world": ("ResetWorld", lambda request: ResetSimulation(keyframe=request.keyframe)),
}
"""Type of each service, and the function that makes its request to the robot."""


class SimulationServices(Endpoint):
    """Services that control a simulation, created with the first state sample that has simulated time."""

    def __init__(self, ros: NodeContext) -> None:
        super().__init__(ros)
        self._has_services = False

    def on_state(self, state: StateSample) -> None:
        if self._has_services or state.sim_epoch is None:
            return
        self._has_services = True
        for name, (kind, make_request) in _SERVICES.items():
            for node in _NODES:
                self.serve(f"mujoco_ros2_control_msgs/srv/{kind}", f"{node}/{name}", self._handler(make_request))

    def _handler(self, make_request: Callable[[RosMessage], Request[Simulation]]) -> Handler:
        def handler(request: RosMessage, response: RosMessage, reply: Reply) -> None:
            def answer(done: Simulation | None, error: str | None) -> None:
                response.success, response.message = error is None, error or _text(done)
                reply(response)

            if getattr(request, "steps", 1) not in range(1, MAX_STEPS + 1):
                answer(None, f"steps is {request.steps}; give a number of cycles from 1 to {MAX_STEPS}")
            else:
                self._ros.ask(make_request(request), answer)

        return handler


def _text(simulation: Simulation | None) -> str:
    if simulation is None:
        return ""
    mode = "paused" if simulation.paused else "running"
    return f"{mode} at {simulation.seconds:.6g} s; a step is a cycle of {1000.0 * simulation.period:g} ms"
