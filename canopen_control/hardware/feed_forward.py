"""Feed-forward of velocity (0x60B1) and torque (0x60B2) in addition to the positions of CSP (CiA 402-2).

The offsets are what the controller of the position gives beside it, in the units of 0x60FF and
0x6071, within the drive's limits; the drive adds them to its velocity and torque loop and never to the position. They
are zero whenever they do not belong to a position that leads on: at rest, in a stop, in another mode, when another
controller gives them, and when the positions stand for longer than three cycles and 50 ms, since a stream that broke
would else push against the position loop.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from canopen_control.cia402.units import INT16_MAX, INT16_MIN, INT32_MAX, INT32_MIN, to_object
from canopen_control.urdf.joint_element import EFFORT, POSITION, VELOCITY

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

    from canopen_control.hardware.axis import AxisProcessData
    from canopen_control.hardware.interfaces import CommandInterface


FEED_FORWARD: Final = (VELOCITY, EFFORT)
"""The command interfaces that a position can have beside it."""
_BROKEN_S: Final = 0.05
_BROKEN_CYCLES: Final = 3.5


class FeedForward:
    """Offsets of one axis; `fed` means that a controller commands any."""

    def __init__(self, axis: AxisProcessData, commands: Mapping[str, CommandInterface]) -> None:
        self.fed = False
        self._foreign, self._told = "", ""
        self._axis, self._commands = axis, commands
        self._outputs = {VELOCITY: axis.velocity_offset, EFFORT: axis.torque_offset}
        self._velocity: CommandInterface | None = None
        self._effort: CommandInterface | None = None
        self._last = math.nan
        self._standing_s = 0.0

    def carries(self, interface: str) -> bool:
        """Whether an RPDO contains the offset of a command interface."""
        return self._outputs.get(interface) is not None

    def claim(self, interfaces: Collection[str]) -> None:
        """Use the offsets of these command interfaces from now on."""
        self._velocity = self._commands[VELOCITY] if VELOCITY in interfaces else None
        self._effort = self._commands[EFFORT] if EFFORT in interfaces else None
        self.fed = bool(interfaces)
        self._foreign = self._told = ""
        self.refresh()
        self.zero()

    def refresh(self) -> None:
        """Update the ranges of the offsets after a change of the scale."""
        scale = self._axis.scale
        if self._velocity is not None:
            _span(self._velocity, INT32_MAX / abs(scale.vel_to_dev))
        if self._effort is not None:
            _span(self._effort, INT16_MAX / abs(scale.eff_to_dev))

    def refused(self) -> str | None:
        """Return once the offset that is ignored because another controller commands it."""
        if self._foreign == self._told:
            return None
        self._told = interface = self._foreign
        position, other_owner = self._commands[POSITION].owner, self._commands[interface].owner
        return (
            f"its {interface} is commanded by {other_owner} and its position by {position}: that is no feed-forward, "
            f"and not sent; deactivate {other_owner}"
        )

    def zero(self) -> None:
        """Set the offsets to zero."""
        self._last, self._standing_s = math.nan, 0.0
        for output in self._outputs.values():
            if output is not None:
                output.set(0)

    def follow(self, position: CommandInterface, period: float) -> None:
        """Send the offsets of this cycle's position; `period` in s."""
        value = position.value
        if value != self._last:
            self._last, self._standing_s = value, 0.0
        else:
            self._standing_s += period
        broken = value != value or self._standing_s > max(_BROKEN_S, _BROKEN_CYCLES * period)
        axis = self._axis
        velocity, effort = self._velocity, self._effort
        if velocity is not None and axis.velocity_offset is not None:
            raw = 0 if broken else self._raw(position, velocity, axis.scale.vel_to_dev, INT32_MIN, INT32_MAX)
            axis.velocity_offset.set(axis.limits.of_velocity(raw))
        if effort is not None and axis.torque_offset is not None:
            raw = 0 if broken else self._raw(position, effort, axis.scale.eff_to_dev, INT16_MIN, INT16_MAX)
            axis.torque_offset.set(axis.limits.of_torque(raw))

    def _raw(self, position: CommandInterface, command: CommandInterface, factor: float, low: int, high: int) -> int:
        if command.owner != position.owner:
            self._foreign = command.interface
            return 0
        return to_object(command.value * factor, low, high) or 0


def _span(command: CommandInterface, most: float) -> None:
    command.lowest, command.highest, command.range = -most, most, None
