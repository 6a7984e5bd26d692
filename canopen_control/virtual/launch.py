"""Fast start of the process of virtual drives: the bus is queried first, and imports run while it answers.

A node id that answers on the bus already is refused.
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING

from canopen_control.bus.channel import open_port, parse_channel
from canopen_control.errors import BusError
from canopen_control.host.reactor import Reactor
from canopen_control.virtual.node_id_check import NodeIdCheck

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    from canopen_control.bus.port import Port


@dataclass(frozen=True, slots=True)
class DriveOptions:
    """Options of the devices: files, faults ``name`` or ``name@seconds``, and quirks ``name=value@axis``.

    `like` is a personality, by name or a file.

    `serial` is 0x1018:04, of several nodes the first one's; None: the node id. `others` are the EDS files of the nodes
    that have another one.
    """

    faults: Sequence[str] = ()
    quirks: Sequence[str] = ()
    like: str = ""
    serial: int | None = None
    store: Path | None = None
    scenario: Path | None = None
    plant: Path | None = None
    others: Mapping[int, Path] = field(default_factory=dict)


def run_drives(
    node_ids: Sequence[int], eds: Path, channel: str, options: DriveOptions, report: Callable[[str], None]
) -> int:
    """Run the virtual devices of an EDS until stopped; return the exit code.

    Raises EdsError and ConfigError for what cannot be started, BusError for the channel.
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
                like=read_personality(options.like) if options.like else None,
                serial=options.serial,
                store=options.store,
                scenario=options.scenario,
                plant=options.plant,
                eds_files=options.others,
            )
            check.finish()
            with contextlib.closing(devices.world):
                again = partial(reopen, channel, label)
                bus = BusNodes(port, devices.nodes, again, devices.timeline, devices.world)
                process = DriveProcess(reactor, [bus], report)
                return process.run()
        finally:
            port.close()


def reopen(channel: str, label: str) -> Port | None:
    """Reopen a lost channel, None if it is still missing. A local bus is not started for it.

    It joins, for a hub that dies is still there to who looks whether it is, and gone to who then opens.
    """
    if parse_channel(channel).kind.in_process:
        return None
    try:
        return open_port(channel, label=label, join=True)
    except BusError:
        return None
