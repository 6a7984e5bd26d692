"""`world pause`, `step`, `reset` and `play` on the bundled robot of Gazebo's plugin, in this process."""

from __future__ import annotations

import json

import pytest

from canopen_control import Robot
from canopen_control.cli.main import main


@pytest.fixture
def simulated(private_folders):
    robot = Robot.from_config("diffbot_sim", name="acts")
    robot.start()
    yield robot
    robot.shutdown()


@pytest.fixture
def world(capsys):
    def world(*words):
        assert main(["world", *words, "--json"]) == 0
        return json.loads(capsys.readouterr().out)

    return world


def test_it_is_paused_stepped_reset_and_continues(simulated, world, capsys):
    paused = world("pause")
    assert paused["paused"]
    assert world() == paused
    assert world("step", "25")["seconds"] == pytest.approx(paused["seconds"] + 25 * paused["period"])
    assert world("step")["seconds"] == pytest.approx(paused["seconds"] + 26 * paused["period"])
    assert main(["world", "reset"]) == 0
    assert "paused; resume with: canopen-control world play" in capsys.readouterr().out
    assert not world("play")["paused"]
    assert main(["world", "step"]) == 1
    assert "pause it first" in capsys.readouterr().err


@pytest.mark.parametrize("words", ["step 0", "step -1", "step many", "step 1.5", "step ٣", "pause now", "play 2"])
def test_what_is_not_a_number_of_cycles_and_a_value_for_nothing_are_reported(words, capsys, private_folders):
    assert main(["world", *words.split()]) == 2
    error_output = capsys.readouterr().err
    assert (
        "a number of cycles from 1 to 1000000" in error_output
        or "takes no value" in error_output
        or "unrecognized" in error_output
    )
