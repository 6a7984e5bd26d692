"""Decoder of CAN frames to text, with the names of bus.yml and EDS (CiA 301, CiA 305, CiA 402-2).

The decoder is deterministic and has no clock, and every frame gets a text. One table maps identifiers to contents:
first the PDOs of the network, because a mapping may use any identifier, then the predefined connection set. PDOs that
are configured during the trace are learned from their SDO transfers, because the bus is right if a file is outdated.
History (SDO transfers, the previous NMT state, the mode for the bits of a statusword) is stored per node and bounded;
malformed frames are described as such.
"""

from __future__ import annotations

import datetime
import enum
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from canopen_control.bus.error_events import error_text, events_of
from canopen_control.bus.port import BusEventKind
from canopen_control.cia301.emcy import EmcyMessage
from canopen_control.cia301.lss import (
    AUTOMATIC_BIT_TIMING,
    BIT_TIMINGS,
    FAST_SCAN_START,
    UNCONFIGURED,
    LssCommand,
    LssMode,
)
from canopen_control.cia301.nmt import NmtState, parse_nmt, state_of_byte
from canopen_control.cia301.pdo import INVALID_BIT, MAX_BITS, PdoCodec, mapping_entry, parse_mapping_entry
from canopen_control.cia301.sync import parse_time
from canopen_control.cia402 import objects
from canopen_control.errors import LocalProtocolError
from canopen_control.frame import (
    BROADCAST,
    EXTENDED_FLAG,
    REMOTE_FLAG,
    CanFrame,
    Service,
    can_id_of,
    is_restricted,
    service_of,
)
from canopen_control.od.model import TYPES
from canopen_control.rpc.messages.fault import FaultEvent
from canopen_control.rpc.messages.layout import MappedEntry, PdoLayout
from canopen_control.trace.network_description import (
    NodeDescription,
    is_gap,
    mapped_name,
    mapped_object,
    pdo_name,
    type_of,
)
from canopen_control.trace.sdo_conversation import SdoConversation
from canopen_control.trace.values import NodeWords, SignalValue, ValueChange

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.od.model import DataType
    from canopen_control.rpc.messages.layout import Direction
    from canopen_control.trace.network_description import NetworkDescription


# Learning of a node's PDOs from its SDO transfers (CiA 301, 7.5.2.35 to 7.5.2.38).


LIMIT: Final = 4096
_COUNT: Final = 512  # PDOs per direction
# index of the first communication and mapping record
_FIRST: Final[dict[Direction, tuple[int, int]]] = {"rpdo": (0x1400, 0x1600), "tpdo": (0x1800, 0x1A00)}
_COB_ID, _TYPE, _EVENT_DRIVEN = 1, 2, 255
_MAX_OBJECTS: Final = 64


