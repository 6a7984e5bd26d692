"""UMBmark calibration (Borenstein, Feng 1996): wheel radii and track of a differential drive base.

The base drives squares clockwise and counter-clockwise by its odometry. The error of a run is the true end position
minus the end position by odometry, both relative to the start: x ahead and y to the left, in m. A wrong track has the
same effect on turns in both directions, and unequal wheels bend both paths to the same side. Both directions together
separate the two errors, which may cancel each other in one direction. The mean radius, which scales distances, is not
observable from a closed square.
"""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from canopen_control.errors import ConfigError, ControlError

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence


Planar = tuple[float, float, float]
TURN: Final = math.pi / 2  # turn at a corner of the square, in rad
_LARGEST: Final = 1000.0  # maximum side in m; a larger value is probably not in m
_FAR: Final = 1.0
"""Maximum distance of a plausible end position, as a fraction of the side.

A position further away was measured wrongly, or belongs to another path. A newly assembled base with wheels that differ
by 1 % and a track of 0.24 m that is wrong by 10 % ends 0.93 of a side of 4 m away. A length in cm taken for m exceeds
the limit from 1 % of the side on.
"""


class ImplausibleEnds(ConfigError):
    """Error: the end positions of the squares do not result in a valid calibration."""


class Direction(enum.Enum):
    """Direction of a square; the value is the sign of the turns."""

    CCW = 1
    CW = -1

    @property
    def word(self) -> str:
        return "counter-clockwise" if self is Direction.CCW else "clockwise"


@dataclass(frozen=True, slots=True)
class SquareRun:
    """Error of one square: true end position minus end position by odometry.

    `x` is ahead of the start and `y` to its left, in m.
    """

    direction: Direction
    x: float
    y: float


@dataclass(frozen=True, slots=True)
class WheelFactors:
    """Multipliers of the current wheel values: track, left radius and right radius."""

    separation: float = 1.0
    left: float = 1.0
    right: float = 1.0

    def after(self, before: WheelFactors) -> WheelFactors:
        """Return these multipliers combined with earlier multipliers."""
        return WheelFactors(self.separation * before.separation, self.left * before.left, self.right * before.right)


@dataclass(frozen=True, slots=True)
class Correction:
    """Correction of the wheel values, derived from the errors of the squares.

    E_b is the true track divided by the current track, E_d the diameter of the right wheel divided by that of the left
    wheel. `largest` is the systematic error E_max,syst in m: the larger of the mean errors of both directions.
    `scatter` in m is three standard deviations of the runs about these means, which calibration cannot remove; None
    with one run per direction.
    """

    e_b: float
    e_d: float
    largest: float
    scatter: float | None

    @property
    def factors(self) -> WheelFactors:
        """Multipliers of the current wheel values; the mean radius is unchanged."""
        return WheelFactors(self.e_b, 2.0 / (self.e_d + 1.0), 2.0 / (1.0 / self.e_d + 1.0))


def relative(end: Planar, start: Planar) -> Planar:
    """Return the pose `end` relative to the pose `start`."""
    cosine, sine = math.cos(start[2]), math.sin(start[2])
    x, y = end[0] - start[0], end[1] - start[1]
    return cosine * x + sine * y, cosine * y - sine * x, end[2] - start[2]


def correction(runs: Sequence[SquareRun], side: float, separation: float, least: int = 1) -> Correction:
    """Compute the correction from runs around squares of `side`, with a current track of `separation`, both in m.

    Raise ImplausibleEnds for invalid numbers, errors larger than the side, or fewer than `least` runs per direction.
    """
    _refuse_sizes(side, separation)
    for number, run in enumerate(runs, 1):
        _refuse_run(number, run, side)
    by_direction = {direction: [run for run in runs if run.direction is direction] for direction in Direction}
    _refuse_count(by_direction, least)
    means = {direction: _mean(group) for direction, group in by_direction.items()}
    (x_ccw, y_ccw), (x_cw, y_cw) = means[Direction.CCW], means[Direction.CW]
    # angles in rad; they follow from x as well as from y, with a second-order error of the other angle: use the mean
    alpha = ((x_cw + x_ccw) + (y_cw - y_ccw)) / (-8.0 * side)
    beta = ((x_cw - x_ccw) + (y_cw + y_ccw)) / (-8.0 * side)
    e_b = TURN / (TURN - alpha)
    bend = 2.0 * math.sin(beta / 2.0) * (separation / 2.0) / side  # half the track over the radius of the bent side
    largest = max(math.hypot(x, y) for x, y in means.values())
    return Correction(e_b, (1.0 + bend) / (1.0 - bend), largest, _scatter(by_direction, means))


