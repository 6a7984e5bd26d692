"""The other ROS programs (running: test_bridge)."""

from canopen_control_bench.bridge_subject import CONTROLLER
from canopen_control_bench.peers.rclpy_topics import COMMANDS, KINDS, TOPICS


def test_both_are_listened_to_on_topics_of_the_same_kinds():
    assert {frozenset(topics) for topics in TOPICS.values()} == {frozenset(KINDS)}
    assert len({name for topics in TOPICS.values() for name in topics.values()}) == 6


def test_the_controller_is_the_one_that_is_active():
    assert TOPICS["bridge"]["odom"] == f"/{CONTROLLER}/odom"
    assert COMMANDS.startswith(f"/{CONTROLLER}/")
