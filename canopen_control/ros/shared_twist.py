"""The shared `cmd_vel` topic that teleop and Nav2 publish: Twist or TwistStamped, whichever is there.

The law of the file: the topic leads to the active base controller; with several, which one is meant is not known, and
the command is refused.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.ros.base_topics import send_twist
from canopen_control.ros.endpoint import Endpoint
from canopen_control.ros.twist_subscription import TwistSubscription

if TYPE_CHECKING:
    from geometry_msgs.msg import Twist, TwistStamped

    from canopen_control.ros.endpoint import Ros
    from canopen_control.rpc.messages.state import StateSample

__all__ = ["SharedTwist"]


class SharedTwist(Endpoint):
    """The subscription of one robot; `kind` is "Twist", "TwistStamped" or "auto"."""

    def __init__(self, ros: Ros, topic: str, kind: str) -> None:
        self._ros, self._topic = ros, topic
        self._subscription = TwistSubscription(ros, topic, self._on_message, kind)

    def on_state(self, state: StateSample) -> None:
        """Follow who publishes."""
        self._subscription.look(state)

    def close(self) -> None:
        """Leave the topic."""
        self._subscription.close()

    def _on_message(self, message: Twist | TwistStamped) -> None:
        bases = [each for each in self._ros.controllers.values() if each.is_base]
        active = [each for each in bases if each.active] or bases
        if len(active) == 1:
            send_twist(self._ros, active[0], message)
            return
        names = ", ".join(each.name for each in active)
        text = (
            f"several base controllers ({names}): publish to the one that is meant" if names else "no base controller"
        )
        self._ros.warn(self._topic, f"{self._topic}: {text}")
