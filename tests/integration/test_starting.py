"""A robot that starts waits for what it started: however long that takes, nothing is reported before.

With `--spawn` the drives begin as interpreters, which takes long enough for a test to stop them; forks do not.
"""

import os
import signal
import time

import pytest
from support.channel import channel_of


@pytest.mark.embedded
def test_drives_that_need_seconds_to_start_are_waited_for_and_nothing_is_told_before(stage):
    robot = stage.start("run", "robby", "--spawn", "--as", "slow", "--can", channel_of("slow"), "--for", "1")
    drives = [stage.pid_of(f"--node-id {node_id}") for node_id in (2, 3)]
    for pid in drives:
        os.kill(pid, signal.SIGSTOP)
    time.sleep(4)  # a boot would have failed by now
    assert robot.out == ""
    for pid in drives:
        os.kill(pid, signal.SIGCONT)
    assert robot.wait() == 0
    assert robot.out.startswith("node "), robot.out
    assert "operational after" in robot.out.splitlines()[0]
    assert "error" not in robot.out
    assert not list(stage.place.glob("**/flight/*.zip"))


@pytest.mark.embedded
def test_ctrl_c_while_the_drives_start_ends_it(stage):
    robot = stage.start("run", "robby", "--spawn", "--as", "early", "--can", channel_of("early"))
    drive = stage.pid_of("--node-id 2")
    os.kill(drive, signal.SIGSTOP)
    time.sleep(1)
    robot.send(signal.SIGINT)
    time.sleep(0.2)
    os.kill(drive, signal.SIGCONT)
    assert robot.wait() == 0
    assert "early has stopped before it began" in robot.out
