import math

import pytest

from canopen_control.physics.joint_servo import ServoLoop
from canopen_control.physics.motor_estimate import EstimatedMotor
from canopen_control.physics.physics_file import AxisSettings
from canopen_control.virtual.plant import ServoGains

PERIOD = 1e-3


def loop(inertia=0.01, **settings):
    motor = EstimatedMotor(1.0, 2.0, inertia, 0.0, 0.0, 0.0, False)
    return ServoLoop(motor, AxisSettings("joint", **{"scale_pos_to_dev": 1e5, **settings}), PERIOD)


def moved(servo, target, speed=0.0, *, inertia=0.01, load=0.0, limit=5.0, seconds=2.0):
    """Return angle, speed and torque of a plain inertia under a servo, after a time, and the greatest angle."""
    angle = velocity = torque = highest = 0.0
    for step in range(round(seconds / PERIOD)):
        torque = servo.torque(angle, target + speed * step * PERIOD, speed, limit)
        velocity += (torque + load) / inertia * PERIOD
        angle += velocity * PERIOD
        highest = max(highest, angle)
    return angle, velocity, torque, highest


def test_a_position_is_reached_and_held_against_a_load():
    angle, velocity, torque, _ = moved(loop(), 1.0, load=-0.7)
    assert (angle, torque) == (pytest.approx(1.0, abs=1e-3), pytest.approx(0.7, abs=0.02))
    assert abs(velocity) < 1e-2


@pytest.mark.parametrize("counts", [1e6, 65536 / math.tau, 4096 / math.tau])
def test_a_velocity_is_followed_without_an_error_whatever_the_encoder(counts):
    angle, velocity, _, _ = moved(loop(scale_pos_to_dev=counts, encoder=round(counts * math.tau)), 0.0, 5.0)
    assert velocity == pytest.approx(5.0, rel=0.02)
    assert angle == pytest.approx(10.0, abs=0.02)


def test_the_limit_of_the_current_holds_and_nothing_winds_up_on_it():
    servo = loop()
    torques = [servo.torque(0.0, 1.0, 0.0, 0.3) for _ in range(1000)]
    assert set(torques) == {0.3}
    angle, _, _, highest = moved(servo, 0.05, limit=0.3)
    assert angle == pytest.approx(0.05, abs=1e-3)
    assert highest < 0.065


def test_at_rest_within_a_count_it_does_not_hunt():
    servo = loop(encoder=1000)
    moved(servo, 1.0, load=-0.2)
    torques = {servo.torque(1.0, 1.0, 0.0, 5.0) for _ in range(200)}
    assert len(torques) == 1 or max(torques) - min(torques) < 0.05


def test_a_velocity_alone_does_not_make_up_for_way_that_was_lost():
    servo = loop()
    for _ in range(500):  # blocked
        assert servo.velocity_torque(0.0, 5.0, 0.3) <= 0.3
    angle = velocity = 0.0
    for _ in range(2000):
        velocity += servo.velocity_torque(angle, 5.0, 0.3) / 0.01 * PERIOD
        angle += velocity * PERIOD
    assert velocity == pytest.approx(5.0, rel=0.02)
    assert angle == pytest.approx(10.0, abs=0.6)


def test_the_gains_of_the_drive_are_taken_and_given_back():
    servo = loop()
    mine = moved(servo, 1.0, load=-0.7)
    servo = loop()
    servo.tune(ServoGains(1e-6, 0.0, 5.0, 0.0), counts=1e5, per_mille=0.001)
    soft = moved(servo, 1.0, load=-0.7)
    assert soft[0] < 0.9  # without an integral a load is an error
    servo = loop()
    servo.tune(ServoGains(1e-6, 0.0, 5.0, 0.0), counts=1e5, per_mille=0.001)
    servo.tune()
    assert moved(servo, 1.0, load=-0.7) == mine
