"""Content of the panels, shared by all pages, without NiceGUI."""

from __future__ import annotations

import contextlib
from collections import deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final, TypeVar

from canopen_control.client.drive_client import DriveClient
from canopen_control.errors import RemoteError
from canopen_control.host.sockets import drive_name, list_sockets
from canopen_control.rpc.messages.drive import ListFaults, ListQuirks
from canopen_control.view.sampling import commanded_interfaces
from canopen_control.view.words import banner, lost_banner

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from canopen_control.rpc.messages.declare import Request
    from canopen_control.rpc.messages.drive import FaultListing, QuirkListing
    from canopen_control.rpc.messages.state import ControllerReading, RobotEvent, StateSample
    from canopen_control.view.robot_connection import NodeAddress
    from canopen_control.view.words import Banner


A = TypeVar("A")
_EVENTS: Final = 100


class RecentEvents:
    """Last `_EVENTS` events of the robot, oldest first."""

    def __init__(self, events: Iterable[RobotEvent] = ()) -> None:
        self._events: deque[RobotEvent] = deque(maxlen=_EVENTS)
        for event in events:
            self.add(event)

    def __iter__(self) -> Iterator[RobotEvent]:
        return iter(self._events)

    def add(self, event: RobotEvent) -> None:
        """Add an event; a repeated event replaces its previous occurrence."""
        if event.count > 1:
            self._replace(event)
        else:
            self._events.append(event)

    def _replace(self, event: RobotEvent) -> None:
        for number, entry in enumerate(self._events):
            if (entry.first, entry.kind, entry.node) == (event.first, event.kind, event.node):
                del self._events[number]
                break
        self._events.append(event)


@dataclass(frozen=True, slots=True)
class PageContent:
    """Data for the panels; `lost` is the reason why `state` may be outdated, or "" while the robot is connected."""

    state: StateSample
    events: RecentEvents
    controllers: tuple[ControllerReading, ...] = ()
    faults: DriveFaults | None = None
    lost: str = ""
    commanded: dict[str, str] = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "commanded", commanded_interfaces(self.controllers, self.state))

    @property
    def banner(self) -> Banner:
        return lost_banner(self.lost) if self.lost else banner(self.state)


# Requests to the control sockets of virtual drives.
#
# A real drive has no such socket, so that no request can reach a real drive. A request blocks for a second at most, and
# is sent from a thread.


TIMEOUT_S: Final = 1.0


class VirtualDrives:
    """Control sockets of the robot's virtual drives; `nodes` are all nodes of the robot, by name."""

    def __init__(self, nodes: Iterable[NodeAddress]) -> None:
        self.nodes = {node.name: node for node in nodes}

    def running(self) -> list[str]:
        """Return the names of the nodes whose virtual drive is running."""
        alive = set(list_sockets("drive"))
        return [name for name, node in self.nodes.items() if drive_name(node.channel, node.node_id) in alive]

    def ask(self, drive: str, request: Request[A]) -> A:
        """Send a request to a drive; raise RemoteError if the drive refuses, is unknown or is not running."""
        node = self.nodes.get(drive)
        if node is None:
            raise RemoteError("UnknownName", f"drive {drive!r} does not exist")
        label = f"the virtual drive {drive}"
        with DriveClient.connect(node.channel, node.node_id, TIMEOUT_S, label=label) as client:
            return client.ask(request)


@dataclass(frozen=True, slots=True)
class DriveFaults:
    """Available faults and quirks of each running virtual drive."""

    drives: dict[str, tuple[FaultListing, ...]] = field(default_factory=dict)
    quirks: dict[str, tuple[QuirkListing, ...]] = field(default_factory=dict)

    @property
    def active(self) -> dict[str, list[str]]:
        """Names of the active faults and quirks by drive."""
        return {
            drive: [
                *(fault.name for fault in faults if fault.on),
                *(text for quirk in self.quirks.get(drive, ()) for text in quirk.on),
            ]
            for drive, faults in self.drives.items()
        }


def read_faults(drives: VirtualDrives) -> DriveFaults:
    """Return the faults and quirks of all running virtual drives, without those that do not respond; blocks."""
    faults, quirks = {}, {}
    for drive in drives.running():
        with contextlib.suppress(RemoteError):
            faults[drive] = drives.ask(drive, ListFaults())
            quirks[drive] = drives.ask(drive, ListQuirks())
    return DriveFaults(faults, quirks)
