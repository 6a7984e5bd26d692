from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from canopen_control.ros.interfaces.definition import (
    DUMMY,
    Field,
    FieldType,
    Registry,
    Shape,
    Structure,
    hash_of,
    hash_text,
    owner_of,
    parse,
)


def fields_of(*lines):
    return parse("p/msg/T", list(lines))[0].fields


@pytest.mark.parametrize(
    ("structure", "interface"),
    [("p/msg/T", "p/msg/T"), ("p/srv/S_Request", "p/srv/S"), ("p/action/A_SendGoal_Event", "p/action/A")],
)
def test_a_structure_belongs_to_an_interface(structure, interface):
    assert owner_of(structure) == interface


@pytest.mark.parametrize(
    ("line", "field"),
    [
        ("uint8 a", Field("a", FieldType(3))),
        ("char a", Field("a", FieldType(3))),
        ("float64[] a", Field("a", FieldType(11, Shape.SEQUENCE))),
        ("float64[3] a", Field("a", FieldType(11, Shape.ARRAY, 3))),
        ("string<=5[<=7] a", Field("a", FieldType(21, Shape.BOUNDED_SEQUENCE, 7, 5))),
        ("Header header", Field("header", FieldType(1, nested="std_msgs/msg/Header"))),
        ("Other[] a", Field("a", FieldType(1, Shape.SEQUENCE, nested="p/msg/Other"))),
        ("geometry_msgs/Twist a # far", Field("a", FieldType(1, nested="geometry_msgs/msg/Twist"))),
        ("int32 a 0x10", Field("a", FieldType(6), 16)),
        ("bool a true", Field("a", FieldType(15), True)),
        ("string a 'x # y'", Field("a", FieldType(17), "x # y")),
        ("int8[] a [1, -2]", Field("a", FieldType(2, Shape.SEQUENCE), [1, -2])),
    ],
)
def test_a_line_is_a_field(line, field):
    assert fields_of("# a comment", "", line) == (field,)


def test_a_constant_is_not_a_field_and_an_empty_message_has_one_byte():
    (structure,) = parse("p/msg/T", ["int32 STRICT=2", 'string NAME = "x"', "float32 HALF=0.5"])
    assert structure == Structure("p/msg/T", (Field(DUMMY, FieldType(3)),), {"STRICT": 2, "NAME": "x", "HALF": 0.5})


def test_a_service_is_request_response_event_and_itself():
    request, response, event, service = parse("p/srv/S", ["string name", "---", "bool ok"])
    assert [item.name for item in (request, response, event, service)] == [
        "p/srv/S_Request", "p/srv/S_Response", "p/srv/S_Event", "p/srv/S",
    ]  # fmt: skip
    assert [field.name for field in request.fields] == ["name"]
    assert [field.name for field in response.fields] == ["ok"]
    assert event.fields[1].type == FieldType(1, Shape.BOUNDED_SEQUENCE, 1, nested="p/srv/S_Request")
    assert [field.type.nested for field in service.fields] == ["p/srv/S_Request", "p/srv/S_Response", "p/srv/S_Event"]


@pytest.mark.parametrize("line", ["uint8", "uint8 9a", "[] a", "wstring a"])
def test_a_line_that_is_none_is_named(line):
    with pytest.raises(ValueError, match=r"cannot read|wstring"):
        fields_of(line)


@pytest.mark.parametrize("type_id", [2, 17, 1, 1 + 48, 11 + 96, 17 + 144])
def test_type_ids_go_both_ways(type_id):
    assert FieldType.of_id(type_id, 4, 0, "").type_id == type_id


