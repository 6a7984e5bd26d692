"""Lidars and cameras among the tags of a simulation plugin: parameters of mujoco_ros2_control, and what is wrong."""

import pytest

from canopen_control.physics.physics_file import PhysicsError
from canopen_control.physics.plugin_robot import LidarSettings, camera_notes, tag_lidars
from canopen_control.urdf.document import Place
from canopen_control.urdf.ros2_control import ControlJoint, Ros2ControlSystem

ANGLES = {"min_angle": "-1.5", "max_angle": "1.5", "angle_increment": "0.5"}


def found(parameters, **hardware):
    part = ControlJoint("lidar", parameters, place=Place(7, 5))
    return tag_lidars(Ros2ControlSystem("robot", "system", "plugin", hardware, (), (part,)), "base", "robot.urdf")


def test_what_is_not_said_is_as_upstream_has_it():
    (lidar,) = found(ANGLES)
    expected = LidarSettings("lidar", "base", "/scan", -1.5, 1.5, 0.5, 0.0, 1000.0, 5.0, 0.0, 0, "robot.urdf:7:5")
    assert (lidar, lidar.count) == (expected, 7)


def test_everything_can_be_said():
    more = {"frame_name": "laser", "range_min": "0.1", "range_max": "8", "laserscan_topic": "/front", "noise": "0.01",
            "seed": "3"}  # fmt: skip
    (lidar,) = found(ANGLES | more, lidar_publish_rate="20")
    assert (lidar.frame, lidar.topic, lidar.range_min, lidar.range_max) == ("laser", "/front", 0.1, 8.0)
    assert (lidar.rate, lidar.noise, lidar.seed) == (20.0, 0.01, 3)


def test_other_sensors_are_none():
    assert found({"frame_id": "base"}) == []


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"min_angle": "left"}, "min_angle is 'left'; it is a finite number"),
        ({"max_angle": "inf"}, "max_angle is 'inf'"),
        ({"max_angle": "-2"}, "max_angle -2 is below min_angle -1.5"),
        ({"angle_increment": "0"}, "angle_increment is 0; it is above 0"),
        ({"angle_increment": "-0.1"}, "angle_increment is -0.1"),
        ({"angle_increment": "1e-5"}, "it has 300001 rays; 10000 are the most"),
        ({"angle_increment": "1e-320"}, "rays; 10000 are the most"),
        ({"range_min": "5", "range_max": "5"}, "range_min is from 0 and below range_max"),
        ({"noise": "-1"}, "noise is -1; it is a number from 0"),
        ({"seed": "0.5"}, "seed is a whole number from 0"),
        ({"laserscan_topic": " "}, "laserscan_topic is empty"),
    ],
)
def test_what_is_wrong_is_told_with_its_place(changed, said):
    with pytest.raises(PhysicsError) as told:
        found(ANGLES | changed)
    assert str(told.value).startswith("robot.urdf:7:5: sensor lidar: ")
    assert said in str(told.value)


def test_all_that_is_missing_is_told_at_once_and_a_rate_that_is_none():
    with pytest.raises(PhysicsError) as told:
        found({"min_angle": "0"})
    assert [line.split(": ")[2].split(";")[0] for line in str(told.value).splitlines()] == [
        "no max_angle",
        "no angle_increment",
    ]
    with pytest.raises(PhysicsError, match="lidar_publish_rate of its hardware is 0"):
        found(ANGLES, lidar_publish_rate="0")


def test_each_camera_is_told_once():
    parts = [ControlJoint("eye", {"image_topic": "/eye"}), ControlJoint("other", {"mujoco_type": "camera"})]
    notes = camera_notes([*parts, ControlJoint("imu")], ["eye", "scene"])
    assert [note.split()[1] for note in notes] == ["eye", "other", "scene"]
    assert all("OpenGL" in note for note in notes)
