"""Process data objects: mapping, codec and transmission (CiA 301, 7.2.2 and 7.5.2.35 to 7.5.2.38).

A mapping is a sequence of objects, packed without gaps from bit 0 of byte 0, little-endian. Byte-aligned integers of 8,
16, 32 or 64 bits and reals are compiled into one `struct.Struct`, so that the cycle does no work per object; any other
mapping is packed through one large integer. Both forms refuse a value that does not fit. The data type determines the
sign, the mapping the width: an INTEGER8 mapped with 4 bits holds -8 to 7. BOOLEAN and the two time types are numbers;
strings and domains are bytes of the mapped length.
"""

from __future__ import annotations

import enum
import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from canopen_control.cia301.outbox import Outbox
from canopen_control.errors import LocalProtocolError
from canopen_control.frame import EXTENDED_BIT, EXTENDED_FLAG, REMOTE_FLAG, CanFrame, is_restricted, make_frame
from canopen_control.od.model import DataType

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from canopen_control.od.model import Value


MAX_BITS = 64  # length of a classic CAN frame
INVALID_BIT = 1 << 31  # in a COB-ID entry
NO_RTR_BIT = 1 << 30

# Transmission types (CiA 301, 7.5.2.37); 1 to 240 are cyclic synchronous, 241 to 251 reserved.
ACYCLIC_SYNCHRONOUS = 0
LAST_CYCLIC = 240
RTR_SYNCHRONOUS = 252
RTR_EVENT = 253
EVENT_MANUFACTURER = 254
EVENT_PROFILE = 255

# Dummy entries fill gaps in an RPDO: the index is the number of the data type (CiA 301, 7.4.1.2).
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
    """Object in a PDO mapping: `bits` is its width in the PDO, `data_type` the interpretation of the bits."""

    index: int  # type: ignore[assignment]  # hides tuple.index, which means nothing here
    subindex: int
    bits: int
    data_type: DataType


def mapping_entry(mapped: MappedObject) -> int:
    """Return the mapping entry of `mapped`: index in bits 16-31, subindex in bits 8-15, width in bits 0-7."""
    return mapped.index << 16 | mapped.subindex << 8 | mapped.bits


def parse_mapping_entry(value: int) -> tuple[int, int, int]:
    """Return the index, subindex and width in bits of a mapping entry."""
    return value >> 16 & 0xFFFF, value >> 8 & 0xFF, value & 0xFF


def dummy(data_type: DataType) -> MappedObject:
    """Return the RPDO mapping entry that skips a value of `data_type`.

    Raise LocalProtocolError if the type is not in `DUMMY_TYPES`.
    """
    if data_type not in DUMMY_TYPES:
        msg = f"{data_type.name} cannot fill a gap in a PDO; use one of the data types 1 to 7"
        raise LocalProtocolError(msg)
    return MappedObject(int(data_type), 0, data_type.bits or 0, data_type)


def is_cyclic(transmission_type: int) -> bool:
    """Whether a PDO of this type is sent at every nth SYNC: types 1 to 240."""
    return ACYCLIC_SYNCHRONOUS < transmission_type <= LAST_CYCLIC


def is_event_driven(transmission_type: int) -> bool:
    """Whether a PDO of this type is sent on events: types 254 and 255."""
    return transmission_type in (EVENT_MANUFACTURER, EVENT_PROFILE)


def is_reserved(transmission_type: int) -> bool:
    """Whether the type is reserved: 241 to 251, and values outside UNSIGNED8."""
    return not (0 <= transmission_type <= LAST_CYCLIC or RTR_SYNCHRONOUS <= transmission_type <= EVENT_PROFILE)


