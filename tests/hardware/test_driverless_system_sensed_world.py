import math

import pytest

from canopen_control.hardware.driverless_system import WorldSensors
from canopen_control.hardware.interfaces import OK
from canopen_control.urdf.ros2_control import ControlJoint

MS = 1_000_000


@pytest.fixture
def world():
    world = WorldSensors(
        "robot_world", [ControlJoint("imu", {}, {}, dict.fromkeys(["orientation.w", "orientation.x"]))]
    )
    world.configure()
    world.activate()
    return world


def values(world):
    return {interface.name: interface.value for interface in world.state_interfaces}


def test_nothing_is_known_until_the_world_reports_it(world):
    assert all(math.isnan(value) for value in values(world).values())
    world.take({"imu/orientation.w": 0.5, "other/range": 1.0})
    assert values(world)["imu/orientation.w"] == 0.5
    assert math.isnan(values(world)["imu/orientation.x"])


def test_what_is_not_reported_any_more_is_not_known_after_half_a_second(world):
    world.take({"imu/orientation.w": 1.0})
    for now in range(0, 501, 20):
        assert world.read(now * MS, 0.02) is OK
    assert values(world)["imu/orientation.w"] == 1.0
    world.read(520 * MS, 0.02)
    assert math.isnan(values(world)["imu/orientation.w"])
    world.take({"imu/orientation.w": 2.0})
    world.read(540 * MS, 0.02)
    assert values(world)["imu/orientation.w"] == 2.0


def test_it_commands_nothing_and_a_switch_or_a_stop_is_nothing_to_it(world):
    world.prepare_command_mode_switch([], [])
    world.perform_command_mode_switch([], [])
    world.reset("")
    world.deactivate()
    assert (list(world.command_interfaces), world.simulated_ns, world.write(0, 0.02)) == ([], None, OK)
