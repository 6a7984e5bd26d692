"""Objects of a node as texts for tables and pages, and edits of objects."""

from __future__ import annotations

import fnmatch
import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final, NamedTuple

from canopen_control.cia301.emcy import REGISTER_TEXTS
from canopen_control.cia402 import objects
from canopen_control.cia402.modes import MODE_BITS, OperationMode
from canopen_control.cia402.objects import MOTION, axis_of
from canopen_control.cia402.units import rpm_of_unit
from canopen_control.commissioning.parameter_set import entry_label, same_value, value_text
from canopen_control.errors import ConfigError, DriveError
from canopen_control.od.codec import decode, encode
from canopen_control.od.eds_values import format_value
from canopen_control.od.model import SCALAR_CODES, DataType
from canopen_control.rpc.messages.declare import Document
from canopen_control.trace.network_description import NodeDescription
from canopen_control.trace.values import NodeWords

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from canopen_control.commissioning.node_session import NodeSession
    from canopen_control.od.model import Entry, ObjectDictionary, Value


# Units of the objects of CiA 301 and CiA 402-2 in output; "" if there is none or the unit is unknown.
#
# Positions and velocities of a drive are in user-defined units, which are the drive's counts unless 0x60A8 and 0x60A9
# define others; 0x60A9 can be revolutions per minute. The counts of a stepper are its microsteps.


POSITION: Final = "counts"
VELOCITY: Final = "counts/s"
ACCELERATION: Final = "counts/s^2"
_BY_UNIT: Final = {
    POSITION: (
        *(objects.POSITION_DEMAND, objects.POSITION_ACTUAL_INTERNAL, objects.POSITION_ACTUAL, objects.TARGET_POSITION),
        *(objects.FOLLOWING_ERROR_WINDOW, objects.POSITION_WINDOW, objects.HOME_OFFSET, objects.POSITION_OFFSET),
        *(objects.FOLLOWING_ERROR_ACTUAL, objects.POSITION_DEMAND_INTERNAL, objects.TOUCH_PROBE_1_POSITIVE),
        *(objects.TOUCH_PROBE_1_NEGATIVE, objects.TOUCH_PROBE_2_POSITIVE, objects.TOUCH_PROBE_2_NEGATIVE),
        *(objects.POSITION_RANGE_LIMIT, objects.SOFTWARE_POSITION_LIMIT),
    ),
    VELOCITY: (
        *(objects.VELOCITY_DEMAND, objects.VELOCITY_ACTUAL, objects.VELOCITY_WINDOW, objects.VELOCITY_THRESHOLD),
        *(objects.MAX_PROFILE_VELOCITY, objects.PROFILE_VELOCITY, objects.END_VELOCITY, objects.TARGET_VELOCITY),
        *(objects.VELOCITY_OFFSET, objects.MAX_SLIPPAGE, objects.HOMING_SPEEDS),
    ),
    ACCELERATION: (
        *(objects.PROFILE_ACCELERATION, objects.PROFILE_DECELERATION, objects.QUICK_STOP_DECELERATION),
        *(objects.MAX_ACCELERATION, objects.MAX_DECELERATION, objects.HOMING_ACCELERATION),
    ),
    "rpm": (
        *(objects.VL_TARGET_VELOCITY, objects.VL_VELOCITY_DEMAND, objects.VL_VELOCITY_ACTUAL),
        *(objects.VL_MIN_MAX_AMOUNT, objects.MAX_MOTOR_SPEED),
    ),
    "1/1000 of the rated torque": (
        *(objects.TARGET_TORQUE, objects.MAX_TORQUE, objects.TORQUE_DEMAND, objects.TORQUE_ACTUAL),
        *(objects.POSITIVE_TORQUE_LIMIT, objects.NEGATIVE_TORQUE_LIMIT, objects.TORQUE_OFFSET),
    ),
    "1/1000 of the rated torque a second": (objects.TORQUE_SLOPE,),
    "1/1000 of the rated current": (objects.MAX_CURRENT, objects.CURRENT_ACTUAL),
    "mA": (objects.MOTOR_RATED_CURRENT,),
    "mNm": (objects.MOTOR_RATED_TORQUE,),
    "mV": (objects.DC_LINK_VOLTAGE,),
    "ms": (
        *(0x100C, 0x1017),
        *(objects.FOLLOWING_ERROR_TIMEOUT, objects.POSITION_WINDOW_TIME, objects.VELOCITY_WINDOW_TIME),
        *(objects.VELOCITY_THRESHOLD_TIME,),
    ),
    "us": (0x1006, 0x1007),
}
_UNITS: Final = {index: unit for unit, indices in _BY_UNIT.items() for index in indices}
_IN_REVOLUTIONS: Final = {VELOCITY: "rpm"}


