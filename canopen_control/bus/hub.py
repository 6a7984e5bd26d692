"""The hub process of a ``local:`` bus: sockets around `exchange.Exchange`, and the control socket.

``python -m canopen_control.bus.hub NAME`` serves two sockets. On the first, each end greets (`hello`), then sends and
receives records; one read and one write a turn for each end, however many frames, and none of them can make the hub
wait. On the second it is asked and told what `rpc.messages.hub` declares (`hubcontrol`). Two seconds after the last end
has left, the hub is gone.

It imports little, so that it is there at once: what the control socket needs (msgspec: a third as long again) comes
right after the first end was greeted, while that one prepares what it will send, or when somebody asks before.
"""

from __future__ import annotations

import functools
import heapq
import os
import signal
import socket
import sys
from typing import TYPE_CHECKING, Final, NoReturn, TypeVar

from canopen_control.bus import error_frames
from canopen_control.bus.arbitration import PacedWire
from canopen_control.bus.error_frames import bus_off_frame, has_error_frames, overrun_frame, restarted_frame
from canopen_control.bus.wanted import (
    GIVES_STAMPS,
    MARK,
    STAMP_STEP_NS,
    TAKES_WANTED,
    Hello,
    HelloServer,
    Wanted,
    own_stamp,
    pack_hello,
    pack_stamp,
)
from canopen_control.bus.wire_faults import DropRule, WireFaults
from canopen_control.errors import CanopenError, ConfigError
from canopen_control.frame import ERROR_FLAG, RECORD, RECORD_SIZE, CanFrame, pack_records
from canopen_control.host.lifeline import report_failure, report_ready
from canopen_control.host.reactor import Reactor
from canopen_control.host.sockets import close_listener, listen, lock, socket_path
from canopen_control.rpc.messages import hub
from canopen_control.rpc.messages.declare import PROTOCOL, Done, Request
from canopen_control.rpc.server import Call, Server

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from canopen_control.host.timer import Timer


# The control socket of a hub: answers the requests of `rpc.messages.hub` about one `Exchange`.
#
# Its import costs more than all else of a hub, msgspec first of all: the hub does it when nobody waits for frames.


R = TypeVar("R", bound=Request[Done])
_NS_PER_MS: Final = 1_000_000

ERROR_FRAMES: Final[Mapping[hub.ErrorKind, Callable[[], CanFrame]]] = {
    "bus-error": error_frames.protocol_error_frame,
    "error-passive": error_frames.passive_frame,
    "error-active": error_frames.active_frame,
    "overrun": lambda: error_frames.overrun_frame(0),
}


