"""A wheel on a floor: a plant that reports the way it goes to the base it belongs to.

The motion is the inner plant's; this one only cuts it at the points of a fixed grid, so that what is reported does not
depend on when somebody looks. Points are handed over in bundles.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from canopen_control.virtual.diffbase import slipped

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from canopen_control.virtual.plant import Plant
    from canopen_control.virtual.trajectory import Trajectory

__all__ = ["GRID_NS", "Floor", "WheelPlant"]

GRID_NS = 5_000_000
_BUNDLE = 4


class Floor(Protocol):
    """Who takes the points."""

    def report(self, wheel: int, points: Sequence[tuple[int, float]]) -> None:
        """Take points of `wheel`: monotonic ns and metres."""


class WheelPlant:
    """`inner` on `floor` as its wheel number `side`; `metres` for each count, negative where it is reversed."""

    def __init__(
        self, inner: Plant, floor: Floor, side: int, metres: float, *, slip: float = 0.0, seed: int = 0
    ) -> None:
        self.inner, self._floor, self._side, self._metres = inner, floor, side, metres
        self._slip, self._seed = slip, seed
        self._way = 0.0  # gone on the floor, in metres
        self._steps = 0  # that were gone at all
        self._reported = inner.position  # counts at the last point
        self._points: list[tuple[int, float]] = []

    @property
    def position(self) -> float:
        """Counts of the motor."""
        return self.inner.position

    @position.setter
    def position(self, value: float) -> None:
        """Displace the motor; the wheel is lifted for it."""
        self._reported += value - self.inner.position
        self.inner.position = value

    @property
    def velocity(self) -> float:
        """Counts/s."""
        return self.inner.velocity

    @velocity.setter
    def velocity(self, value: float) -> None:
        """Change the velocity."""
        self.inner.velocity = value

    @property
    def torque(self) -> float:
        """Per mille of the rated torque."""
        return self.inner.torque

    @torque.setter
    def torque(self, value: float) -> None:
        """Change the torque."""
        self.inner.torque = value

    @property
    def stiff(self) -> bool:
        """Whether the inner plant is."""
        return self.inner.stiff

    @stiff.setter
    def stiff(self, value: bool) -> None:
        """Change it."""
        self.inner.stiff = value

    def follow(self, demand: Trajectory, start_ns: int, end_ns: int) -> None:
        """Move as the inner plant follows."""
        standing = demand.end_ns <= start_ns and not demand.final_velocity and demand.final_position == self.position
        quiet = standing and self.stiff and not self.velocity
        self._move(lambda start, end: self.inner.follow(demand, start, end), start_ns, end_ns, quiet=quiet)

    def push(self, torque: Trajectory, start_ns: int, end_ns: int) -> None:
        """Move as the torque does."""
        self._move(lambda start, end: self.inner.push(torque, start, end), start_ns, end_ns, quiet=False)

    def release(self, start_ns: int, end_ns: int) -> None:
        """Move without power."""
        quiet = self.stiff and not self.velocity
        self._move(self.inner.release, start_ns, end_ns, quiet=quiet)

    def feed_forward(self, velocity: float, torque: float) -> None:
        """Feed the inner plant's loops."""
        self.inner.feed_forward(velocity, torque)

    def _move(self, move: Callable[[int, int], None], start_ns: int, end_ns: int, *, quiet: bool) -> None:
        clock = start_ns
        first = (start_ns // GRID_NS + 1) * GRID_NS
        if quiet:  # nothing moves: the last point of the grid is enough
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
            self._way += slipped(step, self._slip, self._seed, self._side, self._steps) if self._slip else step
        self._points.append((now, self._way))

    def publish(self) -> None:
        """Hand the points over."""
        if self._points:
            self._floor.report(self._side, self._points)
            self._points = []