def unit_of(od: ObjectDictionary, index: int, subindex: int) -> str:
    """Return the unit of an object, or "" if unknown; for velocities, 0x60A9 decides between rpm and counts."""
    base, axis = objects.axis_of(index)
    unit = _UNITS.get(base, "")
    if subindex == 0 and (index, 1) in od:
        return ""  # the number of subindices
    if unit in _IN_REVOLUTIONS:
        entry = od.get(objects.axis_index(objects.SI_UNIT_VELOCITY, axis))
        value = None if entry is None else entry.value
        rpm = rpm_of_unit(value) if isinstance(value, int) else 0.0
        if rpm:
            return "rpm" if rpm == 1.0 else f"{rpm:g} rpm"
    return unit


# Conversion of values between bytes and text, by data type.
#
# A whole number is decimal, 0x, 0o or 0b, and is never truncated: a number outside of the type's range is refused. For
# a signed type, a 0x number of the type's full width is two's complement, as data sheets print it. The output shows the
# value of the type, its bytes in hexadecimal, and printable text; without a type, a number is shown unsigned and
# signed.


_ALIASES: dict[str, DataType] = {
    "bool": DataType.BOOLEAN,
    **{f"i{bits}": DataType[f"INTEGER{bits}"] for bits in (8, 16, 24, 32, 40, 48, 56, 64)},
    **{f"u{bits}": DataType[f"UNSIGNED{bits}"] for bits in (8, 16, 24, 32, 40, 48, 56, 64)},
    "f32": DataType.REAL32,
    "f64": DataType.REAL64,
    "text": DataType.VISIBLE_STRING,
    "unicode": DataType.UNICODE_STRING,
    "bytes": DataType.OCTET_STRING,
    "domain": DataType.DOMAIN,
    "time": DataType.TIME_OF_DAY,
    "interval": DataType.TIME_DIFFERENCE,
}
TYPE_NAMES = ", ".join(_ALIASES)
_WORDS = {"true": 1, "false": 0}
_TEXTS = (DataType.VISIBLE_STRING, DataType.UNICODE_STRING)
_NUMBER_BYTES = 8  # maximum length of bytes without a type that are shown as a number
_TEXT_BYTES = 3  # minimum length of printable bytes that are also shown as text
_SHOWN_BYTES = 64


def parse_type(text: str) -> DataType:
    """Return the data type with a name such as `i32` or `INTEGER32`; raise ConfigError, with all names, if unknown."""
    data_type = _ALIASES.get(text.casefold()) or DataType.__members__.get(text.upper())
    if data_type is None:
        raise ConfigError(
            f"no data type {text!r}; data types: {TYPE_NAMES}, and the names of CiA 301 such as UNSIGNED32"
        )
    return data_type


def parse_value(text: str, data_type: DataType) -> bytes:
    """Encode a value given as text; raise ConfigError if it does not fit the type."""
    try:
        return encode(_value(text, data_type), data_type)
    except ValueError as error:
        raise ConfigError(f"value {error}") from None


def _value(text: str, data_type: DataType) -> Value:
    if data_type in _TEXTS:
        return text
    if data_type.is_real:
        return _real(text, data_type)
    if data_type.is_integer:
        return _whole(text, data_type)
    try:
        return bytes.fromhex(text.removeprefix("0x"))
    except ValueError:
        raise ValueError(
            f"{text!r} is not a valid {data_type.name}: write bytes in hexadecimal, as in DEADBEEF"
        ) from None


