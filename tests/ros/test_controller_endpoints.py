from __future__ import annotations

import pytest
from support.ros import run_ros

pytestmark = pytest.mark.ros


def test_topics_follow_from_the_kind_of_a_controller():
    code = """
from canopen_control.ros import controller_endpoints
from canopen_control.rpc.messages.state import ControllerReading
def view(tells, topic, publishes):
    return ControllerReading(name="c", type="x/Y", state="active", tells=tells, topic=topic, publishes=publishes)
class Ros:
    def subscribe(self, *args): pass
    create_publisher = serve = frame = leave_out = unsubscribe = unserve = destroy_publisher = subscribe
    @property
    def node(self): return self
def names(tells, topic, *publishes):
    endpoints = controller_endpoints.endpoints_for(Ros(), view(tells, topic, publishes))
    return [getattr(getattr(each, "_row", None), "topic", each.__class__.__name__) for each in endpoints]
assert names(None, "commands") == ["ForwardCommands"]
assert names("odometry", "cmd_vel") == ["TwistCommands", "OdometrySetting", "odom", "cmd_vel_out", "cmd_ackermann"]
broadcaster = "joint_states"
assert names(broadcaster, None, "joint_states", "dynamic_joint_states") == ["joint_states", "dynamic_joint_states"]
assert names(broadcaster, None, "c/joint_states", "c/dynamic_joint_states") == ["joint_states", "dynamic_joint_states"]
assert names(broadcaster, None, "joint_states") == ["joint_states"]
assert names(broadcaster, None) == []  # not configured yet
assert names("gpio", None) == ["gpio_states"]
assert names("gpio", "gpio_commands") == ["GpioCommands", "gpio_states"]
assert names("diagnostics", None) == []
assert names(None, "dance") == []
proxy = ControllerReading(name="c", type="x/Y", state="active", offers=("node_services", "of a later version"))
assert [each.__class__.__name__ for each in controller_endpoints.endpoints_for(Ros(), proxy)] == ["ProxyNode"]
from canopen_control.controllers.types import TYPES, class_of
declared = {offer for name in TYPES for offer in class_of(name).offers}
assert declared - set(controller_endpoints.BY_OFFER) == {"wheel_calibration"}
assert set(controller_endpoints.BY_OFFER) <= declared
"""
    assert run_ros(code) == ""
