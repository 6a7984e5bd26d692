"""Base with two wheels, and shafts with encoders, both moved by virtual drives.

The shaft of a virtual encoder (CiA 406) is turned by the motor of a virtual drive through a gear. The encoder reads a
drive in the same process directly; a drive in another process writes its shaft positions at the world's period to a
file that both plant files name. The position is that of the load: the backlash of a loaded plant is between load and
motor.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import json
import math
import os
import stat
import struct
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final, Protocol, TypedDict, runtime_checkable

from canopen_control.errors import ConfigError
from canopen_control.host.sockets import runtime_dir
from canopen_control.rpc.messages.drive import BasePose
from canopen_control.virtual.plant import LoadedPlant, World

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from canopen_control.virtual.plant import Plant
    from canopen_control.virtual.trajectory import DemandCurve


# A diff-drive base on a floor: its pose, computed from the distances of its two wheels.
#
# Wheels report points (time, distance in metres) of their motion on a grid of their own, in any order and from any
# process; the pose is integrated exactly along the arc between neighbouring points, up to the last time known for both
# wheels. So the result depends on the motion only, not on the order of the reports. A wheel without a report for ten
# seconds is assumed to be at standstill. Slip is noise on the steps of a wheel, computed from seed and step number.


LEFT, RIGHT = 0, 1
SILENT_NS = 10_000_000_000
_MASK = (1 << 64) - 1
Point = tuple[int, float]


class _Record(TypedDict):
    x: float
    y: float
    heading: float
    time_ns: int
    last: list[Point | None]
    next: list[list[Point]]


class DiffBase:
    """Differential-drive base that integrates its pose; `separation` is the distance between the wheels in m."""

    def __init__(self, separation: float) -> None:
        self.separation = separation
        self.x = self.y = self.heading = 0.0
        self._last: list[Point | None] = [None, None]
        self._next: tuple[deque[Point], deque[Point]] = (deque(), deque())
        self.time_ns = 0

    def report(self, wheel: int, points: Sequence[Point]) -> None:
        """Add points (time in ns, distance in m) of a wheel in order of time; older points are ignored."""
        for time_ns, distance in points:
            last = self._next[wheel][-1] if self._next[wheel] else self._last[wheel]
            if last is None:
                self._last[wheel] = (time_ns, distance)
            elif time_ns > last[0]:
                self._next[wheel].append((time_ns, distance))
        self._integrate()

    def pose(self) -> BasePose:
        """Return the pose at the latest time known for both wheels."""
        return BasePose(self.x, self.y, self.heading, self.time_ns)

    def _integrate(self) -> None:
        self._assume_standing()
        while self._next[LEFT] and self._next[RIGHT]:
            time_ns = min(self._next[LEFT][0][0], self._next[RIGHT][0][0])
            self._advance(self._step(LEFT, time_ns), self._step(RIGHT, time_ns))
            self.time_ns = time_ns

    def _assume_standing(self) -> None:
        for wheel in (LEFT, RIGHT):
            other_wheel, since = self._next[1 - wheel], self._last[wheel] or self._last[1 - wheel]
            if (
                not self._next[wheel]
                and other_wheel
                and since is not None
                and other_wheel[-1][0] - since[0] > SILENT_NS
            ):
                last = self._last[wheel] = self._last[wheel] or (since[0], 0.0)
                self._next[wheel].append((other_wheel[-1][0], last[1]))

    def _step(self, wheel: int, time_ns: int) -> float:
        """Advance a wheel to `time_ns`; return the distance travelled, interpolated between the wheel's points."""
        ahead, last = self._next[wheel], self._last[wheel] or self._next[wheel][0]
        when, distance = ahead[0]
        if when == time_ns:
            ahead.popleft()
        else:
            distance = last[1] + (distance - last[1]) * max(time_ns - last[0], 0) / (when - last[0])
        self._last[wheel] = (max(time_ns, last[0]), distance)
        return distance - last[1]

    def _advance(self, left: float, right: float) -> None:
        """Advance the pose along an arc by the distances of the left and right wheel."""
        distance, turn = 0.5 * (left + right), (right - left) / self.separation
        half = 0.5 * turn
        chord = distance * (math.sin(half) / half if abs(half) > 1e-9 else 1.0)
        self.x += chord * math.cos(self.heading + half)
        self.y += chord * math.sin(self.heading + half)
        self.heading += turn

    # -- as plain values, for a file

    def dump(self) -> _Record:
        """Return the complete state as JSON-compatible data."""
        return {
            "x": self.x,
            "y": self.y,
            "heading": self.heading,
            "time_ns": self.time_ns,
            "last": self._last,
            "next": [list(points) for points in self._next],
        }

    def load(self, content: _Record) -> None:
        """Restore a state returned by `dump`."""
        self.x, self.y, self.heading = float(content["x"]), float(content["y"]), float(content["heading"])
        self.time_ns = int(content["time_ns"])
        self._last = [None if item is None else (int(item[0]), float(item[1])) for item in content["last"]]
        left, right = (deque((int(when), float(distance)) for when, distance in item) for item in content["next"])
        self._next = (left, right)


