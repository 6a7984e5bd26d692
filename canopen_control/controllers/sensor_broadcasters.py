"""Broadcasters of sensors: IMU, range, force and torque, pose, over the state interfaces of a <sensor> of any hardware.

The law of the file (ros2_controllers, Jazzy): the names of the interfaces are fixed (`orientation.x`, `range`,
`force.x` ...), and a broadcaster is not activated before all that it reads are there; a force-torque broadcaster whose
interfaces are named one by one tells nothing (nan) of the others. A value is what the interface is at the update, nan
while the hardware does not know it.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, ClassVar, Final

from canopen_control.controllers.base import Controller
from canopen_control.controllers.sensor_params import (
    AXES,
    ForceTorqueParams,
    ImuParams,
    PoseParams,
    RangeParams,
    SensorParams,
)
from canopen_control.controllers.state_copy import finite
from canopen_control.hardware.interfaces import OK, ReturnType
from canopen_control.rpc.messages.samples import ImuSample, PoseSample, RangeSample, WrenchSample

if TYPE_CHECKING:
    from canopen_control.controllers.params import Params
    from canopen_control.hardware.interfaces import CommandInterface, StateInterface
    from canopen_control.rpc.messages.samples import Sample

__all__ = [
    "ForceTorqueSensorBroadcaster",
    "IMUSensorBroadcaster",
    "PoseBroadcaster",
    "RangeSensorBroadcaster",
    "SensorBroadcaster",
]

_IMU: Final = (
    *(f"orientation.{axis}" for axis in "xyzw"),
    *(f"angular_velocity.{axis}" for axis in "xyz"),
    *(f"linear_acceleration.{axis}" for axis in "xyz"),
)


class SensorBroadcaster(Controller):
    """Copies state interfaces by their places; "" is one that is not there."""

    is_broadcaster: ClassVar[bool] = True
    moves_joints: ClassVar[bool] = False

    def __init__(self, name: str, type_name: str = "") -> None:
        super().__init__(name, type_name)
        self._names: list[str] = []
        self._sources: list[tuple[int, StateInterface]] = []
        self._values: list[float] = []

    def state_interface_names(self) -> list[str]:
        """Return all that it reads."""
        return [each for each in self._names if each]

    def on_activate(self, commands: list[CommandInterface], states: list[StateInterface], now: int) -> None:
        """Take the interfaces, and publish what they are."""
        super().on_activate(commands, states, now)
        by_name = {each.name: each for each in states}
        self._values = [math.nan] * len(self._names)
        self._sources = [(place, by_name[each]) for place, each in enumerate(self._names) if each]
        self.update(now, 0.0)

    def update(self, now: int, period: float) -> ReturnType:
        """Copy the states: a publication."""
        del period
        for place, source in self._sources:
            self._values[place] = source.value
        self.stamp = now
        return OK

    def _set_up(self, given: SensorParams | PoseParams, names: list[str]) -> None:
        """Take checked parameters."""
        given.check(self.name)
        self.update_rate, self.frame_id, self._names = given.update_rate, given.frame_id, names

    def _known(self, first: int, last: int) -> tuple[float | None, ...]:
        """Return some of the values at the last update, None for what is not known."""
        return tuple(finite(each) for each in self._values[first:last])


class IMUSensorBroadcaster(SensorBroadcaster):
    """Tells orientation, angular velocity and linear acceleration of an IMU."""

    tells: ClassVar[type[Sample] | None] = ImuSample

    def __init__(self, name: str, type_name: str = "") -> None:
        super().__init__(name, type_name)
        self.params = ImuParams()

    def on_configure(self, params: Params) -> None:
        """Read the parameters; RobotConfigError with everything that is wrong in them."""
        self.params = params.read(ImuParams)
        self._set_up(self.params, [f"{self.params.sensor_name}/{each}" for each in _IMU])

    def sample(self, wall_offset_ns: int) -> ImuSample:
        """Return what was measured at the last update."""
        given = self.params
        return ImuSample(
            time=self.published(wall_offset_ns),
            frame_id=self.frame_id,
            orientation=self._known(0, 4),
            angular_velocity=self._known(4, 7),
            linear_acceleration=self._known(7, 10),
            orientation_covariance=list(given.static_covariance_orientation),
            angular_velocity_covariance=list(given.static_covariance_angular_velocity),
            linear_acceleration_covariance=list(given.static_covariance_linear_acceleration),
        )


class RangeSensorBroadcaster(SensorBroadcaster):
    """Tells the distance that one sensor measures."""

    tells: ClassVar[type[Sample] | None] = RangeSample

    def __init__(self, name: str, type_name: str = "") -> None:
        super().__init__(name, type_name)
        self.params = RangeParams()

    def on_configure(self, params: Params) -> None:
        """Read the parameters; RobotConfigError with everything that is wrong in them."""
        self.params = params.read(RangeParams)
        self._set_up(self.params, [f"{self.params.sensor_name}/range"])

    def sample(self, wall_offset_ns: int) -> RangeSample:
        """Return what was measured at the last update."""
        given = self.params
        return RangeSample(
            time=self.published(wall_offset_ns),
            frame_id=self.frame_id,
            range=finite(self._values[0]),
            radiation_type=given.radiation_type,
            field_of_view=given.field_of_view,
            min_range=given.min_range,
            max_range=given.max_range,
            variance=given.variance,
        )


class ForceTorqueSensorBroadcaster(SensorBroadcaster):
    """Tells forces and torques along and about three axes."""

    tells: ClassVar[type[Sample] | None] = WrenchSample

    def __init__(self, name: str, type_name: str = "") -> None:
        super().__init__(name, type_name)
        self._scales: list[tuple[float, float]] = []

    def on_configure(self, params: Params) -> None:
        """Read the parameters; RobotConfigError with everything that is wrong in them."""
        given = params.read(ForceTorqueParams)
        self._set_up(given, given.names)
        self._scales = [(given.offset.get(axis, 0.0), given.multiplier.get(axis, 1.0)) for axis in AXES]

    def update(self, now: int, period: float) -> ReturnType:
        """Copy the states, with offset and multiplier: a publication."""
        super().update(now, period)
        for place, source in self._sources:
            offset, factor = self._scales[place]
            self._values[place] = (source.value + offset) * factor
        return OK

    def sample(self, wall_offset_ns: int) -> WrenchSample:
        """Return what was measured at the last update."""
        return WrenchSample(
            time=self.published(wall_offset_ns),
            frame_id=self.frame_id,
            force=self._known(0, 3),
            torque=self._known(3, 6),
        )


class PoseBroadcaster(SensorBroadcaster):
    """Tells a position and an orientation, and the transform that they are."""

    tells: ClassVar[type[Sample] | None] = PoseSample

    def __init__(self, name: str, type_name: str = "") -> None:
        super().__init__(name, type_name)
        self.params = PoseParams()

    def on_configure(self, params: Params) -> None:
        """Read the parameters; RobotConfigError with everything that is wrong in them."""
        self.params = given = params.read(PoseParams)
        given.check(self.name)
        self._set_up(given, given.names)
        if given.tf.publish_rate:
            self.tell(
                "parameter", "tf.publish_rate has no effect: a transform goes out at every update; set update_rate"
            )

    def sample(self, wall_offset_ns: int) -> PoseSample:
        """Return what was measured at the last update."""
        return PoseSample(
            time=self.published(wall_offset_ns),
            frame_id=self.frame_id,
            position=self._known(0, 3),
            orientation=self._known(3, 7),
            child_frame_id=self.params.child_frame_id,
        )
