"""Virtual drives as an operating system process of their own, which knows nothing of any master.

It prints one line when its nodes are on the bus, then what happens to them, in words. SIGTERM and SIGINT end it with
exit code 0. When its parent dies (the lifeline breaks) it serves on until its drives stand still by their own reaction
to the missing master, five seconds at most. A channel that is only down is waited for; one that is gone is opened again
when it is back within three seconds, else BusClosed ends it.
"""

from __future__ import annotations

import signal
from typing import TYPE_CHECKING, Final

from canopen_control.host.lifeline import lifeline_fd, report_ready
from canopen_control.host.sockets import SocketInUse
from canopen_control.virtual.control import NodeControl
from canopen_control.virtual.node_events import NodeIdChanged, in_words
from canopen_control.virtual.node_id_check import NodeIdTaken
from canopen_control.virtual.nodehost import NodeHost
from canopen_control.virtual.shaft import ShaftWorld

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable, Sequence

    from canopen_control.bus.port import BusEvent, Port
    from canopen_control.errors import BusClosed
    from canopen_control.host.reactor import Reactor
    from canopen_control.virtual.plant import World
    from canopen_control.virtual.scenario import Switching
    from canopen_control.virtual.virtual_node import VirtualNode


__all__ = ["WINDOW_NS", "DriveProcess", "FoldedLog"]

_MS = 1_000_000
STANDSTILL_NS = 5_000 * _MS
REJOIN_NS = 3_000 * _MS
WINDOW_NS: Final = 10_000_000_000
_SAME_LINES = 10  # of one node, before they are summed
_LOOK_NS = 20 * _MS
_RETRY_NS = 100 * _MS


def _never() -> None:
    return None


