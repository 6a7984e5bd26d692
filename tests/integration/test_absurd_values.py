"""Values that no drive can represent are refused, reported and have no effect; on whole robots."""

import math

import pytest
from support.faultbench import FaultBench
from support.generic import write_generic
from support.robots import FORWARD, LEFT, RIGHT, Bench, copy_robby

from canopen_control.errors import ControlError

ABSURD = [1e308, -1e308, 1e30, 1e12]


@pytest.fixture
def robby(request, tmp_path):
    bench = Bench(f"absurd{abs(hash(request.node.nodeid)) % 10**8}", config=copy_robby(tmp_path))
    bench.start()
    yield bench
    bench.close()


@pytest.mark.parametrize("value", ABSURD)
def test_a_velocity_that_no_object_holds_is_refused_and_the_wheels_stop(robby, value):
    robby.hold(10, 10, ms=500)
    rejected = robby.robot.manager.get(FORWARD).rejected
    for _ in range(5):
        with pytest.raises(ControlError, match="the range of left_wheel_joint/velocity is") as refused:
            robby.command(value, 1.0)
        robby.run(100)
    assert f"cannot send {value:g}" in str(refused.value)
    assert robby.robot.manager.get(FORWARD).rejected == rejected + 5
    assert len(robby.texts("refused")) == 1
    robby.run(1000)
    assert (robby.speed(LEFT), robby.speed(RIGHT)) == (0, 0)
    robby.hold(5, 5, ms=500)
    assert robby.velocity(LEFT) == pytest.approx(5.0, rel=0.02)


@pytest.mark.parametrize("twist", [(1e308, 0.0), (0.0, -1e308), (1e30, 1e30), (1e308, 1e308)])
def test_a_twist_whose_wheels_no_drive_could_turn_is_refused_and_the_base_stands(robby, twist):
    robot = robby.robot
    robot.switch(["robby_base_controller"], [FORWARD], strict=True)
    robby.run(200)
    for _ in range(5):
        robot.command("robby_base_controller", [0.2, 0.0], "test")
        robby.run(100)
    assert robby.speed(RIGHT) != 0
    with pytest.raises(ControlError, match=r"the range of .*_wheel_joint/velocity is"):
        robot.command("robby_base_controller", list(twist), "test")
    robby.run(1000)
    assert (robby.speed(LEFT), robby.speed(RIGHT)) == (0, 0)


@pytest.mark.parametrize("value", [*ABSURD, math.inf, -math.inf])
def test_what_a_controller_makes_itself_stands_too_and_is_reported_once(robby, value):
    """A controller of somebody else's writes what it likes; no exception in the cycle, no old speed."""
    robby.hold(10, 10, ms=500)
    interface = robby.robot.joints["left_wheel_joint"].commands["velocity"]
    robby.robot.manager.get(FORWARD).forget(robby.reactor.now())
    for _ in range(50):
        interface.value = value
        robby.run(20)
    assert robby.speed(LEFT) == 0
    assert len(robby.texts("target_refused")) == 1


@pytest.mark.parametrize("kind", ["velocity", "effort", "position"])
@pytest.mark.parametrize("value", [1e308, -1e30])
def test_every_interface_refuses_what_its_object_cannot_hold(tmp_path, kind, value):
    bench = FaultBench(f"absurd{kind}", config=write_generic(tmp_path), drives=(2, 3), controllers=[kind])
    try:
        bench.start()
        with pytest.raises(ControlError, match=f"/{kind} is "):
            bench.robot.command(kind, [value, 0.0], "test")
        bench.run(500)
        assert bench.speed(2) == bench.speed(3) == 0
        assert all(joint.enabled for joint in bench.robot.joints.values())
    finally:
        bench.close()
