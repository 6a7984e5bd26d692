"""One trajectory on its way from ROS to the robot, on a connection of its own, in as many requests as it needs.

The law of the file: the connection is what the trajectory lives by, since the robot brakes when it is gone: closing it
is enough, and the bridge's death closes it as well. A bridge that hangs sends no heartbeat any more. A request is sent
when the one before it was answered, so that a large trajectory holds up neither side. Everything is on the reactor's
thread.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, TypeVar

from canopen_control.errors import CanopenError
from canopen_control.rpc.messages.trajectory import TrajectoryData, TrajectoryHeartbeat

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from canopen_control.rpc.messages.declare import Request
    from canopen_control.rpc.messages.samples import TrajectoryPoint
    from canopen_control.rpc.reactor_client import ReactorClient

    Points = list[TrajectoryPoint]

__all__ = ["HEARTBEAT_S", "TrajectorySender"]

HEARTBEAT_S: Final = 3.0
"""What a trajectory from ROS promises as its `heartbeat`."""
_BEAT_NS: Final = 500_000_000

A = TypeVar("A")


class TrajectorySender:
    """Sends trajectories one after another; `connect` makes the connection when the first one comes."""

    def __init__(self, connect: Callable[[], ReactorClient]) -> None:
        self._connect = connect
        self._client: ReactorClient | None = None

    @property
    def client(self) -> ReactorClient:
        """The connection; RemoteError if the robot is gone."""
        if self._client is None:
            self._client = self._connect()
            self._client.keep_saying(TrajectoryHeartbeat(), _BEAT_NS)
        return self._client

    def send(
        self,
        pieces: Iterator[Points],
        request: Callable[[Points], Request[A]],
        answer: Callable[[A | None, str | None], object],
    ) -> None:
        """Send all pieces, the last one with the request that is made for it; `answer(result, why not)` once."""
        try:
            self._send(next(pieces), pieces, request, answer)
        except (CanopenError, ValueError) as error:  # nothing was sent of it yet
            answer(None, str(error))

    def close(self) -> None:
        """Let go of what was sent; a second call does nothing."""
        client, self._client = self._client, None
        if client is not None:
            client.close()

    def _send(
        self,
        piece: Points,
        rest: Iterator[Points],
        request: Callable[[Points], Request[A]],
        answer: Callable[[A | None, str | None], object],
    ) -> None:
        following = next(rest, None)
        if following is None:
            self.client.ask(request(piece), answer)
            return

        def goes_on(_done: object, error: str | None) -> None:
            if error is not None:
                answer(None, error)
                return
            try:
                self._send(following, rest, request, answer)
            except (CanopenError, ValueError) as wrong:
                self.close()  # the robot drops what it has of it
                answer(None, str(wrong))

        self.client.ask(TrajectoryData(points=piece), goes_on)
