import argparse

import pytest

from canopen_control.cli.demo import add_arguments
from canopen_control.cli.main import main


def test_it_runs_robby_unless_another_robot_is_named():
    parser = argparse.ArgumentParser()
    add_arguments(parser)
    assert parser.parse_args([]).config == "robby"
    assert parser.parse_args(["other"]).config == "other"


@pytest.mark.process
def test_it_plays_its_motion_and_ends_with_0(capfd):
    assert main(["demo", "--can", "memory:demo", "--duration", "4"]) == 0
    said = capfd.readouterr().out
    assert "OPERATION ENABLED" in said
    assert " 10.000 " in said
