"""An active controller's place in the cycle: when it is due, what it moves, and whether that follows.

The law of the file (ros2_control jazzy): who runs slower than the cycle runs in the one nearest to its period. Ours,
and safer: a command is forgotten in the cycle in which what it moves is no longer enabled.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.controllers.base import Controller
    from canopen_control.hardware.interfaces import CommandInterface

__all__ = ["NOT_DUE", "Ends", "Part", "Rate", "Slot"]

NS: Final = 1_000_000_000
NOT_DUE: Final = -1.0
_NEVER: Final = -1

Ends = tuple["CommandInterface", ...]


class Rate:
    """Divides cycles: `hz` steps in a second, 0 for one in every cycle."""

    __slots__ = ("hz", "last")

    def __init__(self, hz: int) -> None:
        self.hz, self.last = hz, _NEVER

    def step(self, now: int, period: float) -> float:
        """Return the time since the last step in s if this cycle is nearer to the next one than the cycle after it.

        NOT_DUE else. `now` in ns, `period` of the cycles in s.
        """
        if not self.hz:
            return period
        if self.last == _NEVER:
            self.last = now - NS // self.hz
        elapsed = (now - self.last) / NS
        if abs(elapsed * self.hz - 1.0) > abs((elapsed + period) * self.hz - 1.0):
            return NOT_DUE
        self.last = now
        return elapsed


class Part:
    """Interfaces of the hardware that follow commands together or not at all; `enabled` as of the last cycle."""

    __slots__ = ("enabled", "ends")

    def __init__(self, ends: Ends) -> None:
        self.ends = ends
        self.enabled = self.follows()

    def follows(self) -> bool:
        """Whether all follow commands now, but those that a user has set aside."""
        following = not self.ends
        for each in self.ends:
            if each.enabled:
                following = True
            elif not each.set_aside:
                return False
        return following


class Slot:
    """An active controller, its rate, and the parts of the hardware that it moves, by others too."""

    __slots__ = ("controller", "parts", "rate")

    def __init__(self, controller: Controller, hz: int, parts: Sequence[Ends]) -> None:
        self.controller, self.rate = controller, Rate(hz)
        self.parts = [Part(each) for each in parts]

    @property
    def only_tells(self) -> bool:
        """Whether it runs once the commands of the cycle are on their way."""
        return self.controller.is_broadcaster and not self.controller.commands

    @property
    def follows(self) -> bool:
        """Whether a part of what it moves follows commands as a whole, or it moves nothing."""
        return not self.parts or any(part.follows() for part in self.parts)

    @property
    def disabled(self) -> list[CommandInterface]:
        """Those of what it moves that follow no commands."""
        return [each for part in self.parts for each in part.ends if not each.enabled]

    def take_over(self, before: Slot, were_enabled: set[CommandInterface]) -> None:
        """Go on where it was before others were switched: with its rhythm, and what was enabled in the last cycle."""
        self.rate.last = before.rate.last
        for part in self.parts:
            part.enabled = part.enabled or were_enabled.issuperset(part.ends)

    def forget(self, now: int, some: Ends | None = None, why: str = "") -> None:
        """Have its command forgotten, or that of some interfaces; `why` is a clause."""
        if some is not None:
            self.controller.forget_some(some, now)
            return
        self.controller.life.end(why)
        self.controller.forget(now)
