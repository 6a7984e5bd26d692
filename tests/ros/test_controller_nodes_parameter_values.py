from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support import endpoints

from canopen_control.ros import controller_nodes
from canopen_control.ros.controller_nodes import descriptor_of, matches, requested_value, value_of
from canopen_control.rpc.messages.parameters import ParameterReading, plain_value

pytestmark = pytest.mark.ros
TEXT = st.text(st.characters(blacklist_categories=["Cs"], blacklist_characters="\0"))
KINDS = {
    "bool": st.booleans(),
    "integer": st.integers(-(1 << 63), (1 << 63) - 1),
    "double": st.floats(),
    "string": TEXT,
    "bool_array": st.lists(st.booleans()),
    "double_array": st.lists(st.floats()),
    "string_array": st.lists(TEXT),
}


@pytest.fixture(autouse=True)
def without_libraries(monkeypatch):
    monkeypatch.setattr(controller_nodes, "interface", endpoints.interface)


def parameter(name, value):
    return endpoints.interface("rcl_interfaces/msg/Parameter")(name=name, value=value)


@given(st.sampled_from(sorted(KINDS)).flatmap(lambda kind: st.tuples(st.just(kind), KINDS[kind])))
def test_what_is_reported_to_ros_and_set_again_is_the_same(value):
    kind, plain = value
    came = requested_value(
        parameter("a.b", value_of(ParameterReading(name="a.b", kind=kind, value=plain_value(plain))))
    )
    assert (came.name, came.kind, came.value) == ("a.b", kind, plain_value(plain))


def test_a_descriptor_has_meaning_type_range_and_choices():
    told_of = descriptor_of(ParameterReading(name="t", kind="double", read_only=True, low=0.0, text="s; 0: never"))
    assert told_of.description == "s; 0: never"
    assert (told_of.name, told_of.type, told_of.read_only) == ("t", 3, True)
    (limits,) = told_of.floating_point_range
    assert (limits.from_value, limits.to_value) == (0.0, math.inf)
    (limits,) = descriptor_of(ParameterReading(name="n", kind="integer", low=1, high=9)).integer_range
    assert (limits.from_value, limits.to_value, limits.step) == (1, 9, 1)
    one_of = descriptor_of(ParameterReading(name="s", kind="string", choices=("splines", "none")))
    assert one_of.additional_constraints == "one of: splines, none"
    assert not one_of.read_only


@pytest.mark.parametrize(
    ("prefixes", "depth", "result"),
    [
        ([], 0, ["a", "a.b", "a.b.c", "ab"]),
        ([], 1, ["a", "ab"]),
        ([], 2, ["a", "a.b", "ab"]),
        (["a"], 0, ["a", "a.b", "a.b.c"]),
        (["a"], 1, ["a", "a.b"]),
        (["a.b"], 0, ["a.b", "a.b.c"]),
        (["x"], 0, []),
    ],
)
def test_names_are_listed_below_prefixes_to_a_depth(prefixes, depth, result):
    assert [name for name in ("a", "a.b", "a.b.c", "ab") if matches(name, prefixes, depth)] == result
