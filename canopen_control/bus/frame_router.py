"""Routing of frames between the members of a ``local:`` bus, and its wire faults, without sockets and without a clock.

Rules:
- A frame reaches every member but its sender; the frames of one sender stay in order.
- A slow reader delays no other: if its queue is full, its frames are lost and replaced by one error frame with their
  number.
- Bytes may arrive in any pieces; only whole records are forwarded.
- Without faults and bit rate the work is per chunk, not per frame: a member with a subscription gets a chunk as a whole
  if it contains one of its identifiers, otherwise not at all.
- A chunk has one time: its arrival, or its last bit on a paced wire. Members that requested stamps receive it before
  the chunk. Stamps are equal for all members and strictly increasing.
- A wire fault (a cut cable, dropped frames) is declared by the label of a member. A label without a member is allowed:
  its cable is cut when a member with this label joins.
"""

from __future__ import annotations

import heapq
from typing import TYPE_CHECKING

from canopen_control.bus.arbitration import PacedWire
from canopen_control.bus.error_frames import bus_off_frame, has_error_frames, overrun_frame, restarted_frame
from canopen_control.bus.subscription import MARK, STAMP_STEP_NS, Subscription, own_stamp, pack_stamp
from canopen_control.frame import ERROR_FLAG, RECORD, RECORD_SIZE, CanFrame, pack_records

if TYPE_CHECKING:
    from collections.abc import Iterable


class DropRule:
    """Rule that drops frames of `label` ("" for all) with identifier `can_id` (None for any).

    Each `every`-th matching frame is dropped, `count` of them in all (None: no limit).
    """

    __slots__ = ("can_id", "count", "every", "label", "lost", "matched")

    def __init__(self, label: str = "", can_id: int | None = None, every: int = 1, count: int | None = None) -> None:
        self.label, self.can_id, self.every, self.count = label, can_id, max(1, every), count
        self.matched = 0
        self.lost = 0

    @property
    def spent(self) -> bool:
        """Whether the rule has dropped its `count` frames."""
        return self.count is not None and self.lost >= self.count

    def takes(self, label: str, can_id: int) -> bool:
        """Count a frame that matches the rule, and return whether the rule drops it."""
        if self.spent or self.label not in ("", label) or self.can_id not in (None, can_id):
            return False
        self.matched += 1
        lost = self.matched % self.every == 0
        self.lost += lost
        return lost


class WireFaults:
    """Faults of one bus by label: cut cables, controllers in bus-off, delays and drop rules."""

    def __init__(self) -> None:
        self.cut: set[str] = set()
        self.bus_off: set[str] = set()
        self.delays: dict[str, int] = {}  # label, "" for all ports -> ns
        self.drops: list[DropRule] = []

    @property
    def active(self) -> bool:
        """Whether frames must be checked before delivery because of delays or drop rules."""
        return bool(self.delays or self.drops)

    def silences(self, label: str) -> bool:
        """Whether members with this label are disconnected, by a cut cable or bus-off."""
        return label in self.cut or label in self.bus_off

    def delay_of(self, label: str) -> int:
        """Return the delay of frames from this label in ns; the delay of "" applies to labels without their own."""
        return self.delays.get(label, self.delays.get("", 0))

    def delay(self, label: str, delay_ns: int) -> None:
        """Delay frames from this label ("" for all) by `delay_ns`; 0 ends the delay."""
        if delay_ns > 0:
            self.delays[label] = delay_ns
        else:
            self.delays.pop(label, None)

    def survivors(self, label: str, records: bytes) -> bytes:
        """Apply the drop rules, and return the records that are not dropped."""
        if not self.drops:
            return records
        remaining = b"".join(
            records[at : at + RECORD_SIZE]
            for at in range(0, len(records), RECORD_SIZE)
            if not self._lost(label, RECORD.unpack_from(records, at)[0])
        )
        self.drops = [rule for rule in self.drops if not rule.spent]
        return remaining

    def _lost(self, label: str, can_id: int) -> bool:
        return any(rule.takes(label, can_id) for rule in self.drops)


QUEUE_LIMIT = 16384 * RECORD_SIZE
"""Maximum number of bytes waiting for one reader, in addition to those in the kernel."""
BACKLOG_LIMIT = 256
"""Number of frames waiting for a paced wire above which a sender is not read."""
DELAY_LIMIT = 65536
"""Maximum number of delayed chunks."""


class RouterPort:
    """Member of a bus: one opened port; counters are in frames, as seen by this member."""

    __slots__ = ("label", "lost", "missed", "number", "outbox", "partial", "pid", "rx", "silent", "subscription", "tx")

    def __init__(self, number: int, label: str, pid: int) -> None:
        self.number, self.label, self.pid = number, label, pid
        self.rx = self.tx = self.lost = 0
        self.missed = 0  # number of lost frames not yet reported to the member
        self.silent = False
        self.partial = b""
        self.outbox = bytearray()
        self.subscription = Subscription()