class HubControl:
    """Serves the bus `name` on the socket that `listener` is of.

    `started` is the reactor's time when the hub was; `after` is called when the exchange may have something to send.
    """

    def __init__(
        self,
        name: str,
        exchange: Exchange,
        reactor: Reactor,
        listener: socket.socket,
        *,
        started: int,
        after: Callable[[], None],
    ) -> None:
        self._name, self._exchange, self._now, self._after = name, exchange, reactor.now, after
        self._started = started
        path = socket_path("busctl", name)
        self._server: Server[hub.HubHello, NoReturn] = Server(hub.HUB, reactor, path, self._hello, listener=listener)
        self._server.answers(hub.GetHubStatus, lambda call: call.reply(self._status()))
        self._answer_faults()
        self._server.check()

    def close(self) -> None:
        """End all connections and remove the socket; a second call does nothing."""
        self._server.close()

    def _hello(self) -> hub.HubHello:
        return hub.HubHello(self._name, PROTOCOL, os.getpid())

    def _answer_faults(self) -> None:
        exchange, label = self._exchange, self._label
        self._does(hub.Cut, lambda asked: exchange.cut(label(asked.label)))
        self._does(hub.Uncut, lambda asked: exchange.cut(label(asked.label), mend=True))
        self._does(hub.BusOff, lambda asked: exchange.bus_off(label(asked.label)))
        self._does(hub.Restart, lambda asked: exchange.bus_off(label(asked.label), restart=True))
        self._does(hub.SendErrorFrame, lambda asked: exchange.report(self._anybody(asked.label), _frame(asked)))
        self._does(hub.DropFrames, self._drop)
        self._does(hub.DelayFrames, self._delay)
        self._does(hub.SetBitrate, lambda asked: exchange.pace(asked.bitrate, self._now()))
        self._does(hub.ClearFaults, lambda _asked: exchange.clear_faults())

    def _does(self, kind: type[R], do: Callable[[R], object]) -> None:
        def handle(call: Call[R]) -> None:
            self._exchange.tick(self._now())  # what was due before is done before
            do(call.request)
            self._after()
            call.reply(Done())

        self._server.answers(kind, handle)

    def _label(self, label: str) -> str:
        """Return a label that somebody has or whose wires are faulty; ConfigError for any other."""
        faults = self._exchange.faults
        known = [member.label for member in self._exchange.members.values()]
        if label in known or faults.silences(label) or label in faults.delays:
            return label
        raise ConfigError(f"nobody called {label!r} on local:{self._name}; there are: {', '.join(known) or 'none'}")

    def _anybody(self, label: str) -> str:
        return self._label(label) if label else ""

    def _drop(self, asked: hub.DropFrames) -> None:
        rule = DropRule(self._anybody(asked.label), asked.can_id, asked.every, asked.count)
        self._exchange.faults.drops.append(rule)

    def _delay(self, asked: hub.DelayFrames) -> None:
        self._exchange.faults.delay(self._anybody(asked.label), asked.ms * _NS_PER_MS)

    def _status(self) -> hub.HubStatus:
        exchange, faults, now = self._exchange, self._exchange.faults, self._now()
        return hub.HubStatus(
            bus=self._name,
            pid=os.getpid(),
            uptime_s=(now - self._started) / 1e9,
            bitrate=None if exchange.wire is None else exchange.wire.bitrate,
            load=exchange.load(now),
            frames=exchange.frames,
            dropped=exchange.dropped,
            members=[_member(each) for each in exchange.members.values()],
            cut=sorted(faults.cut),
            bus_off=sorted(faults.bus_off),
            delays_ms={label: delay / _NS_PER_MS for label, delay in faults.delays.items()},
            drops=[_drop_state(rule) for rule in faults.drops],
        )


def _frame(asked: hub.SendErrorFrame) -> CanFrame:
    return ERROR_FRAMES[asked.kind]()


def _member(member: Member) -> hub.Member:
    queued = len(member.outbox) // RECORD_SIZE
    return hub.Member(member.label, member.pid, member.rx, member.tx, member.lost, queued)


def _drop_state(rule: DropRule) -> hub.DropState:
    return hub.DropState(rule.label, rule.can_id, rule.every, rule.count, rule.seen, rule.lost)


# The routing core of a ``local:`` bus's hub: members, and which bytes go to whom. No sockets, no clock.
#
# Rule 1: a frame reaches everybody but its sender, and frames of one sender stay in order. Rule 2: nobody waits for
# anybody: a reader whose queue is full loses its own frames, and finds an error frame with their number where they are
# missing. Rule 3: bytes come in any split; only whole records go out. Rule 4: without faults and bit rate there is no
# work per frame, only per chunk: who has said what he wants to hear is left in peace by chunks that hold nothing of
# that, and gets any other as a whole. Rule 5: a chunk has one time, that of its arrival or of its last bit on a paced
# wire; who has asked for stamps gets it before the chunk, the same as everybody else, and none is as early as the one
# before.


QUEUE_LIMIT = 16384 * RECORD_SIZE
"""Bytes that wait for one reader, beside what the kernel holds for it."""
BACKLOG_LIMIT = 256
"""Frames of one sender that wait for a paced wire before it is read no more."""
DELAY_LIMIT = 65536
"""Chunks of frames that a delay may hold back."""


class Member:
    """One opened end; counters are in frames and from its own point of view."""

    __slots__ = ("label", "lost", "missed", "number", "outbox", "partial", "pid", "rx", "silent", "tx", "wanted")

    def __init__(self, number: int, label: str, pid: int) -> None:
        self.number, self.label, self.pid = number, label, pid
        self.rx = self.tx = self.lost = 0
        self.missed = 0  # lost and not told yet
        self.silent = False
        self.partial = b""
        self.outbox = bytearray()
        self.wanted = Wanted()


