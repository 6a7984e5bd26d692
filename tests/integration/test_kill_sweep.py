"""`run` is killed at every moment of its first second and a half: no process of it is there ten seconds later.

CANOPEN_CONTROL_SWEEP_MS is the step between two moments: 100 where nothing is set, 20 for the fine sweep.
"""

import os
import signal
import time

import pytest
from support.channel import channel_of
from support.processes import GONE_S

STEP_MS = int(os.environ.get("CANOPEN_CONTROL_SWEEP_MS", "100"))
SWEEP_MS = 1500


@pytest.mark.parametrize("options", [(), ("--view",), ("--ros", "--view")], ids=["drives", "view", "ros"])
@pytest.mark.embedded
def test_no_process_survives_a_run_killed_during_its_start(stage, options):
    if "--ros" in options:
        pytest.importorskip("rclpy")
    if "--view" in options:
        pytest.importorskip("nicegui")
    stage.own_interpreters = True  # their start is what is killed
    # clients start late and live on the same lifeline: fewer moments do
    moments = range(0, SWEEP_MS + 1, STEP_MS if not options else 4 * STEP_MS)
    for moment in moments:
        name = f"kill{moment}"
        robot = stage.start("run", "robby", "--as", name, "--can", channel_of(name), *options)
        time.sleep(moment / 1000)
        robot.end(signal.SIGKILL)
    stage.nobody_is_left(GONE_S)
    assert len(stage.programs) == len(moments)
