"""Sensors of the world on virtual drives with physics, in simulated time: the world measures, broadcasters tell."""

import math
import statistics

import pytest
from support.physicsrobot import PhysicsRobot
from support.robots import Bench, copy_robby

from canopen_control.physics.physics_file import PhysicsError
from canopen_control.runtime.physics_plant import SensedValues, sensed_world, world_sensors

IMU = [*(f"orientation.{axis}" for axis in "xyzw"), *(f"angular_velocity.{axis}" for axis in "xyz"),
       *(f"linear_acceleration.{axis}" for axis in "xyz")]  # fmt: skip
POSE = [*(f"position.{axis}" for axis in "xyz"), *(f"orientation.{axis}" for axis in "xyzw")]


def tags(noise="0", frame="base_link"):
    def sensor(name, interfaces, parameters):
        given = "".join(f'<param name="{key}">{value}</param>' for key, value in parameters.items())
        states = "".join(f'<state_interface name="{each}"/>' for each in interfaces)
        return f'<sensor name="{name}">{given}{states}</sensor>'

    imu = sensor("imu", IMU, {"frame_id": frame, "noise": noise, "seed": "3"})
    return f"{imu}{sensor('truth', POSE, {})}{sensor('other', ['voltage'], {})}"


def robby(folder, **how):
    description = {"  </ros2_control>": f"{tags(**how)}</ros2_control>"}
    controllers = {
        "    robby_forward_controller:\n      type": "    imu_broadcaster:\n"
        "      type: imu_sensor_broadcaster/IMUSensorBroadcaster\n\n    robby_forward_controller:\n      type",
        "robby_forward_controller:\n  ros__parameters:": "imu_broadcaster:\n"
        "  ros__parameters: {sensor_name: imu, frame_id: base_link}\n\nrobby_forward_controller:\n  ros__parameters:",
    }
    return copy_robby(folder, description=description, controllers=controllers)


@pytest.fixture
def robot(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    robot = PhysicsRobot("sensing", config=robby(tmp_path))
    robot.start()
    yield robot
    robot.close()


def told(robot):
    return {each.name: each.value for each in robot.robot.registry.state_interfaces}


def sense(robot):
    SensedValues(robot.robot.sensed, world_sensors(robot.setup)).take(robot.world.describe().sensors)


def test_what_the_world_measures_is_in_the_interfaces_and_is_broadcast(robot):
    assert math.isnan(told(robot)["imu/orientation.w"])
    robot.hold(10.0, 10.0, ms=1000)
    upward = []
    for _ in range(25):  # what an IMU tells at one moment has the chassis's rocking in it
        robot.hold(10.0, 10.0, ms=20)
        sense(robot)
        robot.run(40)
        values = told(robot)
        upward.append(values["imu/linear_acceleration.z"])
    assert statistics.mean(upward) == pytest.approx(9.81, abs=0.5)
    assert values["truth/position.x"] == pytest.approx(robot.world.describe().base.x, abs=0.02)
    assert values["truth/position.x"] > 0.1
    assert "other/voltage" not in values
    sample = robot.robot.manager.running.samples(0)["imu_broadcaster"]
    assert sample.linear_acceleration[2] == values["imu/linear_acceleration.z"]


def test_without_physics_there_is_nothing_to_measure(tmp_path):
    bench = Bench("unsensed", config=robby(tmp_path), drives=(), mock=True)
    try:
        assert world_sensors(bench.setup) == {}
        assert sensed_world(bench.setup, bench.setup.description.hardware[0]) is None
        assert not SensedValues(bench.robot.sensed, {}).wanted
    finally:
        bench.close()


def test_a_mistake_in_a_tag_is_told_before_anything_runs_with_its_line(tmp_path):
    with pytest.raises(PhysicsError, match=r"robby\.urdf\.xacro:\d+:\d+: sensor imu: no link 'base_lnk'"):
        PhysicsRobot("missensed", config=robby(tmp_path, frame="base_lnk"))