def _real(text: str, data_type: DataType) -> float:
    try:
        return float(text)
    except ValueError:
        raise ValueError(f"{text!r} is not a valid {data_type.name}: expected a number") from None


def _whole(text: str, data_type: DataType) -> int:
    if data_type is DataType.BOOLEAN and text.casefold() in _WORDS:
        return _WORDS[text.casefold()]
    try:
        value = int(text, 0)
    except ValueError:
        raise ValueError(f"{text!r} is not a valid {data_type.name}: expected a whole number, decimal or 0x") from None
    bits = data_type.bits or 0
    if data_type.signed and text.lower().startswith("0x") and data_type.maximum < value < 1 << bits:
        value -= 1 << bits
    return value


def show(data: bytes, data_type: DataType | None) -> str:
    """Format a value for users: a number in decimal and hexadecimal, quoted text, or bytes."""
    if data_type is None:
        return _show_untyped(data)
    value = decode(data, data_type)
    if isinstance(value, str):
        return f'"{printable(value)}" ({_count(data)})'
    if isinstance(value, bytes):
        return _show_bytes(data)
    return f"{value} (0x{_hex_number(data)})" if data_type is not DataType.BOOLEAN else f"{bool(value)} ({value})"


def _show_untyped(data: bytes) -> str:
    if not 0 < len(data) <= _NUMBER_BYTES:
        return _show_bytes(data)
    unsigned, signed = (int.from_bytes(data, "little", signed=value) for value in (False, True))
    signed_text = "" if signed == unsigned else f", signed {signed}"
    text = _text_of(data)
    return f"{unsigned} (0x{_hex_number(data)}{signed_text}" + (f', text "{text}")' if text else ")")


def _show_bytes(data: bytes) -> str:
    if not data:
        return "empty (0 bytes)"
    cut = " ..." if len(data) > _SHOWN_BYTES else ""
    text = _text_of(data)
    return f'"{text}" ({_count(data)})' if text else f"{data[:_SHOWN_BYTES].hex(' ')}{cut} ({_count(data)})"


def _text_of(data: bytes) -> str:
    """Return printable ASCII as text, without padding zeros, or "" for other, very short or very long data."""
    body = data.rstrip(b"\0")
    if len(body) < _TEXT_BYTES or len(data) > _SHOWN_BYTES * 4 or not all(32 <= byte < 127 for byte in body):
        return ""
    return body.decode("ascii")


def printable(text: str) -> str:
    """Return a text with non-printable characters escaped."""
    return "".join(letter if letter.isprintable() else letter.encode("unicode_escape").decode() for letter in text)


def _hex_number(data: bytes) -> str:
    return data[::-1].hex().upper()


def _count(data: bytes) -> str:
    return f"{len(data)} byte" if len(data) == 1 else f"{len(data)} bytes"


# Selection of objects by words: an address, a pattern of addresses or names, or a part of a name.
#
#     0x6081  6081  0x1018:01     an object, or one subindex of it
#     0x60*   *velocity*          patterns with * and ?, of addresses and of names
#     velocity                    every name that contains the word
#
# A value counts as changed if it differs from the default of the EDS; without a default the object counts as unchanged.


_ADDRESS: Final = re.compile(r"(?:0x)?([0-9a-f]{4})(?::(?:0x)?([0-9a-f]{1,2}))?", re.IGNORECASE)
_PATTERN: Final = re.compile(r"[*?]")
_NOT_IN_A_SCAN: Final = 2  # bit 1 of ObjFlags (CiA 306-1)


