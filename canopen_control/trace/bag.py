"""A ROS 2 bag of a run, made of the runtime's state stream without any ROS: MCAP, the types of Jazzy.

The law of this file: the topics that the ROS bridge publishes, under the same names and with the same stamps, so that
rqt, Foxglove, PlotJuggler and `ros2 bag` find what they know:

    /joint_states                    sensor_msgs/JointState         every update of a broadcaster, on its topic
    /tf, /tf_static                  tf2_msgs/TFMessage             joints of the description, odometry
    /CONTROLLER/odom                 nav_msgs/Odometry              as often as the controller publishes
    /ground_truth                    geometry_msgs/PoseStamped      the true pose of a simulated base, seen by odometry
    /CONTROLLER/cmd_vel_out          geometry_msgs/TwistStamped     the twist that its limits left of a command
    /CONTROLLER/commands_out         std_msgs/Float64MultiArray     what a forward controller writes, when it changes
    /CONTROLLER/controller_state     control_msgs/...               every update: trajectory, PID, steering, mecanum
    /CONTROLLER/imu, range, wrench, pose, battery_state, gpio_states    every update of a broadcaster (`bag_sensors`)
    /diagnostics                     diagnostic_msgs/DiagnosticArray   once a second
    /rosout                          rcl_interfaces/Log             the robot's events
    /robot_description               std_msgs/String                once

Commands have a name that nobody listens to: a bag that is played must not move the robot. SI units; what is not known
is nan. With `bag_messages` this is the only module that imports rosbags.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final, TypeVar

from canopen_control.errors import ConfigError
from canopen_control.host.files import failed, telling
from canopen_control.ros.conversions import (
    arrays_of,
    diagonal,
    frames_with_a_place,
    positions_of,
    stamp_of,
    transform_of,
)
from canopen_control.ros.diagnosis import diagnose
from canopen_control.rpc.messages.samples import JointStatesSample, OdometrySample, PoseSample
from canopen_control.trace.bag_messages import BagMessages
from canopen_control.trace.bag_sensors import SENSORS
from canopen_control.urdf.geometry import from_rpy, from_yaw
from canopen_control.urdf.robot_model import read_model

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from canopen_control.rpc.messages.samples import Sample
    from canopen_control.rpc.messages.state import ControllerReading, RobotEvent, StateSample
    from canopen_control.urdf.geometry import Quaternion
    from canopen_control.urdf.joint_element import Transform

__all__ = ["BagWriter"]

S = TypeVar("S", bound="Sample")

_LEVELS: Final = {"info": 20, "warning": 30, "error": 40}  # rcl_interfaces/msg/Log
_CUT: Final = "the bag has no end: what is in it up to there can be had with `mcap recover`"
_DIAGNOSTICS_S: Final = 1.0
_LATCHED: Final = ("/tf_static", "/robot_description")


class BagWriter:
    """Writes one bag into the new folder `path`; `state` and `event` take what the API's stream gives, in any order.

    `controllers` and `urdf` are the answers of the API's `controllers` and `description`. ConfigError when rosbags is
    missing, or when `path` is there already.
    """

    def __init__(
        self, path: Path, robot: str, *, controllers: Iterable[ControllerReading] = (), urdf: str = ""
    ) -> None:
        self.messages = 0
        self._robot, self._urdf = robot, urdf
        self._ros = BagMessages()
        self._controllers = {each.name: each for each in controllers}
        self._joints = tuple(read_model(urdf).joints.values()) if urdf else ()
        self._path, self._writer = path, _open(path)
        self._topics: dict[str, object] = {}  # rosbags' connections
        self._last: dict[str, object] = {}  # by topic: what need not be written again
        self._missed = 0

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Finish the bag; a second call does nothing."""
        writer, self._writer = self._writer, None
        if writer is not None:
            with telling(self._path, _CUT):
                writer.close()

    def state(self, state: StateSample) -> None:
        """Write a sample of the state stream."""
        self._controllers = {
            name: each.became(state.controllers.get(name, each.state)) for name, each in self._controllers.items()
        }
        for write in (self._describe, self._commands, self._diagnostics):
            write(state)
        joint_states = self._new(state.told(JointStatesSample))
        odometry = self._new(state.told(OdometrySample))
        for name, states in joint_states.items():
            self._joint_states(name, states)
        for name, sample in odometry.items():
            self._odometry(name, sample)
        self._ground_truth(state)
        for kind, make in self._ros.states.items():
            for name, told in self._new(state.told(kind), "state").items():
                self._write(f"/{name}/controller_state", told.time, make(told))
        for row in SENSORS:
            for name, told in self._new(state.told(row.kind), row.topic).items():
                self._write(f"/{name}/{row.topic}", told.time, row.make(self._ros, told))
        self._transforms(state, joint_states.values(), odometry.values())

    def event(self, event: RobotEvent) -> None:
        """Write an event."""
        name = ".".join(word for word in (self._robot, event.node) if word)
        level = _LEVELS.get(event.level, _LEVELS["info"])
        stamp = self._ros.time(event.time)
        log = self._ros.make("rcl_interfaces/Log", stamp, level, name, event.text, "", event.kind, 0)
        self._write("/rosout", event.time, log)

    def number(self, topic: str, unix_s: float, value: float) -> None:
        """Write a number on a topic of its own: std_msgs/Float64."""
        self._write(topic, unix_s, self._ros.make("std_msgs/Float64", value))

    # Messages ------------------------------------------------------------------------------------------------------

    def _describe(self, state: StateSample) -> None:
        if self._urdf and self._is_new("/robot_description", True):
            self._write("/robot_description", state.time, self._ros.make("std_msgs/String", self._urdf))

    def _joint_states(self, name: str, sample: JointStatesSample) -> None:
        controller = self._controllers.get(name)
        topic = None if controller is None else controller.published("joint_states")
        if controller is not None and topic is not None:
            arrays = arrays_of(sample.joints, sample.names)
            header = self._ros.header(sample.time, controller.frame_id)
            message = self._ros.make("sensor_msgs/JointState", header, arrays.names, *map(self._ros.floats, arrays[1:]))
            self._write(f"/{topic}", sample.time, message)

    def _transforms(
        self, state: StateSample, joint_states: Iterable[JointStatesSample], odometry: Iterable[OdometrySample]
    ) -> None:
        based = frames_with_a_place(state)
        joints = [each for each in self._joints if each.child not in based]
        if self._is_new("/tf_static", based):
            fixed = (each.transform({}) for each in joints if each.fixed)
            self._send_transforms("/tf_static", ((state.time, each) for each in fixed))
        moving = [each for each in joints if not each.fixed]
        moved = [(sample.time, each.transform(positions_of(sample))) for sample in joint_states for each in moving]
        poses = self._new(state.told(PoseSample), "transform").values()
        based_on = [(sample.time, transform_of(sample)) for sample in (*odometry, *poses)]
        self._send_transforms("/tf", [*moved, *based_on])

    def _send_transforms(self, topic: str, transforms: Iterable[tuple[float, Transform | None]]) -> None:
        known = [(time, each) for time, each in transforms if each is not None]
        if known:
            messages = [self._transform(each, time) for time, each in known]
            self._write(topic, max(time for time, _ in known), self._ros.make("tf2_msgs/TFMessage", messages))

    def _transform(self, transform: Transform, time: float) -> object:
        ros = self._ros
        position, rotation = transform.pose
        motion = ros.make("geometry_msgs/Transform", ros.vector(*position), self._quaternion(rotation))
        header = ros.header(time, transform.parent)
        return ros.make("geometry_msgs/TransformStamped", header, transform.child, motion)

    def _quaternion(self, rotation: Quaternion) -> object:
        w, x, y, z = rotation
        return self._ros.make("geometry_msgs/Quaternion", x, y, z, w)

    def _commands(self, state: StateSample) -> None:
        """Write what forward controllers hold their joints to; a joint's command is known while it is claimed."""
        for name, view in self._controllers.items():
            known = [state.joints.get(joint) for joint in view.joints]
            values = [None if joint is None else joint.command for joint in known]
            topic = f"/{name}/commands_out"
            if view.topic == "commands" and view.active and values and self._is_new(topic, values):
                data = self._ros.floats(math.nan if value is None else value for value in values)
                layout = self._ros.make("std_msgs/MultiArrayLayout", [], 0)
                self._write(topic, state.time, self._ros.make("std_msgs/Float64MultiArray", layout, data))

    def _odometry(self, name: str, sample: OdometrySample) -> None:
        ros, time = self._ros, sample.time
        point = ros.make("geometry_msgs/Point", sample.x, sample.y, 0.0)
        pose = ros.make("geometry_msgs/Pose", point, self._quaternion(from_yaw(sample.heading)))
        spread = ros.floats(diagonal(sample.pose_covariance))
        with_pose = ros.make("geometry_msgs/PoseWithCovariance", pose, spread)
        twist, spread = (
            ros.twist(sample.linear, sample.angular, sample.lateral),
            ros.floats(diagonal(sample.twist_covariance)),
        )
        with_twist = ros.make("geometry_msgs/TwistWithCovariance", twist, spread)
        header = ros.header(time, sample.frame_id)
        message = ros.make("nav_msgs/Odometry", header, sample.child_frame_id, with_pose, with_twist)
        controller = self._controllers.get(name)
        topic = "odom" if controller is None else controller.odometry_topic
        self._write(f"/{name}/{topic}", time, message)
        if sample.limited is not None:
            header = ros.header(time, sample.child_frame_id)
            stamped = ros.make("geometry_msgs/TwistStamped", header, ros.twist(*sample.limited))
            self._write(f"/{name}/cmd_vel_out", time, stamped)

    def _ground_truth(self, state: StateSample) -> None:
        truth = state.true_pose
        frame = next((each.frame_id for each in state.told(OdometrySample).values()), None)
        if truth is None or truth.in_odometry is None or truth.rpy is None or frame is None:
            return
        if self._is_new("/ground_truth", truth.time):
            x, y, _ = truth.in_odometry
            ros, turn = self._ros, self._quaternion(from_rpy(truth.rpy))
            pose = ros.make("geometry_msgs/Pose", ros.make("geometry_msgs/Point", x, y, truth.z), turn)
            stamped = ros.make("geometry_msgs/PoseStamped", ros.header(truth.time, frame), pose)
            self._write("/ground_truth", truth.time, stamped)

    def _diagnostics(self, state: StateSample) -> None:
        last = self._last.get("/diagnostics")
        if isinstance(last, float) and 0 <= state.time - last < _DIAGNOSTICS_S:
            return
        self._last["/diagnostics"] = state.time
        found = diagnose(self._robot, state, self._controllers, self._missed)
        self._missed = state.cycle.missed
        statuses = [
            self._ros.make(
                "diagnostic_msgs/DiagnosticStatus",
                int(each.level),
                each.name,
                each.message,
                each.hardware_id,
                [self._ros.make("diagnostic_msgs/KeyValue", *pair) for pair in each.values.items()],
            )
            for each in found
        ]
        header = self._ros.header(state.time, "")
        self._write("/diagnostics", state.time, self._ros.make("diagnostic_msgs/DiagnosticArray", header, statuses))

    # The bag -------------------------------------------------------------------------------------------------------

    def _new(self, told: dict[str, S], use: str = "sample") -> dict[str, S]:
        """Return the samples that were published since they were last asked for: who looks twice writes once."""
        return {name: each for name, each in told.items() if self._is_new(f"{use} of {name}", each.time)}

    def _is_new(self, topic: str, value: object) -> bool:
        """Whether this differs from what was last asked about the topic."""
        if topic in self._last and self._last[topic] == value:
            return False
        self._last[topic] = value
        return True

    def _write(self, topic: str, unix_s: float, message: Any) -> None:  # noqa: ANN401 - rosbags makes the classes
        if self._writer is None:
            return
        kind = message.__msgtype__
        connection = self._topics.get(topic)
        if connection is None:
            qos = [_latched()] if topic in _LATCHED else []
            connection = self._writer.add_connection(topic, kind, typestore=self._ros.store, offered_qos_profiles=qos)
            self._topics[topic] = connection
        seconds, nanoseconds = stamp_of(unix_s)
        data = self._ros.store.serialize_cdr(message, kind)
        try:
            self._writer.write(connection, seconds * 1_000_000_000 + nanoseconds, data)
        except OSError as error:
            self._writer = None  # there is no room for its end either
            raise failed(self._path, error, _CUT) from error
        self.messages += 1


def _open(path: Path) -> Any:  # noqa: ANN401 - rosbags' writer, or None once it is closed
    from rosbags.rosbag2 import StoragePlugin, Writer, WriterError

    try:
        writer = Writer(path, version=9, storage_plugin=StoragePlugin.MCAP)
        writer.open()
        path.chmod(0o700)  # nobody else's, as the other recordings
    except WriterError as error:
        raise ConfigError(f"{path}: there is something already; a bag gets a folder of its own") from error
    except OSError as error:
        raise failed(path, error, "no bag was begun") from error
    return writer


def _latched() -> object:
    """Return the QoS of a topic whose last message is kept for who comes later."""
    from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime

    unset = QosTime(0, 0)
    return Qos(
        QosHistory.KEEP_LAST,
        1,
        QosReliability.RELIABLE,
        QosDurability.TRANSIENT_LOCAL,
        unset,  # deadline
        unset,  # lifespan
        QosLiveliness.SYSTEM_DEFAULT,
        unset,
        False,  # the ROS conventions of names hold
    )
