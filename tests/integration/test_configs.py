"""The bundled robots: each runs by its name, and moves according to its files."""

import math

import pytest
from support.configs import ROBOTS, changed
from support.robots import Bench

from canopen_control.errors import ControlError
from canopen_control.host.reactor import Reactor
from canopen_control.host.timer import ManualClock
from canopen_control.runtime.core import RobotCore, RobotState
from canopen_control.runtime.robot_files import find_robot
from canopen_control.runtime.setup import read_robot

ARM = "arm_position_controller"
COUNTS = 65536 / (2 * math.pi)


@pytest.mark.parametrize("name", ROBOTS)
def test_each_runs_with_one_command(stage, name):
    done = stage.call("run", name, "--for", 2)
    assert done.wait() == 0, done
    assert f"{name} runs: " in done.out
    assert "has stopped" in done.out


@pytest.mark.parametrize("name", ROBOTS)
def test_each_runs_on_mock_hardware_and_strictly_read(stage, name):
    done = stage.call("run", name, "--mock", "--strict", "--for", 0.3)
    assert done.wait() == 0, done


@pytest.fixture
def arm():
    bench = Bench("arm", config="arm6", drives=(2, 3, 4, 5, 6, 7))
    bench.start()
    yield bench
    bench.close()


def positions(bench):
    return [bench.robot.registry.state(f"joint_{index}/position").value for index in range(1, 7)]


def test_six_axes_reach_their_positions_without_going_faster_than_the_description_allows(arm):
    target = [0.5, -0.4, 0.3, 1.0, -0.2, 2.0]
    arm.robot.command(ARM, target, "test")
    before, fastest = positions(arm), 0.0
    for _ in range(150):
        arm.run(20)
        now = positions(arm)
        fastest = max([fastest, *(abs(a - b) / 0.02 for a, b in zip(now, before, strict=True))])
        before = now
    assert positions(arm) == pytest.approx(target, abs=1e-3)
    assert 1.8 < fastest < 2.1  # rad/s: <limit velocity="2.0"> by enforce_command_limits
    for node_id, expected in enumerate(target, 2):
        plant = arm.drives[node_id].drives[0].mover.plant
        assert plant.position / COUNTS / 100 == pytest.approx(expected, abs=1e-3)


def test_an_axis_does_not_leave_its_range(arm):
    arm.robot.command(ARM, [0.0, 9.0, 0.0, 0.0, 0.0, 0.0], "test")
    arm.run(3000)
    assert positions(arm)[1] == pytest.approx(2.0, abs=1e-3)
    assert any("joint_2/position: " in text and "is limited to" in text for text in arm.texts("limited"))
    arm.robot.switch((), [ARM], strict=True)
    arm.run(1000)
    assert positions(arm)[1] == pytest.approx(2.0, abs=1e-3)  # a position is held


def test_the_motors_of_a_ros_1_base_turn_thirty_times_as_far_as_its_wheels():
    base = "mobile_base_controller"
    bench = Bench("base1", config="mobile_base_ros1", drives=(2, 3))
    bench.start()
    for _ in range(30):
        bench.robot.command(base, [0.3, 0.0], "test")
        bench.run(100)
    wheels = [bench.robot.registry.state(f"wheel_{side}_joint/position").value for side in ("left", "right")]
    motors = [bench.drives[node_id].drives[0].mover.plant.position / COUNTS for node_id in (2, 3)]
    assert wheels[0] == pytest.approx(wheels[1], rel=0.01)
    assert wheels[0] > 5.0
    assert [-motors[0], motors[1]] == pytest.approx([30 * wheels[0], 30 * wheels[1]], rel=0.02)
    odometry = bench.robot.manager.get(base).odometry
    assert odometry.x == pytest.approx(0.0985 * wheels[0], rel=0.02)  # the radius is that of the URDF
    bench.close()


def test_the_simulated_base_is_real_by_changing_the_one_line(tmp_path):
    edit = {"gz_ros2_control/GazeboSimSystem": "canopen_ros2_control/RobotSystem"}
    files = changed(tmp_path, "diffbot_sim", description=edit)
    for name, how in (("line", {"config": str(files.bus.parent)}), ("option", {"config": "diffbot_sim", "real": True})):
        bench = Bench(f"real_{name}", drives=(2, 3), **how)
        bench.start()
        for _ in range(20):
            bench.robot.command("diff_drive_base_controller", [0.5, 0.0], "test")
            bench.run(100)
        wheel = bench.robot.registry.state("right_wheel_joint/velocity").value
        assert wheel == pytest.approx(5.0, rel=0.01)
        assert bench.speed(3) == pytest.approx(5.0 * COUNTS, rel=0.01)
        assert bench.speed(2) == pytest.approx(-5.0 * COUNTS, rel=0.01)
        bench.close()


