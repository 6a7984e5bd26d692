"""Process of virtual drives, independent of any master.

The process prints a line for each bus when the nodes are on the bus, and then their events as sentences. SIGTERM and
SIGINT end the process with exit code 0. When the parent process ends (the lifeline breaks), the process waits at
most five seconds for its drives to stop by themselves, because their master is missing. The process waits for a
channel that is only down; a missing channel is reopened if it returns within three seconds, else the bus is abandoned.
BusClosed ends the process when the last bus is abandoned.
"""

from __future__ import annotations

import signal
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Final

from canopen_control.cia301.lss import UNCONFIGURED
from canopen_control.host.lifeline import lifeline_fd, report_ready
from canopen_control.host.sockets import SocketInUse
from canopen_control.virtual.control import NodeControl
from canopen_control.virtual.node_host import NodeHost, NodeIdTaken
from canopen_control.virtual.node_outbox import NodeIdChanged, in_words
from canopen_control.virtual.shaft import ShaftWorld

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable, Sequence

    from canopen_control.bus.port import BusEvent, Port
    from canopen_control.errors import BusClosed
    from canopen_control.host.reactor import Reactor
    from canopen_control.virtual.plant import World
    from canopen_control.virtual.scenario import ScenarioEvent
    from canopen_control.virtual.virtual_node import VirtualNode


# Virtual nodes on one bus, in a process of drives: their host, their control sockets, their log and their timeline.
#
# A missing channel is reopened if it returns within three seconds; otherwise the bus is abandoned, and its nodes
# continue without a bus.


_MS = 1_000_000
REJOIN_NS = 3_000 * _MS
WINDOW_NS: Final = 10_000_000_000
_SAME_LINES = 10  # equal lines that are written before they are only counted
_RETRY_NS = 100 * _MS


def _never() -> None:
    return None


@dataclass(frozen=True)
class BusNodes:
    """Nodes for an opened port; `reopen` reopens the channel, or returns None while it is missing.

    `timeline` is played from the ready line on; `world` has the plants of the axes.
    """

    port: Port
    nodes: Sequence[VirtualNode]
    reopen: Callable[[], Port | None] = field(default=_never)
    timeline: Sequence[ScenarioEvent] = ()
    world: World | None = None


