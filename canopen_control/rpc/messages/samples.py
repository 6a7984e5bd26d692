"""Samples of controllers: one structure per kind, identified by the key `kind`.

A sample is from the last publication of its controller: all readers get the same values with the same stamp. SI units;
unknown values are None. A new kind needs a structure here, and has to be added to `ControllerSample`.
"""

from __future__ import annotations

from typing import Any, TypeAlias, TypeVar

import msgspec

Values: TypeAlias = dict[str, float | None]
S = TypeVar("S", bound="Sample")
M = TypeVar("M", bound=msgspec.Struct)


class Sample(msgspec.Struct, frozen=True, kw_only=True, tag_field="kind", tag="none"):
    """Base class of all samples; `time` is the Unix time of the publication in s."""

    time: float


class OdometrySample(Sample, frozen=True, kw_only=True, tag="odometry"):
    """Odometry of a base controller as pose and twist, in m, rad and s.

    `lateral` is the velocity of a holonomic base to the left; covariances are the six values of the diagonal.
    `limited` is the twist after the limiters, `ackermann` the speed (rad/s) and the angle (rad) of the wheel that
    drives and steers; both are None if they are not published. With `only_twist` the ROS message has no pose.
    """

    x: float
    y: float
    heading: float
    linear: float = 0.0
    lateral: float = 0.0
    angular: float = 0.0
    frame_id: str = "odom"
    child_frame_id: str = "base_link"
    pose_covariance: list[float] = []
    twist_covariance: list[float] = []
    enable_odom_tf: bool = True
    limited: tuple[float, float] | None = None
    ackermann: tuple[float, float] | None = None
    only_twist: bool = False


class SteeringSample(OdometrySample, frozen=True, kw_only=True, tag="steering"):
    """Odometry of a steered base with the wheel states (control_msgs/SteeringControllerStatus).

    Wheels are in the order from right to left, in rad and rad/s; unknown values are null. Either positions or
    velocities of the traction wheels are measured.
    """

    traction_positions: list[float | None] = []
    traction_velocities: list[float | None] = []
    steering: list[float | None] = []
    traction_commands: list[float | None] = []
    steering_commands: list[float | None] = []


class MecanumSample(OdometrySample, frozen=True, kw_only=True, tag="mecanum"):
    """Odometry and wheel speeds of a base with mecanum wheels (control_msgs/MecanumDriveControllerState).

    `wheels` are the measured speeds in rad/s, counter-clockwise from the front left wheel, null if unknown; `reference`
    is the commanded twist: forward and to the left in m/s, and the rotation in rad/s, null without a command.
    """

    wheels: list[float | None] = []
    reference: list[float | None] = []


class JointStatesSample(Sample, frozen=True, kw_only=True, tag="joint_states"):
    """Joint states of a broadcaster by joint and interface; `names` is the order in JointState messages.

    "position", "velocity" and "effort" have the values of the interfaces that the broadcaster's parameters map to these
    names; all values of extra joints are 0.0.
    """

    names: tuple[str, ...]
    joints: dict[str, Values]


class GpioSample(Sample, frozen=True, kw_only=True, tag="gpio"):
    """Inputs and outputs of a GPIO controller, by part (a joint or a <gpio>) and interface."""

    parts: dict[str, Values]


class JointDiagnosis(msgspec.Struct, frozen=True):
    """Diagnosis of a joint; `level` is as in diagnostic_msgs, the diagnosis is based on `values`."""

    name: str
    level: int
    message: str
    values: Values = {}


class DiagnosticsSample(Sample, frozen=True, kw_only=True, tag="diagnostics"):
    """Diagnoses of the drives of a diagnostics broadcaster's joints."""

    joints: list[JointDiagnosis]


class TrajectoryPoint(msgspec.Struct, frozen=True, kw_only=True):
    """Point of a trajectory; each list has one value per joint or is empty, `time_from_start` is in s.

    Positions are in rad (m), velocities in rad/s, accelerations in rad/s^2, effort in Nm (N).
    """

    positions: list[float] = []
    velocities: list[float] = []
    accelerations: list[float] = []
    effort: list[float] = []
    time_from_start: float = 0.0


class TrajectorySample(Sample, frozen=True, kw_only=True, tag="trajectory"):
    """Desired and actual state of a trajectory's joints, the error between them, and the output to the hardware.

    `executing` is true while a goal is executed, `holding` while the joints hold their position.
    """

    joints: tuple[str, ...]
    executing: bool
    holding: bool
    reference: TrajectoryPoint
    feedback: TrajectoryPoint
    error: TrajectoryPoint
    output: TrajectoryPoint
    speed_scaling_factor: float = 1.0


