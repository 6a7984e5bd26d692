"""Calibration session: drives squares in both directions, sets corrected values, and drives the squares again.

Unless the calibration ends with an improvement, the initial values are restored. The end positions are the true poses
of a simulation, or measurements of the user.
"""

from __future__ import annotations

import contextlib
import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Final, Protocol

from canopen_control.calibration.base_link import FACTORS
from canopen_control.calibration.umbmark import (
    TURN,
    Correction,
    Direction,
    Pace,
    SquarePath,
    SquareRun,
    WheelFactors,
    allowed_deviation,
    correction,
)
from canopen_control.errors import CanopenError, ControlError

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.calibration.base_link import Driven, WheelValues


EXACT: Final = 0.001  # m; a smaller error is not corrected
_NO_BETTER: Final = 0.0002  # m; a smaller improvement does not justify another pass
_OF_LIMIT: Final = 0.8  # fraction of the controller's ramps: the rest is for its own delay


class CalibratedBase(Protocol):
    """Base that is calibrated; `BaseLink` is the implementation for a running robot."""

    def wheel_values(self) -> WheelValues:
        """Return the current wheel values and limits."""

    def set_factors(self, factors: tuple[float, float, float]) -> None:
        """Set the multipliers of track, left radius and right radius."""

    def drive(self, path: SquarePath) -> Driven:
        """Drive a square to its end, and return the end position."""


class Ends(Protocol):
    """Source of the true end positions of the squares."""

    def before(self, text: str) -> None:
        """Announce the next square, described by `text`, and return when the base may start."""

    def end(self, text: str, driven: Driven) -> tuple[float, float]:
        """Return the true end position of the base, in m ahead and to the left of the start of the square."""


class TrueEnds:
    """Source of true end positions for a simulated base: the true poses of the simulation."""

    def __init__(self, report: Callable[[str], object]) -> None:
        self._report = report

    def before(self, text: str) -> None:
        self._report(text)

    def end(self, text: str, driven: Driven) -> tuple[float, float]:
        """Return the end position of the simulation; raise ControlError if it has reported none."""
        if driven.truth is None:
            raise ControlError(f"{text}: the simulation has reported no true pose")
        return driven.truth[0], driven.truth[1]


@dataclass(frozen=True, slots=True)
class CalibrationPlan:
    """Plan of a calibration: squares of `side` m, `runs` per direction, and `passes` with corrected values."""

    side: float = 1.0
    runs: int = 1
    passes: int = 1
    pace: Pace = field(default_factory=Pace)

    @property
    def squares(self) -> int:
        """Maximum number of squares, including those with the initial values."""
        return 2 * self.runs * (self.passes + 1)

    @property
    def seconds(self) -> float:
        """Approximate driving time of all squares in s."""
        pace = self.pace
        side = self.side / pace.speed + pace.speed / pace.ramp + pace.settle
        turn = TURN / pace.turn + pace.turn / pace.turn_ramp + pace.settle
        return self.squares * 4.0 * (side + turn)


@dataclass(frozen=True, slots=True)
class CalibrationResult:
    """Result of a calibration: the corrections from the first and the last pass, and the final multipliers."""

    first: Correction
    last: Correction
    factors: dict[str, float]

    @property
    def gain(self) -> float:
        """Ratio of the largest systematic error before the calibration to that after it."""
        return self.first.largest / self.last.largest if self.last.largest else math.inf


def fitting_pace(pace: Pace, wheels: WheelValues) -> Pace:
    """Return the pace, reduced to the limits of the controller."""
    return replace(
        pace,
        speed=min(pace.speed, wheels.max_linear),
        turn=min(pace.turn, wheels.max_angular),
        ramp=min(pace.ramp, _OF_LIMIT * wheels.linear_ramp),
        turn_ramp=min(pace.turn_ramp, _OF_LIMIT * wheels.angular_ramp),
    )


def space(side: float) -> str:
    """Return a text about the free space that squares with sides of `side` m need around the start."""
    margin = allowed_deviation(side)
    return (
        f"{side + margin:.2f} m ahead of its start and as much to its left and to its right, {margin:.2f} m behind it, "
        "plus the size of the robot in each direction"
    )


def calibrate(
    base: CalibratedBase,
    ends: Ends,
    plan: CalibrationPlan,
    report: Callable[[str], object],
    corrected: Callable[[dict[str, float]], object] = lambda _: None,
) -> CalibrationResult:
    """Calibrate a base; `report` receives progress texts, `corrected` each set of new multipliers by name.

    Raise ControlError, RemoteError or ImplausibleEnds if the calibration fails; the initial values are then restored.
    """
    wheels = base.wheel_values()
    original = wheels.factors
    try:
        first = last = _round(base, ends, plan, wheels.separation, f"uncorrected, 1 of {plan.passes + 1}", report)
        for number in range(1, plan.passes + 1):
            if last.largest <= (EXACT if last is first else _NO_BETTER):
                break
            factors = last.factors.after(WheelFactors(*wheels.factors))
            new = (_written(factors.separation), _written(factors.left), _written(factors.right))
            wheels = replace(wheels, factors=new, separation=wheels.separation * last.e_b)
            corrected(dict(zip(FACTORS, new, strict=True)))
            base.set_factors(new)
            last = _round(base, ends, plan, wheels.separation, f"corrected, {number + 1} of {plan.passes + 1}", report)
        if wheels.factors != original and last.largest >= first.largest:
            raise ControlError(
                f"the largest error is {1e3 * last.largest:.1f} mm with the corrected values and was "
                f"{1e3 * first.largest:.1f} mm before: they are not an improvement; measure again, with more runs"
            )
    except BaseException:
        if wheels.factors != original:
            with contextlib.suppress(CanopenError):  # a robot that has ended has lost the values anyway
                base.set_factors(original)
        raise
    return CalibrationResult(first, last, dict(zip(FACTORS, wheels.factors, strict=True)))


def _round(
    base: CalibratedBase,
    ends: Ends,
    plan: CalibrationPlan,
    separation: float,
    title: str,
    report: Callable[[str], object],
) -> Correction:
    """Drive all squares of one pass with the current values, and return the correction."""
    runs = []
    for number in range(1, plan.runs + 1):
        for direction in Direction:
            text = f"{title}: run {number} of {plan.runs}, {direction.word}"
            ends.before(text)
            driven = base.drive(SquarePath(plan.side, direction, plan.pace))
            x, y = ends.end(text, driven)
            run = SquareRun(direction, x - driven.odometry[0], y - driven.odometry[1])
            report(f"  ended {1e3 * math.hypot(run.x, run.y):.1f} mm from odometry: {_millimetres(run.x, run.y)}")
            runs.append(run)
    result = correction(runs, plan.side, separation, least=plan.runs)
    scatter = "" if result.scatter is None else f", scatter (3 sigma) {1e3 * result.scatter:.1f} mm"
    report(
        f"  largest systematic error {1e3 * result.largest:.1f} mm{scatter}; right / left wheel {result.e_d:.6f}, "
        f"true track / current track {result.e_b:.6f}"
    )
    return result


def _written(value: float) -> float:
    """Round a value to the digits written to a file, so that robot and file have the same value."""
    return float(f"{value:.9g}")


def _millimetres(x: float, y: float) -> str:
    ahead, sideways = (round(1e3 * metres, 1) + 0.0 for metres in (x, y))
    return f"{ahead:+.1f} mm ahead, {sideways:+.1f} mm to the left"