@dataclass(frozen=True, slots=True)
class PdoParameters:
    """Communication parameters of one PDO (0x1400 and above for RPDOs, 0x1800 and above for TPDOs).

    `cob_id` is the CAN identifier alone; `enabled` and `rtr_allowed` are the inverse of bits 31 and 30 of the entry.
    `from_value` disables a PDO whose identifier is 0 or restricted (CiA 301, 7.3.5).
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
        """Inhibit time in ns: minimum time between two transmissions."""
        return self.inhibit_time_100us * 100_000

    @property
    def event_ns(self) -> int:
        """Event timer of a TPDO or timeout of an RPDO in ns; 0 if not set."""
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
        """Return the parameters for the values of the COB-ID (subindex 1) and the other subindices."""
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


# struct format characters by width: unsigned, signed
_INTEGERS = {8: "Bb", 16: "Hh", 32: "Ii", 64: "Qq"}
_REALS = {(DataType.REAL32, 32): "f", (DataType.REAL64, 64): "d"}


class _Field(NamedTuple):
    """Position and type of a mapped object in the PDO, which is read as one little-endian integer."""

    name: str
    shift: int
    bits: int
    mask: int
    sign: int  # value of the sign bit; 0: unsigned
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
    for mapped in objects:  # with these widths every object starts at a byte boundary
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
    """Codec of a mapping: packs and unpacks values; `length` is the number of bytes, the last possibly partial.

    `struct` is the compiled form, None if the mapping needs the slower bit form. A mapping of more than 64 bits or of
    an invalid width raises LocalProtocolError.
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
            msg = f"a PDO has at most {MAX_BITS} bits, the mapping has {self.bits}; remove an object"
            raise LocalProtocolError(msg)
        self._fields = tuple(fields)
        self.length = (self.bits + 7) // 8
        self.struct = _compile(self.objects)

    def pack(self, values: Sequence[Value]) -> bytes:
        """Pack one value per object into bytes; raise LocalProtocolError for a value that does not fit."""
        if self.struct is None:
            return self._image(values).to_bytes(self.length, "little")
        try:
            return self.struct.pack(*values)
        except (struct.error, OverflowError) as error:
            raise self._packing_error(values, error) from None

    def unpack(self, data: bytes | bytearray | memoryview) -> tuple[Value, ...]:
        """Unpack one value per object from the first `length` bytes; raise LocalProtocolError if there are fewer."""
        if len(data) < self.length:
            msg = f"{len(data)} bytes are too few for a mapping of {self.length}; check the length first"
            raise LocalProtocolError(msg)
        if self.struct is not None:
            return self.struct.unpack_from(data)
        image = int.from_bytes(data[: self.length], "little")
        return tuple([_value_of(field, image >> field.shift & field.mask) for field in self._fields])

    def _image(self, values: Sequence[Value]) -> int:
        if len(values) != len(self._fields):
            raise self._packing_error(values, None)
        image = 0
        for field, value in zip(self._fields, values, strict=True):
            try:
                image |= _raw_of(field, value) << field.shift
            except (struct.error, OverflowError) as error:
                raise self._packing_error(values, error) from None
        return image

    def _packing_error(self, values: Sequence[Value], error: Exception | None) -> LocalProtocolError:
        if len(values) != len(self.objects):
            return LocalProtocolError(f"the mapping has {len(self.objects)} objects, not {len(values)}")
        names = ", ".join(field.name for field in self._fields)
        return LocalProtocolError(f"{list(values)!r} cannot be packed as {names}: {error}")


class RpdoEventKind(enum.Enum):
    """Kind of an RPDO event."""

    APPLY = "apply"  # write `data` to the mapped objects
    TOO_SHORT = "too short"
    TOO_LONG = "too long"
    TIMEOUT = "timeout"
    RESOLVED = "resolved"  # first data after a timeout


EMCY_OF: dict[RpdoEventKind, int] = {
    RpdoEventKind.TOO_SHORT: 0x8210,
    RpdoEventKind.TOO_LONG: 0x8220,
    RpdoEventKind.TIMEOUT: 0x8250,
}


class RpdoEvent(NamedTuple):
    """RPDO event `kind`; `data` are the mapped bytes for APPLY, else empty; `length` is the length of the frame."""

    kind: RpdoEventKind
    data: bytes = b""
    length: int = 0


