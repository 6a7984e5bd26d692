from __future__ import annotations

import pytest
from support.ros import run_ros

pytestmark = pytest.mark.ros


def test_topics_follow_from_the_kind_of_a_controller():
    code = """
from canopen_control.ros import table
from canopen_control.ros.conversions import ControllerView
def view(type, topic):
    return ControllerView("c", type, "active", (), topic, False, 0)
class Ros:
    def subscribe(self, *args): pass
    create_publisher = subscribe
    @property
    def node(self): return self
def names(type, topic):
    return [each.__class__.__name__ for each in table.endpoints_for(Ros(), view(type, topic))]
assert names("velocity_controllers/JointGroupVelocityController", "commands") == ["ForwardCommands"]
assert names("diff_drive_controller/DiffDriveController", "cmd_vel") == ["TwistCommands", "BaseOdometry"]
assert names("joint_state_broadcaster/JointStateBroadcaster", None) == [
    "JointStates", "DynamicJointStates"]
assert names("joint_state_controller/JointStateController", None) == ["JointStates", "DynamicJointStates"]
assert names("canopen_control/GpioBroadcaster", None) == ["GpioStates"]
assert names("somebody/Else", None) == []
assert names("somebody/Else", "dance") == []
"""
    assert run_ros(code) == ""
