from __future__ import annotations

import math

import pytest
from support.control import Hardware, S, add, manager

from canopen_control.errors import UnknownInterface
from canopen_control.hardware.interfaces import ReturnType

IMU = "imu_sensor_broadcaster/IMUSensorBroadcaster"
RANGE = "range_sensor_broadcaster/RangeSensorBroadcaster"
WRENCH = "force_torque_sensor_broadcaster/ForceTorqueSensorBroadcaster"
AXES = ("force.x", "force.y", "force.z", "torque.x", "torque.y", "torque.z")
POSE = [*(f"position.{axis}" for axis in "xyz"), *(f"orientation.{axis}" for axis in "xyzw")]
OF_IMU = [f"orientation.{axis}" for axis in "xyzw"]
OF_IMU += [f"{what}.{axis}" for what in ("angular_velocity", "linear_acceleration") for axis in "xyz"]


def robot(type_name, states, activate=True, **params):
    """Return hardware, the manager and a broadcaster; each state is its number among them, the first one 1.0."""
    hardware = Hardware("l/velocity", states=tuple(states))
    for number, each in enumerate(hardware.state_interfaces, 1):
        each.value = float(number)
    control = manager(hardware)
    broadcaster = add(control, "b", type_name, frame_id="link", **params)
    if activate:
        control.switch(["b"], now=0)
    return hardware, control, broadcaster


def test_an_imu_is_told_with_the_names_of_ros2_control_and_its_covariances():
    covariance = [float(each) for each in range(9)]
    _, control, imu = robot(
        IMU, [f"imu/{each}" for each in reversed(OF_IMU)], sensor_name="imu", static_covariance_orientation=covariance
    )
    control.broadcast(S, 0.01)
    sample = imu.sample(0)
    assert (sample.time, sample.frame_id) == (1.0, "link")
    assert sample.orientation == (10.0, 9.0, 8.0, 7.0)
    assert sample.angular_velocity == (6.0, 5.0, 4.0)
    assert sample.linear_acceleration == (3.0, 2.0, 1.0)
    assert sample.orientation_covariance == covariance
    assert sample.angular_velocity_covariance == [0.0] * 9
    reading = control.list()[0]
    assert (reading.tells, reading.is_broadcaster, reading.frame_id) == ("imu", True, "link")


def test_a_range_is_told_with_what_is_known_of_the_sensor():
    hardware, control, sonar = robot(
        RANGE, ["sonar/range"], sensor_name="sonar", radiation_type=1, min_range=0.1, max_range=2.0, field_of_view=0.3
    )
    control.broadcast(S, 0.01)
    sample = sonar.sample(0)
    assert (sample.range, sample.radiation_type, sample.field_of_view) == (1.0, 1, 0.3)
    assert (sample.min_range, sample.max_range, sample.variance) == (0.1, 2.0, 0.0)
    hardware.set("sonar/range", math.nan)
    control.broadcast(2 * S, 0.01)
    assert sonar.sample(0).range is None


def test_forces_and_torques_have_their_offset_and_then_their_multiplier():
    _, control, wrist = robot(
        WRENCH,
        [f"wrist/{each}" for each in AXES],
        sensor_name="wrist",
        offset={"force": {"z": -1.0}, "torque": {"x": 0.5}},
        multiplier={"force": {"z": 10.0}, "torque": {"z": -1.0}},
    )
    control.broadcast(S, 0.01)
    sample = wrist.sample(0)
    assert sample.force == (1.0, 2.0, 20.0)
    assert sample.torque == (4.5, 5.0, -6.0)


def test_what_is_not_named_of_forces_and_torques_is_not_known():
    names = {"force": {"z": "scale/load"}, "torque": {"y": "arm/effort"}}
    _, control, scale = robot(WRENCH, ["arm/effort", "scale/load"], interface_names=names)
    assert control.list()[0].required_state_interfaces == ("scale/load", "arm/effort")
    sample = scale.sample(0)
    assert sample.force == (None, None, 2.0)
    assert sample.torque == (None, 1.0, None)


@pytest.mark.parametrize(
    ("type_name", "states", "missing"),
    [
        (IMU, [f"s/{each}" for each in OF_IMU[1:]], "s/orientation.x"),
        (RANGE, ["s/distance"], "s/range"),
        (WRENCH, [f"s/{each}" for each in AXES[:5]], "s/torque.z"),
    ],
)
def test_an_interface_that_is_not_there_keeps_it_from_being_activated(type_name, states, missing):
    _, control, _ = robot(type_name, states, activate=False, sensor_name="s")
    with pytest.raises(UnknownInterface, match=missing):
        control.switch(["b"], now=0)
    assert control.states == {"b": "inactive"}


@pytest.mark.parametrize(("type_name", "states"), [(IMU, OF_IMU), (RANGE, ["range"]), (WRENCH, AXES)])
def test_it_claims_nothing_and_publishes_once_per_update(type_name, states):
    hardware, control, broadcaster = robot(type_name, [f"s/{each}" for each in states], sensor_name="s")
    assert broadcaster.sample(0).time == 0.0
    hardware.state_interfaces[0].value = 77.0
    control.update(S, 0.01)
    assert broadcaster.sample(0).time == 0.0
    assert broadcaster.update(2 * S, 0.01) is ReturnType.OK
    assert broadcaster.sample(0).time == 2.0
    assert "77.0" in str(broadcaster.sample(0))
    assert control.list()[0].claims == ()


def test_a_pose_is_told_with_the_frame_whose_transform_it_is():
    states = [f"gps/{each}" for each in POSE]
    hardware, control, gps = robot("pose_broadcaster/PoseBroadcaster", states, pose_name="gps")
    control.broadcast(S, 0.01)
    sample = gps.sample(0)
    assert (sample.position, sample.orientation) == ((1.0, 2.0, 3.0), (4.0, 5.0, 6.0, 7.0))
    assert (sample.frame_id, sample.child_frame_id) == ("link", "gps")
    hardware.set("gps/position.y", math.nan)
    control.broadcast(2 * S, 0.01)
    assert gps.sample(0).position == (1.0, None, 3.0)


def test_a_pose_of_interfaces_by_their_names_is_no_transform_unless_its_frame_is_named():
    names = {"position": dict(zip("xyz", ("a/x", "a/y", "a/z"), strict=True)),
             "orientation": dict(zip("xyzw", ("b/i", "b/j", "b/k", "b/w"), strict=True))}  # fmt: skip
    states = [each for part in names.values() for each in part.values()]
    kind = "pose_broadcaster/PoseBroadcaster"
    _, _, pose = robot(kind, states, interface_names=names)
    assert pose.sample(0).child_frame_id is None
    _, control, pose = robot(kind, states, interface_names=names, tf={"child_frame_id": "base", "publish_rate": 5.0})
    assert pose.sample(0).child_frame_id == "base"
    assert any("tf.publish_rate has no effect" in each.text for each in control.events())
    _, _, pose = robot(kind, states, interface_names=names, tf={"child_frame_id": "base", "enable": False})
    assert pose.sample(0).child_frame_id is None
