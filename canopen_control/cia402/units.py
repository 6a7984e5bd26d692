"""Device units and SI units: scales, and position counts without the 32-bit wrap-around.

SI positions are in radians (or metres), velocities in these units per second; device values are the integers of 0x607A,
0x60FF, 0x6064 and 0x606C, with `_dev` or `raw` in their names. Values for the device are rounded to nearest, never
truncated, since truncation would turn a small target into standstill; a value that does not fit its object is not a
target. The drive's position counter has 32 bits: differences are taken modulo 2**32, and a step that no motor can make
is a jump (a reset encoder, a restarted drive), which is counted and does not change the position.
"""

from __future__ import annotations

import math
from typing import Final

from canopen_control.errors import ConfigError

INT16_MIN, INT16_MAX = -(1 << 15), (1 << 15) - 1
INT32_MIN, INT32_MAX = -(1 << 31), (1 << 31) - 1
_SPAN: Final = 1 << 32
_HALF: Final = 1 << 31
_TURN: Final = 2.0 * math.pi
_RPM: Final = 0xB447  # numerator and denominator, bits 8 to 23: revolutions per minute


def to_object(raw: float, low: int, high: int) -> int | None:
    """Round a scaled value to an integer; None for nan and for values outside `low` to `high`."""
    return round(raw) if low <= raw <= high else None


def wrap_int32(value: int) -> int:
    """Wrap an integer to the range of int32 (modulo 2**32)."""
    return value if -_HALF <= value < _HALF else (value + _HALF) % _SPAN - _HALF


def counts_per_revolution(
    encoder_resolution: tuple[int, int],
    gear_ratio: tuple[int, int] = (1, 1),
    feed_constant: tuple[int, int] | None = None,
) -> float:
    """Return the position units per shaft revolution from 0x608F, 0x6091 and 0x6092.

    Each pair is (subindex 1, subindex 2): increments and motor revolutions, motor and shaft revolutions, feed and shaft
    revolutions. A feed constant defines the user unit, and the other two are then only conversions inside the drive.
    Raise ConfigError for a value that is not positive.
    """
    pairs = (encoder_resolution, gear_ratio) if feed_constant is None else (feed_constant,)
    if not all(part > 0 for pair in pairs for part in pair):
        raise ConfigError(
            f"0x608F {encoder_resolution}, 0x6091 {gear_ratio}, 0x6092 {feed_constant}: all values must be above 0"
        )
    return math.prod(numerator / denominator for numerator, denominator in pairs)


def is_feed(feed_constant: tuple[int, int]) -> bool:
    """Whether 0x6092 defines a user unit; n/n is the default of drives whose unit is the count.

    According to CiA 402-2 the unit would be a whole revolution in this case, which is useless for positioning.
    """
    return feed_constant[0] != feed_constant[1]


def counts_of_objects(
    encoder_resolution: tuple[int, int] | None,
    gear_ratio: tuple[int, int] | None = None,
    feed_constant: tuple[int, int] | None = None,
) -> float | None:
    """Return the position units per shaft revolution, or None if the objects do not define a value.

    They are not defined if the objects are absent or 0, or if encoder resolution and feed constant are both n/n, as in
    devices before commissioning.
    """
    feed = feed_constant if feed_constant is not None and is_feed(feed_constant) else None
    encoder = encoder_resolution if encoder_resolution is not None and is_feed(encoder_resolution) else None
    if encoder is None and feed is None:
        return None
    try:
        return counts_per_revolution(encoder or (1, 1), gear_ratio or (1, 1), feed)
    except ConfigError:
        return None


def rpm_of_unit(unit: int) -> float:
    """Return the velocity unit in 0x60A9 in rpm (CiA 303-2); 0 if the unit is not revolutions per minute."""
    exponent = (unit >> 24 & 0xFF ^ 0x80) - 0x80  # power of ten, in two's complement
    return 10.0**exponent if unit >> 8 & 0xFFFF == _RPM else 0.0