class LearnedPdos:
    """PDO records of one node, learned from SDO transfers, with at most `LIMIT` values.

    Only values that the node has sent or confirmed are learned. A PDO is known once it is valid, and the number of its
    objects and all mapping entries have been received or are known from the description.
    """

    def __init__(self, node: NodeDescription, words: NodeWords) -> None:
        self._node, self._words = node, words
        self._held: dict[tuple[int, int], int] = {}
        self._cob_ids: dict[tuple[Direction, int], int] = {}
        for pdo in node.pdos:
            self._take(pdo)

    def _take(self, pdo: PdoLayout) -> None:
        communication, mapping = _records(pdo.direction, pdo.number)
        self._cob_ids[pdo.direction, pdo.number] = pdo.cob_id
        self._held[communication, _TYPE] = pdo.transmission_type
        self._held[mapping, 0] = len(pdo.objects)
        for slot, entry in enumerate(pdo.objects, 1):
            self._held[mapping, slot] = mapping_entry(mapped_object(entry))

    def learn(self, value: SignalValue) -> tuple[PdoLayout, int | None] | None:
        """Record a value of the node; return a PDO that is now complete, with its former CAN identifier, or None."""
        which = _pdo_of(value.index)
        if which is None or not isinstance(value.value, int):
            return None
        address = value.index, value.subindex
        if address not in self._held and len(self._held) >= LIMIT:
            return None
        self._held[address] = value.value
        pdo = self._known(*which)
        if pdo is None:
            return None
        before, self._cob_ids[which] = self._cob_ids.get(which), pdo.cob_id
        return pdo, before

    def _known(self, direction: Direction, number: int) -> PdoLayout | None:
        communication, mapping = _records(direction, number)
        entry = self._held.get((communication, _COB_ID))
        count = self._held.get((mapping, 0), 0)
        can_id = self._cob_ids.get((direction, number)) if entry is None else can_id_of(entry)
        if can_id is None or (entry is not None and entry & INVALID_BIT) or not 0 < count <= _MAX_OBJECTS:
            return None
        slots = [self._held.get((mapping, slot)) for slot in range(1, count + 1)]
        mapped = tuple(self._object(slot) for slot in slots if slot)
        forbidden = not can_id & EXTENDED_FLAG and is_restricted(can_id)
        if forbidden or len(mapped) != count or sum(entry.bits for entry in mapped) > MAX_BITS:
            return None
        transmission = self._held.get((communication, _TYPE), _EVENT_DRIVEN)
        return PdoLayout(can_id, direction, number, transmission, mapped)

    def _object(self, entry: int) -> MappedEntry:
        index, subindex, bits = parse_mapping_entry(entry)
        name = self._words.name(index, subindex)
        return MappedEntry(index, subindex, bits, self._type(index, subindex, bits).name, name)

    def _type(self, index: int, subindex: int, bits: int) -> DataType:
        """Return the data type from the EDS, or from CiA 402 for a drive, or the unsigned type of that width."""
        in_eds = self._node.od is not None and (index, subindex) in self._node.od
        profile = TYPES.get((objects.axis_of(index)[0], subindex), ()) if self._node.is_drive else ()
        by_profile = next((candidate for candidate in profile if candidate.bits == bits), None)
        return by_profile if by_profile is not None and not in_eds else type_of(self._node.od, index, subindex, bits)


def _records(direction: Direction, number: int) -> tuple[int, int]:
    communication, mapping = _FIRST[direction]
    return communication + number - 1, mapping + number - 1


def _pdo_of(index: int) -> tuple[Direction, int] | None:
    for direction, firsts in _FIRST.items():
        for first in firsts:
            if first <= index < first + _COUNT:
                return direction, index - first + 1
    return None


# -- LSS frames (CiA 305, 6.4)


_PARTS = ("vendor", "product", "revision", "serial number")
_RANGES = ("vendor", "product", "lowest revision", "highest revision", "lowest serial", "highest serial")
_NODE_ID_ANSWERS = {0: "accepted", 1: "refused, out of range"}
_BIT_TIMING_ANSWERS = {0: "accepted", 1: "refused, not supported"}
_STORE_ANSWERS = {0: "stored", 1: "refused, not supported", 2: "failed, storage not accessible"}


def lss_text(data: bytes, *, from_master: bool) -> str:
    """Describe an LSS frame from the master or from a slave; an unknown command is shown as a number."""
    if not data:
        return "malformed: no data"
    data = data.ljust(8, b"\0")
    command = data[0]
    words = (_MASTER if from_master else _SLAVE).get(command)
    return words(data) if words is not None else f"unknown command 0x{command:02X}"


def _number(data: bytes) -> int:
    return int.from_bytes(data[1:5], "little")


def _node_id(value: int) -> str:
    return "no node-ID" if value == UNCONFIGURED else f"node-ID {value}"


def _bit_timing(data: bytes) -> str:
    if data[2] == AUTOMATIC_BIT_TIMING and not data[1]:
        return "configure bit rate: automatic"
    rate = BIT_TIMINGS.get(data[2]) if not data[1] else None
    return f"configure bit rate: {rate} bit/s" if rate else f"configure bit timing {data[2]} of table {data[1]}"


def _switch_global(data: bytes) -> str:
    modes = {int(mode): mode.name.lower() for mode in LssMode}
    return f"all switch to {modes.get(data[1], f'mode {data[1]}')}"


def _fast_scan(data: bytes) -> str:
    if data[5] == FAST_SCAN_START:
        return "fast scan: any node without a node-ID"
    part = _PARTS[data[6]] if data[6] < len(_PARTS) else f"part {data[6]}"
    return f"fast scan: {part} 0x{_number(data):08X}, bits {data[5]} to 31"


