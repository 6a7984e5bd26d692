"""A mode whose set-points come in a stream of RPDOs: what it counts of them, and what it does when one is missing.

The stream begins with the second RPDO after the mode began; what is written by SDO is followed and makes no stream, so
that nobody who tries a drive by hand runs into its supervision. When a set-point is due is told by the interpolation
time 0x60C2, as a drive reckons that does not know its master's period.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.cia301.emcy_codes import ErrorRegister
from canopen_control.cia402 import objects as o
from canopen_control.virtual.mode_base import FollowingMode

if TYPE_CHECKING:
    from canopen_control.cia402.options import Reaction

__all__ = ["StreamMode"]

_MS = 1_000_000


class StreamMode(FollowingMode):
    """The base of CSP, IP, CSV and CST; subclasses name their `set_point` and call `supervise` for each."""

    def reset(self) -> None:
        """Forget the target and the stream."""
        super().reset()
        self._arrived = 0  # set-points since the mode began or was stopped
        self._begun = False
        self.mover.feed_forward(0.0, 0.0)

    def start(self, now: int) -> None:
        """Go on to the target from the present motion; the quality is measured anew, but for a halt."""
        if not self._begun:
            self._begun = self.meter.used = True
            self.meter.restart()
        super().start(now)

    def stop(self, now: int, reaction: Reaction) -> None:
        """End the stream, and what is fed forward; then as every mode."""
        self.meter.follow(self.mover.demand, now)
        self.meter.pause()
        self._arrived = 0
        self.mover.cancel("set point")
        self.mover.feed_forward(0.0, 0.0)
        super().stop(now, reaction)

    @property
    def streaming(self) -> bool:
        """Whether set-points have come one after the other."""
        return self._arrived > 1

    @property
    def cycles(self) -> int:
        """For how many interpolation periods it goes on without a set-point."""
        missing, store = self.model.missing, self.objects.store
        if missing.cycles_object is None:
            return missing.cycles
        return store.number(*missing.cycles_object, default=missing.cycles)

    @property
    def period_ns(self) -> int:
        """When the next set-point is due after one: the interpolation time, 1 ms where that is 0."""
        return round(self.objects.interpolation_s * 1e9) or _MS

    def take(self, now: int) -> None:
        """Count the set-point, look at it also where it is the one before, and expect the next one."""
        self._arrived += 1
        self.meter.take(self.compared(), now)
        self.update(now)
        self.supervise(now)

    def compared(self) -> float | None:
        """Return the set-point that must change while the axis moves; None: a constant one is a motion, too."""
        return None

    def missed(self) -> None:
        """Note that a SYNC came without a set-point."""
        if self.streaming:
            self.meter.missed += 1

    def supervise(self, now: int) -> None:
        """Let the drive fault when none comes for as long as it goes on alone, where it does."""
        cycles = self.cycles if self.model.missing.fault and self.streaming else 0
        if cycles:
            period = self.period_ns
            self.mover.at("set point", now + (1 + cycles) * period + period // 2, self._lost)

    def feed(self) -> None:
        """Feed 0x60B1 and 0x60B2 forward: they are added in the loops and move no demand."""
        number = self.objects.number
        self.mover.feed_forward(number(o.VELOCITY_OFFSET) * self.units.velocity, float(number(o.TORQUE_OFFSET)))

    def _lost(self, now: int) -> None:
        if self.power.live and self._begun:
            self.power.fault(self.model.missing.fault, now, register=ErrorRegister.MANUFACTURER)
