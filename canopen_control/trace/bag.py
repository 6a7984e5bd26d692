"""ROS 2 bag of a run (MCAP, Jazzy types), written from the runtime's state stream without a ROS installation.

Topics, names and stamps are those of the ROS bridge, so that rqt, Foxglove, PlotJuggler and `ros2 bag` can use them:

    /joint_states                    sensor_msgs/JointState         every update of a broadcaster, on its topic
    /tf, /tf_static                  tf2_msgs/TFMessage             joints of the description, odometry
    /CONTROLLER/odom                 nav_msgs/Odometry              at the publish rate of the controller
    /ground_truth                    geometry_msgs/PoseStamped      true pose of a simulated base in the odometry frame
    /CONTROLLER/cmd_vel_out          geometry_msgs/TwistStamped     the command after the limits of the controller
    /CONTROLLER/commands_out         std_msgs/Float64MultiArray     commands of a forward controller, on change
    /CONTROLLER/controller_state     control_msgs/...               every update: trajectory, PID, steering, mecanum
    /CONTROLLER/imu, range, wrench, pose, battery_state, gpio_states    every update of a broadcaster
    /diagnostics                     diagnostic_msgs/DiagnosticArray   once a second
    /rosout                          rcl_interfaces/Log             the robot's events
    /robot_description               std_msgs/String                once

Commands, including those of a gripper, are on topics without subscribers, so that playing a bag does not move the
robot. Values are in SI units, nan if unknown. Only this module imports rosbags.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final, TypeVar

from canopen_control.errors import ConfigError
from canopen_control.host.files import failed, telling
from canopen_control.ros.conversions import (
    located_frames,
    positions_of,
    stamp_of,
    transform_of,
)
from canopen_control.ros.diagnosis import diagnose
from canopen_control.ros.interfaces.definition import DEFINITIONS
from canopen_control.ros.sample_topics import ELEMENTS, SAMPLE_TOPICS, fill
from canopen_control.rpc.messages.samples import (
    JointStatesSample,
    OdometrySample,
    PoseSample,
)
from canopen_control.rpc.messages.state import ControllerReading
from canopen_control.urdf.geometry import from_rpy
from canopen_control.urdf.robot_model import read_model

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from canopen_control.ros.sample_topics import SampleTopic
    from canopen_control.rpc.messages.samples import Sample
    from canopen_control.rpc.messages.state import RobotEvent, StateSample
    from canopen_control.urdf.geometry import Quaternion
    from canopen_control.urdf.joint_element import Transform


_ADDED: Final = tuple(
    name for name in dict.fromkeys((*ELEMENTS.values(), *(row.message for row in SAMPLE_TOPICS))) if name in DEFINITIONS
)


class BagMessages:
    """Factory for ROS 2 Jazzy messages, with classes created by rosbags."""

    def __init__(self) -> None:
        try:
            from numpy import array
            from rosbags.typesys import Stores, get_types_from_msg, get_typestore
        except ImportError as error:
            text = "a bag needs rosbags, which is not installed: pip install 'canopen-control[bag]'"
            raise ConfigError(text) from error
        self.store = get_typestore(Stores.ROS2_JAZZY)
        for name in _ADDED:
            self.store.register(get_types_from_msg("\n".join(DEFINITIONS[name]), name))
        self.array = array

    def make(self, kind: str, *values: Any) -> Any:  # noqa: ANN401 - rosbags makes the classes at run time
        """Return a message of the type `package/Name`; `values` are the field values in order."""
        return self.store.types[kind.replace("/", "/msg/")](*values)

    def empty(self, name: str) -> Any:  # noqa: ANN401 - as above
        """Return a message of the type `package/msg/Name` with zeros, empty strings and empty lists."""
        fields = (self._empty_field(node.name, part) for _, (node, part) in self.store.fielddefs[name][1])
        return self.store.types[name](*fields)

    def _empty_field(self, node: str, part: Any) -> Any:  # noqa: ANN401 - as above
        if node == "NAME":
            return self.empty(part)
        if node == "BASE":
            return "" if part[0] == "string" else 0
        return [] if part[0][0].name == "NAME" else self.floats(())

    def time(self, unix_s: float) -> Any:  # noqa: ANN401 - as above
        return self.make("builtin_interfaces/Time", *stamp_of(unix_s))

    def header(self, unix_s: float, frame: str) -> Any:  # noqa: ANN401 - as above
        return self.make("std_msgs/Header", self.time(unix_s), frame)

    def vector(self, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Any:  # noqa: ANN401 - as above
        return self.make("geometry_msgs/Vector3", float(x), float(y), float(z))

    def twist(self, linear: float, angular: float, lateral: float = 0.0) -> Any:  # noqa: ANN401 - as above
        """Return the Twist message of a base, in m/s and rad/s."""
        return self.make("geometry_msgs/Twist", self.vector(linear, lateral), self.vector(z=angular))

    def frame(self, name: str) -> str:
        """Return a frame name unchanged; other message factories may add a prefix."""
        return name

    def floats(self, values: Iterable[float]) -> Any:  # noqa: ANN401 - a numpy array
        return self.array(list(values), dtype=float)


S = TypeVar("S", bound="Sample")

_LEVELS: Final = {"info": 20, "warning": 30, "error": 40}  # constants of rcl_interfaces/msg/Log
_CUT: Final = "the bag is incomplete; recover its content with `mcap recover`"
_DIAGNOSTICS_S: Final = 1.0
_LATCHED: Final = ("/tf_static", "/robot_description")


class BagWriter:
    """Writer of a bag in the new folder `path`; `state` and `event` write the messages of the API's stream.

    `controllers` and `urdf` are the answers to the API's requests `controllers` and `description`. Raise
    ConfigError if rosbags is missing or `path` exists.
    """

    def __init__(
        self, path: Path, robot: str, *, controllers: Iterable[ControllerReading] = (), urdf: str = ""
    ) -> None:
        self.messages = 0
        self._robot, self._urdf = robot, urdf
        self._ros = BagMessages()
        self._controllers = {controller.name: controller for controller in controllers}
        self._joints = tuple(read_model(urdf).joints.values()) if urdf else ()
        self._path, self._writer = path, _open(path)
        self._topics: dict[str, object] = {}  # rosbags' connections
        self._last: dict[str, object] = {}  # by topic: the last value, to write only changes
        self._missed = 0

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Complete the bag; a second call has no effect."""
        writer, self._writer = self._writer, None
        if writer is not None:
            with telling(self._path, _CUT):
                writer.close()

    def state(self, state: StateSample) -> None:
        """Write the messages that result from a state sample."""
        self._controllers = {
            name: controller.became(state.controllers.get(name, controller.state))
            for name, controller in self._controllers.items()
        }
        for write in (self._describe, self._commands, self._diagnostics):
            write(state)
        for row in SAMPLE_TOPICS:
            if row.bag:
                for name, sample in self._new(state.samples_of(row.kind), f"{row.topic} {row.message}").items():
                    self._sample(row, name, sample)
        self._ground_truth(state)
        self._transforms(state)

    def event(self, event: RobotEvent) -> None:
        """Write an event to /rosout."""
        name = ".".join(word for word in (self._robot, event.node) if word)
        level = _LEVELS.get(event.level, _LEVELS["info"])
        stamp = self._ros.time(event.time)
        log = self._ros.make("rcl_interfaces/Log", stamp, level, name, event.text, "", event.kind, 0)
        self._write("/rosout", event.time, log)

    def number(self, topic: str, unix_s: float, value: float) -> None:
        """Write a number to a topic of type std_msgs/Float64."""
        self._write(topic, unix_s, self._ros.make("std_msgs/Float64", value))

    # -- messages

    def _describe(self, state: StateSample) -> None:
        if self._urdf and self._is_new("/robot_description", True):
            self._write("/robot_description", state.time, self._ros.make("std_msgs/String", self._urdf))

    def _sample(self, row: SampleTopic, name: str, sample: Sample) -> None:
        controller = self._controllers.get(name) or ControllerReading(name=name, type="", state="")
        topic = row.name(controller)
        if topic and getattr(sample, row.optional) is not None:
            message = self._ros.empty(row.message)
            fill(self._ros, message, row, sample, controller.frame_id)
            self._write(f"/{topic}", sample.time, message)

    def _transforms(self, state: StateSample) -> None:
        joint_states = self._new(state.samples_of(JointStatesSample)).values()
        odometry = self._new(state.samples_of(OdometrySample)).values()
        based = located_frames(state)
        joints = [joint for joint in self._joints if joint.child not in based]
        if self._is_new("/tf_static", based):
            fixed = (joint.transform({}) for joint in joints if joint.fixed)
            self._send_transforms("/tf_static", ((state.time, joint) for joint in fixed))
        moving = [joint for joint in joints if not joint.fixed]
        moved = [(sample.time, joint.transform(positions_of(sample))) for sample in joint_states for joint in moving]
        poses = self._new(state.samples_of(PoseSample), "transform").values()
        based_on = [(sample.time, transform_of(sample)) for sample in (*odometry, *poses)]
        self._send_transforms("/tf", [*moved, *based_on])

    def _send_transforms(self, topic: str, transforms: Iterable[tuple[float, Transform | None]]) -> None:
        known_transforms = [(time, transform) for time, transform in transforms if transform is not None]
        if known_transforms:
            messages = [self._transform(transform, time) for time, transform in known_transforms]
            self._write(
                topic, max(time for time, _ in known_transforms), self._ros.make("tf2_msgs/TFMessage", messages)
            )

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
        """Write the commands of forward controllers that have changed; nan for a joint without a known command."""
        for name, view in self._controllers.items():
            joints = [state.joints.get(joint) for joint in view.joints]
            values = [None if joint is None else joint.command for joint in joints]
            topic = f"/{name}/commands_out"
            if view.topic == "commands" and view.active and values and self._is_new(topic, values):
                data = self._ros.floats(math.nan if value is None else value for value in values)
                layout = self._ros.make("std_msgs/MultiArrayLayout", [], 0)
                self._write(topic, state.time, self._ros.make("std_msgs/Float64MultiArray", layout, data))

    def _ground_truth(self, state: StateSample) -> None:
        truth = state.true_pose
        frame = next((sample.frame_id for sample in state.samples_of(OdometrySample).values()), None)
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
        diagnosis = diagnose(self._robot, state, self._controllers, self._missed)
        self._missed = state.cycle.missed
        statuses = [
            self._ros.make(
                "diagnostic_msgs/DiagnosticStatus",
                int(entry.level),
                entry.name,
                entry.message,
                entry.hardware_id,
                [self._ros.make("diagnostic_msgs/KeyValue", *pair) for pair in entry.values.items()],
            )
            for entry in diagnosis
        ]
        header = self._ros.header(state.time, "")
        self._write("/diagnostics", state.time, self._ros.make("diagnostic_msgs/DiagnosticArray", header, statuses))

    # -- bag

    def _new(self, samples: dict[str, S], use: str = "sample") -> dict[str, S]:
        """Return the samples that are new since the last call with the same `use`, so that each is written once."""
        return {name: sample for name, sample in samples.items() if self._is_new(f"{use} of {name}", sample.time)}

    def _is_new(self, topic: str, value: object) -> bool:
        """Whether a value differs from the previous value of the topic."""
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
            self._writer = None  # the end of the bag could not be written either
            raise failed(self._path, error, _CUT) from error
        self.messages += 1


def _open(path: Path) -> Any:  # noqa: ANN401 - rosbags' writer, or None once it is closed
    from rosbags.rosbag2 import StoragePlugin, Writer, WriterError

    try:
        writer = Writer(path, version=9, storage_plugin=StoragePlugin.MCAP)
        writer.open()
        path.chmod(0o700)  # private, as the other recordings
    except WriterError as error:
        raise ConfigError(f"{path}: it already exists; give a new folder for the bag") from error
    except OSError as error:
        raise failed(path, error, "no bag was created") from error
    return writer


def _latched() -> object:
    """Return a QoS that delivers the last message of a topic to late subscribers."""
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
        False,  # avoid_ros_namespace_conventions
    )
