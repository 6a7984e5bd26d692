"""A square driven by odometry, as UMBmark wants it: straight sides, a stop at each corner, turns on the spot.

The law of the file: it is sans-IO; each pose of odometry becomes the twist to command until `done`. Speeds fall along a
ramp towards the end of a side or turn, so that the odometry at the end is where the square ends but for some mm, which
the measurement takes into account. A base that does not do as it is told ends it with a sentence. Clockwise is the
mirror image of counter-clockwise, to the last bit.
"""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from canopen_control.calibration.umbmark import Planar, relative
from canopen_control.errors import ControlError

if TYPE_CHECKING:
    from canopen_control.calibration.umbmark import Direction


_CORNERS: Final = 4
_TURN: Final = math.pi / 2
_NEAR: Final = 0.001  # m
_STRAIGHT: Final = 0.001  # rad
_CREEP: Final = (0.01, 0.02)  # m/s and rad/s: what a ramp ends with
_STANDS: Final = (0.002, 0.005)  # m and rad: what an encoder may tell of a base that stands
_STEER: Final = (2.0, 1.0)  # rad/s for each rad off the side's heading, and for each m off its line over 0.1 m
_MOST_STEER: Final = 0.2  # rad/s
_OFF: Final = 0.3  # of the side, at least 0.2 m: so far from the square it is another motion
_PATIENCE_S: Final = 5.0  # beyond twice the time that a side or turn should take


@dataclass(frozen=True, slots=True)
class Pace:
    """How fast a square is driven: m/s and rad/s, and the ramps to a stop in m/s^2 and rad/s^2.

    `settle` in s is how long the base stands at each corner.
    """

    speed: float = 0.2
    turn: float = 0.6
    ramp: float = 0.25
    turn_ramp: float = 0.8
    settle: float = 0.5


class _Phase(enum.Enum):
    SIDE = "side"
    CORNER = "corner"  # stands before a turn
    TURN = "turn"
    REST = "rest"  # stands after it
    DONE = "done"


_NEXT: Final = {
    _Phase.SIDE: _Phase.CORNER,
    _Phase.CORNER: _Phase.TURN,
    _Phase.TURN: _Phase.REST,
    _Phase.REST: _Phase.SIDE,
}
_MOVES: Final = frozenset({_Phase.SIDE, _Phase.TURN})


class SquarePath:
    """One square of `side` m in a direction, from wherever the first pose is; `corner` is how many turns are done."""

    def __init__(self, side: float, direction: Direction, pace: Pace) -> None:
        self.side, self.direction, self.pace = side, direction, pace
        self.corner = 0
        self._phase = _Phase.SIDE
        self._start: Planar | None = None
        self._since = 0.0  # s, of the phase
        self._stood: tuple[Planar, float] | None = None  # where, and since when

    @property
    def done(self) -> bool:
        """Whether the base stands at the end of the square."""
        return self._phase is _Phase.DONE

    def twist(self, pose: Planar, now: float) -> tuple[float, float]:
        """Return the twist to command, m/s and rad/s, where odometry is at `pose` at `now` in s.

        Raises ControlError where the base is not on its way any more.
        """
        if self._start is None:
            self._start, self._since = pose, now
        seen = relative(pose, self._start)
        self._check(seen, now)
        if self._phase in _MOVES:
            wanted = self._along(seen) if self._phase is _Phase.SIDE else self._around(seen)
            if wanted is not None:
                return wanted
            self._enter(_NEXT[self._phase], now)
        elif self._stands(seen, now):
            self._enter(_NEXT[self._phase], now)
        return 0.0, 0.0

    def _enter(self, phase: _Phase, now: float) -> None:
        if phase is _Phase.REST:
            self.corner += 1
        if phase is _Phase.SIDE and self.corner == _CORNERS:
            phase = _Phase.DONE
        self._phase, self._since, self._stood = phase, now, None

    def _stands(self, seen: Planar, now: float) -> bool:
        if self._stood is not None:
            (x, y, heading), since = self._stood
            if math.hypot(seen[0] - x, seen[1] - y) <= _STANDS[0] and abs(seen[2] - heading) <= _STANDS[1]:
                return now - since >= self.pace.settle
        self._stood = seen, now
        return False

    def _along(self, seen: Planar) -> tuple[float, float] | None:
        """Return the twist along the side that is under way, None at its end."""
        ahead, aside, turned = self._from_corner(seen)
        left = self.side - ahead
        if left <= _NEAR:
            return None
        speed = min(self.pace.speed, math.sqrt(2.0 * self.pace.ramp * left) + _CREEP[0], left * 4.0 + _CREEP[0])
        steer = -_STEER[0] * turned - _STEER[1] * math.atan(aside / 0.1)
        return speed, max(-_MOST_STEER, min(_MOST_STEER, steer))

    def _around(self, seen: Planar) -> tuple[float, float] | None:
        """Return the twist of the turn that is under way, None at its end."""
        sign = self.direction.value
        left = (self.corner + 1) * _TURN - sign * seen[2]
        if left <= _STRAIGHT:
            return None
        speed = min(self.pace.turn, math.sqrt(2.0 * self.pace.turn_ramp * left) + _CREEP[1], left * 4.0 + _CREEP[1])
        return 0.0, sign * speed

    def _from_corner(self, seen: Planar) -> Planar:
        """Return the pose as it is seen from the corner that the side begins at, along the side."""
        corners = ((0.0, 0.0), (self.side, 0.0), (self.side, self.side), (0.0, self.side))
        x, y = corners[self.corner % _CORNERS]
        sign = self.direction.value
        heading = self.corner * _TURN
        cosine, sine = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[self.corner % _CORNERS]
        along, aside = seen[0] - x, sign * seen[1] - y  # of the mirror image that goes counter-clockwise
        return cosine * along + sine * aside, sign * (cosine * aside - sine * along), seen[2] - sign * heading

    def _check(self, seen: Planar, now: float) -> None:
        """Raise ControlError where the base is somewhere else, or takes too long."""
        x, y = seen[0], self.direction.value * seen[1]
        off = max(-x, x - self.side, -y, y - self.side)
        if not off <= max(0.2, _OFF * self.side):  # no number is nowhere, too
            raise ControlError(
                f"the base has left the square of {self.side:g} m: odometry is at {seen[0]:.2f}, {seen[1]:.2f} m from "
                "its start; does anybody else drive it?"
            )
        if now - self._since > self._patience():
            what = "does not come to rest" if self._phase not in _MOVES else "does not move as it is commanded"
            where = f"{self._phase.value} {min(self.corner + 1, _CORNERS)} of the square"
            raise ControlError(f"the base {what}: {now - self._since:.0f} s at {where}; see canopen-control status")

    def _patience(self) -> float:
        pace = self.pace
        side = self.side / pace.speed + pace.speed / pace.ramp
        turn = _TURN / pace.turn + pace.turn / pace.turn_ramp
        return _PATIENCE_S + 2.0 * {_Phase.SIDE: side, _Phase.TURN: turn}.get(self._phase, pace.settle)
