"""Starts the process of virtual drives quickly: the bus is asked first, everything else is imported while it answers.

The law of this file: a node id that answers on the bus already is refused. The question is an upload of 0x1000, which
every node has; whoever answers it, or is heard with a heartbeat, holds the id.
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from typing import TYPE_CHECKING

from canopen_control.bus.channel import ChannelKind, open_port, parse_channel
from canopen_control.cia301.sdo_codec import ANSWER_BASE, INITIATE, REQUEST_BASE, UPLOAD
from canopen_control.errors import BusError
from canopen_control.frame import CanFrame, frames_of, pack_records
from canopen_control.host.reactor import Reactor
from canopen_control.host.sockets import list_sockets

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from canopen_control.bus.port import Port

__all__ = ["PROBE_NS", "NodeIdTaken", "Options", "Probe", "run_drives"]

PROBE_NS = 40_000_000  # how long a node that is there already may take to answer
_DEVICE_TYPE = INITIATE.pack(UPLOAD, 0x1000, 0)


class NodeIdTaken(BusError):
    """Another node answers with the id."""

    def __init__(self, node_id: int, channel: str) -> None:
        self.node_id = node_id
        super().__init__(f"node id {node_id} already answers on {channel}; choose another --node-id, or end that node")


class Probe:
    """Asks whether `node_ids` are free on `port`, from the moment it is made."""

    def __init__(self, reactor: Reactor, port: Port, node_ids: Sequence[int]) -> None:
        self._reactor, self._port = reactor, port
        self._answers = {base + node_id: node_id for node_id in node_ids for base in (ANSWER_BASE, 0x700)}
        self._taken: int | None = None
        self._until = reactor.now() + PROBE_NS
        port.send(pack_records([CanFrame(REQUEST_BASE + node_id, _DEVICE_TYPE) for node_id in node_ids]))

    def finish(self) -> None:
        """Wait for what is left of the time; raise NodeIdTaken when somebody was heard."""
        self._reactor.add_reader(self._port, self._listen)
        self._reactor.run_until(lambda: self._taken is not None, max(0, self._until - self._reactor.now()))
        self._reactor.remove_reader(self._port)
        if self._taken is not None:
            raise NodeIdTaken(self._taken, self._port.channel)

    def _listen(self) -> None:
        for frame in frames_of(self._port.receive()):
            self._taken = self._answers.get(frame.can_id, self._taken)


@dataclass(frozen=True, slots=True)
class Options:
    """What to start besides the nodes: files, and faults ``name`` or ``name@seconds``.

    `serial` is 0x1018:04, of several nodes the first one's; None: the node id.
    """

    faults: Sequence[str] = ()
    serial: int | None = None
    store: Path | None = None
    scenario: Path | None = None
    plant: Path | None = None


def run_drives(node_ids: Sequence[int], eds: Path, channel: str, options: Options, say: Callable[[str], None]) -> int:
    """Run the virtual devices of an EDS until told to end; return the exit code.

    Raises EdsError and ConfigError for what cannot be started, BusError for the channel.
    """
    label = f"drive {node_ids[0]}" if len(node_ids) == 1 else f"drives {node_ids[0]}-{node_ids[-1]}"
    with Reactor() as reactor:
        port = open_port(channel, label=label)
        try:
            probe = Probe(reactor, port, node_ids)
            from canopen_control.virtual.crew import make_crew
            from canopen_control.virtual.process import DriveProcess

            crew = make_crew(node_ids, eds, options, say)
            probe.finish()
            with contextlib.closing(crew.world):
                process = DriveProcess(
                    reactor,
                    port,
                    crew.nodes,
                    say,
                    reopen=lambda: _reopen(channel, label),
                    timeline=crew.timeline,
                    world=crew.world,
                )
                return process.run()
        finally:
            port.close()


def _reopen(channel: str, label: str) -> Port | None:
    """Open a channel that was gone, None where it is not back. A local bus is not started for it."""
    spec = parse_channel(channel)
    if spec.kind.in_process or (spec.kind is ChannelKind.LOCAL and spec.name not in list_sockets("bus")):
        return None
    try:
        return open_port(channel, label=label)
    except BusError:
        return None
