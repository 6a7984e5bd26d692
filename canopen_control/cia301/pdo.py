"""Process data: mapped objects, their codec, and the communication parameters (CiA 301, 7.2.2 and 7.5.2.35 to 38).

A mapping is a row of objects, packed without gaps from bit 0 of byte 0, little-endian. Byte-aligned integers of 8,
16, 32 or 64 bits and reals become one compiled `struct.Struct`, made once, so that the cycle does no work per object;
any other mapping goes through one big integer. Both refuse a value that its width cannot hold. Signedness is the data
type's, the width is the mapping's: an INTEGER8 mapped with 4 bits holds -8 to 7. BOOLEAN and the two times are
numbers, strings and domains are bytes of the mapped length.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from canopen_control.errors import LocalProtocolError
from canopen_control.frame import EXTENDED_BIT, is_restricted
from canopen_control.od.model import DataType

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from canopen_control.od.model import Value

__all__ = [
    "ACYCLIC_SYNCHRONOUS",
    "DUMMY_TYPES",
    "EVENT_MANUFACTURER",
    "EVENT_PROFILE",
    "INVALID_BIT",
    "MAX_BITS",
    "NO_RTR_BIT",
    "RTR_EVENT",
    "RTR_SYNCHRONOUS",
    "MappedObject",
    "PdoCodec",
    "PdoParameters",
    "dummy",
    "is_cyclic",
    "is_event_driven",
    "is_reserved",
    "mapping_entry",
    "parse_mapping_entry",
]

MAX_BITS = 64  # a classic CAN frame
INVALID_BIT = 1 << 31  # of a COB-ID entry
NO_RTR_BIT = 1 << 30

# Transmission types (table 69); 1 to 240 are cyclic synchronous, 241 to 251 reserved.
ACYCLIC_SYNCHRONOUS = 0
LAST_CYCLIC = 240
RTR_SYNCHRONOUS = 252
RTR_EVENT = 253
EVENT_MANUFACTURER = 254
EVENT_PROFILE = 255

# Dummy entries fill gaps in an RPDO: the index is that of the type (7.4.1.2).
DUMMY_TYPES: dict[int, DataType] = {
    int(data_type): data_type
    for data_type in (
        DataType.BOOLEAN,
        DataType.INTEGER8,
        DataType.INTEGER16,
        DataType.INTEGER32,
        DataType.UNSIGNED8,
        DataType.UNSIGNED16,
        DataType.UNSIGNED32,
    )
}


class MappedObject(NamedTuple):
    """One object of a mapping: `bits` is its width in the PDO, `data_type` how the bits are read."""

    index: int  # type: ignore[assignment]  # hides tuple.index, which means nothing here
    subindex: int
    bits: int
    data_type: DataType


def mapping_entry(mapped: MappedObject) -> int:
    """Return the mapping parameter of `mapped`: index, subindex, bits."""
    return mapped.index << 16 | mapped.subindex << 8 | mapped.bits


def parse_mapping_entry(value: int) -> tuple[int, int, int]:
    """Return index, subindex and bits of a mapping parameter."""
    return value >> 16 & 0xFFFF, value >> 8 & 0xFF, value & 0xFF


def dummy(data_type: DataType) -> MappedObject:
    """Make the entry that skips a value of `data_type`; LocalProtocolError unless it is one of `DUMMY_TYPES`."""
    if data_type not in DUMMY_TYPES:
        msg = f"{data_type.name} cannot fill a gap in a PDO; take one of the types 1 to 7"
        raise LocalProtocolError(msg)
    return MappedObject(int(data_type), 0, data_type.bits or 0, data_type)


def is_cyclic(transmission_type: int) -> bool:
    """Whether the PDO is sent every nth SYNC: 1 to 240."""
    return ACYCLIC_SYNCHRONOUS < transmission_type <= LAST_CYCLIC


def is_event_driven(transmission_type: int) -> bool:
    """Whether the PDO is sent on events: 254 and 255."""
    return transmission_type in (EVENT_MANUFACTURER, EVENT_PROFILE)


def is_reserved(transmission_type: int) -> bool:
    """Whether the standard gives the value no meaning: 241 to 251, and what no UNSIGNED8 holds."""
    return not (0 <= transmission_type <= LAST_CYCLIC or RTR_SYNCHRONOUS <= transmission_type <= EVENT_PROFILE)


@dataclass(frozen=True, slots=True)
class PdoParameters:
    """The communication record, 0x1400 or 0x1800 and following, of one PDO.

    `cob_id` is the CAN identifier alone; `enabled` and `rtr_allowed` are the inverse of bits 31 and 30 of the entry. A
    PDO whose identifier is 0, or another one that the standard keeps for itself, is not enabled.
    """

    cob_id: int
    enabled: bool = True
    rtr_allowed: bool = True
    transmission_type: int = EVENT_PROFILE
    inhibit_time_100us: int = 0
    event_timer_ms: int = 0
    sync_start: int = 0
    extended: bool = False

    @property
    def inhibit_ns(self) -> int:
        """The least time between two transmissions."""
        return self.inhibit_time_100us * 100_000

    @property
    def event_ns(self) -> int:
        """The event timer of a TPDO, the deadline of an RPDO; 0: none."""
        return self.event_timer_ms * 1_000_000

    @classmethod
    def from_value(
        cls,
        value: int,
        *,
        transmission_type: int = EVENT_PROFILE,
        inhibit_time_100us: int = 0,
        event_timer_ms: int = 0,
        sync_start: int = 0,
    ) -> PdoParameters:
        """Make the parameters of an entry of subindex 1, and of the values of the other subindices."""
        extended = bool(value & EXTENDED_BIT)
        identifier = value & (0x1FFFFFFF if extended else 0x7FF)
        return cls(
            identifier,
            not value & INVALID_BIT and (extended or not is_restricted(identifier)),
            not value & NO_RTR_BIT,
            transmission_type,
            inhibit_time_100us,
            event_timer_ms,
            sync_start,
            extended,
        )


# struct's letters by width: unsigned, signed
_INTEGERS = {8: "Bb", 16: "Hh", 32: "Ii", 64: "Qq"}
_REALS = {(DataType.REAL32, 32): "f", (DataType.REAL64, 64): "d"}


class _Field(NamedTuple):
    """Where an object lies in the big integer of a PDO."""

    name: str
    shift: int
    bits: int
    mask: int
    sign: int  # the value of the sign bit; 0: unsigned
    real: struct.Struct | None
    is_bytes: bool


def _letter(mapped: MappedObject) -> str | None:
    if mapped.data_type.is_real:
        return _REALS.get((mapped.data_type, mapped.bits))
    if mapped.data_type.is_integer and mapped.bits in _INTEGERS:
        return _INTEGERS[mapped.bits][mapped.data_type.signed]
    return None


def _compile(objects: Sequence[MappedObject]) -> struct.Struct | None:
    letters: list[str] = []
    for mapped in objects:  # a width that struct knows keeps the next object on a byte
        letter = _letter(mapped)
        if letter is None:
            return None
        letters.append(letter)
    return struct.Struct("<" + "".join(letters))


def _field(mapped: MappedObject, shift: int) -> _Field:
    data_type, bits = mapped.data_type, mapped.bits
    name = f"0x{mapped.index:04X}:{mapped.subindex:02X}"
    letter = _letter(mapped) if data_type.is_real else None
    if bits < 1 or (data_type.is_real and letter is None) or (data_type.bits is None and bits % 8):
        msg = f"{name}: a {data_type.name} cannot be mapped with {bits} bits"
        raise LocalProtocolError(msg)
    real = struct.Struct("<" + letter) if letter else None
    sign = 1 << (bits - 1) if data_type.signed else 0
    return _Field(name, shift, bits, (1 << bits) - 1, sign, real, data_type.bits is None)


def _raw_of(field: _Field, value: Value) -> int:
    if field.real is not None:
        return int.from_bytes(field.real.pack(value), "little")
    if field.is_bytes:
        if not isinstance(value, bytes | bytearray) or len(value) * 8 != field.bits:
            msg = f"{field.name}: {value!r} is not {field.bits // 8} bytes"
            raise LocalProtocolError(msg)
        return int.from_bytes(value, "little")
    if not isinstance(value, int) or not -field.sign <= value <= field.mask ^ field.sign:
        msg = f"{field.name}: {value!r} does not fit into {field.bits} bits"
        raise LocalProtocolError(msg)
    return value & field.mask


def _value_of(field: _Field, raw: int) -> Value:
    if field.real is not None:
        number: float = field.real.unpack(raw.to_bytes(field.bits // 8, "little"))[0]
        return number
    if field.is_bytes:
        return raw.to_bytes(field.bits // 8, "little")
    return (raw ^ field.sign) - field.sign


class PdoCodec:
    """Packs and unpacks the values of a mapping; `length` is its data in bytes, the last one perhaps in part.

    `struct` is the compiled form, None where the mapping needs the bit path. LocalProtocolError for a mapping of more
    than 64 bits or of an impossible width.
    """

    __slots__ = ("_fields", "bits", "length", "objects", "struct")

    def __init__(self, objects: Iterable[MappedObject]) -> None:
        self.objects = tuple(objects)
        fields: list[_Field] = []
        self.bits = 0
        for mapped in self.objects:
            fields.append(_field(mapped, self.bits))
            self.bits += mapped.bits
        if self.bits > MAX_BITS:
            msg = f"a PDO holds {MAX_BITS} bits, the mapping has {self.bits}; leave out an object"
            raise LocalProtocolError(msg)
        self._fields = tuple(fields)
        self.length = (self.bits + 7) // 8
        self.struct = _compile(self.objects)

    def pack(self, values: Sequence[Value]) -> bytes:
        """Return the `length` bytes of one value per object; LocalProtocolError for a value that does not fit."""
        if self.struct is None:
            return self._image(values).to_bytes(self.length, "little")
        try:
            return self.struct.pack(*values)
        except (struct.error, OverflowError) as error:
            raise self._misfit(values, error) from None

    def unpack(self, data: bytes | bytearray | memoryview) -> tuple[Value, ...]:
        """Return one value per object from the first `length` bytes; LocalProtocolError when there are fewer."""
        if len(data) < self.length:
            msg = f"{len(data)} bytes are too few for a mapping of {self.length}; check the length first"
            raise LocalProtocolError(msg)
        if self.struct is not None:
            return self.struct.unpack_from(data)
        image = int.from_bytes(data[: self.length], "little")
        return tuple([_value_of(field, image >> field.shift & field.mask) for field in self._fields])

    def _image(self, values: Sequence[Value]) -> int:
        if len(values) != len(self._fields):
            raise self._misfit(values, None)
        image = 0
        for field, value in zip(self._fields, values, strict=True):
            try:
                image |= _raw_of(field, value) << field.shift
            except (struct.error, OverflowError) as error:
                raise self._misfit(values, error) from None
        return image

    def _misfit(self, values: Sequence[Value], error: Exception | None) -> LocalProtocolError:
        if len(values) != len(self.objects):
            return LocalProtocolError(f"the mapping has {len(self.objects)} objects, not {len(values)}")
        names = ", ".join(field.name for field in self._fields)
        return LocalProtocolError(f"{list(values)!r} cannot be packed as {names}: {error}")
