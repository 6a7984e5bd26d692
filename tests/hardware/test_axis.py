"""An axis' process data, found by the profile's indices."""

import pytest
from support.generic import write_generic
from support.robots import Bench

from canopen_control.hardware.axis import AxisLimits


@pytest.fixture
def servo(tmp_path):
    bench = Bench("axis", config=write_generic(tmp_path), drives=(2, 3), controllers=["velocity"])
    bench.start()
    yield bench
    bench.close()


def test_limits_are_applied_in_device_units():
    limits = AxisLimits()
    assert limits.of_velocity(-(1 << 31) + 1) == -(1 << 31) + 1
    limits.velocity, limits.low, limits.high = 100.0, -5, 7
    limits.torque_positive, limits.torque_negative = 30, 20
    assert [limits.of_velocity(raw) for raw in (-200, -50, 50, 200)] == [-100, -50, 50, 100]
    assert [limits.of_position(raw) for raw in (-9, 0, 9)] == [-5, 0, 7]
    assert [limits.of_torque(raw) for raw in (-99, 0, 99)] == [-20, 0, 30]
    limits.blocked = 1
    assert [limits.of_velocity(raw) for raw in (-50, 50)] == [-50, 0]


def test_what_is_held_is_standstill_at_a_position(servo):
    axis = servo.joint(2).axis
    axis.hold(1234)
    assert axis.output(0x607A).value == axis.output(0x60C1, 1).value == 1234
    assert axis.output(0x60FF).value == axis.output(0x6071).value == axis.output(0x6042).value == 0


def test_other_targets_stay_with_the_axis_while_one_is_used(servo):
    servo.robot.command("velocity", [1.0, 1.0], "test")
    servo.run(500)
    axis = servo.joint(2).axis
    assert axis.output(0x60FF).value == 10430
    assert axis.output(0x607A).value == pytest.approx(axis.raw_position, abs=1500)
    assert axis.raw_position > 1000


def test_it_is_stale_when_a_tpdo_of_its_feedback_is(servo):
    axis = servo.joint(2).axis
    assert not axis.is_stale
    axis.position.pdo.overdue = True
    assert axis.is_stale
    assert axis.has(0x603F)
    assert not axis.has(0x607B, 77)
