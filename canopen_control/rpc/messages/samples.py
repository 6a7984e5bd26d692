"""Samples of controllers: one structure per kind, distinguished by its `kind`.

A sample belongs to its controller's last publication: all readers see the same stamps with the same values. SI units,
None if unknown. A new kind is a structure here and a member of `ControllerSample`.
"""

from __future__ import annotations

from typing import Any, TypeAlias, TypeVar

import msgspec

Values: TypeAlias = dict[str, float | None]
S = TypeVar("S", bound="Sample")
M = TypeVar("M", bound=msgspec.Struct)


class Sample(msgspec.Struct, frozen=True, kw_only=True, tag_field="kind", tag="none"):
    """Common fields of all samples: `time` of the publication in Unix s."""

    time: float


class OdometrySample(Sample, frozen=True, kw_only=True, tag="odometry"):
    """Pose of a base controller by odometry.

    Metres, rad, seconds; `lateral` is to the left, of a holonomic base; each covariance by the six values of its
    diagonal. `limited` is the twist after the limits if it is published; `ackermann` is the speed (rad/s) and the angle
    (rad) of the wheel that drives and steers, likewise. With `only_twist` the message for ROS has no pose.
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
    """Odometry of a steered base, and its wheels from right to left (control_msgs/SteeringControllerStatus).

    rad and rad/s, null is unknown; of traction positions or velocities are measured.
    """

    traction_positions: list[float | None] = []
    traction_velocities: list[float | None] = []
    steering: list[float | None] = []
    traction_commands: list[float | None] = []
    steering_commands: list[float | None] = []


class MecanumSample(OdometrySample, frozen=True, kw_only=True, tag="mecanum"):
    """Odometry of a base with mecanum wheels, and the wheels (control_msgs/MecanumDriveControllerState).

    `wheels` are the measured speeds in rad/s, counter-clockwise from the front left one, null is unknown; `reference`
    is the commanded twist, forward, to the left (m/s) and turning (rad/s), null without one.
    """

    wheels: list[float | None] = []
    reference: list[float | None] = []


class JointStatesSample(Sample, frozen=True, kw_only=True, tag="joint_states"):
    """Sample of a joint state broadcaster: values by joint and name; `names` is the order of a JointState.

    "position", "velocity" and "effort" are what its parameters map to these, an extra joint's are 0.0.
    """

    names: tuple[str, ...]
    joints: dict[str, Values]


class GpioSample(Sample, frozen=True, kw_only=True, tag="gpio"):
    """Inputs and outputs: values by part (a joint or a <gpio>) and name."""

    parts: dict[str, Values]


class JointDiagnosis(msgspec.Struct, frozen=True):
    """Diagnosis of a joint: `level` as in diagnostic_msgs, and the `values` it is based on."""

    name: str
    level: int
    message: str
    values: Values = {}


class DiagnosticsSample(Sample, frozen=True, kw_only=True, tag="diagnostics"):
    """Diagnosis of the drives of the joints."""

    joints: list[JointDiagnosis]


class TrajectoryPoint(msgspec.Struct, frozen=True, kw_only=True):
    """Trajectory point: one value per joint, or none; `time_from_start` in s.

    Positions in rad (m), velocities in rad/s, accelerations in rad/s^2, effort in Nm (N).
    """

    positions: list[float] = []
    velocities: list[float] = []
    accelerations: list[float] = []
    effort: list[float] = []
    time_from_start: float = 0.0


class TrajectorySample(Sample, frozen=True, kw_only=True, tag="trajectory"):
    """Desired and actual state of a trajectory's joints, and the error.

    `executing` is true while a goal is executed, `holding` while the joints are held.
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
    """Degree of freedom of a PID (control_msgs/SingleDOFState): SI units, `time_step` in s, null for unknown."""

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
    """Position and target of a gripper: rad or m, rad/s or m/s, Nm or N; `target` None while it holds."""

    joint: str
    position: float | None
    velocity: float | None
    effort: float | None
    target: float | None
    executing: bool
    stalled: bool
    reached_goal: bool


class ImuSample(Sample, frozen=True, kw_only=True, tag="imu"):
    """IMU measurement: `orientation` as (x, y, z, w), rad/s and m/s^2; covariances row by row about x, y, z."""

    frame_id: str
    orientation: tuple[float | None, ...]
    angular_velocity: tuple[float | None, ...]
    linear_acceleration: tuple[float | None, ...]
    orientation_covariance: list[float] = []
    angular_velocity_covariance: list[float] = []
    linear_acceleration_covariance: list[float] = []


class RangeSample(Sample, frozen=True, kw_only=True, tag="range"):
    """Distance in m, and the sensor: `radiation_type` 0 ultrasound, 1 infrared, `field_of_view` in rad."""

    frame_id: str
    range: float | None
    radiation_type: int = 0
    field_of_view: float = 0.0
    min_range: float = 0.0
    max_range: float = 0.0
    variance: float = 0.0


class WrenchSample(Sample, frozen=True, kw_only=True, tag="wrench"):
    """Forces in N along x, y, z and torques in Nm about them."""

    frame_id: str
    force: tuple[float | None, ...]
    torque: tuple[float | None, ...]


class PoseSample(Sample, frozen=True, kw_only=True, tag="pose"):
    """Pose: `position` in m, `orientation` as (x, y, z, w).

    `child_frame_id` is the frame whose transform that is, None where it is none.
    """

    frame_id: str
    position: tuple[float | None, ...]
    orientation: tuple[float | None, ...]
    child_frame_id: str | None = None


class BatteryReading(msgspec.Struct, frozen=True, kw_only=True):
    """Battery state: V, degC, A (negative while discharging), Ah; `percentage` from 0 to 1.

    The enums are those of sensor_msgs/BatteryState, 0 is unknown. `name` is empty for all of them as one.
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
    """Batteries of a robot, and all of them combined."""

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
"""What a controller may tell."""


def grown(kind: type[S], sample: Sample, **more: Any) -> S:  # noqa: ANN401 - fields of any type
    """Return a sample of a derived kind with the fields of another one and `more`."""
    return kind(**(msgspec.structs.asdict(sample) | more))


def stamped(message: M, time: float, **more: Any) -> M:  # noqa: ANN401 - fields of any type
    """Return a copy of a message with another `time` and `more` fields."""
    return msgspec.structs.replace(message, time=time, **more)


def kind_of(sample: type[Sample]) -> str:
    """Return the `kind` of a type of sample on the wire."""
    return str(sample.__struct_config__.tag)
