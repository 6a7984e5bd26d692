"""The heartbeat protocol, producer and consumer (CiA 301, 7.2.8.3.2).

Monitoring of a node starts with its first heartbeat, not with `watch` and not with its boot-up. A boot-up ends it
until the next heartbeat: the node lost what was not stored, perhaps its producer time too. A byte whose low seven
bits are no state is a sign of life of unknown state; the toggle bit, which heartbeats keep 0, is masked and counted,
except on 0x80, which is neither a boot-up nor a heartbeat.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass

from canopen_control.cia301.nmt import ERROR_CONTROL_COB_ID, NmtState, boot_up_frame, state_of_byte
from canopen_control.cia301.outbox import Outbox
from canopen_control.errors import LocalProtocolError
from canopen_control.frame import MAX_NODE_ID, CanFrame


def consumer_entry(node_id: int, ms: int) -> int:
    """Return the 0x1016 value that watches `node_id` with `ms` (both 0: unused); LocalProtocolError if too large."""
    if not 0 <= node_id <= MAX_NODE_ID or not 0 <= ms <= 0xFFFF:
        msg = f"0x1016: node {node_id} with {ms} ms; node ids end at 127, times at 65535 ms"
        raise LocalProtocolError(msg)
    return node_id << 16 | ms


def parse_consumer_entry(value: int) -> tuple[int, int]:
    """Return node id and time in ms of a 0x1016 value; a node id of 0 or above 127, or 0 ms, means unused."""
    return value >> 16 & 0xFF, value & 0xFFFF


def next_on_grid(deadline_ns: int, period_ns: int, now: int) -> int:
    """Return the first time after `now` on the grid of `deadline_ns`: a late tick shifts nothing, bursts nothing."""
    if deadline_ns > now:
        return deadline_ns
    return deadline_ns + ((now - deadline_ns) // period_ns + 1) * period_ns


class HeartbeatProducer:
    """Sends the own `state` every `period_ns` (0x1017; 0: off); the owner keeps `state` up to date.

    Silent while INITIALISING. A period set later starts with a heartbeat at the next tick.
    """

    def __init__(self, node_id: int, period_ns: int = 0) -> None:
        self.node_id = node_id
        self.state = NmtState.INITIALISING
        self._period_ns = period_ns
        self._deadline_ns: int | None = None  # None: at once
        self.outgoing: Outbox[CanFrame] = Outbox()

    @property
    def period_ns(self) -> int:
        """The producer time in ns, 0: off."""
        return self._period_ns

    @period_ns.setter
    def period_ns(self, period_ns: int) -> None:
        if period_ns != self._period_ns:
            self._period_ns = period_ns
            self._deadline_ns = None

    def boot_up(self, now: int) -> None:
        """Send the boot-up frame and become PRE_OPERATIONAL; the first heartbeat follows one period later."""
        self.outgoing.put(boot_up_frame(self.node_id))
        self.state = NmtState.PRE_OPERATIONAL
        self.started(now)

    def started(self, now: int) -> None:
        """Count the period from `now`, when somebody else sent the boot-up."""
        self._deadline_ns = now + self._period_ns

    def receive(self, frame: CanFrame, now: int) -> None:
        """Do nothing: a producer hears nobody."""

    def tick(self, now: int) -> None:
        """Send the heartbeat when due; missed periods are skipped, the grid is kept."""
        if self._period_ns <= 0 or self.state is NmtState.INITIALISING:
            return
        deadline = now if self._deadline_ns is None else self._deadline_ns
        if now >= deadline:
            self.outgoing.put(CanFrame(ERROR_CONTROL_COB_ID + self.node_id, bytes((self.state,))))
            deadline = next_on_grid(deadline, self._period_ns, now)
        self._deadline_ns = deadline

    def next_deadline(self) -> int | None:
        """Return when `tick` has something to do; 0 means at once."""
        if self._period_ns <= 0 or self.state is NmtState.INITIALISING:
            return None
        return self._deadline_ns or 0

    def frames(self) -> list[CanFrame]:
        """Drain the frames to send."""
        return self.outgoing.drain()

    def events(self) -> list[object]:
        """Return nothing: nothing happens to a producer."""
        return []


class HeartbeatEventKind(enum.Enum):
    """What happened to a watched node; BOOT_UP is told of every node."""

    STARTED = "started"
    CHANGED = "changed"
    MISSED = "missed"
    RESOLVED = "resolved"
    BOOT_UP = "boot-up"


@dataclass(frozen=True, slots=True)
class HeartbeatEvent:
    """`kind` at `node_id`; `state` None: unknown; `age_ns` since its last sign of life before this (0: the first).

    `monitored`: monitoring was running. A BOOT_UP with it is a remote reset, without it a node that came.
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
    """Watches nodes for their heartbeats; knows the last state of every node it ever heard.

    `malformed` counts error control frames whose length is not 1,
    `unknown` those whose state the standard does not know. At most 127 nodes are kept.
    """

    def __init__(self) -> None:
        self.malformed = 0
        self.unknown = 0
        self._nodes: dict[int, _Node] = {}
        self.happened: Outbox[HeartbeatEvent] = Outbox(1024)

    def watch(self, node_id: int, timeout_ns: int) -> None:
        """Watch `node_id` (0x1016); watching anew starts with its next heartbeat; a time of 0 ends it."""
        if not 1 <= node_id <= MAX_NODE_ID or timeout_ns < 0:
            msg = f"cannot watch node {node_id} with {timeout_ns} ns; node ids are 1 to {MAX_NODE_ID}"
            raise LocalProtocolError(msg)
        node = self._nodes.setdefault(node_id, _Node())
        node.timeout_ns, node.deadline_ns, node.missed = timeout_ns, None, False

    def unwatch(self, node_id: int) -> None:
        """Stop watching; no-op for a node that is not watched."""
        if node_id in self._nodes:
            self.watch(node_id, 0)

    def watched(self) -> dict[int, int]:
        """Return the time in ns of each watched node."""
        return {node_id: node.timeout_ns for node_id, node in self._nodes.items() if node.timeout_ns}

    def state_of(self, node_id: int) -> NmtState | None:
        """Return the state last shown (INITIALISING after a boot-up), or None: never heard or unknown."""
        node = self._nodes.get(node_id)
        return None if node is None else node.state

    def age_ns(self, node_id: int, now: int) -> int | None:
        """Return the time since the last sign of life, None: never heard."""
        node = self._nodes.get(node_id)
        return None if node is None or node.last_ns is None else now - node.last_ns

    def is_missed(self, node_id: int) -> bool:
        """Whether a watched node is silent for longer than its time."""
        node = self._nodes.get(node_id)
        return node is not None and node.missed

    def goes_on(self, node_id: int, state: NmtState, now: int, since: int | None = None) -> bool:
        """Take a heartbeat of a watched node, in time and of the state that it had; False: `receive` has to look at it.

        It came between `since`, when none waited, and `now`.
        """
        node = self._nodes.get(node_id)
        if node is None or node.state is not state or node.deadline_ns is None:
            return False
        if (now if since is None else since) >= node.deadline_ns:
            return False
        node.last_ns, node.deadline_ns = now, now + node.timeout_ns
        return True

    def receive(self, frame: CanFrame, now: int, since: int | None = None) -> None:
        """Take a heartbeat or boot-up of any node; it came between `since`, when none waited, and `now`."""
        node_id = frame.can_id - ERROR_CONTROL_COB_ID
        if not 1 <= node_id <= MAX_NODE_ID:
            return
        if len(frame.data) != 1:
            self.malformed += 1
            return
        value = frame.data[0]
        if value == 0x80:
            self.unknown += 1
            return
        node = self._nodes.setdefault(node_id, _Node())
        # a frame behind its deadline resolves a miss, it does not hide it; one that waited for a late reader is none
        self._check(node_id, node, now if since is None else since)
        age = 0 if node.last_ns is None else now - node.last_ns
        node.last_ns = now
        if value == 0:
            self._boot_up(node_id, node, age)
        else:
            self._heartbeat(node_id, node, state_of_byte(value), age)
            node.missed, node.deadline_ns = False, now + node.timeout_ns if node.timeout_ns else None

    def tick(self, now: int) -> None:
        """Report nodes whose time is over; a node is silent too long when its whole time has passed."""
        for node_id, node in self._nodes.items():
            self._check(node_id, node, now)

    def next_deadline(self) -> int | None:
        """Return when the next node is missed."""
        first: int | None = None
        for node in self._nodes.values():
            deadline = node.deadline_ns
            if deadline is not None and (first is None or deadline < first):
                first = deadline
        return first

    def frames(self) -> list[CanFrame]:
        """Return nothing: a consumer does not send."""
        return []

    def events(self) -> list[HeartbeatEvent]:
        """Drain what happened, in order."""
        return self.happened.drain()

    def _check(self, node_id: int, node: _Node, now: int) -> None:
        if node.deadline_ns is not None and now >= node.deadline_ns:
            age = now - node.deadline_ns + node.timeout_ns
            node.deadline_ns, node.missed = None, True
            self.happened.put(HeartbeatEvent(HeartbeatEventKind.MISSED, node_id, node.state, age))

    def _boot_up(self, node_id: int, node: _Node, age: int) -> None:
        monitored = node.monitored
        node.state, node.deadline_ns, node.missed = NmtState.INITIALISING, None, False
        self.happened.put(HeartbeatEvent(HeartbeatEventKind.BOOT_UP, node_id, node.state, age, monitored))

    def _heartbeat(self, node_id: int, node: _Node, state: NmtState | None, age: int) -> None:
        self.unknown += state is None
        previous, node.state = node.state, state
        if not node.timeout_ns:
            return
        if node.missed:
            self.happened.put(HeartbeatEvent(HeartbeatEventKind.RESOLVED, node_id, state, age))
        elif node.deadline_ns is None:
            self.happened.put(HeartbeatEvent(HeartbeatEventKind.STARTED, node_id, state, age))
            previous = state  # STARTED told the state
        if previous is not state:
            self.happened.put(HeartbeatEvent(HeartbeatEventKind.CHANGED, node_id, state, age))
