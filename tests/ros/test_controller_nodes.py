"""Controllers as nodes, looked at by another ROS program with rclpy's own client of parameters."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from support import endpoints
from support.ros import eventually, run_ros

from canopen_control.ros import controller_nodes
from canopen_control.ros.controller_nodes import ParameterServices
from canopen_control.rpc.messages.declare import Done
from canopen_control.rpc.messages.parameters import GetParameters, ParameterReading, ParameterValue, SetParameters

pytestmark = pytest.mark.ros
READINGS_OF_PARAMETER_SERVICES = (
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
    response, requested = robot.call("base/list_parameters", READINGS_OF_PARAMETER_SERVICES)
    assert requested == [GetParameters(controller="base")]
    assert list(response.result.names) == ["joints", "linear.x.max_velocity", "timeout"]
    assert list(response.result.prefixes) == ["linear.x"]
    response, _ = robot.call("base/list_parameters", READINGS_OF_PARAMETER_SERVICES, prefixes=["linear"])
    assert list(response.result.names) == ["linear.x.max_velocity"]


def test_values_types_and_descriptors_come_in_the_order_of_the_request(robot):
    values = robot.call("base/get_parameters", READINGS_OF_PARAMETER_SERVICES, names=["timeout", "joints"])[0].values
    assert (values[0].double_value, list(values[1].string_array_value)) == (0.5, ["l", "r"])
    assert list(
        robot.call("base/get_parameter_types", READINGS_OF_PARAMETER_SERVICES, names=["timeout", "joints"])[0].types
    ) == [3, 9]
    reported = robot.call("base/describe_parameters", READINGS_OF_PARAMETER_SERVICES, names=["joints"])[0].descriptors
    assert [(item.name, item.read_only) for item in reported] == [("joints", True)]


@pytest.mark.parametrize("service", ["get_parameters", "get_parameter_types", "describe_parameters"])
def test_a_name_that_is_not_declared_leaves_the_answer_empty(robot, service):
    response, _ = robot.call(f"base/{service}", READINGS_OF_PARAMETER_SERVICES, names=["timeout", "nonsense"])
    field = {"get_parameters": "values", "get_parameter_types": "types", "describe_parameters": "descriptors"}[service]
    assert len(getattr(response, field)) == 0


def test_a_robot_that_refuses_leaves_the_answer_empty_and_why_is_reported(robot):
    response, _ = robot.call("base/list_parameters", "no controller 'base' is loaded")
    assert list(response.result.names) == []
    assert robot.collected == ["base: no controller 'base' is loaded"]


def test_each_is_set_on_its_own_in_order(robot):
    expected = parameters(timeout=1.5, wrong=2.0, other=3.0)
    response, requested = robot.call("base/set_parameters", Done(), "it is read-only", Done(), parameters=expected)
    assert [(result.successful, result.reason) for result in response.results] == [
        (True, ""), (False, "it is read-only"), (True, ""),
    ]  # fmt: skip
    assert requested[0] == SetParameters(
        controller="base", values=(ParameterValue(name="timeout", kind="double", value=1.5),)
    )
    assert [item.values[0].name for item in requested] == ["timeout", "wrong", "other"]


def test_together_they_are_one_request_and_one_result(robot):
    expected = parameters(timeout=1.5, other=3.0)
    response, (requested,) = robot.call("base/set_parameters_atomically", "no", parameters=expected)
    assert (response.result.successful, response.result.reason) == (False, "no")
    assert [value.name for value in requested.values] == ["timeout", "other"]
    assert robot.publishers == [], "nothing has changed"


def test_set_parameters_are_published_to_clients_that_show_them(robot):
    robot.call("base/set_parameters", Done(), "no", parameters=parameters(timeout=1.5, other=2.0))
    (publisher,) = robot.publishers
    assert publisher.topic == "/parameter_events"
    (event,) = publisher.collected
    assert (event.node, [parameter.name for parameter in event.changed_parameters]) == ("/robot/base", ["timeout"])
    robot.endpoint.close()
    assert publisher in robot.left


def test_a_relative_file_of_parameters_is_the_callers_where_the_caller_has_it(fresh):
    def setting(*paths):
        fresh.robot.collected.clear()
        named = [
            {"name": f"wheels{number}.params_file", "value": {"type": 4, "string_value": path}}
            for number, path in enumerate(paths)
        ]
        fresh.peer.call("/controller_manager/set_parameters", "rcl_interfaces/srv/SetParameters", parameters=named)
        return [command["values"][0]["value"] for command in fresh.robot.commands("set_parameters")]

    here = Path.cwd()
    (name, *_) = [item.name for item in here.iterdir() if item.is_file()]
    assert setting(name, "nowhere.yaml", "/whole.yaml") == [str(here / name), "nowhere.yaml", "/whole.yaml"]


READINGS = [
    {"name": "cmd_vel_timeout", "kind": "double", "value": 0.5, "low": 0.0},
    {"name": "wheel_radius", "kind": "double", "value": 0.1, "read_only": True},
]
CLIENT = """
import json, sys
import rclpy
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient

rclpy.init()
node = rclpy.create_node("looker")
def ask(future):
    rclpy.spin_until_future_complete(node, future, timeout_sec=20)
    return future.result()
client = AsyncParameterClient(node, sys.argv[1])
assert client.wait_for_services(20), "all six, or rclpy's client does not begin"
names = list(ask(client.list_parameters()).result.names)
values = [each.double_value for each in ask(client.get_parameters(names)).values]
read_only = [each.read_only for each in ask(client.describe_parameters(names)).descriptors]
types = list(ask(client.get_parameter_types(names)).types)
results = [each.successful for each in ask(client.set_parameters([Parameter("cmd_vel_timeout", value=1.5)])).results]
together = ask(client.set_parameters_atomically([Parameter("cmd_vel_timeout", value=2.5)])).result.successful
print(json.dumps([names, values, read_only, types, results, together]))
"""


def nodes(stage):
    return set(stage.peer.order("graph")["nodes"])


def test_each_controller_and_the_manager_is_a_node_as_long_as_it_is_loaded(fresh):
    expected = {"/base", "/forward", "/joint_state_broadcaster", "/controller_manager", "/canopen_control_bridge"}
    assert eventually(lambda: expected <= nodes(fresh))
    assert fresh.peer.publisher("/joint_states")["node"] == "joint_state_broadcaster"
    base = next(controller for controller in fresh.robot.controllers if controller["name"] == "base")
    fresh.robot.on_loop(lambda: fresh.robot.controllers.remove(base))
    try:
        assert eventually(lambda: "/base" not in nodes(fresh))
    finally:
        fresh.robot.on_loop(lambda: fresh.robot.controllers.append(base))
    assert eventually(lambda: "/base" in nodes(fresh))


@pytest.mark.parametrize("node", ["base", "controller_manager"])
def test_rclpys_own_client_lists_reads_describes_and_sets(fresh, ros_folder, node):
    fresh.robot.answers["parameters"] = READINGS
    ros = run_ros(CLIENT, fresh.domain, [f"/{node}"], ROS_LOG_DIR=ros_folder["ROS_LOG_DIR"])
    names, values, read_only, types, results, together = json.loads(ros)
    assert names == ["cmd_vel_timeout", "wheel_radius"]
    assert (values, read_only, types) == ([0.5, 0.1], [False, True], [3, 3])
    assert (results, together) == ([True], True)
    assert fresh.robot.commands("set_parameters") == [
        {"controller": node, "values": [{"name": "cmd_vel_timeout", "kind": "double", "value": value}]}
        for value in (1.5, 2.5)
    ]
