"""The LSS master: a queue of services, one at a time on the bus (CiA 305, 3.9).

A service is a generator that asks (frames out, then an answer or silence) and returns its result. Silence is an error
where one slave must answer, and a result where the question was whether there is one. While scanning every question
waits its whole time, because the answers of several slaves are equal and a late one would answer the next question.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

from canopen_control.cia301.lss import (
    FAST_SCAN_START,
    SLAVE_COB_ID,
    UNCONFIGURED,
    LssCommand,
    LssIdentity,
    LssMode,
    lss_frame,
)
from canopen_control.cia301.outbox import Outbox
from canopen_control.errors import LocalProtocolError, RemoteProtocolError
from canopen_control.frame import MAX_NODE_ID

if TYPE_CHECKING:
    from collections.abc import Generator

    from canopen_control.frame import CanFrame

__all__ = ["LssMaster", "LssRequest", "LssResult"]

LssResult: TypeAlias = int | LssIdentity | None
PART_NAMES = LssIdentity._fields
_REFUSALS = {1: "not supported or out of range", 2: "storing failed"}


class _Ask(NamedTuple):
    """Send `frames`, then wait for the command `answer` (None: for nothing); `scan`: to the end of the scan time."""

    frames: list[CanFrame]
    answer: int | None
    scan: bool = False


if TYPE_CHECKING:
    _Service: TypeAlias = Generator[_Ask, bytes | None, LssResult]


@dataclass(slots=True, eq=False)
class LssRequest:
    """One service: `result` when `done` without `error`; `context` is free for the owner."""

    name: str
    result: LssResult = None
    error: RemoteProtocolError | None = None
    done: bool = False
    context: object = None


@dataclass(slots=True)
class _Job:
    request: LssRequest
    service: _Service
    ask: _Ask | None = None
    deadline_ns: int = 0
    answer: bytes | None = None


class LssMaster:
    """Runs LSS services in the order of the calls; each call returns its `LssRequest`, `events` tells finished ones.

    `timeout_ns` is what a slave has for an answer, `scan_timeout_ns` what all slaves have for each question of a scan.
    Questions are asked at the next `tick`. LocalProtocolError for arguments the protocol cannot carry and when
    `queue_limit` services wait. `stray` counts answers nobody waits for.
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
        """Switch all slaves; unconfirmed."""
        return self._submit(f"switch all to {mode.name}", _tell(lss_frame(LssCommand.SWITCH_GLOBAL, mode)))

    def switch_selective(self, identity: LssIdentity) -> LssRequest:
        """Switch the slave of this identity to configuration."""
        frames = [lss_frame(LssCommand.SWITCH_SELECTIVE + part, value) for part, value in enumerate(identity)]
        return self._submit("switch one slave", _switch_selective("switch one slave", frames))

    def configure_node_id(self, node_id: int) -> LssRequest:
        """Give the slave in configuration a node id, 1 to 127, or 255: none."""
        if not 1 <= node_id <= MAX_NODE_ID and node_id != UNCONFIGURED:
            msg = f"LSS: node id {node_id} is not 1 to {MAX_NODE_ID} or {UNCONFIGURED}"
            raise LocalProtocolError(msg)
        return self._coded(f"configure node id {node_id}", LssCommand.CONFIGURE_NODE_ID, node_id)

    def configure_bit_timing(self, index: int, table: int = 0) -> LssRequest:
        """Set the bit timing of the slave in configuration, an index of `lss.BIT_TIMINGS`."""
        if not (0 <= index <= 0xFF and 0 <= table <= 0xFF):
            msg = f"LSS: bit timing {index} of table {table} does not fit into a byte"
            raise LocalProtocolError(msg)
        return self._coded(f"configure bit timing {index}", LssCommand.CONFIGURE_BIT_TIMING, table | index << 8)

    def activate_bit_timing(self, delay_ms: int) -> LssRequest:
        """Let all slaves in configuration switch after `delay_ms` and be silent as long again; unconfirmed."""
        if not 0 <= delay_ms <= 0xFFFF:
            msg = f"LSS: a delay of {delay_ms} ms is not 0 to 65535"
            raise LocalProtocolError(msg)
        return self._submit("activate bit timing", _tell(lss_frame(LssCommand.ACTIVATE_BIT_TIMING, delay_ms)))

    def store(self) -> LssRequest:
        """Let the slave in configuration keep node id and bit timing."""
        return self._coded("store", LssCommand.STORE, 0)

    def inquire(self, part: str) -> LssRequest:
        """Ask the slave in configuration for ``vendor``, ``product``, ``revision``, ``serial`` or ``node_id``."""
        commands = {name: LssCommand.INQUIRE + number for number, name in enumerate(PART_NAMES)}
        command = {**commands, "node_id": int(LssCommand.INQUIRE_NODE_ID)}.get(part)
        if command is None:
            msg = f"LSS: cannot inquire {part!r}; there are {', '.join(commands)} and node_id"
            raise LocalProtocolError(msg)
        return self._submit(f"inquire {part}", _inquire(f"inquire {part}", command))

    def identify(self, low: LssIdentity, high: LssIdentity) -> LssRequest:
        """Ask whether there are slaves of `low`'s vendor and product, revision and serial number from low to high."""
        values = (low.vendor, low.product, low.revision, high.revision, low.serial, high.serial)
        frames = [lss_frame(LssCommand.IDENTIFY + step, value) for step, value in enumerate(values)]
        return self._submit("identify", _exists(frames, LssCommand.IDENTIFIED))

    def identify_non_configured(self) -> LssRequest:
        """Ask whether there are slaves without a node id."""
        frames = [lss_frame(LssCommand.IDENTIFY_NON_CONFIGURED)]
        return self._submit("identify non-configured", _exists(frames, LssCommand.IDENTIFIED_NON_CONFIGURED))

    def fast_scan(
        self,
        *,
        vendor: int | None = None,
        product: int | None = None,
        revision: int | None = None,
        serial: int | None = None,
    ) -> LssRequest:
        """Find one slave without a node id and switch it to configuration; the result is its identity, None: none.

        Parts given are only confirmed, which saves 32 questions each.
        """
        return self._submit("fast scan", _fast_scan((vendor, product, revision, serial)))

    def receive(self, frame: CanFrame, now: int) -> None:
        """Take an answer; other frames are ignored."""
        if frame.can_id != SLAVE_COB_ID:
            return
        job = self._jobs[0] if self._jobs else None
        ask = None if job is None else job.ask
        if job is None or ask is None or len(frame.data) != 8 or frame.data[0] != ask.answer:
            self.stray += 1
            return
        job.answer = frame.data
        if not ask.scan:
            self._advance(job, now)

    def tick(self, now: int) -> None:
        """Ask the next question, or take silence for the answer."""
        if not self._jobs:
            return
        job = self._jobs[0]
        if job.ask is None or now >= job.deadline_ns:
            self._advance(job, now)

    def next_deadline(self) -> int | None:
        """Return when `tick` has something to do; 0 means at once."""
        if not self._jobs:
            return None
        job = self._jobs[0]
        return 0 if job.ask is None else job.deadline_ns

    def frames(self) -> list[CanFrame]:
        """Drain the questions to send."""
        return self._frames.drain()

    def events(self) -> list[LssRequest]:
        """Drain the finished requests."""
        return self._events.drain()

    def _coded(self, name: str, command: int, value: int) -> LssRequest:
        return self._submit(name, _coded(name, command, value))

    def _submit(self, name: str, service: _Service) -> LssRequest:
        if len(self._jobs) >= self.queue_limit:
            msg = f"LSS: {self.queue_limit} services wait already; let the queue drain first"
            raise LocalProtocolError(msg)
        request = LssRequest(name)
        self._jobs.append(_Job(request, service))
        return request

    def _advance(self, job: _Job, now: int) -> None:
        answer, job.answer = job.answer, None
        try:
            ask = next(job.service) if job.ask is None else job.service.send(answer)
            while ask.answer is None:
                self._send(ask)
                ask = job.service.send(None)
        except StopIteration as stop:
            self._finish(job, stop.value, None, now)
        except RemoteProtocolError as error:
            self._finish(job, None, error, now)
        else:
            self._send(ask)
            job.ask = ask
            job.deadline_ns = now + (self.scan_timeout_ns if ask.scan else self.timeout_ns)

    def _send(self, ask: _Ask) -> None:
        for frame in ask.frames:
            self._frames.put(frame)

    def _finish(self, job: _Job, result: LssResult, error: RemoteProtocolError | None, now: int) -> None:
        self._jobs.popleft()
        request = job.request
        request.result, request.error, request.done = result, error, True
        self._events.put(request)
        self.tick(now)


