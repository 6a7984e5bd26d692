"""Layer setting services (LSS), master and slave (CiA 305).

Every LSS frame has 8 bytes: the command specifier, then little-endian parameters, then zeros. The master sends on
0x7E5; all slaves answer on 0x7E4 without identification. A service addresses either one slave by its identity
(0x1018), or several slaves whose answers are identical, so that they may collide.
"""

from __future__ import annotations

import enum
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, TypeAlias

from canopen_control.cia301.outbox import Outbox
from canopen_control.errors import LocalProtocolError, RemoteProtocolError
from canopen_control.frame import MAX_NODE_ID, CanFrame

if TYPE_CHECKING:
    from collections.abc import Callable, Generator

    _Service: TypeAlias = Generator["_Exchange", "bytes | None", "LssResult"]


MASTER_COB_ID = 0x7E5
SLAVE_COB_ID = 0x7E4
UNCONFIGURED = 0xFF  # value for "no node-ID" (CiA 305)
FAST_SCAN_START = 0x80  # bit number of the first fast scan request

# Bit timing table 0 (CiA 305): index to bit/s; index 5 is reserved.
BIT_TIMINGS: dict[int, int] = {
    0: 1_000_000,
    1: 800_000,
    2: 500_000,
    3: 250_000,
    4: 125_000,
    6: 50_000,
    7: 20_000,
    8: 10_000,
}
AUTOMATIC_BIT_TIMING = 9


class LssMode(enum.IntEnum):
    """States of an LSS slave, with the values of the service "switch state global"."""

    WAITING = 0
    CONFIGURATION = 1


class LssCommand(enum.IntEnum):
    """LSS command specifiers; in a group of four, add 0 to 3 for vendor, product, revision and serial number."""

    SWITCH_GLOBAL = 0x04
    CONFIGURE_NODE_ID = 0x11
    CONFIGURE_BIT_TIMING = 0x13
    ACTIVATE_BIT_TIMING = 0x15
    STORE = 0x17
    SWITCH_SELECTIVE = 0x40  # 0x40 vendor, 0x41 product, 0x42 revision, 0x43 serial number
    SWITCHED = 0x44
    IDENTIFY = 0x46  # 0x46 vendor, 0x47 product, 0x48/0x49 revision low/high, 0x4A/0x4B serial low/high
    IDENTIFY_NON_CONFIGURED = 0x4C
    IDENTIFIED = 0x4F
    IDENTIFIED_NON_CONFIGURED = 0x50
    FAST_SCAN = 0x51
    INQUIRE = 0x5A  # 0x5A vendor, 0x5B product, 0x5C revision, 0x5D serial number
    INQUIRE_NODE_ID = 0x5E


class LssRefused(RemoteProtocolError):
    """Refusal of an LSS service by a slave; `code` is 1 for an unsupported value, 2 for a storage failure.

    Other codes are manufacturer-specific.
    """

    def __init__(self, code: int, reason: str) -> None:
        self.code = code
        super().__init__(0, reason)


class LssIdentity(NamedTuple):
    """LSS address: the identity object 0x1018:01 to 0x1018:04."""

    vendor: int
    product: int
    revision: int
    serial: int


def lss_frame(command: int, value: int = 0, *, tail: bytes = b"", cob_id: int = MASTER_COB_ID) -> CanFrame:
    """Return a frame with a command, a 32-bit value and up to three more bytes."""
    head = bytes((command,)) + value.to_bytes(4, "little")
    return CanFrame(cob_id, (head + tail).ljust(8, b"\0"))


def bit_timing_index(bitrate: int) -> int | None:
    """Return the index of `bitrate` (bit/s) in bit timing table 0, or None if it is not in the table."""
    return next((index for index, table_bitrate in BIT_TIMINGS.items() if table_bitrate == bitrate), None)


LssResult: TypeAlias = int | LssIdentity | None
PART_NAMES = LssIdentity._fields
_REFUSALS = {1: "not supported or out of range", 2: "storing failed"}


