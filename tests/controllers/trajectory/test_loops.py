import pytest

from canopen_control.controllers.trajectory.loops import Loops
from canopen_control.controllers.trajectory.params import JointGains
from canopen_control.controllers.trajectory.point import Point

GAINS = [JointGains(p=2.0, ff_velocity_scale=1.0), JointGains(p=3.0, d=0.5)]
WANTED, ERROR = Point([1.0, 1.0], [4.0, 5.0], effort=[10.0, 20.0]), Point([0.1, 0.2], [0.0, 1.0])


def test_a_velocity_is_that_of_the_trajectory_and_the_loops():
    loops = Loops(GAINS, [0, 1], with_effort=False)
    assert loops.compute(0, WANTED, ERROR, 0.01) == pytest.approx(4.0 + 0.2)
    assert loops.compute(1, WANTED, ERROR, 0.01) == pytest.approx(0.6 + 0.5)


def test_an_effort_begins_with_that_of_the_trajectory():
    assert Loops(GAINS, [1], with_effort=True).compute(0, WANTED, ERROR, 0.01) == pytest.approx(20.0 + 0.6 + 0.5)


def test_a_trajectory_that_says_nothing_is_no_feed_forward():
    assert Loops(GAINS, [0], with_effort=True).compute(0, Point([1.0, 1.0]), ERROR, 0.01) == pytest.approx(0.2)


def test_other_gains_keep_the_integral_and_a_reset_does_not():
    loops = Loops([JointGains(i=1.0)], [0], with_effort=False)
    error = Point([1.0], [0.0])
    before = [loops.compute(0, Point([1.0]), error, 0.1) for _ in range(3)][-1]
    loops.set_gains([JointGains()])
    assert loops.compute(0, Point([1.0]), error, 0.1) == pytest.approx(before)
    loops.reset()
    assert loops.compute(0, Point([1.0]), error, 0.1) == 0.0
