"""What a robot pushes to its subscribers: its events one after the other, and how often its state has to be asked for.

Of samples of the state ROS and bags ask for so many that every publication of a controller is in them.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from canopen_control.errors import RemoteError
from canopen_control.rpc.messages.robot import STREAM_RATE, Subscribe
from canopen_control.rpc.messages.state import RobotEvent

if TYPE_CHECKING:
    from collections.abc import Iterable
    from types import TracebackType

    from canopen_control.client.robot_client import RobotClient
    from canopen_control.rpc.messages.state import ControllerReading, CycleTimes

__all__ = ["EventStream", "outpaced", "stream_rate"]

_ENDED: Final = "stopped"  # the last event of a robot that was ended


class EventStream:
    """Iterates over events until none has come for `timeout` seconds (None: for ever), or the robot was ended.

    RemoteError when the robot has died instead. It closes itself at its end; who leaves earlier calls `close`, or
    uses it in a `with` block.
    """

    def __init__(self, client: RobotClient, timeout: float | None = None) -> None:
        self._client = client
        self._messages = client.messages(timeout)
        self._over = False
        client.ask(Subscribe(events=True))

    def __enter__(self) -> EventStream:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self.close()

    def __iter__(self) -> EventStream:
        return self

    def __next__(self) -> RobotEvent:
        """Wait for the next event."""
        if self._over:
            raise StopIteration
        try:
            for message in self._messages:
                if isinstance(message, RobotEvent):
                    self._over = message.kind == _ENDED
                    return message
        except RemoteError:
            self.close()
            raise
        self.close()
        raise StopIteration

    def close(self) -> None:
        """End it; a second call does nothing."""
        self._over = True
        self._client.close()


_NEARLY = 1e-6


def stream_rate(cycle: CycleTimes, wanted: float = 0.0) -> float:
    """Return the rate in Hz that a subscription gets: what is wanted, 0 for every cycle and at most STREAM_RATE.

    A sample comes after a whole number of cycles.
    """
    hz = 1.0 / cycle.period_s if cycle.period_s > 0.0 else STREAM_RATE
    every = round(hz / wanted) if wanted else math.ceil(hz / STREAM_RATE - _NEARLY)
    return hz / max(1, every)


def outpaced(controllers: Iterable[ControllerReading], rate: float) -> str | None:
    """Say which controllers publish more often than the state is asked for; None if every publication comes."""
    fast = [each for each in controllers if each.publish_rate > rate * (1.0 + _NEARLY)]
    names = ", ".join(f"{each.name} ({each.publish_rate:g} Hz)" for each in fast)
    return (
        f"{names}: published more often than the state comes, {rate:g} Hz; what is between is left out"
        if fast
        else None
    )
