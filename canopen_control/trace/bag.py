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

Commands, including those of a gripper, use names without a subscriber, so that playing a bag does not move the robot.
Values are in SI units, nan if unknown. Only this module imports rosbags.
"""

from __future__ import annotations

import math
from functools import partial
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypeVar

from canopen_control.errors import ConfigError
from canopen_control.host.files import failed, telling
from canopen_control.ros.conversions import (
    SENSOR_MESSAGES,
    SensorMessage,
    arrays_of,
    diagonal,
    frames_with_a_place,
    positions_of,
    put_sample,
    stamp_of,
    transform_of,
    unknown_as_nan,
)
from canopen_control.ros.diagnosis import diagnose
from canopen_control.ros.interfaces.definition import DEFINITIONS
from canopen_control.rpc.messages.samples import (
    BatteriesSample,
    GpioSample,
    GripperSample,
    JointStatesSample,
    MecanumSample,
    OdometrySample,
    PidSample,
    PoseSample,
    SteeringSample,
    TrajectorySample,
)
from canopen_control.urdf.geometry import from_rpy, from_yaw
from canopen_control.urdf.robot_model import read_model

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable
    from pathlib import Path

    from canopen_control.rpc.messages.samples import BatteryReading, Sample, TrajectoryPoint
    from canopen_control.rpc.messages.state import ControllerReading, RobotEvent, StateSample
    from canopen_control.urdf.geometry import Quaternion
    from canopen_control.urdf.joint_element import Transform


_ADDED: Final = tuple(
    f"control_msgs/msg/{each}"
    for each in (
        "JointTrajectoryControllerState",
        "SingleDOFState",
        "MultiDOFStateStamped",
        "SteeringControllerStatus",
        "MecanumDriveControllerState",
        "InterfaceValue",
        "DynamicInterfaceGroupValues",
        "BatteryStateArray",
    )
)


class BagMessages:
    """Messages of ROS 2 Jazzy for a bag, created by rosbags; those of control_msgs from their definitions."""

    def __init__(self) -> None:
        try:
            from numpy import array
            from rosbags.typesys import Stores, get_types_from_msg, get_typestore
        except ImportError as error:
            text = "a bag is written by rosbags, which is not installed: pip install 'canopen-control[bag]'"
            raise ConfigError(text) from error
        self.store = get_typestore(Stores.ROS2_JAZZY)
        for name in _ADDED:
            self.store.register(get_types_from_msg("\n".join(DEFINITIONS[name]), name))
        self.array = array

    def make(self, kind: str, *values: Any) -> Any:  # noqa: ANN401 - rosbags makes the classes at run time
        """Return a message of `package/Name` with its fields in order."""
        return self.store.types[kind.replace("/", "/msg/")](*values)

    def empty(self, name: str) -> Any:  # noqa: ANN401 - as above
        """Return a message of `package/msg/Name` whose numbers are 0 and whose lists are empty."""
        fields = (self._empty_field(node.name, part) for _, (node, part) in self.store.fielddefs[name][1])
        return self.store.types[name](*fields)

    def _empty_field(self, node: str, part: Any) -> Any:  # noqa: ANN401 - as above
        if node == "NAME":
            return self.empty(part)
        return ("" if part[0] == "string" else 0) if node == "BASE" else []

    def time(self, unix_s: float) -> Any:  # noqa: ANN401 - as above
        """Return a time stamp."""
        return self.make("builtin_interfaces/Time", *stamp_of(unix_s))

    def header(self, unix_s: float, frame: str) -> Any:  # noqa: ANN401 - as above
        """Return a header."""
        return self.make("std_msgs/Header", self.time(unix_s), frame)

    def vector(self, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Any:  # noqa: ANN401 - as above
        """Return a vector."""
        return self.make("geometry_msgs/Vector3", float(x), float(y), float(z))

    def twist(self, linear: float, angular: float, lateral: float = 0.0) -> Any:  # noqa: ANN401 - as above
        """Return a twist of a base: m/s and rad/s."""
        return self.make("geometry_msgs/Twist", self.vector(linear, lateral), self.vector(z=angular))

    def floats(self, values: Iterable[float]) -> Any:  # noqa: ANN401 - a numpy array
        """Return an array of numbers."""
        return self.array(list(values), dtype=float)

    # -- controller states


class BagTopic(NamedTuple):
    """Topic of the samples of one `kind` of a controller; `make` returns the message of one sample."""

    kind: type[Sample]
    topic: str
    make: Callable[[BagMessages, Any], object]


# -- states of controllers


def _trajectory(ros: BagMessages, sample: TrajectorySample) -> object:
    """Return reference and feedback of the joints of a trajectory."""
    points = [_point(ros, point) for point in (sample.reference, sample.feedback, sample.error, sample.output)]
    nowhere = ros.make("trajectory_msgs/MultiDOFJointTrajectoryPoint", [], [], [], _duration(ros, 0.0))
    return ros.make(
        "control_msgs/JointTrajectoryControllerState",
        ros.header(sample.time, ""),
        list(sample.joints),
        *points,
        [],
        *[nowhere] * len(points),
        sample.speed_scaling_factor,
    )


def _point(ros: BagMessages, point: TrajectoryPoint) -> object:
    values = (point.positions, point.velocities, point.accelerations, point.effort)
    after = _duration(ros, point.time_from_start)
    return ros.make("trajectory_msgs/JointTrajectoryPoint", *map(ros.floats, values), after)


def _duration(ros: BagMessages, seconds: float) -> object:
    return ros.make("builtin_interfaces/Duration", *stamp_of(seconds))


def _loops(ros: BagMessages, sample: PidSample) -> object:
    """Return the reference of each degree of freedom of a PID controller."""
    dofs = [
        ros.make(
            "control_msgs/SingleDOFState",
            dof.name,
            *map(unknown_as_nan, (dof.reference, dof.feedback, dof.feedback_dot, dof.error, dof.error_dot)),
            dof.time_step,
            unknown_as_nan(dof.output),
        )
        for dof in sample.dofs
    ]
    return ros.make("control_msgs/MultiDOFStateStamped", ros.header(sample.time, ""), dofs)


def _steering(ros: BagMessages, sample: SteeringSample) -> object:
    """Return the wheels of a steered base, measured and commanded."""
    columns = (
        sample.traction_positions,
        sample.traction_velocities,
        sample.steering,
        sample.traction_commands,
        sample.steering_commands,
    )
    values = [ros.floats(map(unknown_as_nan, column)) for column in columns]
    return ros.make("control_msgs/SteeringControllerStatus", ros.header(sample.time, sample.frame_id), *values)


def _mecanum(ros: BagMessages, sample: MecanumSample) -> object:
    """Return the wheels of a mecanum base, and its reference twist."""
    unknown = (None,) * 4  # of a base that has not reported its wheels yet
    ahead, lateral, turning = map(unknown_as_nan, (*sample.reference, *unknown)[:3])
    return ros.make(
        "control_msgs/MecanumDriveControllerState",
        ros.header(sample.time, sample.frame_id),
        *map(unknown_as_nan, (*sample.wheels, *unknown)[:4]),
        ros.twist(ahead, turning, lateral),
    )


# -- samples of broadcasters and grippers


def _sensor(row: SensorMessage, ros: BagMessages, sample: Any) -> object:  # noqa: ANN401 - of the kind of the row
    message = ros.empty(row.message)
    message.header = ros.header(sample.time, sample.frame_id)
    put_sample(message, row, sample, ros.floats)
    return message


def _gpio(ros: BagMessages, sample: GpioSample) -> object:
    values = [
        ros.make("control_msgs/InterfaceValue", list(part), ros.floats(_known(part.values())))
        for part in sample.parts.values()
    ]
    return ros.make("control_msgs/DynamicInterfaceGroupValues", ros.header(sample.time, ""), list(sample.parts), values)


def _battery(ros: BagMessages, battery: BatteryReading, time: float) -> object:
    measured = (
        battery.voltage,
        battery.temperature,
        battery.current,
        battery.charge,
        battery.capacity,
        battery.design_capacity,
        battery.percentage,
    )
    return ros.make(
        "sensor_msgs/BatteryState",
        ros.header(time, battery.name),
        *_known(measured),
        battery.power_supply_status,
        battery.power_supply_health,
        battery.power_supply_technology,
        battery.present,
        ros.floats(()),  # the cells are unknown
        ros.floats(()),
        battery.location,
        battery.serial_number,
    )


def _together(ros: BagMessages, sample: BatteriesSample) -> object:
    return _battery(ros, sample.together, sample.time)


def _each(ros: BagMessages, sample: BatteriesSample) -> object:
    return ros.make(
        "control_msgs/BatteryStateArray", [_battery(ros, battery, sample.time) for battery in sample.batteries]
    )


def _gripper(ros: BagMessages, sample: GripperSample) -> object:
    layout = ros.make("std_msgs/MultiArrayLayout", [], 0)
    return ros.make("std_msgs/Float64MultiArray", layout, ros.floats((unknown_as_nan(sample.target),)))


def _known(values: Iterable[float | None]) -> list[float]:
    return [unknown_as_nan(value) for value in values]


CONTROLLER_TOPICS: Final = (
    BagTopic(TrajectorySample, "controller_state", _trajectory),
    BagTopic(PidSample, "controller_state", _loops),
    BagTopic(SteeringSample, "controller_state", _steering),
    BagTopic(MecanumSample, "controller_state", _mecanum),
    *(BagTopic(row.kind, row.topic, partial(_sensor, row)) for row in SENSOR_MESSAGES),
    BagTopic(BatteriesSample, "battery_state", _together),
    BagTopic(BatteriesSample, "raw_battery_states", _each),
    BagTopic(GpioSample, "gpio_states", _gpio),
    BagTopic(GripperSample, "commands_out", _gripper),
)
"""All topics; a new kind of sample needs a line here."""


S = TypeVar("S", bound="Sample")

_LEVELS: Final = {"info": 20, "warning": 30, "error": 40}  # rcl_interfaces/msg/Log
_CUT: Final = "the bag has no end: what is in it up to there can be had with `mcap recover`"
_DIAGNOSTICS_S: Final = 1.0
_LATCHED: Final = ("/tf_static", "/robot_description")


class BagWriter:
    """Writer of one bag into the new folder `path`; `state` and `event` accept the API's stream in any order.

    `controllers` and `urdf` are the answers of the API's `controllers` and `description`. ConfigError if rosbags is
    missing or `path` exists.
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
        """Complete the bag; a second call does nothing."""
        writer, self._writer = self._writer, None
        if writer is not None:
            with telling(self._path, _CUT):
                writer.close()

    def state(self, state: StateSample) -> None:
        """Write a sample of the state stream."""
        self._controllers = {
            name: controller.became(state.controllers.get(name, controller.state))
            for name, controller in self._controllers.items()
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
        for row in CONTROLLER_TOPICS:
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

    # -- messages

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
        joints = [joint for joint in self._joints if joint.child not in based]
        if self._is_new("/tf_static", based):
            fixed = (joint.transform({}) for joint in joints if joint.fixed)
            self._send_transforms("/tf_static", ((state.time, joint) for joint in fixed))
        moving = [joint for joint in joints if not joint.fixed]
        moved = [(sample.time, joint.transform(positions_of(sample))) for sample in joint_states for joint in moving]
        poses = self._new(state.told(PoseSample), "transform").values()
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
        """Write the commands of forward controllers; the command of a joint is known while it is claimed."""
        for name, view in self._controllers.items():
            joints = [state.joints.get(joint) for joint in view.joints]
            values = [None if joint is None else joint.command for joint in joints]
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
        frame = next((sample.frame_id for sample in state.told(OdometrySample).values()), None)
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
        """Return the samples published since the last call for this `use`, so that each is written once."""
        return {name: sample for name, sample in samples.items() if self._is_new(f"{use} of {name}", sample.time)}

    def _is_new(self, topic: str, value: object) -> bool:
        """Whether the value differs from the last one passed for the topic."""
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
            self._writer = None  # there is no space for the end of the bag either
            raise failed(self._path, error, _CUT) from error
        self.messages += 1


def _open(path: Path) -> Any:  # noqa: ANN401 - rosbags' writer, or None once it is closed
    from rosbags.rosbag2 import StoragePlugin, Writer, WriterError

    try:
        writer = Writer(path, version=9, storage_plugin=StoragePlugin.MCAP)
        writer.open()
        path.chmod(0o700)  # private, as the other recordings
    except WriterError as error:
        raise ConfigError(f"{path}: there is something already; a bag gets a folder of its own") from error
    except OSError as error:
        raise failed(path, error, "no bag was begun") from error
    return writer


def _latched() -> object:
    """Return the QoS of a topic whose last message is kept for late subscribers."""
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
