"""Objects of one axis, and its user units in counts of the plant (CiA 402-2, 6.3, 7).

Without a feed constant (0x6092), or with one of 1/1, the user's unit is the count; with another
counts = user * encoder resolution (0x608F) * gear ratio (0x6091) / feed constant, as each of them is there. 0x6096 and
0x6097 scale velocities and accelerations on top, whose unit is rpm where 0x60A9 says so. Bits 7 and 6 of 0x607E turn
positions and velocities round. A zero is taken for one: no object may divide by it. Positions inside are the plant's;
the user's are smaller by `zero`, which homing moves.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.cia402 import objects as o
from canopen_control.cia402.units import is_feed, rpm_of_unit

if TYPE_CHECKING:
    from canopen_control.od.model import Value
    from canopen_control.virtual.device_model import DeviceModel
    from canopen_control.virtual.object_store import VirtualStore


# What bounds the motion of an axis: software limits, limit switches, velocities, torques, the following error.
#
# A limit is reported once, when the motion ends at it (bit 11, and an EMCY where the device has one for it), and
# forgotten with the next demand that leads away. The software limits 0x607D count when the lower one is the lower one;
# a pair at the ends of its type is no limit.


UNIT_OBJECTS = (
    o.POLARITY,
    o.POSITION_ENCODER_RESOLUTION,
    o.GEAR_RATIO,
    o.FEED_CONSTANT,
    o.VELOCITY_FACTOR,
    o.ACCELERATION_FACTOR,
    o.SI_UNIT_VELOCITY,
)
_TURN_POSITION, _TURN_VELOCITY = 1 << 7, 1 << 6


def wrap32(value: float) -> int:
    """Return `value`, rounded, as a 32-bit counter."""
    return (round(value) + 0x80000000 & 0xFFFFFFFF) - 0x80000000


class DriveUnits:
    """Counts per user unit: `position` and `velocity` with sign, `length`, `speed`, `acceleration` without.

    `turn` is 1 or -1 for velocities in another unit (rpm), `zero` the plant's position of the user's 0.
    """

    def __init__(self) -> None:
        self.position = self.velocity = self.length = self.speed = self.acceleration = self.turn = 1.0
        self.zero = 0.0
        self.own_speed = 1.0  # of a velocity unit that no object names

    def update(self, objects: AxisObjects) -> None:
        """Update the factors from the objects."""
        polarity = objects.number(o.POLARITY)
        self.length = 1.0
        feed = objects.number(o.FEED_CONSTANT, 1, 1) or 1, objects.number(o.FEED_CONSTANT, 2, 1) or 1
        if is_feed(feed):
            resolution, gear = objects.ratio(o.POSITION_ENCODER_RESOLUTION), objects.ratio(o.GEAR_RATIO)
            self.length = resolution * gear / objects.ratio(o.FEED_CONSTANT)
        factor = objects.ratio(o.VELOCITY_FACTOR)
        own = self.own_speed if not objects.speed_unit and factor == 1.0 else 1.0
        per_second = (objects.speed_unit or self.length) * own
        self.speed = per_second / factor
        self.acceleration = per_second / objects.ratio(o.ACCELERATION_FACTOR)
        self.turn = -1.0 if polarity & _TURN_VELOCITY else 1.0
        self.position = -self.length if polarity & _TURN_POSITION else self.length
        self.velocity = self.turn * self.speed

    def user(self, place: float) -> int:
        """Return the user's position of a position of the plant."""
        return wrap32((place - self.zero) / self.position)

    def lose_counts(self, counts: float) -> None:
        """Shift the encoder's position by `counts` (a fault)."""
        self.zero -= counts


class AxisObjects:
    """Objects of axis `axis` in `store`; indices are given as those of axis 0."""

    def __init__(self, store: VirtualStore, axis: int, model: DeviceModel) -> None:
        self.axis, self.store, self.model = axis, store, model
        self.offset = o.axis_index(o.CONTROLWORD, axis) - o.CONTROLWORD
        self.units = DriveUnits()
        self._values = store.values

    def number(self, index: int, subindex: int = 0, default: int = 0) -> int:
        """Return an integer, `default` if the object is missing or of another type."""
        value = self._values.get((index + self.offset, subindex), default)
        return value if isinstance(value, int) else default

    def has(self, index: int, subindex: int = 0) -> bool:
        """Return whether the axis has an object."""
        return (index + self.offset, subindex) in self._values

    def set(self, index: int, value: Value) -> None:
        """Set an object without any check, like the device's firmware; no-op if it is missing."""
        self.store.set(index + self.offset, 0, value)

    def ramp(self, index: int) -> float:
        """Return an acceleration object in counts/s^2; the device model replaces a missing or zero value."""
        return self.number(index) * self.units.acceleration or self.model.unset_ramp

    def speed(self, index: int, subindex: int = 0) -> float:
        """Return an object with a speed without direction, in counts/s."""
        return self.number(index, subindex) * self.units.speed

    def length(self, index: int) -> float:
        """Return an object with a distance without direction, in counts."""
        return self.number(index) * self.units.length

    def ratio(self, index: int) -> float:
        """Return subindex 1 divided by subindex 2; each is 1 if it is missing or 0."""
        return float(self.number(index, 1, 1) or 1) / float(self.number(index, 2, 1) or 1)

    @property
    def counts_per_rpm(self) -> float:
        """Counts per second of one revolution per minute."""
        counts = self.number(o.POSITION_ENCODER_RESOLUTION, 1) or self.model.counts_per_revolution
        return counts / max(1, self.number(o.POSITION_ENCODER_RESOLUTION, 2, 1)) / 60.0

    @property
    def speed_unit(self) -> float:
        """Counts per second of the velocity unit in 0x60A9, 0 if it is counts."""
        return self.counts_per_rpm * rpm_of_unit(self.number(o.SI_UNIT_VELOCITY))

    @property
    def interpolation_s(self) -> float:
        """Value of 0x60C2 in s: the time between two set-points of a cyclic mode."""
        exponent = max(-9, min(1, self.number(o.INTERPOLATION_TIME_PERIOD, 2, -3)))
        return float(self.number(o.INTERPOLATION_TIME_PERIOD, 1, 1) * 10.0**exponent)
