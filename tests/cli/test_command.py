import pytest
from support.host import eventually

from canopen_control.cli.main import main

FORWARD = "robby_forward_controller"


def commands(robot):
    joints = robot.status().joints
    return [joints[f"{side}_wheel_joint"].command for side in ("left", "right")]


def test_values_reach_the_joints_and_zeros_follow(mock_robot):
    assert main(["command", FORWARD, "2", "3", "--for", "0.3"]) == 0
    assert eventually(lambda: commands(mock_robot) == [0.0, 0.0])
    joints = mock_robot.status().joints
    assert joints["right_wheel_joint"].position > joints["left_wheel_joint"].position > 0.2


def test_once_sends_it_once_and_leaves_the_end_to_the_controller(mock_robot):
    assert main(["command", FORWARD, "2", "3", "--once"]) == 0
    mock_robot.status()
    assert mock_robot.status().commander == "command"


def test_negative_values_are_values(mock_robot):
    assert main(["command", FORWARD, "-2", "-3.5", "--for", "0.2"]) == 0
    assert mock_robot.status().joints["left_wheel_joint"].position < 0


@pytest.mark.parametrize(
    ("arguments", "code", "words"), [([FORWARD, "1"], 1, "1"), (["nobody", "1", "1"], 2, "nobody")]
)
def test_what_the_controller_refuses_is_one_sentence(mock_robot, capsys, arguments, code, words):
    assert main(["command", *arguments, "--for", "1"]) == code
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1


def test_without_a_robot_it_says_how_to_start_one(capsys):
    assert main(["command", FORWARD, "1", "1"]) == 2
    assert "canopen-control run" in capsys.readouterr().err


@pytest.mark.parametrize("value", ["fast", "nan", "inf"])
def test_a_value_that_is_no_number_is_a_usage_error(value):
    with pytest.raises(SystemExit) as caught:
        main(["command", FORWARD, value, "1"])
    assert caught.value.code == 2
