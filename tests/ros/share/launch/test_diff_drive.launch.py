from __future__ import annotations

from support.launch_stub import launched

from canopen_control.cli.main import main

NAME = "diff_drive"
CONTROLLER = ["--ros", "--controller", "robby_base_controller"]


def command(real="false", channel=""):
    return [
        "canopen-control",
        "run",
        "robby",
        f"use_real_hardware:={real}",
        f"can_interface_name:={channel}",
        *CONTROLLER,
    ]


def test_virtual_drives_are_on_the_embedded_bus_or_where_it_is_reported():
    assert launched(NAME) == ([command()], [])
    assert launched(NAME, can_interface_name="vcan0") == ([command(channel="vcan0")], [])


def test_real_drives_are_asked_for_in_the_tutorials_words():
    commands, nodes = launched(NAME, ["rviz2"], use_real_hardware="true", can_interface_name="can0")
    assert commands == [command("true", "can0")]
    assert nodes == ["rviz2"]


def test_real_drives_need_their_interface(capsys):
    assert main(["run", "robby", *command("true")[3:5]]) == 2
    assert "use_real_hardware:=true: where are the drives?" in capsys.readouterr().err