def _answer(service: str, answers: dict[int, str]) -> Callable[[bytes], str]:
    def text(data: bytes) -> str:
        return f"{service}: {answers.get(data[1], f'error {data[1]}, detail {data[2]}')}"

    return text


def _part(prefix: str, part: str) -> Callable[[bytes], str]:
    return lambda data: f"{prefix} {part} 0x{_number(data):08X}"


def _constant(text: str) -> Callable[[bytes], str]:
    return lambda _data: text


_C = LssCommand
_MASTER: dict[int, Callable[[bytes], str]] = {
    _C.SWITCH_GLOBAL: _switch_global,
    _C.CONFIGURE_NODE_ID: lambda data: f"configure {_node_id(data[1])}",
    _C.CONFIGURE_BIT_TIMING: _bit_timing,
    _C.ACTIVATE_BIT_TIMING: lambda data: f"activate bit rate after {data[1] | data[2] << 8} ms",
    _C.STORE: _constant("store"),
    **{_C.SWITCH_SELECTIVE + n: _part("select", part) for n, part in enumerate(_PARTS)},
    **{_C.IDENTIFY + n: _part("identify", part) for n, part in enumerate(_RANGES)},
    _C.IDENTIFY_NON_CONFIGURED: _constant("identify nodes without a node-ID"),
    _C.FAST_SCAN: _fast_scan,
    **{_C.INQUIRE + n: _constant(f"inquire {part}") for n, part in enumerate(_PARTS)},
    _C.INQUIRE_NODE_ID: _constant("inquire node-ID"),
}
_SLAVE: dict[int, Callable[[bytes], str]] = {
    _C.CONFIGURE_NODE_ID: _answer("node-ID", _NODE_ID_ANSWERS),
    _C.CONFIGURE_BIT_TIMING: _answer("bit rate", _BIT_TIMING_ANSWERS),
    _C.STORE: _answer("store", _STORE_ANSWERS),
    _C.SWITCHED: _constant("selected"),
    _C.IDENTIFIED: _constant("identified"),
    _C.IDENTIFIED_NON_CONFIGURED: _constant("a node has no node-ID"),
    **{_C.INQUIRE + n: _part("is", part) for n, part in enumerate(_PARTS)},
    _C.INQUIRE_NODE_ID: lambda data: _node_id(data[1]),
}


SERVICES: Final = ("nmt", "sync", "emcy", "time", "pdo", "sdo", "hb", "lss", "error", "raw")
_LONGEST = 8  # bytes of a classic CAN frame
_SILENT_GAPS = 3  # number of usual heartbeat periods that count as a silence
_SHORTEST_SILENCE_NS = 200_000_000


class Mark(enum.IntEnum):
    """Importance of a decoded frame."""

    PLAIN = 0
    NOTABLE = 1  # a change: NMT command, boot-up, NMT state, CiA 402 state, command or mode
    WARNING = 2  # malformed, too short, late
    ERROR = 3  # EMCY, abort, a drive that enters a fault state


_MARKS: Final = {ValueChange.NONE: Mark.PLAIN, ValueChange.STATE: Mark.NOTABLE, ValueChange.FAULT: Mark.ERROR}


@dataclass(frozen=True, slots=True)
class DecodedFrame:
    """Frame with its description.

    `time` is the time passed to `decode`, in ns. `service` is one of `SERVICES`; `node_id` is None if the frame has no
    node, and `node` is "" without a name. `subject` is the instance of the service (``TPDO1``), `text` the description,
    `values` the objects in the frame, `fault` the reported fault: an EMCY, or a statusword that enters FAULT.
    """

    time: int
    can_id: int
    data: bytes
    service: str
    node_id: int | None
    node: str
    text: str
    values: tuple[SignalValue, ...] = ()
    subject: str = ""
    mark: Mark = Mark.PLAIN
    fault: FaultEvent | None = None

    @property
    def node_label(self) -> str:
        """Name of the node, "node N" without a name, or "" without a node."""
        return self.node or ("" if self.node_id is None else f"node {self.node_id}")


@dataclass(slots=True)
class _Decoded:
    """Description of a frame, created by its handler; `node_id`, if not None, replaces that of the identifier."""

    text: str
    values: tuple[SignalValue, ...] = ()
    mark: Mark = Mark.PLAIN
    node_id: int | None = None
    fault: FaultEvent | None = None


