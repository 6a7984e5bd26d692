"""The parameters of the broadcasters of sensors: IMU, range, force and torque, pose.

Keys, defaults and meaning are those of ros2_controllers (jazzy).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from canopen_control.controllers.params import CommonParams
from canopen_control.errors import RobotConfigError, nearest
from canopen_control.yamlfile.convert import setting

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = [
    "AXES",
    "POSE",
    "ForceTorqueParams",
    "ImuParams",
    "PoseParams",
    "PoseTransform",
    "RangeParams",
    "SensorParams",
]

AXES: Final = ("force.x", "force.y", "force.z", "torque.x", "torque.y", "torque.z")
POSE: Final = (*(f"position.{axis}" for axis in "xyz"), *(f"orientation.{axis}" for axis in "xyzw"))
_UNKNOWN: Final = (0.0,) * 9
_COVARIANCE: Final = 9


@dataclass(frozen=True)
class SensorParams(CommonParams):
    """Parameters of each: `sensor_name` is a <sensor> of the description, `frame_id` where its values are measured."""

    sensor_name: str = ""
    frame_id: str = ""

    def mistakes(self) -> Iterator[str]:
        """Yield what cannot be."""
        if not self.sensor_name:
            yield "no 'sensor_name'; give it under ros__parameters: sensor_name: imu"
        if not self.frame_id:
            yield "no 'frame_id'; give it under ros__parameters: frame_id: imu_link"

    def check(self, name: str) -> None:
        """Raise RobotConfigError with everything that cannot be; `name` is the controller's."""
        refuse_all(name, self.mistakes())


@dataclass(frozen=True)
class ImuParams(SensorParams):
    """Parameters of imu_sensor_broadcaster/IMUSensorBroadcaster; covariances row by row about x, y, z."""

    static_covariance_orientation: tuple[float, ...] = _UNKNOWN
    static_covariance_angular_velocity: tuple[float, ...] = _UNKNOWN
    static_covariance_linear_acceleration: tuple[float, ...] = _UNKNOWN

    def mistakes(self) -> Iterator[str]:
        """Yield what cannot be."""
        yield from super().mistakes()
        for what in ("orientation", "angular_velocity", "linear_acceleration"):
            given = getattr(self, f"static_covariance_{what}")
            if len(given) != _COVARIANCE or not all(map(math.isfinite, given)):
                yield f"static_covariance_{what} has {len(given)} numbers; give nine finite ones, row by row"


@dataclass(frozen=True)
class RangeParams(SensorParams):
    """Parameters of range_sensor_broadcaster/RangeSensorBroadcaster; rad and m, the variance in m^2."""

    radiation_type: int = setting(0, low=0, high=1)
    field_of_view: float = setting(0.52, low=0.0, high=2 * math.pi)
    min_range: float = 0.52
    max_range: float = 4.0
    variance: float = setting(0.0, low=0.0, high=1e9)


@dataclass(frozen=True)
class ForceTorqueParams(SensorParams):
    """Parameters of force_torque_sensor_broadcaster/ForceTorqueSensorBroadcaster, by "force.x" to "torque.z".

    The interfaces are those of `sensor_name`, or each by its own name; those that are not named are not known. N and
    Nm are published as (value + offset) * multiplier.
    """

    interface_names: dict[str, str] = setting(key="interface_names", section=True, factory=dict)  # noqa: RUF009 - makes a field
    offset: dict[str, float] = setting(key="offset", section=True, factory=dict)  # noqa: RUF009 - makes a field
    multiplier: dict[str, float] = setting(key="multiplier", section=True, factory=dict)  # noqa: RUF009 - makes a field

    @property
    def names(self) -> list[str]:
        """The six state interfaces in the order of `AXES`, "" for one that is not there."""
        if self.sensor_name:
            return [f"{self.sensor_name}/{axis}" for axis in AXES]
        return [self.interface_names.get(axis, "") for axis in AXES]

    def mistakes(self) -> Iterator[str]:
        """Yield what cannot be."""
        named = any(self.interface_names.values())
        if bool(self.sensor_name) == named:
            both = "both 'sensor_name' and interface_names" if named else "neither 'sensor_name' nor interface_names"
            yield f"{both}; give sensor_name for all six, or some of interface_names.force.x to torque.z"
        if not self.frame_id:
            yield "no 'frame_id'; give it under ros__parameters: frame_id: tool0"
        for key, given in (
            ("interface_names", self.interface_names),
            ("offset", self.offset),
            ("multiplier", self.multiplier),
        ):
            yield from (f"{key}.{each}{nearest(each, AXES)}" for each in given if each not in AXES)
        for key, numbers in (("offset", self.offset), ("multiplier", self.multiplier)):
            yield from (f"{key}.{axis} is {each}; give a finite number" for axis, each in numbers.items()
                        if not math.isfinite(each))  # fmt: skip


@dataclass(frozen=True)
class PoseTransform:
    """Whether a pose is a transform too, and to which frame; that of its name unless another is given."""

    enable: bool = True
    child_frame_id: str = ""
    publish_rate: float = setting(0.0, low=0.0)


@dataclass(frozen=True)
class PoseParams(CommonParams):
    """Parameters of pose_broadcaster/PoseBroadcaster: the state interfaces of `pose_name`, or each by its own name."""

    frame_id: str = ""
    pose_name: str = ""
    interface_names: dict[str, str] = setting(key="interface_names", section=True, factory=dict)  # noqa: RUF009 - makes a field
    tf: PoseTransform = setting(PoseTransform(), key="tf", section=True)  # noqa: RUF009 - makes a field

    @property
    def names(self) -> list[str]:
        """The seven state interfaces in the order of `POSE`."""
        if self.pose_name:
            return [f"{self.pose_name}/{each}" for each in POSE]
        return [self.interface_names[each] for each in POSE]

    @property
    def child_frame_id(self) -> str | None:
        """The frame whose transform a pose is, None where it is none."""
        return (self.tf.child_frame_id or self.pose_name or None) if self.tf.enable else None

    def mistakes(self) -> Iterator[str]:
        """Yield what cannot be."""
        named = any(self.interface_names.values())
        if bool(self.pose_name) == named:
            both = "both 'pose_name' and interface_names" if named else "neither 'pose_name' nor interface_names"
            yield f"{both}; give pose_name for all seven, or interface_names.position.x to orientation.w"
        elif named and (missing := [each for each in POSE if not self.interface_names.get(each)]):
            yield f"interface_names.{missing[0]} is missing; a pose has all of position.x to orientation.w"
        if not self.frame_id:
            yield "no 'frame_id'; give it under ros__parameters: frame_id: map"
        yield from (f"interface_names.{each}{nearest(each, POSE)}" for each in self.interface_names if each not in POSE)

    def check(self, name: str) -> None:
        """Raise RobotConfigError with everything that cannot be; `name` is the controller's."""
        refuse_all(name, self.mistakes())


def refuse_all(name: str, mistakes: Iterator[str]) -> None:
    """Raise RobotConfigError with all sentences, if there is one; `name` is the controller's."""
    if found := list(mistakes):
        raise RobotConfigError(f"{name}: {'; '.join(found)}")
