"""Node guarding and life guarding, master and slave (CiA 301, 7.2.8.3.2.1).

Every guard time the master sends a remote frame on the error control COB-ID of each node. The node answers with its
state and a toggle bit that alternates and is 0 after a reset; a node that was already running may begin with either.
A node that does not answer within guard time x life time factor is lost; a node that is not polled within this time
has lost its master. Monitoring starts with the first answer on the master, and with the first remote frame on the
slave.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass

from canopen_control.cia301.heartbeat import next_on_grid
from canopen_control.cia301.nmt import ERROR_CONTROL_COB_ID, NmtState, state_of_byte
from canopen_control.cia301.outbox import Outbox
from canopen_control.errors import LocalProtocolError
from canopen_control.frame import MAX_NODE_ID, REMOTE_FLAG, CanFrame, remote_frame


class GuardingEventKind(enum.Enum):
    """Kind of a guarding event; in a slave, MISSED and RESOLVED refer to the master."""

    STARTED = "started"
    CHANGED = "changed"
    MISSED = "missed"
    RESOLVED = "resolved"
    TOGGLE_ERROR = "toggle error"  # the answer is dropped: two nodes share this id, or an answer was lost
    BOOT_UP = "boot-up"


@dataclass(frozen=True, slots=True)
class GuardingEvent:
    """Guarding event `kind` of `node_id`; `state` is the last received state, None if unknown."""

    kind: GuardingEventKind
    node_id: int
    state: NmtState | None = None


@dataclass(slots=True)
class _Guarded:
    guard_ns: int
    life_ns: int
    poll_ns: int
    toggle: int = 0
    state: NmtState | None = None
    answered: bool = False
    missed: bool = False
    deadline_ns: int = 0


class GuardingMaster:
    """Guarding of any number of nodes by the master; `malformed` counts responses whose length is not 1."""

    def __init__(self) -> None:
        self.malformed = 0
        self._nodes: dict[int, _Guarded] = {}
        self._frames: Outbox[CanFrame] = Outbox()
        self._events: Outbox[GuardingEvent] = Outbox(1024)

    def watch(self, node_id: int, guard_time_ns: int, life_time_factor: int, now: int) -> None:
        """Start guarding `node_id`; raise LocalProtocolError for an invalid node-ID, or a time or factor of 0."""
        if not 1 <= node_id <= MAX_NODE_ID or guard_time_ns <= 0 or life_time_factor <= 0:
            msg = f"cannot guard node {node_id} every {guard_time_ns} ns with factor {life_time_factor}"
            raise LocalProtocolError(msg)
        life = guard_time_ns * life_time_factor
        self._nodes[node_id] = _Guarded(guard_time_ns, life, now, deadline_ns=now + life)

    def unwatch(self, node_id: int) -> None:
        """Stop guarding `node_id`; no effect if it is not guarded."""
        self._nodes.pop(node_id, None)

    def state_of(self, node_id: int) -> NmtState | None:
        """Return the last received state; None if unknown, not yet received, or if the node is not guarded."""
        node = self._nodes.get(node_id)
        return None if node is None else node.state

    def receive(self, frame: CanFrame, now: int, since: int | None = None) -> None:
        """Receive a response or a boot-up of a guarded node.

        The frame arrived between `since`, when the receive queue was last empty, and `now`.
        """
        node_id = frame.can_id - ERROR_CONTROL_COB_ID
        node = self._nodes.get(node_id)
        if node is None:
            return
        # CiA 301, 7.2.8.3.2.1: the answer has one byte, toggle bit and state
        if len(frame.data) != 1:
            self.malformed += 1
            return
        self._check(node_id, node, now if since is None else since)
        value = frame.data[0]
        # CiA 301, 7.2.8.3.2.1: the toggle bit of the first answer after a reset communication is 0
        if value == 0:
            node.toggle, node.state = 0, NmtState.INITIALISING
            self._report(GuardingEventKind.BOOT_UP, node_id, node)
        # CiA 301, 7.2.8.3.2.1: an answer is invalid if its toggle bit has not alternated
        elif value >> 7 != node.toggle and node.answered:
            self._report(GuardingEventKind.TOGGLE_ERROR, node_id, node)
        else:
            self._answered(node_id, node, value >> 7, state_of_byte(value), now)

    def tick(self, now: int) -> None:
        """Send the remote frames that are due, and report nodes that have not responded in time."""
        for node_id, node in self._nodes.items():
            self._check(node_id, node, now)
            if now >= node.poll_ns:
                self._frames.put(remote_frame(ERROR_CONTROL_COB_ID + node_id, 1))
                node.poll_ns = next_on_grid(node.poll_ns, node.guard_ns, now)

    def postpone(self, nanoseconds: int) -> None:
        """Extend all deadlines by `nanoseconds`, a time during which no remote frame was sent."""
        for node in self._nodes.values():
            node.deadline_ns += nanoseconds

    def next_deadline(self) -> int | None:
        times = [node.poll_ns for node in self._nodes.values()]
        times += [node.deadline_ns for node in self._nodes.values() if not node.missed]
        return min(times, default=None)

    def frames(self) -> list[CanFrame]:
        return self._frames.drain()

    def events(self) -> list[GuardingEvent]:
        return self._events.drain()

    def _check(self, node_id: int, node: _Guarded, now: int) -> None:
        # CiA 301, 7.2.8.3.2.1: node guarding event after guard time x life time factor without an answer
        if not node.missed and now >= node.deadline_ns:
            node.missed = True
            self._report(GuardingEventKind.MISSED, node_id, node)

    def _answered(self, node_id: int, node: _Guarded, toggle: int, state: NmtState | None, now: int) -> None:
        previous, node.state = node.state, state
        node.toggle = toggle ^ 1
        node.deadline_ns = now + node.life_ns
        if not node.answered:
            self._report(GuardingEventKind.STARTED, node_id, node)
        elif node.missed:
            self._report(GuardingEventKind.RESOLVED, node_id, node)
        if node.answered and previous is not state:
            self._report(GuardingEventKind.CHANGED, node_id, node)
        node.answered, node.missed = True, False

    def _report(self, kind: GuardingEventKind, node_id: int, node: _Guarded) -> None:
        self._events.put(GuardingEvent(kind, node_id, node.state))


class GuardingSlave:
    """Guarding in one slave: answers remote frames and monitors the master; the owner keeps `state` up to date.

    `enabled` is False while a heartbeat producer time is set: only one of the two protocols runs, and heartbeat takes
    precedence (CiA 301, 7.2.8.3.2.1). `guard_time_ns` x `life_time_factor` (0x100C, 0x100D) is the life time; at 0 the
    master is not monitored.
    """

    def __init__(self, node_id: int, *, guard_time_ns: int = 0, life_time_factor: int = 0) -> None:
        self.node_id = node_id
        self.guard_time_ns = guard_time_ns
        self.life_time_factor = life_time_factor
        self.enabled = True
        self.state = NmtState.INITIALISING
        self._toggle = 0
        self._asked_ns: int | None = None
        self._missed = False
        self.outgoing: Outbox[CanFrame] = Outbox()
        self.event_queue: Outbox[GuardingEvent] = Outbox()

    @property
    def life_time_ns(self) -> int:
        """Longest tolerated silence of the master in ns; 0 if the master is not monitored."""
        return self.guard_time_ns * self.life_time_factor

    def reset(self) -> None:
        """Reset the toggle bit to 0 and wait for the master again (NMT reset communication)."""
        self._toggle, self._asked_ns, self._missed = 0, None, False

    def receive(self, frame: CanFrame, now: int) -> None:
        """Answer a remote frame of the master; ignore other frames."""
        if frame.can_id != ERROR_CONTROL_COB_ID + self.node_id | REMOTE_FLAG:
            return
        # CiA 301, 7.2.8.3.2.1: no guarding while the heartbeat producer time is not 0
        if not self.enabled or self.state is NmtState.INITIALISING:
            return
        self.tick(now)
        if self._missed:
            self._missed = False
            self.event_queue.put(GuardingEvent(GuardingEventKind.RESOLVED, self.node_id, self.state))
        self._asked_ns = now
        answer = bytes((self._toggle | self.state,))
        self._toggle ^= 0x80
        self.outgoing.put(CanFrame(ERROR_CONTROL_COB_ID + self.node_id, answer))

    def tick(self, now: int) -> None:
        """Report once that the master has been silent for the life time (EMCY 0x8130)."""
        # CiA 301, 7.2.8.3.2.1: life guarding event after guard time x life time factor
        deadline = self.next_deadline()
        if deadline is not None and now >= deadline:
            self._missed = True
            self.event_queue.put(GuardingEvent(GuardingEventKind.MISSED, self.node_id, self.state))

    def next_deadline(self) -> int | None:
        """Return the time at which the life time expires, or None if the master is not currently monitored."""
        if self._asked_ns is None or self._missed or not self.enabled or not self.life_time_ns:
            return None
        return self._asked_ns + self.life_time_ns

    def frames(self) -> list[CanFrame]:
        return self.outgoing.drain()

    def events(self) -> list[GuardingEvent]:
        return self.event_queue.drain()