class _Exchange(NamedTuple):
    """Frames to send as one step of a service, and the command specifier of the expected response (None: no wait).

    With `scan` the master waits for the whole scan time, because the answers of several slaves are identical and a late
    answer would be mistaken for the answer to the next request.
    """

    frames: list[CanFrame]
    answer: int | None
    scan: bool = False


@dataclass(slots=True, eq=False)
class LssRequest:
    """LSS service call; `result` is valid once it is `done` and `error` is None; the owner may use `context`."""

    name: str
    result: LssResult = None
    error: RemoteProtocolError | None = None
    done: bool = False
    context: object = None


@dataclass(slots=True)
class _Job:
    request: LssRequest
    service: _Service
    exchange: _Exchange | None = None
    deadline_ns: int = 0
    answer: bytes | None = None


class LssMaster:
    """Queue of LSS services, one of which uses the bus at a time; each call returns an `LssRequest` (CiA 305).

    A service is a generator that yields its requests and returns its result. A missing answer is an error if one slave
    must answer, and a result if the service checks whether a slave exists. `timeout_ns` is the time for an answer,
    `scan_timeout_ns` the time that all slaves have for each request of a scan. Requests are sent at the next `tick`;
    `events` returns the finished requests. Invalid arguments, and more than `queue_limit` waiting services, raise
    LocalProtocolError. `stray` counts answers without a request.
    """

    def __init__(
        self, *, timeout_ns: int = 500_000_000, scan_timeout_ns: int = 20_000_000, queue_limit: int = 64
    ) -> None:
        self.timeout_ns = timeout_ns
        self.scan_timeout_ns = scan_timeout_ns
        self.queue_limit = queue_limit
        self.stray = 0
        self._jobs: deque[_Job] = deque()
        self._frames: Outbox[CanFrame] = Outbox()
        self._events: Outbox[LssRequest] = Outbox()

    def switch_global(self, mode: LssMode) -> LssRequest:
        """Switch all slaves to `mode`; the service is unconfirmed."""
        return self._submit(f"switch all to {mode.name}", _report(lss_frame(LssCommand.SWITCH_GLOBAL, mode)))

    def switch_selective(self, identity: LssIdentity) -> LssRequest:
        """Switch the slave with this identity to configuration state."""
        frames = [lss_frame(LssCommand.SWITCH_SELECTIVE + part, value) for part, value in enumerate(identity)]
        return self._submit("switch one slave", _switch_selective("switch one slave", frames))

    def configure_node_id(self, node_id: int) -> LssRequest:
        """Set the node-ID of the slave in configuration state: 1 to 127, or 255 for none."""
        if not 1 <= node_id <= MAX_NODE_ID and node_id != UNCONFIGURED:
            msg = f"LSS: node-ID {node_id} is out of range, 1 to {MAX_NODE_ID} or {UNCONFIGURED}"
            raise LocalProtocolError(msg)
        return self._with_error_code(f"configure node-ID {node_id}", LssCommand.CONFIGURE_NODE_ID, node_id)

    def configure_bit_timing(self, index: int, table: int = 0) -> LssRequest:
        """Set the bit timing of the slave in configuration state; `index` is a key of `lss.BIT_TIMINGS` for table 0."""
        if not (0 <= index <= 0xFF and 0 <= table <= 0xFF):
            msg = f"LSS: bit timing {index} of table {table} does not fit into a byte"
            raise LocalProtocolError(msg)
        return self._with_error_code(
            f"configure bit timing {index}", LssCommand.CONFIGURE_BIT_TIMING, table | index << 8
        )

    def activate_bit_timing(self, delay_ms: int) -> LssRequest:
        """Switch all slaves in configuration state to their new bit timing; the service is unconfirmed.

        Each slave waits for `delay_ms`, switches, and stays silent for another `delay_ms`.
        """
        if not 0 <= delay_ms <= 0xFFFF:
            msg = f"LSS: a delay of {delay_ms} ms is out of range, 0 to 65535 ms"
            raise LocalProtocolError(msg)
        return self._submit("activate bit timing", _report(lss_frame(LssCommand.ACTIVATE_BIT_TIMING, delay_ms)))

    def store(self) -> LssRequest:
        """Store the node-ID and the bit timing in the slave in configuration state."""
        return self._with_error_code("store", LssCommand.STORE, 0)

    def inquire(self, part: str) -> LssRequest:
        """Read ``vendor``, ``product``, ``revision``, ``serial`` or ``node_id`` of the slave in configuration state."""
        commands = {name: LssCommand.INQUIRE + number for number, name in enumerate(PART_NAMES)}
        command = {**commands, "node_id": int(LssCommand.INQUIRE_NODE_ID)}.get(part)
        if command is None:
            msg = f"LSS: cannot inquire {part!r}; valid parts are {', '.join(commands)} and node_id"
            raise LocalProtocolError(msg)
        return self._submit(f"inquire {part}", _inquire(f"inquire {part}", command))

    def identify(self, low: LssIdentity, high: LssIdentity) -> LssRequest:
        """Check whether slaves exist in a range of identities.

        Vendor and product are those of `low`; revision and serial number may lie anywhere from `low` to `high`.
        """
        values = (low.vendor, low.product, low.revision, high.revision, low.serial, high.serial)
        frames = [lss_frame(LssCommand.IDENTIFY + step, value) for step, value in enumerate(values)]
        return self._submit("identify", _exists(frames, LssCommand.IDENTIFIED))

    def identify_non_configured(self) -> LssRequest:
        """Check whether slaves without a node-ID exist."""
        frames = [lss_frame(LssCommand.IDENTIFY_NON_CONFIGURED)]
        return self._submit("identify non-configured", _exists(frames, LssCommand.IDENTIFIED_NON_CONFIGURED))

    def open_fast_scan(self) -> LssRequest:
        """Send the first request of a fast scan: it detects slaves without a node-ID, and changes no state."""
        frames = [lss_frame(LssCommand.FAST_SCAN, tail=bytes((FAST_SCAN_START,)))]
        return self._submit("open fast scan", _exists(frames, LssCommand.IDENTIFIED))

    def fast_scan(
        self,
        *,
        vendor: int | None = None,
        product: int | None = None,
        revision: int | None = None,
        serial: int | None = None,
    ) -> LssRequest:
        """Find a slave without a node-ID and switch it to configuration state; the result is its identity or None.

        A known part is only confirmed, which saves 32 requests.
        """
        return self._submit("fast scan", _fast_scan((vendor, product, revision, serial)))

    def receive(self, frame: CanFrame, now: int) -> None:
        if frame.can_id != SLAVE_COB_ID:
            return
        job = self._jobs[0] if self._jobs else None
        exchange = None if job is None else job.exchange
        if job is None or exchange is None or len(frame.data) != 8 or frame.data[0] != exchange.answer:
            self.stray += 1
            return
        job.answer = frame.data
        if not exchange.scan:
            self._advance(job, now)

    def tick(self, now: int) -> None:
        """Send the next request, or stop waiting for a response when its time has elapsed."""
        if not self._jobs:
            return
        job = self._jobs[0]
        if job.exchange is None or now >= job.deadline_ns:
            self._advance(job, now)

    def next_deadline(self) -> int | None:
        """Return the time of the next request or timeout, 0 for now, or None if no service is waiting."""
        if not self._jobs:
            return None
        job = self._jobs[0]
        return 0 if job.exchange is None else job.deadline_ns

    def frames(self) -> list[CanFrame]:
        return self._frames.drain()

    def events(self) -> list[LssRequest]:
        return self._events.drain()

    def _with_error_code(self, name: str, command: int, value: int) -> LssRequest:
        return self._submit(name, _with_error_code(name, command, value))

    def _submit(self, name: str, service: _Service) -> LssRequest:
        if len(self._jobs) >= self.queue_limit:
            msg = f"LSS: {self.queue_limit} services are waiting already; wait until one has finished"
            raise LocalProtocolError(msg)
        request = LssRequest(name)
        self._jobs.append(_Job(request, service))
        return request

    def _advance(self, job: _Job, now: int) -> None:
        answer, job.answer = job.answer, None
        try:
            exchange = next(job.service) if job.exchange is None else job.service.send(answer)
            while exchange.answer is None:
                self._send(exchange)
                exchange = job.service.send(None)
        except StopIteration as stop:
            self._finish(job, stop.value, None, now)
        except RemoteProtocolError as error:
            self._finish(job, None, error, now)
        else:
            self._send(exchange)
            job.exchange = exchange
            job.deadline_ns = now + (self.scan_timeout_ns if exchange.scan else self.timeout_ns)

    def _send(self, exchange: _Exchange) -> None:
        for frame in exchange.frames:
            self._frames.put(frame)

    def _finish(self, job: _Job, result: LssResult, error: RemoteProtocolError | None, now: int) -> None:
        self._jobs.popleft()
        request = job.request
        request.result, request.error, request.done = result, error, True
        self._events.put(request)
        self.tick(now)