def test_a_simulated_base_drives_without_any_bus(tmp_path):
    files = changed(tmp_path, "diffbot_sim")
    files.bus.unlink()
    reactor = Reactor(ManualClock(1_000_000_000))
    robot = RobotCore(read_robot(find_robot(str(files.description.parent))), reactor)
    robot.start()
    for _ in range(20):
        reactor.run_for(100_000_000)
        if robot.state is RobotState.RUNNING:
            robot.command("diff_drive_base_controller", [0.5, 0.0], "test")
    assert robot.registry.state("right_wheel_joint/velocity").value == pytest.approx(5.0, rel=0.01)
    robot.shutdown("the test is over")
    reactor.run_for(5_000_000_000)
    assert robot.failure is None
    reactor.close()


def driven(config, drives, base, twist, seconds):
    """Drive a base by a twist and then stand; return the bench, its odometry as published."""
    bench = Bench(config, config=config, drives=drives)
    bench.start()
    for _ in range(round(seconds * 10)):
        bench.robot.command(base, twist, "test")
        bench.run(100)
    moving = bench.robot.manager.get(base).sample(0)
    bench.run(3000)
    return bench, moving, bench.robot.manager.get(base).sample(0)


def test_a_forklift_steers_with_its_rear_wheel_and_its_odometry_is_right():
    base = "forklift_base_controller"
    bench, moving, stood = driven("forklift", (2, 3, 4), base, [0.5, 0.25], 6.0)
    assert (moving.linear, moving.angular) == pytest.approx((0.5, 0.25), rel=0.02)
    gear = 30 * COUNTS
    right, left, steering = (bench.drives[node_id].drives[0].mover.plant.position / gear for node_id in (2, 3, 4))
    assert (right - -left) * 0.15 / 0.9 == pytest.approx(stood.heading, rel=0.05)
    assert steering == pytest.approx(math.atan(0.25 * 1.2 / 0.5), abs=1e-3), "the angle is held"
    assert stood.linear == 0.0
    assert math.hypot(stood.x, stood.y) > 2.0
    bench.close()


def test_a_forklift_drives_off_with_its_steering_across_and_does_not_lose_its_way():
    base = "forklift_base_controller"
    bench, moving, _ = driven("forklift", (2, 3, 4), base, [0.0, 1.0], 1.5)
    assert bench.robot.registry.state("steering_joint/position").value == pytest.approx(math.pi / 2, abs=1e-3)
    assert (moving.x, moving.y, moving.heading) == (0.0, 0.0, 0.0)
    for _ in range(15):
        bench.robot.command(base, [0.5, 0.0], "test")
        bench.run(100)
        speeds = [bench.robot.registry.state(f"{side}_traction_joint/velocity").value for side in ("right", "left")]
        assert max(map(abs, speeds)) < 0.5 / 0.15 * 1.01
    right, left = (bench.robot.registry.state(f"{side}_traction_joint/position").value for side in ("right", "left"))
    reported = bench.robot.manager.get(base).sample(0)
    assert reported.heading == pytest.approx((right - left) * 0.15 / 0.9, rel=0.15)
    assert reported.linear == pytest.approx(0.5, rel=0.01)
    bench.close()


def test_a_forklift_whose_steering_is_lost_stands_and_continues_with_a_newer_twist_once_it_is_enabled():
    base = "forklift_base_controller"
    bench = Bench("lost", config="forklift", drives=(2, 3, 4))
    bench.start()
    for _ in range(20):
        bench.robot.command(base, [0.5, 0.25], "test")
        bench.run(100)
    bench.power_off(4)
    bench.run(3000)
    assert bench.speed(2) == bench.speed(3) == 0
    with pytest.raises(ControlError, match="steering"):
        bench.robot.command(base, [0.5, 0.25], "test")
    bench.power_on(4)
    bench.run(3000)
    for joint in bench.robot.joints.values():
        joint.enable()
    bench.run(1000)
    assert bench.speed(2) == bench.speed(3) == 0, "nothing moves before a newer twist"
    assert bench.robot.manager.states[base] == "active"
    assert bench.drives[4].get(0x6064) == 0, "the drive, which began anew, is held where it is"
    bench.robot.command(base, [0.5, 0.25], "test")
    bench.run(300)
    assert bench.speed(2) > 0
    bench.close()


def test_a_base_on_mecanum_wheels_slides_to_the_left():
    bench, moving, stood = driven("mecanum", (2, 3, 4, 5), "mecanum_base_controller", [0.0, 0.4, 0.0], 3.0)
    assert (moving.linear, moving.lateral, moving.angular) == pytest.approx((0.0, 0.4, 0.0), abs=0.01)
    assert stood.y > 1.0
    assert (stood.x, stood.heading, stood.lateral) == pytest.approx((0.0, 0.0, 0.0), abs=0.01)
    gear = 20 * COUNTS
    wheels = [bench.drives[node_id].drives[0].mover.plant.position / gear for node_id in (2, 3, 4, 5)]
    way = stood.y / 0.08
    assert wheels == pytest.approx([way, way, -way, -way], rel=0.02)  # those on the left are mounted mirrored
    bench.close()
