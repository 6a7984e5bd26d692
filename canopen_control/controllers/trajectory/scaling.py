"""Speed scaling: how fast the time of trajectories runs, told by a user or by a state interface.

The law of the file (ros2_controllers jazzy): what a user says goes to the command interface too, what a state interface
says counts. Ours, and safer: time stands while nobody knows how fast it runs.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from canopen_control.hardware.interfaces import CommandInterface, StateInterface

__all__ = ["SpeedScaling", "scaled"]


def scaled(time: int, factor: float) -> int:
    """Return a time in ns at a speed, cut to whole ns: 10 ms at 0.3 are 2,999,999 ns, since 0.3 is a bit less.

    The product is exact, as upstream's is in extended precision: rounded to a double it would be 1 ns more.
    """
    if factor == 1.0:
        return time
    numerator, denominator = factor.as_integer_ratio()
    return time * numerator // denominator


class SpeedScaling:
    """`factor` of the time of trajectories: 1 is their own speed, 0 lets it stand.

    `allowed` says that users may set it: where positions alone are commanded, since the velocities of a trajectory that
    runs slower would have to be scaled too.
    """

    def __init__(self, factor: float = 1.0, *, allowed: bool = False) -> None:
        self.allowed = allowed
        self.factor = self._wanted = factor if allowed else 1.0
        self._state: StateInterface | None = None
        self._command: CommandInterface | None = None

    def take(self, state: StateInterface | None, command: CommandInterface | None) -> None:
        """Take the interfaces, where there are some."""
        self._state, self._command = state, command

    def mistake(self, factor: float) -> str | None:
        """Say why a factor cannot be set, None if it can."""
        if not self.allowed:
            return "cannot scale its speed: it commands more than positions"
        return None if 0.0 <= factor < math.inf else f"cannot scale its speed by {factor:g}; give 0 or more"

    def set(self, factor: float) -> None:
        """Run at a factor from the next cycle on."""
        self._wanted = self.factor = factor

    def update(self) -> None:
        """Read and write the interfaces, in the cycle."""
        if self._state is not None:
            factor = self._state.value
            self.factor = factor if 0.0 <= factor < math.inf else 0.0
        if self._command is not None:
            self._command.value = self._wanted