def _report(frame: CanFrame) -> _Service:
    yield _Exchange([frame], None)
    return None


def _confirmed(name: str, frames: list[CanFrame], answer: int) -> Generator[_Exchange, bytes | None, bytes]:
    data = yield _Exchange(frames, answer)
    if data is None:
        raise RemoteProtocolError(
            0, f"LSS {name}: no answer; check that one slave is connected and in the configuration state"
        )
    return data


def _switch_selective(name: str, frames: list[CanFrame]) -> _Service:
    yield from _confirmed(name, frames, LssCommand.SWITCHED)
    return None


def _with_error_code(name: str, command: int, value: int) -> _Service:
    data = yield from _confirmed(name, [lss_frame(command, value)], command)
    if data[1]:
        reason = _REFUSALS.get(data[1], f"error {data[1]}, manufacturer-specific code {data[2]}")
        raise LssRefused(data[1], f"LSS {name}: refused, {reason}")
    return None


def _inquire(name: str, command: int) -> _Service:
    data = yield from _confirmed(name, [lss_frame(command)], command)
    return data[1] if command == LssCommand.INQUIRE_NODE_ID else int.from_bytes(data[1:5], "little")


def _exists(frames: list[CanFrame], answer: int) -> _Service:
    return (yield _Exchange(frames, answer, scan=True)) is not None