class Exchange:
    """One bus. The owner writes the `outbox` of each member in `dirty` and says with `sent` how much went."""

    def __init__(self, *, limit: int = QUEUE_LIMIT) -> None:
        self.members: dict[int, Member] = {}
        self.faults = WireFaults()
        self.frames = 0
        self.dropped = 0
        self.dirty: list[Member] = []
        self.wire: PacedWire | None = None
        self._limit = limit
        self._next_number = 1
        self._delayed: list[tuple[int, int, int, bytes]] = []  # due, serial, sender's number, records
        self._last_due: dict[int, int] = {}
        self._serial = 0
        self._now = 0  # of the last chunk or tick
        self._stamping = False  # whether anybody has asked for stamps
        self._next_stamp = 0

    # Members -------------------------------------------------------------------------------------------------------

    def join(self, label: str, pid: int) -> Member:
        """Add an end; its label is made unique."""
        number, self._next_number = self._next_number, self._next_number + 1
        member = Member(number, self._unique(label or f"pid-{pid}"), pid)
        member.silent = self.faults.silences(member.label)
        self.members[number] = member
        return member

    def _unique(self, label: str) -> str:
        taken = {member.label for member in self.members.values()}
        name, number = label, 1
        while name in taken:
            number += 1
            name = f"{label}-{number}"
        return name

    def leave(self, member: Member) -> None:
        """Remove an end; what it sent before still travels, except what waits for the wire."""
        self.members.pop(member.number, None)
        self._stamping = any(each.wanted.stamps for each in self.members.values())
        self._last_due.pop(member.number, None)
        if self.wire is not None:
            self.wire.forget(member.number)

    def labelled(self, label: str) -> list[Member]:
        """Return the ends with this label, all of them for ""."""
        return [member for member in self.members.values() if label in ("", member.label)]

    # Frames --------------------------------------------------------------------------------------------------------

    def receive(self, member: Member, data: bytes, now: int) -> None:
        """Take bytes from an end, in any split."""
        self._now = now
        if member.partial:
            data = member.partial + data
            member.partial = b""
        if excess := len(data) % RECORD_SIZE:
            member.partial = data[-excess:]
            data = data[:-excess]
        if MARK in data:
            data = member.wanted.take(data)
            self._stamping = self._stamping or member.wanted.stamps
        if not data:
            return
        member.tx += len(data) // RECORD_SIZE
        if member.silent:
            self._lose(member, data)
        elif self.faults.active or self._delayed:
            self._with_faults(member, data, now)
        else:
            self._transmit(member.number, data, now)

    def _lose(self, member: Member, records: bytes) -> None:
        count = len(records) // RECORD_SIZE
        member.lost += count
        self.dropped += count

    def _with_faults(self, member: Member, records: bytes, now: int) -> None:
        kept = self.faults.survivors(member.label, records)
        self.dropped += (len(records) - len(kept)) // RECORD_SIZE
        # Never before what is under way already: one sender's frames stay in order when its delay shrinks.
        due = max(now + self.faults.delay_of(member.label), self._last_due.get(member.number, 0))
        if not kept:
            return
        if due <= now:
            self._transmit(member.number, kept, now)
            return
        if len(self._delayed) >= DELAY_LIMIT:
            self._lose(member, kept)
            return
        self._last_due[member.number] = due
        self._serial += 1
        heapq.heappush(self._delayed, (due, self._serial, member.number, kept))

    def _transmit(self, sender: int, records: bytes, now: int) -> None:
        if self.wire is None:
            self._deliver(sender, records, now)
            return
        self._advance(now)
        reports, frames = _split_reports(records)
        if reports:
            self._deliver(sender, reports, now)
        if frames:
            self.wire.put(sender, frames, now)

    def _deliver(self, sender: int, records: bytes, at: int) -> None:
        self.frames += len(records) // RECORD_SIZE
        can_ids: list[int] | None = None
        stamp = self._stamp(records, at) if self._stamping else b""
        for number, member in self.members.items():
            if number == sender:
                if stamp and member.wanted.echoes and not member.silent:
                    self._put(member, records, own_stamp(stamp))
                continue
            if member.silent:
                continue
            wanted = member.wanted.ids
            if wanted is not None:
                if can_ids is None:
                    can_ids = _plain_ids(records)
                if can_ids and wanted.isdisjoint(can_ids):
                    continue
            self._put(member, records, stamp)

    def _stamp(self, records: bytes, at: int) -> bytes:
        """Return the stamp of a chunk, which is later than the last frame of the chunk before."""
        if at < self._next_stamp:
            at = self._next_stamp
        self._next_stamp = at + len(records) // RECORD_SIZE * STAMP_STEP_NS
        return pack_stamp(at)

    def _put(self, member: Member, records: bytes, stamp: bytes) -> None:
        outbox = member.outbox
        if member.missed or len(outbox) + len(records) > self._limit:
            records = self._squeeze(member, records)
            if not records:
                return
        if not outbox:
            self.dirty.append(member)
        if stamp and member.wanted.stamps:
            outbox += stamp
        outbox += records
        member.rx += len(records) // RECORD_SIZE

    def _squeeze(self, member: Member, records: bytes) -> bytes:
        """Return the records that still fit; the rest is lost and counted. Once one is lost, so is all that follows."""
        room = 0 if member.missed else max(0, self._limit - len(member.outbox)) // RECORD_SIZE * RECORD_SIZE
        lost = (len(records) - room) // RECORD_SIZE
        member.missed += lost
        member.lost += lost
        return records[:room]

    def sent(self, member: Member, size: int) -> None:
        """Note that the first `size` bytes of the outbox are written; a reader that catches up learns what it lost."""
        outbox = member.outbox
        if size == len(outbox):
            outbox.clear()
        else:
            del outbox[:size]
        if member.missed and len(outbox) <= self._limit // 2:
            self._append(member, overrun_frame(member.missed))
            member.missed = 0

    def _append(self, member: Member, frame: CanFrame) -> None:
        if not member.outbox:
            self.dirty.append(member)
        record = pack_records([frame])
        if member.wanted.stamps:
            member.outbox += self._stamp(record, self._now)
        member.outbox += record

    def take_dirty(self) -> list[Member]:
        """Return the ends whose outbox was empty and is not now, each once."""
        dirty, self.dirty = self.dirty, []
        return dirty

    # Time ----------------------------------------------------------------------------------------------------------

    def tick(self, now: int) -> None:
        """Deliver what is due."""
        self._now = now
        while self._delayed and self._delayed[0][0] <= now:
            due, _serial, sender, records = heapq.heappop(self._delayed)
            self._transmit(sender, records, due)
        self._advance(now)

    def _advance(self, now: int) -> None:
        wire = self.wire
        while wire is not None and (due := wire.due_ns) is not None and due <= now:
            if (passed := wire.finish()) is not None:
                _, sender, _, record = passed
                self._deliver(sender, record, due)

    def next_deadline(self) -> int | None:
        """Return when `tick` has something to do."""
        due = [self._delayed[0][0]] if self._delayed else []
        wire = self.wire.next_deadline() if self.wire is not None else None
        return min([*due, wire] if wire is not None else due, default=None)

    def may_read(self, member: Member) -> bool:
        """Whether to read from this end: a paced wire that is behind pushes back on its senders."""
        return self.wire is None or self.wire.backlog(member.number) < BACKLOG_LIMIT

    # Control -------------------------------------------------------------------------------------------------------

    def pace(self, bitrate: int | None, now: int) -> None:
        """Set the bit rate in bit/s; None or 0 ends pacing, and what waits goes out at once."""
        old, self.wire = self.wire, PacedWire(bitrate) if bitrate else None
        if old is not None:
            for sender, record in old.drain():
                self._transmit(sender, record, now)

    def load(self, now: int) -> float | None:
        """Return the busy share of the wire in the last second; None without a bit rate."""
        return None if self.wire is None else self.wire.load(now)

    def cut(self, label: str, *, mend: bool = False) -> None:
        """Cut, or mend, the cable of a label: nothing comes from it or gets there, and nobody is told."""
        (self.faults.cut.discard if mend else self.faults.cut.add)(label)
        self._refresh()

    def bus_off(self, label: str, *, restart: bool = False) -> None:
        """Send the controllers of a label off the bus, or restart them; an error frame tells them."""
        (self.faults.bus_off.discard if restart else self.faults.bus_off.add)(label)
        self._refresh()
        self.report(label, restarted_frame() if restart else bus_off_frame())

    def report(self, label: str, frame: CanFrame) -> None:
        """Hand a frame, such as an error frame, to the ends of one label ("" for all)."""
        for member in self.labelled(label):
            self._append(member, frame)

    def clear_faults(self) -> None:
        """Mend everything; those that were bus-off are told of the restart."""
        restarted = self.faults.bus_off
        self.faults = WireFaults()
        self._refresh()
        for label in restarted:
            self.report(label, restarted_frame())

    def _refresh(self) -> None:
        for member in self.members.values():
            member.silent = self.faults.silences(member.label)


