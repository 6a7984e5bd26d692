from __future__ import annotations

import pytest

from canopen_control.cli.ros import typed
from canopen_control.errors import ConfigError


@pytest.mark.parametrize(
    ("value", "declared", "result"),
    [
        (1, "double", ("double", 1.0)),
        (1, "integer", ("integer", 1)),
        (1, "not_set", ("integer", 1)),
        (0.5, "integer", ("double", 0.5)),
        (True, "double", ("bool", True)),
        ("a", "string", ("string", "a")),
        ([1, 2.5], "double_array", ("double_array", [1.0, 2.5])),
        ([1, 2], "integer_array", ("integer_array", [1, 2])),
        ([], "string_array", ("string_array", [])),
        (["a"], "not_set", ("string_array", ["a"])),
    ],
)
def test_a_value_has_the_type_of_the_parameter_where_it_fits(value, declared, result):
    kind, created = typed(value, declared)
    assert (kind, created) == result
    assert type(created) is type(result[1])


@pytest.mark.parametrize("value", [{"a": 1}, None, [1, "a"], [[1]], [None], []])
def test_what_is_not_a_parameter_is_refused(value):
    with pytest.raises(ConfigError, match="a parameter cannot be "):
        typed(value, "not_set")