def _fast_scan_step(number: int, bit: int, part: int, following: int) -> _Exchange:
    frame = lss_frame(LssCommand.FAST_SCAN, number, tail=bytes((bit, part, following)))
    return _Exchange([frame], LssCommand.IDENTIFIED, scan=True)


def _fast_scan(known_parts: tuple[int | None, ...]) -> _Service:
    if (yield _fast_scan_step(0, FAST_SCAN_START, 0, 0)) is None:
        return None
    parts: list[int] = []
    for part, known_part in enumerate(known_parts):
        number = known_part or 0
        for bit in range(31, -1, -1) if known_part is None else ():
            if (yield _fast_scan_step(number, bit, part, part)) is None:
                number |= 1 << bit  # no slave has a 0 at this bit
        if (yield _fast_scan_step(number, 0, part, (part + 1) % 4)) is None:
            name = PART_NAMES[part]
            raise RemoteProtocolError(0, f"LSS fast scan: no slave confirms {name} 0x{number:08X}; scan again")
        parts.append(number)
    return LssIdentity(*parts)


OK, REFUSED, STORE_FAILED = 0, 1, 2


@dataclass(frozen=True, slots=True)
class LssNodeIdAssigned:
    """Assignment of a node-ID to an unconfigured node, which must now initialise with it and send its boot-up."""

    node_id: int


@dataclass(frozen=True, slots=True)
class LssActivateBitTiming:
    """Activation of a bit timing: the node switches to `bitrate` after `delay_ms`, then is silent for `delay_ms`.

    `bitrate` is in bit/s, 0 for automatic detection.
    """

    bitrate: int
    delay_ms: int


