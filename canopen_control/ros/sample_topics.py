"""Table that converts the samples of controllers to ROS messages.

The table is used by the bridge, the bag writer and the report; this module imports no ROS. A message is filled by field
names, so that fields that an older ROS lacks are skipped. Unknown values are nan.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, NamedTuple, Protocol

from canopen_control.ros.conversions import diagonal, stamp_of, unknown_as_nan
from canopen_control.rpc.messages.samples import (
    BatteriesSample,
    BatteryReading,
    GpioSample,
    GripperSample,
    ImuSample,
    JointStatesSample,
    MecanumSample,
    OdometrySample,
    PidSample,
    PoseSample,
    RangeSample,
    SteeringSample,
    TrajectorySample,
    WrenchSample,
)
from canopen_control.urdf.geometry import from_yaw

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping

    from canopen_control.rpc.messages.samples import Sample
    from canopen_control.rpc.messages.state import ControllerReading

    #: path of a value in a sample, or a function that returns the value from a sample
    Source = str | Callable[[Any], object]


class Messages(Protocol):
    """Factory of messages, from rclpy's classes in the bridge and from rosbags' classes in a bag."""

    def empty(self, name: str) -> Any:  # noqa: ANN401 - a generated class
        """Return a message of type `package/msg/Name` with zeros and empty lists."""

    def floats(self, values: Iterable[float]) -> object:
        """Return the numbers as an array of the type that the messages require."""

    def frame(self, name: str) -> str:
        """Return a frame's name with the robot's prefix, if any."""


class SampleTopic(NamedTuple):
    """Topic for samples of one `kind`; `fields` maps message fields to sources in the sample.

    `frame` names the sample's field with the frame of the header; a sample without this field has the controller's
    frame. `optional` names a field of the sample; a sample with None in this field is not sent. `units` maps the
    sources that belong in a report to their units. A `latched` topic is published even without a subscriber, for later
    subscribers. `bridge` and `bag` are True if the topic exists in the bridge and in bags.
    """

    kind: type[Sample]
    topic: str
    message: str
    fields: Mapping[str, Source]
    units: Mapping[str, str] = {}
    frame: str = "frame_id"
    optional: str = "time"
    latched: bool = False
    bridge: bool = True
    bag: bool = True

    def name(self, controller: ControllerReading) -> str:
        """Return the name of a controller's topic, relative to the robot's namespace, or "" if not published."""
        if self.kind is JointStatesSample:
            return controller.published(self.topic) or ""
        topic = controller.odometry_topic if self.topic == "odom" else self.topic
        return f"{controller.name}/{topic}"


def _same(*names: str) -> dict[str, str]:
    return {name: name for name in names}


def _column(kind: str) -> Callable[[JointStatesSample], list[float]]:
    return lambda sample: [unknown_as_nan(sample.joints[name].get(kind)) for name in sample.names]


def _position(sample: OdometrySample) -> tuple[float, float, float]:
    return (0.0, 0.0, 0.0) if sample.only_twist else (sample.x, sample.y, 0.0)


def _orientation(sample: OdometrySample) -> tuple[float, float, float, float]:
    w, x, y, z = from_yaw(0.0 if sample.only_twist else sample.heading)
    return x, y, z, w


_BATTERY: Final = tuple(BatteryReading.__struct_fields__[1:])  # fields without the name

SAMPLE_TOPICS: Final = (
    SampleTopic(
        OdometrySample,
        "odom",
        "nav_msgs/msg/Odometry",
        {
            "child_frame_id": "child_frame_id",
            "pose.pose.position": _position,
            "pose.pose.orientation": _orientation,
            "pose.covariance": lambda sample: diagonal(sample.pose_covariance),
            "twist.twist.linear.x": "linear",
            "twist.twist.linear.y": "lateral",
            "twist.twist.angular.z": "angular",
            "twist.covariance": lambda sample: diagonal(sample.twist_covariance),
        },
        latched=True,
    ),
    SampleTopic(
        OdometrySample,
        "cmd_vel_out",
        "geometry_msgs/msg/TwistStamped",
        {"twist.linear.x": "limited.0", "twist.angular.z": "limited.1"},
        frame="child_frame_id",
        optional="limited",
        latched=True,
    ),
    SampleTopic(
        OdometrySample,
        "cmd_ackermann",
        "ackermann_msgs/msg/AckermannDrive",
        {"speed": "ackermann.0", "steering_angle": "ackermann.1"},
        optional="ackermann",
    ),
    SampleTopic(
        TrajectorySample,
        "controller_state",
        "control_msgs/msg/JointTrajectoryControllerState",
        {"joint_names": "joints", **_same("reference", "feedback", "error", "output", "speed_scaling_factor")},
    ),
    SampleTopic(PidSample, "controller_state", "control_msgs/msg/MultiDOFStateStamped", {"dof_states": "dofs"}),
    SampleTopic(
        SteeringSample,
        "controller_state",
        "control_msgs/msg/SteeringControllerStatus",
        {
            "traction_wheels_position": "traction_positions",
            "traction_wheels_velocity": "traction_velocities",
            "steer_positions": "steering",
            "linear_velocity_command": "traction_commands",
            "traction_command": "traction_commands",  # name of the field in newer releases
            "steering_angle_command": "steering_commands",
        },
    ),
    SampleTopic(
        MecanumSample,
        "controller_state",
        "control_msgs/msg/MecanumDriveControllerState",
        {
            "front_left_wheel_velocity": "wheels.0",
            "back_left_wheel_velocity": "wheels.1",
            "back_right_wheel_velocity": "wheels.2",
            "front_right_wheel_velocity": "wheels.3",
            "reference_velocity.linear.x": "reference.0",
            "reference_velocity.linear.y": "reference.1",
            "reference_velocity.angular.z": "reference.2",
        },
    ),
    SampleTopic(
        JointStatesSample,
        "joint_states",
        "sensor_msgs/msg/JointState",
        {"name": "names", **{kind: _column(kind) for kind in ("position", "velocity", "effort")}},
        latched=True,
    ),
    SampleTopic(
        JointStatesSample,
        "dynamic_joint_states",
        "control_msgs/msg/DynamicJointState",
        {"joint_names": "joints", "interface_values": "joints"},
        bag=False,
    ),
    SampleTopic(
        ImuSample,
        "imu",
        "sensor_msgs/msg/Imu",
        _same(
            *(
                f"{quantity}{part}"
                for quantity in ("orientation", "angular_velocity", "linear_acceleration")
                for part in ("", "_covariance")
            )
        ),
        {"orientation": "", "angular_velocity": "rad/s", "linear_acceleration": "m/s²"},
    ),
    SampleTopic(
        RangeSample,
        "range",
        "sensor_msgs/msg/Range",
        _same("range", "radiation_type", "field_of_view", "min_range", "max_range", "variance"),
        {"range": "m"},
    ),
    SampleTopic(
        WrenchSample,
        "wrench",
        "geometry_msgs/msg/WrenchStamped",
        {"wrench.force": "force", "wrench.torque": "torque"},
        {"force": "N", "torque": "Nm"},
    ),
    SampleTopic(
        PoseSample,
        "pose",
        "geometry_msgs/msg/PoseStamped",
        {"pose.position": "position", "pose.orientation": "orientation"},
        {"position": "m", "orientation": ""},
    ),
    SampleTopic(
        BatteriesSample,
        "battery_state",
        "sensor_msgs/msg/BatteryState",
        {name: f"together.{name}" for name in _BATTERY},
        {
            "batteries.voltage": "V",
            "batteries.current": "A",
            "batteries.temperature": "°C",
            "batteries.percentage": "",
        },
    ),
    SampleTopic(
        BatteriesSample, "raw_battery_states", "control_msgs/msg/BatteryStateArray", {"battery_states": "batteries"}
    ),
    SampleTopic(
        GpioSample,
        "gpio_states",
        "control_msgs/msg/DynamicInterfaceGroupValues",
        {"interface_groups": "parts", "interface_values": "parts"},
        {"parts": ""},
        latched=True,
    ),
    SampleTopic(
        GripperSample,
        "commands_out",
        "std_msgs/msg/Float64MultiArray",
        {"data": lambda sample: [sample.target]},
        {"position": "rad or m", "effort": "Nm or N", "target": "rad or m"},
        bridge=False,
    ),
)
"""All topics; a new kind of sample needs a row here."""

TRAJECTORY_FEEDBACK: Final = SampleTopic(
    TrajectorySample,
    "follow_joint_trajectory",
    "control_msgs/action/FollowJointTrajectory",
    {"joint_names": "joints", "desired": "reference", "actual": "feedback", "error": "error"},
)
"""Feedback of the FollowJointTrajectory action."""
ELEMENTS: Final = {
    "dof_states": "control_msgs/msg/SingleDOFState",
    "interface_values": "control_msgs/msg/InterfaceValue",
    "battery_states": "sensor_msgs/msg/BatteryState",
}
"""Message types of the elements of list fields, by field name."""


def fill(messages: Messages, message: Any, row: SampleTopic, sample: Sample, frame: str = "") -> None:  # noqa: ANN401
    """Fill a message from a sample; `frame` is the controller's frame, for samples without one."""
    if hasattr(message, "header"):
        _head(message, sample.time, messages.frame(getattr(sample, row.frame, frame)))
    for place, source in row.fields.items():
        *parents, field = place.split(".")
        part = message
        for parent in parents:
            part = getattr(part, parent)
        value = _value(sample, source) if isinstance(source, str) else source(sample)
        _put(messages, part, field, messages.frame(str(value)) if field.endswith("frame_id") else value, sample.time)


