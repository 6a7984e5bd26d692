from __future__ import annotations

import pytest
from support.ros import run_ros

pytestmark = pytest.mark.ros


def test_topics_follow_from_the_kind_of_a_controller():
    code = """
from canopen_control.ros import table
from canopen_control.ros.conversions import ControllerView
def view(type, topic, publishes):
    return ControllerView("c", type, "active", (), topic, False, 0, None, publishes)
class Ros:
    def subscribe(self, *args): pass
    create_publisher = subscribe
    @property
    def node(self): return self
def names(type, topic, *publishes):
    return [each.__class__.__name__ for each in table.endpoints_for(Ros(), view(type, topic, publishes))]
assert names("velocity_controllers/JointGroupVelocityController", "commands") == ["ForwardCommands"]
assert names("diff_drive_controller/DiffDriveController", "cmd_vel") == ["TwistCommands", "BaseOdometry"]
broadcaster = "joint_state_broadcaster/JointStateBroadcaster"
assert names(broadcaster, None, "joint_states", "dynamic_joint_states") == ["JointStates", "DynamicJointStates"]
assert names(broadcaster, None, "c/joint_states", "c/dynamic_joint_states") == ["JointStates", "DynamicJointStates"]
assert names(broadcaster, None, "joint_states") == ["JointStates"]
assert names(broadcaster, None) == []  # not configured yet
assert names("canopen_control/GpioBroadcaster", None) == ["GpioStates"]
assert names("somebody/Else", None) == []
assert names("somebody/Else", "dance") == []
"""
    assert run_ros(code) == ""