def _refuse_sizes(side: float, separation: float) -> None:
    for name, value in (("side of the square", side), ("wheel separation", separation)):
        if not (math.isfinite(value) and value > 0.0):
            raise ImplausibleEnds(f"the {name} is {value:g} m; give a length above 0")
    if side > _LARGEST:
        raise ImplausibleEnds(f"a side of {side:g} m is longer than {_LARGEST:g} m; was it given in metres?")
    if side < separation:
        raise ImplausibleEnds(f"a side of {side:g} m is shorter than the wheel separation; drive a larger square")


def _refuse_run(number: int, run: SquareRun, side: float) -> None:
    if not (math.isfinite(run.x) and math.isfinite(run.y)):
        raise ImplausibleEnds(
            f"run {number} ({run.direction.word}) ended at {run.x}, {run.y}, which is not a position; measure it again"
        )
    if (away := math.hypot(run.x, run.y)) > _FAR * side:
        raise ImplausibleEnds(
            f"run {number} ({run.direction.word}) ended {away:.2f} m from its odometry, more than the "
            f"side of {side:g} m; were metres measured from the start of the run, x ahead and y to the left?"
        )


def _refuse_count(by_direction: dict[Direction, list[SquareRun]], least: int) -> None:
    for direction, runs in by_direction.items():
        if not runs:
            raise ImplausibleEnds(
                f"no run is {direction.word}; drive both directions, because one alone may hide both errors"
            )
        if len(runs) < least:
            count = "1 run is" if len(runs) == 1 else f"{len(runs)} runs are"
            raise ImplausibleEnds(f"{count} {direction.word}; {least} of each direction are needed")


def _mean(runs: Sequence[SquareRun]) -> tuple[float, float]:
    return math.fsum(run.x for run in runs) / len(runs), math.fsum(run.y for run in runs) / len(runs)


def _scatter(
    by_direction: dict[Direction, list[SquareRun]], means: dict[Direction, tuple[float, float]]
) -> float | None:
    """Return three standard deviations of the runs about the mean of their direction; None with one run in each."""
    freedom = sum(len(runs) - 1 for runs in by_direction.values())
    if freedom == 0:
        return None
    squares = (_squares(runs, means[direction]) for direction, runs in by_direction.items())
    return 3.0 * math.sqrt(math.fsum(squares) / freedom)


def _squares(runs: Iterable[SquareRun], mean: tuple[float, float]) -> float:
    return math.fsum((run.x - mean[0]) ** 2 + (run.y - mean[1]) ** 2 for run in runs)


# Square path by odometry: straight sides, a stop at each corner, turns in place. The code does no input or output: it
# computes the twist to command from each pose of the odometry until `done`. Speeds ramp down towards the end of a side
# or turn, so that the odometry ends within some mm of the end of the square, which the measurement takes into account.
# A base that deviates ends the path with an error text. Clockwise is the exact mirror image of counter-clockwise.


_CORNERS: Final = 4
_NEAR: Final = 0.001  # remaining distance in m at which a side ends
_STRAIGHT: Final = 0.001  # remaining angle in rad at which a turn ends
_CREEP: Final = (0.01, 0.02)  # m/s and rad/s: speed at the end of a ramp
_STANDSTILL: Final = (0.002, 0.005)  # m and rad: maximum motion of a base at standstill
_STEER: Final = (2.0, 1.0)  # rad/s per rad of heading error, and per m of lateral error over 0.1 m
_MAX_STEER: Final = 0.2  # rad/s
_PATIENCE_S: Final = 5.0  # added to twice the expected time of a side or turn


@dataclass(frozen=True, slots=True)
class Pace:
    """Speeds of a square in m/s and rad/s, and decelerations to a stop in m/s^2 and rad/s^2.

    `settle` in s is the pause before and after each turn.
    """

    speed: float = 0.2
    turn: float = 0.6
    ramp: float = 0.25
    turn_ramp: float = 0.8
    settle: float = 0.5


def allowed_deviation(side: float) -> float:
    """Return the distance in m from a square with sides of `side` m beyond which its run is aborted."""
    return max(0.2, 0.3 * side)


class _Phase(enum.Enum):
    SIDE = "side"
    CORNER = "corner"  # pause before a turn
    TURN = "turn"
    REST = "rest"  # pause after a turn
    DONE = "done"


_NEXT: Final = {
    _Phase.SIDE: _Phase.CORNER,
    _Phase.CORNER: _Phase.TURN,
    _Phase.TURN: _Phase.REST,
    _Phase.REST: _Phase.SIDE,
}
_MOVES: Final = frozenset({_Phase.SIDE, _Phase.TURN})


