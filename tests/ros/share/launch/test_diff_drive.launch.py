from __future__ import annotations

import pytest
from support.launch_stub import launched

from canopen_control.cli.main import main

NAME = "diff_drive"
ROBBY = ["canopen-control", "run", "robby", "--ros", "--controller", "robby_base_controller", "--can"]


def test_virtual_drives_are_on_the_embedded_bus_or_where_it_is_said():
    assert launched(NAME) == ([[*ROBBY, "local:robby"]], [])
    assert launched(NAME, can_interface_name="vcan0") == ([[*ROBBY, "vcan0"]], [])


def test_real_drives_are_asked_for_in_the_tutorials_words():
    commands, nodes = launched(NAME, ["rviz2"], use_real_hardware="true", can_interface_name="can0")
    assert commands == [[*ROBBY, "can0", "--real"]]
    assert nodes == ["rviz2"]


def test_the_command_line_understands_the_command(capsys):
    ((_, *command),), _ = launched(NAME, use_real_hardware="true", can_interface_name="can0")
    with pytest.raises(SystemExit) as caught:
        main([*command, "--help"])
    assert caught.value.code == 0
