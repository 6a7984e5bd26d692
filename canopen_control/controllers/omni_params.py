"""The parameters of the omni wheel drive controller, in jazzy's words."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from canopen_control.controllers.base_params import PrefixedParams, Six
from canopen_control.yamlfile.convert import setting

if TYPE_CHECKING:
    from collections.abc import Iterator


LEAST_WHEELS: Final = 3
_NONE: Final[Six] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class OmniParams(PrefixedParams):
    """Parameters of omni_wheel_drive_controller/OmniWheelDriveController: m, s, rad."""

    pose_covariance_diagonal: Six = setting(_NONE, key="diagonal_covariance.pose", help="of the odometry's pose")
    twist_covariance_diagonal: Six = setting(_NONE, key="diagonal_covariance.twist", help="of the odometry's twist")
    wheel_names: tuple[str, ...] = setting(
        (), help="joints of the wheels, three or more, around the base against the clock"
    )
    wheel_offset: float | None = setting(None, help="rad from straight ahead to the first wheel, seen from the middle")
    robot_radius: float = setting(0.0, low=0.0, help="m from the middle to a wheel")
    wheel_radius: float = setting(0.0, low=0.0, help="m")
    open_loop: bool = setting(False, help="odometry from the commands instead of the wheels")
    position_feedback: bool = setting(True, help="odometry from positions, else from velocities of the wheels")
    cmd_vel_timeout: float = setting(
        0.5, low=0.0, high=1e9, help="s after which a twist ends; 0: it counts for one update"
    )

    def mistakes(self) -> Iterator[tuple[bool, str]]:
        """Return the checks with their results."""
        names = self.wheel_names
        yield (
            len(names) < LEAST_WHEELS,
            f"wheel_names has {len(names)} joints; give {LEAST_WHEELS} or more, around the base against the clock",
        )
        both = sorted({name for name in names if names.count(name) > 1})
        yield bool(both), f"wheel_names names one twice: {', '.join(both)}; name each once"
        missing = "wheel_offset is missing; give the angle of the first wheel, seen from the middle, in rad"
        yield self.wheel_offset is None, missing
        yield (
            self.robot_radius <= 0.0,
            "robot_radius is missing or 0; give the distance of the wheels from the middle in m",
        )
        yield self.wheel_radius <= 0.0, "wheel_radius is missing or 0; give it in m"
