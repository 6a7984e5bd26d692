"""The ROS side of the latency bench, on the whole path."""

import json
import statistics

import pytest
from canopen_control_bench.clients import has_ros
from canopen_control_bench.cycle import ROBOT, Arena
from canopen_control_bench.stage import stage

pytestmark = [pytest.mark.ros, pytest.mark.skipif(not has_ros(), reason="no ROS installation")]


def test_commands_and_states_by_topic_are_timed():
    with stage() as played:
        arena = Arena(played, 2, 5000, base=False)
        ours = arena.ours()
        played.start("canopen_control.ros.bridge", "--name", ROBOT, ros=True)
        words = ("canopen_control_bench.peers.ros_latency", arena.channel, "5", "2")
        found = json.loads(played.start(*words, ros=True).line())
        ours.leave()
    assert [len(each) for each in found["commands"]] == [5, 5]
    assert len(found["states"]) > 50
    assert 0 < statistics.median(found["states"]) < 1000
