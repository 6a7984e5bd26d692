from __future__ import annotations

import math

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.rpc.messages.parameters import ParameterValue, plain_value
from canopen_control.rpc.wire import decode, plain

KINDS = {
    "bool": st.booleans(),
    "integer": st.integers(-(1 << 63), (1 << 63) - 1),
    "double": st.floats(),
    "string": st.text(),
    "double_array": st.lists(st.floats()),
    "integer_array": st.lists(st.integers(-(1 << 63), (1 << 63) - 1)),
    "string_array": st.lists(st.text()),
}
VALUES = st.sampled_from(sorted(KINDS)).flatmap(lambda kind: st.tuples(st.just(kind), KINDS[kind]))


def same(one, other):
    """Compare as ROS does: not a number is equal to itself, and 1 is not 1.0."""
    if isinstance(one, list):
        return len(one) == len(other) and all(map(same, one, other))
    return type(one) is type(other) and (one == other or (one != one and other != other))


@given(VALUES)
def test_a_value_comes_over_the_wire_as_it_was(value):
    kind, given = value
    message = ParameterValue(name="a.b", kind=kind, value=plain_value(given))
    came = decode(msgspec.json.encode(message), ParameterValue)
    assert same(came.plain, given)


@pytest.mark.parametrize(("value", "text"), [(math.nan, ".nan"), (math.inf, ".inf"), (-math.inf, "-.inf")])
def test_a_double_that_is_not_finite_is_the_text_of_yaml(value, text):
    assert plain_value(value) == text
    assert plain(ParameterValue(name="x", kind="double", value=plain_value(value)))["value"] == text


@pytest.mark.parametrize("value", [True, "fast", [1.0, "slow"]])
def test_a_double_of_another_type_is_refused(value):
    kind = "double_array" if isinstance(value, list) else "double"
    with pytest.raises(ValueError, match=r"number|float"):
        _ = ParameterValue(name="x", kind=kind, value=value).plain


def test_what_is_not_a_parameter_is_not_reported():
    assert plain_value({"a": 1}) is None
    assert plain_value([1, {"a": 1}, [2]]) == [1]
