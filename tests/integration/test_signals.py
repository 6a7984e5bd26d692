"""Ctrl-C and other signals in every phase: the wheels ramp down, the drives are disabled, all processes end."""

import os
import signal
import subprocess
import sys

import pytest
from support.host import eventually
from support.processes import GONE_S, seconds_until

from canopen_control.client import RobotClient
from canopen_control.rpc.messages.robot import GetStatus

pytestmark = pytest.mark.timed

SPEED = 10 / 0.003926990816987242


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_before_the_boot_has_ended(stage, number):
    robot = stage.start("run", "robby", "--can", "local:early")
    assert eventually(lambda: sum("drive --node-id" in line for line in stage.survivors().values()) == 2)
    assert robot.end(number) == 0, robot
    assert robot.err == ""
    assert "robby runs" not in robot.out
    assert f"stopping: {signal.Signals(number).name}" in robot.out


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_while_the_wheels_turn_they_stop_along_the_ramp(stage, probe, number):
    for node_id in (3, 2):  # apart from the robot, so that they are there to be asked afterwards
        stage.drive("turning", node_id)
    robot = stage.robby("turning", "--no-drives")
    command = stage.start("command", "robby_forward_controller", 10, 10)
    probes = [probe("turning", node_id) for node_id in (3, 2)]
    assert eventually(lambda: all(abs(item.speed) > 0.99 * SPEED for item in probes))
    robot.send(number)
    speeds = []
    seconds_until(lambda: speeds.append(abs(probes[0].speed)) or speeds[-1] < 1, 5)
    assert any(0.1 * SPEED < speed < 0.9 * SPEED for speed in speeds), "they stopped at once, not along a ramp"
    assert robot.wait() == 0, robot
    assert robot.err == ""
    assert command.wait() == 1
    for item in probes:
        assert item.speed == 0
        assert item.power == "SWITCH_ON_DISABLED"
        assert item.state.errors == []


def test_a_second_ctrl_c_changes_nothing(stage, probe):
    robot = stage.robby("twice")
    stage.start("command", "robby_forward_controller", 10, 10)
    drive = probe("twice", 3)
    assert eventually(lambda: abs(drive.speed) > 0.99 * SPEED)
    for _ in range(3):
        robot.send(signal.SIGINT)
    assert robot.wait() == 0, robot
    assert robot.out.count("stopping: SIGINT") == 1


def test_while_a_drive_is_in_fault(stage, probe):
    robot = stage.robby("faulty")
    probe("faulty", 3).fault("undervoltage")
    with RobotClient.connect("faulty") as client:
        assert eventually(lambda: client.ask(GetStatus()).state == "fault")
    assert robot.end(signal.SIGINT) == 0, robot


def test_while_the_bus_hangs(stage):
    robot = stage.robby("hangs")
    hub = stage.pid_of("hub import main")
    os.kill(hub, signal.SIGSTOP)
    try:
        with RobotClient.connect("hangs") as client:
            assert eventually(lambda: client.ask(GetStatus()).state == "fault")
        assert robot.end(signal.SIGINT) == 1, robot
        assert robot.err == (
            "canopen-control: could not confirm that left_drive, right_drive are disabled; "
            "check the drives before you approach the robot\n"
        )
    finally:
        os.kill(hub, signal.SIGCONT)
    stage.nobody_is_left(GONE_S)


def test_a_command_that_is_interrupted_sends_zeros(stage, probe):
    stage.robby("zeros")
    drive = probe("zeros", 3)
    for number in (signal.SIGINT, signal.SIGTERM):
        command = stage.start("command", "robby_forward_controller", 10, 10)
        assert eventually(lambda: abs(drive.speed) > 0.99 * SPEED)
        assert command.end(number) == 0, command
        assert seconds_until(lambda: abs(drive.speed) < 1, 5) < 1.0  # well before the controller's time-out


def test_a_reader_of_the_output_may_leave_or_stall(stage):
    """A terminal that is closed or stopped does not stop the robot, nor make its end a failure."""
    for reader in ("head -n 1", "sleep 2"):
        line = f"{sys.executable} -m canopen_control run robby --can local:pipe --for 0.5 | {reader}"
        shell = ["bash", "-c", f"{line}; exit ${{PIPESTATUS[0]}}"]
        done = subprocess.run(shell, capture_output=True, cwd=stage.place, timeout=60)
        assert (done.returncode, done.stderr) == (0, b"")
