"""User units of one axis: what an object's number is in counts of the plant (CiA 402-2, 6.3 and 7).

The law of this file: without a feed constant (0x6092) the user's unit is the count; with it
counts = user * encoder resolution (0x608F) * gear ratio (0x6091) / feed constant, as each of them is there. 0x6096 and
0x6097 scale velocities and accelerations on top. Bits 7 and 6 of 0x607E turn positions and velocities round. A zero is
taken for one: no object may divide by it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.cia402 import objects as o

if TYPE_CHECKING:
    from canopen_control.virtual.drive import VirtualDrive

__all__ = ["SOURCES_OF_UNITS", "AxisUnits"]

SOURCES_OF_UNITS = (
    o.POLARITY,
    o.POSITION_ENCODER_RESOLUTION,
    o.GEAR_RATIO,
    o.FEED_CONSTANT,
    o.VELOCITY_FACTOR,
    o.ACCELERATION_FACTOR,
)
_TURN_POSITION, _TURN_VELOCITY = 1 << 7, 1 << 6


class AxisUnits:
    """Counts for each user unit: `position` and `velocity` with their sign, `length`, `speed`, `acceleration` without.

    `turn` is 1 or -1 for velocities whose unit is another one (rpm).
    """

    def __init__(self) -> None:
        self.position = self.velocity = self.length = self.speed = self.acceleration = self.turn = 1.0

    def update(self, drive: VirtualDrive) -> None:
        """Take the objects as they are now."""
        polarity = drive.number(o.POLARITY)
        self.length = 1.0
        if drive.has(o.FEED_CONSTANT, 1):
            resolution, gear = _ratio(drive, o.POSITION_ENCODER_RESOLUTION), _ratio(drive, o.GEAR_RATIO)
            self.length = resolution * gear / _ratio(drive, o.FEED_CONSTANT)
        self.speed = self.length / _ratio(drive, o.VELOCITY_FACTOR)
        self.acceleration = self.length / _ratio(drive, o.ACCELERATION_FACTOR)
        self.turn = -1.0 if polarity & _TURN_VELOCITY else 1.0
        self.position = -self.length if polarity & _TURN_POSITION else self.length
        self.velocity = self.turn * self.speed


def _ratio(drive: VirtualDrive, index: int) -> float:
    return float(drive.number(index, 1, 1) or 1) / float(drive.number(index, 2, 1) or 1)