def _head(message: Any, time: float, frame: str) -> None:  # noqa: ANN401 - as above
    message.header.stamp.sec, message.header.stamp.nanosec = stamp_of(time)
    message.header.frame_id = frame


def _value(sample: Sample, source: str) -> Any:  # noqa: ANN401 - of any type
    value: Any = sample
    for key in source.split("."):
        value = getattr(value, key, None) if not key.isdigit() else next(iter(value[int(key) :]), None)
    return value


def _put(messages: Messages, part: Any, field: str, value: Any, time: float) -> None:  # noqa: ANN401 - as above
    """Set a field of a message, unless the message lacks it; unknown numbers become nan.

    Structures are filled by field names, vectors by axes.
    """
    target = getattr(part, field, None)
    if target is None:  # the message does not exist in this ROS
        return
    if hasattr(value, "__struct_fields__"):
        for name in value.__struct_fields__:
            _put(messages, target, name, getattr(value, name), time)
    elif field in ELEMENTS:
        of = value.values() if isinstance(value, dict) else value
        setattr(part, field, [_element(messages, ELEMENTS[field], element, time) for element in of])
    elif hasattr(target, "nanosec"):
        target.sec, target.nanosec = stamp_of(value)
    elif hasattr(target, "x"):
        for axis, component in zip("xyzw"[: len(value)], value, strict=True):
            setattr(target, axis, unknown_as_nan(component))
    elif isinstance(value, list | tuple | dict):
        words = any(isinstance(element, str) for element in value)
        setattr(part, field, list(value) if words else messages.floats(map(unknown_as_nan, value)))
    else:
        setattr(part, field, unknown_as_nan(value))


