"""`record --bag` with a robot on mock hardware."""

import os
import signal
import threading

import pytest
from support.host import eventually
from support.mockrobot import running

from canopen_control.cli.record import record_bag
from canopen_control.errors import ConfigError

rosbag2 = pytest.importorskip("rosbags.rosbag2", reason="rosbags is not installed: pip install canopen-control[bag]")


def topics(path):
    with rosbag2.Reader(path) as reader:
        return {connection.topic: connection.msgcount for connection in reader.connections}


@pytest.mark.rest
def test_a_bag_of_a_running_robot(tmp_path):
    with running("bagged"):
        recorded = record_bag("bagged", str(tmp_path / "run"), 0.5)
    assert recorded.samples >= 10
    result = topics(tmp_path / "run")
    assert result["/joint_states"] == result["/tf"] == recorded.samples
    assert sum(result.values()) == recorded.messages
    assert f"{recorded.messages} messages of bagged" in recorded.sentence()


def test_what_a_lower_rate_leaves_out_is_reported(tmp_path):
    with running("slowly"):
        recorded = record_bag("slowly", str(tmp_path / "run"), 0.5, 10.0)
    assert 1 <= recorded.samples <= 10.0 * recorded.seconds + 2
    assert "joint_state_broadcaster (50 Hz): published more often than the samples at 10 Hz" in recorded.sentence()


def test_ctrl_c_finishes_the_bag(tmp_path):
    def interrupt(robot):
        eventually((tmp_path / "run").exists)
        first = robot.status().cycle.count
        eventually(lambda: robot.status().cycle.count > first + 25)
        os.kill(os.getpid(), signal.SIGINT)

    with running("broken") as robot:
        user = threading.Thread(target=interrupt, args=(robot,))
        user.start()
        recorded = record_bag("broken", str(tmp_path / "run"), None)
        user.join()
    assert recorded.samples >= 5
    assert topics(tmp_path / "run")["/joint_states"] == recorded.samples


def test_a_robot_that_ends_leaves_a_whole_bag(tmp_path):
    with running("ending") as robot:
        timer = threading.Timer(0.3, robot.shutdown)
        timer.start()
        recorded = record_bag("ending", str(tmp_path / "run"), 60.0)
        timer.join()
    assert recorded.events >= 1
    assert topics(tmp_path / "run")["/rosout"] == recorded.events


@pytest.mark.parametrize(
    ("name", "rate", "words"), [("nobody", 50.0, "nobody"), (None, 0.0, "--rate"), (None, 1e6, "--rate")]
)
def test_what_cannot_be_is_a_sentence(tmp_path, name, rate, words):
    with pytest.raises(ConfigError, match=words):
        record_bag(name, str(tmp_path / "run"), 1.0, rate)
    assert not (tmp_path / "run").exists()
