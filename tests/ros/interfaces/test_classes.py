from __future__ import annotations

from array import array

import pytest
from support.ros import run_ros

from canopen_control.ros.interfaces.classes import MadeMessage, action_class, message_class, service_class
from canopen_control.ros.interfaces.definition import Registry


@pytest.fixture
def made():
    registry = Registry()
    registry.add(
        {
            "p/msg/Point": ["float64 x", "float64 y 1.5"],
            "p/msg/All": [
                "int32 FIRST=1", "Point point", "Point[] points", "float64[] numbers", "uint8[3] three",
                "string[2] texts", "bool yes", "byte octet", "string text 'hi'", "int16[] defaults [1, 2]",
                "string<=5[<=7] short",
            ],
            "p/msg/Empty": [],
        }
    )  # fmt: skip
    classes = {}

    def class_of(name):
        if name not in classes:
            classes[name] = message_class(registry.get(name), class_of, lambda: None)
        return classes[name]

    return class_of


def test_every_field_has_its_default(made):
    message = made("p/msg/All")()
    assert (message.point.x, message.point.y) == (0.0, 1.5)
    assert (message.points, message.numbers, message.three) == ([], array("d"), array("B", [0, 0, 0]))
    assert (message.texts, message.yes, message.octet, message.text) == (["", ""], False, b"\0", "hi")
    assert (message.defaults, message.short) == ([1, 2], [])


def test_fields_are_given_by_name_and_none_is_the_default(made):
    message = made("p/msg/Point")(x=2.0, y=None)
    assert (message.x, message.y) == (2.0, 1.5)
    with pytest.raises(TypeError, match="Point has no field z"):
        made("p/msg/Point")(z=1)
    with pytest.raises(AttributeError):
        message.z = 1


def test_constants_are_the_classs_and_the_messages(made):
    assert made("p/msg/All").FIRST == made("p/msg/All")().FIRST == 1


def test_messages_are_equal_by_their_fields_whatever_kind_of_sequence_holds_them(made):
    one, other = made("p/msg/All")(numbers=[1.0]), made("p/msg/All")(numbers=array("d", [1.0]))
    assert one == other
    other.numbers = (2.0,)
    assert one != other
    assert made("p/msg/Empty")() == made("p/msg/Empty")()
    assert made("p/msg/Empty")() != made("p/msg/Point")()
    with pytest.raises(TypeError, match="unhashable"):
        hash(one)


def test_a_message_shows_its_fields(made):
    assert repr(made("p/msg/Point")()) == "p.msg.Point(x=0.0, y=1.5)"
    assert "numbers=[]" in repr(made("p/msg/All")())


def test_field_types_are_in_idls_words(made):
    assert made("p/msg/All").get_fields_and_field_types() == {
        "point": "p/Point", "points": "sequence<p/Point>", "numbers": "sequence<double>", "three": "uint8[3]",
        "texts": "string[2]", "yes": "boolean", "octet": "octet", "text": "string", "defaults": "sequence<int16>",
        "short": "sequence<string<5>, 7>",
    }  # fmt: skip


def test_the_type_support_is_made_once_when_it_is_first_asked_for():
    requests = []

    class Supports:
        def message(self, name):
            requests.append(name)
            return ("create", "destroy", "from_py", "to_py", name)

        def service(self, name):
            requests.append(name)
            return name

    registry = Registry()
    registry.add({"p/srv/S": ["bool a", "---", "bool b"]})
    parts = {
        part: message_class(registry.get(f"p/srv/S_{part}"), lambda name: MadeMessage, Supports)
        for part in ("Request", "Response", "Event")
    }
    service = service_class("p/srv/S", parts, Supports)
    assert type(service)._TYPE_SUPPORT is None
    for _ in range(2):
        type(service).__import_type_support__()
    assert type(service)._TYPE_SUPPORT == "p/srv/S"
    assert type(service.Request)._TYPE_SUPPORT == "p/srv/S_Request"
    assert type(service.Request)._CONVERT_TO_PY == "to_py"
    assert requests == ["p/srv/S", "p/srv/S_Request", "p/srv/S_Response", "p/srv/S_Event"]


def test_an_action_has_what_rclpy_asks_for_and_loads_the_supports_of_its_parts():
    requests = []

    class Supports:
        def message(self, name):
            return (None, None, None, None, name)

        def service(self, name):
            return name

        def action(self, name, cancel, status):
            requests.append((name, cancel, status))
            return f"action {name}"

    registry = Registry()
    registry.add({"p/action/A": ["bool a", "---", "int32 OK=1", "---"], "action_msgs/msg/GoalStatusArray": ["bool a"]})
    registry.add({"action_msgs/srv/CancelGoal": ["---"]})
    classes = {}

    def class_of(name):
        if name not in classes:
            classes[name] = message_class(registry.get(name), class_of, Supports)
        return classes[name]

    def service_of(name):
        parts = {item: class_of(f"{name}_{item}") for item in ("Request", "Response")}
        return classes.setdefault(name, service_class(name, parts, Supports))

    service_of("action_msgs/srv/CancelGoal")
    action = action_class("p/action/A", class_of, service_of, Supports)
    parts = [class_of(f"p/action/A_{item}") for item in ("Goal", "Result", "Feedback")]
    assert [action.Goal, action.Result, action.Feedback] == parts
    assert action.Result.OK == 1
    assert action.Impl.SendGoalService.Request is class_of("p/action/A_SendGoal_Request")
    assert action.Impl.GetResultService.Response is class_of("p/action/A_GetResult_Response")
    type(action).__import_type_support__()
    assert requests == [("p/action/A", "action_msgs/srv/CancelGoal", "action_msgs/msg/GoalStatusArray")]
    loaded = [action, action.Impl.SendGoalService, action.Impl.GetResultService, action.Impl.FeedbackMessage]
    supports = [type(item)._TYPE_SUPPORT for item in loaded]
    assert supports == [
        "action p/action/A",
        *(f"p/action/A_{item}" for item in ("SendGoal", "GetResult", "FeedbackMessage")),
    ]


SLOTS = """
import importlib, json, sys
from pathlib import Path
from canopen_control.ros.interfaces.classes import message_class
from canopen_control.ros.interfaces.definition import Registry
share, count = Path(sys.prefix, "share"), 0
registry = Registry([share])
def class_of(name):
    package, kind, short = name.split("/")
    return getattr(importlib.import_module(f"{package}.{kind}"), short)
for path in sorted(share.glob("*_msgs/msg/*.json")) + sorted(share.glob("rcl_interfaces/*/*.json")):
    name = json.loads(path.read_text())["type_description_msg"]["type_description"]["type_name"]
    try:
        theirs = class_of(name)
        ours = message_class(registry.get(name), class_of, lambda: None)
    except AttributeError:  # a service
        continue
    if not hasattr(theirs, "SLOT_TYPES"):
        continue
    assert ours.SLOT_TYPES == theirs.SLOT_TYPES, name
    assert ours().SLOT_TYPES is ours.SLOT_TYPES
    slots = [each for each in theirs.__slots__ if each != "_check_fields"]
    assert [*ours.__slots__] == slots, name
    count += 1
print(count)
"""


@pytest.mark.ros
def test_slots_and_their_types_are_those_of_ros_own_classes():
    assert int(run_ros(SLOTS)) > 100
