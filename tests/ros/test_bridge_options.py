from __future__ import annotations

import dataclasses
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest
from support.ros import run_ros

from canopen_control.errors import ConfigError
from canopen_control.ros import bridge_options
from canopen_control.ros.bridge_options import BridgeOptions, with_parameters
from canopen_control.yamlfile.reader import tree


class Node:
    """As much of a node as is asked: parameters that were given from outside win when they are declared."""

    def __init__(self, **inputs):
        self.given, self.declared = inputs, {}

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
    assert with_parameters(Node(), BridgeOptions(rate=20.0)) == BridgeOptions(rate=20.0)


@pytest.mark.parametrize("inputs", [{"rate": -1.0}, {"rate": 1000.1}, {"rate": "fast"}, {"cmd_vel_type": "twist"}])
def test_a_value_that_does_not_fit_is_one_sentence(inputs):
    with pytest.raises(ConfigError, match=f"parameter {next(iter(inputs))}"):
        with_parameters(Node(**inputs), BridgeOptions())


EXAMPLES = Path(bridge_options.__file__).parent / "share/examples"


def test_the_example_file_has_every_parameter_with_its_default():
    path = EXAMPLES / "bridge.yaml"
    reported = tree(path).value["/**/canopen_control_bridge"]["ros__parameters"]
    assert '\n    # frame_prefix: ""' in path.read_text(), "its default follows from the namespace"
    assert {**reported, "frame_prefix": ""} == dataclasses.asdict(BridgeOptions())


@pytest.mark.ros
@pytest.mark.parametrize("namespace", ["", "/two"])
def test_the_example_file_is_read_in_any_namespace(namespace, tmp_path):
    path = tmp_path / "bridge.yaml"
    path.write_text((EXAMPLES / "bridge.yaml").read_text().replace("rate: 0.0", "rate: 33.0"))
    code = """
import sys
from canopen_control.ros import bridge_options, rcl
context, node = rcl.start("canopen_control_bridge", sys.argv[1], ["--ros-args", "--params-file", sys.argv[2]])
print(bridge_options.with_parameters(node, bridge_options.BridgeOptions(frame_prefix="two/")))
context.shutdown()
"""
    text = run_ros(code, arguments=[namespace, str(path)])
    assert "rate=33.0" in text
    assert "frame_prefix='two/'" in text


def test_the_example_for_another_controller_manager_names_our_topics_and_never_falls_silent():
    (hardware,) = ET.parse(EXAMPLES / "topic_hardware.urdf").getroot().iter("hardware")
    reported = {item.get("name"): item.text for item in hardware.findall("param")}
    assert reported == {
        "joint_commands_topic": BridgeOptions().joint_commands_topic,
        "joint_states_topic": BridgeOptions().joint_states_topic,
        "trigger_joint_command_threshold": "-1",
    }
    controllers = tree(EXAMPLES / "topic_hardware_controllers.yaml").value
    assert set(controllers["diff_drive_controller"]["ros__parameters"]["left_wheel_names"]) == {"left_wheel_joint"}