class FrameRouter:
    """Router of the CAN frames of one bus between its members, with injected faults and a simulated bit rate.

    The owner writes the `outbox` of each member in `dirty` to its socket and reports the written size with `sent`.
    """

    def __init__(self, *, limit: int = QUEUE_LIMIT) -> None:
        self.members: dict[int, RouterPort] = {}
        self.faults = WireFaults()
        self.frames = 0
        self.dropped = 0
        self.dirty: list[RouterPort] = []
        self.wire: PacedWire | None = None
        self._limit = limit
        self._next_number = 1
        self._delayed: list[tuple[int, int, int, bytes]] = []  # due, serial, sender's number, records
        self._last_due: dict[int, int] = {}
        self._serial = 0
        self._now = 0  # time of the last chunk or tick
        self._stamping = False  # whether a member requested stamps
        self._next_stamp = 0

    # -- members

    def join(self, label: str, pid: int) -> RouterPort:
        """Add a member; if another member has the same label, a number is appended to the label."""
        number, self._next_number = self._next_number, self._next_number + 1
        member = RouterPort(number, self._unique(label or f"pid-{pid}"), pid)
        member.silent = self.faults.silences(member.label)
        self.members[number] = member
        return member

    def _unique(self, label: str) -> str:
        labels = {member.label for member in self.members.values()}
        name, number = label, 1
        while name in labels:
            number += 1
            name = f"{label}-{number}"
        return name

    def leave(self, member: RouterPort) -> None:
        """Remove a member; its frames are still delivered, except those waiting for the wire."""
        self.members.pop(member.number, None)
        self._stamping = any(other.subscription.stamps for other in self.members.values())
        self._last_due.pop(member.number, None)
        if self.wire is not None:
            self.wire.forget(member.number)

    def labelled(self, label: str) -> list[RouterPort]:
        """Return the members with this label, or all members for ""."""
        return [member for member in self.members.values() if label in ("", member.label)]

    # -- frames

    def receive(self, member: RouterPort, data: bytes, now: int) -> None:
        """Route the records in bytes from a member; an incomplete record is kept until the rest arrives."""
        self._now = now
        if member.partial:
            data = member.partial + data
            member.partial = b""
        if excess := len(data) % RECORD_SIZE:
            member.partial = data[-excess:]
            data = data[:-excess]
        if MARK in data:
            data = member.subscription.take(data)
            self._stamping = self._stamping or member.subscription.stamps
        if not data:
            return
        member.tx += len(data) // RECORD_SIZE
        if member.silent:
            self._lose(member, data)
        elif self.faults.active or self._delayed:
            self._with_faults(member, data, now)
        else:
            self._transmit(member.number, data, now)

    def _lose(self, member: RouterPort, records: bytes) -> None:
        count = len(records) // RECORD_SIZE
        member.lost += count
        self.dropped += count

    def _with_faults(self, member: RouterPort, records: bytes, now: int) -> None:
        survivors = self.faults.survivors(member.label, records)
        self.dropped += (len(records) - len(survivors)) // RECORD_SIZE
        # never before frames already under way: the frames of one sender stay in order when its delay is reduced
        delivery_ns = max(now + self.faults.delay_of(member.label), self._last_due.get(member.number, 0))
        if not survivors:
            return
        if delivery_ns <= now:
            self._transmit(member.number, survivors, now)
            return
        if len(self._delayed) >= DELAY_LIMIT:
            self._lose(member, survivors)
            return
        self._last_due[member.number] = delivery_ns
        self._serial += 1
        heapq.heappush(self._delayed, (delivery_ns, self._serial, member.number, survivors))

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
                if stamp and member.subscription.echoes and not member.silent:
                    self._put(member, records, own_stamp(stamp))
                continue
            if member.silent:
                continue
            ids = member.subscription.ids
            if ids is not None:
                if can_ids is None:
                    can_ids = _plain_ids(records)
                if can_ids and ids.isdisjoint(can_ids):
                    continue
            self._put(member, records, stamp)

    def _stamp(self, records: bytes, at: int) -> bytes:
        """Return the stamp of a chunk, later than the last frame of the previous chunk."""
        if at < self._next_stamp:
            at = self._next_stamp
        self._next_stamp = at + len(records) // RECORD_SIZE * STAMP_STEP_NS
        return pack_stamp(at)

    def _put(self, member: RouterPort, records: bytes, stamp: bytes) -> None:
        outbox = member.outbox
        if member.missed or len(outbox) + len(records) > self._limit:
            records = self._squeeze(member, records)
            if not records:
                return
        if not outbox:
            self.dirty.append(member)
        if stamp and member.subscription.stamps:
            outbox += stamp
        outbox += records
        member.rx += len(records) // RECORD_SIZE

    def _squeeze(self, member: RouterPort, records: bytes) -> bytes:
        """Return the records that fit into the outbox.

        After the first lost record all others are lost too, and counted.
        """
        room = 0 if member.missed else max(0, self._limit - len(member.outbox)) // RECORD_SIZE * RECORD_SIZE
        lost = (len(records) - room) // RECORD_SIZE
        member.missed += lost
        member.lost += lost
        return records[:room]

    def sent(self, member: RouterPort, size: int) -> None:
        """Remove the first `size` bytes of the outbox, which have been written.

        Report lost frames once the outbox is at most half full.
        """
        outbox = member.outbox
        if size == len(outbox):
            outbox.clear()
        else:
            del outbox[:size]
        if member.missed and len(outbox) <= self._limit // 2:
            self._append(member, overrun_frame(member.missed))
            member.missed = 0

    def _append(self, member: RouterPort, frame: CanFrame) -> None:
        if not member.outbox:
            self.dirty.append(member)
        record = pack_records([frame])
        if member.subscription.stamps:
            member.outbox += self._stamp(record, self._now)
        member.outbox += record

    def take_dirty(self) -> list[RouterPort]:
        """Return the members whose outbox has become non-empty since the last call."""
        dirty, self.dirty = self.dirty, []
        return dirty

    # -- time

    def tick(self, now: int) -> None:
        """Deliver the delayed and paced frames that are due by `now`."""
        self._now = now
        while self._delayed and self._delayed[0][0] <= now:
            delivery_ns, _serial, sender, records = heapq.heappop(self._delayed)
            self._transmit(sender, records, delivery_ns)
        self._advance(now)

    def _advance(self, now: int) -> None:
        wire = self.wire
        while wire is not None and (end_ns := wire.due_ns) is not None and end_ns <= now:
            if (passed := wire.end()) is not None:
                _, sender, _, record = passed
                self._deliver(sender, record, end_ns)

    def next_deadline(self) -> int | None:
        """Return the time in ns of the next delivery, or None if no frame is waiting."""
        deadlines = [self._delayed[0][0]] if self._delayed else []
        wire = self.wire.next_deadline() if self.wire is not None else None
        return min([*deadlines, wire] if wire is not None else deadlines, default=None)

    def may_read(self, member: RouterPort) -> bool:
        """Whether the hub may read from a member; False while too many of its frames wait for a paced wire."""
        return self.wire is None or self.wire.backlog(member.number) < BACKLOG_LIMIT

    # -- control

    def pace(self, bitrate: int | None, now: int) -> None:
        """Set the bit rate in bit/s; None or 0 ends pacing and delivers waiting frames at once."""
        old, self.wire = self.wire, PacedWire(bitrate) if bitrate else None
        if old is not None:
            for sender, record in old.drain():
                self._transmit(sender, record, now)

    def load(self, now: int) -> float | None:
        """Return the bus load of the last full second, from 0 to 1, or None without a bit rate."""
        return None if self.wire is None else self.wire.load(now)

    def cut(self, label: str, *, repair: bool = False) -> None:
        """Cut the cable of a label, so that frames in both directions are lost unreported; `repair` repairs it."""
        (self.faults.cut.discard if repair else self.faults.cut.add)(label)
        self._refresh()

    def bus_off(self, label: str, *, restart: bool = False) -> None:
        """Set the CAN controllers with a label to bus-off or, with `restart`, restart them.

        Their ports receive an error frame.
        """
        (self.faults.bus_off.discard if restart else self.faults.bus_off.add)(label)
        self._refresh()
        self.report(label, restarted_frame() if restart else bus_off_frame())

    def report(self, label: str, frame: CanFrame) -> None:
        """Deliver an error frame to the members with a label, or to all members for ""."""
        for member in self.labelled(label):
            self._append(member, frame)

    def clear_faults(self) -> None:
        """Clear all faults; members in bus-off receive the error frame of a restart."""
        restarted = self.faults.bus_off
        self.faults = WireFaults()
        self._refresh()
        for label in restarted:
            self.report(label, restarted_frame())

    def _refresh(self) -> None:
        for member in self.members.values():
            member.silent = self.faults.silences(member.label)


def _plain_ids(records: bytes) -> list[int]:
    """Return the identifiers of records; [] if any may be an error frame, which every member receives."""
    return [] if has_error_frames(records) else memoryview(records).cast("I")[:: RECORD_SIZE // 4].tolist()


def _split_reports(records: bytes) -> tuple[bytes, bytes]:
    """Split records into error frames, which are not sent on the wire, and other frames."""
    parts: Iterable[bytes] = (records[at : at + RECORD_SIZE] for at in range(0, len(records), RECORD_SIZE))
    reports, frames = b"", b""
    for record in parts:
        if RECORD.unpack(record)[0] & ERROR_FLAG:
            reports += record
        else:
            frames += record
    return reports, frames
