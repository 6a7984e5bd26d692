from __future__ import annotations

import json

import pytest
from support.host import eventually, open_descriptors, runs

from canopen_control.host.files import state_dir
from canopen_control.runtime import prepared_bridge as module
from canopen_control.runtime.prepared_bridge import bridge_command, prepared_bridge

WAITS = """
import json, os, sys
from canopen_control.host.lifeline import gate_fd, LivenessReport

print(json.dumps([sys.argv[1:], LivenessReport().is_asked_for]), flush=True)
os.read(gate_fd(), 1)
print("open", flush=True)
"""


@pytest.fixture
def waiting(run_folder, tmp_path, monkeypatch):
    """The program in the place of the bridge, which prints its arguments and waits at its gate."""
    (tmp_path / "waiting_bridge.py").write_text(WAITS)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setattr(module, "_MODULE", "waiting_bridge")


def test_the_bridge_is_given_the_robot_and_the_options_of_ros():
    assert bridge_command("robby", ["--namespace", "two"]) == [
        "canopen_control.ros.bridge",
        "--name",
        "robby",
        "--namespace",
        "two",
    ]


@pytest.mark.process
def test_it_waits_for_the_robot_and_logs_where_the_robot_does(waiting):
    with prepared_bridge("robby", ["--namespace", "two"]) as child:
        assert child.log_path == state_dir("robby") / "ros.log"
        assert eventually(lambda: bool(child.last_lines()))
        assert json.loads(child.last_lines()[0]) == [["--name", "robby", "--namespace", "two"], True]
        child.open_gate()
        assert child.wait(60) == 0
        assert child.last_lines()[-1] == "open"


@pytest.mark.process
def test_it_ends_with_a_run_that_comes_to_nothing(waiting):
    before = open_descriptors()
    with pytest.raises(ValueError, match="no robot"), prepared_bridge("robby", []) as child:
        raise ValueError("no robot")
    assert not runs(child.pid)
    assert open_descriptors() == before
