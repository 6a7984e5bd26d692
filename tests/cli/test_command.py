import pytest
from support.host import eventually
from support.lockstep import lockstep
from support.suspension import suspend_after

from canopen_control import Robot
from canopen_control.cli.main import main
from canopen_control.rpc.messages.robot import CommandController

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


def test_a_suspended_command_moves_nothing_when_it_is_resumed(mock_robot, monkeypatch, capsys):
    requested = suspend_after(monkeypatch, CommandController, 3)
    assert main(["command", FORWARD, "2", "3", "--for", "60"]) == 1
    assert [item.values for item in requested] == [[2.0, 3.0]] * 3 + [[0.0, 0.0]]
    assert capsys.readouterr().err == (
        "canopen-control: this program was suspended for 3.0 s, so its command has ended; "
        "start it again to move the robot\n"
    )


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [([FORWARD, "1"], 2, "got 1; nothing was applied"), (["nobody", "1", "1"], 2, "nobody")],
)
def test_what_the_controller_refuses_is_one_sentence(mock_robot, capsys, arguments, code, words):
    assert main(["command", *arguments, "--for", "1"]) == code
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1


def test_without_a_robot_it_suggests_how_to_start_one(capsys):
    assert main(["command", FORWARD, "1", "1"]) == 2
    assert "canopen-control run" in capsys.readouterr().err


OUTPUTS = """<robot name="cell"><link name="base"/><ros2_control name="cell" type="system">
<hardware><plugin>mock_components/GenericSystem</plugin></hardware>
<gpio name="io"><command_interface name="lamp"/><command_interface name="horn"/>
<state_interface name="lamp"/><state_interface name="horn"/></gpio></ros2_control></robot>"""
GPIO = """controller_manager: {ros__parameters: {outputs: {type: gpio_controllers/GpioCommandController}}}
outputs: {ros__parameters: {gpios: [io], command_interfaces: {io: {interfaces: [lamp, horn]}},
  safe_values: {io: {horn: 0.5}}}}"""


@pytest.fixture
def cell(private_folders, tmp_path):
    (tmp_path / "cell.urdf").write_text(OUTPUTS, encoding="utf-8")
    (tmp_path / "ros2_controllers.yaml").write_text(GPIO, encoding="utf-8")
    with lockstep(), Robot.from_config(tmp_path, name="cell") as robot:
        yield robot


def outputs(robot):
    return list(robot.joints()["io"].others.values())


def test_outputs_by_name_stay_after_once_and_the_others_are_left_alone(cell):
    assert main(["command", "outputs", "io/lamp=1", "--once"]) == 0
    assert eventually(lambda: outputs(cell) == [1.0, 0.0])
    cell.command("outputs", {"io/horn": 0.25})
    assert eventually(lambda: outputs(cell) == [1.0, 0.25])


@pytest.mark.rest
@pytest.mark.parametrize("values", [["io/lamp=1", "io/horn=1"], ["1", "1"]])
def test_outputs_are_safe_when_a_command_that_repeats_has_ended(cell, values):
    assert main(["command", "outputs", *values, "--for", "0.2"]) == 0
    assert eventually(lambda: outputs(cell) == [0.0, 0.5])


def test_an_output_that_the_robot_does_not_have_is_wrong_usage(cell, capsys):
    assert main(["command", "outputs", "io/lmp=1", "--once"]) == 2
    assert "has no output 'io/lmp' (did you mean 'io/lamp'?); nothing was applied" in capsys.readouterr().err


@pytest.mark.parametrize("values", [["io/lamp=1", "1"], ["io/lamp=1", "io/lamp=0"]])
def test_values_are_all_named_or_none_is(cell, capsys, values):
    assert main(["command", "outputs", *values]) == 2
    assert "write all values as NAME=VALUE, each name once, or all without names" in capsys.readouterr().err
