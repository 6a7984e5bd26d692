"""The sliders of position targets: what nobody has set is where the joint is, and a held button does not move it.

The law of this file: a slider that somebody sets keeps his target until the drive that follows has ended; all others
follow their joints, whoever moves those. While somebody drives, a joint that was not set stays where it was at first.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    import viser

__all__ = ["TargetSliders"]

_DRIVEN_S: Final = 0.5  # without a word of a held button the drive has ended
_SHOWN_S: Final = 0.2  # between two looks at the joints


class TargetSliders:
    """`sliders` are viser's, by joint; `clock` gives seconds. Positions in rad or m, None where nobody knows."""

    def __init__(
        self, sliders: Mapping[str, viser.GuiSliderHandle[float]], clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._sliders, self._clock = sliders, clock
        self._set: set[str] = set()
        self._rest: dict[str, float] = {}
        self._held_at: float | None = None
        self._shown_at = clock() - _SHOWN_S
        for joint, slider in sliders.items():
            self._watch(joint, slider)

    def _watch(self, joint: str, slider: viser.GuiSliderHandle[float]) -> None:
        @slider.on_update
        def _(event: viser.GuiEvent[Any]) -> None:
            if event.client is not None:  # a page did it, not `follow`
                self._set.add(joint)

    def follow(self, positions: Mapping[str, float | None]) -> None:
        """Show where the joints are that nobody has set, unless somebody drives."""
        now = self._clock()
        if self._driven(now) or now - self._shown_at < _SHOWN_S:
            return
        self._shown_at = now
        if self._held_at is not None:
            self._held_at = None
            self._set.clear()
        for joint, slider in self._sliders.items():
            at = positions.get(joint)
            if at is None or joint in self._set:
                continue
            shown = min(max(at, slider.min), slider.max)
            if abs(shown - slider.value) >= slider.step / 2:
                slider.value = shown  # type: ignore[misc] # viser's setter is hidden from type checkers

    def targets(self, positions: Mapping[str, float | None]) -> list[float]:
        """Return what a held button sends, by the order of the sliders."""
        now = self._clock()
        if not self._driven(now):
            self._rest = {joint: at for joint, at in positions.items() if at is not None}
        self._held_at = now
        return [
            float(slider.value if joint in self._set else self._rest.get(joint, slider.value))
            for joint, slider in self._sliders.items()
        ]

    def rest(self, positions: Mapping[str, float | None]) -> list[float]:
        """Return what ends the drive: where the joints are, as far as that is known."""
        found = {**{joint: slider.value for joint, slider in self._sliders.items()}, **self._rest}
        found |= {joint: at for joint, at in positions.items() if at is not None}
        return [found[joint] for joint in self._sliders]

    def _driven(self, now: float) -> bool:
        return self._held_at is not None and now - self._held_at < _DRIVEN_S
