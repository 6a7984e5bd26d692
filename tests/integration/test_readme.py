"""What the README says was run."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from canopen_control.cli.main import VERBS, main

README = (Path(__file__).parents[2] / "README.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("code", re.findall(r"```python\n(.*?)```", README, re.DOTALL))
def test_its_python_runs(code, tmp_path):
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stderr) == (0, "")


def test_its_table_of_verbs_is_that_of_the_command_line():
    table = {
        verb for row in re.findall(r"^\| (`.*?) \|", README, re.MULTILINE) for verb in re.findall(r"`([a-z]+)", row)
    }
    assert set(VERBS) <= table


@pytest.mark.parametrize(
    "line", sorted(set(re.findall(r"^    canopen-control (.*?)(?:  +#.*)?$", README, re.MULTILINE)))
)
def test_its_commands_are_understood(line, capsys):
    """Only the parsing: each of them runs in a test of its own."""
    words = line.split()
    assert words[0] in VERBS
    words.insert(words.index("--ros-args") if "--ros-args" in words else len(words), "--help")  # ROS takes what follows
    with pytest.raises(SystemExit) as caught:
        main(words)
    assert caught.value.code == 0
