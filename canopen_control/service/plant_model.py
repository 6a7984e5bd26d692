"""Identifies a motor with its load: inertia, viscous and Coulomb friction, constant load, dead time; least squares.

The model is J dw/dt = u - B w - C sgn(w) + g. What is fitted is its integral over each cycle. A torque is held for a
cycle, and where in the cycle it changes is unknown; so the dead time is found first, as the one that leaves the least
residual, in quarters of a cycle: one cycle that is not accounted for costs a quarter of the inertia. Samples around
standstill are left out, since there Coulomb friction is any torque up to C. No friction drives a shaft: where the least
residual would need one below 0, as that of an axis without friction does by its noise, it is 0 and the rest is fitted
without it.
Units: u in per mille of the rated torque (or N m), w in rad/s, so J in per mille s^2/rad (or kg m^2).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from canopen_control.errors import DriveError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

__all__ = ["PlantModel", "identify_plant"]

_MOST_DELAY: Final = 4.0  # cycles
_STEPS: Final = 4  # of a cycle
_STANDING: Final = 0.05  # of the greatest speed, below which it stands
_FEWEST: Final = 50
_VISCOUS, _COULOMB = 1, 2  # their columns
_MODELS: Final = ([0, 1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 3])
"""The columns that are fitted: all, else without a friction that would be below 0; the last ones have none."""
_TRUSTED: Final = 0.7  # of the changes of speed that the model has to explain


@dataclass(frozen=True, slots=True)
class PlantModel:
    """What was identified; `load` is g, `delay` in s, `fit` how much of the changes of speed it explains, 1 is all."""

    inertia: float
    viscous: float
    coulomb: float
    load: float
    delay: float
    fit: float

    @property
    def time_constant(self) -> float:
        """J/B in s, infinite without viscous friction."""
        return self.inertia / self.viscous if self.viscous > 0.0 else math.inf

    def scaled(self, unit: float) -> PlantModel:
        """Return it with torques in another unit, `unit` for each of this one."""
        parts = (self.inertia * unit, self.viscous * unit, self.coulomb * unit, self.load * unit)
        return PlantModel(*parts, self.delay, self.fit)


def identify_plant(torque: Sequence[float], speed: Sequence[float], period: float) -> PlantModel:
    """Identify from samples of each cycle of `period` s; DriveError where they do not tell.

    A sample that is not known is nan; it is left out with the cycles behind it in which its torque acts.
    """
    u, w = np.asarray(torque, float), np.asarray(speed, float)
    if len(w) < _FEWEST:
        raise DriveError(f"{len(w)} samples are too few to identify anything; excite it longer: --for S")
    fastest = float(np.nanmax(np.abs(w)))
    if not fastest:
        raise DriveError("the shaft did not move: the torque does not overcome its friction; take more, or free it")
    found: tuple[float, NDArray[np.floating], float, float] | None = None
    first = int(_MOST_DELAY) + 1
    for quarter in range(round(_MOST_DELAY * _STEPS) + 1):
        delay = quarter / _STEPS
        fitted = _fit(_delayed(u, delay, first), w, first, fastest, period)
        if found is None or fitted[1] < found[2]:
            found = delay, fitted[0], fitted[1], fitted[2]
    assert found is not None
    delay, parts, residual, power = found
    share = 1.0 - residual / power if power > 0.0 else 0.0
    if parts[0] <= 0.0 or share < _TRUSTED:
        raise DriveError(
            f"the speed does not follow the torque as that of a mass with friction does (it explains {share:.0%} of "
            "it): excite it more, look whether the shaft is free and whether something else drives it"
        )
    inertia = 1.0 / parts[0]
    viscous, coulomb = abs(parts[_VISCOUS]) * inertia, abs(parts[_COULOMB]) * inertia
    return PlantModel(inertia, viscous, coulomb, parts[3] * inertia, delay * period, min(1.0, share))


def _delayed(u: NDArray[np.float64], delay: float, first: int) -> NDArray[np.float64]:
    """Return the mean torque between each sample from `first` on and the one before, `delay` cycles late."""
    whole = int(delay)
    part = delay - whole
    late = u[first - whole : len(u) - whole]
    later = u[first - whole - 1 : len(u) - whole - 1]
    return (1.0 - part) * late + part * later


def _fit(
    u: NDArray[np.float64], w: NDArray[np.float64], first: int, fastest: float, period: float
) -> tuple[NDArray[np.floating], float, float]:
    """Return 1/J, -B/J, -C/J, g/J, and the sums of squares of the residual and of the changes; DriveError."""
    before, after = w[first - 1 : -1], w[first:]
    mean = 0.5 * (before + after)
    moving = np.minimum(np.abs(before), np.abs(after)) > _STANDING * fastest
    moving &= (before * after > 0.0) & np.isfinite(u)
    if int(moving.sum()) < _FEWEST:
        raise DriveError("the shaft hardly moved: the torque does not overcome its friction; take more, or free it")
    turned = np.sign(mean[moving])
    if int(min((turned > 0.0).sum(), (turned < 0.0).sum())) < _FEWEST // 5:
        raise DriveError("the shaft turned one way only, so that friction and load look the same: excite it more")
    change = (after - before)[moving]
    allowed: list[tuple[NDArray[np.floating], float, float]] = []
    columns = period * np.column_stack([u[moving], mean[moving], turned, np.ones(len(change))])
    power = float(change @ change)
    for kept in _MODELS:
        parts = np.zeros(columns.shape[1])
        parts[list(kept)], _, _, _ = np.linalg.lstsq(columns[:, kept], change, rcond=None)
        left = change - columns @ parts
        if parts[_VISCOUS] <= 0.0 and parts[_COULOMB] <= 0.0:
            allowed.append((parts, float(left @ left), power))
            if kept == _MODELS[0]:
                break
    return min(allowed, key=lambda fit: fit[1])
