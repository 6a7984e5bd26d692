import argparse
import json
import threading

import pytest
from support.host import eventually
from support.liverobot import live_robot
from support.lockstep import lockstep
from support.mockrobot import running

from canopen_control import Robot
from canopen_control.cli.main import main
from canopen_control.cli.support.commands import (
    add_repeat_arguments,
    positions_of,
    send,
    target_interface,
    values_at_the_end,
)
from canopen_control.errors import RemoteError
from canopen_control.rpc.messages.robot import CommandController
from canopen_control.rpc.messages.state import ControllerReading


def parse(*arguments):
    parser = argparse.ArgumentParser()
    add_repeat_arguments(parser)
    return parser.parse_args(arguments)


def test_for_and_once_exclude_each_other(capsys):
    with pytest.raises(SystemExit) as caught:
        parse("--for", "1", "--once")
    assert caught.value.code == 2
    assert "not allowed" in capsys.readouterr().err


def test_zeros_are_sent_even_if_the_robot_refuses_in_between():
    """The finally clause is what stops the wheels: a refusal in the middle may not skip it."""
    with running() as robot:
        moving = CommandController(controller="robby_forward_controller", values=[1.0, 1.0])
        zeros = CommandController(controller="robby_forward_controller", values=[0.0, 0.0])
        timer = threading.Timer(0.15, moving.values.pop)  # the robot refuses one value for two joints
        timer.start()
        with pytest.raises(RemoteError, match="1"):
            send(parse("--for", "2"), moving, zeros)
        timer.join()
        assert eventually(lambda: robot.status().joints["left_wheel_joint"].command == 0.0)


# how a command ends
ARM = "arm_position_controller"
TARGETS = [0.3, 0.4, -0.5, 0.2, 0.3, 0.1]
MIXED = [ControllerReading(name="mixed", type="", state="", required_command_interfaces=("a/position", "a/velocity"))]


@pytest.fixture
def arm(private_folders):
    with lockstep(), Robot.from_config("arm6", mock=True, name="arm") as robot:
        yield robot


def values(robot, what):
    joints = robot.status().joints
    return [getattr(joints[f"joint_{number}"], what) for number in range(1, 7)]


@pytest.mark.parametrize("end", [["--for", "1.5"], ["--once"]])
def test_a_position_is_not_a_motion_back_to_zero_when_the_command_ends(arm, end):
    """Zeros are positions too: an arm that is sent them falls back to where it began."""
    assert main(["command", ARM, *map(str, TARGETS), *end]) == 0
    assert eventually(lambda: values(arm, "position") == pytest.approx(TARGETS))
    cycle = arm.status().cycle.count
    assert eventually(lambda: arm.status().cycle.count > cycle + 25)
    assert values(arm, "position") == pytest.approx(TARGETS)


def test_the_end_of_the_command_ends_the_motion_to_a_far_position(arm):
    assert main(["command", ARM, "1.5", "0", "0", "0", "0", "0", "--for", "0.2"]) == 0
    assert eventually(lambda: values(arm, "command")[0] is None)
    assert values(arm, "position")[0] < 1.4


def test_each_value_is_known_for_what_it_is():
    assert positions_of(MIXED, "mixed") == [True, False]
    assert positions_of(MIXED, "other") == []


FORWARD = "robby_forward_controller"
OFF = "left_drive, right_drive are not enabled and will not move: canopen-control axis enable all"


@pytest.fixture
def robby(private_folders):
    with live_robot("robby"):
        yield


@pytest.mark.rest
@pytest.mark.parametrize("how", [["--for", "2"], ["--once"]])
def test_a_command_that_moves_nothing_is_exit_code_1_and_the_sentence(robby, capsys, how):
    assert main(["stop"]) == 0
    capsys.readouterr()
    assert main(["command", FORWARD, "5", "5", *how]) == 1
    error = capsys.readouterr().err
    assert error.startswith(f"canopen-control: {OFF}")
    assert error.count("\n") == 1
    assert main(["axis", "enable", "all"]) == 0
    assert main(["command", FORWARD, "5", "5", "--for", "0.3"]) == 0


@pytest.mark.rest
@pytest.mark.parametrize("how", [["--for", "0.5"], ["--once"]])
def test_a_joint_that_does_not_follow_is_named_once_and_exit_code_1_until_the_advice_is_followed(robby, capsys, how):
    assert main(["axis", "disable", "left_drive"]) == 0
    capsys.readouterr()
    assert main(["command", FORWARD, "5", "5", *how]) == 1
    advice = "canopen-control axis enable left_drive"
    text = f"canopen-control: left_wheel_joint does not follow: left_drive is not enabled: {advice}\n"
    assert capsys.readouterr().err == text
    assert main(["command", FORWARD, "0", "5", *how]) == 0  # this joint is to stand
    assert main(advice.split()[1:]) == 0
    assert main(["command", FORWARD, "5", "5", *how]) == 0


@pytest.mark.rest
def test_the_json_of_a_command_has_the_joints_that_do_not_follow(robby, capsys):
    assert main(["axis", "halt", "right_drive"]) == 0
    capsys.readouterr()
    assert main(["command", FORWARD, "5", "5", "--once", "--json"]) == 1
    idle = json.loads(capsys.readouterr().out)["idle"]
    assert idle == {"right_wheel_joint": "right_drive is halted: canopen-control axis enable right_drive"}


@pytest.mark.rest
def test_a_command_right_after_a_switch_waits_for_the_drives(robby, capsys):
    base = "robby_base_controller"
    assert main(["twist", base, "0.1", "0", "--for", "0.3"]) == 1
    error_output = capsys.readouterr().err
    assert f"controller switch --activate {base} --deactivate {FORWARD}" in error_output
    assert main(["stop"]) == 0
    assert main(["controller", "switch", "--activate", base, "--deactivate", FORWARD]) == 0
    assert main(["twist", base, "0.1", "0", "--for", "0.3"]) == 0


@pytest.mark.rest
def test_a_stop_in_the_middle_ends_the_command_with_the_sentence(robby, capsys):
    timer = threading.Timer(0.5, main, [["stop"]])
    timer.start()
    assert main(["command", FORWARD, "2", "2", "--for", "20"]) == 1
    timer.join()
    assert OFF in capsys.readouterr().err


def test_the_list_shows_what_is_only_in_the_file(robby, capsys):
    assert main(["controller", "list"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert next(line for line in lines if "robby_base_controller" in line).split()[2] == "unloaded"


def reading(topic, interface):
    names = ("lift/target",) if topic == "target" else ("lift/velocity",)
    return [
        ControllerReading(
            name="lift", type="", state="", topic=topic, interface=interface, required_command_interfaces=names
        )
    ]


@pytest.mark.parametrize(
    ("topic", "interface", "meant"),
    [("target", "velocity", "velocity"), ("target", "target", None), ("commands", "velocity", None)],
)
def test_a_target_is_sent_as_what_it_is_in_the_present_mode(topic, interface, meant):
    assert target_interface(reading(topic, interface), "lift") == meant
    assert target_interface(reading(topic, interface), "other") is None


def test_a_target_does_not_end_with_a_zero_which_could_be_a_place_to_go_to():
    assert values_at_the_end(reading("target", "position"), "lift", [2.0]) == [2.0]
    assert values_at_the_end(reading("commands", "velocity"), "lift", [2.0]) == [0.0]