class DofReading(msgspec.Struct, frozen=True, kw_only=True):
    """State of one degree of freedom of a PID controller (control_msgs/SingleDOFState); `time_step` is in s or null."""

    name: str
    reference: float | None
    feedback: float | None
    feedback_dot: float | None
    error: float | None
    error_dot: float | None
    time_step: float
    output: float | None


class PidSample(Sample, frozen=True, kw_only=True, tag="pid"):
    """References and errors of a PID controller (control_msgs/MultiDOFStateStamped)."""

    dofs: list[DofReading]


class GripperSample(Sample, frozen=True, kw_only=True, tag="gripper"):
    """State and target of a gripper in SI units; `target` is None while the gripper holds."""

    joint: str
    position: float | None
    velocity: float | None
    effort: float | None
    target: float | None
    executing: bool
    stalled: bool
    reached_goal: bool


class ImuSample(Sample, frozen=True, kw_only=True, tag="imu"):
    """Measurement of an IMU: `orientation` as (x, y, z, w), angular velocity in rad/s, acceleration in m/s^2.

    Covariances are matrices about x, y and z, row by row.
    """

    frame_id: str
    orientation: tuple[float | None, ...]
    angular_velocity: tuple[float | None, ...]
    linear_acceleration: tuple[float | None, ...]
    orientation_covariance: list[float] = []
    angular_velocity_covariance: list[float] = []
    linear_acceleration_covariance: list[float] = []


class RangeSample(Sample, frozen=True, kw_only=True, tag="range"):
    """Distance measured by a range sensor, in m; `radiation_type` is 0 for ultrasound, 1 for infrared."""

    frame_id: str
    range: float | None
    radiation_type: int = 0
    field_of_view: float = 0.0
    min_range: float = 0.0
    max_range: float = 0.0
    variance: float = 0.0


class WrenchSample(Sample, frozen=True, kw_only=True, tag="wrench"):
    """Forces along x, y and z in N, and torques about x, y and z in Nm."""

    frame_id: str
    force: tuple[float | None, ...]
    torque: tuple[float | None, ...]


class PoseSample(Sample, frozen=True, kw_only=True, tag="pose"):
    """Pose of a pose broadcaster: `position` in m, `orientation` as (x, y, z, w).

    `child_frame_id` is the frame at this pose, None if no transform is published.
    """

    frame_id: str
    position: tuple[float | None, ...]
    orientation: tuple[float | None, ...]
    child_frame_id: str | None = None


class BatteryReading(msgspec.Struct, frozen=True, kw_only=True):
    """State of a battery: V, degC, A (negative while discharging), Ah; `percentage` from 0 to 1.

    The enumerations are those of sensor_msgs/BatteryState, 0 is unknown. `name` is "" for the combination of all
    batteries.
    """

    name: str
    voltage: float | None = None
    temperature: float | None = None
    current: float | None = None
    charge: float | None = None
    capacity: float | None = None
    design_capacity: float | None = None
    percentage: float | None = None
    power_supply_status: int = 0
    power_supply_health: int = 0
    power_supply_technology: int = 0
    present: bool = False
    location: str = ""
    serial_number: str = ""


class BatteriesSample(Sample, frozen=True, kw_only=True, tag="batteries"):
    """States of a robot's batteries, and their combined state `together`."""

    batteries: list[BatteryReading]
    together: BatteryReading


ControllerSample: TypeAlias = (
    OdometrySample
    | SteeringSample
    | MecanumSample
    | JointStatesSample
    | GpioSample
    | DiagnosticsSample
    | TrajectorySample
    | PidSample
    | GripperSample
    | ImuSample
    | RangeSample
    | WrenchSample
    | PoseSample
    | BatteriesSample
)
"""All kinds of samples."""


def grown(kind: type[S], sample: Sample, **more: Any) -> S:  # noqa: ANN401 - fields of any type
    """Return a sample of the derived type `kind`, with the fields of `sample` and the further fields `more`."""
    return kind(**(msgspec.structs.asdict(sample) | more))


def stamped(message: M, time: float, **more: Any) -> M:  # noqa: ANN401 - fields of any type
    """Return a copy of a message with another `time`, and with the fields in `more` replaced."""
    return msgspec.structs.replace(message, time=time, **more)


def kind_of(sample: type[Sample]) -> str:
    """Return the value of the JSON key `kind` for a sample type."""
    return str(sample.__struct_config__.tag)