def select_objects(od: ObjectDictionary, words: Iterable[str]) -> list[Entry]:
    """Return the entries that match any of the words, or all entries if there are no words.

    Raise ConfigError for a word without a match.
    """
    ordered = sorted(od, key=lambda entry: entry.address)
    patterns = list(words)
    if not patterns:
        return ordered
    addresses = set[tuple[int, int]]()
    for word in patterns:
        matches = {entry.address for entry in ordered if _means(word, od, entry)}
        if not matches:
            raise ConfigError(
                f"no object {word!r} in the EDS; write an address such as 0x6081 or 0x1018:01, a pattern such as "
                "0x60* or *velocity*, or a part of a name"
            )
        addresses |= matches
    return [entry for entry in ordered if entry.address in addresses]


def _means(word: str, od: ObjectDictionary, entry: Entry) -> bool:
    match = _ADDRESS.fullmatch(word)
    if match is not None:
        return entry.index == int(match[1], 16) and (match[2] is None or entry.subindex == int(match[2], 16))
    folded, name = word.casefold(), object_name(od, entry).casefold()
    if _PATTERN.search(word):
        addresses = (f"0x{entry.index:04x}", f"0x{entry.index:04x}:{entry.subindex:02x}")
        texts = (*addresses, *(address.removeprefix("0x") for address in addresses), name)
        return any(fnmatch.fnmatchcase(text, folded) for text in texts)
    return bool(folded) and folded in name


def object_name(od: ObjectDictionary, entry: Entry) -> str:
    """Return the name of an entry, preceded by the name of its array or record."""
    info = od.objects.get(entry.index)
    if info is None or info.code in SCALAR_CODES or info.name == entry.name:
        return entry.name
    return f"{info.name}: {entry.name}"


def is_scanned(entry: Entry) -> bool:
    """Whether a scan reads the object: readable, not a DOMAIN, and not excluded by ObjFlags."""
    return entry.readable and entry.data_type is not DataType.DOMAIN and not entry.obj_flags & _NOT_IN_A_SCAN


def has_changed(entry: Entry, value: Value) -> bool:
    """Whether a writable object differs from its default in the EDS; False without a default."""
    if entry.default is None or not entry.writable:
        return False
    try:
        return encode(value, entry.data_type) != encode(entry.default, entry.data_type)
    except ValueError:
        return value != entry.default


# Named bits of objects: statusword, controlword, error register, supported drive modes, digital inputs.


_STATUSWORD: Final = {
    0: "ready to switch on",
    1: "switched on",
    2: "operation enabled",
    3: "fault",
    4: "voltage enabled",
    5: "no quick stop",
    6: "switch on disabled",
    7: "warning",
    9: "remote",
    10: "target reached",
    11: "internal limit",
}
_CONTROLWORD: Final = {
    0: "switch on",
    1: "enable voltage",
    2: "no quick stop",
    3: "enable operation",
    7: "fault reset",
    8: "halt",
}
# 0x60FD (CiA 402-2)
_INPUTS: Final = {0: "negative limit switch", 1: "positive limit switch", 2: "home switch", 3: "interlock"}
_MODES: Final = {mode - 1: mode.name for mode in OperationMode if mode > 0}


class NamedBit(NamedTuple):
    """Name of a bit, and whether the bit is set."""

    bit: int
    name: str
    on: bool


def axis_word(index: int) -> bool:
    """Whether an object is a statusword or a controlword, whose bits depend on the mode."""
    return objects.axis_of(index)[0] in (objects.STATUSWORD, objects.CONTROLWORD)


def statusword_bits(word: int, mode: int | str | None = None) -> list[NamedBit]:
    """Return the bits of a statusword; `mode`, a number or a name, selects the names of bits 10, 12 and 13."""
    number = OperationMode.__members__.get(mode) if isinstance(mode, str) else mode
    mode_bits = MODE_BITS.get(number) if number is not None else None
    return _named(word, {**_STATUSWORD, **(mode_bits.statusword if mode_bits is not None else {})})


