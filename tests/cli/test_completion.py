import os
import shutil
import subprocess
import sys

import pytest

from canopen_control.cli.completion import SCRIPTS
from canopen_control.cli.main import VERBS, main

#: what readline takes for the ends of words by default
BREAKS = " \t\n\"'><=;|&(:"


@pytest.fixture
def bash(tmp_path):
    """Return what completes a line in a real bash."""
    program = tmp_path / "canopen-control"
    program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m canopen_control "$@"\n')
    program.chmod(0o755)
    for name in ("notes.eds", "with space.eds"):
        (tmp_path / name).touch()
    (tmp_path / "folder").mkdir()
    code = """
source "$SCRIPT"
COMP_LINE="$1" COMP_POINT=${#1} COMP_WORDBREAKS="$2"
_canopen_control
printf '%s\\n' "${COMPREPLY[@]}"
"""
    script = tmp_path / "completion.bash"
    script.write_text(SCRIPTS["bash"])

    def bash(line):
        environment = {**os.environ, "SCRIPT": str(script), "PATH": f"{tmp_path}:{os.environ['PATH']}"}
        environment["_ROS_WHEELS_BOOTSTRAP_COMPLETE"] = "1"
        command = ["bash", "--norc", "-c", code, "bash", line, BREAKS]
        done = subprocess.run(command, env=environment, cwd=tmp_path, capture_output=True, text=True, timeout=30)
        assert (done.returncode, done.stderr) == (0, ""), done.stderr
        return [each for each in done.stdout.split("\n") if each]

    return bash


def test_verbs_and_options_in_bash(bash):
    assert bash("canopen-control mon") == ["monitor"]
    assert bash("canopen-control st") == ["status", "stop"]
    assert set(VERBS) <= set(bash("canopen-control "))
    assert bash("canopen-control monitor --ca") == ["--can"]
    assert bash("canopen-control nonsense x") == []


def test_names_of_the_running_robot_in_bash(bash, mock_robot):
    assert bash("canopen-control status --name ") == ["mock"]
    assert bash("canopen-control command r") == ["robby_forward_controller"]
    assert bash("canopen-control controller switch --deactivate joint_state_broadcaster --name mock --activate r") == [
        "robby_forward_controller"
    ]


def test_paths_in_bash_also_with_spaces(bash):
    found = bash("canopen-control eds check ")
    assert {"TMCM-1270.eds", "notes.eds", "with space.eds", "folder"} <= set(found)
    assert bash("canopen-control scan --eds-dir ") == ["folder"]


def test_a_channel_keeps_its_colon_in_bash(bash, monkeypatch):
    from support.localbus import end_hubs

    from canopen_control.bus.channel import open_port

    port = open_port("local:robby", label="test")
    try:
        assert "local:robby" in bash("canopen-control monitor --can lo")
        assert bash("canopen-control monitor --can local:ro") == [
            "robby"
        ]  # readline keeps what stands before the colon
    finally:
        port.close()
        end_hubs()


def test_the_scripts_are_printed_and_right_by_their_shells(capsys, tmp_path):
    for shell, script in SCRIPTS.items():
        assert main(["completion", shell]) == 0
        assert capsys.readouterr().out == script
        assert "canopen-control" in script
        assert "completion words" in script
        if shutil.which(shell) is None:
            continue  # its own parser cannot be asked here
        path = tmp_path / f"script.{shell}"
        path.write_text(script)
        done = subprocess.run([shell, "-n", str(path)], capture_output=True, text=True, timeout=30)
        assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize(("opening", "closing"), ["{}", "()", "[]", '""'])
def test_brackets_and_quotes_of_the_scripts_match(opening, closing):
    for shell in ("zsh", "fish"):
        script = SCRIPTS[shell]
        cases = script.count(") _files") + script.count(") found+=")  # `pattern)` of a case has no other half
        surplus = cases if closing == ")" else 0
        if opening == closing:
            assert script.count(opening) % 2 == 0
        else:
            assert script.count(closing) - script.count(opening) == surplus


def test_words_prints_explanations_behind_tabs(capsys):
    assert main(["completion", "words", "stat"]) == 0
    assert capsys.readouterr().out == "status\twhat a running robot is doing\n"


def test_options_of_the_line_are_not_taken_for_our_own(capsys):
    assert main(["completion", "words", "--ver"]) == 0
    assert capsys.readouterr().out == "--version\n"
    assert main(["completion", "words", "run", "--help"]) == 0
    assert capsys.readouterr().out.startswith("--help\t")
    assert main(["completion", "words"]) == 0
    assert "status\t" in capsys.readouterr().out
