import subprocess
import sys
import time

import pytest
from argcomplete import CompletionFinder
from argcomplete.completers import SuppressCompleter
from support.lockstep import lockstep

from canopen_control.cli.support.completion_words import parser_for
from canopen_control.cli.verbs import VERBS


def complete(line):
    """Return (word, explanation) of what the last word may become, as argcomplete finds it."""
    finder = CompletionFinder(
        parser_for(line), always_complete_options=False, default_completer=SuppressCompleter(), append_space=False
    )
    text, result = " ".join(line), []
    while (whole := finder.rl_complete(text, len(result))) is not None:
        word = line[-1] + whole[len(text) :]
        result.append((word, finder.get_display_completions().get(word, "")))
    return result


def words(*line):
    return [word for word, _ in complete(line)]


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """Complete paths in a folder with one file and one folder."""
    (tmp_path / "notes.eds").touch()
    (tmp_path / "robots").mkdir()
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize("verb", VERBS)
def test_every_verb_offers_its_options_or_actions(verb):
    assert words(verb[:-1]).count(verb) == 1
    assert "--help" in words(verb, "--")


@pytest.mark.process  # bash lists files
@pytest.mark.parametrize(
    ("line", "expected"),
    [
        (["axis", "f"], ["fault-reset"]),
        (["axis", "mode", "left_drive", "CSP"], ["CSP"]),
        (["axis", "enable", "a"], ["all"]),
        (["bus", "fault", "local:x", "error"], ["error-frame"]),
        (["run", "ro"], ["robby", "robots/"]),
        (["run", "--can", "x", "ro"], ["robby", "robots/"]),
        (["run", "--mock", "ro"], ["robby", "robots/"]),
        (["run", "robby", "--bus", ""], ["notes.eds", "robots/"]),
        (["run", "--as", ""], []),
        (["help", "moni"], ["monitor"]),
        (["fault", "3", "drive_"], ["drive_fault"]),
        (["fault", "3", "drive_fault", "o"], ["on", "off"]),
        (["ros", "topic", "e"], ["echo"]),
        (["ros", "topic", "pub", "/x", ""], []),
        (["lss", "switch", "w"], ["waiting"]),
        (["lss", "switch", "--ve"], ["--vendor"]),
        (["trace", "--service", "em"], ["emcy"]),
        (["eds", "check", "TMCM"], ["TMCM-1270.eds"]),
        (["eds", "check", "a.eds", "n"], ["notes.eds"]),
        (["nonsense", "robby", "x"], []),
        (["ros", "nonsense", "topi"], ["topic"]),  # what should have been there
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
    assert complete(["controller", "activate", "joint"]) == [("joint_state_broadcaster", "active")]
    assert words("twist", "--name", "other", "") == []


def test_without_a_robot_nothing_is_offered_and_nothing_waits():
    with lockstep():
        begin = time.monotonic()
        assert words("twist", "") == []
        assert words("status", "--name", "") == []
        assert time.monotonic() == begin


@pytest.mark.process
def test_no_heavy_import_for_a_word():
    code = """
import sys
from argcomplete import CompletionFinder
from canopen_control.cli.support.completion_words import parser_for
for line in (["stat"], ["stop", "--na"], ["twist", ""], ["monitor", "--can", ""]):
    CompletionFinder(parser_for(line)).rl_complete(" ".join(line), 0)
    heavy = {"can", "canopen", "numpy", "yaml", "rclpy", "textual", "nicegui", "xacro"} & set(sys.modules)
    assert not heavy, (line, heavy)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