class ServedBus:
    """Nodes of one bus with their host, control sockets, log and timeline, from `open` to `close`.

    `log` receives the lines of the log, `on_lost` is called when the bus is abandoned. `error` is the reason why the
    channel is missing, None while the channel works.
    """

    def __init__(
        self, reactor: Reactor, bus: BusNodes, log: Callable[[str], None], on_lost: Callable[[], object]
    ) -> None:
        self._reactor, self._bus, self._log, self._on_lost = reactor, bus, log, on_lost
        self.port, self.nodes, self.world = bus.port, list(bus.nodes), bus.world
        self._folded = FoldedLog(reactor, log)
        self._started_with = {node.node_id: node for node in self.nodes}
        self._controls: dict[VirtualNode, NodeControl] = {}
        self._host: NodeHost | None = None
        self._rejoin_until = 0
        self.error: BusClosed | None = None

    def open(self) -> None:
        """Start the nodes and their control sockets; raise NodeIdTaken if another process uses a node-ID."""
        self._host = NodeHost(
            self._reactor,
            self.port,
            self.nodes,
            on_event=self._on_event,
            on_bus_event=self._on_bus_event,
            on_closed=self._on_closed,
        )
        for node in self.nodes:
            try:
                self._controls[node] = NodeControl(self._host, node, self.world)
            except SocketInUse as error:
                if node.node_id != UNCONFIGURED:
                    raise NodeIdTaken(node.node_id, self.port.channel) from error
                self._controls[node] = NodeControl(self._host, node, self.world, with_socket=False)
                self._log(
                    "another drive without a node-ID has the control socket; this drive has none until it gets an id"
                )

    def close(self) -> None:
        if self._host is not None:
            self._host.close()
        for control in self._controls.values():
            control.close()
        self.port.close()

    def play_timeline(self) -> None:
        """Start the timeline of the scenario, if any."""
        if self._bus.timeline:
            from canopen_control.virtual.scenario import Timeline  # imports YAML, which is slow

            Timeline(self._reactor, self._controls, self._started_with, self._log).plan(self._bus.timeline)

    def advance(self, now: int) -> None:
        for node in self.nodes:
            node.advance_drives(now)

    @property
    def moving(self) -> bool:
        return any(not drive.mover.at_standstill for node in self.nodes for drive in node.drives.values())

    @property
    def ready_line(self) -> str:
        """Line that names the nodes and the channel, printed once all nodes are ready."""
        ids = [node.node_id for node in self.nodes]
        kind = "drive" if self.nodes[0].drives else "node"
        which = f"{kind} {ids[0]}" if len(ids) == 1 else f"{kind}s {', '.join(map(str, ids))}"
        name = self.nodes[0].name
        if ids == [UNCONFIGURED]:
            # LSS finds the node by its serial number
            name += f", serial number {self.nodes[0].store.number(0x1018, 4)}"
        return f"{which} ({name}) ready on {self.port.channel}"

    # -- events

    def _on_event(self, node: VirtualNode, event: object) -> None:
        words = in_words(event)
        if words is None:
            return
        line = f"node {node.node_id}: {words}"
        self._folded.report(line, line, _SAME_LINES)
        if node in self._controls:
            self._controls[node].push(words)
            if isinstance(event, NodeIdChanged) and self._host is not None:
                self._rename(self._host, node)

    def _rename(self, host: NodeHost, node: VirtualNode) -> None:
        """Replace the control socket after a change of the node-ID, which is part of its name."""
        self._controls[node].close()
        try:
            self._controls[node] = NodeControl(host, node, self.world)
        except SocketInUse:
            self._controls[node] = NodeControl(host, node, self.world, with_socket=False)
            self._log(f"node {node.node_id}: another virtual drive has this id; this node has no control socket")

    def _on_bus_event(self, event: BusEvent) -> None:
        """Log the first bus event of a kind at once, and further ones within 10 s as a summary."""
        self._folded.report(event.kind, event.text, 1)

    def _on_closed(self, error: BusClosed) -> None:
        self.error = error
        self._log(str(error))
        self._rejoin_until = self._reactor.now() + (0 if self._bus.reopen is _never else REJOIN_NS)
        self._rejoin()

    def _rejoin(self) -> None:
        """Try to reopen the channel until `REJOIN_NS` have passed; then abandon the bus."""
        if self.error is None or self._host is None:
            return
        port = self._bus.reopen()
        if port is not None:
            self.port.close()
            self.port, self.error = port, None
            self._log(f"{port.channel} is back")
            self._host.rejoin(port)
        elif self._reactor.now() < self._rejoin_until:
            self._reactor.call_later(_RETRY_NS, self._rejoin)
        else:
            self._on_lost()


class FoldedLog:
    """Rate-limited log: in each 10 s, the first lines of a kind are written, and the rest are summarised."""

    def __init__(self, reactor: Reactor, write: Callable[[str], object]) -> None:
        self._reactor, self._write = reactor, write
        self._counts: dict[Hashable, int] = {}
        self._left_out: dict[Hashable, tuple[str, int]] = {}

    def report(self, kind: Hashable, text: str, at_most: int) -> None:
        """Write a line, or only count it if `at_most` lines of its kind were written in the present 10 s."""
        if not self._counts:
            self._reactor.call_later(WINDOW_NS, self._end_window)
        count = self._counts[kind] = self._counts.get(kind, 0) + 1
        if count <= at_most:
            self._write(text)
        else:
            self._left_out[kind] = (text, count - at_most)

    def _end_window(self) -> None:
        left_out, self._left_out = self._left_out, {}
        self._counts = {}
        for text, count in left_out.values():
            self._write(f"{text} ({count} more times in {WINDOW_NS // 1_000_000_000} s)")


