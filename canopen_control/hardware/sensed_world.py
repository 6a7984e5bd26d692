"""State interfaces of <sensor> tags that no device measures but the world of virtual drives with physics.

The drives move the robot in a world of their own process, which tells what its sensors measure when it is asked. A
value that is older than half a second, as after the drives have died, is nan, as every state that is not known.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from canopen_control.hardware.interfaces import OK, ReturnType, StateInterface
from canopen_control.hardware.lifecycle import Lifecycle

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from canopen_control.hardware.interfaces import CommandInterface
    from canopen_control.urdf.ros2_control import ControlJoint

__all__ = ["SensedWorld"]

_AGE_NS: Final = 500_000_000


class SensedWorld(Lifecycle):
    """The sensors of one tag, told by `take`; it commands nothing."""

    def __init__(self, name: str, parts: Iterable[ControlJoint]) -> None:
        super().__init__()
        self.name = name
        self._states = [StateInterface(part.name, each) for part in parts for each in part.state_interfaces]
        self.state_interfaces: Sequence[StateInterface] = self._states
        self.command_interfaces: Sequence[CommandInterface] = []
        self._taken = False  # since the last cycle
        self._last = 0
        self._known = False

    def take(self, values: Mapping[str, float]) -> None:
        """Take what was measured, by the names of interfaces such as "imu/orientation.x"."""
        for state in self._states:
            state.value = values.get(state.name, math.nan)
        self._taken = self._known = True

    def _begin(self) -> None:
        """Nothing to do: the world tells by itself."""

    def _rest(self) -> None:
        """Nothing to stop."""

    def prepare_command_mode_switch(self, start: Sequence[str], stop: Sequence[str]) -> None:
        """Do nothing: there is nothing to command."""

    def perform_command_mode_switch(self, start: Sequence[str], stop: Sequence[str]) -> None:
        """Do nothing, as above."""

    def read(self, now: int, period: float) -> ReturnType:  # noqa: ARG002 - the verb of every component
        """Forget what is too old."""
        if self._taken:
            self._last, self._taken = now, False
        elif self._known and now - self._last > _AGE_NS:
            self._known = False
            for state in self._states:
                state.value = math.nan
        return OK

    def write(self, now: int, period: float) -> ReturnType:  # noqa: ARG002 - as above
        """Do nothing: there is nothing to command."""
        return OK
