"""The <sensor> tags supported by a world, and errors in them; MuJoCo is not needed."""

import sys

import pytest

from canopen_control.physics.physics_file import PhysicsError, SensorSettings
from canopen_control.physics.urdf_sensors import IMU, INTERFACES, RANGE, urdf_sensors
from canopen_control.urdf.document import ElementPlace
from canopen_control.urdf.ros2_control import ControlJoint

LINKS = ("base", "imu_link")


def part(*interfaces, name="one", **parameters):
    return ControlJoint(name, parameters, {}, dict.fromkeys(interfaces), None, ElementPlace(7, 5))


def found(*parts):
    return urdf_sensors(parts, LINKS, "base", "robot.urdf")


@pytest.mark.parametrize("kind", INTERFACES)
def test_the_kind_follows_from_the_interfaces(kind):
    assert found(part(*INTERFACES[kind])) == {"one": SensorSettings(kind, "base")}


def test_an_orientation_alone_is_an_imus_and_other_sensors_are_none_of_a_world():
    assert found(part("orientation.x"))["one"].kind == IMU
    assert found(part("temperature"), part(name="empty")) == {}


def test_link_noise_seed_and_reach_are_parameters():
    inputs = part("range", frame_id="imu_link", noise="0.5", seed="7", range_max="3")
    assert found(inputs) == {"one": SensorSettings(RANGE, "imu_link", 0.5, 3.0, 7)}


@pytest.mark.parametrize(
    ("parameters", "text"),
    [
        ({"noise": "-1"}, "noise is '-1'; it must be 0 or more"),
        ({"noise": "nan"}, "noise is 'nan'"),
        ({"noise": ""}, "noise is ''"),
        ({"seed": "1.5"}, "seed is '1.5'; it must be an integer from 0 to 2147483647"),
        ({"seed": "1e300"}, "seed is '1e300'; it must be an integer"),
        ({"seed": "inf"}, "seed is 'inf'"),
        ({"range_max": "0"}, "range_max is 0"),
        ({"frame_id": "imu_lnk"}, "no link 'imu_lnk' for its frame_id (did you mean 'imu_link'?)"),
        ({"mujoco_type": "sonar"}, "no mujoco_type 'sonar'; known: imu, fts, pose, magnetometer"),
        ({"mujoco_type": "imo"}, "no mujoco_type 'imo' (did you mean 'imu'"),
    ],
)
def test_what_is_wrong_is_reported_with_its_line(parameters, text):
    with pytest.raises(PhysicsError) as reported:
        found(part("range", **parameters))
    assert str(reported.value).startswith(f"robot.urdf:7:5: sensor one: {text}")


def test_reading_tags_does_not_need_mujoco():
    assert "mujoco" not in vars(sys.modules["canopen_control.physics.urdf_sensors"])