class RpdoConsumer:
    """Consumer of one RPDO whose mapping has `length` bytes (CiA 301, 7.2.2.2 and 7.5.2.35).

    With transmission types 0 to 240 the newest data are applied at the next SYNC, with 254 and 255 at once. Data that
    are too short are dropped and reported (EMCY 0x8210); if they are too long, the mapped part is applied and the
    excess reported (0x8220). The event timer, if set, is a timeout that starts with the first reception (0x8250). The
    RPDO is received only between `start` (OPERATIONAL) and `stop`. `received` counts accepted frames, `short` and
    `long` length errors, `late` synchronous data outside the window `window_ns` after SYNC (0x1007; 0: no window).
    `length_error` is the length error of the last frame, None if its length was right.
    """

    def __init__(self, parameters: PdoParameters, length: int, *, window_ns: int = 0) -> None:
        self.length = length
        self.window_ns = window_ns
        self.running = False
        self.received = self.short = self.long = self.late = 0
        self.length_error: RpdoEventKind | None = None
        self.event_queue: Outbox[RpdoEvent] = Outbox()
        self._sync_ns: int | None = None
        self._held: bytes | None = None
        self._deadline_ns: int | None = None
        self._timed_out = False
        self._adopt(parameters)

    @property
    def holds(self) -> bool:
        """Whether data is waiting for the next SYNC."""
        return self._held is not None

    @property
    def parameters(self) -> PdoParameters:
        return self._parameters

    def configure(self, parameters: PdoParameters, length: int) -> None:
        """Set the communication parameters and the mapping length, and discard waiting data."""
        self.length = length
        self._clear()
        self._adopt(parameters)

    def start(self) -> None:
        """Start reception when the node enters OPERATIONAL."""
        self._clear()
        self.running = True

    def stop(self) -> None:
        """Stop reception when the node leaves OPERATIONAL; waiting data is discarded. No effect if stopped."""
        self._clear()
        self.running = False

    def receive(self, frame: CanFrame, now: int) -> None:
        # CiA 301, 7.3.2.2.5: PDOs are processed only while OPERATIONAL
        if frame.can_id != self._can_id or not self.running:
            return
        if self._deadline_ns is not None:
            self.tick(now)  # data after the deadline resolve a timeout instead of hiding it
        data = self._checked(frame.data)
        if data is None:
            return
        # CiA 301, 7.5.2.7: synchronous PDOs outside of the window length 0x1007 are discarded
        if self.window_ns and not self._immediate and self._is_late(now):
            self.late += 1
            return
        self.received += 1
        if self._timed_out or self._event_ns:
            self._alive(now)
        if self._immediate:
            self.event_queue.put(RpdoEvent(RpdoEventKind.APPLY, data, len(frame.data)))
        else:
            self._held = data

    def hold(self, data: bytes) -> bool:
        """Store synchronous data until the next SYNC; return False if `receive` must process it instead."""
        usual = self._waits and self.running and len(data) == self.length
        if not usual or self.window_ns or self._timed_out or self.length_error is not None:
            return False
        self.received += 1
        self._held = data
        return True

    def sync(self, now: int) -> None:
        """Process a SYNC: apply the waiting data."""
        self._sync_ns = now
        if self._held is not None:
            self.event_queue.put(RpdoEvent(RpdoEventKind.APPLY, self._held, len(self._held)))
            self._held = None

    def tick(self, now: int) -> None:
        """Report an RPDO timeout once."""
        # CiA 301, 7.5.2.35: the event timer of an RPDO is its reception timeout
        if self._deadline_ns is not None and now >= self._deadline_ns:
            self._deadline_ns, self._timed_out = None, True
            self.event_queue.put(RpdoEvent(RpdoEventKind.TIMEOUT))

    def next_deadline(self) -> int | None:
        return self._deadline_ns

    def frames(self) -> list[CanFrame]:
        return []

    def events(self) -> list[RpdoEvent]:
        return self.event_queue.drain()

    def _adopt(self, parameters: PdoParameters) -> None:
        self._parameters, self._event_ns = parameters, parameters.event_ns
        self._immediate = is_event_driven(parameters.transmission_type)
        # CiA 301, 7.5.2.35: types 0 to 240 are synchronous, 254 and 255 event-driven; the others are not for RPDOs
        usable = parameters.enabled and (self._immediate or parameters.transmission_type <= LAST_CYCLIC)
        self._can_id = parameters.cob_id | (EXTENDED_FLAG if parameters.extended else 0) if usable else -1
        self._waits = usable and not self._immediate and not self._event_ns

    def _clear(self) -> None:
        self._held = self._deadline_ns = None
        self._timed_out = False
        self.length_error = None

    def _checked(self, data: bytes) -> bytes | None:
        self.length_error = None
        if len(data) < self.length:
            # CiA 301, 7.2.2.5: a short PDO is not processed, EMCY 0x8210
            self.length_error = RpdoEventKind.TOO_SHORT
            self.short += 1
            self.event_queue.put(RpdoEvent(RpdoEventKind.TOO_SHORT, length=len(data)))
            return None
        # CiA 301, 7.2.2.5: the first bytes of a long PDO are used, EMCY 0x8220
        if len(data) > self.length:
            self.length_error = RpdoEventKind.TOO_LONG
            self.long += 1
            self.event_queue.put(RpdoEvent(RpdoEventKind.TOO_LONG, length=len(data)))
        return data[: self.length]

    def _is_late(self, now: int) -> bool:
        return self._sync_ns is not None and now - self._sync_ns > self.window_ns

    def _alive(self, now: int) -> None:
        if self._timed_out:
            self._timed_out = False
            self.event_queue.put(RpdoEvent(RpdoEventKind.RESOLVED))
        if self._event_ns:
            self._deadline_ns = now + self._event_ns