class LssSlave:
    """LSS slave of one node; `node_id` is the active node-ID (255: none), `pending_node_id` the next one (CiA 305).

    The slave is in the waiting state until the master switches all slaves, selects this slave by its identity, or finds
    it by fast scan; then it is in the configuration state. An unconfigured node activates a new node-ID when it returns
    to waiting, any other node at its next reset communication. Frames that are not 8 bytes long or have an unknown
    command are counted in `malformed`; frames that are not valid in the current state are counted in `ignored`. `store`
    stores node-ID and bit rate (None: unchanged) and returns whether it succeeded; without `store` the service is
    refused as not supported. `bit_timings` are the supported indices of table 0.
    """

    def __init__(
        self,
        identity: LssIdentity,
        node_id: int = UNCONFIGURED,
        *,
        bit_timings: frozenset[int] = frozenset(BIT_TIMINGS),
        store: Callable[[int, int | None], bool] | None = None,
    ) -> None:
        self.identity = identity
        self.node_id = node_id
        self.pending_node_id = node_id
        self.pending_bitrate: int | None = None
        self.bit_timings = bit_timings
        self.store = store
        self.mode = LssMode.WAITING
        self.malformed = 0
        self.ignored = 0
        self._selected = 0  # number of identity parts matched by switch state selective
        self._identified = 0  # number of parts matched by identify remote slave
        self._scanned = 0  # part that fast scan compares next
        self.outgoing: Outbox[CanFrame] = Outbox()
        self._events: Outbox[LssNodeIdAssigned | LssActivateBitTiming] = Outbox()

    def reset(self) -> None:
        """Activate the pending node-ID and return to waiting (NMT reset communication)."""
        self.node_id = self.pending_node_id
        self.mode = LssMode.WAITING
        self._selected = self._identified = self._scanned = 0

    def receive(self, frame: CanFrame, now: int) -> None:  # noqa: ARG002 - the verb of every core
        if frame.can_id != MASTER_COB_ID:
            return
        # CiA 305: every frame has 8 bytes
        command = frame.data[0] if len(frame.data) == 8 else -1
        if (service := self._SERVICES.get(command)) is not None:
            service(self, frame.data)
        elif (service := self._CONFIGURING.get(command)) is None:
            self.malformed += 1
        # CiA 305: configuration and inquiry services need the configuration state
        elif self.mode is LssMode.CONFIGURATION:
            service(self, frame.data)
        else:
            self.ignored += 1

    def tick(self, now: int) -> None:
        """Do nothing; this core has no timers."""

    def next_deadline(self) -> None: ...

    def frames(self) -> list[CanFrame]:
        return self.outgoing.drain()

    def events(self) -> list[LssNodeIdAssigned | LssActivateBitTiming]:
        return self._events.drain()

    def _answer(self, command: int, value: int = 0) -> None:
        self.outgoing.put(lss_frame(command, value, cob_id=SLAVE_COB_ID))

    def _switch_global(self, data: bytes) -> None:
        if data[1] == LssMode.CONFIGURATION:
            self.mode = LssMode.CONFIGURATION
        elif data[1] == LssMode.WAITING:
            self._leave_configuration()
        else:
            self.ignored += 1

    def _leave_configuration(self) -> None:
        was_configuring, self.mode = self.mode is LssMode.CONFIGURATION, LssMode.WAITING
        # CiA 305: an unconfigured node starts with its new node-ID when it leaves the configuration state
        if was_configuring and self.node_id == UNCONFIGURED != self.pending_node_id:
            self.node_id = self.pending_node_id
            self._events.put(LssNodeIdAssigned(self.node_id))

    def _switch_selective(self, data: bytes) -> None:
        # CiA 305: vendor, product, revision and serial number in this order select the slave
        part = data[0] - LssCommand.SWITCH_SELECTIVE
        if part == 0:
            self._selected = 0
        matches = part == self._selected and _number(data) == self.identity[part]
        self._selected = part + 1 if matches else 0
        if self._selected == 4:
            self._selected = 0
            self.mode = LssMode.CONFIGURATION
            self._answer(LssCommand.SWITCHED)

    def _configure_node_id(self, data: bytes) -> None:
        # CiA 305: node-ID 1 to 127, or 255 for an unconfigured node
        accepted = 1 <= data[1] <= MAX_NODE_ID or data[1] == UNCONFIGURED
        if accepted:
            self.pending_node_id = data[1]
        self._answer(LssCommand.CONFIGURE_NODE_ID, OK if accepted else REFUSED)

    def _configure_bit_timing(self, data: bytes) -> None:
        # CiA 305: table 0 holds the standard bit timings
        accepted = data[1] == 0 and data[2] in self.bit_timings
        if accepted:
            self.pending_bitrate = 0 if data[2] == AUTOMATIC_BIT_TIMING else BIT_TIMINGS[data[2]]
        self._answer(LssCommand.CONFIGURE_BIT_TIMING, OK if accepted else REFUSED)

    def _activate_bit_timing(self, data: bytes) -> None:
        if self.pending_bitrate is None:
            self.ignored += 1
        else:
            self._events.put(LssActivateBitTiming(self.pending_bitrate, data[1] | data[2] << 8))

    def _store(self, data: bytes) -> None:
        if self.store is None:
            self._answer(data[0], REFUSED)
        else:
            self._answer(data[0], OK if self.store(self.pending_node_id, self.pending_bitrate) else STORE_FAILED)

    def _inquire(self, data: bytes) -> None:
        self._answer(data[0], self.identity[data[0] - LssCommand.INQUIRE])

    def _inquire_node_id(self, data: bytes) -> None:
        self._answer(data[0], self.node_id)

    def _identify(self, data: bytes) -> None:
        # CiA 305: vendor and product must be equal, revision and serial number within their ranges
        step, number = data[0] - LssCommand.IDENTIFY, _number(data)
        vendor, product, revision, serial = self.identity
        matches = (
            number == vendor,
            number == product,
            number <= revision,
            number >= revision,
            number <= serial,
            number >= serial,
        )[step]
        if step == 0:
            self._identified = 0
        self._identified = step + 1 if matches and step == self._identified else 0
        if self._identified == 6:
            self._identified = 0
            self._answer(LssCommand.IDENTIFIED)

    def _identify_non_configured(self, _data: bytes) -> None:
        if self.pending_node_id == UNCONFIGURED:
            self._answer(LssCommand.IDENTIFIED_NON_CONFIGURED)

    def _fast_scan(self, data: bytes) -> None:
        # CiA 305: only unconfigured nodes in the waiting state take part in a fast scan
        bit, part, following = data[5], data[6], data[7]
        if self.mode is not LssMode.WAITING or self.pending_node_id != UNCONFIGURED:
            return
        if bit == FAST_SCAN_START:
            self._scanned = 0
            self._answer(LssCommand.IDENTIFIED)
        elif bit > 31 or part > 3 or following > 3:
            self.ignored += 1
        elif part == self._scanned and (_number(data) ^ self.identity[part]) >> bit == 0:
            self._scanned = following
            if bit == 0 and following < part:
                self.mode = LssMode.CONFIGURATION
            self._answer(LssCommand.IDENTIFIED)

    _SERVICES: ClassVar[dict[int, Callable[[Any, bytes], None]]] = {
        LssCommand.SWITCH_GLOBAL: _switch_global,
        LssCommand.IDENTIFY_NON_CONFIGURED: _identify_non_configured,
        LssCommand.FAST_SCAN: _fast_scan,
        **dict.fromkeys(range(LssCommand.SWITCH_SELECTIVE, LssCommand.SWITCH_SELECTIVE + 4), _switch_selective),
        **dict.fromkeys(range(LssCommand.IDENTIFY, LssCommand.IDENTIFY + 6), _identify),
    }
    """Handlers of the services that are available in both states."""
    _CONFIGURING: ClassVar[dict[int, Callable[[Any, bytes], None]]] = {
        LssCommand.CONFIGURE_NODE_ID: _configure_node_id,
        LssCommand.CONFIGURE_BIT_TIMING: _configure_bit_timing,
        LssCommand.ACTIVATE_BIT_TIMING: _activate_bit_timing,
        LssCommand.STORE: _store,
        LssCommand.INQUIRE_NODE_ID: _inquire_node_id,
        **dict.fromkeys(range(LssCommand.INQUIRE, LssCommand.INQUIRE + 4), _inquire),
    }
    """Handlers of the services that are available only in the configuration state."""


def _number(data: bytes) -> int:
    return int.from_bytes(data[1:5], "little")
