"""Client of a running robot: its events, the rate of its samples, trajectories of any length, repeated calls."""

from __future__ import annotations

import contextlib
import math
import threading
from typing import TYPE_CHECKING, Final

from canopen_control.errors import RemoteError
from canopen_control.host.lineclient import LineClient
from canopen_control.host.sockets import select_robot, socket_path
from canopen_control.rpc.client import Client
from canopen_control.rpc.messages.robot import ROBOT, STREAM_RATE, RobotHello, RobotPush, SdoPiece, SdoWrite, Subscribe
from canopen_control.rpc.messages.state import RobotEvent
from canopen_control.rpc.messages.trajectory import TrajectoryData, TrajectoryHeartbeat

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator
    from types import TracebackType
    from typing import Self

    from canopen_control.rpc.messages.samples import TrajectoryPoint
    from canopen_control.rpc.messages.state import ControllerReading, CycleTimes


@contextlib.contextmanager
def periodic_call(
    function: Callable[[], object], period_s: float, *, name: str, join_s: float | None = None
) -> Iterator[None]:
    """Context in which the thread `name` calls `function` every `period_s`, first after one period.

    The exit waits at most `join_s` for a running call (None: no limit). An exception in `function` ends the calls.
    """
    ended = threading.Event()

    def run() -> None:
        while not ended.wait(period_s):
            function()

    thread = threading.Thread(target=run, name=name, daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join(join_s)


# Messages that a robot sends to its subscribers: events one after the other, and state samples at a rate.
#
# ROS and bags request a rate at which the samples contain every publication of a controller.


_ENDED: Final = "stopped"  # the last event of a robot that was ended


class EventStream:
    """Iterator over events, until `timeout` s pass without an event (None: no limit) or the robot has ended.

    Raise RemoteError if the robot was killed. The connection is closed at the end of the iteration; to end earlier,
    call `close`, or use the iterator in a `with` block.
    """

    def __init__(self, client: RobotClient, timeout: float | None = None) -> None:
        self._client = client
        self._messages = client.messages(timeout)
        self._ended = False
        client.ask(Subscribe(events=True))

    def __enter__(self) -> EventStream:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self.close()

    def __iter__(self) -> EventStream:
        return self

    def __next__(self) -> RobotEvent:
        if self._ended:
            raise StopIteration
        try:
            for message in self._messages:
                if isinstance(message, RobotEvent):
                    self._ended = message.kind == _ENDED
                    return message
        except RemoteError:
            self.close()
            raise
        self.close()
        raise StopIteration

    def close(self) -> None:
        """Close the connection; a second call does nothing."""
        self._ended = True
        self._client.close()


_NEARLY = 1e-6


def stream_rate(cycle: CycleTimes, rate: float = 0.0) -> float:
    """Return a rate in Hz near `rate` at which the state samples are a whole number of cycles apart.

    A `rate` of 0 requests every cycle, as far as STREAM_RATE permits.
    """
    hz = 1.0 / cycle.period_s if cycle.period_s > 0.0 else STREAM_RATE
    every = round(hz / rate) if rate else math.ceil(hz / STREAM_RATE - _NEARLY)
    return hz / max(1, every)


def outpaced(controllers: Iterable[ControllerReading], rate: float) -> str | None:
    """Return a sentence about controllers that publish more often than `rate` in Hz, or None if none does."""
    fast = [controller for controller in controllers if controller.publish_rate > rate * (1.0 + _NEARLY)]
    names = ", ".join(f"{controller.name} ({controller.publish_rate:g} Hz)" for controller in fast)
    return (
        f"{names}: published more often than the samples at {rate:g} Hz, which omit the values in between"
        if fast
        else None
    )


HEARTBEAT_S: Final = 2.0
"""Interval in s within which a client promises a heartbeat for a trajectory; otherwise the robot stops the joints."""
_BEATS: Final = 4  # heartbeats in this time

_PIECE: Final = 24_000  # bytes of an object in one request
_VALUES: Final = 2000  # values of a trajectory in one request


class RobotClient(Client[RobotHello, RobotPush]):
    """Connection to the running robot `robot`; the requests are in `rpc.messages.robot`."""

    def __init__(self, stream: LineClient, timeout: float = 10.0) -> None:
        super().__init__(ROBOT, stream, timeout)
        self.robot = self.hello.robot

    @classmethod
    def connect(cls, name: str | None = None, timeout: float = 10.0) -> Self:
        """Connect to the robot `name`, or to the only running robot.

        Raise ConfigError unless exactly one robot matches.
        """
        robot = select_robot(name)
        return cls(LineClient(socket_path("robot", robot), timeout, label=f"robot {robot}"), timeout)

    def sdo_write(self, request: SdoWrite, timeout: float) -> None:
        """Download an object of any length through the robot, in several requests if necessary."""
        data = request.data
        last_piece = max(0, len(data) - 1) // _PIECE * _PIECE  # the last piece is part of the request that writes
        for start in range(0, last_piece, _PIECE):
            self.ask(SdoPiece(data=data[start : start + _PIECE]))
        last = SdoWrite(
            node=request.node,
            index=request.index,
            subindex=request.subindex,
            data=data[last_piece:],
            timeout=request.timeout,
            source=request.source,
            session=request.session,
        )
        self.ask(last, timeout)

    @contextlib.contextmanager
    def heartbeats(self) -> Iterator[None]:
        """Context in which a thread sends heartbeats for a trajectory sent with `HEARTBEAT_S`."""

        def beat() -> None:
            with contextlib.suppress(RemoteError):  # the robot has ended, which other calls report
                self.notify(TrajectoryHeartbeat())

        with periodic_call(beat, HEARTBEAT_S / _BEATS, name="heartbeats", join_s=HEARTBEAT_S):
            yield

    def send_points(self, points: list[TrajectoryPoint]) -> list[TrajectoryPoint]:
        """Send all but the last points of a long trajectory; return the rest for the final request."""
        width = max((len(point.positions) for point in points), default=0)
        at_once = max(1, _VALUES // (4 * max(1, width)))
        while len(points) > at_once:
            self.ask(TrajectoryData(points=points[:at_once]))
            points = points[at_once:]
        return points
