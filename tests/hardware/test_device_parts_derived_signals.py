"""Velocity of an encoder and orientation of an inclinometer, on robots with virtual ones."""

import math

import pytest
from support.devices import DeviceBench, with_device

STATES = {
    406: ("position", "position_absolute", "velocity"),
    410: ("longitudinal", "lateral", *(f"orientation.{axis}" for axis in "xyzw"), "angular_velocity.x"),
    404: ("ai0", "ai1", "status0"),
    418: ("battery_voltage", "battery_temperature", "battery_percentage", "0x6081"),
}


@pytest.fixture
def robot(tmp_path, request):
    number = request.param
    config = with_device(tmp_path, f"generic_cia{number}.eds", STATES[number], tag="sensor")
    bench = DeviceBench(f"sensor-{number}", config)
    yield bench
    bench.close()


def states(bench, *names):
    return [bench.state(f"io/{name}") for name in names]


@pytest.mark.parametrize("robot", [406], indirect=True)
def test_an_encoder_goes_on_beyond_its_range_and_tells_its_velocity(robot):
    turns = math.tau * 4095.75
    robot.set(position=turns)
    robot.start()
    assert states(robot, "position")[0] == pytest.approx(turns)
    robot.set(position=turns + 1.0, velocity=2.0)
    robot.run(1000)
    position, absolute, velocity = states(robot, *STATES[406])
    assert position == pytest.approx(turns + 3.0, abs=0.1)
    assert absolute == pytest.approx((turns + 3.0) % (math.tau * 4096), abs=0.1)
    assert velocity == pytest.approx(2.0, abs=0.2)
    robot.set(velocity=0.0)
    robot.run(300)
    assert states(robot, "velocity") == [0.0]


@pytest.mark.parametrize("robot", [406], indirect=True)
def test_an_encoder_that_is_silent_is_unknown(robot):
    robot.start()
    robot.power_off(robot.device_id)
    robot.run(200)  # before the heartbeat is missed
    assert all(math.isnan(each) for each in states(robot, *STATES[406]))


@pytest.mark.parametrize("robot", [410], indirect=True)
def test_two_angles_are_an_orientation_without_heading(robot):
    robot.start()
    robot.set(lateral=0.2, longitudinal=-0.1)
    robot.run(100)
    x, y, z, w = states(robot, *(f"orientation.{axis}" for axis in "xyzw"))
    assert x * x + y * y + z * z + w * w == pytest.approx(1.0)
    assert math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)) == pytest.approx(0.2, abs=2e-4)
    assert math.asin(2 * (w * y - z * x)) == pytest.approx(-0.1, abs=2e-4)
    assert math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)) == pytest.approx(0.0, abs=1e-9)
    assert math.isnan(states(robot, "angular_velocity.x")[0])


@pytest.mark.parametrize("robot", [404], indirect=True)
def test_a_measured_value_with_a_status_is_none(robot):
    robot.start()
    robot.set(ai0=21.5, ai1=3.3)
    robot.run(60)
    assert states(robot, "ai0", "ai1") == [pytest.approx(21.5), pytest.approx(3.3)]
    robot.set(status0=1)
    robot.run(60)
    assert math.isnan(states(robot, "ai0")[0])
    assert states(robot, "ai1", "status0") == [pytest.approx(3.3), 1.0]


@pytest.mark.parametrize("robot", [418], indirect=True)
def test_a_battery_is_told_in_units(robot):
    robot.start()
    robot.run(1100)
    assert states(robot, *STATES[418]) == [pytest.approx(25.6, abs=1e-3), 25.0, 80.0, 80.0]


def test_an_encoder_that_jumps_is_told_once_and_has_neither_position_nor_velocity(tmp_path):
    keys = {"signals": [{"name": "position", "max_rate": 20.0}]}
    bench = DeviceBench("sensor-jump", with_device(tmp_path, "generic_cia406.eds", ("position", "velocity"), keys=keys))
    try:
        bench.start()
        bench.set(velocity=10.0)
        bench.run(500)
        assert bench.state("io/position") == pytest.approx(5.0, abs=0.5)
        bench.device.switches.set("input_jump", True, bench.reactor.now())
        bench.run(100)
        assert math.isnan(bench.state("io/position"))
        assert math.isnan(bench.state("io/velocity"))
        (told,) = bench.texts("input_jumped")
        assert told.startswith("node 5 (io): io/position jumped from")
    finally:
        bench.close()
