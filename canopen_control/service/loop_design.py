"""PI gains of a velocity loop for a phase margin, P of the position loop around it, from an identified plant.

The plant is 1/(J s + B) with a dead time Td in the loop; the open loop is to pass 1 at the crossover frequency with
the phase margin wanted. All of it is arithmetic on phases; where the phase that the controller would need cannot be
had, a PI has no solution and the crossover is too high for this dead time.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from canopen_control.errors import ConfigError

if TYPE_CHECKING:
    from canopen_control.service.plant_model import PlantModel

__all__ = ["LOOP_DELAY_S", "LoopGains", "design_velocity_loop", "phase_margin"]

LOOP_DELAY_S: Final = 0.0005
"""The dead time of a velocity loop inside a drive, where nobody tells another."""
_POSITION_SHARE: Final = 4.0  # the position loop is so much slower


@dataclass(frozen=True, slots=True)
class LoopGains:
    """`velocity_p` in torque per rad/s, `reset` (Ti) in s, `position_p` in 1/s; crossover in rad/s, margin in rad."""

    velocity_p: float
    reset: float
    position_p: float
    crossover: float
    margin: float

    @property
    def velocity_i(self) -> float:
        """Torque per rad: the P gain divided by the reset time."""
        return self.velocity_p / self.reset


def design_velocity_loop(plant: PlantModel, crossover: float, margin: float, delay: float = LOOP_DELAY_S) -> LoopGains:
    """Return gains for a crossover in rad/s and a phase margin in rad; ConfigError where there are none."""
    viscous = max(0.0, plant.viscous)
    lag = -math.atan2(plant.inertia * crossover, viscous) - crossover * delay
    needed = margin - math.pi - lag
    if not -math.pi / 2.0 < needed < 0.0:
        raise ConfigError(_impossible(needed, crossover, margin, delay))
    reset = math.tan(needed + math.pi / 2.0) / crossover
    gain = abs(complex(viscous, plant.inertia * crossover)) / math.hypot(1.0, 1.0 / (crossover * reset))
    return LoopGains(gain, reset, crossover / _POSITION_SHARE, crossover, margin)


def _impossible(needed: float, crossover: float, margin: float, delay: float) -> str:
    words = f"a crossover of {crossover / math.tau:.3g} Hz with a phase margin of {math.degrees(margin):.0f} degrees"
    if needed >= 0.0:
        return f"no PI gives {words} at a dead time of {delay * 1e3:.3g} ms: take a lower --crossover or --phase-margin"
    return f"{words} needs no P at all: take a greater --phase-margin, or a higher --crossover"


def phase_margin(plant: PlantModel, gains: LoopGains, delay: float = LOOP_DELAY_S) -> tuple[float, float]:
    """Return the crossover in rad/s and the phase margin in rad that gains have on a plant: of another load, say.

    The gain of the open loop falls all the way, so the crossover is found by halving.
    """

    def loop(omega: float) -> complex:
        s = complex(0.0, omega)
        controller = gains.velocity_p * (1.0 + 1.0 / (gains.reset * s))
        return controller * cmath.exp(-s * delay) / (plant.inertia * s + max(0.0, plant.viscous))

    low, high = 1e-3, 1e6
    for _ in range(100):
        middle = math.sqrt(low * high)
        low, high = (middle, high) if abs(loop(middle)) > 1.0 else (low, middle)
    lag = -math.atan2(plant.inertia * low, max(0.0, plant.viscous)) - low * delay
    return low, math.pi + lag - math.atan2(1.0, gains.reset * low)
