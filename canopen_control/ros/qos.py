"""Qualities of service, as ros2_control and robot_state_publisher have them.

Measured with Fast DDS: a publisher with the system default is reliable and transient local, a subscription with it
best effort and volatile. So such a publisher satisfies every subscriber, and such a subscription takes every publisher.
"""

from __future__ import annotations

from canopen_control.ros.rcl import DurabilityPolicy, QoSProfile, ReliabilityPolicy, qos_profile_system_default

__all__ = ["EVENTS", "LATCHED", "LATEST", "SYSTEM_DEFAULT", "TF", "TF_STATIC"]

SYSTEM_DEFAULT = qos_profile_system_default
#: the last message is kept for who comes later: robot_description, /tf_static
LATCHED = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)
#: the newest alone: reliable, as joint_state_topic_hardware_interface publishes its commands
LATEST = QoSProfile(depth=1)
TF = QoSProfile(depth=100)
TF_STATIC = LATCHED
EVENTS = QoSProfile(depth=50)