def _element(messages: Messages, name: str, value: Any, time: float) -> object:  # noqa: ANN401 - as above
    message = messages.empty(name)
    if isinstance(value, dict):
        message.interface_names = list(value)
        message.values = messages.floats(map(unknown_as_nan, value.values()))
        return message
    if hasattr(message, "header"):
        _head(message, time, value.name)
    for field in value.__struct_fields__:
        _put(messages, message, field, getattr(value, field), time)
    return message


def measured_values(sample: Sample) -> Iterator[tuple[str, str, float | None]]:
    """Yield the name, unit and value of each field of a sample that belongs in a report."""
    for row in SAMPLE_TOPICS:
        if isinstance(sample, row.kind):
            for source, unit in row.units.items():
                for name, value in _named(sample, source):
                    yield name, unit, value


def _named(sample: Sample, source: str) -> Iterator[tuple[str, float | None]]:
    field, _, part = source.partition(".")
    value = getattr(sample, field)
    if isinstance(value, dict):
        yield from ((f"{group}/{name}", number) for group, values in value.items() for name, number in values.items())
    elif isinstance(value, list):
        yield from ((f"{element.name} {part}", getattr(element, part)) for element in value)
    elif isinstance(value, tuple):
        yield from ((f"{field}.{axis}", component) for axis, component in zip("xyzw", value, strict=False))
    else:
        joint = getattr(sample, "joint", "")
        yield f"{joint} {field}".lstrip(), value