def bits_of(index: int, subindex: int, value: object, mode: int | None = None) -> list[NamedBit]:
    """Return the named bits of an object's value, or an empty list without named bits."""
    base = objects.axis_of(index)[0]
    if subindex or not isinstance(value, int):
        return []
    if base == objects.STATUSWORD:
        return statusword_bits(value, mode)
    if base == objects.CONTROLWORD:
        mode_bits = MODE_BITS.get(mode) if mode is not None else None
        return _named(value, {**_CONTROLWORD, **(mode_bits.controlword if mode_bits is not None else {})})
    if index == 0x1001:  # error register
        return _named(value, {bit.bit_length() - 1: text for bit, text in REGISTER_TEXTS.items()})
    if base == objects.SUPPORTED_DRIVE_MODES:
        return _named(value, _MODES)
    return _named(value, _INPUTS) if base == objects.DIGITAL_INPUTS else []


def _named(value: int, names: Mapping[int, str]) -> list[NamedBit]:
    return [NamedBit(bit, names[bit], bool(value >> bit & 1)) for bit in sorted(names)]


READS_PER_S: Final = 60.0
"""Maximum rate in Hz for reading objects through a running robot without delaying its own requests."""


@dataclass(frozen=True, slots=True)
class LiveObject:
    """Entry with its value, or the reason `why` it could not be read (both empty if not read yet)."""

    entry: Entry
    value: Value | None = None
    why: str = ""

    @property
    def changed(self) -> bool:
        """Whether the value is known and differs from the default in the EDS."""
        return self.value is not None and has_changed(self.entry, self.value)


class ObjectRow(Document, frozen=True, kw_only=True):
    """Object in `objects --json`, with values as texts; null if missing or unread."""

    index: str
    subindex: int
    name: str
    type: str
    access: str
    mappable: str
    unit: str
    default: str | None
    value: str | None
    meaning: str | None
    changed: bool
    error: str | None


def _row(od: ObjectDictionary, live: LiveObject, words: NodeWords) -> ObjectRow:
    entry, value = live.entry, live.value
    unit = unit_of(od, entry.index, entry.subindex)
    return ObjectRow(
        index=f"0x{entry.index:04X}",
        subindex=entry.subindex,
        name=object_name(od, entry),
        type=entry.data_type.name,
        access=entry.access,
        mappable=("R" if entry.rpdo_mappable else "") + ("T" if entry.tpdo_mappable else ""),
        unit=unit,
        default=None if entry.default is None else _text(entry, entry.default, unit),
        value=None if value is None else _text(entry, value, unit),
        meaning=None if value is None else _meaning(entry, value, words),
        changed=live.changed,
        error=live.why or None,
    )


def rows_of(od: ObjectDictionary, objects: Iterable[LiveObject], node_id: int) -> list[ObjectRow]:
    """Return the rows of objects of one node."""
    words = NodeWords(NodeDescription("", node_id, od))
    return [_row(od, entry, words) for entry in objects]


def _text(entry: Entry, value: Value, unit: str) -> str:
    """Format a value on one line, in decimal if it is an integer with a unit, else as in a DCF."""
    return str(value) if unit and isinstance(value, int) else printable(format_value(value, entry.data_type))


def _meaning(entry: Entry, value: Value, words: NodeWords) -> str | None:
    """Return the meaning of a number, or None if it has no particular meaning."""
    if not isinstance(value, int):
        return None
    text = words.text(entry.index, entry.subindex, value)
    plain = (
        str(value),
        format_value(value, entry.data_type),
        f"0x{value & 0xFFFFFFFF:08X}",
        f"{value} ms",
        f"{value} us",
    )
    if text in plain:
        return None
    head, _, rest = text.partition(" ")
    if rest.startswith("(") and rest.endswith(")"):
        return rest[1:-1]
    return rest if head.startswith("0x") or head == str(value) else text


# Edits of single objects by a user: which objects may be written, within which limits, and how an edit is undone.
#
# An edit reads the value, writes, and reads back. An object that would move an axis is refused, because such a motion
# would have no dead-man control and no timeout. An edit can be undone only while the object has the written value.


_PROGRAM: Final = range(0x1F50, 0x1F58)
_MAX_EDITS: Final = 100


