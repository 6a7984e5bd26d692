"""The time of ROS where it is not this computer's: stamps follow somebody's `/clock` with the bridge's `use_sim_time`.

The law of the file: what the robot tells is stamped with the time of ROS at which it came, and keeps that stamp; while
`/clock` stands nothing new is told, before it begins the time is 0. The stamp of a command counts by its age, and one
in the future by how far ahead it is. Timeouts are the robot's, in its own time: a `/clock` that stands puts none off. A
robot that is simulated publishes `/clock` itself, and its time is its own.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.rpc.messages.samples import stamped

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.rpc.messages.state import RobotEvent, StateSample

__all__ = ["RosTime"]


class RosTime:
    """Puts the times of messages from the robot into those of ROS, and stamps from ROS into the robot's.

    `clock` returns ROS's time in s, None where it is this computer's; `wall` Unix seconds. Of two threads each has its
    own half: `state` and `event` are the reactor's, `unix` may be anybody's.
    """

    def __init__(self, clock: Callable[[], float | None], wall: Callable[[], float]) -> None:
        self._clock, self._wall = clock, wall
        self._known: dict[str, tuple[float, float]] = {}  # of each controller: the robot's time, and that of ROS
        self._simulated = False

    def state(self, message: StateSample) -> StateSample:
        """Return a sample with ROS's times."""
        self._simulated = message.sim_time is not None
        now = self._now()
        if now is None:
            return message
        self._known = {name: self._of(name, each.time, now) for name, each in message.samples.items()}
        samples = {name: stamped(each, self._known[name][1]) for name, each in message.samples.items()}
        return stamped(message, now, samples=samples)

    def event(self, message: RobotEvent) -> RobotEvent:
        """Return an event with ROS's time."""
        now = self._now()
        return message if now is None else stamped(message, now)

    def unix(self, stamp: float | None) -> float | None:
        """Return a stamp of ROS in the robot's time; None: there is none."""
        now = self._now()
        return stamp if stamp is None or now is None else self._wall() + stamp - now

    def _now(self) -> float | None:
        return None if self._simulated else self._clock()

    def _of(self, name: str, time: float, now: float) -> tuple[float, float]:
        known = self._known.get(name)
        return known if known is not None and known[0] == time else (time, now)
