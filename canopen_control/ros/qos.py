"""Qualities of service as in ros2_control and robot_state_publisher.

Measured with Fast DDS: a publisher with the system default is reliable and transient local, a subscription with it
best effort and volatile. So such a publisher satisfies every subscriber, and such a subscription takes every publisher.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from canopen_control.ros.rcl import (
    DurabilityPolicy,
    Duration,
    QoSProfile,
    ReliabilityPolicy,
    qos_profile_system_default,
)

if TYPE_CHECKING:
    from collections.abc import Sequence


SYSTEM_DEFAULT = qos_profile_system_default
#: the same, and what was published before the subscription: rclcpp::SystemDefaultsQoS().transient_local()
KEPT_DEFAULT = QoSProfile(
    depth=1,
    reliability=ReliabilityPolicy.SYSTEM_DEFAULT,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
#: the last message is latched for later subscribers: robot_description, /tf_static
LATCHED = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)
#: the newest alone: reliable, as joint_state_topic_hardware_interface publishes its commands
LATEST = QoSProfile(depth=1)
#: the newest alone, of any publisher: as chainable controllers take references
REFERENCE = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT, durability=DurabilityPolicy.SYSTEM_DEFAULT)
TF = QoSProfile(depth=100)
TF_STATIC = LATCHED
EVENTS = QoSProfile(depth=50)
#: as rcl has it for the log of every node
ROSOUT = QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL, lifespan=Duration(seconds=10))


def quality_of(publishers: Sequence[Any]) -> Any:  # noqa: ANN401 - rclpy's, without types
    """Return a subscription's quality that is compatible with these publishers and receives stored messages."""
    profiles = [publisher.qos_profile for publisher in publishers]
    reliable = all(profile.reliability == ReliabilityPolicy.RELIABLE for profile in profiles)
    is_latched = bool(profiles) and all(profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for profile in profiles)
    return QoSProfile(
        depth=50,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if is_latched else DurabilityPolicy.VOLATILE,
    )
