import threading

import pytest
from support.lockstep import lockstep

from canopen_control import Robot
from canopen_control.cli.main import main
from canopen_control.client import RobotClient
from canopen_control.rpc.messages.gripper import MoveGripper

GRIPPER = """<robot name="cell"><link name="base"/><link name="tip"/>
<joint name="finger" type="prismatic"><parent link="base"/><child link="tip"/>
<limit lower="0" upper="0.08" velocity="1" effort="9"/></joint>
<ros2_control name="cell" type="system"><hardware><plugin>mock_components/GenericSystem</plugin>
<param name="disable_commands">DISABLED</param></hardware>
<joint name="finger"><command_interface name="position"/><state_interface name="position"/>
<state_interface name="velocity"/></joint></ros2_control></robot>"""
YAML = """controller_manager: {ros__parameters: {gripper: {type: position_controllers/GripperActionController}}}
gripper: {ros__parameters: {joint: finger, stall_timeout: 0.1}}"""


@pytest.fixture
def cell(private_folders, tmp_path, request):
    disabled = getattr(request, "param", "false")
    (tmp_path / "cell.urdf").write_text(GRIPPER.replace("DISABLED", disabled), encoding="utf-8")
    (tmp_path / "ros2_controllers.yaml").write_text(YAML, encoding="utf-8")
    with lockstep(), Robot.from_config(tmp_path, name="cell") as robot:
        yield robot


def test_it_waits_until_the_gripper_is_there(cell, capsys):
    assert main(["gripper", "0.04"]) == 0
    assert capsys.readouterr().out == "the goal was reached (finger is at 0.04)\n"
    assert cell.joints()["finger"].position == 0.04
    assert cell.status().commander == "gripper"


def test_a_suspended_one_loses_its_goal_since_it_promises_heartbeats(cell, monkeypatch):
    """Of a goal whose heartbeats are missing, `test_api_trajectories` tests the end."""
    promised, ask = [], RobotClient.ask

    def spy(self, request, *timeout):
        if isinstance(request, MoveGripper):
            promised.append((request.heartbeat, "heartbeats" in [thread.name for thread in threading.enumerate()]))
        return ask(self, request, *timeout)

    monkeypatch.setattr(RobotClient, "ask", spy)
    assert main(["gripper", "0.04"]) == 0
    assert promised == [(2.0, True)]


@pytest.mark.parametrize("cell", ["true"], indirect=True)
def test_a_stall_that_is_not_allowed_is_exit_code_1(cell, capsys):
    assert main(["gripper", "0.04", "--controller", "gripper"]) == 1
    assert capsys.readouterr().err == (
        "finger has stalled at 0, 0.04 before the goal; it is held there (finger is at 0)\n"
    )


def test_what_the_controller_refuses_is_one_sentence(cell, capsys):
    assert main(["gripper", "0.09"]) == 1
    assert "expects 0 to 0.08, the limits of finger, got 0.09" in capsys.readouterr().err
    assert main(["command", "gripper", "0.04"]) == 1
    assert "accepts only goals" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["0.01", "--controller", "griper"], "no controller 'griper' is loaded; available: gripper"),
        (["0.01", "--name", "nobody"], "no robot 'nobody' is running"),
    ],
)
def test_usage_errors(cell, capsys, arguments, words):
    assert main(["gripper", *arguments]) == 2
    assert words in capsys.readouterr().err


def test_without_a_gripper_it_reports_this(mock_robot, capsys):
    assert main(["gripper", "0.01"]) == 2
    assert "no gripper action controller is active; name one with --controller" in capsys.readouterr().err
