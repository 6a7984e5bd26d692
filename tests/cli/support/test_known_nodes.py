import pytest
from support.liverobot import live_robot

from canopen_control.cli.support.known_nodes import KnownNode, find_node, known_nodes
from canopen_control.errors import ConfigError

LEFT = KnownNode("robby", "local:robby", 3, "left_drive", ("left_wheel_joint",))
OTHER = KnownNode("two", "local:two", 3, "left_drive", ("left_wheel_joint",))


@pytest.mark.parametrize("word", ["left_drive", "3", "left_wheel_joint"])
def test_a_node_has_three_names(word):
    assert find_node(word, [LEFT]) is LEFT


def test_no_slave_and_more_than_one():
    assert find_node("nobody", [LEFT]) is None
    with pytest.raises(ConfigError, match=r"left_drive \(3\) of robby on local:robby, .* of two on local:two; .*--can"):
        find_node("left_drive", [LEFT, OTHER])


def test_a_running_robot_reports_its_nodes_with_bus_and_joints(private_folders):
    assert known_nodes() == []
    with live_robot("names"):
        left, right = known_nodes("memory:names")
        assert left == KnownNode("names", "memory:names", 3, "left_drive", ("left_wheel_joint",))
        assert right.words == ("right_drive", "2", "right_wheel_joint")
        assert known_nodes() == [left, right]
        assert known_nodes("memory:other") == []
