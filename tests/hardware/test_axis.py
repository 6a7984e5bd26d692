"""An axis' process data, found by the profile's indices."""

import math

import pytest
from support.generic import write_generic
from support.robots import Bench

from canopen_control.cia402.units import Scale
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
    limits.take_velocity(100.0, Scale())
    limits.low, limits.high = -5, 7
    limits.torque_positive, limits.torque_negative = 30, 20
    assert [limits.of_velocity(raw) for raw in (-200, -50, 50, 200)] == [-100, -50, 50, 100]
    assert [limits.of_position(raw) for raw in (-9, 0, 9)] == [-5, 0, 7]
    assert [limits.of_torque(raw) for raw in (-99, 0, 99)] == [-20, 0, 30]
    limits.blocked = 1
    assert [limits.of_velocity(raw) for raw in (-50, 50)] == [-50, 0]


@pytest.mark.parametrize(("described", "most"), [(math.inf, 5000.0), (0.5, 500.0), (20.0, 5000.0)])
def test_the_smaller_of_the_drives_and_the_descriptions_velocity_holds_for_steps_of_positions_too(described, most):
    limits, scale = (
        AxisLimits(),
        Scale(vel_to_dev=-1000.0, vel_from_dev=-0.001, pos_to_dev=4000.0, pos_from_dev=1 / 4000),
    )
    limits.described = described
    limits.take_velocity(5000.0, scale)
    assert (limits.most, limits.pace) == (most, 4.0 * most)
    assert (limits.of_velocity(99_999), limits.held) == (most, True)
    limits.held = False
    assert (limits.of_velocity(int(most)), limits.held) == (most, False)


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
