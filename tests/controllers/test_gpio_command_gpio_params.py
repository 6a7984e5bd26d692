from __future__ import annotations

import math

import pytest

from canopen_control.controllers.gpio_command import read_params
from canopen_control.controllers.params import Params
from canopen_control.errors import RobotConfigError

IO = {"gpios": ["io", "valve"], "command_interfaces": {"io": {"interfaces": ["lamp", "horn"]}}}


def read(joints=(), **more):
    return read_params(Params.of({**IO, **more}), "outputs", joints)


def test_outputs_and_inputs_are_in_the_order_of_the_parameters():
    both = {"valve": {"interfaces": ["open"]}, "io": {"interfaces": ["horn", "lamp"]}}
    arguments = read(command_interfaces=both, state_interfaces={"io": {"interfaces": ["pressed"]}})
    assert arguments.outputs == ["io/horn", "io/lamp", "valve/open"]
    assert arguments.inputs == ["io/pressed"]
    assert arguments.unnamed_gpios == ["valve"]


def test_an_output_is_safe_at_zero_unless_another_value_is_written_or_it_is_kept():
    inputs = read(safe_values={"io": {"horn": 0.5}}, kept_outputs=["io/lamp"])
    assert inputs.safe_value("io/horn", 1.0) == 0.5
    assert math.isnan(inputs.safe_value("io/lamp", 1.0))
    assert read().safe_value("io/lamp", None) == 0.0
    assert read().safe_value("io/lamp", 1.0) == 1.0
    assert math.isnan(read().safe_value("io/lamp", math.nan))


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({"gpios": []}, "no 'gpios'; give it"),
        ({"gpios": ["io", "io"]}, "gpios contains a name twice"),
        (
            {"command_interfaces": {"i": {"interfaces": ["lamp"]}}},
            "command_interfaces.i.interfaces is not NAME.interfaces",
        ),
        ({"state_interfaces": {"io": {"lamp": ["lamp"]}}}, "state_interfaces.io.lamp is not NAME.interfaces"),
        ({"command_interfaces": {"io": {"interfaces": ["lamp", "lamp"]}}}, "contains a name twice: lamp; list"),
        ({"safe_values": {"io": {"lmp": 1.0}}}, "safe_values.io.lmp is not in command_interfaces"),
        ({"safe_values": {"io": {"lamp": math.inf}}}, "safe_values.io.lamp is inf; give a finite number"),
        ({"kept_outputs": ["lamp"]}, "kept_outputs: 'lamp' is not in command_interfaces"),
    ],
)
def test_what_cannot_be_is_reported_with_its_name(more, words):
    with pytest.raises(RobotConfigError, match=r"^outputs: ") as caught:
        read(**more)
    assert words in str(caught.value)


@pytest.mark.parametrize("interface", ["position", "velocity", "effort", "acceleration"])
def test_what_moves_a_joint_is_not_an_output(interface):
    both = {"gpios": ["wheel"], "command_interfaces": {"wheel": {"interfaces": [interface]}}}
    with pytest.raises(RobotConfigError, match="moves a joint and is not an output"):
        read(joints=("wheel",), **both)
    assert read(joints=("arm",), **both).outputs == [f"wheel/{interface}"]
