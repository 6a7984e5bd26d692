"""Parameters of the controllers of omni and mecanum wheels, by the names of jazzy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from canopen_control.controllers.base_params import PrefixedParams, Six, TwistAxisLimits
from canopen_control.yamlfile.convert import setting

if TYPE_CHECKING:
    from collections.abc import Iterator


LEAST_WHEELS: Final = 3
_NONE: Final[Six] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class OmniParams(PrefixedParams):
    """Parameters of omni_wheel_drive_controller/OmniWheelDriveController, in units of m, s and rad."""

    pose_covariance_diagonal: Six = setting(
        _NONE, key="diagonal_covariance.pose", help="diagonal of the covariance of the odometry's pose"
    )
    twist_covariance_diagonal: Six = setting(
        _NONE, key="diagonal_covariance.twist", help="diagonal of the covariance of the odometry's twist"
    )
    wheel_names: tuple[str, ...] = setting(
        (), help="joints of the wheels, at least three, counterclockwise around the base"
    )
    wheel_offset: float | None = setting(
        None, help="angle in rad from straight ahead to the first wheel, seen from the centre of the base"
    )
    robot_radius: float = setting(0.0, low=0.0, help="distance in m from the centre of the base to a wheel")
    wheel_radius: float = setting(0.0, low=0.0, help="radius of the wheels in m")
    open_loop: bool = setting(
        False, help="whether to compute the odometry from the commands instead of the feedback of the wheels"
    )
    position_feedback: bool = setting(
        True, help="true: compute the odometry from wheel positions; false: from wheel velocities"
    )
    cmd_vel_timeout: float = setting(
        0.5,
        low=0.0,
        high=1e9,
        help="time in s after which a twist command expires; 0: a command is used for one update",
    )

    def mistakes(self) -> Iterator[tuple[bool, str]]:
        names = self.wheel_names
        yield (
            len(names) < LEAST_WHEELS,
            f"wheel_names has {len(names)} joints; give {LEAST_WHEELS} or more, counterclockwise around the base",
        )
        both = sorted({name for name in names if names.count(name) > 1})
        yield bool(both), f"wheel_names contains a name twice: {', '.join(both)}; list each name once"
        missing = "wheel_offset is missing; give the angle in rad of the first wheel, seen from the centre"
        yield self.wheel_offset is None, missing
        yield (
            self.robot_radius <= 0.0,
            "robot_radius is missing or 0; give the distance in m from the centre to a wheel",
        )
        yield self.wheel_radius <= 0.0, "wheel_radius is missing or 0; give it in m"


WHEELS: Final = ("front_left", "front_right", "rear_right", "rear_left")
"""Mecanum wheels, in the order of the interfaces."""
COMMANDED: Final = tuple(f"{wheel}_wheel_command_joint_name" for wheel in WHEELS)
_RADIUS: Final = "kinematics.wheels_radius"
_REACH: Final = "kinematics.sum_of_robot_center_projection_on_X_Y_axis"
_COVARIANCE: Final[Six] = (0.1, 0.1, 0.1, 0.1, 0.1, 0.1)


@dataclass(frozen=True)
class MecanumParams(PrefixedParams):
    """Parameters of mecanum_drive_controller/MecanumDriveController, in units of m, s and rad."""

    pose_covariance_diagonal: Six = _COVARIANCE
    twist_covariance_diagonal: Six = _COVARIANCE
    reference_timeout: float = setting(
        0.0,
        low=0.0,
        high=1e9,
        help="time in s after which a twist command expires; 0: a command is used for one update",
    )
    front_left_wheel_command_joint_name: str = setting("", help="command joint of the front left wheel")
    front_right_wheel_command_joint_name: str = setting("", help="command joint of the front right wheel")
    rear_right_wheel_command_joint_name: str = setting("", help="command joint of the rear right wheel")
    rear_left_wheel_command_joint_name: str = setting("", help="command joint of the rear left wheel")
    front_left_wheel_state_joint_name: str = setting(
        "", help="joint with the feedback of the front left wheel; empty: the command joint"
    )
    front_right_wheel_state_joint_name: str = setting(
        "", help="joint with the feedback of the front right wheel; empty: the command joint"
    )
    rear_right_wheel_state_joint_name: str = setting(
        "", help="joint with the feedback of the rear right wheel; empty: the command joint"
    )
    rear_left_wheel_state_joint_name: str = setting(
        "", help="joint with the feedback of the rear left wheel; empty: the command joint"
    )
    offset_x: float = setting(
        0.0,
        key="kinematics.base_frame_offset.x",
        help="distance in m forward from the centre of the wheels to the base frame",
    )
    offset_y: float = setting(
        0.0,
        key="kinematics.base_frame_offset.y",
        help="distance in m to the left from the centre of the wheels to the base frame",
    )
    offset_angle: float = setting(
        0.0, key="kinematics.base_frame_offset.theta", help="rotation of the base frame in rad, relative to the wheels"
    )
    radius: float = setting(0.0, key=_RADIUS, low=0.0, help="radius of the wheels in m")
    reach: float = setting(
        0.0, key=_REACH, low=0.0, help="distance in m from the centre to a wheel along x, plus that along y"
    )
    linear_x: TwistAxisLimits = setting(TwistAxisLimits(), key="linear.x", section=True)
    linear_y: TwistAxisLimits = setting(TwistAxisLimits(), key="linear.y", section=True)
    angular_z: TwistAxisLimits = setting(TwistAxisLimits(), key="angular.z", section=True)

    @property
    def commanded(self) -> tuple[str, ...]:
        """Commanded joints, in the order of `WHEELS`."""
        return tuple(getattr(self, key) for key in COMMANDED)

    @property
    def measured(self) -> tuple[str, ...]:
        """Joints with velocity feedback, in the order of `WHEELS`; by default the commanded joints."""
        names = (getattr(self, f"{wheel}_wheel_state_joint_name") for wheel in WHEELS)
        return tuple(name or joint for name, joint in zip(names, self.commanded, strict=True))

    @property
    def limits(self) -> tuple[TwistAxisLimits, ...]:
        """Limits of the twist axes: forward, to the left, and yaw."""
        return self.linear_x, self.linear_y, self.angular_z

    @property
    def offset(self) -> tuple[float, float, float]:
        """Pose of the base frame relative to the centre of the wheels: x and y in m, angle in rad."""
        return self.offset_x, self.offset_y, self.offset_angle

    def mistakes(self) -> Iterator[tuple[bool, str]]:
        for wheel, joint in zip(WHEELS, self.commanded, strict=True):
            yield not joint, f"no {wheel}_wheel_command_joint_name; give the joint of this wheel"
        joints = [joint for joint in self.commanded if joint]
        both = sorted({joint for joint in joints if joints.count(joint) > 1})
        yield bool(both), f"{', '.join(both)} is the joint of several wheels; give each wheel its own joint"
        yield self.radius <= 0.0, f"{_RADIUS} is missing or 0; give it in m"
        yield self.reach <= 0.0, f"{_REACH} is missing or 0; give the sum of a wheel's distances along x and y in m"