STANDSTILL_NS = 5_000 * _MS
_CHECK_NS = 20 * _MS


class DriveProcess:
    """Process that runs nodes on the opened ports of their buses; `report` receives the lines of the log."""

    def __init__(self, reactor: Reactor, buses: Sequence[BusNodes], report: Callable[[str], None]) -> None:
        self._reactor, self._report = reactor, report
        self._buses: list[ServedBus] = []
        for bus in buses:
            log = partial(self._log, f"{bus.port.channel}: " if len(buses) > 1 else "")
            self._buses.append(ServedBus(reactor, bus, log, self._on_lost))
        self._early: list[str] | None = []  # lines of the log before the ready line
        self._started = reactor.now()
        self._lifeline = lifeline_fd()
        self._standstill_until: int | None = None
        self._ended = False  # also if the end came before the loop started
        self._lost: BusClosed | None = None

    def run(self) -> int:
        """Run until a signal arrives or the parent process ends; return the exit code.

        Raise NodeIdTaken if a node-ID is in use, and BusClosed if every bus is lost.
        """
        self._reactor.handle_signals({signal.SIGTERM: self._end, signal.SIGINT: self._end})
        try:
            for bus in self._buses:
                bus.open()
            self._serve()
        finally:
            for bus in self._buses:
                bus.close()
        if self._lost is not None:
            raise self._lost
        return 0

    def _serve(self) -> None:
        if self._lifeline is not None:
            self._reactor.add_reader(self._lifeline, self._on_orphaned)
        self._reactor.run_for(0)  # the boot-up messages are sent before the line is printed
        for bus in self._buses:
            self._report(bus.ready_line)
        report_ready()
        for line in self._early or ():
            self._report(line)
        self._early = None
        for bus in self._buses:
            bus.play_timeline()
        self._plan_to_keep_up()
        if not self._ended:
            self._reactor.run()

    def _end(self) -> None:
        self._lost = None
        self._leave()

    def _leave(self) -> None:
        self._ended = True
        self._reactor.stop()

    @property
    def _worlds(self) -> list[World]:
        return [bus.world for bus in self._buses if bus.world is not None]

    def _plan_to_keep_up(self) -> None:
        periods = [world.period_ns for world in self._worlds if world.period_ns is not None]
        if periods:
            self._reactor.call_later(min(periods), self._keep_up)

    def _keep_up(self) -> None:
        """Advance all axes to the current time, and publish shaft positions to other processes."""
        self._advance()
        for world in self._worlds:
            if isinstance(world, ShaftWorld):
                world.publish()
        self._plan_to_keep_up()

    def _advance(self) -> None:
        now = self._reactor.now()
        for bus in self._buses:
            bus.advance(now)

    # -- events

    def _log(self, prefix: str, text: str) -> None:
        line = f"{(self._reactor.now() - self._started) * 1e-9:9.3f} {prefix}{text}"
        if self._early is None:
            self._report(line)
        else:
            self._early.append(line)

    def _on_lost(self) -> None:
        """End the process if all buses are abandoned."""
        errors = [bus.error for bus in self._buses]
        if all(error is not None for error in errors):
            self._lost = errors[0]
            self._leave()

    def _on_orphaned(self) -> None:
        """Handle the end of the parent process: end this process when its drives stand still, or after 5 s."""
        if self._lifeline is not None:
            self._reactor.remove_reader(self._lifeline)
        self._log("", "the parent process has ended; waiting until the drives stand still")
        self._standstill_until = self._reactor.now() + STANDSTILL_NS
        self._check_standstill()

    def _check_standstill(self) -> None:
        self._advance()
        if any(bus.moving for bus in self._buses) and self._reactor.now() < (self._standstill_until or 0):
            self._reactor.call_later(_CHECK_NS, self._check_standstill)
        else:
            self._leave()