class Scale:
    """Conversion between SI and device units of one joint, by the factors `*_to_dev` and `*_from_dev`.

    `offset_pos_to_dev` is in device units, `offset_pos_from_dev` in SI units, like the keys of these names in bus.yml.
    A reversed joint has negative scales. Raises ConfigError for a scale that is zero, or a value that is not finite.
    """

    __slots__ = (
        "eff_from_dev",
        "eff_to_dev",
        "offset_pos_from_dev",
        "offset_pos_to_dev",
        "pos_from_dev",
        "pos_to_dev",
        "vel_from_dev",
        "vel_to_dev",
    )

    def __init__(
        self,
        pos_to_dev: float = 1000.0,
        pos_from_dev: float = 0.001,
        vel_to_dev: float = 1000.0,
        vel_from_dev: float = 0.001,
        eff_from_dev: float = 0.001,
        offset_pos_to_dev: float = 0.0,
        offset_pos_from_dev: float = 0.0,
        eff_to_dev: float = 1.0,
    ) -> None:
        self.pos_to_dev, self.pos_from_dev = float(pos_to_dev), float(pos_from_dev)
        self.vel_to_dev, self.vel_from_dev = float(vel_to_dev), float(vel_from_dev)
        self.eff_to_dev, self.eff_from_dev = float(eff_to_dev), float(eff_from_dev)
        self.offset_pos_to_dev, self.offset_pos_from_dev = float(offset_pos_to_dev), float(offset_pos_from_dev)
        self._check()

    def _check(self) -> None:
        for name in ("pos_to_dev", "pos_from_dev", "vel_to_dev", "vel_from_dev", "eff_to_dev", "eff_from_dev"):
            value = getattr(self, name)
            if not math.isfinite(value) or value == 0.0:
                raise ConfigError(f"scale_{name} is {value:g}: a scale must be finite and not 0")
        if not math.isfinite(self.offset_pos_to_dev) or not math.isfinite(self.offset_pos_from_dev):
            raise ConfigError("offset_pos_to_dev and offset_pos_from_dev must be finite")

    @property
    def has_own_velocity_unit(self) -> bool:
        """Whether velocities have another unit than position units per s; the unit of ramps is then unknown."""
        return not math.isclose(abs(self.pos_to_dev), abs(self.vel_to_dev), rel_tol=0.01)

    @classmethod
    def from_units(
        cls,
        counts_per_revolution: float,
        gear_ratio: float = 1.0,
        reversed: bool = False,  # noqa: A002 - the name of the bus.yml key
        eff_from_dev: float = 0.001,
        eff_to_dev: float = 1.0,
    ) -> Scale:
        """Return the scales of a rotary joint; `gear_ratio` is motor revolutions per joint revolution."""
        counts = counts_per_revolution * gear_ratio * (-1.0 if reversed else 1.0)
        if not math.isfinite(counts) or counts == 0.0:
            raise ConfigError(
                f"counts_per_revolution {counts_per_revolution:g} and gear_ratio {gear_ratio:g}: neither may be 0"
            )
        to_dev = counts / _TURN
        return cls(to_dev, 1.0 / to_dev, to_dev, 1.0 / to_dev, eff_from_dev, eff_to_dev=eff_to_dev)

    def position_count(self, position: float) -> int:
        """Return the unwrapped count of a finite position; see `PositionUnwrapper.raw_of` for the int32."""
        return round(position * self.pos_to_dev + self.offset_pos_to_dev)

    def velocity_from_device(self, raw: int) -> float:
        return raw * self.vel_from_dev

    def effort_from_device(self, raw: int) -> float:
        return raw * self.eff_from_dev


class PositionUnwrapper:
    """Conversion of a stream of int32 positions into a continuous count.

    `span` is the number of counts after which the drive's position wraps: 2**32, or the range in its 0x607B.
    `max_step` is the largest step in counts that the motor can make between two updates; None accepts every step. It
    may be changed at any time, for instance to grow with the age of the last sample. A larger step is a jump: `jumps`
    counts jumps, `last_jump` is the size of the last one, and the count does not change. After a jump the reference is
    lost, so that a client that needs absolute positions must home again.
    """

    __slots__ = ("_half", "_pending", "_raw", "count", "jumps", "last_jump", "max_step", "offset", "span")

    def __init__(self, max_step: int | None = None, span: int = _SPAN) -> None:
        self.max_step = max_step
        self.set_span(span)
        self.count = 0
        self.offset = 0  # count minus raw: whole turns of the counter, and removed jumps
        self.jumps = 0
        self.last_jump = 0
        self._raw: int | None = None
        self._pending = False

    def set_span(self, span: int) -> None:
        """Set the number of counts after which the position wraps."""
        self.span, self._half = span, span // 2

    @property
    def started(self) -> bool:
        return self._raw is not None

    def update(self, raw: int) -> int:
        """Return the continuous count for the next value of 0x6064."""
        last, most, half = self._raw, self.max_step, self._half
        if last is None:
            self._raw = self.count = raw
            return raw
        step = raw - last
        if most is not None and most < half and -most <= step <= most and not self._pending:
            self._raw = raw  # the usual case: no jump and no wrap-around
            self.count += step
            return self.count
        if not step and not self._pending:
            return self.count
        self._raw = raw
        if not -half <= step < half:
            step = (step + half) % self.span - half
        if self._pending:
            self._pending = False
            self.offset = self.count - raw
        elif most is not None and not -most <= step <= most:
            self.jumps += 1
            self.last_jump = step
            self.offset = self.count - raw
        else:
            self.count += step
            self.offset = self.count - raw
        return self.count

    def discount(self, step: int) -> None:
        """Remove the last step from the count, like a jump."""
        self.count -= step
        self.offset -= step

    def rebase(self) -> None:
        """Treat the next position as equal to the last position, because the drive has restarted."""
        self._pending = self._raw is not None

    def raw_of(self, count: int) -> int:
        """Return the int32 target for a continuous count, without the accumulated turns."""
        return wrap_int32(count - self.offset)