class DriveProcess:
    """The nodes of one process on an opened port; `say` takes the lines of the log.

    `reopen` opens the channel again where it is back, else it returns None; `timeline` is played from the ready line
    on; `world` is what hangs on the axes.
    """

    def __init__(
        self,
        reactor: Reactor,
        port: Port,
        nodes: Sequence[VirtualNode],
        say: Callable[[str], None],
        *,
        reopen: Callable[[], Port | None] = _never,
        timeline: Sequence[Switching] = (),
        world: World | None = None,
    ) -> None:
        self._reactor, self._port, self._nodes, self._say = reactor, port, list(nodes), say
        self._folded = FoldedLog(reactor, self._log)
        self._reopen, self._timeline, self._world = reopen, timeline, world
        self._started_with = {node.node_id: node for node in self._nodes}
        self._host: NodeHost | None = None
        self._rejoin_until = 0
        self._early: list[str] | None = []  # what happened before the ready line
        self._started = reactor.now()
        self._controls: dict[VirtualNode, NodeControl] = {}
        self._lifeline = lifeline_fd()
        self._standstill_until: int | None = None
        self._ended = False  # also when that came before the loop that it ends
        self._lost: BusClosed | None = None

    def run(self) -> int:
        """Serve until a signal, or the parent's end; return the exit code. Raises BusClosed, or NodeIdTaken."""
        self._reactor.handle_signals({signal.SIGTERM: self._end, signal.SIGINT: self._end})
        self._host = host = NodeHost(
            self._reactor,
            self._port,
            self._nodes,
            on_event=self._on_event,
            on_bus_event=self._on_bus_event,
            on_closed=self._on_closed,
        )
        try:
            for node in self._nodes:
                self._controls[node] = NodeControl(host, node, self._world)
            self._serve()
        except SocketInUse as error:
            raise NodeIdTaken(self._nodes[len(self._controls)].node_id, self._port.channel) from error
        finally:
            host.close()
            for control in self._controls.values():
                control.close()
            self._port.close()
        if self._lost is not None:
            raise self._lost
        return 0

    def _serve(self) -> None:
        if self._lifeline is not None:
            self._reactor.add_reader(self._lifeline, self._on_orphaned)
        self._reactor.run_for(0)  # the boot-up messages are out before anybody reads the line
        self._say(self._ready_line())
        report_ready()
        for line in self._early or ():
            self._say(line)
        self._early = None
        self._play_timeline()
        if self._world is not None and self._world.period_ns is not None:
            self._reactor.call_later(self._world.period_ns, self._keep_up)
        if not self._ended:
            self._reactor.run()

    def _play_timeline(self) -> None:
        if self._timeline:
            from canopen_control.virtual.scenario import Timeline  # with it comes YAML, which is slow to import

            Timeline(self._reactor, self._controls, self._started_with, self._log).plan(self._timeline)

    def _end(self) -> None:
        self._lost = None
        self._leave()

    def _leave(self) -> None:
        self._ended = True
        self._reactor.stop()

    def _keep_up(self) -> None:
        """Bring all axes to the present, for a world that wants to know them."""
        now = self._reactor.now()
        for node in self._nodes:
            node.advance_drives(now)
        if isinstance(self._world, ShaftWorld):
            self._world.publish()
        if self._world is not None and self._world.period_ns is not None:
            self._reactor.call_later(self._world.period_ns, self._keep_up)

    def _ready_line(self) -> str:
        ids = [node.node_id for node in self._nodes]
        kind = "drive" if self._nodes[0].drives else "node"
        which = f"{kind} {ids[0]}" if len(ids) == 1 else f"{kind}s {', '.join(map(str, ids))}"
        return f"{which} ({self._nodes[0].name}) ready on {self._port.channel}"

    # -- what happens

    def _log(self, text: str) -> None:
        line = f"{(self._reactor.now() - self._started) * 1e-9:9.3f} {text}"
        if self._early is None:
            self._say(line)
        else:
            self._early.append(line)

    def _on_event(self, node: VirtualNode, event: object) -> None:
        words = in_words(event)
        if words is None:
            return
        line = f"node {node.node_id}: {words}"
        self._folded.tell(line, line, _SAME_LINES)
        if node in self._controls:
            self._controls[node].push(words)
            if isinstance(event, NodeIdChanged) and self._host is not None:
                self._rename(self._host, node)

    def _rename(self, host: NodeHost, node: VirtualNode) -> None:
        """Let the control socket bear the node's new id."""
        self._controls[node].close()
        try:
            self._controls[node] = NodeControl(host, node, self._world)
        except SocketInUse:
            self._log(f"node {node.node_id}: another virtual drive has this id; this one has no control socket")

    def _on_bus_event(self, event: BusEvent) -> None:
        """Tell what the controller reports: the first of its kind at once, those of the next seconds in sum."""
        self._folded.tell(event.kind, event.text, 1)

    def _on_closed(self, error: BusClosed) -> None:
        self._lost = error
        self._log(str(error))
        self._rejoin_until = self._reactor.now() + (0 if self._reopen is _never else REJOIN_NS)
        self._rejoin()

    def _rejoin(self) -> None:
        """Open the channel again as soon as it is back; end when that takes too long."""
        if self._lost is None or self._host is None:
            return
        port = self._reopen()
        if port is not None:
            self._port.close()
            self._port, self._lost = port, None
            self._log(f"{port.channel} is back")
            self._host.rejoin(port)
        elif self._reactor.now() < self._rejoin_until:
            self._reactor.call_later(_RETRY_NS, self._rejoin)
        else:
            self._leave()

    def _on_orphaned(self) -> None:
        """Wait for the drives' own reaction to a missing master, then end."""
        if self._lifeline is not None:
            self._reactor.remove_reader(self._lifeline)
        self._log("the parent process is gone; ending when the drives stand still")
        self._standstill_until = self._reactor.now() + STANDSTILL_NS
        self._look_for_standstill()

    def _look_for_standstill(self) -> None:
        now = self._reactor.now()
        for node in self._nodes:
            node.advance_drives(now)
        moving = any(not drive.mover.standing for node in self._nodes for drive in node.drives.values())
        if moving and now < (self._standstill_until or 0):
            self._reactor.call_later(_LOOK_NS, self._look_for_standstill)
        else:
            self._leave()


class FoldedLog:
    """A log without floods: of one `kind` the first `at_most` in 10 s, then the newest with how many there were."""

    def __init__(self, reactor: Reactor, write: Callable[[str], object]) -> None:
        self._reactor, self._write = reactor, write
        self._counts: dict[Hashable, int] = {}
        self._left_out: dict[Hashable, tuple[str, int]] = {}

    def tell(self, kind: Hashable, text: str, at_most: int) -> None:
        """Write a line, or count it where its kind has had as many as it may."""
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
