from __future__ import annotations

import dataclasses

import pytest

from canopen_control.errors import ConfigError
from canopen_control.ros.options import Options, with_parameters


class Node:
    """As much of a node as is asked: parameters that were given from outside win when they are declared."""

    def __init__(self, **given):
        self.given, self.declared = given, {}

    def has_parameter(self, name):
        return name in self.declared

    def declare_parameter(self, name, default):
        value = self.given.get(name, default)
        if type(value) is not type(default):
            raise TypeError(f"wrong type {type(value).__name__}")
        self.declared[name] = value

    def get_parameter(self, name):
        return dataclasses.make_dataclass("Parameter", ["value"])(self.declared[name])


def test_without_parameters_the_arguments_count():
    assert with_parameters(Node(), Options(rate=20.0)) == Options(rate=20.0)


def test_a_parameter_wins_over_an_argument():
    assert with_parameters(Node(rate=10.0, cmd_vel_type="Twist"), Options(rate=20.0)) == Options(
        rate=10.0, cmd_vel_type="Twist"
    )


@pytest.mark.parametrize("given", [{"rate": 0.0}, {"rate": "fast"}, {"cmd_vel_type": "twist"}])
def test_a_value_that_does_not_fit_is_one_sentence(given):
    with pytest.raises(ConfigError, match=f"parameter {next(iter(given))}"):
        with_parameters(Node(**given), Options())
