import subprocess
import sys
import time

import pytest

from canopen_control.cli.completion_words import DIRS, FILES, complete
from canopen_control.cli.main import VERBS


def words(*line):
    return [word for word, _ in complete(line)]


@pytest.mark.parametrize("verb", VERBS)
def test_every_verb_offers_its_options_or_actions(verb):
    assert words(verb[:-1]).count(verb) == 1
    assert "--help" in words(verb, "--")


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        (["axis", "f"], ["fault-reset"]),
        (["axis", "mode", "left_drive", "CSP"], ["CSP"]),
        (["axis", "enable", "a"], ["all"]),
        (["bus", "fault", "local:x", "error"], ["error-frame"]),
        (["run", "ro"], ["robby", DIRS]),
        (["run", "--can", "x", "ro"], ["robby", DIRS]),
        (["run", "--mock", "ro"], ["robby", DIRS]),
        (["run", "robby", "--bus", ""], [FILES]),
        (["run", "--name", ""], []),
        (["fault", "3", "drive_"], ["drive_fault"]),
        (["fault", "3", "drive_fault", "o"], ["on", "off"]),
        (["ros", "topic", "e"], ["echo"]),
        (["ros", "topic", "pub", "/x", ""], []),
        (["lss", "switch", "w"], ["waiting"]),
        (["lss", "switch", "--ve"], ["--vendor"]),
        (["trace", "--service", "em"], ["emcy"]),
        (["eds", "check", "TMCM"], ["TMCM-1270.eds", FILES]),
        (["eds", "check", "a.eds", "TMCM"], ["TMCM-1270.eds", FILES]),
        (["nonsense", ""], []),
        (["ros", "nonsense", ""], []),
        (["stop", "x", "y", ""], []),
        (["nmt", "start", "--can", "can0", ""], ["all"]),
    ],
)
def test_what_may_stand_there(line, expected):
    assert words(*line) == expected


def test_a_running_robot_gives_its_names(mock_robot):
    assert words("twist", "") == words("teleop", "--controller", "")
    assert "robby_forward_controller" in words("twist", "rob")
    assert words("status", "--name", "") == ["mock"]
    assert words("status", "--name=") == ["--name=mock"]
    assert complete(["controller", "activate", "joint"]) == [("joint_state_broadcaster", "active")]
    assert words("twist", "--name", "other", "") == []


def test_without_a_robot_nothing_is_offered_and_nothing_waits():
    begin = time.monotonic()
    assert words("twist", "") == []
    assert words("status", "--name", "") == []
    assert time.monotonic() - begin < 1.0


@pytest.mark.parametrize("line", [["stat"], ["stop", "--na"], ["twist", ""], ["monitor", "--can", ""]])
def test_no_heavy_import_for_a_word(line):
    code = f"""
import sys
from canopen_control.cli.main import main
main(["completion", "words", *{line!r}])
heavy = {{"can", "canopen", "numpy", "yaml", "rclpy", "textual", "viser", "xacro"}} & set(sys.modules)
assert not heavy, heavy
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=30)
    assert done.returncode == 0, done.stderr