class SquarePath:
    """Path around one square with a side of `side` m, starting at the first pose of the odometry.

    `corner` is the number of completed turns.
    """

    def __init__(self, side: float, direction: Direction, pace: Pace) -> None:
        self.side, self.direction, self.pace = side, direction, pace
        self.corner = 0
        self._phase = _Phase.SIDE
        self._start: Planar | None = None
        self._since = 0.0  # start of the phase in s
        self._stood: tuple[Planar, float] | None = None  # pose of a base at standstill, and its first time in s

    @property
    def done(self) -> bool:
        """Whether the base is at rest at the end of the square."""
        return self._phase is _Phase.DONE

    def twist(self, pose: Planar, now: float) -> tuple[float, float]:
        """Return the twist to command, in m/s and rad/s, for the odometry `pose` at `now` in s.

        Raise ControlError if the base deviates from the square or takes too long.
        """
        if self._start is None:
            self._start, self._since = pose, now
        moved = relative(pose, self._start)
        self._check(moved, now)
        if self._phase in _MOVES:
            command = self._along(moved) if self._phase is _Phase.SIDE else self._around(moved)
            if command is not None:
                return command
            self._enter(_NEXT[self._phase], now)
        elif self._is_standstill(moved, now):
            self._enter(_NEXT[self._phase], now)
        return 0.0, 0.0

    def _enter(self, phase: _Phase, now: float) -> None:
        if phase is _Phase.REST:
            self.corner += 1
        if phase is _Phase.SIDE and self.corner == _CORNERS:
            phase = _Phase.DONE
        self._phase, self._since, self._stood = phase, now, None

    def _is_standstill(self, moved: Planar, now: float) -> bool:
        if self._stood is not None:
            (x, y, heading), since = self._stood
            if math.hypot(moved[0] - x, moved[1] - y) <= _STANDSTILL[0] and abs(moved[2] - heading) <= _STANDSTILL[1]:
                return now - since >= self.pace.settle
        self._stood = moved, now
        return False

    def _along(self, moved: Planar) -> tuple[float, float] | None:
        """Return the twist along the current side, or None at the end of the side."""
        ahead, aside, turned = self._from_corner(moved)
        remaining = self.side - ahead
        if remaining <= _NEAR:
            return None
        speed = min(
            self.pace.speed, math.sqrt(2.0 * self.pace.ramp * remaining) + _CREEP[0], remaining * 4.0 + _CREEP[0]
        )
        steer = -_STEER[0] * turned - _STEER[1] * math.atan(aside / 0.1)
        return speed, max(-_MAX_STEER, min(_MAX_STEER, steer))

    def _around(self, moved: Planar) -> tuple[float, float] | None:
        """Return the twist of the current turn, or None at the end of the turn."""
        sign = self.direction.value
        remaining = (self.corner + 1) * TURN - sign * moved[2]
        if remaining <= _STRAIGHT:
            return None
        speed = min(
            self.pace.turn, math.sqrt(2.0 * self.pace.turn_ramp * remaining) + _CREEP[1], remaining * 4.0 + _CREEP[1]
        )
        return 0.0, sign * speed

    def _from_corner(self, moved: Planar) -> Planar:
        """Return the pose relative to the corner at which the current side begins, with x along the side."""
        corners = ((0.0, 0.0), (self.side, 0.0), (self.side, self.side), (0.0, self.side))
        x, y = corners[self.corner % _CORNERS]
        sign = self.direction.value
        heading = self.corner * TURN
        cosine, sine = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[self.corner % _CORNERS]
        along, aside = moved[0] - x, sign * moved[1] - y  # mirrored to counter-clockwise
        return cosine * along + sine * aside, sign * (cosine * aside - sine * along), moved[2] - sign * heading

    def _check(self, moved: Planar, now: float) -> None:
        """Raise ControlError if the base deviates from the square, or takes too long for a side, turn or pause."""
        x, y = moved[0], self.direction.value * moved[1]
        off = max(-x, x - self.side, -y, y - self.side)
        if not off <= allowed_deviation(self.side):  # nan too
            raise ControlError(
                f"the base has left the square of {self.side:g} m: odometry is at {moved[0]:.2f}, {moved[1]:.2f} m "
                "from its start; does another client drive it?"
            )
        if now - self._since > self._patience():
            problem = "does not come to rest" if self._phase not in _MOVES else "does not move as it is commanded"
            place = f"{self._phase.value} {min(self.corner + 1, _CORNERS)} of the square"
            raise ControlError(f"the base {problem}: {now - self._since:.0f} s at {place}; see canopen-control status")

    def _patience(self) -> float:
        pace = self.pace
        side = self.side / pace.speed + pace.speed / pace.ramp
        turn = TURN / pace.turn + pace.turn / pace.turn_ramp
        return _PATIENCE_S + 2.0 * {_Phase.SIDE: side, _Phase.TURN: turn}.get(self._phase, pace.settle)
