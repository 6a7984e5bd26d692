import pytest
from support.fake_client import FakeClient

from canopen_control.cli import axis
from canopen_control.cli.main import main


def test_all_axes_of_a_robot_without_drives_are_done_at_once(mock_robot, capsys):
    assert main(["axis", "enable", "all"]) == 0
    assert capsys.readouterr().out == "enable all: done\n"


def test_a_robot_without_drives_has_no_fault_to_reset(mock_robot, capsys):
    assert main(["axis", "fault-reset", "all"]) == 1
    sentence = "nothing was reset, because the robot, which has no drive, has no fault"
    assert capsys.readouterr().err == f"canopen-control: {sentence}\n"


def test_an_unknown_node_is_one_sentence(mock_robot, capsys):
    assert main(["axis", "enable", "nobody"]) == 2
    assert "nobody" in capsys.readouterr().err


def test_a_joint_that_the_node_does_not_move_is_one_sentence(mock_robot, capsys):
    assert main(["axis", "enable", "all", "--joint", "elbow"]) == 2
    assert "all has no joint 'elbow'; available: none" in capsys.readouterr().err


@pytest.mark.parametrize(
    "words",
    [
        ["axis", "mode", "all"],
        ["axis", "enable", "all", "PP"],
        ["axis", "enable", "all", "--method", "17"],
        ["axis", "home", "all", "--method", "limit"],
    ],
)
def test_a_mode_and_a_method_go_with_their_own_actions(words):
    with pytest.raises(SystemExit) as caught:
        main(words)
    assert caught.value.code == 2


def test_homing_and_modes_are_asked_of_the_robot(mock_robot, capsys):
    assert main(["axis", "home", "all", "--method", "37"]) == 0
    assert main(["axis", "mode", "all", "PV"]) == 0
    assert capsys.readouterr().out == "home all: done\nmode all PV: done\n"


@pytest.mark.parametrize(("action", "asked"), [("home", ["home", "disable"]), ("enable", ["enable"])])
def test_an_interrupted_homing_is_stopped(monkeypatch, capsys, action, asked):
    class Interrupted(FakeClient):
        def ask(self, request, timeout=None):
            super().ask(request, timeout)
            if request.action == action:
                raise KeyboardInterrupt

    client = Interrupted()
    monkeypatch.setattr(axis.RobotClient, "connect", lambda _name: client)
    assert main(["axis", action, "left_drive"]) == 130
    assert [(request.action, request.node) for request in client.asked] == [(each, "left_drive") for each in asked]
    assert ("the homing has ended, and its drives are disabled" in capsys.readouterr().err) is (action == "home")
