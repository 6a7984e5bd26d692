from __future__ import annotations

import pytest
from support.ros import run_ros

pytestmark = pytest.mark.ros


def test_latched_keeps_the_last_message_and_the_default_is_the_systems():
    code = """
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy, qos_profile_system_default
from canopen_control.ros.rcl import LATCHED, SYSTEM_DEFAULT
assert SYSTEM_DEFAULT == qos_profile_system_default
assert (LATCHED.depth, LATCHED.reliability, LATCHED.durability) == (
    1, ReliabilityPolicy.RELIABLE, DurabilityPolicy.TRANSIENT_LOCAL)
"""
    assert run_ros(code) == ""