def _tell(frame: CanFrame) -> _Service:
    yield _Ask([frame], None)
    return None


def _confirmed(name: str, frames: list[CanFrame], answer: int) -> Generator[_Ask, bytes | None, bytes]:
    data = yield _Ask(frames, answer)
    if data is None:
        raise RemoteProtocolError(0, f"LSS {name}: no answer; is a slave there, and in configuration?")
    return data


def _switch_selective(name: str, frames: list[CanFrame]) -> _Service:
    yield from _confirmed(name, frames, LssCommand.SWITCHED)
    return None


def _coded(name: str, command: int, value: int) -> _Service:
    data = yield from _confirmed(name, [lss_frame(command, value)], command)
    if data[1]:
        reason = _REFUSALS.get(data[1], f"error {data[1]}, manufacturer's {data[2]}")
        raise RemoteProtocolError(0, f"LSS {name}: refused, {reason}")
    return None


def _inquire(name: str, command: int) -> _Service:
    data = yield from _confirmed(name, [lss_frame(command)], command)
    return data[1] if command == LssCommand.INQUIRE_NODE_ID else int.from_bytes(data[1:5], "little")


def _exists(frames: list[CanFrame], answer: int) -> _Service:
    return (yield _Ask(frames, answer, scan=True)) is not None


def _question(number: int, bit: int, part: int, following: int) -> _Ask:
    frame = lss_frame(LssCommand.FAST_SCAN, number, tail=bytes((bit, part, following)))
    return _Ask([frame], LssCommand.IDENTIFIED, scan=True)


def _fast_scan(known: tuple[int | None, ...]) -> _Service:
    if (yield _question(0, FAST_SCAN_START, 0, 0)) is None:
        return None
    found: list[int] = []
    for part, given in enumerate(known):
        number = given or 0
        for bit in range(31, -1, -1) if given is None else ():
            if (yield _question(number, bit, part, part)) is None:
                number |= 1 << bit  # nobody has a 0 there
        if (yield _question(number, 0, part, (part + 1) % 4)) is None:
            name = PART_NAMES[part]
            raise RemoteProtocolError(0, f"LSS fast scan: no slave confirms {name} 0x{number:08X}; scan again")
        found.append(number)
    return LssIdentity(*found)