class SharedFile:
    """File at `path` shared by several processes; opened on first use, which may raise ConfigError."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._file: int | None = None

    @contextlib.contextmanager
    def locked(self, operation: int) -> Iterator[int]:
        """Hold a lock (`fcntl.LOCK_SH` or `fcntl.LOCK_EX`) on the file; yield its file descriptor."""
        if self._file is None:
            self._file = open_shared(self._path)
        fcntl.flock(self._file, operation)
        try:
            yield self._file
        finally:
            fcntl.flock(self._file, fcntl.LOCK_UN)

    def close(self) -> None:
        if self._file is not None:
            os.close(self._file)
            self._file = None


class SharedBase(SharedFile):
    """`DiffBase` that several processes share through a file with its complete state as JSON."""

    def __init__(self, separation: float, path: Path) -> None:
        super().__init__(path)
        self._base = DiffBase(separation)

    def report(self, wheel: int, points: Sequence[Point]) -> None:
        with self.locked(fcntl.LOCK_EX) as fd:
            self._read(fd)
            self._base.report(wheel, points)
            data = json.dumps(self._base.dump()).encode()
            os.pwrite(fd, data, 0)
            os.ftruncate(fd, len(data))

    def pose(self) -> BasePose:
        """Return the pose that results from the reports of all processes."""
        with self.locked(fcntl.LOCK_SH) as fd:
            self._read(fd)
        return self._base.pose()

    def _read(self, fd: int) -> None:
        """Load the state in the file; an incomplete file, left by a killed process, resets the state."""
        try:
            content = json.loads(os.pread(fd, 1 << 24, 0) or b"{}")
            if content:
                self._base.load(content)
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
            self._base = DiffBase(self._base.separation)


def shared_path(text: str) -> Path:
    """Return the path for a `share:` value; a name without / is a file in the user's private folder."""
    if "/" in text:
        return Path(text).expanduser()
    return runtime_dir() / f"share-{text}"


def open_shared(path: Path) -> int:
    """Open or create a file shared by several processes; raise ConfigError on failure.

    A link, another user's file and a file that others may write to are refused: in a shared folder such as /tmp
    another user may have created it.
    """
    try:
        fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK, 0o600)
    except OSError as error:
        reason = "it is a symbolic link" if error.errno == errno.ELOOP else error.strerror
        raise ConfigError(f"{path} cannot be shared: {reason}; {_SHARE}") from error
    status = os.fstat(fd)
    problem = ""
    if not stat.S_ISREG(status.st_mode):
        problem = "it is not a regular file"
    elif status.st_uid != os.getuid():
        problem = f"it belongs to user id {status.st_uid}, not to yours ({os.getuid()})"
    elif status.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        problem = f"others may write to it (mode {stat.S_IMODE(status.st_mode):04o})"
    if problem:
        os.close(fd)
        raise ConfigError(f"{path} cannot be shared: {problem}; {_SHARE}")
    return fd


_SHARE: Final = "use a name without / in share: for a file in your private folder"


def slipped(distance: float, slip: float, seed: int, wheel: int, step: int) -> float:
    """Return the distance of a wheel step with pseudo-random slip of relative standard deviation `slip`."""
    number = (seed * 0x9E3779B97F4A7C15 + wheel * 0xD1B54A32D192ED03 + step * 0xBF58476D1CE4E5B9) & _MASK
    number = ((number ^ number >> 30) * 0xBF58476D1CE4E5B9) & _MASK  # splitmix64
    number = ((number ^ number >> 27) * 0x94D049BB133111EB) & _MASK
    uniform = (number ^ number >> 31) / (_MASK >> 1) - 1.0
    return distance * (1.0 + slip * math.sqrt(3.0) * uniform)


# A wheel on a floor: a plant that reports its distance to the base.
#
# The motion is that of the inner plant, divided at the points of a fixed grid, so that the reports do not depend on
# when the plant is read. Points are reported in bundles.


GRID_NS = 5_000_000
_BUNDLE = 4


class WheelOdometry(Protocol):
    """Base that integrates the distances of the wheels."""

    def report(self, wheel: int, points: Sequence[tuple[int, float]]) -> None:
        """Add points of a wheel: monotonic time in ns and distance in metres."""


