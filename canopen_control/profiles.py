"""Device profiles other than CiA 402: the profile of a device, and its signals in units (I/O, sensors, batteries).

The low word of 0x1000 is the number of the profile, but half of all files have 0 there, and some call a drive an I/O
module. A device with controlword and statusword is therefore a drive, and without a number in 0x1000 the objects
decide.

value = raw * factor * (scales read from the device) + offset, and the inverse for outputs; a bit is 0 or 1. The value
of an invalid raw number is nan.

Manufacturers do not share object names, so that a signal has the name of the profile (`di0`, `position`) or of bus.yml;
a device of CiA 454 has only names of bus.yml. ``0x6401:01`` and ``0x6000:01.3`` name any object, or a bit of it, with
the raw number as its value.
"""

from __future__ import annotations

import dataclasses
import enum
import math
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from canopen_control.od.codec import decode, encode
from canopen_control.od.indices import DEVICE_TYPE
from canopen_control.od.model import AXIS_STEP, DataType

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping

    from canopen_control.od.model import Address, Entry, ObjectDictionary, Value


_OBJECT: Final = re.compile(r"(?:0[xX])?([0-9A-Fa-f]{4})(?::(?:0[xX])?([0-9A-Fa-f]{1,2}))?(?:\.(\d{1,2}))?")

TYPES: Final = {
    "bool": DataType.BOOLEAN,
    **{f"u{bits}": DataType[f"UNSIGNED{bits}"] for bits in (8, 16, 24, 32, 64)},
    **{f"i{bits}": DataType[f"INTEGER{bits}"] for bits in (8, 16, 24, 32, 64)},
    "f32": DataType.REAL32,
    "f64": DataType.REAL64,
}
"""Names of the types that can replace the type of an object."""


@dataclass(frozen=True, slots=True)
class SignalScale:
    """Scale factor in an object of the device: `of` computes the factor; `assumed` is used if the object is missing.

    The object is read after the boot of the node and not taken from a file, because users and devices change it.
    """

    address: Address
    of: Callable[[int], float]
    assumed: int


@dataclass(frozen=True, slots=True)
class Signal:
    """Input or output of a device; its value is invalid while the number in the object `status` is not 0.

    `data_type` overrides the type of the object, None: as in the file. `invalid` contains raw numbers without a value.
    `unwrap` is the object with the range of a position: the value is then the continuous travel since the first value.
    `safe` is the value of an output without a master, None: unchanged. `max_rate` is the largest plausible rate of an
    input in units per second; a faster change is a jump.
    """

    name: str
    index: int
    subindex: int = 0
    output: bool = False
    bit: int | None = None
    factor: float = 1.0
    offset: float = 0.0
    unit: str = ""
    data_type: DataType | None = None
    invalid: tuple[float, ...] = ()
    status: Address | None = None
    scales: tuple[SignalScale, ...] = ()
    unwrap: Address | None = None
    safe: float | None = 0.0
    max_rate: float | None = None

    @property
    def address(self) -> Address:
        """Address of the object: the pair (index, subindex)."""
        return self.index, self.subindex

    @property
    def where(self) -> str:
        """Address of the object and bit, for messages."""
        return f"0x{self.index:04X}:{self.subindex:02X}" + ("" if self.bit is None else f".{self.bit}")

    @property
    def needs(self) -> tuple[Address, ...]:
        """Addresses of the objects whose values the conversion needs."""
        return (*(scale.address for scale in self.scales), *(() if self.unwrap is None else (self.unwrap,)))

    def gain(self, numbers: Mapping[Address, Value]) -> float:
        """Return the units per raw number; `numbers` are the values read from the objects in `needs`."""
        gain = self.factor
        for scale in self.scales:
            number = numbers.get(scale.address)
            gain *= scale.of(number if isinstance(number, int) else scale.assumed)
        return gain

    def value(self, raw: float, gain: float) -> float:
        """Return the value of a raw number; nan if the number is invalid."""
        if raw in self.invalid:
            return math.nan
        if self.bit is not None:
            return float(int(raw) >> self.bit & 1)
        return raw * gain + self.offset

    def raw(self, value: float, gain: float, *, whole: bool) -> float:
        """Return the raw number of a value; `whole` rounds it to an integer, for objects of integer types."""
        raw = (value - self.offset) / gain
        return round(raw) if whole else raw


