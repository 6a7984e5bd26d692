"""The loops of a virtual servo with gains of its own: position P and feed-forward over velocity PI, on any plant.

The torque is made anew at each point of a fixed grid and held until the next, so what happens does not depend on when
somebody looks. In modes of operation that command a velocity there is no position loop, as in servo drives.
Units: counts, counts/s, per mille of the rated torque.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from canopen_control.virtual.trajectory import cruise

if TYPE_CHECKING:
    from canopen_control.virtual.plant import Plant, ServoGains
    from canopen_control.virtual.trajectory import Trajectory

__all__ = ["PERIOD_NS", "VelocityLoop"]

PERIOD_NS: Final = 500_000
_PERIOD_S: Final = PERIOD_NS * 1e-9


class VelocityLoop:
    """Loops with gains; `fed` is what comes beside the demand, in counts/s and per mille (0x60B1, 0x60B2)."""

    def __init__(self, gains: ServoGains) -> None:
        self.gains = gains
        self.fed = (0.0, 0.0)
        self._integral = self._torque = 0.0

    def rest(self, torque: float = 0.0) -> None:
        """Forget what was gathered; go on from a torque."""
        self._integral = self._torque = torque
        self.fed = (0.0, 0.0)

    def follow(
        self, plant: Plant, demand: Trajectory, start_ns: int, end_ns: int, limit: float, *, velocity_only: bool
    ) -> None:
        """Move a plant along a demand, with at most `limit` of torque."""
        clock = start_ns
        for point in range((start_ns // PERIOD_NS + 1) * PERIOD_NS, end_ns + 1, PERIOD_NS):
            self._push(plant, clock, point)
            position, velocity = demand.at(point)
            known = self.fed[0] or (velocity if velocity_only else velocity * self.gains.feed_forward)
            if not velocity_only:
                known += self.gains.position_p * (position - plant.position)
            self._control(known - plant.velocity, limit, plant)
            clock = point
        self._push(plant, clock, end_ns)

    def _push(self, plant: Plant, start_ns: int, end_ns: int) -> None:
        if end_ns > start_ns:
            plant.push(cruise(start_ns, 0.0, self._torque), start_ns, end_ns)

    def _control(self, lacking: float, limit: float, plant: Plant) -> None:
        """Make the torque until the next point; at a limit, the loop's or the motor's, nothing more is gathered."""
        gains = self.gains
        wanted = gains.velocity_p * lacking + self._integral + self.fed[1]
        held = max(-limit, min(limit, wanted))
        bounded = held != wanted or abs(plant.torque) < abs(self._torque) * (1.0 - 1e-9)
        if not bounded or lacking * wanted < 0.0:
            self._integral += gains.velocity_i * lacking * _PERIOD_S
        self._torque = held
