"""The graph as used by the command line; its uses run in tests/cli/test_ros.py."""

from __future__ import annotations

import json
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support import ros

from canopen_control.errors import ConfigError
from canopen_control.ros.graph import fill, full_name, lines, plain
from canopen_control.ros.interfaces.classes import message_class
from canopen_control.ros.interfaces.definition import parse
from canopen_control.yamlfile.reader import read

DEFINITIONS = {
    "p/msg/Inner": ["float64 x", "string name"],
    "p/msg/Outer": ["Inner one", "Inner[] many", "float64[] data", "uint8[3] three", "int32[<=2] few",
                    "bool flag", "byte raw", "string[] names", "uint16 index"],
}  # fmt: skip


def class_of(name):
    return message_class(parse(name, DEFINITIONS[name])[0], class_of, None)


def made(**data):
    return fill(class_of("p/msg/Outer")(), data, class_of)


@pytest.mark.parametrize(
    ("data", "where"),
    [
        ({"speed": 1}, r"speed is not a field of the message; the fields are: one, many"),
        ({"one": 1}, r"one has fields \(x, name\), not 1"),
        ({"many": [{"x": "fast"}]}, r"many\[0\]\.x is a double, not 'fast'"),
        ({"data": 1.0}, r"data is a list of double, not 1\.0"),
        ({"three": [1]}, "three has 3 elements, not 1"),
        ({"few": [1, 2, 3]}, "few has at most 2 elements, not 3"),
        ({"flag": 1}, "flag is a boolean, not 1"),
        ({"index": True}, "index is a uint16, not True"),
        ({"raw": 256}, "raw is a octet, not 256"),
        ({"names": [1]}, r"names\[0\] is a string, not 1"),
    ],
)
def test_what_does_not_fit_is_one_sentence_with_the_way_to_it(data, where):
    with pytest.raises(ConfigError, match=where):
        made(**data)


def test_text_is_the_yaml_that_ros2_topic_echo_prints():
    message = made(one={"x": math.nan, "name": "it's"}, many=[{"x": 2}], data=[1.5, math.inf], flag=True, raw=7)
    assert list(lines(message)) == [
        "one:", "  x: .nan", "  name: 'it''s'", "many:", "- x: 2.0", "  name: ''", "data:", "- 1.5", "- .inf",
        "three:", "- 0", "- 0", "- 0", "few: []", "flag: true", "raw: 7", "names: []", "index: 0",
    ]  # fmt: skip


@given(st.floats(), st.text("abc' :-#"), st.lists(st.floats()), st.booleans())
def test_what_is_printed_can_be_given_back(x, name, data, flag):
    message = made(one={"x": x, "name": name}, data=data, flag=flag)
    again = fill(class_of("p/msg/Outer")(), read("\n".join(lines(message)), "text").value, class_of)
    assert list(lines(again)) == list(lines(message))


@pytest.mark.parametrize("text", ["std_msgs/String", "std_msgs/msg/String"])
def test_the_short_name_of_a_type_is_understood(text):
    assert full_name(text, "msg") == "std_msgs/msg/String"


@pytest.mark.parametrize("text", ["String", "std_msgs/srv/String", "std_msgs.msg.String", "", "a/b/c"])
def test_what_is_not_a_name_of_a_type_is_one_sentence(text):
    with pytest.raises(ConfigError, match="is not an interface"):
        full_name(text, "msg")


def test_plain_data_is_what_json_holds():
    message = made(
        one={"x": math.nan, "name": "n"}, many=[{"x": 2}], data=[1.5, math.inf], flag=True, raw=7, names=["a"]
    )
    reported = plain(message)
    assert json.loads(json.dumps(reported, allow_nan=False)) == reported
    assert reported == {
        "one": {"x": None, "name": "n"}, "many": [{"x": 2.0, "name": ""}], "data": [1.5, None], "three": [0, 0, 0],
        "few": [], "flag": True, "raw": 7, "names": ["a"], "index": 0,
    }  # fmt: skip


@pytest.mark.ros
def test_a_latched_message_reaches_late_subscribers():
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


@pytest.mark.ros
def test_a_topic_of_several_types_must_be_distinguished():
    code = """
from canopen_control.ros.graph import open_graph
from canopen_control.errors import CanopenError
with open_graph() as graph:
    graph.spin(10.0, lambda: len(dict(graph._node.get_topic_names_and_types()).get("/two", ())) == 2)
    assert graph.type_of("/two", 1.0, "std_msgs/Bool") == "std_msgs/msg/Bool"
    try:
        graph.type_of("/two", 1.0)
    except CanopenError as error:
        print(error)
"""
    with ros.domain() as number, ros.Peer(number) as one, ros.Peer(number) as other:
        one.order("publish", topic="/two", of="std_msgs/msg/String", data={})
        other.order("publish", topic="/two", of="std_msgs/msg/Bool", data={})
        assert ros.run_ros(code, number).startswith("/two has several types (std_msgs/msg/")