class WheelPlant:
    """Plant of a wheel: moves like the plant `inner`, and reports the distances of wheel `side` to `floor`.

    `metres` is the distance of one count, negative if the wheel is reversed.
    """

    def __init__(
        self, inner: Plant, floor: WheelOdometry, side: int, metres: float, *, slip: float = 0.0, seed: int = 0
    ) -> None:
        self.inner, self._floor, self._side, self._metres = inner, floor, side, metres
        self._slip, self._seed = slip, seed
        self._distance = 0.0  # distance on the floor, in metres
        self._steps = 0  # number of steps with a motion
        self._reported = inner.position  # counts at the last point
        self._points: list[tuple[int, float]] = []

    @property
    def position(self) -> float:
        """Position of the motor in counts."""
        return self.inner.position

    @position.setter
    def position(self, value: float) -> None:
        """Position of the motor in counts."""
        self._reported += value - self.inner.position
        self.inner.position = value

    @property
    def velocity(self) -> float:
        return self.inner.velocity

    @velocity.setter
    def velocity(self, value: float) -> None:
        self.inner.velocity = value

    @property
    def torque(self) -> float:
        return self.inner.torque

    @torque.setter
    def torque(self, value: float) -> None:
        self.inner.torque = value

    @property
    def stiff(self) -> bool:
        return self.inner.stiff

    @stiff.setter
    def stiff(self, value: bool) -> None:
        self.inner.stiff = value

    def follow(self, demand: DemandCurve, start_ns: int, end_ns: int) -> None:
        standing = demand.end_ns <= start_ns and not demand.final_velocity and demand.final_position == self.position
        quiet = standing and self.stiff and not self.velocity
        self._move(lambda start, end: self.inner.follow(demand, start, end), start_ns, end_ns, quiet=quiet)

    def apply_torque(self, torque: DemandCurve, start_ns: int, end_ns: int) -> None:
        self._move(lambda start, end: self.inner.apply_torque(torque, start, end), start_ns, end_ns, quiet=False)

    def release(self, start_ns: int, end_ns: int) -> None:
        quiet = self.stiff and not self.velocity
        self._move(self.inner.release, start_ns, end_ns, quiet=quiet)

    def feed_forward(self, velocity: float, torque: float) -> None:
        self.inner.feed_forward(velocity, torque)

    def _move(self, move: Callable[[int, int], None], start_ns: int, end_ns: int, *, quiet: bool) -> None:
        clock = start_ns
        first = (start_ns // GRID_NS + 1) * GRID_NS
        if quiet:  # at standstill the last point of the grid is enough
            first = max(first, end_ns // GRID_NS * GRID_NS)
        for point in range(first, end_ns + 1, GRID_NS):
            move(clock, point)
            self._mark(point)
            clock = point
        move(clock, end_ns)
        if len(self._points) >= _BUNDLE:
            self.publish()

    def _mark(self, now: int) -> None:
        step = (self.inner.position - self._reported) * self._metres
        self._reported = self.inner.position
        if step:
            self._steps += 1
            self._distance += slipped(step, self._slip, self._seed, self._side, self._steps) if self._slip else step
        self._points.append((now, self._distance))

    def publish(self) -> None:
        """Report the pending points to the base."""
        if self._points:
            self._floor.report(self._side, self._points)
            self._points = []


_SLOT: Final = struct.Struct("<Qd")  # 1 if the position is known, counts
_AXES: Final = 8


@runtime_checkable
class ShaftWorld(World, Protocol):
    """World with shafts that turn encoders."""

    def has_shaft(self, node_id: int) -> bool:
        """Whether a node is an encoder on a shaft."""

    def shaft_position(self, node_id: int) -> float | None:
        """Return the position of an encoder's shaft in rad (m if linear), or None while unknown."""

    def publish(self) -> None:
        """Publish the shaft positions to other processes."""


@dataclass(frozen=True, slots=True)
class Coupling:
    """Gear between a motor and an encoder: counts per motor turn, gear ratio and direction.

    With a `lead` the encoder is linear, and `lead` is the distance in m per turn after the gear.
    """

    counts_per_revolution: float
    gear: float = 1.0
    reversed: bool = False
    lead: float | None = None

    def place(self, counts: float) -> float:
        """Return the encoder position in rad (m if linear) for a motor position in counts."""
        turns = counts / self.counts_per_revolution / self.gear
        return (-turns if self.reversed else turns) * (self.lead or math.tau)


def load_counts(plant: Plant) -> float:
    """Return the load position of an axis in counts of the motor."""
    inner = plant.inner if isinstance(plant, WheelPlant) else plant
    return inner.load_position if isinstance(inner, LoadedPlant) and inner.backlash else inner.position


class ShaftFile(SharedFile):
    """File with shaft positions by node-ID and axis, shared by several processes."""

    def put(self, node_id: int, axis: int, counts: float) -> None:
        """Write a shaft position in motor counts to the file."""
        with self.locked(fcntl.LOCK_EX) as fd:
            os.pwrite(fd, _SLOT.pack(1, counts), _slot(node_id, axis))

    def get(self, node_id: int, axis: int) -> float | None:
        """Return a shaft position in motor counts, or None if the file has no value yet."""
        with self.locked(fcntl.LOCK_SH) as fd:
            data = os.pread(fd, _SLOT.size, _slot(node_id, axis))
        content, counts = _SLOT.unpack(data.ljust(_SLOT.size, b"\0"))
        return float(counts) if content == 1 and math.isfinite(counts) else None


def _slot(node_id: int, axis: int) -> int:
    return (node_id * _AXES + axis) * _SLOT.size
