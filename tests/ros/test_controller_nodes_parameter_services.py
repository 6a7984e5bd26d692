"""The six services of a controller's node, without ROS: what they ask of the robot, and what they answer."""

from __future__ import annotations

from pathlib import Path

import pytest
from support import endpoints

from canopen_control.ros import controller_nodes
from canopen_control.ros.controller_nodes import ParameterServices
from canopen_control.rpc.messages.declare import Done
from canopen_control.rpc.messages.parameters import GetParameters, ParameterReading, ParameterValue, SetParameters

pytestmark = pytest.mark.ros
READINGS = (
    ParameterReading(name="joints", kind="string_array", value=["l", "r"], read_only=True),
    ParameterReading(name="linear.x.max_velocity", kind="double", value=".nan", low=0.0),
    ParameterReading(name="timeout", kind="double", value=0.5),
)


@pytest.fixture
def robot(monkeypatch):
    for module in (controller_nodes, controller_nodes):
        monkeypatch.setattr(module, "interface", endpoints.interface, raising=False)
    robot = endpoints.Ros()
    robot.endpoint = ParameterServices(robot, "base")
    return robot


def parameters(**values):
    make = endpoints.interface("rcl_interfaces/msg/Parameter")
    value = endpoints.interface("rcl_interfaces/msg/ParameterValue")
    return [make(name=name, value=value(type=3, double_value=each)) for name, each in values.items()]


def test_the_six_services_are_below_the_name(robot):
    assert sorted(robot.services) == [
        f"base/{name}"
        for name in (
            "describe_parameters", "get_parameter_types", "get_parameters", "list_parameters", "set_parameters",
            "set_parameters_atomically",
        )
    ]  # fmt: skip
    robot.endpoint.close()
    assert sorted(robot.left) == sorted(robot.services)


def test_names_are_listed_with_their_prefixes(robot):
    response, asked = robot.call("base/list_parameters", READINGS)
    assert asked == [GetParameters(controller="base")]
    assert list(response.result.names) == ["joints", "linear.x.max_velocity", "timeout"]
    assert list(response.result.prefixes) == ["linear.x"]
    response, _ = robot.call("base/list_parameters", READINGS, prefixes=["linear"])
    assert list(response.result.names) == ["linear.x.max_velocity"]


def test_values_types_and_descriptors_come_in_the_order_of_the_request(robot):
    values = robot.call("base/get_parameters", READINGS, names=["timeout", "joints"])[0].values
    assert (values[0].double_value, list(values[1].string_array_value)) == (0.5, ["l", "r"])
    assert list(robot.call("base/get_parameter_types", READINGS, names=["timeout", "joints"])[0].types) == [3, 9]
    told = robot.call("base/describe_parameters", READINGS, names=["joints"])[0].descriptors
    assert [(each.name, each.read_only) for each in told] == [("joints", True)]


@pytest.mark.parametrize("service", ["get_parameters", "get_parameter_types", "describe_parameters"])
def test_a_name_that_is_not_declared_leaves_the_answer_empty(robot, service):
    response, _ = robot.call(f"base/{service}", READINGS, names=["timeout", "nonsense"])
    field = {"get_parameters": "values", "get_parameter_types": "types", "describe_parameters": "descriptors"}[service]
    assert len(getattr(response, field)) == 0


def test_a_robot_that_refuses_leaves_the_answer_empty_and_why_is_told(robot):
    response, _ = robot.call("base/list_parameters", "no controller 'base' is loaded")
    assert list(response.result.names) == []
    assert robot.told == ["base: no controller 'base' is loaded"]


def test_each_is_set_on_its_own_in_order(robot):
    wanted = parameters(timeout=1.5, wrong=2.0, other=3.0)
    response, asked = robot.call("base/set_parameters", Done(), "it is read-only", Done(), parameters=wanted)
    assert [(each.successful, each.reason) for each in response.results] == [
        (True, ""), (False, "it is read-only"), (True, ""),
    ]  # fmt: skip
    assert asked[0] == SetParameters(
        controller="base", values=(ParameterValue(name="timeout", kind="double", value=1.5),)
    )
    assert [each.values[0].name for each in asked] == ["timeout", "wrong", "other"]


def test_together_they_are_one_request_and_one_result(robot):
    wanted = parameters(timeout=1.5, other=3.0)
    response, (asked,) = robot.call("base/set_parameters_atomically", "no", parameters=wanted)
    assert (response.result.successful, response.result.reason) == (False, "no")
    assert [each.name for each in asked.values] == ["timeout", "other"]
    assert robot.publishers == [], "nothing has changed"


def test_what_was_set_is_told_to_those_who_show_parameters(robot):
    robot.call("base/set_parameters", Done(), "no", parameters=parameters(timeout=1.5, other=2.0))
    (publisher,) = robot.publishers
    assert publisher.topic == "/parameter_events"
    (event,) = publisher.told
    assert (event.node, [each.name for each in event.changed_parameters]) == ("/robot/base", ["timeout"])
    robot.endpoint.close()
    assert publisher in robot.left


def test_a_relative_file_of_parameters_is_the_callers_where_the_caller_has_it(fresh):
    def setting(*paths):
        fresh.robot.told.clear()
        named = [
            {"name": f"wheels{number}.params_file", "value": {"type": 4, "string_value": path}}
            for number, path in enumerate(paths)
        ]
        fresh.peer.call("/controller_manager/set_parameters", "rcl_interfaces/srv/SetParameters", parameters=named)
        return [each["values"][0]["value"] for each in fresh.robot.commands("set_parameters")]

    here = Path.cwd()
    (name, *_) = [each.name for each in here.iterdir() if each.is_file()]
    assert setting(name, "nowhere.yaml", "/whole.yaml") == [str(here / name), "nowhere.yaml", "/whole.yaml"]
