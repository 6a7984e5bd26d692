"""The time of ROS where it is not this computer's: stamps follow somebody's `/clock` with the bridge's `use_sim_time`.

The law of the file: what the robot tells is stamped with the time of ROS at which it came, and keeps that stamp; while
`/clock` stands nothing new is told, before it begins the time is 0. The stamp of a command counts by its age, and one
in the future by how far ahead it is. Timeouts are the robot's, in its own time: a `/clock` that stands puts none off. A
robot that is simulated publishes `/clock` itself: with `use_sim_time` of its controller manager, or of the bridge, its
stamps are the simulation's, else this computer's. The stamp of a command is of the one of the two that it is nearer to.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.errors import RemoteError
from canopen_control.rpc.messages.parameters import MANAGER, GetParameters
from canopen_control.rpc.messages.samples import stamped

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.client import RobotClient
    from canopen_control.rpc.messages.state import RobotEvent, StateSample

__all__ = ["RosTime", "wants_sim_time"]

_DIGITS = 6  # of seconds: what a time in Unix seconds can hold


def wants_sim_time(client: RobotClient) -> bool:
    """Return whether the controller manager of a robot has `use_sim_time`; False where nobody can say."""
    try:
        found = client.ask(GetParameters(controller=MANAGER))
    except RemoteError:
        return False
    return any(each.name == "use_sim_time" and each.value is True for each in found)


class RosTime:
    """Puts the times of messages from the robot into those of ROS, and stamps from ROS into the robot's.

    `clock` returns ROS's time in s, None where it is this computer's; `wall` Unix seconds. Of two threads each has its
    own half: `state` and `event` are the reactor's, `unix` may be anybody's. `in_simulation`: the stamps of a simulated
    robot are the simulation's.
    """

    def __init__(self, clock: Callable[[], float | None], wall: Callable[[], float]) -> None:
        self._clock, self._wall = clock, wall
        self._known: dict[str, tuple[float, float]] = {}  # of each controller: the robot's time, and that of ROS
        self.in_simulation = False
        self._simulated = False
        self._epoch: float | None = None  # of the simulation, in Unix seconds
        self._reached = 0.0  # by the simulation, in s

    def state(self, message: StateSample) -> StateSample:
        """Return a sample with ROS's times."""
        self._simulated = message.sim_time is not None
        self._epoch, self._reached = self._epoch_of(message), message.sim_time or 0.0
        if (epoch := self._epoch) is not None:
            own = {name: stamped(each, round(each.time - epoch, _DIGITS)) for name, each in message.samples.items()}
            return stamped(message, self._reached, samples=own)
        now = self._now()
        if now is None:
            return message
        self._known = {name: self._of(name, each.time, now) for name, each in message.samples.items()}
        samples = {name: stamped(each, self._known[name][1]) for name, each in message.samples.items()}
        return stamped(message, now, samples=samples)

    def event(self, message: RobotEvent) -> RobotEvent:
        """Return an event with ROS's time."""
        now = self._now() if self._epoch is None else self._reached
        return message if now is None else stamped(message, now)

    def unix(self, stamp: float | None) -> float | None:
        """Return a stamp of ROS in the robot's time; None: there is none."""
        if stamp is not None and (epoch := self._epoch) is not None:
            wall = self._wall()
            return stamp if abs(stamp - wall) < abs(stamp - (wall - epoch)) else stamp + epoch
        now = self._now()
        return stamp if stamp is None or now is None else self._wall() + stamp - now

    def _now(self) -> float | None:
        return None if self._simulated else self._clock()

    def _epoch_of(self, message: StateSample) -> float | None:
        """Return when the simulation began in Unix seconds, None where stamps are not the simulation's."""
        return message.sim_epoch if self.in_simulation or self._clock() is not None else None

    def _of(self, name: str, time: float, now: float) -> tuple[float, float]:
        known = self._known.get(name)
        return known if known is not None and known[0] == time else (time, now)
