"""The claimed interface, its mode and its target."""

import math

import pytest
from support.generic import write_generic
from support.robots import Bench

from canopen_control.cia402.modes import OperationMode
from canopen_control.errors import UnsupportedMode


@pytest.fixture
def servo(tmp_path):
    bench = Bench("targets", config=write_generic(tmp_path), drives=(2, 3), controllers=["velocity"])
    bench.start()
    yield bench
    bench.close()


def test_a_claim_brings_its_mode_and_its_command(servo):
    targets = servo.joint(2).targets
    assert targets.claimed == "velocity"
    assert targets.mode is OperationMode.CSV
    assert targets.mode_serves(OperationMode.PP) == "position"
    assert targets.mode_serves(OperationMode.HM) is None


def test_a_new_mode_of_an_enabled_drive_waits_for_a_cycle_at_rest(servo):
    servo.robot.command("velocity", [1.0, 1.0], "test")
    servo.run(300)
    joint = servo.joint(2)
    joint.targets.claim("position")
    assert joint.targets.pending is OperationMode.CSP
    assert joint.machine.mode == OperationMode.CSV
    servo.run(10)
    assert joint.axis.output(0x607A).value == pytest.approx(joint.axis.raw_position, abs=500)
    assert joint.axis.output(0x60FF).value == 0
    servo.run(100)
    assert joint.machine.mode == OperationMode.CSP
    assert joint.enabled


def test_a_mode_that_the_drive_lacks_is_refused(servo):
    with pytest.raises(UnsupportedMode):
        servo.joint(2).targets.set_mode(OperationMode.CSTCA)


def test_the_limits_of_the_description_hold(servo):
    joint = servo.joint(2)
    command = joint.commands["velocity"]
    command.minimum, command.maximum = -0.5, 0.25
    for value, expected in ((1.0, 0.25), (-1.0, -0.5), (0.1, 0.1)):
        servo.robot.command("velocity", [value, value], "test")
        servo.run(20)
        assert joint.axis.output(0x60FF).value == pytest.approx(expected * 65536 / math.tau, abs=1)


def test_a_mode_that_does_not_serve_the_claim_follows_nothing(servo):
    joint = servo.joint(2)
    joint.targets.take_mode(OperationMode.PP)
    servo.robot.command("velocity", [1.0, 1.0], "test")
    servo.run(200)
    assert joint.axis.output(0x60FF).value == 0
    assert joint.targets.handshakes
