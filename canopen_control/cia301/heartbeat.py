"""Heartbeat protocol, producer and consumer (CiA 301, 7.2.8.3.2.2).

Monitoring of a node starts with its first heartbeat, not with `watch` or its boot-up. A boot-up suspends monitoring
until the next heartbeat, because the node may have lost its producer time. A byte whose low seven bits are not an
NMT state counts as a heartbeat with an unknown state. Bit 7, which is 0 in heartbeats, is masked; only 0x80 is neither
a boot-up nor a heartbeat, and is counted as unknown.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass

from canopen_control.cia301.nmt import ERROR_CONTROL_COB_ID, NmtState, boot_up_frame, state_of_byte
from canopen_control.cia301.outbox import Outbox
from canopen_control.errors import LocalProtocolError
from canopen_control.frame import MAX_NODE_ID, CanFrame


def consumer_entry(node_id: int, ms: int) -> int:
    """Return the 0x1016 value that monitors `node_id` with `ms` (0: unused); raise LocalProtocolError out of range."""
    # CiA 301, 7.5.2.19: node-ID in bits 16 to 23, time in bits 0 to 15
    if not 0 <= node_id <= MAX_NODE_ID or not 0 <= ms <= 0xFFFF:
        msg = f"0x1016: node {node_id} with {ms} ms is out of range; at most node 127 and 65535 ms"
        raise LocalProtocolError(msg)
    return node_id << 16 | ms


def parse_consumer_entry(value: int) -> tuple[int, int]:
    """Return the node-ID and the time in ms of a 0x1016 value.

    A node-ID of 0 or above 127, or a time of 0 ms, means an unused entry (CiA 301, 7.5.2.19).
    """
    return value >> 16 & 0xFF, value & 0xFFFF


def next_on_grid(deadline_ns: int, period_ns: int, now: int) -> int:
    """Return `deadline_ns` advanced by as many whole periods as necessary to be after `now`."""
    if deadline_ns > now:
        return deadline_ns
    return deadline_ns + ((now - deadline_ns) // period_ns + 1) * period_ns


class HeartbeatProducer:
    """Producer of the node's heartbeat every `period_ns` (0x1017; 0: off); the owner keeps `state` up to date.

    No heartbeat is sent while INITIALISING. When a new period is set, the first heartbeat is due at the next tick.
    """

    def __init__(self, node_id: int, period_ns: int = 0) -> None:
        self.node_id = node_id
        self.state = NmtState.INITIALISING
        self._period_ns = period_ns
        self._deadline_ns: int | None = None  # None: at once
        self.outgoing: Outbox[CanFrame] = Outbox()

    @property
    def period_ns(self) -> int:
        """Producer heartbeat time in ns; 0 if the producer is off."""
        return self._period_ns

    @period_ns.setter
    def period_ns(self, period_ns: int) -> None:
        if period_ns != self._period_ns:
            self._period_ns = period_ns
            self._deadline_ns = None

    def boot_up(self, now: int) -> None:
        """Send the boot-up frame and enter PRE_OPERATIONAL; the first heartbeat follows one period later."""
        self.outgoing.put(boot_up_frame(self.node_id))
        self.state = NmtState.PRE_OPERATIONAL
        self.restart(now)

    def restart(self, now: int) -> None:
        """Restart the period at `now`, after the owner has sent the boot-up."""
        self._deadline_ns = now + self._period_ns

    def receive(self, frame: CanFrame, now: int) -> None:
        """Ignore the frame; a heartbeat producer receives nothing."""

    def tick(self, now: int) -> None:
        """Send the heartbeat when due; missed periods are skipped and do not shift later heartbeats."""
        # CiA 301, 7.5.2.20: a time of 0 disables the heartbeat; 7.3.2.2.5: only the boot-up while INITIALISING
        if self._period_ns <= 0 or self.state is NmtState.INITIALISING:
            return
        deadline = now if self._deadline_ns is None else self._deadline_ns
        if now >= deadline:
            self.outgoing.put(CanFrame(ERROR_CONTROL_COB_ID + self.node_id, bytes((self.state,))))
            deadline = next_on_grid(deadline, self._period_ns, now)
        self._deadline_ns = deadline

    def next_deadline(self) -> int | None:
        """Return the time of the next heartbeat, 0 if it is due at once, or None if no heartbeat is sent."""
        if self._period_ns <= 0 or self.state is NmtState.INITIALISING:
            return None
        return self._deadline_ns or 0

    def silence_ns(self, now: int) -> int:
        """Return the time since the last heartbeat was due, 0 if no heartbeat is sent."""
        deadline = self.next_deadline()
        return now - deadline + self._period_ns if deadline else 0

    def frames(self) -> list[CanFrame]:
        return self.outgoing.drain()

    def events(self) -> list[object]:
        return []


class HeartbeatEventKind(enum.Enum):
    """Kind of a heartbeat event; BOOT_UP is reported for every node, the other kinds for monitored nodes."""

    STARTED = "started"
    CHANGED = "changed"
    MISSED = "missed"
    RESOLVED = "resolved"
    BOOT_UP = "boot-up"


@dataclass(frozen=True, slots=True)
class HeartbeatEvent:
    """Heartbeat event `kind` of `node_id`.

    `state` is None if unknown. `age_ns` is the time since the previous message, 0 for the first. `monitored` is True if
    monitoring was running: a BOOT_UP is then a restart of the node, otherwise its first start.
    """

    kind: HeartbeatEventKind
    node_id: int
    state: NmtState | None
    age_ns: int
    monitored: bool = True


@dataclass(slots=True)
class _Node:
    timeout_ns: int = 0
    state: NmtState | None = None
    last_ns: int | None = None
    deadline_ns: int | None = None
    missed: bool = False

    @property
    def monitored(self) -> bool:
        return self.missed or self.deadline_ns is not None


class HeartbeatConsumer:
    """Consumer that monitors the heartbeats of nodes, and keeps the last state received from every node.

    `malformed` counts error control frames whose length is not 1, `unknown` those whose state is not defined by CiA
    301. At most 127 nodes are kept.
    """

    def __init__(self) -> None:
        self.malformed = 0
        self.unknown = 0
        self._nodes: dict[int, _Node] = {}
        self.event_queue: Outbox[HeartbeatEvent] = Outbox(1024)

    def watch(self, node_id: int, timeout_ns: int) -> None:
        """Monitor `node_id` with `timeout_ns` (0x1016) from its next heartbeat on; 0 ends monitoring.

        Raise LocalProtocolError for an invalid node-ID or a negative timeout.
        """
        if not 1 <= node_id <= MAX_NODE_ID or timeout_ns < 0:
            msg = f"cannot watch node {node_id} with {timeout_ns} ns; node-IDs are 1 to {MAX_NODE_ID}"
            raise LocalProtocolError(msg)
        node = self._nodes.setdefault(node_id, _Node())
        node.timeout_ns, node.deadline_ns, node.missed = timeout_ns, None, False

    def unwatch(self, node_id: int) -> None:
        """Stop monitoring `node_id`; no effect if it is not monitored."""
        if node_id in self._nodes:
            self.watch(node_id, 0)

    def watched(self) -> dict[int, int]:
        """Return the timeout in ns of each monitored node, by node-ID."""
        return {node_id: node.timeout_ns for node_id, node in self._nodes.items() if node.timeout_ns}

    def state_of(self, node_id: int) -> NmtState | None:
        """Return the last received state (INITIALISING after a boot-up), or None before any frame or if undefined."""
        node = self._nodes.get(node_id)
        return None if node is None else node.state

    def age_ns(self, node_id: int, now: int) -> int | None:
        """Return the time since the last heartbeat or boot-up in ns, or None before the first one."""
        node = self._nodes.get(node_id)
        return None if node is None or node.last_ns is None else now - node.last_ns

    def is_missed(self, node_id: int) -> bool:
        """Whether a monitored node has been silent for longer than its timeout."""
        node = self._nodes.get(node_id)
        return node is not None and node.missed

    def record_unchanged(self, node_id: int, state: NmtState, now: int, since: int | None = None) -> bool:
        """Record a timely heartbeat with an unchanged state; return False if `receive` must process the frame.

        False is also returned for a node that is not monitored at present. The frame arrived between `since`, when the
        receive queue was last empty, and `now`.
        """
        node = self._nodes.get(node_id)
        if node is None or node.state is not state or node.deadline_ns is None:
            return False
        if (now if since is None else since) >= node.deadline_ns:
            return False
        node.last_ns, node.deadline_ns = now, now + node.timeout_ns
        return True

    def receive(self, frame: CanFrame, now: int, since: int | None = None) -> None:
        """Receive a heartbeat or boot-up of any node.

        The frame arrived between `since`, when the receive queue was last empty, and `now`.
        """
        node_id = frame.can_id - ERROR_CONTROL_COB_ID
        if not 1 <= node_id <= MAX_NODE_ID:
            return
        # CiA 301, 7.2.8.3.2.2: a heartbeat has one byte, bit 7 is reserved and 0
        if len(frame.data) != 1:
            self.malformed += 1
            return
        value = frame.data[0]
        # CiA 301, 7.2.8.3.2.2: neither a boot-up (0) nor a heartbeat, whose state is not 0
        if value == 0x80:
            self.unknown += 1
            return
        node = self._nodes.setdefault(node_id, _Node())
        # a heartbeat after its deadline resolves a timeout instead of hiding it; a heartbeat that waited in the queue
        # was not late
        self._check(node_id, node, now if since is None else since)
        age = 0 if node.last_ns is None else now - node.last_ns
        node.last_ns = now
        if value == 0:
            self._boot_up(node_id, node, age)
        else:
            self._heartbeat(node_id, node, state_of_byte(value), age)
            node.missed, node.deadline_ns = False, now + node.timeout_ns if node.timeout_ns else None

    def tick(self, now: int) -> None:
        """Report monitored nodes whose timeout has elapsed."""
        for node_id, node in self._nodes.items():
            self._check(node_id, node, now)

    def next_deadline(self) -> int | None:
        first: int | None = None
        for node in self._nodes.values():
            deadline = node.deadline_ns
            if deadline is not None and (first is None or deadline < first):
                first = deadline
        return first

    def frames(self) -> list[CanFrame]:
        return []

    def events(self) -> list[HeartbeatEvent]:
        return self.event_queue.drain()

    def _check(self, node_id: int, node: _Node, now: int) -> None:
        # CiA 301, 7.2.8.3.2.2: heartbeat event after the consumer time without a heartbeat
        if node.deadline_ns is not None and now >= node.deadline_ns:
            age = now - node.deadline_ns + node.timeout_ns
            node.deadline_ns, node.missed = None, True
            self.event_queue.put(HeartbeatEvent(HeartbeatEventKind.MISSED, node_id, node.state, age))

    def _boot_up(self, node_id: int, node: _Node, age: int) -> None:
        # CiA 301, 7.2.8.3.3: the boot-up protocol; monitoring starts again with the first heartbeat
        monitored = node.monitored
        node.state, node.deadline_ns, node.missed = NmtState.INITIALISING, None, False
        self.event_queue.put(HeartbeatEvent(HeartbeatEventKind.BOOT_UP, node_id, node.state, age, monitored))

    def _heartbeat(self, node_id: int, node: _Node, state: NmtState | None, age: int) -> None:
        self.unknown += state is None
        previous, node.state = node.state, state
        if not node.timeout_ns:
            return
        if node.missed:
            self.event_queue.put(HeartbeatEvent(HeartbeatEventKind.RESOLVED, node_id, state, age))
        elif node.deadline_ns is None:
            self.event_queue.put(HeartbeatEvent(HeartbeatEventKind.STARTED, node_id, state, age))
            previous = state  # STARTED already reported the state
        if previous is not state:
            self.event_queue.put(HeartbeatEvent(HeartbeatEventKind.CHANGED, node_id, state, age))
