"""Tests of a robot in virtual time; `canopen_robot = config/robby` in pytest.ini selects the robot."""

from itertools import pairwise

import pytest

FORWARD, BASE = "robby_forward_controller", "robby_base_controller"


def test_it_turns_as_commanded(robot):
    robot.command(FORWARD, 5.0, 5.0, seconds=2.0)
    robot.run(1.5)
    assert robot.velocity("left_wheel_joint") == pytest.approx(5.0, rel=0.01)


def test_a_command_that_is_not_renewed_expires(robot):
    robot.command(FORWARD, 5.0, 5.0)
    robot.run(1.0)
    assert robot.moving
    robot.run(1.2)  # command_timeout: 2.0
    assert robot.stopped_within(0.5)


def test_both_wheels_stop_when_the_left_drive_dies(robot, drives):
    robot.command("robby_forward_controller", 5.0, 5.0, seconds=5.0)
    robot.run(1.0)
    drives["left_drive"].power_off()
    assert robot.until(lambda: robot.state == "fault") <= 0.6  # five heartbeats of 100 ms
    assert robot.stopped_within(0.3)


def test_a_drive_in_fault_stops_the_other(robot, drives):
    robot.command(FORWARD, 5.0, 5.0, seconds=5.0)
    robot.run(1.0)
    drives[3].fault("drive_fault")
    assert robot.stopped_within(0.5)
    assert any("node 3" in event.text for event in robot.events)


def test_a_repaired_drive_waits_for_an_enable(robot, drives):
    drives[3].fault("drive_fault", seconds=0.5)
    robot.run(1.0)
    robot.reset_faults()
    robot.run(0.5)
    robot.command(FORWARD, 5.0, 5.0, seconds=1.0)
    robot.run(1.0)
    assert not robot.moving
    robot.enable()
    robot.run(0.5)
    robot.command(FORWARD, 5.0, 5.0, seconds=1.0)
    robot.run(0.5)
    assert robot.moving


def test_the_drives_stop_by_themselves_when_the_computer_hangs(robot, clock):
    robot.command(FORWARD, 5.0, 5.0, seconds=5.0)
    clock.run(1.0)
    robot.stall(2.0)
    assert robot.stopped_within(1.0)


def test_the_drives_stop_by_themselves_when_the_program_is_killed(robot):
    robot.command(FORWARD, 5.0, 5.0, seconds=5.0)
    robot.run(1.0)
    robot.kill()
    assert robot.stopped_within(1.0)


def test_stop_is_latched(robot):
    robot.stop(latch=True)
    robot.run(0.2)
    robot.enable()
    robot.command(FORWARD, 5.0, 5.0, seconds=1.0)
    robot.run(1.0)
    assert not robot.moving


def test_one_disturbed_frame_of_fifty_is_harmless(robot, bus):
    bus.disturb(every=50, seconds=2.0)
    robot.command(FORWARD, 5.0, 5.0, seconds=2.0)
    robot.run(1.5)
    assert robot.state == "running"
    assert robot.moving


def test_the_bus_carries_a_sync_every_20_ms(robot, bus):
    robot.run(1.0)
    syncs = [time for time, _sender, frame in bus.frames if frame.can_id == 0x080][-40:]
    gaps = [later - earlier for earlier, later in pairwise(syncs)]
    assert max(gaps) < 0.027


@pytest.mark.canopen_robot(controllers=[BASE])
def test_a_base_drives_a_curve(robot):
    robot.command(BASE, 0.2, 0.5, seconds=2.0)
    robot.run(1.5)
    assert robot.velocity("right_wheel_joint") > robot.velocity("left_wheel_joint") > 0.0