def object_of(text: str) -> tuple[int, int, int | None] | None:
    """Return the index, subindex and bit of ``0x6401:01``, ``6000:1.3`` or ``0x6004``; None for other texts."""
    match = _OBJECT.fullmatch(text.strip())
    if match is None:
        return None
    bit = None if match[3] is None else int(match[3])
    return None if bit is not None and bit > 63 else (int(match[1], 16), int(match[2] or "0", 16), bit)


def retyped(value: Value, source: DataType, target: DataType) -> Value:
    """Return a value with its bits interpreted as another type; nan if the bits are invalid for the type."""
    try:
        return decode(encode(value, source), target)
    except ValueError:
        return math.nan


# -- units and prefixes as coded in objects (CiA 303-2): unit in bits 16 to 23, prefix as a power of ten in bits 24 to
# 31

_UNITS: Final = {
    0x01: "m",
    0x02: "kg",
    0x03: "s",
    0x04: "A",
    0x05: "K",
    0x10: "rad",
    0x20: "Hz",
    0x21: "N",
    0x22: "Pa",
    0x23: "J",
    0x24: "W",
    0x26: "V",
    0x28: "Ohm",
    0x2D: "degC",
}


def unit_of_code(code: int) -> str:
    """Return the name of a coded unit, such as "degC" for 0x002D0000, or "" if it is not in the table."""
    return _UNITS.get(code >> 16 & 0xFF, "")


def factor_of_prefix(code: int) -> float:
    """Return the factor of a coded prefix, such as 0.001 for 0xFD260000 (millivolt)."""
    power = code >> 24 & 0xFF
    return float(10.0 ** (power - 0x100 if power > 0x7F else power))


def factor_of_digits(digits: int) -> float:
    """Return the weight of the last of `digits` decimal digits; 1.0 for an invalid number."""
    return float(10.0**-digits) if 0 <= digits <= 9 else 1.0


_CONTROLWORD, _STATUSWORD, _AXES = 0x6040, 0x6041, 8


class Profile(enum.IntEnum):
    """Device profiles by the number of their CiA standard; NONE for an unknown profile."""

    NONE = 0
    IO = 401
    DRIVE = 402
    MEASURING = 404
    ENCODER = 406
    INCLINOMETER = 410
    BATTERY = 418
    CHARGER = 419
    ENERGY = 454

    @property
    def words(self) -> str:
        """Description of a device with this profile, for messages."""
        return _WORDS[self]


_WORDS: Final = {
    Profile.NONE: "device",
    Profile.IO: "I/O module (CiA 401)",
    Profile.DRIVE: "drive (CiA 402)",
    Profile.MEASURING: "measuring device (CiA 404)",
    Profile.ENCODER: "encoder (CiA 406)",
    Profile.INCLINOMETER: "inclinometer (CiA 410)",
    Profile.BATTERY: "battery (CiA 418)",
    Profile.CHARGER: "battery charger (CiA 419)",
    Profile.ENERGY: "energy management device (CiA 454)",
}

T = DataType
#: objects (index, subindex, type), all required -> the profile, if 0x1000 names none; the first that fits
_SIGNATURES: Final = (
    (((0x6060, 0, T.UNSIGNED32), (0x6081, 0, T.UNSIGNED8)), Profile.BATTERY),
    (((0x6001, 0, T.UNSIGNED32), (0x6004, 0, T.UNSIGNED32)), Profile.ENCODER),
    (((0x6000, 0, T.UNSIGNED16), (0x6010, 0, T.INTEGER16)), Profile.INCLINOMETER),
    (((0x6150, 1, T.UNSIGNED8), (0x7130, 1, T.INTEGER16)), Profile.MEASURING),
    (((0x6150, 1, T.UNSIGNED8), (0x9130, 1, T.INTEGER32)), Profile.MEASURING),
    (((0x6000, 1, T.UNSIGNED8),), Profile.IO),
    (((0x6200, 1, T.UNSIGNED8),), Profile.IO),
    (((0x6401, 1, T.INTEGER16),), Profile.IO),
    (((0x6411, 1, T.INTEGER16),), Profile.IO),
)


