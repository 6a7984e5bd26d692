"""Content of the panels, shared by all pages, without NiceGUI."""

from __future__ import annotations

import contextlib
from collections import deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from canopen_control.client.drive_client import DriveClient
from canopen_control.errors import RemoteError
from canopen_control.host.sockets import drive_name, list_sockets
from canopen_control.rpc.messages.drive import ListFaults, ListQuirks, SetSignals, SwitchFault, SwitchQuirk
from canopen_control.view.sampling import commanded_interfaces
from canopen_control.view.words import banner, lost_banner

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from canopen_control.rpc.messages.drive import FaultListing, QuirkListing
    from canopen_control.rpc.messages.state import ControllerReading, RobotEvent, StateSample
    from canopen_control.view.robot_connection import NodeAddress
    from canopen_control.view.words import Banner


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


# Fault injection by the control sockets of virtual drives.
#
# A real drive has no such socket, so that no request can reach a real drive. A request blocks for a second at most, and
# is sent from a thread.


_TIMEOUT_S: Final = 1.0


class FaultClient:
    """Client for faults, quirks and inputs of virtual drives; `nodes` are all nodes of the robot."""

    def __init__(self, nodes: Iterable[NodeAddress]) -> None:
        self._nodes = {node.name: node for node in nodes}

    def drives(self) -> list[str]:
        """Return the names of the nodes whose virtual drive is running."""
        alive = set(list_sockets("drive"))
        return [name for name, node in self._nodes.items() if drive_name(node.channel, node.node_id) in alive]

    def faults(self, drive: str) -> tuple[FaultListing, ...]:
        """Return all faults that a virtual drive supports; raise RemoteError if the drive is unknown or not running."""
        with self._connect(drive) as client:
            return client.ask(ListFaults())

    def switch(self, drive: str, fault: str, *, on: bool) -> list[str]:
        """Switch a fault and return the active faults; raise RemoteError if the drive refuses or is not running."""
        with self._connect(drive) as client:
            return client.ask(SwitchFault(name=fault, on=on)).active

    def quirks(self, drive: str) -> tuple[QuirkListing, ...]:
        """Return all quirks that a virtual drive supports; raise RemoteError if the drive is unknown or not running."""
        with self._connect(drive) as client:
            return client.ask(ListQuirks())

    def switch_quirk(self, drive: str, quirk: str, *, on: bool) -> list[str]:
        """Switch a quirk, given as NAME=VALUE@AXIS, and return the active quirks; raise RemoteError if refused."""
        with self._connect(drive) as client:
            return client.ask(SwitchQuirk(quirk=quirk, on=on)).active

    def set_signals(self, drive: str, values: dict[str, float]) -> None:
        """Set inputs of a virtual device by name.

        Raise RemoteError if the input or the device is unknown, or the device is not running.
        """
        with self._connect(drive) as client:
            client.ask(SetSignals(values=values))

    def _connect(self, drive: str) -> DriveClient:
        node = self._nodes.get(drive)
        if node is None:
            raise RemoteError("UnknownName", f"drive {drive!r} does not exist")
        return DriveClient.connect(node.channel, node.node_id, _TIMEOUT_S, label=f"the virtual drive {drive}")


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


def read_faults(client: FaultClient) -> DriveFaults:
    """Return the faults and quirks of all running virtual drives, without those that do not respond; blocks."""
    faults, quirks = {}, {}
    for drive in client.drives():
        with contextlib.suppress(RemoteError):
            faults[drive] = client.faults(drive)
            quirks[drive] = client.quirks(drive)
    return DriveFaults(faults, quirks)
