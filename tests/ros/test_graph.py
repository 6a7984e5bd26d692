"""The graph as the command line sees it; each way of using it runs in tests/cli/test_ros.py."""

from __future__ import annotations

import pytest
from support import ros

pytestmark = pytest.mark.ros


def test_who_keeps_a_message_for_later_is_heard_by_who_comes_later():
    code = """
from canopen_control.ros.graph import open_graph
got = []
with open_graph() as graph:
    assert graph.type_of("/kept", 10.0) == "std_msgs/msg/String"
    graph.subscribe("/kept", "std_msgs/msg/String", got.append)
    assert graph.spin(10.0, lambda: got)
assert got[0].data == "once"
"""
    with ros.domain() as number, ros.Peer(number) as peer:
        peer.order("publish", topic="/kept", of="std_msgs/msg/String", data={"data": "once"}, qos="latched")
        assert ros.run_ros(code, number) == ""


def test_a_topic_of_several_types_must_be_told_apart():
    code = """
from canopen_control.ros.graph import open_graph
from canopen_control.errors import CanopenError
with open_graph() as graph:
    graph.spin(10.0, lambda: len(dict(graph._node.get_topic_names_and_types()).get("/two", ())) == 2)
    try:
        graph.type_of("/two", 1.0)
    except CanopenError as error:
        print(error)
"""
    with ros.domain() as number, ros.Peer(number) as one, ros.Peer(number) as other:
        one.order("publish", topic="/two", of="std_msgs/msg/String", data={})
        other.order("publish", topic="/two", of="std_msgs/msg/Bool", data={})
        assert ros.run_ros(code, number).startswith("/two has several types (std_msgs/msg/")
