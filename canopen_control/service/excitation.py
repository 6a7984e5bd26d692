"""Excitation signals for tuning and identification: step, logarithmic chirp, pseudo-random binary sequence (PRBS).

Sans-IO: a signal is a function of the seconds since it began, in the unit of what is commanded (rad/s, or per mille of
the rated torque). A chirp and a PRBS rise and fall over `RAMP_S`, so that neither begins nor ends with a blow; a step
is one, which is what is measured. Each is zero at its end and behind it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Final, Protocol

__all__ = ["LEAD_S", "RAMP_S", "Chirp", "Excitation", "Prbs", "Step"]

RAMP_S: Final = 0.2
LEAD_S: Final = 0.3  # of standstill before a step, by which its beginning is known
_TAPS: Final = {7: (7, 6), 8: (8, 6, 5, 4), 9: (9, 5), 10: (10, 7), 11: (11, 9)}
"""Feedback of shift registers whose sequence is the longest there is, 2**bits - 1."""


class Excitation(Protocol):
    """A signal; `seconds` is its length, `peak` the most that it commands, either way."""

    @property
    def seconds(self) -> float:
        """How long it is."""

    @property
    def peak(self) -> float:
        """The most that it commands, either way."""

    def at(self, seconds: float) -> float:
        """Return what is commanded so long after its beginning."""


@dataclass(frozen=True, slots=True)
class Step:
    """Nothing for `LEAD_S`, then `height` until the end."""

    height: float
    seconds: float

    @property
    def peak(self) -> float:
        """Its height."""
        return abs(self.height)

    def at(self, seconds: float) -> float:
        """Return 0 or the height."""
        return self.height if LEAD_S <= seconds < self.seconds else 0.0


@dataclass(frozen=True, slots=True)
class Chirp:
    """A sine of `amplitude` around `bias`; its frequency rises from `low` to `high` Hz by equal factors in equal times.

    The bias keeps a motor turning one way, so that friction does not change its sign (Coulomb friction is no linear
    system). Frequencies are above 0.
    """

    amplitude: float
    bias: float
    low: float
    high: float
    seconds: float

    @property
    def peak(self) -> float:
        """The bias and the amplitude on top."""
        return abs(self.bias) + abs(self.amplitude)

    def at(self, seconds: float) -> float:
        """Return the value at a time."""
        span = self.seconds - 2.0 * RAMP_S
        rate = math.log(self.high / self.low) / span
        since = min(max(seconds - RAMP_S, 0.0), span)
        phase = math.tau * self.low * (math.expm1(rate * since) / rate if rate else since)
        return _envelope(seconds, self.seconds) * (self.bias + self.amplitude * math.sin(phase))


@dataclass(frozen=True, slots=True)
class Prbs:
    """`bias` plus or minus `amplitude`, as a shift register of `bits` says, each bit for `hold` seconds."""

    amplitude: float
    hold: float
    seconds: float
    bits: int = 9
    bias: float = 0.0
    _sequence: tuple[int, ...] = field(init=False, repr=False, default=())

    def __post_init__(self) -> None:
        object.__setattr__(self, "_sequence", _maximum_length(self.bits))

    @property
    def peak(self) -> float:
        """The bias and the amplitude on top."""
        return abs(self.bias) + abs(self.amplitude)

    def at(self, seconds: float) -> float:
        """Return the value at a time."""
        if not 0.0 <= seconds < self.seconds:
            return 0.0
        bit = self._sequence[int(seconds / self.hold) % len(self._sequence)]
        return _envelope(seconds, self.seconds) * (self.bias + self.amplitude * bit)


def _envelope(seconds: float, length: float) -> float:
    """Return how far a signal is faded in, from 0 to 1."""
    return max(0.0, min(1.0, seconds / RAMP_S, (length - seconds) / RAMP_S))


def _maximum_length(bits: int) -> tuple[int, ...]:
    """Return the sequence of a shift register that begins with ones, as 1 and -1."""
    register, found = [1] * bits, []
    for _ in range((1 << bits) - 1):
        found.append(1 if register[-1] else -1)
        fed = 0
        for tap in _TAPS[bits]:
            fed ^= register[tap - 1]
        register = [fed, *register[:-1]]
    return tuple(found)
