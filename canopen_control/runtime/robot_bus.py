"""CAN bus of a robot: port, NMT master network, traffic counters, and SYNC from another producer."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING, Final, Protocol

from canopen_control.bus.channel import ChannelKind, open_port, parse_channel
from canopen_control.bus.kernel_sync import KernelSync
from canopen_control.bus.port import BusEventKind
from canopen_control.bus.port_abilities import set_filter
from canopen_control.cia301.nmt import ERROR_CONTROL_COB_ID, NmtCommand, NmtState
from canopen_control.errors import BusError
from canopen_control.frame import FRAME_BITS, RECORD_SIZE, frames_of
from canopen_control.master.event_log import Event, Level
from canopen_control.master.keys import DEFAULT_BOOT_MS
from canopen_control.master.network import Network

if TYPE_CHECKING:
    from collections.abc import Callable, Container

    from canopen_control.bus.port import BusEvent, Port, PortStats
    from canopen_control.host.reactor import Reactor
    from canopen_control.master.config import BusConfig
    from canopen_control.master.remote_node import RemoteNode


# SYNC that the kernel or a node of the bus sends, and that the cycle follows.
#
# The kernel's SYNC is received like any frame (a frame sent by one socket reaches all others), and the edges of the
# cycle are placed after the SYNC (`SyncPhase`): an eighth of a period later, which leaves seven eighths to a process
# that is late, or with `sync_order: last` half a period later, after the answers of the drives. The frames of the cycle
# are sent before the next SYNC, at which the drives apply them. Without SYNC the cycle continues by its own clock, the
# SYNC task is set up again, and that is reported.
#
# The kernel measures each period from the end of its transmission, so that its SYNC period is too long by its latency
# of some us. The excess is measured from the received SYNCs and subtracted from the period passed to the kernel.


_MISSED = 5  # periods without SYNC until the task is set up again
_RETRY_NS = 500_000_000
_BLOCK, _BLOCKS = 64, 5  # SYNCs in a block, and blocks before a correction
_TRIM_DIVISOR = 20  # a correction is at most a period divided by this, and _LATENCY_US
_LATENCY_US = 100  # a larger excess is caused by pauses of the machine


class SyncTask(Protocol):
    """SYNC producer on a bus that is independent of the control cycle: the kernel or a node."""

    @property
    def sender(self) -> str:
        """Name of the SYNC producer for messages."""

    @property
    def correction(self) -> str:
        """Clause for messages: the effect of a missing SYNC, and the remedy."""

    def start(self, period_us: int) -> None:
        """Start or restart sending SYNC every `period_us`; raise BusError on failure."""

    def adjust(self, period_us: int) -> None:
        """Change the period of the running task without an extra SYNC; raise BusError on failure."""

    def close(self) -> None:
        """Stop sending SYNC."""


class _Excess:
    """Measurement of the difference between the received SYNC period and `period_ns`.

    A SYNC can be received late, but never early, so that the earliest SYNC of a block shows when it was sent; the
    minimum of several blocks counts, because a pause of the machine delays all later SYNCs.
    """

    __slots__ = ("_before", "_count", "_excesses", "_minimum", "_next_check", "_period_ns")

    def __init__(self, period_ns: int) -> None:
        self._period_ns = period_ns
        self.restart()

    def restart(self) -> None:
        """Discard all measurements."""
        self._count = self._next_check = self._minimum = 0
        self._before: int | None = None
        self._excesses: list[int] = []

    def receive_sync(self, now: int) -> int | None:
        """Process a SYNC received at `now`; return the excess of the period in ns once known, else None."""
        if not self._count:
            self._next_check = self._minimum = now
        self._count += 1
        self._minimum = (
            min(self._minimum, now - self._next_check) if self._count % _BLOCK != 1 else now - self._next_check
        )
        self._next_check += self._period_ns
        if self._count % _BLOCK:
            return None
        before, self._before = self._before, self._minimum
        if before is not None:
            self._excesses.append((self._minimum - before) // _BLOCK)
        if len(self._excesses) < _BLOCKS:
            return None
        excess = min(self._excesses)
        self.restart()
        return excess


class NodeSync:
    """SYNC task for a SYNC that a node of the bus produces and this process only receives."""

    sender = "a node of the bus (sync_producer: other)"
    correction = (
        "the cycle continues by its own clock, and drives that wait for SYNC do not move; "
        "enable SYNC production in a node (0x1005)"
    )

    def start(self, period_us: int) -> None:
        """Do nothing; the configuration of the node enables SYNC (0x1005, 0x1006)."""

    def adjust(self, period_us: int) -> None:
        """Do nothing; the period is set in the node."""

    def close(self) -> None:
        """Do nothing; the node continues to send SYNC."""


class ExternalSync:
    """Supervision of a SYNC that the kernel or a node sends; `lead(now)`, unless None, is called for each SYNC.

    `count` is the number of received SYNCs; `first_wait_ns` is additional time until the first SYNC, for the boot of a
    node that produces SYNC.
    """

    def __init__(
        self,
        task: SyncTask,
        period_us: int,
        lead: Callable[[int], None] | None,
        report: Callable[[Event], None],
        first_wait_ns: int = 0,
    ) -> None:
        self._task, self._period_us, self._lead, self._report = task, period_us, lead, report
        self._timeout = max(_MISSED * period_us * 1000, _RETRY_NS // 2)
        self.count = 0
        self._deadline, self._first_wait = 0, first_wait_ns
        self._loss_reported = False
        self._excess, self._trimmed_us = _Excess(period_us * 1000), 0

    def start(self, now: int) -> None:
        """Start the SYNC task and the supervision of SYNC; raise BusError on failure."""
        self._begin()
        self._deadline = now + self._first_wait + self._timeout

    def receive_sync(self, now: int) -> None:
        """Handle a SYNC received at `now` in ns."""
        self.count += 1
        self._deadline = now + self._timeout
        self._loss_reported = False
        if self._lead is not None:
            self._lead(now)
        if (excess := self._excess.receive_sync(now)) is not None:
            self._trim(round(excess / 1000))

    def _begin(self) -> None:
        self._trimmed_us = 0
        self._excess.restart()
        self._task.start(self._period_us)

    def _trim(self, excess_us: int) -> None:
        """Correct the period of the SYNC task for a measured excess in us, within limits."""
        limit = min(self._period_us // _TRIM_DIVISOR, _LATENCY_US)
        trimmed = max(0, min(limit, self._trimmed_us + excess_us))
        if trimmed != self._trimmed_us:
            self._trimmed_us = trimmed
            with contextlib.suppress(BusError):  # a missing SYNC is set up again later
                self._task.adjust(self._period_us - trimmed)

    def tick(self, now: int) -> None:
        """Restart the SYNC task after a timeout, every half second until SYNC is received; report the loss once."""
        if now < self._deadline:
            return
        self._deadline = now + _RETRY_NS
        self._task.close()
        why = self._task.correction
        try:
            self._begin()
        except BusError as error:
            why = str(error)
        if not self._loss_reported:
            self._loss_reported = True
            self._report(
                Event(now, "sync_lost", "", f"no SYNC is received from {self._task.sender}; {why}", Level.WARNING)
            )

    def close(self) -> None:
        """Stop the SYNC task; a second call does nothing."""
        self._task.close()


_LENGTH: Final = 4  # position of the data length in a frame record
_BOOT_UP: Final = bytes([NmtState.INITIALISING])
_WINDOW_NS: Final = 1_000_000_000
_LATE_NS: Final = 10_000_000  # lateness of a cycle beyond which all waiting frames are read first
_BACKLOG: Final = 100  # reads, of up to a thousand frames
_SIMULATED_NS: Final = 250_000_000  # virtual drives in other processes wait for a processor too
_FAILURES: Final = (BusEventKind.BUS_OFF, BusEventKind.DOWN)
_RETURNS: Final = (BusEventKind.ERROR_ACTIVE, BusEventKind.UP)
_LONGEST_NS: Final = 20_000_000  # longest cycle in which the port need not be read
_LOST_BY_FAILURE: Final = ("bus_frames_lost", "while the bus had failed")


def is_simulated(channel: str) -> bool:
    """Whether a channel connects only processes on this computer (vcan, vxcan or `local:`)."""
    parsed = parse_channel(channel)
    virtual = parsed.kind is ChannelKind.SOCKETCAN and parsed.name.startswith(("vcan", "vxcan"))
    return virtual or parsed.kind is ChannelKind.LOCAL


class RobotBus:
    """CAN bus of a robot: passes frames between port and network; a port error closes the bus.

    If `watched`, the reactor reads each frame when it arrives; if not, frames are read at the edges of the cycle: while
    all nodes are ready and no answer is awaited, no frame has an effect before the edge, and a wake-up of the process
    costs more than the cycle. A missing heartbeat or PDO is detected at an edge in both cases, and at the same edge if
    the timeout is a multiple of the period.
    """

    def __init__(
        self,
        name: str,
        channel: str,
        config: BusConfig,
        reactor: Reactor,
        *,
        cycle_ns: int,
        report: Callable[[Event], None],
        on_lost: Callable[[BusError], None],
    ) -> None:
        self.name, self.channel, self.config = name, channel, config
        self.bitrate = config.master.baudrate * 1000
        self.network = Network(name, config, report, cycle_ns)
        self.port: Port | None = None
        self.load: float | None = None
        self.booted_up: set[int] = set()  # nodes whose boot-up message was received between `join` and `open`
        self._reactor, self._report, self._on_lost = reactor, report, on_lost
        self._synchronous = config.master.sync_period > 0
        self._sync_with_rpdos = not config.master.sends_sync_first
        self._followed: ExternalSync | None = None
        self._by_kernel = False
        self._syncs = 0  # received SYNCs at the time of the last cycle's RPDOs
        self._writing = False
        self._lost_frames = 0
        self._loss_reported_at = -_WINDOW_NS
        self._failed = self._failed_meanwhile = False
        self._data_bytes = 0
        self._late_ns = cycle_ns + max(cycle_ns, _LATE_NS)
        self._drained_at = 0  # time at which no frame waited at the port
        self.network.reader = self.network.pdo_watch.reader = self
        if is_simulated(channel):
            self.network.pdo_watch.min_ns = _SIMULATED_NS
        self.watched = True
        times = [plan.heartbeat_timeout_ns for plan in config.plans.values()]
        times += [pdo.age_limit_ns for pdo in self.network.image.inputs.values()]
        self._may_rest = cycle_ns <= _LONGEST_NS and not any(time % cycle_ns for time in times)
        self._window: tuple[int, int] | None = None  # start of the measurement, and the number of bits at that time
        self._measure_at = 0

    @property
    def sends_sync_first(self) -> bool:
        """Whether this process sends SYNC before the RPDOs of a cycle."""
        return self._synchronous and self._followed is None and not self._sync_with_rpdos

    @property
    def follows_sync(self) -> bool:
        """Whether the cycle follows the SYNC of the kernel or of a node."""
        return self._followed is not None

    def unserved_syncs(self) -> int:
        """Return the number of SYNCs since the last call that were not followed by a cycle."""
        if self._followed is None:
            return 0
        syncs, self._syncs = self._followed.count - self._syncs, self._followed.count
        return max(0, syncs - 1)

    @property
    def sync_words(self) -> str:
        """Text about the producer and the timing of SYNC."""
        return self.config.master.sync_words(by_kernel=self._by_kernel)

    def why_no_kernel_sync(self) -> str | None:
        """Return why the kernel cannot send SYNC on this SocketCAN interface, or None if it can."""
        return KernelSync(parse_channel(self.channel).name, ()).why_not()

    def leave_sync_to_kernel(self, lead: Callable[[int], None] | None) -> None:
        """Let the kernel send SYNC, and call `lead(now)` for each SYNC; before `open`, on SocketCAN only."""
        sync = self.network.sync
        task = KernelSync(parse_channel(self.channel).name, [sync.frame() for _ in range(max(1, sync.overflow))])
        self._by_kernel = True
        self._follow(ExternalSync(task, self.config.master.sync_period, lead, self._report))

    def follow_sync(self, lead: Callable[[int], None] | None) -> None:
        """Follow the SYNC of a node, and call `lead(now)` for each SYNC; before `open` only."""
        master = self.config.master
        first_wait_ns = (master.boot_time or DEFAULT_BOOT_MS) * 1_000_000
        self._follow(ExternalSync(NodeSync(), master.sync_period, lead, self._report, first_wait_ns))

    def _follow(self, sync: ExternalSync) -> None:
        self._followed = sync
        self.network.hear_sync(sync.receive_sync)

    def join(self) -> None:
        """Open the channel; until `open`, only boot-up messages are processed. Raise BusError on failure."""
        if self.port is None:
            self.port = open_port(self.channel, label="master")
            self._reactor.add_reader(self.port.fileno(), self._note_boot_ups)

    def open(self) -> None:
        """Start processing received frames, opening the channel first if necessary; raise BusError on failure."""
        self.join()
        if self.port is None:
            return
        self._note_boot_ups()
        set_filter(self.port, self.network.identifiers)
        if self._followed is not None:
            self._followed.start(self._reactor.now())
        self._drained_at = self._reactor.now()
        self.watch()

    def watch(self) -> None:
        """Read frames in the reactor as they arrive, not at cycle edges."""
        self.watched = True
        if self.port is not None:
            self._reactor.add_reader(self.port.fileno(), self.receive)

    def select_reception(self) -> None:
        """Read frames at cycle edges if the cycle permits and no answer is awaited, else as they arrive."""
        rests = self._may_rest and self._followed is None and not self.network.waits
        if rests is not self.watched:
            return
        if not rests:
            self.watch()
        elif self.port is not None:
            self.watched = False
            self._reactor.remove_reader(self.port.fileno())

    def _take(self) -> bytes:
        """Return the pending records to send; if they request answers, watch the port."""
        if not self.watched and self.network.waits:
            self.watch()
        return self.network.take()

    def _note_boot_ups(self) -> None:
        """Discard received frames except boot-up messages, which are recorded; a port error closes the bus."""
        try:
            records = b"" if self.port is None else self.port.receive()
        except BusError as error:
            self._lost(error)
            return
        self.booted_up.update(
            frame.can_id - ERROR_CONTROL_COB_ID for frame in frames_of(records) if frame.data == _BOOT_UP
        )

    def follow_identifiers(self) -> None:
        """Set the receive filter of the channel to the identifiers that the network needs."""
        if self.port is not None:
            set_filter(self.port, self.network.identifiers)

    def receive(self, edge: int | None = None) -> None:
        """Process all received frames and send replies; `edge` is the nominal time of reception, None for now."""
        port, network = self.port, self.network
        if port is None:
            return
        try:
            records = port.receive()
        except BusError as error:
            self._lost(error)
            return
        if records:
            self._data_bytes += sum(records[_LENGTH::RECORD_SIZE])
            now, since = self._reactor.now() if edge is None else edge, self._drained_at
            network.receive(records, now, since if now - since > self._late_ns else None)
            if network.outgoing:
                self._send(self._take())
        # if sending has closed the port, that has been reported
        for event in port.events() if self.port is port else ():
            self._on_bus_event(event)

    def tick(self, now: int) -> None:
        """Process timeouts of the network's services and send the resulting frames; measure bus load and frame loss."""
        network = self.network
        if now - self._drained_at > self._late_ns:
            self.catch_up()
            network.was_away(now - self._drained_at)
        self._drained_at = now
        network.tick(now)
        if network.outgoing:
            self._send(self._take())
        port = self.port
        if port is None:
            return
        if self._followed is not None:
            self._followed.tick(now)
        if now >= self._measure_at:
            self._measure(port.stats, now)
        if port.stats.lost != self._lost_frames:
            self._report_lost(port.stats.lost, now)

    def send_sync(self, now: int) -> None:
        """Send SYNC at the beginning of a cycle, before the RPDOs."""
        self._send(self.network.sync_record())
        self._sent_sync(now)

    def send_cycle(self, now: int) -> None:
        """Send pending frames and the due RPDOs, followed by SYNC if this process sends it last."""
        network = self.network
        with_sync = self._synchronous and self._sync_with_rpdos
        records = network.cycle(sync=with_sync)
        self._send(self._take() + records if network.outgoing else records)
        if with_sync or self._followed is not None or not self._synchronous:
            self._sent_sync(now)

    def _sent_sync(self, now: int) -> None:
        network, port = self.network, self.port
        if port is not None and not port.stats.queued:  # with a non-empty queue SYNC is still queued
            network.synced(now)

    def catch_up(self) -> None:
        """Process all frames waiting at the port after a delay of the process."""
        for _ in range(_BACKLOG):
            port = self.port
            before = port.stats.rx if port is not None else 0
            self.receive()
            if port is None or port.stats.rx == before:
                return

    def send_waiting(self) -> None:
        """Send pending frames (NMT, SDO), but no process data."""
        self.network.changed()
        self._send(self._take())

    def release_nodes(self, doubtful: Container[RemoteNode]) -> None:
        """Reset the communication of the nodes, if permitted, to end their monitoring of the master's heartbeat.

        The `doubtful` nodes keep it: a drive that may still have power stops by itself when the heartbeat ends. A node
        with `boot: false` may belong to another master.
        """
        for node in self.network.nodes.values():
            # CiA 301, 7.3.2.2.1: a reset communication restores 0x1000 to 0x1FFF, and so the heartbeat consumer
            if node.is_managed and node.config.boot.reset_communication and node not in doubtful:
                self.network.send_nmt(NmtCommand.RESET_COMMUNICATION, node.node_id)
        self.send_waiting()

    def close(self) -> None:
        """Stop the SYNC task and close the channel; a second call does nothing."""
        if self._followed is not None:
            self._followed.close()
        if self.port is not None:
            self._reactor.remove_reader(self.port.fileno())
            if self._writing:
                self._reactor.remove_writer(self.port.fileno())
            self.port.close()
            self.port = None

    def _send(self, records: bytes) -> None:
        port = self.port
        if not records or port is None:
            return
        self._data_bytes += sum(records[_LENGTH::RECORD_SIZE])
        try:
            port.send(records)
        except BusError as error:
            self._lost(error)
            return
        if port.wants_write and not self._writing:
            self._writing = True
            self._reactor.add_writer(port.fileno(), self._flush)

    def _flush(self) -> None:
        if self.port is None:
            return
        try:
            self.port.flush()
        except BusError as error:
            self._lost(error)
            return
        if not self.port.wants_write:
            self._writing = False
            self._reactor.remove_writer(self.port.fileno())

    def _lost(self, error: BusError) -> None:
        self.close()
        self._report(Event(self._reactor.now(), "bus_lost", "", str(error), Level.ERROR))
        self._on_lost(error)

    def _on_bus_event(self, event: BusEvent) -> None:
        """Report a bus event; pass a failure (bus-off, interface down) or a recovery to the network."""
        now = self._reactor.now()
        kind = event.kind.value.replace("-", "_")
        level = Level.INFO if kind in ("up", "error_active") else Level.WARNING
        self._report(Event(now, f"bus_{kind}", "", f"bus {self.name} ({self.channel}): {event.text}", level))
        if event.kind in _FAILURES:
            self._failed = self._failed_meanwhile = True
            self.network.bus_failed(f"no frame can be sent or received on bus {self.name}: {event.text}", now)
        elif event.kind in _RETURNS:
            self._failed = False
            self.network.bus_back(now)

    def _report_lost(self, lost: int, now: int) -> None:
        """Report lost frames with the reason, at most once a second; on a failed bus, not before it has recovered."""
        if now - self._loss_reported_at < _WINDOW_NS or self._failed:
            return
        kind, why = ("bus_queue_full", "the send queue was full") if not self._failed_meanwhile else _LOST_BY_FAILURE
        text = f"bus {self.name} ({self.channel}): a frame was lost, {why}"
        self._report(Event(now, kind, "", text, Level.WARNING, count=lost - self._lost_frames))
        self._failed_meanwhile = False
        self._lost_frames, self._loss_reported_at = lost, now

    def _measure(self, stats: PortStats, now: int) -> None:
        """Compute the bus load of the last second, without stuff bits."""
        bits = FRAME_BITS * (stats.rx + stats.tx) + 8 * self._data_bytes
        if self._window is not None and self.bitrate > 0:
            since, before = self._window
            self.load = (bits - before) * 1e9 / (now - since) / self.bitrate
        self._window, self._measure_at = (now, bits), now + _WINDOW_NS
