"""The parameters of ROS 1's Ackermann steering controller: those of a bicycle, one rear wheel and one front steer.

The law of the file (ros_controllers, noetic): that controller moves two joints under the type name that ROS 2 has for
four, so its keys tell which one is meant. Its names become those of the bicycle and each is named once; odometry is by
the wheel's position. What differs is told: a twist's `angular.z` is rad/s here and was the steering angle there, so
limits of it have no effect. Sizes that are not given are the description's, as there.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

from canopen_control.controllers.base_params import AxisLimits
from canopen_control.controllers.diff_drive_params import SwitchedLimits
from canopen_control.controllers.steering_params import BicycleParams
from canopen_control.yamlfile.convert import setting

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from canopen_control.controllers.base import Geometry
    from canopen_control.controllers.params import Params

__all__ = ["Ros1AckermannParams", "is_ros1", "read_ros1"]

_OWN: Final = ("rear_wheel", "front_steer", "wheel_separation_h")
_ANGLE: Final = (
    "angular.z of a twist is how fast it turns, in rad/s; the controller of ROS 1 took it as the angle of front_steer"
)


@dataclass(frozen=True)
class Ros1AckermannParams(BicycleParams):
    """What that controller has beside the bicycle's: two joints by their names, multipliers, limits of `linear.x`."""

    reference_timeout: float = setting(0.5, low=0.0, high=1e9)
    position_feedback: bool = True
    rear_wheel: str = "rear_wheel_joint"
    front_steer: str = "front_steer_joint"
    wheel_separation_h_multiplier: float = 1.0
    wheel_radius_multiplier: float = 1.0
    steer_pos_multiplier: float = 1.0
    linear: SwitchedLimits = setting(SwitchedLimits(), key="linear.x", section=True)  # noqa: RUF009 - it is a field

    @property
    def limits(self) -> tuple[AxisLimits, ...]:
        """The limits of `linear.x`, and none of `angular.z`."""
        return self.linear, AxisLimits()

    def as_bicycle(self) -> Ros1AckermannParams:
        """Return this with the joints and the sizes where the bicycle has them."""
        return replace(
            self,
            traction_joints_names=(self.rear_wheel,),
            steering_joints_names=(self.front_steer,),
            wheelbase=self.wheelbase * self.wheel_separation_h_multiplier,
            traction_wheel_radius=self.traction_wheel_radius * self.wheel_radius_multiplier,
        )

    def mistakes(self) -> Iterator[tuple[bool, str]]:
        """Say what is wrong, a multiplier of the measured angle too."""
        yield from super().mistakes()
        scale = "it scales what is measured alone; put the factor into scale_pos_from_dev and scale_pos_to_dev"
        yield self.steer_pos_multiplier != 1.0, f"steer_pos_multiplier is {self.steer_pos_multiplier:g}; {scale}"


_RENAMES: Final = {
    "wheel_separation_h": "wheelbase",
    "wheel_radius": "traction_wheel_radius",
    "cmd_vel_timeout": "reference_timeout",
    "linear.x.min_acceleration": "linear.x.max_acceleration_reverse",
    "publish_rate": "",  # odometry is published in every update
    "allow_multiple_cmd_vel_publishers": "",
    **{
        f"angular.z.{key}": ""
        for key in (
            *("has_velocity_limits", "has_acceleration_limits", "has_jerk_limits", "min_acceleration"),
            *(f"{bound}_{what}" for bound in ("min", "max") for what in ("velocity", "jerk")),
            "max_acceleration",
        )
    },
}


def is_ros1(params: Params) -> bool:
    """Whether the parameters are those of ROS 1's controller."""
    return any(params.flat.get(key) is not None for key in _OWN)


def read_ros1(
    params: Params, geometry: Geometry | None = None, tell: Callable[[str], object] = lambda _: None
) -> Ros1AckermannParams:
    """Return the parameters as a bicycle has them, not yet checked for what cannot be together.

    Sizes that are not given are those of the description's `geometry`; `tell` is told of each.
    """
    key = (
        params.flat.keys().get("front_steer")
        or params.flat.keys()[next(each for each in _OWN if params.flat.get(each))]
    )
    key.warning(_ANGLE)
    given = _completed(params.read(Ros1AckermannParams, _RENAMES), geometry, tell).as_bicycle()
    params.taken = given
    return given


def _completed(
    given: Ros1AckermannParams, geometry: Geometry | None, tell: Callable[[str], object]
) -> Ros1AckermannParams:
    if geometry is None:
        return given
    wheel, steer = (given.rear_wheel,), (given.front_steer,)
    if given.wheelbase <= 0.0 and (base := geometry.separation(wheel, steer)):
        tell(f"wheel_separation_h is not given, the description's is taken: {base:g} m")
        given = replace(given, wheelbase=base)
    if given.traction_wheel_radius <= 0.0 and (radius := geometry.radius(wheel)):
        tell(f"wheel_radius is not given, the description's is taken: {radius:g} m")
        given = replace(given, traction_wheel_radius=radius)
    return given
