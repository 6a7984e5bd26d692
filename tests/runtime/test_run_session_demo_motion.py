import math

import pytest
from support.robots import FORWARD, LEFT, RIGHT, Bench

from canopen_control.runtime.run_session import DemoMotion


@pytest.fixture
def robby():
    bench = Bench("motion")
    bench.start()
    yield bench
    bench.close()


@pytest.mark.rest
def test_it_plays_zero_ten_and_minus_ten_in_a_loop(robby):
    DemoMotion(robby.robot, FORWARD)
    observed = []
    for _ in range(4):
        robby.run(2500)
        observed.append(round(robby.velocity(LEFT)))
        robby.run(500)
    assert observed == [0, 10, -10, 0]


@pytest.mark.rest
def test_the_first_command_of_anyone_else_ends_it_for_good(robby):
    DemoMotion(robby.robot, FORWARD)
    robby.run(4000)
    robby.command(3.0, 3.0, source="ros")
    robby.run(1500)
    assert robby.velocity(RIGHT) == pytest.approx(3.0, rel=0.01)
    robby.run(5000)
    assert robby.speed(RIGHT) == 0
    assert robby.texts("demo") == ["ros commands the robot; the demo motion ends"]


def test_it_waits_while_the_robot_is_in_fault_and_never_enables(robby):
    DemoMotion(robby.robot, FORWARD)
    robby.run(4000)
    robby.power_off(RIGHT)
    robby.run(10_000)
    assert robby.speed(LEFT) == 0


def test_it_ends_with_the_robot(robby):
    DemoMotion(robby.robot, FORWARD)
    robby.run(4000)
    robby.robot.shutdown("test")
    robby.run(10_000)
    assert robby.speed(LEFT) == robby.speed(RIGHT) == 0


def played(config, drives, ms):
    """Play on a robot; return the positions of its joints at the start and the extremes that they reached."""
    bench = Bench(f"motion{config}", config=config, drives=drives)
    try:
        bench.start()
        joints = list(bench.robot.joints.values())
        begin = [joint.states["position"].value for joint in joints]
        DemoMotion(bench.robot, bench.setup.to_activate[-1])
        observed = []
        for _ in range(ms // 100):
            bench.run(100)
            observed.append([joint.states["position"].value for joint in joints])
        columns = list(zip(*observed, strict=True))
        return begin, (list(map(min, columns)), list(map(max, columns)))
    finally:
        bench.close()


@pytest.mark.rest
def test_a_base_that_is_steered_goes_a_curve():
    begin, (low, high) = played("forklift", (2, 3, 4), 9000)
    assert begin == [0.0, 0.0, 0.0]
    assert min(high[:2]) > 0.5
    assert low[2] >= -0.01
    assert high[2] == pytest.approx(math.atan(0.5 * 1.2 / 0.2), abs=0.02)


@pytest.mark.rest
def test_positions_swing_a_little_about_where_they_were():
    begin, (low, high) = played("arm6", range(2, 8), 9000)
    for at, least, most in zip(begin, low, high, strict=True):
        assert at - 0.27 < least < at - 0.2
        assert at + 0.2 < most < at + 0.27
