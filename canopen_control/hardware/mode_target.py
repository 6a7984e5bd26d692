"""The target of one mode of operation: the verbs that every mode has, and what they share (CiA 402-2).

`hold` is standstill where the axis is, for every cycle in which nothing may move; `follow` takes a target in SI units,
nan for none; `slow` is one cycle of a controlled stop and tells when its target stands. A target that did not change
costs one comparison.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.cia402.drive import DriveMachine
    from canopen_control.cia402.setpoint import SetPointEvent
    from canopen_control.hardware.axis import Axis
    from canopen_control.master.cycle import Output

__all__ = ["ModeTarget", "stop_slope"]

_NAN: Final = math.nan
_DEFAULT_STOP_S: Final = 0.5  # of a ramp where the drive tells no deceleration


class ModeTarget:
    """The target of one mode: what the modes share, and their verbs.

    `output` carries it, `bits` are the mode's bits of the controlword; `handshakes` says that it has events of its own,
    `tracks` that the axis is to be where the target is, or as fast, in every cycle.
    """

    interface = ""
    bits = 0
    handshakes = False
    tracks = False

    def __init__(self, axis: Axis, output: Output, machine: DriveMachine) -> None:
        self._axis, self.output, self._machine = axis, output, machine
        self._value = _NAN
        self._blocked = 0
        self._slope = 0.0  # of a stop that the master ramps

    def hold(self) -> None:
        """Stay where the axis is."""
        raise NotImplementedError

    def follow(self, value: float, now: int, period: float) -> None:
        """Take a target in SI units, nan for none."""
        raise NotImplementedError

    def ramp(self, velocity: float, slope: float) -> None:
        """Take a speed and an acceleration, in device units, for targets that are places to go to and no set-points."""

    def slow(self, period: float) -> bool:
        """Make one cycle of a controlled stop; True when the target stands."""
        raise NotImplementedError

    def span(self) -> tuple[float, float]:
        """Return the lowest and the highest value that its object can hold now, in SI units."""
        raise NotImplementedError

    def pushes(self, value: float) -> bool:  # noqa: ARG002 - the verb of every mode
        """Whether a target in SI units leads beyond the active limit; a position never does, it stays before it."""
        return False

    def events(self) -> Sequence[SetPointEvent]:
        """Return what happened since the last call."""
        return ()

    def _same(self, value: float) -> bool:
        """Whether the target is the one of the last cycle, under the same limits."""
        if value == self._value and self._axis.limits.blocked == self._blocked:
            return True
        self._value, self._blocked = value, self._axis.limits.blocked
        return False


def stop_slope(axis: Axis, speed: float) -> float:
    """Return units/s^2 of a stop: the drive's (0x6084), or what stops this speed in half a second."""
    slope = axis.limits.deceleration
    return slope if math.isfinite(slope) and slope > 0 else speed / _DEFAULT_STOP_S
