"""The shared `cmd_vel` topic that teleop and Nav2 publish: Twist or TwistStamped, whichever is there.

The law of the file: one context of rclpy cannot hold two types on one name, so the type is a parameter, or, `auto`,
that of the first publisher who is seen; it changes only when all publishers of the other type have gone. The topic
leads to the active base controller; with several, which one is meant is not known, and the command is refused.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from geometry_msgs.msg import Twist, TwistStamped

from canopen_control.ros.diff_drive import send_twist
from canopen_control.ros.endpoint import Endpoint
from canopen_control.ros.qos import SYSTEM_DEFAULT

if TYPE_CHECKING:
    from canopen_control.ros.endpoint import Ros

__all__ = ["AUTO", "SharedTwist"]

AUTO: Final = "auto"
_LOOK_S: Final = 0.25
_TYPES: Final[dict[str, type]] = {"geometry_msgs/msg/Twist": Twist, "geometry_msgs/msg/TwistStamped": TwistStamped}


class SharedTwist(Endpoint):
    """The subscription of one robot; `kind` is "Twist", "TwistStamped" or "auto"."""

    def __init__(self, ros: Ros, topic: str, kind: str) -> None:
        self._ros, self._topic, self._kind = ros, topic, kind
        self._subscription: object = None
        self._type, self._next = "", 0.0
        if kind != AUTO:
            self._subscribe(f"geometry_msgs/msg/{kind}")

    def on_state(self, state: dict[str, Any]) -> None:
        """Look from time to time who publishes."""
        time = state["time"]
        # a clock that was set back does not blind it
        if self._kind != AUTO or time < self._next <= time + _LOOK_S:
            return
        self._next = time + _LOOK_S
        published = {each.topic_type for each in self._ros.node.get_publishers_info_by_topic(self._topic)}
        known = [name for name in _TYPES if name in published]
        if len(known) > 1:
            self._ros.warn(self._topic, f"{self._topic} is published as {' and as '.join(known)}; {self._type} counts")
        if known and self._type not in known:
            self._change(known[0])

    def close(self) -> None:
        """Leave the topic."""
        if self._subscription is not None:
            self._ros.unsubscribe(self._subscription)

    def _change(self, name: str) -> None:
        """Leave the one type; the other is taken at the next look, when rclpy has forgotten the first."""
        if self._subscription is None:
            self._subscribe(name)
        else:
            self.close()
            self._subscription, self._type = None, ""

    def _subscribe(self, name: str) -> None:
        self._subscription = self._ros.subscribe(_TYPES[name], self._topic, self._on_message, SYSTEM_DEFAULT)
        self._type = name

    def _on_message(self, message: Twist | TwistStamped) -> None:
        bases = [each for each in self._ros.controllers.values() if each.topic == "cmd_vel"]
        active = [each for each in bases if each.active] or bases
        if len(active) == 1:
            send_twist(self._ros, active[0], message)
            return
        names = ", ".join(each.name for each in active)
        text = (
            f"several base controllers ({names}): publish to the one that is meant" if names else "no base controller"
        )
        self._ros.warn(self._topic, f"{self._topic}: {text}")
