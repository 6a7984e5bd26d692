import os
import signal
import time

import pytest
from support.host import eventually
from support.mockrobot import running
from support.suspension import suspend_after
from support.terminal import in_background

from canopen_control.cli.main import main
from canopen_control.cli.teleop import ZEROS, Sender, choose, sides
from canopen_control.client.teleop_keys import Velocities
from canopen_control.errors import ConfigError, RemoteError
from canopen_control.rpc.messages.robot import CommandController
from canopen_control.rpc.messages.state import ControllerReading

BASE, FORWARD = "robby_base_controller", "robby_forward_controller"
MS = 1_000_000


def commands(robot):
    joints = robot.status().joints
    return [joints[f"{side}_wheel_joint"].command for side in ("left", "right")]


def stopped(robot):
    return commands(robot) in ([0.0, 0.0], [-0.0, -0.0])


# -- the complete path, with a pseudo-terminal


@pytest.mark.rest
def test_keys_move_the_base_and_ctrl_c_leaves_it_standing(terminal, capsys):
    with running(controllers=[BASE]) as robot:

        def user():
            terminal.write(b"i")
            assert eventually(lambda: (commands(robot)[0] or 0.0) > 1.0 and commands(robot)[0] == commands(robot)[1])
            terminal.write(b" ")
            assert eventually(lambda: stopped(robot))
            terminal.write(b"j")
            assert eventually(lambda: (commands(robot)[1] or 0.0) > 0.5 and commands(robot)[0] == -commands(robot)[1])
            terminal.write(b"\x03")

        with in_background(user, terminal.close):
            assert main(["teleop"]) == 0
        assert eventually(lambda: stopped(robot))
    output = capsys.readouterr().out
    assert output.startswith(f"teleop of mock, {BASE}\n")
    assert "linear 0.50 m/s, angular 0.00 rad/s (speeds 0.50 and 1.00)" in output
    assert output.endswith("stopped\n")


def test_without_a_base_controller_two_wheels_are_driven_in_their_own_units(terminal, mock_robot, capsys):
    def user():
        terminal.write(b"l")
        assert eventually(lambda: commands(mock_robot) == [3.0, -3.0])
        terminal.write(b"\x03")

    with in_background(user, terminal.close):
        assert main(["teleop", "--turn", "3"]) == 0
    assert eventually(lambda: stopped(mock_robot), 1.0)
    assert f"{FORWARD} (no base controller is active" in capsys.readouterr().out


def test_a_tapped_key_stops_by_itself(terminal, mock_robot):
    def user():
        terminal.write(b"i")
        assert eventually(lambda: commands(mock_robot) == [5.0, 5.0])
        begin = time.monotonic()
        assert eventually(lambda: stopped(mock_robot))
        assert time.monotonic() - begin < 1.5  # the controller's own timeout is 2 s: it is teleop that stops
        terminal.write(b"\x04")

    with in_background(user, terminal.close):
        assert main(["teleop", "--tap", "0.3"]) == 0


def test_a_suspended_teleop_moves_nothing_when_it_is_resumed(terminal, mock_robot, monkeypatch, capsys):
    requested = suspend_after(monkeypatch, CommandController, 3)
    with in_background(lambda: terminal.write(b"i"), terminal.close):
        assert main(["teleop", "--tap", "60"]) == 1
    assert [item.values for item in requested] == [[5.0, 5.0]] * 3 + [[0.0, 0.0]] * ZEROS
    assert "this program was suspended for 3.0 s, so its command has ended" in capsys.readouterr().err


