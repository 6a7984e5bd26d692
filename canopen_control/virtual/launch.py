"""Fast start of a process of virtual drives: modules are imported while the bus check is in progress.

A node-ID that another node on the bus already uses is refused.
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING

from canopen_control.bus.channel import open_port, parse_channel
from canopen_control.cia301.lss import UNCONFIGURED
from canopen_control.cia301.nmt import ERROR_CONTROL_COB_ID
from canopen_control.cia301.sdo_codec import ANSWER_BASE, INITIATE, REQUEST_BASE, UPLOAD
from canopen_control.errors import BusError
from canopen_control.frame import CanFrame, frames_of, pack_records
from canopen_control.host.reactor import Reactor
from canopen_control.virtual.node_host import NodeIdTaken

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    from canopen_control.bus.port import Port
    from canopen_control.od.model import Address


# Check on the bus whether node-IDs are free, before virtual drives use them.
#
# The request is an upload of 0x1000, which every node has; a node that answers, or sends a heartbeat, uses the node-ID.


PROBE_NS = 40_000_000  # response time of a node on the bus
_DEVICE_TYPE = INITIATE.pack(UPLOAD, 0x1000, 0)


class NodeIdCheck:
    """Check whether other nodes on `port` use `node_ids`; the constructor sends the requests.

    The node-ID 255 (unconfigured) is not checked: by CiA 305 any number of such nodes may wait on one bus for a
    node-ID.
    """

    def __init__(self, reactor: Reactor, port: Port, node_ids: Sequence[int]) -> None:
        self._reactor, self._port = reactor, port
        node_ids = [node_id for node_id in node_ids if node_id != UNCONFIGURED]
        self._answers = {
            base + node_id: node_id for node_id in node_ids for base in (ANSWER_BASE, ERROR_CONTROL_COB_ID)
        }
        self._used_id: int | None = None
        self._until = reactor.now() + PROBE_NS
        port.send(pack_records([CanFrame(REQUEST_BASE + node_id, _DEVICE_TYPE) for node_id in node_ids]))

    def finish(self) -> None:
        """Wait for the rest of the response time; raise NodeIdTaken if another node has responded."""
        self._reactor.add_reader(self._port, self._listen)
        self._reactor.run_until(lambda: self._used_id is not None, max(0, self._until - self._reactor.now()))
        self._reactor.remove_reader(self._port)
        if self._used_id is not None:
            raise NodeIdTaken(self._used_id, self._port.channel)

    def _listen(self) -> None:
        for frame in frames_of(self._port.receive()):
            self._used_id = self._answers.get(frame.can_id, self._used_id)


@dataclass(frozen=True, slots=True)
class DriveOptions:
    """Options of `run_drives`: files, faults, quirks and identity of the devices.

    Faults are ``name`` or ``name@seconds``, quirks ``name=value@axis``. `like` is a personality, given by name or as a
    file. `serial` is 0x1018:04 of the first node, None for the node-ID. `others` maps node-IDs to the EDS
    files of nodes that do not have the common EDS, `objects` to values of objects that replace those of the EDS.
    """

    faults: Sequence[str] = ()
    quirks: Sequence[str] = ()
    like: str | None = None
    serial: int | None = None
    store: Path | None = None
    scenario: Path | None = None
    plant: Path | None = None
    others: Mapping[int, Path] = field(default_factory=dict)
    objects: Mapping[int, Mapping[Address, int]] = field(default_factory=dict)


def run_drives(
    node_ids: Sequence[int], eds: Path, channel: str, options: DriveOptions, report: Callable[[str], None]
) -> int:
    """Run the virtual devices of an EDS until stopped; return the exit code.

    Raise EdsError or ConfigError if a device cannot be started, and BusError if the channel cannot be used or a node-ID
    is taken.
    """
    label = f"drive {node_ids[0]}" if len(node_ids) == 1 else f"drives {node_ids[0]}-{node_ids[-1]}"
    with Reactor() as reactor:
        port = open_port(channel, label=label)
        try:
            check = NodeIdCheck(reactor, port, node_ids)
            from canopen_control.personality import read_personality
            from canopen_control.virtual.device import make_devices
            from canopen_control.virtual.process import BusNodes, DriveProcess

            devices = make_devices(
                node_ids,
                eds,
                report,
                faults=options.faults,
                quirks=options.quirks,
                like=None if options.like is None else read_personality(options.like),
                serial=options.serial,
                store=options.store,
                scenario=options.scenario,
                plant=options.plant,
                eds_files=options.others,
                objects=options.objects,
            )
            check.finish()
            # nodes whose node-ID LSS has changed, from the store
            renamed = [node.node_id for node in devices.nodes if node.node_id not in node_ids]
            if renamed:
                NodeIdCheck(reactor, port, renamed).finish()
            with contextlib.closing(devices.world):
                again = partial(reopen, channel, label)
                bus = BusNodes(port, devices.nodes, again, devices.timeline, devices.world)
                process = DriveProcess(reactor, [bus], report)
                return process.run()
        finally:
            port.close()


def reopen(channel: str, label: str) -> Port | None:
    """Return a new port of a lost channel, or None if the channel is still missing or is inside this process.

    The port joins a local bus without a check, because a hub that is about to end may pass the check and be gone when
    the port is opened.
    """
    if parse_channel(channel).kind.in_process:
        return None
    try:
        return open_port(channel, label=label, join=True)
    except BusError:
        return None
