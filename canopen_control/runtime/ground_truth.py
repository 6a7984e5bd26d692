"""True pose of a simulated base, read from the virtual drives and compared with the odometry.

A robot on virtual drives that move a base (the `base` of a plant file, or a physics engine) can compute its odometry
error; every other robot has no true pose. The world frame and the odometry frame are aligned when both poses are first
known, when another base controller becomes active, and when the odometry is set. While the base moves, the odometry is
older than the true pose by about one cycle.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from canopen_control.errors import CanopenError
from canopen_control.host.sockets import socket_path
from canopen_control.rpc.client import ReactorClient
from canopen_control.rpc.messages.drive import DRIVE, GetWorld
from canopen_control.rpc.messages.state import TruePose

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from canopen_control.controllers.manager import ControllerManager
    from canopen_control.host.reactor import Reactor
    from canopen_control.rpc.messages.drive import BasePose, WorldState
    from canopen_control.rpc.messages.state import Planar


PERIOD_NS: Final = 50_000_000
_TIMEOUT_NS: Final = 2_000_000_000
_RETRY_NS: Final = 1_000_000_000
_EXTRAPOLATE_S: Final = 0.2  # maximum extrapolation of odometry to the earlier time of a true pose


class TruePoseTracker:
    """Comparison of true poses with odometry, without I/O; `reading` is the latest result, None while unknown."""

    def __init__(self) -> None:
        self.reading: TruePose | None = None
        self._controller: str | None = None
        self._odom: Planar | None = None

    def align(self) -> None:
        """Align the world and odometry frames at the next true pose, because the odometry has been set."""
        self._odom = None

    def take(self, base: BasePose, odometry: tuple[str, Planar] | None, wall_offset_ns: int) -> None:
        """Update `reading` with a true pose; `odometry` is (controller name, pose) at the same time, if known."""
        name, pose = (None, None) if odometry is None else odometry
        if name is not None and (self._odom is None or name != self._controller):
            self._controller, self._odom = name, _frame_of(base, pose or (0.0, 0.0, 0.0))
        time = (base.time_ns + wall_offset_ns) / 1e9
        x, y, heading = base.x, base.y, base.heading
        truth = TruePose(
            time=time, x=x, y=y, heading=heading, z=base.z, roll=base.roll, pitch=base.pitch, odom=self._odom
        )
        self.reading = truth if pose is None else truth.with_odometry_error(pose)


def _frame_of(base: BasePose, odometry: Planar) -> Planar:
    """Return the pose of the odometry frame in the world frame, as (x, y, heading)."""
    x, y, heading = odometry
    turn = base.heading - heading
    cosine, sine = math.cos(turn), math.sin(turn)
    return base.x - (cosine * x - sine * y), base.y - (sine * x + cosine * y), turn


def odometry_at(manager: ControllerManager, ahead_ns: int) -> tuple[str, Planar] | None:
    """Return the active base controller's name and its pose at `ahead_ns` from now (-0.2 s to 0), or None."""
    ahead = max(-_EXTRAPOLATE_S, min(0.0, ahead_ns / 1e9))
    for name in manager.bases:
        pose = manager.get(name).dead_reckoning(ahead)
        return None if pose is None else (name, pose)
    return None


class TruePoseQuery:
    """Client that finds the virtual drive with the pose of the base, and polls it every `period_ns`.

    `take` receives the true poses. `sense` receives the measured values of the sensors in the drive's world; with
    `sense`, a world that has sensors and no base is accepted too.
    """

    def __init__(
        self,
        drives: Sequence[str],
        reactor: Reactor,
        take: Callable[[BasePose], object],
        sense: Callable[[Mapping[str, tuple[float, ...]]], object] | None = None,
        period_ns: int = PERIOD_NS,
    ) -> None:
        self._on_sensors, self._period_ns = sense, period_ns
        self._names, self._reactor, self._on_pose = tuple(drives), reactor, take
        self._has_answered = False
        self._client: ReactorClient | None = None
        self._drives: Iterator[str] = iter(())
        self._closed = False

    def start(self) -> None:
        """Start polling; if no virtual drive has the pose of a base, each drive is queried only once."""
        if not self._closed:
            self._drives = iter(self._names)
            self._try_next()

    def _try_next(self) -> None:
        self._leave()
        name = next(self._drives, None)
        if name is None:
            if self._has_answered:  # a lost drive may have returned
                self._reactor.call_later(_RETRY_NS, self.start)
            return
        try:
            self._client = ReactorClient(
                DRIVE, socket_path("drive", name), self._reactor, label=name, timeout_ns=_TIMEOUT_NS
            )
        except CanopenError:
            self._reactor.call_soon(self._try_next)
        else:
            self._client.ask(GetWorld(), self._answered)

    def _answered(self, world: WorldState | None, _why_not: str | None) -> None:
        if self._client is None:
            return
        sensed = None if world is None or self._on_sensors is None else world.sensors
        if world is None or (world.base is None and not sensed):
            self._reactor.call_soon(self._try_next)
            return
        self._has_answered = True
        if world.base is not None:
            self._on_pose(world.base)
        if sensed and self._on_sensors is not None:
            self._on_sensors(sensed)
        self._reactor.call_later(self._period_ns, self._poll)

    def _poll(self) -> None:
        if self._client is not None:
            self._client.ask(GetWorld(), self._answered)

    def _leave(self) -> None:
        client, self._client = self._client, None
        if client is not None:
            client.close()

    def close(self) -> None:
        self._closed, self._drives = True, iter(())
        self._leave()