@dataclass(frozen=True, slots=True)
class _Route:
    """Service, node, subject and handler of a CAN identifier."""

    service: str
    node_id: int | None
    subject: str
    handler: Callable[[CanFrame], _Decoded]


class _Node:
    """Decoding history of one node."""

    __slots__ = ("beat", "nmt_state", "pdos", "sdo", "usual_gap", "words")

    def __init__(self, description: NodeDescription) -> None:
        self.words = NodeWords(description)
        self.sdo = SdoConversation(description.od, self.words)
        self.pdos = LearnedPdos(description, self.words)
        self.nmt_state: NmtState | None = None
        self.beat: int | None = None  # time of the last heartbeat
        self.usual_gap = 0  # usual interval of the slower heartbeats in ns; 0: unknown

    def silence(self, time: int) -> int:
        """Record a heartbeat; return the length of the preceding silence in ns, or 0 if the interval was normal."""
        gap, self.beat = (0 if self.beat is None else time - self.beat), time
        if self.usual_gap and gap > max(_SILENT_GAPS * self.usual_gap, _SHORTEST_SILENCE_NS):
            return gap
        self.usual_gap = max(gap, self.usual_gap * 7 // 8)
        return 0

    def booted(self, time: int) -> None:
        self.beat, self.usual_gap = time, 0


class Decoder:
    """Decoder for the frames of one bus, which must be passed in the order of reception."""

    def __init__(self, network: NetworkDescription) -> None:
        self.network = network
        self._nodes: dict[int, _Node] = {}
        self._time = 0  # time of the current frame in ns
        self._routes: dict[int, _Route] = {}
        self._add(network.sync_cob_id, "sync", None, "SYNC", _sync)
        for node in network.nodes.values():
            self._add(node.emcy_cob_id, "emcy", node.node_id, "EMCY", self._emcy(node.node_id))
            for pdo in node.pdos:
                self._add_pdo(node.node_id, pdo)

    def _add(
        self, can_id: int, service: str, node_id: int | None, subject: str, handler: Callable[[CanFrame], _Decoded]
    ) -> None:
        self._routes[can_id] = _Route(service, node_id, subject, handler)

    def _add_pdo(self, node_id: int, pdo: PdoLayout) -> None:
        self._add(pdo.cob_id, "pdo", node_id, pdo_name(pdo), self._pdo(node_id, pdo))

    def decode(self, frame: CanFrame, time: int = 0) -> DecodedFrame:
        """Describe a frame; `time` in ns is copied to the result. This method never raises."""
        frame = frame if len(frame.data) <= _LONGEST else CanFrame(frame.can_id, bytes(frame.data[:_LONGEST]))
        self._time = time
        route, result = self._answer(frame)
        node_id = route.node_id if result.node_id is None else result.node_id
        return DecodedFrame(
            time,
            frame.can_id,
            bytes(frame.data),
            route.service,
            node_id,
            "" if node_id is None else self.network.name_of(node_id),
            result.text,
            result.values,
            route.subject,
            result.mark,
            result.fault,
        )

    def _answer(self, frame: CanFrame) -> tuple[_Route, _Decoded]:
        if frame.is_error:
            return _ERROR, _error(frame)
        if frame.is_remote:
            return self._remote(CanFrame(frame.can_id & ~REMOTE_FLAG, frame.data))
        route = self._routes.get(frame.can_id) or self._predefined(frame.can_id)
        return route, route.handler(frame)

    def _predefined(self, can_id: int) -> _Route:
        """Return the route of an identifier in the predefined connection set, cached for 11-bit identifiers."""
        if can_id & EXTENDED_FLAG or can_id > 0x7FF:
            return _EXTENDED
        service, node_id = service_of(can_id) or (None, BROADCAST)
        route = _UNKNOWN if service is None else self._route(service, node_id)
        self._routes[can_id] = route
        return route

    def _route(self, service: Service, node_id: int) -> _Route:
        if service in _SINGLE:
            name, subject, handler = _SINGLE[service]
            return _Route(name, None, subject, handler or self._nmt)
        if service is Service.EMCY:
            return _Route("emcy", node_id, "EMCY", self._emcy(node_id))
        if service is Service.HEARTBEAT:
            return _Route("hb", node_id, "heartbeat", self._heartbeat(node_id))
        if service in (Service.SDO_CLIENT, Service.SDO_SERVER):
            from_client = service is Service.SDO_CLIENT
            subject = "SDO request" if from_client else "SDO response"
            return _Route("sdo", node_id, subject, self._sdo(node_id, from_client))
        return _Route("pdo", node_id, service.name, _unmapped)

    def _node(self, node_id: int) -> _Node:
        if (node := self._nodes.get(node_id)) is None:
            description = self.network.nodes.get(node_id) or NodeDescription("", node_id)
            node = self._nodes[node_id] = _Node(description)
        return node

    # -- handlers

    def _nmt(self, frame: CanFrame) -> _Decoded:
        parsed = parse_nmt(frame)
        if parsed is None:
            return _Decoded("unknown NMT command", mark=Mark.WARNING)
        command, node_id = parsed
        target = "all nodes" if node_id == BROADCAST else self.network.node_label(node_id)
        return _Decoded(f"{command.name.replace('_', ' ')}, {target}", mark=Mark.NOTABLE, node_id=node_id or None)

    def _remote(self, frame: CanFrame) -> tuple[_Route, _Decoded]:
        route = self._routes.get(frame.can_id) or self._predefined(frame.can_id)
        text = "guarding request" if route.service == "hb" else f"request for {route.subject}"
        return route, _Decoded(text if route.subject else f"remote frame, {len(frame.data)} bytes")

    def _emcy(self, node_id: int) -> Callable[[CanFrame], _Decoded]:
        def decode(frame: CanFrame) -> _Decoded:
            message = EmcyMessage.parse(frame, node_id)
            if message is None:
                return _Decoded(f"malformed: {len(frame.data)} bytes", mark=Mark.WARNING)
            fault = FaultEvent.of_emcy(message)
            return _Decoded(fault.text, mark=Mark.NOTABLE if fault.is_over else Mark.ERROR, fault=fault)

        return decode

    def _heartbeat(self, node_id: int) -> Callable[[CanFrame], _Decoded]:
        def decode(frame: CanFrame) -> _Decoded:
            node = self._node(node_id)
            state = state_of_byte(frame.data[0]) if len(frame.data) == 1 else None
            if state is None:
                return _Decoded(f"malformed: {frame.data.hex(' ') or 'no data'}", mark=Mark.WARNING)
            before, node.nmt_state = node.nmt_state, state
            if state is NmtState.INITIALISING:
                node.booted(self._time)
                return _Decoded("boot-up", mark=Mark.NOTABLE)
            name = state.text
            toggle = ", toggle 1" if frame.data[0] & 0x80 else ""
            if silence := node.silence(self._time):
                return _Decoded(f"{name}{toggle} (after {silence / 1e9:.2f} s of silence)", mark=Mark.WARNING)
            if before in (None, state):
                return _Decoded(f"{name}{toggle}")
            was = "after boot-up" if before is NmtState.INITIALISING else f"was {before.text}"
            return _Decoded(f"{name}{toggle} ({was})", mark=Mark.NOTABLE)

        return decode

    def _sdo(self, node_id: int, from_client: bool) -> Callable[[CanFrame], _Decoded]:
        node = self._node(node_id)

        def decode(frame: CanFrame) -> _Decoded:
            text, value, is_abort, held_value = node.sdo.receive(frame.data, from_client=from_client)
            if held_value is not None and (learned := node.pdos.learn(held_value)) is not None:
                self._relearn(node_id, *learned)
            mark = Mark.ERROR if is_abort else _MARKS[node.words.take_change()]
            return _Decoded(text, () if value is None else (value,), mark)

        return decode

    def _relearn(self, node_id: int, pdo: PdoLayout, before: int | None) -> None:
        """Replace a PDO with its learned configuration, which takes precedence over the description."""
        old = self._routes.get(before) if before is not None else None
        if before is not None and old is not None and (old.node_id, old.subject) == (node_id, pdo_name(pdo)):
            del self._routes[before]
        self._add_pdo(node_id, pdo)

    def _pdo(self, node_id: int, pdo: PdoLayout) -> Callable[[CanFrame], _Decoded]:
        try:
            codec = PdoCodec([mapped_object(entry) for entry in pdo.objects])
        except LocalProtocolError as error:
            reason = f"its mapping cannot be read: {error}"
            return lambda frame: _Decoded(f"{frame.data.hex(' ')}; {reason}", mark=Mark.WARNING)
        words = self._node(node_id).words
        names = [None if is_gap(entry) else mapped_name(entry) for entry in pdo.objects]

        def decode(frame: CanFrame) -> _Decoded:
            if len(frame.data) < codec.length:
                short = f"too short: {len(frame.data)} bytes, {codec.length} are mapped"
                return _Decoded(short, mark=Mark.WARNING)
            return _mapped(words, names, codec, frame.data)

        return decode


def _mapped(words: NodeWords, names: list[str | None], codec: PdoCodec, data: bytes) -> _Decoded:
    """Decode the values of a PDO; `names` has a name for each mapped object, None for a gap.

    The mode is decoded first, because bits of the statusword depend on it.
    """
    rows = [
        (mapped, name, value)
        for mapped, name, value in zip(codec.objects, names, codec.unpack(data), strict=True)
        if name is not None
    ]
    for mapped, _, value in rows:
        if objects.axis_of(mapped.index)[0] == objects.MODES_OF_OPERATION_DISPLAY:
            words.text(mapped.index, mapped.subindex, value)
    values = tuple(
        SignalValue(mapped.index, mapped.subindex, name, value, words.text(mapped.index, mapped.subindex, value))
        for mapped, name, value in rows
    )
    text = "; ".join(f"{value.name} {value.text}" for value in values)
    if len(data) > codec.length:
        text += f"; {len(data)} bytes, {codec.length} are mapped"
    change = words.take_change()
    fault = _shown_fault(values) if change is ValueChange.FAULT else None
    return _Decoded(text or "nothing is mapped", values, _MARKS[change], fault=fault)


def _shown_fault(values: tuple[SignalValue, ...]) -> FaultEvent:
    """Return the fault in the statusword of a PDO, with the error code if the PDO contains one."""
    by_object = {objects.axis_of(value.index)[0]: value.value for value in values}
    word, code = by_object.get(objects.STATUSWORD), by_object.get(objects.ERROR_CODE)
    return FaultEvent(
        error_code=code if isinstance(code, int) and code else None,
        statusword=word if isinstance(word, int) else None,
    )


def _sync(frame: CanFrame) -> _Decoded:
    return _Decoded(f"counter {frame.data[0]}" if frame.data else "")


def _time(frame: CanFrame) -> _Decoded:
    time = parse_time(frame.data)
    if time is None:
        return _Decoded(f"malformed: {len(frame.data)} bytes", mark=Mark.WARNING)
    moment = datetime.datetime(1984, 1, 1) + datetime.timedelta(days=time.days, milliseconds=time.ms)  # noqa: DTZ001 - TIME has no time zone
    return _Decoded(moment.isoformat(" ", "milliseconds"))


def _unmapped(_frame: CanFrame) -> _Decoded:
    return _Decoded("mapping unknown")


def _error(frame: CanFrame) -> _Decoded:
    kinds = {event.kind for event in events_of(CanFrame(frame.can_id, frame.data.ljust(_LONGEST, b"\0")))}
    mark = Mark.ERROR if kinds - {BusEventKind.ERROR_ACTIVE} else Mark.NOTABLE if kinds else Mark.WARNING
    return _Decoded(error_text(frame), mark=mark)


def _nothing(_frame: CanFrame) -> _Decoded:
    return _Decoded("no CANopen service has this identifier")


_ERROR = _Route("error", None, "CAN error", _error)
_UNKNOWN = _Route("raw", None, "", _nothing)
_EXTENDED = _Route("raw", None, "", lambda _frame: _Decoded("29-bit identifier of no known PDO"))
_SINGLE: dict[Service, tuple[str, str, Callable[[CanFrame], _Decoded] | None]] = {
    Service.NMT: ("nmt", "NMT", None),
    Service.SYNC: ("sync", "SYNC", _sync),
    Service.TIME: ("time", "TIME", _time),
    Service.LSS_MASTER: ("lss", "LSS request", lambda frame: _Decoded(lss_text(frame.data, from_master=True))),
    Service.LSS_SLAVE: ("lss", "LSS response", lambda frame: _Decoded(lss_text(frame.data, from_master=False))),
}