class TpdoProducer:
    """Producer of one TPDO (CiA 301, 7.2.2 and 7.5.2.37).

    `sample` returns the packed current values of the mapped objects. They are sent depending on the transmission type:
    - 0: at the next SYNC after `changed`;
    - 1 to 240: at every nth SYNC; with a SYNC start value, counting begins at the SYNC with this counter;
    - 252: on a remote frame, with the values sampled at the last SYNC;
    - 253: on a remote frame;
    - 254, 255: after `changed`, on the event timer, and once at `start`; never within the inhibit time.

    The event timer restarts at each transmission. Changes within the inhibit time are sent once, with the newest
    values, when it has elapsed. The phase of types 1 to 240 is not portable: without a start value this producer first
    sends at the nth SYNC, others send earlier. Nothing is sent before `start` (OPERATIONAL) or after `stop`. `sent`
    counts transmissions, `unanswered` remote frames without a sample or for a type that does not answer.
    """

    def __init__(self, parameters: PdoParameters, sample: Callable[[], bytes]) -> None:
        self.sample = sample
        self.sent = 0
        self.unanswered = 0
        self.running = False
        self.outgoing: Outbox[CanFrame] = Outbox()
        self._pending = False
        self._sampled: bytes | None = None
        self._count = 0
        self._started = False  # whether the SYNC with the start value was received
        self._inhibited_until: int | None = None
        self._event_at: int | None = None
        self._adopt(parameters)

    @property
    def parameters(self) -> PdoParameters:
        return self._parameters

    def configure(self, parameters: PdoParameters, now: int) -> None:
        """Set the communication parameters; a running PDO restarts with them."""
        self._adopt(parameters)
        if not self._valid:
            self.outgoing.clear()
        if self.running:
            self.start(now)

    def start(self, now: int, *, shows: bool = True) -> None:
        """Start transmission when the node enters OPERATIONAL or the PDO becomes valid.

        An event-driven PDO sends its initial values at once, unless `shows` is False, which some profiles require.
        """
        self._clear()
        self.running = True
        if not self._valid or not is_event_driven(self._type):
            return
        if shows:
            self._send(now)
        elif self._event_ns:
            self._event_at = now + self._event_ns

    def stop(self) -> None:
        """Stop transmission when the node leaves OPERATIONAL. No effect if stopped."""
        self._clear()
        self.running = False
        self.outgoing.clear()

    def changed(self, now: int) -> None:
        """Record a changed value or a profile event; no effect if the transmission type is not triggered by changes."""
        if not self._active:
            return
        transmission_type = self._type
        # CiA 301, 7.5.2.37: type 0 is sent at the next SYNC after an event
        if transmission_type == ACYCLIC_SYNCHRONOUS:
            self._pending = True
        elif is_event_driven(transmission_type):
            self._pending = True
            self.tick(now)

    def sync(self, now: int, counter: int | None = None) -> None:
        """Process a SYNC; `counter` is None if the SYNC has no counter."""
        if not (self.running and self._valid):
            return
        if self._cyclic:
            if (self._started and self._type == 1) or self._is_turn(counter):
                self._send(now)
        elif self._type == ACYCLIC_SYNCHRONOUS:
            if self._pending:
                self._send(now)
        elif self._type == RTR_SYNCHRONOUS:
            self._sampled = self.sample()

    def receive(self, frame: CanFrame, now: int) -> None:
        """Answer a remote frame with the PDO's COB-ID; ignore other frames."""
        if frame.can_id != self._can_id | REMOTE_FLAG or not self._active:
            return
        transmission_type = self._type
        # CiA 301, 7.5.2.37: 252 and 253 are sent on a remote frame, if bit 30 of the COB-ID permits it
        if transmission_type == RTR_EVENT and self._parameters.rtr_allowed:
            self._send(now)
        elif transmission_type == RTR_SYNCHRONOUS and self._parameters.rtr_allowed and self._sampled is not None:
            self._put(self._sampled)
        else:
            self.unanswered += 1

    def tick(self, now: int) -> None:
        """Send the PDO if the event timer has elapsed, or the inhibit time after a change."""
        deadline = self.next_deadline()
        if deadline is not None and now >= deadline:
            self._send(now)

    def next_deadline(self) -> int | None:
        """Return the time of the next transmission triggered by a timer, or None."""
        if not (self._driven_by_events and self.running and self._valid):
            return None
        if self._pending:
            return self._inhibited_until or 0
        if self._event_at is None:
            return None
        return max(self._event_at, self._inhibited_until or 0)

    def frames(self) -> list[CanFrame]:
        return self.outgoing.drain()

    def events(self) -> list[object]:
        return []

    @property
    def _active(self) -> bool:
        return self.running and self._valid

    def _adopt(self, parameters: PdoParameters) -> None:
        self._parameters = parameters
        self._can_id = parameters.cob_id | (EXTENDED_FLAG if parameters.extended else 0)
        self._valid = parameters.enabled
        self._type, self._event_ns = parameters.transmission_type, parameters.event_ns
        self._inhibit_ns = parameters.inhibit_ns
        self._cyclic, self._driven_by_events = is_cyclic(self._type), is_event_driven(self._type)

    def _clear(self) -> None:
        self._pending = self._started = False
        self._sampled = self._inhibited_until = self._event_at = None
        self._count = 0

    def _is_turn(self, counter: int | None) -> bool:
        if not self._started:
            # CiA 301, 7.5.2.37: counting begins at the SYNC whose counter is the SYNC start value
            start = self._parameters.sync_start
            self._started = counter is None or not start or counter == start
            if not self._started:
                return False
        self._count += 1
        if self._count < self._type:
            return False
        self._count = 0
        return True

    def _send(self, now: int) -> None:
        # CiA 301, 7.5.2.37: every transmission restarts inhibit time and event timer
        self._pending = False
        self._inhibited_until = now + self._inhibit_ns if self._inhibit_ns else None
        self._event_at = now + self._event_ns if self._event_ns else None
        self._put(self.sample())

    def _put(self, data: bytes) -> None:
        self.sent += 1
        self.outgoing.put(make_frame((self._can_id, data)))
