"""The client of a running robot: which one, and its socket."""

from __future__ import annotations

import contextlib
import threading
from typing import TYPE_CHECKING, Final

from canopen_control.errors import ConfigError, RemoteError
from canopen_control.host.lineclient import LineClient
from canopen_control.host.sockets import check_name, list_sockets, socket_path
from canopen_control.rpc.client import Client
from canopen_control.rpc.messages.robot import (
    ROBOT,
    RobotHello,
    RobotPush,
    SdoPiece,
    SdoWrite,
    TrajectoryData,
    TrajectoryHeartbeat,
)

if TYPE_CHECKING:
    from collections.abc import Iterator
    from typing import Self

    from canopen_control.rpc.messages.samples import TrajectoryPoint

__all__ = ["HEARTBEAT_S", "RobotClient", "find_robots", "select_robot"]

HEARTBEAT_S: Final = 2.0
"""What who plays a trajectory promises as its `heartbeat`: silent for longer he is gone, and the joints brake."""
_BEATS: Final = 4  # within that time

_PIECE: Final = 24_000  # bytes of an object in one request
_VALUES: Final = 2000  # of a trajectory in one request


def find_robots() -> list[str]:
    """Return the names of this user's running robots, sorted."""
    return list_sockets("robot")


def select_robot(name: str | None = None) -> str:
    """Return the robot that is meant: `name`, or without one the only robot there is; ConfigError otherwise."""
    running = find_robots()
    if name is not None:
        if check_name(name) in running:
            return name
        raise ConfigError(f"no robot {name!r} is running" + (f"; running: {', '.join(running)}" if running else ""))
    if not running:
        raise ConfigError("no robot is running; start one: canopen-control run robby")
    if len(running) > 1:
        raise ConfigError(f"several robots are running: {', '.join(running)}; choose one with --name")
    return running[0]


class RobotClient(Client[RobotHello, RobotPush]):
    """A connection to a running robot; `robot` is its name. See `rpc.messages.robot` for what it can be asked."""

    def __init__(self, stream: LineClient, timeout: float = 10.0) -> None:
        super().__init__(ROBOT, stream, timeout)
        self.robot = self.hello.robot

    @classmethod
    def connect(cls, name: str | None = None, timeout: float = 10.0) -> Self:
        """Connect to the robot `name`, or to the only one; ConfigError when there is none or a choice."""
        robot = select_robot(name)
        return cls(LineClient(socket_path("robot", robot), timeout, label=f"robot {robot}"), timeout)

    def sdo_write(self, request: SdoWrite, timeout: float) -> None:
        """Download an object of any length that the robot passes on, in pieces where it is long."""
        data = request.data
        rest = max(0, len(data) - 1) // _PIECE * _PIECE  # the last piece goes with the request that writes
        for start in range(0, rest, _PIECE):
            self.ask(SdoPiece(data=data[start : start + _PIECE]))
        last = SdoWrite(
            node=request.node,
            index=request.index,
            subindex=request.subindex,
            data=data[rest:],
            timeout=request.timeout,
            source=request.source,
        )
        self.ask(last, timeout)

    @contextlib.contextmanager
    def heartbeats(self) -> Iterator[None]:
        """Say again and again, on a thread, that this process is at work: for a trajectory sent with `HEARTBEAT_S`."""
        over = threading.Event()

        def beat() -> None:
            with contextlib.suppress(RemoteError):  # the robot is gone, which who waits for the end is told
                while not over.wait(HEARTBEAT_S / _BEATS):
                    self.notify(TrajectoryHeartbeat())

        thread = threading.Thread(target=beat, name="heartbeats", daemon=True)
        thread.start()
        try:
            yield
        finally:
            over.set()
            thread.join(HEARTBEAT_S)

    def send_points(self, points: list[TrajectoryPoint]) -> list[TrajectoryPoint]:
        """Send the first points of a trajectory of any length; returns the last ones, for the request that sends it."""
        width = max((len(each.positions) for each in points), default=0)
        at_once = max(1, _VALUES // (4 * max(1, width)))
        while len(points) > at_once:
            self.ask(TrajectoryData(points=points[:at_once]))
            points = points[at_once:]
        return points