def why_fixed(entry: Entry) -> str:
    """Return why a user must not write an object, or "" if it may be written."""
    if not entry.writable:
        return f"is {'constant' if entry.access == 'const' else 'read-only'}"
    if axis_of(entry.index)[0] in MOTION:
        return "moves the axis: use the hold buttons, which stop it on release"
    if entry.index in _PROGRAM:
        return "is the drive's program: use Firmware"
    return "is a DOMAIN, which cannot be edited" if entry.data_type is DataType.DOMAIN else ""


def limits_of(entry: Entry) -> tuple[int | float | None, int | float | None]:
    """Return minimum and maximum from the EDS or the data type; None means no limit."""
    is_integer = entry.data_type.is_integer
    low = entry.low if entry.low is not None else entry.data_type.minimum if is_integer else None
    high = entry.high if entry.high is not None else entry.data_type.maximum if is_integer else None
    return low, high


def limit_words(entry: Entry) -> str:
    """Return the limits of an object as text, or "" without limits."""
    low, high = limits_of(entry)
    if low is not None and high is not None:
        return f"{low} to {high}"
    return f"at least {low}" if low is not None else f"at most {high}" if high is not None else ""


def parsed_value(entry: Entry, text: str) -> Value:
    """Parse a value for an object; raise ConfigError if the object is fixed, or the text is invalid or out of range."""
    name = entry_label(entry)
    if why := why_fixed(entry):
        raise ConfigError(f"{name} {why}; nothing was written")
    try:
        value = decode(parse_value(text.strip(), entry.data_type), entry.data_type)
    except ConfigError as error:
        raise ConfigError(f"{name}: {error}; nothing was written") from None
    low, high = limits_of(entry)
    if isinstance(value, int | float) and not ((low is None or value >= low) and (high is None or value <= high)):
        raise ConfigError(f"{name} accepts {limit_words(entry)}, not {value}; nothing was written")
    return value


@dataclass(frozen=True, slots=True)
class Edit:
    """Edit of an object: the value before (None if unreadable), and the value that was read back."""

    entry: Entry
    before: Value | None
    after: Value

    @property
    def words(self) -> str:
        """Text with the object and the change of its value."""
        before = "" if self.before is None else f"{value_text(self.entry, self.before)} -> "
        return f"{entry_label(self.entry)}: {before}{value_text(self.entry, self.after)}"


@dataclass(slots=True)
class EditHistory:
    """Edits of the objects of one node, the newest last."""

    edits: list[Edit] = field(default_factory=list)

    def write(self, session: NodeSession, entry: Entry, text: str) -> Edit:
        """Write a value and read it back; raise ConfigError if it is invalid, DriveError if another value is read."""
        value = parsed_value(entry, text)
        before = session.read_value(entry) if entry.readable else None
        session.write_value(entry, value)
        edit = Edit(entry, before, session.read_value(entry) if entry.readable else value)
        self.edits = [*self.edits[1 - _MAX_EDITS :], edit]
        if not same_value(entry, value, edit.after):
            has = value_text(entry, edit.after)
            raise DriveError(
                f"{entry_label(entry)}: {value_text(entry, value)} was written, but the drive reports {has}"
            )
        return edit

    @property
    def last(self) -> Edit | None:
        """Latest edit that can be undone, or None."""
        return next((edit for edit in reversed(self.edits) if edit.before is not None), None)

    def undo(self, session: NodeSession) -> Edit:
        """Undo the latest edit; raise ConfigError if there is none, DriveError if the object was written after it."""
        edit = self.last
        if edit is None or edit.before is None:
            raise ConfigError(f"{session}: no edit to undo")
        entry, current = edit.entry, session.read_value(edit.entry)
        if not same_value(entry, current, edit.after):
            self.edits.remove(edit)
            raise DriveError(
                f"{entry_label(entry)} is {value_text(entry, current)} and not {value_text(entry, edit.after)} any "
                "more: another program has written it since; nothing was written"
            )
        session.write_value(entry, edit.before)
        self.edits.remove(edit)
        return Edit(entry, edit.after, session.read_value(entry))