def profile_of(od: ObjectDictionary) -> Profile:
    """Return the profile of a device; NONE if neither 0x1000 nor its objects indicate a known one."""
    if any(
        (_CONTROLWORD + AXIS_STEP * axis, 0) in od and (_STATUSWORD + AXIS_STEP * axis, 0) in od
        for axis in range(_AXES)
    ):
        return Profile.DRIVE
    number = (od.number(DEVICE_TYPE) or 0) & 0xFFFF  # the number of the profile (CiA 301 7.5.2.1)
    if number:
        is_known = number in _WORDS and number != Profile.DRIVE
        return Profile(number) if is_known else Profile.NONE
    for objects, profile in _SIGNATURES:
        if all(
            (declared := od.get(index, subindex)) is not None and declared.data_type is kind
            for index, subindex, kind in objects
        ):
            return Profile.CHARGER if profile is Profile.BATTERY and _receives_charge(od) else profile
    return Profile.NONE


def _receives_charge(od: ObjectDictionary) -> bool:
    """Whether the state of charge is writable: a charger has the objects of a battery, but receives their values."""
    entry = od.get(0x6081)
    return entry is not None and entry.writable and entry.rpdo_mappable


# Sensors and chargers: measuring (CiA 404), encoders (406), inclinometers (410), batteries (418), chargers (419). The
# scale of a raw number (decimal digits, steps per turn, resolution) is read from the device. Angles are in rad, other
# values in the unit named.


_LINEAR: Final = (8, 9)  # high word of 0x1000 of a linear encoder (CiA 406)
_STEP_M: Final = 1e-9  # 0x6005:01 is in 0.001 um
_ANGLE_DEG: Final = 1e-3  # 0x6000 of an inclinometer is in 0.001 degrees


def _number(od: ObjectDictionary, index: int, subindex: int, default: int) -> int:
    number = od.number(index, subindex)
    return default if number is None else number


def measuring_signals(od: ObjectDictionary) -> Iterator[Signal]:
    """Yield the inputs ai0, ai1 ... with their states status0 ..., and the outputs ao0 ... of a CiA 404 device.

    The process values may exist as floats, with 16 and with 32 bits: those mapped into a TPDO are used, or else the
    first. An input is invalid unless its state is 0.
    """
    index = next((candidate for candidate in (0x7130, 0x9130, 0x6130, 0x8130) if _mapped(od, candidate)), None)
    index = index or next((candidate for candidate in (0x7130, 0x9130, 0x6130, 0x8130) if (candidate, 1) in od), None)
    for subindex in () if index is None else od.subindices(index):
        if 1 <= subindex < 0xFF:
            # CiA 404: bit 0 invalid, bit 1 positive overload, bit 2 negative overload
            status = (0x6150, subindex) if (0x6150, subindex) in od else None
            unit, scales = _unit(od, index or 0, subindex, 0x6131, 0x6132)
            yield Signal(f"ai{subindex - 1}", index or 0, subindex, unit=unit, status=status, scales=scales)
            if status is not None:
                yield Signal(f"status{subindex - 1}", *status)
    for subindex in od.subindices(0x7300):
        if 1 <= subindex < 0xFF:
            unit, scales = _unit(od, 0x7300, subindex, 0x6301, 0x6302)
            yield Signal(f"ao{subindex - 1}", 0x7300, subindex, output=True, unit=unit, scales=scales)


