import pytest
from support.simulated import FORWARD, setup_of

from canopen_control.errors import ConfigError, ControlError, UnknownName
from canopen_control.testing.tested_robot import TestedRobot


@pytest.fixture
def robot():
    tested_robot = TestedRobot(setup_of(), 1)
    yield tested_robot
    tested_robot.close()


def test_unknown_names_are_refused_with_the_available_ones(robot):
    with pytest.raises(UnknownName, match="no controller 'robby_foward_controller'"):
        robot.command("robby_foward_controller", 1, 1)
    with pytest.raises(UnknownName, match="no drive 9; available: left_drive \\(3\\), right_drive \\(2\\)"):
        robot.drives[9]
    with pytest.raises(UnknownName, match="no drive 'left'"):
        robot.drives["left"]
    with pytest.raises(UnknownName, match="no joint 'left'"):
        robot.velocity("left")
    with pytest.raises(ConfigError, match="did you mean 'silent'"):
        robot.drives[3].fault("silnt")
    with pytest.raises(ConfigError, match="every 0"):
        robot.bus.lose(0)


def test_a_condition_that_never_comes_is_reported_with_the_last_events(robot):
    with pytest.raises(AssertionError, match=r"condition not met within 0\.1 s; last events: .*runs"):
        robot.until(lambda: False, timeout=0.1)


def test_it_has_booted_stands_and_moves_when_it_is_reported(robot):
    assert robot.state == "running"
    assert len(robot.drives) == 2
    assert not robot.moving
    before = robot.clock.now
    robot.command(FORWARD, 4.0, 4.0, seconds=1.0)
    assert robot.until(lambda: robot.moving) < 0.1
    assert robot.clock.now > before
    robot.run(0.6)
    assert robot.position("left_wheel_joint") > 0.1
    assert not robot.stopped_within(0.05)
    robot.stop()
    assert robot.stopped_within(0.3)
    assert robot.breaches == []


def test_a_latched_stop_is_released_and_a_fault_healed(robot):
    robot.stop(latch=True)
    robot.run(0.3)
    assert robot.simulated.core.latch.held
    robot.release()
    robot.disable()
    robot.run(0.3)
    assert robot.state == "disabled"
    robot.drives[3].fault("warning")
    robot.drives[3].clear_fault("warning")
    robot.run(0.1)
    assert robot.simulated.drives[3].device.fault_switches.active == []


def test_quirks_from_the_power_on_and_while_it_runs():
    robot = TestedRobot(setup_of(), quirks={"all": ["own_bits_change"], "left_drive": ["sdo_late=0.01"]})
    assert robot.drives["left_drive"].quirks == ["own_bits_change", "sdo_late=0.01"]
    assert robot.drives[2].quirks == ["own_bits_change"]
    robot.drives[2].quirk("warning_always")
    robot.run(0.1)
    assert robot.drives[2].quirks == ["warning_always", "own_bits_change"]
    robot.drives[2].quirk_off("warning_always")
    robot.drives[3].quirk("brake_delay=1", seconds=0.05)
    robot.run(0.1)
    assert (robot.drives[2].quirks, robot.drives[3].quirks) == (
        ["own_bits_change"],
        ["own_bits_change", "sdo_late=0.01"],
    )
    with pytest.raises(ConfigError, match="no quirk 'brake_dely'"):
        robot.drives[2].quirk("brake_dely")
    with pytest.raises(ConfigError, match="no quirk"):
        TestedRobot(setup_of(), quirks={3: ["brake_dely"]})
    robot.close()


def test_frames_are_received_lost_doubled_and_sent(robot):
    robot.bus.send(0x7E5, b"\x01")
    assert robot.bus.frames[-1][1:] == ("stranger", (0x7E5, b"\x01"))
    robot.bus.lose(seconds=0.1)
    count = len(robot.bus.frames)
    robot.run(0.09)
    assert len(robot.bus.frames) == count
    robot.bus.double(2, seconds=0.2)
    robot.run(0.2)
    assert robot.activate(FORWARD) is None
    robot.drives[2].cut(0.1)
    robot.run(0.2)


@pytest.mark.rest
def test_an_arm_follows_a_trajectory():
    robot = TestedRobot(setup_of("arm6", "arm_controller"))
    robot.trajectory("arm_controller", *[0.2] * 6, seconds=0.5)
    robot.run(1.0)
    assert robot.position("joint_1") == pytest.approx(0.2, abs=1e-3)
    robot.close()


@pytest.mark.parametrize("values", [(1.0,), (1.0, 2.0, 3.0), (1.0, float("nan"))])
def test_a_command_that_the_robot_refuses_is_raised(robot, values):
    robot.command(FORWARD, *values, seconds=1.0)
    with pytest.raises(ControlError, match=FORWARD):
        robot.run(0.2)


def test_a_command_to_a_controller_that_is_not_active_is_raised_and_one_to_drives_that_are_off_is_not(robot):
    robot.disable()
    robot.run(0.5)
    robot.command(FORWARD, 1.0, 1.0)
    robot.run(0.2)
    robot.command("robby_base_controller", 0.1, 0.0)
    with pytest.raises(ControlError, match="accepts no command; activate it"):
        robot.run(0.2)