def test_an_action_is_three_messages_two_services_the_feedback_and_itself():
    created = {item.name: item for item in parse("p/action/A", ["T a", "---", "int32 OK=1", "---", "uint8 b"])}
    assert [name.partition("A")[2] for name in created] == [
        "_Goal", "_Result", "_Feedback",
        "_SendGoal_Request", "_SendGoal_Response", "_SendGoal_Event", "_SendGoal",
        "_GetResult_Request", "_GetResult_Response", "_GetResult_Event", "_GetResult",
        "_FeedbackMessage", "",
    ]  # fmt: skip
    assert created["p/action/A_Goal"].fields == (Field("a", FieldType(1, nested="p/msg/T")),)
    assert created["p/action/A_Result"].constants == {"OK": 1}
    reported = {name: [field.type.nested or field.name for field in created[name].fields] for name in created}
    uuid = "unique_identifier_msgs/msg/UUID"
    assert reported["p/action/A_SendGoal_Request"] == [uuid, "p/action/A_Goal"]
    assert reported["p/action/A_SendGoal_Response"] == ["accepted", "builtin_interfaces/msg/Time"]
    assert reported["p/action/A_GetResult_Response"] == ["status", "p/action/A_Result"]
    assert reported["p/action/A_FeedbackMessage"] == [uuid, "p/action/A_Feedback"]
    assert reported["p/action/A"][3:] == ["p/action/A_SendGoal", "p/action/A_GetResult", "p/action/A_FeedbackMessage"]


@pytest.mark.parametrize(("name", "lines"), [("p/action/A", ["---"]), ("p/srv/S", []), ("p/srv/S", ["---", "---"])])
def test_an_interface_with_too_few_or_too_many_parts_is_reported(name, lines):
    with pytest.raises(ValueError, match=f"{name}: it has {len(lines) + 1} parts"):
        parse(name, lines)


GOLDEN = json.loads((Path(__file__).parents[2] / "data/ros_interfaces.json").read_text())
SHARE = Path(sys.prefix, "share")


@pytest.fixture(scope="module")
def registry():
    registry = Registry([SHARE])
    registry.add({name: each["definition"] for name, each in GOLDEN.items()})
    return registry


@pytest.mark.ros
@pytest.mark.parametrize("name", GOLDEN)
def test_the_hash_is_the_published_one(registry, name):
    assert hash_text(registry.describe(name)) == GOLDEN[name]["type_hash"]


@pytest.mark.ros
def test_the_hashes_of_every_installed_message_and_service_are_the_installed_ones():
    registry, checked = Registry([SHARE]), 0
    for path in SHARE.glob("*_msgs/[ms][sr][gv]/*.json"):
        reported = json.loads(path.read_text())["type_hashes"][0]
        assert hash_text(registry.describe(reported["type_name"])) == reported["hash_string"], reported["type_name"]
        checked += 1
    assert checked > 100


@pytest.mark.ros
def test_an_installed_message_is_the_same_from_its_text():
    name = "geometry_msgs/msg/TransformStamped"
    registry = Registry([SHARE])
    expected = registry.describe(name)
    registry.add({name: (SHARE / "geometry_msgs/msg/TransformStamped.msg").read_text().splitlines()})
    assert registry.describe(name) == expected


def test_an_unknown_structure_is_reported():
    with pytest.raises(LookupError, match="no type description of x/msg/Y; install the package x"):
        Registry([]).describe("x/msg/Y")


def test_the_hash_depends_on_every_name():
    registry = Registry()
    registry.add({"p/msg/A": ["uint8 a"], "p/msg/B": ["uint8 b"]})
    one, other = registry.describe("p/msg/A"), registry.describe("p/msg/B")
    assert hash_of(one) != hash_of(other)
    other["type_description"]["type_name"] = "p/msg/A"
    assert hash_of(one) != hash_of(other)


def test_a_definition_is_read_when_it_is_asked_for_and_a_later_one_counts():
    registry = Registry()
    registry.add({"p/msg/A": ["no-field"], "p/srv/S": ["uint8 a", "---"]})
    assert [field.name for field in registry.get("p/srv/S_Request").fields] == ["a"]
    with pytest.raises(ValueError, match="cannot read the line"):
        registry.get("p/msg/A")
    registry.add({"p/srv/S": ["uint8 b", "---"]})
    assert [field.name for field in registry.get("p/srv/S_Request").fields] == ["b"]
