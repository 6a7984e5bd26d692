"""Teleop and monitor with real keys in a real terminal (tmux), checked by the drives."""

import contextlib
import os
import shlex
import signal
import sys

import pytest
from support.host import eventually
from support.localbus import open_local
from support.processes import seconds_until
from support.terminal import Tmux

pytestmark = [pytest.mark.tmux, pytest.mark.timed]
PROGRAM = f"{shlex.quote(sys.executable)} -m canopen_control"


@pytest.fixture
def terminal(stage, private_folders):
    terminal = Tmux(private_folders)
    yield terminal
    terminal.close()


def speed(drive):
    return abs(drive.speed)


def test_a_held_key_drives_letting_go_stops_and_the_terminal_is_itself_again(stage, probe, terminal):
    stage.robby("keys")
    left = probe("keys", 3)
    terminal.run(f"{PROGRAM} teleop --speed 5")
    terminal.until("speeds 5.00")
    assert eventually(lambda: terminal.keys("i") or speed(left) > 500, 10.0)  # a key that is held
    seconds_until(lambda: speed(left) == 0, 5.0)  # 0.7 s at most, and the ramp; the machine may be busy
    terminal.keys("j")
    terminal.until("angular 5.00")
    terminal.keys("Space")
    terminal.until("angular 0.00")
    terminal.keys("i")
    assert eventually(lambda: speed(left) > 0, 5.0)
    terminal.keys("C-c")
    terminal.until("stopped")
    assert eventually(lambda: speed(left) == 0, 5.0)
    terminal.run("stty -a | grep -o '[-]*icanon' | sed s/^/tty:/")
    terminal.until("tty:icanon")


def test_a_teleop_that_is_killed_takes_its_motion_along(stage, probe, terminal):
    stage.robby("killed")
    left = probe("killed", 3)
    terminal.run(f"{PROGRAM} teleop --tap 60")
    terminal.until("speeds 5.00")
    terminal.keys("i")
    assert eventually(lambda: speed(left) > 500, 10.0)
    os.kill(stage.pid_of("canopen_control teleop"), signal.SIGKILL)
    # the ramp takes 80 ms; without the connection's end it would be the controller's command_timeout of 2 s
    assert seconds_until(lambda: speed(left) == 0, 5.0) < 1.7


def test_the_monitor_stops_the_robot_by_a_key_also_while_a_filter_is_typed(stage, probe, terminal):
    robot = stage.robby("watched")
    drives = [probe("watched", node_id) for node_id in (3, 2)]
    command = stage.start("command", "robby_forward_controller", "5", "5", "--name", "watched")
    assert eventually(lambda: all(speed(drive) > 500 for drive in drives), 20.0)
    terminal.run(f"{PROGRAM} monitor")
    terminal.until("● OPERATION ENABLED")
    terminal.keys("/")
    terminal.until("pdo, sdo")
    terminal.keys("h", "b", "Space")
    screen = terminal.until("STOP is latched by monitor")
    assert "hb" in screen
    assert eventually(lambda: all(speed(drive) == 0 for drive in drives), 10.0)
    assert eventually(lambda: all(drive.power == "SWITCH_ON_DISABLED" for drive in drives), 10.0)
    terminal.keys("Enter")
    terminal.until("Enable")  # the keys of the screen are back
    terminal.until("heartbeat")
    terminal.keys("e")
    terminal.until("refused")
    command.end()
    terminal.keys("r")
    terminal.until("release: done")
    terminal.keys("E")
    terminal.until("● OPERATION ENABLED")
    robot.end()
    terminal.until("STOP cannot reach the robot")
    stage.robby("watched")
    terminal.until("● OPERATION ENABLED")
    terminal.keys("q")
    terminal.until("$ ")


def test_a_bare_bus_is_shown_by_its_frames(stage, terminal):
    terminal.run(f"{PROGRAM} monitor --can local:bare --eds 3=TMCM-1270.eds")
    terminal.until("bus local:bare: no program has it open")
    with contextlib.closing(open_local("bare", "somebody")):
        terminal.run(f"{PROGRAM} monitor --can local:bare --eds 3=TMCM-1270.eds")
        terminal.until("no node seen")
        stage.drive("bare", 3)
    terminal.until("TMCM-1270 (3)")
    terminal.until("PRE OPERATIONAL")
    terminal.keys("Space")
    assert "sends nothing" in terminal.until("sends nothing")
    terminal.keys("q")
