"""Faults of a virtual device's inputs: stuck at what they show, noisy, or off by a sudden jump.

A stuck input goes on to show the value it had; noise is up to 2 % of the full scale and changes every 20 ms, each time
by the same course; a jump adds a quarter of the full scale, which of an encoder is a turn. Lines that are bits can only
be stuck.
"""

from __future__ import annotations

from typing import Final

from canopen_control.errors import ConfigError

__all__ = ["JUMP", "KINDS", "NOISE", "InputFaults"]

KINDS: Final = ("stuck", "noise", "jump")
NOISE: Final = 0.02  # of the full scale
JUMP: Final = 0.25
_NOISE_NS: Final = 20_000_000
_STEPS: Final = 101  # of the course of the noise, which is the same each time


class InputFaults:
    """Which faults of the inputs are on, and what they make of a value."""

    def __init__(self) -> None:
        self._on: set[str] = set()
        self._frozen: dict[str, float] = {}
        self._noise_at = 0
        self._step = 0

    def switch(self, kind: str, *, on: bool, now: int) -> None:
        """Switch a fault; ConfigError for one that there is not."""
        if kind not in KINDS:
            raise ConfigError(f"no fault of inputs {kind!r}; there are: {', '.join(KINDS)}")
        if on:
            self._on.add(kind)
        else:
            self._on.discard(kind)
        self._frozen.clear()
        self._noise_at = now + _NOISE_NS

    def line(self, name: str, value: float) -> float:
        """Return what a line shows that is `value` outside."""
        return value if "stuck" not in self._on else self._frozen.setdefault(name, value)

    def value(self, name: str, value: float, full_scale: float, now: int) -> float:
        """Return what an input shows that is `value` outside."""
        del now
        if "stuck" in self._on:
            value = self._frozen.setdefault(name, value)
        if "jump" in self._on:
            value += JUMP * full_scale
        if "noise" in self._on:
            course = (self._step * 37 % _STEPS) / (_STEPS - 1) * 2.0 - 1.0
            value += NOISE * full_scale * course
        return value

    def due(self, now: int) -> bool:
        """Whether the noise has gone on."""
        if "noise" not in self._on or now < self._noise_at:
            return False
        self._step += 1
        self._noise_at = now + _NOISE_NS
        return True

    def next_deadline(self) -> int | None:
        """Return when `due` says so next."""
        return self._noise_at if "noise" in self._on else None
