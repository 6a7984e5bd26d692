from __future__ import annotations

import pytest

from canopen_control.ros.interfaces.definition import (
    DUMMY,
    Field,
    FieldType,
    Shape,
    Structure,
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
    assert [each.name for each in (request, response, event, service)] == [
        "p/srv/S_Request", "p/srv/S_Response", "p/srv/S_Event", "p/srv/S",
    ]  # fmt: skip
    assert [each.name for each in request.fields] == ["name"]
    assert [each.name for each in response.fields] == ["ok"]
    assert event.fields[1].type == FieldType(1, Shape.BOUNDED_SEQUENCE, 1, nested="p/srv/S_Request")
    assert [each.type.nested for each in service.fields] == ["p/srv/S_Request", "p/srv/S_Response", "p/srv/S_Event"]


@pytest.mark.parametrize("line", ["uint8", "uint8 9a", "[] a", "wstring a"])
def test_a_line_that_is_none_is_named(line):
    with pytest.raises(ValueError, match=r"cannot read|wstring"):
        fields_of(line)


@pytest.mark.parametrize("type_id", [2, 17, 1, 1 + 48, 11 + 96, 17 + 144])
def test_type_ids_go_both_ways(type_id):
    assert FieldType.of_id(type_id, 4, 0, "").type_id == type_id


def test_an_action_is_three_messages_two_services_the_feedback_and_itself():
    made = {each.name: each for each in parse("p/action/A", ["T a", "---", "int32 OK=1", "---", "uint8 b"])}
    assert [name.partition("A")[2] for name in made] == [
        "_Goal", "_Result", "_Feedback",
        "_SendGoal_Request", "_SendGoal_Response", "_SendGoal_Event", "_SendGoal",
        "_GetResult_Request", "_GetResult_Response", "_GetResult_Event", "_GetResult",
        "_FeedbackMessage", "",
    ]  # fmt: skip
    assert made["p/action/A_Goal"].fields == (Field("a", FieldType(1, nested="p/msg/T")),)
    assert made["p/action/A_Result"].constants == {"OK": 1}
    told = {name: [each.type.nested or each.name for each in made[name].fields] for name in made}
    uuid = "unique_identifier_msgs/msg/UUID"
    assert told["p/action/A_SendGoal_Request"] == [uuid, "p/action/A_Goal"]
    assert told["p/action/A_SendGoal_Response"] == ["accepted", "builtin_interfaces/msg/Time"]
    assert told["p/action/A_GetResult_Response"] == ["status", "p/action/A_Result"]
    assert told["p/action/A_FeedbackMessage"] == [uuid, "p/action/A_Feedback"]
    assert told["p/action/A"][3:] == ["p/action/A_SendGoal", "p/action/A_GetResult", "p/action/A_FeedbackMessage"]


@pytest.mark.parametrize(("name", "lines"), [("p/action/A", ["---"]), ("p/srv/S", []), ("p/srv/S", ["---", "---"])])
def test_an_interface_with_too_few_or_too_many_parts_is_reported(name, lines):
    with pytest.raises(ValueError, match=f"{name}: it has {len(lines) + 1} parts"):
        parse(name, lines)