def _mapped(od: ObjectDictionary, index: int) -> bool:
    """Whether a TPDO maps the object by default."""
    return any(
        isinstance(entry.value, int) and entry.value >> 16 == index  # mapping entry, CiA 301 7.5.2.38
        for entry in od
        if 0x1A00 <= entry.index < 0x1C00 and entry.subindex
    )


def _unit(
    od: ObjectDictionary, index: int, subindex: int, code: int, digits: int
) -> tuple[str, tuple[SignalScale, ...]]:
    """Return the unit of a value, and the scales for its prefix and decimal digits."""
    scales = []
    if (code, subindex) in od:
        scales.append(SignalScale((code, subindex), factor_of_prefix, _number(od, code, subindex, 0)))
    entry = od.get(index, subindex)
    if (digits, subindex) in od and entry is not None and entry.data_type is not DataType.REAL32:
        scales.append(SignalScale((digits, subindex), factor_of_digits, _number(od, digits, subindex, 0)))
    return unit_of_code(_number(od, code, subindex, 0)), tuple(scales)


def _per_turn(steps: int) -> float:
    return math.tau / steps if steps > 0 else math.tau / 4096


def _per_step(thousandths: int) -> float:
    return thousandths * _STEP_M if thousandths > 0 else _STEP_M


def encoder_signals(od: ObjectDictionary) -> Iterator[Signal]:
    """Yield `position`, `position_absolute` and `speed` of a CiA 406 encoder.

    `position` is continuous; both positions are in rad, or in m for a linear encoder. `position_absolute` wraps at the
    total range (0x6002). The unit of `speed` is manufacturer-specific.
    """
    if _number(od, 0x1000, 0, 0) >> 16 & 0xFF in _LINEAR:
        unit, scale = "m", SignalScale((0x6005, 1), _per_step, _number(od, 0x6005, 1, 1000))
    else:
        unit, scale = "rad", SignalScale((0x6001, 0), _per_turn, _number(od, 0x6001, 0, 4096))
    scales = (scale,) if scale.address in od else ()
    plain = 1.0 if scales else scale.of(scale.assumed)
    if (0x6004, 0) in od:
        wraps = (0x6002, 0) if (0x6002, 0) in od else None  # CiA 406: the position wraps at the total range
        yield Signal("position", 0x6004, factor=plain, unit=unit, scales=scales, unwrap=wraps)
        yield Signal("position_absolute", 0x6004, factor=plain, unit=unit, scales=scales)
    elif (0x6020, 1) in od:
        yield Signal("position", 0x6020, 1, factor=plain, unit=unit, scales=scales)
    if (0x6030, 1) in od:
        yield Signal("speed", 0x6030, 1)


def _resolution(thousandths: int) -> float:
    return math.radians(thousandths * _ANGLE_DEG) if thousandths > 0 else math.radians(_ANGLE_DEG)


def inclinometer_signals(od: ObjectDictionary) -> Iterator[Signal]:
    """Yield `longitudinal` and `lateral` in rad of a CiA 410 inclinometer, from the 16-bit or the 32-bit objects."""
    scales = (SignalScale((0x6000, 0), _resolution, _number(od, 0x6000, 0, 10)),)
    for name, short, long in (("longitudinal", 0x6010, 0x6110), ("lateral", 0x6020, 0x6120)):
        index = next((candidate for candidate in (short, long) if _mapped(od, candidate)), None)
        index = index or next((candidate for candidate in (short, long) if (candidate, 0) in od), None)
        if index is not None:
            yield Signal(name, index, unit="rad", scales=scales)


_Table = tuple[tuple[str, int, int, float, str], ...]
_BATTERY: Final[_Table] = (
    ("battery_temperature", 0x6010, 0, 0.125, "degC"),
    ("battery_voltage", 0x6060, 0, 1 / 1024, "V"),
    ("battery_percentage", 0x6081, 0, 1.0, "%"),
    ("battery_status", 0x6000, 0, 1.0, ""),
    ("battery_charge_current", 0x6070, 0, 1 / 16, "A"),
    ("battery_capacity", 0x6020, 2, 1.0, "Ah"),
)
"""Name, index, subindex, units per raw number, and unit; the names are those of ros2_control's battery broadcaster."""


