"""Quality of service profiles, as in ros2_control and robot_state_publisher.

Measured with Fast DDS: with the system default, a publisher is reliable and transient local, and a subscription is best
effort and volatile. So such a publisher matches every subscription, and such a subscription matches every publisher.
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
#: also receives the last message before the subscription: rclcpp::SystemDefaultsQoS().transient_local()
KEPT_DEFAULT = QoSProfile(
    depth=1,
    reliability=ReliabilityPolicy.SYSTEM_DEFAULT,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
#: transient local with the last message, for later subscribers: robot_description, /tf_static
LATCHED = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)
#: only the newest message, reliable: as joint_state_topic_hardware_interface publishes its commands
LATEST = QoSProfile(depth=1)
#: only the newest message of any publisher: as chainable controllers subscribe to references
REFERENCE = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT, durability=DurabilityPolicy.SYSTEM_DEFAULT)
TF = QoSProfile(depth=100)
TF_STATIC = LATCHED
EVENTS = QoSProfile(depth=50)
#: as in rcl for the log of every node
ROSOUT = QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL, lifespan=Duration(seconds=10))


def quality_of(publishers: Sequence[Any]) -> Any:  # noqa: ANN401 - rclpy's, without types
    """Return a subscription profile that matches all these publishers; transient local if all of them are."""
    profiles = [publisher.qos_profile for publisher in publishers]
    reliable = all(profile.reliability == ReliabilityPolicy.RELIABLE for profile in profiles)
    is_latched = bool(profiles) and all(profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for profile in profiles)
    return QoSProfile(
        depth=50,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if is_latched else DurabilityPolicy.VOLATILE,
    )
