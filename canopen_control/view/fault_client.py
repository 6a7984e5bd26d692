"""Fault injection: asks the virtual drives of a robot for their faults and switches them, by their control sockets.

The law of this file: a real drive has no such socket, so that nothing here can reach one. Everything waits for an
answer, a second at most; it is called from threads that may.
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from canopen_control.client.drive_client import DriveClient
from canopen_control.errors import RemoteError
from canopen_control.host.sockets import drive_name, list_sockets
from canopen_control.rpc.messages.drive import ListFaults, SetSignals, SwitchFault

if TYPE_CHECKING:
    from collections.abc import Iterable

    from canopen_control.rpc.messages.drive import FaultListing
    from canopen_control.view.robot_info import VirtualNode

__all__ = ["DriveFaults", "FaultClient", "read_faults"]

_TIMEOUT_S: Final = 1.0


class FaultClient:
    """Asks virtual drives for their faults and switches them; `nodes` are those of the robot, virtual or not."""

    def __init__(self, nodes: Iterable[VirtualNode]) -> None:
        self._nodes = {node.name: node for node in nodes}

    def drives(self) -> list[str]:
        """Return the nodes that are virtual and there."""
        alive = set(list_sockets("drive"))
        return [name for name, node in self._nodes.items() if drive_name(node.channel, node.node_id) in alive]

    def faults(self, drive: str) -> tuple[FaultListing, ...]:
        """Return every fault of a drive; RemoteError if it is not there."""
        with self._connect(drive) as client:
            return client.ask(ListFaults())

    def switch(self, drive: str, fault: str, *, on: bool) -> list[str]:
        """Switch a fault and return those that are on; RemoteError if the drive refuses or is not there."""
        with self._connect(drive) as client:
            return client.ask(SwitchFault(name=fault, on=on)).active

    def set_signals(self, drive: str, values: dict[str, float]) -> None:
        """Set inputs of a device that is no drive; RemoteError if it has no such ones or is not there."""
        with self._connect(drive) as client:
            client.ask(SetSignals(values=values))

    def _connect(self, drive: str) -> DriveClient:
        node = self._nodes.get(drive)
        if node is None:
            raise RemoteError("UnknownName", f"there is no drive {drive!r}")
        return DriveClient.connect(node.channel, node.node_id, _TIMEOUT_S, label=f"the virtual drive {drive}")


@dataclass(frozen=True, slots=True)
class DriveFaults:
    """The faults of each virtual drive that is there, and which are on."""

    drives: dict[str, tuple[FaultListing, ...]] = field(default_factory=dict)

    @property
    def active(self) -> dict[str, list[str]]:
        """The faults that are on, by drive."""
        return {drive: [fault.name for fault in faults if fault.on] for drive, faults in self.drives.items()}


def read_faults(client: FaultClient) -> DriveFaults:
    """Ask every virtual drive that is there; one that went away between two questions is left out. Waits."""
    found = {}
    for drive in client.drives():
        with contextlib.suppress(RemoteError):
            found[drive] = client.faults(drive)
    return DriveFaults(found)