def battery_signals(od: ObjectDictionary) -> Iterator[Signal]:
    """Yield the signals of a CiA 418 battery; no object of the profile contains the current of the battery pack."""
    for signal, _entry in _signals_of(od, _BATTERY):
        yield signal


_CHARGER: Final[_Table] = (
    ("charger_status", 0x6001, 0, 1.0, ""),
    ("charger_percentage", 0x6080, 0, 1.0, "%"),
    ("charge_current_requested", 0x6070, 0, 1 / 16, "A"),
    ("battery_status", 0x6000, 0, 1.0, ""),
    ("battery_temperature", 0x6010, 0, 0.125, "degC"),
    ("battery_voltage", 0x6060, 0, 1 / 1024, "V"),
    ("battery_percentage", 0x6081, 0, 1.0, "%"),
)
"""Objects of a charger: measured values, and values of the battery (CiA 418) that it receives."""


def charger_signals(od: ObjectDictionary) -> Iterator[Signal]:
    """Yield the signals of a CiA 419 charger; values that it receives are outputs.

    A requested charge current persists in the charger.
    """
    for signal, entry in _signals_of(od, _CHARGER):
        yield dataclasses.replace(signal, output=entry.rpdo_mappable and entry.writable)


def _signals_of(od: ObjectDictionary, table: _Table) -> Iterator[tuple[Signal, Entry]]:
    """Yield the signals of a table for existing objects, each with the entry of its object."""
    for name, index, subindex, factor, unit in table:
        if (entry := od.get(index, subindex)) is not None:
            yield Signal(name, index, subindex, factor=factor, unit=unit), entry


# Generic I/O modules (CiA 401): digital and analogue inputs and outputs, named di0, do0, ai0, ao0, ... Lines are
# numbered from 0: bit 3 of 0x6000:02 is di11. The same lines may be grouped by 8, 16 or 32; the first group that a
# device has is used. Analogue values are raw numbers with a full scale of 32767 for 16 bits. No object contains the
# corresponding voltage, so `signals` of bus.yml gives a factor and a unit.


AI_ENABLE: Final = 0x6423  # analogue inputs are sent on events only if it is set (CiA 401)
AI_DELTA: Final = 0x6426
DIGITAL_INPUTS: Final = (0x6000, 0x6100, 0x6120)
ANALOGUE_INPUTS: Final = (0x6401, 0x6402, 0x6400, 0x6403)


@dataclass(frozen=True, slots=True)
class _Group:
    """Alternative objects for the same signals, in order of preference, each with its number of lines per subindex."""

    prefix: str
    output: bool
    objects: tuple[tuple[int, int | None], ...]


_GROUPS: Final = (
    _Group("di", output=False, objects=((0x6000, 8), (0x6100, 16), (0x6120, 32))),
    _Group("do", output=True, objects=((0x6200, 8), (0x6300, 16), (0x6320, 32))),
    _Group("ai", output=False, objects=tuple((index, None) for index in ANALOGUE_INPUTS)),
    _Group("ao", output=True, objects=((0x6411, None), (0x6412, None), (0x6410, None), (0x6413, None))),
)


def io_signals(od: ObjectDictionary) -> Iterator[Signal]:
    """Yield a signal for each input and output line of an I/O module."""
    for group in _GROUPS:
        for index, lines in group.objects:
            subindices = [subindex for subindex in od.subindices(index) if 1 <= subindex < 0xFF]
            if not subindices:
                continue
            for subindex in subindices:
                first = (subindex - 1) * (lines or 1)
                for bit in range(lines or 1):
                    name = f"{group.prefix}{first + bit}"
                    yield Signal(name, index, subindex, group.output, bit if lines else None)
            break


