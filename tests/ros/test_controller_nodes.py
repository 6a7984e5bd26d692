"""Controllers as nodes, looked at by another ROS program with rclpy's own client of parameters."""

from __future__ import annotations

import json

import pytest
from support.ros import eventually, run_ros

pytestmark = pytest.mark.ros
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
    base = next(each for each in fresh.robot.controllers if each["name"] == "base")
    fresh.robot.on_loop(lambda: fresh.robot.controllers.remove(base))
    try:
        assert eventually(lambda: "/base" not in nodes(fresh))
    finally:
        fresh.robot.on_loop(lambda: fresh.robot.controllers.append(base))
    assert eventually(lambda: "/base" in nodes(fresh))


@pytest.mark.parametrize("node", ["base", "controller_manager"])
def test_rclpys_own_client_lists_reads_describes_and_sets(fresh, ros_folder, node):
    fresh.robot.answers["parameters"] = READINGS
    told = run_ros(CLIENT, fresh.domain, [f"/{node}"], ROS_LOG_DIR=ros_folder["ROS_LOG_DIR"])
    names, values, read_only, types, results, together = json.loads(told)
    assert names == ["cmd_vel_timeout", "wheel_radius"]
    assert (values, read_only, types) == ([0.5, 0.1], [False, True], [3, 3])
    assert (results, together) == ([True], True)
    assert fresh.robot.commands("set_parameters") == [
        {"controller": node, "values": [{"name": "cmd_vel_timeout", "kind": "double", "value": value}]}
        for value in (1.5, 2.5)
    ]
