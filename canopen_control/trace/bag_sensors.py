"""What broadcasters and grippers tell, as messages of a bag: IMU, range, wrench, pose, batteries, inputs and outputs.

The law of the file: names and types are those of the ROS bridge. A gripper's target is on `commands_out`, as that of a
forward controller: a name that nobody listens to. What is not known is nan.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, NamedTuple

from canopen_control.ros.conversions import unknown_as_nan
from canopen_control.rpc.messages.samples import (
    BatteriesSample,
    GpioSample,
    GripperSample,
    ImuSample,
    PoseSample,
    RangeSample,
    WrenchSample,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from canopen_control.rpc.messages.samples import BatteryReading, Sample
    from canopen_control.trace.bag_messages import BagMessages

__all__ = ["SENSORS", "Told"]


class Told(NamedTuple):
    """One row: the samples of a `kind` on a topic of their controller; `make` returns the message of one."""

    kind: type[Sample]
    topic: str
    make: Callable[[BagMessages, Any], object]


def _imu(ros: BagMessages, sample: ImuSample) -> object:
    covariances = (
        sample.orientation_covariance,
        sample.angular_velocity_covariance,
        sample.linear_acceleration_covariance,
    )
    around, turning, accelerating = map(ros.floats, covariances)
    return ros.make(
        "sensor_msgs/Imu",
        ros.header(sample.time, sample.frame_id),
        ros.make("geometry_msgs/Quaternion", *_known(sample.orientation)),
        around,
        ros.vector(*_known(sample.angular_velocity)),
        turning,
        ros.vector(*_known(sample.linear_acceleration)),
        accelerating,
    )


def _range(ros: BagMessages, sample: RangeSample) -> object:
    return ros.make(
        "sensor_msgs/Range",
        ros.header(sample.time, sample.frame_id),
        sample.radiation_type,
        sample.field_of_view,
        sample.min_range,
        sample.max_range,
        unknown_as_nan(sample.range),
        sample.variance,
    )


def _wrench(ros: BagMessages, sample: WrenchSample) -> object:
    force, torque = (ros.vector(*_known(each)) for each in (sample.force, sample.torque))
    wrench = ros.make("geometry_msgs/Wrench", force, torque)
    return ros.make("geometry_msgs/WrenchStamped", ros.header(sample.time, sample.frame_id), wrench)


def _pose(ros: BagMessages, sample: PoseSample) -> object:
    point = ros.make("geometry_msgs/Point", *_known(sample.position))
    pose = ros.make("geometry_msgs/Pose", point, ros.make("geometry_msgs/Quaternion", *_known(sample.orientation)))
    return ros.make("geometry_msgs/PoseStamped", ros.header(sample.time, sample.frame_id), pose)


def _gpio(ros: BagMessages, sample: GpioSample) -> object:
    values = [
        ros.make("control_msgs/InterfaceValue", list(each), ros.floats(_known(each.values())))
        for each in sample.parts.values()
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
        ros.floats(()),  # of cells nothing is known
        ros.floats(()),
        battery.location,
        battery.serial_number,
    )


def _together(ros: BagMessages, sample: BatteriesSample) -> object:
    return _battery(ros, sample.together, sample.time)


def _each(ros: BagMessages, sample: BatteriesSample) -> object:
    return ros.make("control_msgs/BatteryStateArray", [_battery(ros, each, sample.time) for each in sample.batteries])


def _gripper(ros: BagMessages, sample: GripperSample) -> object:
    layout = ros.make("std_msgs/MultiArrayLayout", [], 0)
    return ros.make("std_msgs/Float64MultiArray", layout, ros.floats((unknown_as_nan(sample.target),)))


def _known(values: Iterable[float | None]) -> list[float]:
    return [unknown_as_nan(each) for each in values]


SENSORS: Final = (
    Told(ImuSample, "imu", _imu),
    Told(RangeSample, "range", _range),
    Told(WrenchSample, "wrench", _wrench),
    Told(PoseSample, "pose", _pose),
    Told(BatteriesSample, "battery_state", _together),
    Told(BatteriesSample, "raw_battery_states", _each),
    Told(GpioSample, "gpio_states", _gpio),
    Told(GripperSample, "commands_out", _gripper),
)
"""All of them; one that a new kind of sample has gets a line here."""
