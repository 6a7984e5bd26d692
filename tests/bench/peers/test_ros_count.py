"""The ROS counter: it says when nothing comes."""

import pytest

from canopen_control.bench.clients import has_ros
from canopen_control.bench.stage import stage

pytestmark = [pytest.mark.ros, pytest.mark.skipif(not has_ros(), reason="no ROS installation")]


def test_it_counts_what_the_bridge_publishes():
    import json

    from canopen_control.bench.cycle import OURS, ROBOT, Arena

    with stage() as played:
        arena = Arena(played, 2, 10_000)
        with arena.contender(OURS, check=False):
            played.start("canopen_control.ros.bridge", "--name", ROBOT, ros=True)
            counter = played.start("canopen_control.bench.peers.ros_count", "1.0", "1", ros=True)
            assert counter.line() == "begin\n"
            counts = json.loads(counter.line())
            counter.end()
    assert all(count > 20 for count in counts.values()), counts
