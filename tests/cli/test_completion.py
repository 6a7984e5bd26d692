import os
import shutil
import subprocess
import sys

import pytest
from argcomplete.shell_integration import shellcode

from canopen_control.cli.completion import SHELLS
from canopen_control.cli.main import main
from canopen_control.cli.verbs import VERBS

pytestmark = pytest.mark.process

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
COMP_LINE="$1" COMP_POINT=${#1} COMP_TYPE=9 COMP_WORDBREAKS="$2"
_python_argcomplete canopen-control
printf '%s\\n' "${COMPREPLY[@]}"
"""
    script = tmp_path / "completion.bash"
    script.write_text(shellcode(["canopen-control"], use_defaults=False))

    def bash(line):
        environment = {**os.environ, "SCRIPT": str(script), "PATH": f"{tmp_path}:{os.environ['PATH']}"}
        environment["_ROS_WHEELS_BOOTSTRAP_COMPLETE"] = "1"
        command = ["bash", "--norc", "-c", code, "bash", line, BREAKS]
        done = subprocess.run(command, env=environment, cwd=tmp_path, capture_output=True, text=True, timeout=60)
        assert (done.returncode, done.stderr) == (0, ""), done.stderr
        # a single one ends with the space that readline would put there; shells quote what they would split
        return [word.removesuffix(" ").replace("\\", "") for word in done.stdout.split("\n") if word]

    return bash


def test_verbs_and_options_in_bash(bash):
    assert bash("canopen-control mon") == ["monitor"]
    assert sorted(bash("canopen-control st")) == ["status", "stop"]
    assert set(VERBS) <= set(bash("canopen-control "))
    assert bash("canopen-control monitor --ca") == ["--can"]
    assert bash("canopen-control nonsense x") == []


def test_names_of_the_running_robot_in_bash(bash, mock_robot):
    assert bash("canopen-control status --name ") == ["mock"]
    assert bash("canopen-control status --name=") == ["mock"]  # readline keeps what stands before the equals sign
    assert bash("canopen-control command r") == ["robby_forward_controller"]
    assert bash("canopen-control controller switch --deactivate joint_state_broadcaster --name mock --activate r") == [
        "robby_forward_controller"
    ]


def test_paths_in_bash_also_with_spaces(bash):
    result = bash("canopen-control eds check ")
    assert {"TMCM-1270.eds", "notes.eds", "with space.eds", "folder/"} <= set(result)
    assert bash("canopen-control scan --eds-dir ") == ["folder/"]


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


@pytest.mark.parametrize("shell", SHELLS)
def test_the_scripts_are_printed_and_right_by_their_shells(capsys, tmp_path, shell):
    assert main(["completion", shell]) == 0
    script = capsys.readouterr().out
    assert "canopen-control" in script
    assert "_ARGCOMPLETE" in script
    if shutil.which(shell) is None:
        return  # its own parser cannot be asked here
    path = tmp_path / f"script.{shell}"
    path.write_text(script)
    done = subprocess.run([shell, "-n", str(path)], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stderr) == (0, "")