@pytest.mark.parametrize(
    "leave",
    [lambda line: line.close(), lambda _: os.kill(os.getpid(), signal.SIGHUP), lambda line: line.write(b"\x1b[O")],
    ids=["a closed terminal", "SIGHUP", "focus loss"],
)
def test_whatever_ends_it_sends_zeros(terminal, mock_robot, leave):
    def user():
        terminal.write(b"i")
        assert eventually(lambda: commands(mock_robot) == [5.0, 5.0])
        leave(terminal)
        assert eventually(lambda: stopped(mock_robot), 1.0)  # the controller's own timeout is 2 s
        if not terminal.closed:
            terminal.write(b"\x03")

    with in_background(user, terminal.close):
        assert main(["teleop", "--tap", "60"]) == 0


def test_a_robot_that_goes_is_a_sentence_and_exit_code_1(terminal, capsys):
    with running() as robot, in_background(lambda: _later(robot.shutdown)):
        assert main(["teleop"]) == 1
    assert "robot mock" in capsys.readouterr().err


def _later(call):
    time.sleep(0.3)
    call()


def test_no_terminal_is_exit_code_2(mock_robot, capsys):
    assert main(["teleop"]) == 2
    assert "terminal" in capsys.readouterr().err


def test_stamped_goes_with_a_topic(capsys):
    assert main(["teleop", "--stamped"]) == 2
    assert "--topic" in capsys.readouterr().err


# -- the commanded controller


def controller(name, state="active", topic="commands", joints=("left", "right"), interface="velocity"):
    return ControllerReading(name=name, type="", state=state, topic=topic, joints=tuple(joints), interface=interface)


BROADCASTER = controller("states", topic=None)


def test_the_active_base_controller_comes_first():
    result = choose([BROADCASTER, controller("wheels"), controller("base", topic="cmd_vel")], None)
    assert result.name == "base"


@pytest.mark.parametrize(
    ("controllers", "expected", "sentence"),
    [
        ([BROADCASTER], None, "no active controller accepts commands; loaded: states. Activate one"),
        (
            [controller("a"), controller("b")],
            None,
            "several controllers are active: a, b; choose one with --controller",
        ),
        ([controller("a")], "c", "no controller 'c'; available: a"),
        ([controller("a", state="inactive")], "a", "a is inactive; activate it: canopen-control controller activate a"),
        (
            [controller("arm", joints="abc")],
            None,
            "arm commands velocity of 3 joints; teleop drives a base or two wheels",
        ),
        ([controller("arm", interface="position")], None, "arm commands position of 2 joints"),
    ],
)
def test_what_it_cannot_drive_is_a_sentence_with_the_next_step(controllers, expected, sentence):
    with pytest.raises(ConfigError) as caught:
        choose(controllers, expected)
    assert str(caught.value).startswith(sentence)


@pytest.mark.parametrize(
    ("joints", "signs"), [(["left", "right"], (-1, 1)), (["Right_w", "Left_w"], (1, -1)), (["a", "b"], (-1, 1))]
)
def test_the_left_wheel_is_known_by_its_name_or_comes_first(joints, signs):
    assert sides(joints) == signs


# -- when it sends


class Recorder:
    title, units, speeds = "a recorder", ("m/s", "rad/s"), (1.0, 1.0)

    def __init__(self, refusals=()):
        self.sent, self.refusals = [], list(refusals)

    def send(self, velocities):
        self.sent.append(velocities.linear)
        if self.refusals:
            raise self.refusals.pop()


def test_it_sends_changes_at_once_motion_ten_times_a_second_and_zeros_a_few_times():
    recorder = Recorder()
    sender = Sender(recorder)
    for ms in range(0, 1000, 10):
        sender.send(Velocities(1.0) if ms < 300 else Velocities(), ms * MS)
    assert recorder.sent == [1.0, 1.0, 1.0] + [0.0] * ZEROS


def test_a_refusal_is_shown_and_the_end_of_the_robot_is_an_error():
    sender = Sender(Recorder([RemoteError("BusClosed", "gone"), RemoteError("ControlError", "x is not active")]))
    assert not sender.send(Velocities(1.0), 0)
    assert sender.refusal == "x is not active"
    with pytest.raises(RemoteError, match="gone"):
        sender.send(Velocities(2.0), 0)
