"""One topic on which velocities come as Twist or as TwistStamped, whichever is published.

The law of the file: one context of rclpy cannot hold two types on one name, so there is one subscription at a time. Its
type is what was asked for, or, `auto`, that of the first publisher who is seen; it changes only when all publishers of
the other type have gone, and between two looks.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from geometry_msgs.msg import Twist, TwistStamped

from canopen_control.ros.qos import SYSTEM_DEFAULT

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.ros.endpoint import Ros
    from canopen_control.rpc.messages.state import StateSample

__all__ = ["AUTO", "TwistSubscription"]

AUTO: Final = "auto"
_LOOK_S: Final = 0.25
_PACKAGE: Final = "geometry_msgs/msg/"
_TYPES: Final[dict[str, type]] = {f"{_PACKAGE}Twist": Twist, f"{_PACKAGE}TwistStamped": TwistStamped}


class TwistSubscription:
    """A subscription to `topic`; `kind` is "Twist", "TwistStamped" or "auto", `first` what it is before anybody comes.

    `on_message` gets a Twist or a TwistStamped.
    """

    def __init__(
        self,
        ros: Ros,
        topic: str,
        on_message: Callable[[Twist | TwistStamped], object],
        kind: str = AUTO,
        first: str = "",
        quality: object = SYSTEM_DEFAULT,
    ) -> None:
        self._ros, self._topic, self._on_message, self._auto = ros, topic, on_message, kind == AUTO
        self._subscription: object = None
        self._quality = quality
        self._type, self._next = "", 0.0
        wanted = first if self._auto else kind
        if wanted:
            self._subscribe(f"{_PACKAGE}{wanted}")

    def look(self, state: StateSample) -> None:
        """Look, from time to time, who publishes; for every sample of the state stream."""
        time = state.time
        # a clock that was set back does not blind it
        if not self._auto or time < self._next <= time + _LOOK_S:
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
        self._subscription = self._ros.subscribe(_TYPES[name], self._topic, self._on_message, self._quality)
        self._type = name