# Outputs without a master: objects of error mode and error value (CiA 401, CiA 404). If its mode is set, an output
# takes its error value when the heartbeat of the master is lost, at NMT stop and on device failure; otherwise it keeps
# its value. For digital outputs both are bit fields, one bit per line.


ERROR_OBJECTS: Final = {
    0x6200: (0x6206, 0x6207),
    0x6300: (0x6306, 0x6307),
    0x6320: (0x6326, 0x6327),
    0x6410: (0x6443, 0x6444),
    0x6411: (0x6443, 0x6444),
    0x6412: (0x6443, 0x6444),
    0x6413: (0x6443, 0x6445),
    0x7300: (0x6340, 0x7341),
}
"""Objects of error mode and error value by output object; all three have the same subindices."""


@dataclass(frozen=True, slots=True)
class SafeOutput:
    """Error mode and error value to be written for one output object.

    The addresses are None if the device does not have the objects.
    """

    output: Address
    mode_at: Address | None
    value_at: Address | None
    mode: int
    value: float


def safe_outputs(signals: Iterable[Signal], od: ObjectDictionary) -> Iterator[SafeOutput]:
    """Yield, for each output object, the error mode and error value that set the `safe` values of the signals."""
    by_object: dict[Address, list[Signal]] = {}
    for signal in signals:
        if signal.output and signal.index in ERROR_OBJECTS:
            by_object.setdefault(signal.address, []).append(signal)
    for address, lines in by_object.items():
        mode_index, value_index = ERROR_OBJECTS[address[0]]
        mode_at, value_at = (mode_index, address[1]), (value_index, address[1])
        mode, value = _of_lines(lines) if lines[0].bit is not None else _of_value(lines[-1], od)
        yield SafeOutput(address, mode_at if mode_at in od else None, value_at if value_at in od else None, mode, value)


def has_error_mode(od: ObjectDictionary, signal: Signal) -> bool:
    """Whether the device has the error mode object of a signal; True if CiA 401 and CiA 404 define none for it."""
    return signal.index not in ERROR_OBJECTS or (ERROR_OBJECTS[signal.index][0], signal.subindex) in od


def _of_lines(lines: list[Signal]) -> tuple[int, int]:
    """Return the bit fields of the error mode and the error value for the lines of one object.

    If a line has two names, the last signal counts, which is the signal of bus.yml.
    """
    safe = {line.bit or 0: line.safe for line in lines}
    mode = sum(1 << bit for bit, value in safe.items() if value is not None)
    return mode, sum(1 << bit for bit, value in safe.items() if value)


def _of_value(line: Signal, od: ObjectDictionary) -> tuple[int, float]:
    if line.safe is None:
        return 0, 0
    entry = od.get(*line.address)
    gain = line.gain({scale.address: scale.assumed for scale in line.scales})
    return 1, line.raw(line.safe, gain, whole=entry is None or entry.data_type.is_integer)


_TABLES: Final[dict[Profile, Callable[[ObjectDictionary], Iterator[Signal]]]] = {
    Profile.IO: io_signals,
    Profile.MEASURING: measuring_signals,
    Profile.ENCODER: encoder_signals,
    Profile.INCLINOMETER: inclinometer_signals,
    Profile.BATTERY: battery_signals,
    Profile.CHARGER: charger_signals,
}


def profile_signals(od: ObjectDictionary, profile: Profile) -> dict[str, Signal]:
    """Return the signals of a device by name, in the order of the table; none for a drive or an unknown profile."""
    table = _TABLES.get(profile)
    return {} if table is None else {signal.name: signal for signal in table(od)}


def object_signal(od: ObjectDictionary, name: str) -> Signal | None:
    """Return the signal named by an object's address, with its raw number; None if there is no such object."""
    place = object_of(name) if name[:2] in ("0x", "0X") else None
    entry = None if place is None else od.get(place[0], place[1])
    if place is None or entry is None or entry.data_type.bits is None:
        return None
    return Signal(name, place[0], place[1], output=entry.rpdo_mappable and entry.writable, bit=place[2])
