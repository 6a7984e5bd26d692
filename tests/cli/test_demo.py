import argparse

import pytest

from canopen_control.cli import demo
from canopen_control.cli.main import main


@pytest.mark.parametrize(
    ("words", "config"),
    [
        ([], "robby"),
        (["other"], "other"),
        (["--launch", "my.launch.py"], None),
        (["--bus", "bus.yml"], None),
        (["--description", "a.urdf"], None),
    ],
)
def test_it_runs_robby_unless_another_robot_or_its_launch_file_is_named(monkeypatch, words, config):
    ran = []
    monkeypatch.setattr(demo, "run_robot", lambda args, **_: ran.append(args.config) or 0)
    parser = argparse.ArgumentParser()
    demo.add_arguments(parser)
    assert demo.run(parser.parse_args(words)) == 0
    assert ran == [config]


@pytest.mark.process
def test_it_plays_its_motion_and_ends_with_0(stage):
    demo = stage.start("demo", "--can", "local:demo")
    demo.until(" 10.000 ", 60)  # however busy the machine is
    assert "OPERATION ENABLED" in demo.out
    assert demo.end() == 0, demo


@pytest.mark.parametrize(
    "words",
    [
        ["--real"],
        ["--real", "--can", "can0"],
        ["--can", "can0"],
        ["--can", "pcan:PCAN_USBBUS1", "--no-drives"],
        ["robby", "can_interface_name:=can0"],
        ["robby", "use_real_hardware:=true", "can_interface_name:=vcan0"],
    ],
)
def test_it_never_moves_real_drives(capsys, words):
    assert main(["demo", *words]) == 2
    error_output = capsys.readouterr().err
    assert "demo moves the robot without a command" in error_output
