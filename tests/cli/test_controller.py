import json

import pytest

from canopen_control.cli.main import main

BASE, FORWARD, STATES = "robby_base_controller", "robby_forward_controller", "joint_state_broadcaster"


@pytest.fixture
def controller(mock_robot, capsys):
    def controller(*arguments, code=0):
        assert main(["controller", *arguments]) == code
        output = capsys.readouterr()
        return output.out if code == 0 else output.err

    return controller


def states(controller):
    return {load["name"]: load["state"] for load in json.loads(controller("list", "--json"))}


def test_the_list_reports_what_each_commands(controller):
    lines = controller("list").splitlines()
    assert lines[0].split() == ["controller", "type", "state", "commands", "joints"]
    (line,) = [line for line in lines if line.startswith(FORWARD)]
    assert line.split()[2:4] == ["active", "velocity"]
    (line,) = [line for line in lines if line.startswith(BASE)]
    assert line.split()[2:] == ["unloaded", "-", "-"]
    (line,) = [line for line in lines if line.startswith(STATES)]
    assert "none (broadcaster)" in line


def test_types_and_hardware(controller):
    assert "diff_drive_controller/DiffDriveController" in controller("types").splitlines()
    assert "diff_drive_controller/DiffDriveController" in json.loads(controller("types", "--json"))
    shown = controller("hardware")
    assert "command  left_wheel_joint/velocity (claimed)" in shown
    assert json.loads(controller("hardware", "--json"))[0]["state"] == "active"


def test_a_controller_is_loaded_configured_switched_and_unloaded(controller):
    assert controller("load", BASE) == f"{BASE}: inactive\n"
    assert controller("configure", BASE) == f"{BASE}: inactive\n"
    assert states(controller)[BASE] == "inactive"
    text = controller("switch", "--activate", BASE, "--deactivate", FORWARD)
    assert text == f"{FORWARD}: inactive\n{BASE}: active\n"
    assert controller("deactivate", BASE) == f"{BASE}: inactive\n"
    assert controller("unload", BASE) == f"{BASE}: unloaded\n"
    assert states(controller)[BASE] == "unloaded"


def test_activate_does_what_is_missing(controller):
    controller("deactivate", FORWARD)
    assert controller("activate", BASE) == f"{BASE}: active\n"
    assert controller("activate", BASE, "--best-effort") == f"{BASE}: active, unchanged\n"


@pytest.mark.parametrize(
    ("arguments", "code", "sentence"),
    [
        (["activate", BASE], 1, "claimed by robby_forward_controller"),
        (["unload", FORWARD], 1, "is active; deactivate it"),
        (["load", "robby_bas_controller"], 2, "did you mean"),
        (["deactivate", "nothing"], 2, "known: joint_state_broadcaster, robby_forward_controller"),
        (["switch"], 2, "nothing to switch; give --activate"),
    ],
)
def test_what_is_refused_is_a_sentence_and_changes_nothing(controller, arguments, code, sentence):
    before = states(controller)
    assert sentence in controller(*arguments, code=code)
    after = states(controller)
    assert {name: after[name] for name in before} == before