def _plain_ids(records: bytes) -> list[int]:
    """Return the identifiers of records; none where one has a flag: it may be an error frame, which everybody gets."""
    return [] if has_error_frames(records) else memoryview(records).cast("I")[:: RECORD_SIZE // 4].tolist()


def _split_reports(records: bytes) -> tuple[bytes, bytes]:
    """Part error frames, which never are on a wire, from the frames."""
    parts: Iterable[bytes] = (records[at : at + RECORD_SIZE] for at in range(0, len(records), RECORD_SIZE))
    reports, frames = b"", b""
    for record in parts:
        if RECORD.unpack(record)[0] & ERROR_FLAG:
            reports += record
        else:
            frames += record
    return reports, frames


LINGER_NS: Final = 2_000_000_000
_RETRY_NS: Final = 50_000_000
_READ_SIZE: Final = 65536
_BUFFER_SIZE: Final = 1 << 20


class _End:
    """The connection of a member of the exchange."""

    __slots__ = ("member", "reading", "socket", "writing")

    def __init__(self, sock: socket.socket, member: Member) -> None:
        self.socket, self.member = sock, member
        self.reading = True
        self.writing = False


class Hub:
    """Serves one bus from a reactor; `close` ends it, and `on_end` is called when it has ended by itself."""

    def __init__(self, reactor: Reactor, name: str) -> None:
        self.name = name
        self.exchange = Exchange()
        self.on_end = reactor.stop
        self._reactor = reactor
        self._started = reactor.now()
        self._path = socket_path("bus", name)
        self._hello_server = HelloServer(reactor, listen(self._path), self._admit)
        self._ends: dict[int, _End] = {}  # by the member's number
        self._flush_planned = False
        self._timer: Timer | None = None
        self._linger: Timer | None = None
        self._control: HubControl | None = None
        self._asked = listen(socket_path("busctl", name))
        reactor.add_reader(self._asked, self._serve_control)
        self._wait_for_ends()

    # Coming and going ----------------------------------------------------------------------------------------------

    def _serve_control(self) -> None:
        """Serve the control socket from now on; who has connected to it waits in the kernel."""
        if self._control is None and self._asked.fileno() >= 0:
            self._reactor.remove_reader(self._asked)  # should the import fail, it fails once
            from canopen_control.rpc.quick_import import import_msgspec

            import_msgspec()

            self._control = HubControl(
                self.name, self.exchange, self._reactor, self._asked, started=self._started, after=self._after
            )

    def _admit(self, sock: socket.socket, hello: Hello) -> None:
        """Make a member of who has greeted."""
        member = self.exchange.join(hello.label, hello.pid)
        for option in (socket.SO_RCVBUF, socket.SO_SNDBUF):
            sock.setsockopt(socket.SOL_SOCKET, option, _BUFFER_SIZE)  # the kernel takes what it allows
        end = self._ends[member.number] = _End(sock, member)
        member.outbox += pack_hello(os.getpid(), member.label, abilities=TAKES_WANTED | GIVES_STAMPS)
        self._reactor.add_reader(sock, functools.partial(self._read, end))
        if self._linger is not None:
            self._linger.cancel()
        self._write(end)
        self._reactor.call_soon(self._serve_control)

    def _drop(self, end: _End) -> None:
        self.exchange.leave(end.member)
        self._ends.pop(end.member.number, None)
        self._reactor.remove_reader(end.socket)
        self._reactor.remove_writer(end.socket)
        end.socket.close()
        self._wait_for_ends()

    def _wait_for_ends(self) -> None:
        if not self._ends:
            if self._linger is not None:
                self._linger.cancel()
            self._linger = self._reactor.call_later(LINGER_NS, self._expire)

    def _expire(self) -> None:
        """End, unless somebody is about to join: the lock is the one that openers hold while they start a hub."""
        try:
            with lock(self._path, 0):
                self._hello_server.accept()
                if not self._hello_server.busy and not self._ends:
                    self._end()
                    return
        except ConfigError:  # the folder is gone, or the lock is none: nobody finds this hub any more
            self._end()
            return
        except CanopenError:
            pass  # an opener holds the lock
        if not self._ends:
            self._linger = self._reactor.call_later(_RETRY_NS, self._expire)

    def _end(self) -> None:
        self.close()
        self.on_end()

    def close(self) -> None:
        """Leave nothing behind; a second call does nothing."""
        self._hello_server.close()
        if self._control is not None:
            self._control.close()
        elif self._asked.fileno() >= 0:
            self._reactor.remove_reader(self._asked)
            close_listener(self._asked)
        for end in list(self._ends.values()):
            self._reactor.remove_reader(end.socket)
            self._reactor.remove_writer(end.socket)
            end.socket.close()
        self._ends.clear()
        for timer in (self._timer, self._linger):
            if timer is not None:
                timer.cancel()

    # Frames --------------------------------------------------------------------------------------------------------

    def _read(self, end: _End) -> None:
        try:
            data = end.socket.recv(_READ_SIZE)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self._drop(end)
            return
        self.exchange.receive(end.member, data, self._reactor.now())
        self._after()

    def _after(self) -> None:
        """See to what the exchange wants next: writing at the end of this turn, a timer, less or more reading."""
        if self.exchange.dirty and not self._flush_planned:
            self._flush_planned = True
            self._reactor.call_soon(self._flush)
        if self.exchange.wire is not None or self._timer is not None:
            self._plan_tick()
            self._pace_readers()
        elif self.exchange.next_deadline() is not None:
            self._plan_tick()

    def _flush(self) -> None:
        self._flush_planned = False
        for member in self.exchange.take_dirty():
            end = self._ends.get(member.number)
            if end is not None and not end.writing:
                self._write(end)

    def _write(self, end: _End) -> None:
        member = end.member
        try:
            sent = end.socket.send(member.outbox) if member.outbox else 0
        except BlockingIOError:
            sent = 0
        except OSError:
            self._drop(end)
            return
        self.exchange.sent(member, sent)
        if bool(member.outbox) is not end.writing:
            end.writing = not end.writing
            if end.writing:
                self._reactor.add_writer(end.socket, functools.partial(self._write, end))
            else:
                self._reactor.remove_writer(end.socket)

    def _plan_tick(self) -> None:
        deadline = self.exchange.next_deadline()
        if self._timer is not None:
            if self._timer.active and self._timer.deadline_ns == deadline:
                return
            self._timer.cancel()
        self._timer = None if deadline is None else self._reactor.call_at(deadline, self._tick)

    def _tick(self) -> None:
        self.exchange.tick(self._reactor.now())
        self._after()

    def _pace_readers(self) -> None:
        for end in self._ends.values():
            if self.exchange.may_read(end.member) is not end.reading:
                end.reading = not end.reading
                if end.reading:
                    self._reactor.add_reader(end.socket, functools.partial(self._read, end))
                else:
                    self._reactor.remove_reader(end.socket)


def main(arguments: list[str] | None = None) -> int:
    """Serve the bus named on the command line until the last end has left."""
    (name,) = sys.argv[1:] if arguments is None else arguments
    reactor = Reactor()
    try:
        hub = Hub(reactor, name)
    except CanopenError as error:
        report_failure(str(error))
        return 1
    reactor.handle_signals({signal.SIGTERM: reactor.stop, signal.SIGINT: reactor.stop})
    report_ready()
    try:
        reactor.run()
    finally:
        hub.close()
        reactor.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
