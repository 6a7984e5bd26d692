"""Topics and services of a simulated robot, and joint topics for another controller manager."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final

from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import JointState

from canopen_control.ros.conversions import joint_arrays
from canopen_control.ros.endpoint import COMMANDER, Endpoint
from canopen_control.ros.interfaces import interface
from canopen_control.ros.rcl import LATEST, SYSTEM_DEFAULT
from canopen_control.ros.sample_publisher import time_message
from canopen_control.rpc.messages.robot import CommandController
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
    from collections.abc import Callable

    from canopen_control.ros.endpoint import Handler, NodeContext, Reply, RosMessage
    from canopen_control.rpc.messages.declare import Request
    from canopen_control.rpc.messages.simulation import LaserScanReading, Simulation
    from canopen_control.rpc.messages.state import StateSample, TruePose


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
        self._ros, self._topic = ros, commands
        self._subscription = ros.subscribe(JointState, commands, self._on_message, LATEST)
        self._publisher = ros.node.create_publisher(JointState, states, LATEST)
        self._message = JointState()

    def on_state(self, state: StateSample) -> None:
        """Publish the states of all joints; joint_state_topic_hardware_interface ignores nan."""
        message = self._message
        message.header.stamp = time_message(state.time)
        message.name, message.position, message.velocity, message.effort = joint_arrays(state.joints)
        self._publisher.publish(message)

    def close(self) -> None:
        self._ros.unsubscribe(self._subscription)
        self._ros.node.destroy_publisher(self._publisher)

    def _on_message(self, message: JointState) -> None:
        arrays = {name: list(getattr(message, name)) for name in _INTERFACES}
        try:
            values = commanded(list(message.name), arrays)
        except ValueError as error:
            self._ros.warn(self._topic, f"{self._topic}: {error}; the message was dropped")
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
        self._ros = ros
        self._publishers: dict[str, Any] = {}  # rclpy has no types
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
            kind = interface("sensor_msgs/msg/LaserScan")
            self._publishers[scan.topic] = self._ros.node.create_publisher(kind, scan.topic, SYSTEM_DEFAULT)
        message = interface("sensor_msgs/msg/LaserScan")()
        message.header.stamp = time_message(scan.seconds + offset)
        message.header.frame_id = self._ros.frame(scan.frame_id)
        for field in ("angle_min", "angle_max", "angle_increment", "range_min", "range_max", "scan_time"):
            setattr(message, field, getattr(scan, field))
        message.ranges = scan.ranges
        self._publishers[scan.topic].publish(message)

    def close(self) -> None:
        for publisher in self._publishers.values():
            self._ros.node.destroy_publisher(publisher)


# `ground_truth`: the true pose of the base of a simulated robot, in the odometry frame (PoseStamped).
#
# Every new true pose is published with its stamp, once a base controller has reported the name of its odometry frame,
# so that RViz shows the pose in the same fixed frame as `odom`; a robot without a known true pose has no such
# publisher. The pose is not a transform, because a frame has one parent, and the parent of the base is the odometry
# frame.


class GroundTruth(Endpoint):
    """Publisher of `ground_truth`, created with the first true pose that is known in the odometry frame."""

    def __init__(self, ros: NodeContext) -> None:
        self._ros = ros
        self._publisher: Any = None  # rclpy has no types
        self._frame, self._last = "", 0.0

    def on_state(self, state: StateSample) -> None:
        for sample in state.samples_of(OdometrySample).values():
            self._frame = sample.frame_id
        truth = state.true_pose
        if truth is None or truth.odom is None or not self._frame or truth.time == self._last:
            return
        if self._publisher is None:
            self._publisher = self._ros.node.create_publisher(PoseStamped, "ground_truth", SYSTEM_DEFAULT)
        self._last = truth.time
        self._publisher.publish(pose_message(truth, self._ros.frame(self._frame)))

    def close(self) -> None:
        if self._publisher is not None:
            self._ros.node.destroy_publisher(self._publisher)


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
        self._ros = ros
        self._services: list[object] = []

    def on_state(self, state: StateSample) -> None:
        if self._services or state.sim_epoch is None:
            return
        for name, (kind, make_request) in _SERVICES.items():
            service = f"mujoco_ros2_control_msgs/srv/{kind}"
            self._services += [
                self._ros.serve(service, f"{node}/{name}", self._handler(make_request)) for node in _NODES
            ]

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

    def close(self) -> None:
        for service in self._services:
            self._ros.unserve(service)


def _text(simulation: Simulation | None) -> str:
    if simulation is None:
        return ""
    mode = "paused" if simulation.paused else "running"
    return f"{mode} at {simulation.seconds:.6g} s; a step is a cycle of {1000.0 * simulation.period:g} ms"
