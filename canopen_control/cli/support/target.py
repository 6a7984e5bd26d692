"""Whom a verb talks to: the nodes of a running robot through its API, or a bare bus.

An SDO server has one client. The nodes of a running robot are reached through the robot alone; a
bare bus on which a robot runs is open for the other nodes only.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from canopen_control.bus.channel import parse_channel
from canopen_control.client import RobotClient, find_robots
from canopen_control.data_files import data_path
from canopen_control.errors import ConfigError, RemoteError
from canopen_control.frame import MAX_NODE_ID
from canopen_control.master.direct import DirectBus
from canopen_control.od.eds import read_eds
from canopen_control.rpc.messages.robot import GetNodes, NodeListing
from canopen_control.service.node_session import RobotTransfers

if TYPE_CHECKING:
    import argparse
    from types import TracebackType

    from canopen_control.od.model import ObjectDictionary


LABEL = "canopen-control"  # what others on the bus see of a verb


@dataclass(frozen=True, slots=True)
class TargetNode:
    """A node: its id, the name and the EDS if known."""

    node_id: int
    name: str = ""
    eds: Path | None = None

    def __str__(self) -> str:
        return f"node {self.node_id} ({self.name})" if self.name else f"node {self.node_id}"

    def dictionary(self) -> ObjectDictionary | None:
        """Read the EDS; None without one, EdsError for an invalid one."""
        return None if self.eds is None else read_eds(self.eds, self.node_id).od


class SdoTarget(Protocol):
    """Whoever carries SDO transfers."""

    def node(self, word: str) -> TargetNode:
        """Return the node that is meant; ConfigError."""

    def read(self, node: TargetNode, index: int, subindex: int, *, block: bool = False) -> bytes:
        """Upload an object; raises RemoteError or RemoteProtocolError."""

    def write(self, node: TargetNode, index: int, subindex: int, data: bytes) -> None:
        """Download an object; raises RemoteError or RemoteProtocolError."""

    def be_patient(self, node: TargetNode, seconds: float | None) -> None:
        """Set the timeout of each answer in s; None: the initial one."""

    def progress(self, node: TargetNode) -> tuple[int, int | None]:
        """Return transferred and total bytes of the present transfer; from another thread."""

    def close(self) -> None:
        """Close the connection."""

    def __enter__(self) -> SdoTarget: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None
    ) -> None: ...


def add_target_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare --can and --name."""
    group = parser.add_mutually_exclusive_group()
    group.add_argument(
        "--can", metavar="CHANNEL", help="channel of a bare bus (can0, local:NAME, ...), without a running robot"
    )
    group.add_argument("--name", help="the running robot (default: the only one)")


def open_target(args: argparse.Namespace) -> SdoTarget:
    """Open the target of the arguments `can`, `name`, `eds` and `timeout` (seconds or None)."""
    eds = find_eds(args.eds) if args.eds else None
    if args.can is not None:
        return BusTarget(args.can, eds, args.timeout)
    return RobotTarget(RobotClient.connect(args.name), eds, args.timeout)


def find_eds(text: str) -> Path:
    """Return the file, or the bundled one of that name; ConfigError if neither exists."""
    path = Path(text).expanduser()
    bundled = data_path("eds", text)
    if not path.exists() and path.name == text and bundled.is_file():
        return bundled
    if not path.is_file():
        raise ConfigError(f"no EDS file {text}")
    return path


def robot_on(channel: str) -> tuple[str, NodeListing] | None:
    """Return name and node listing of the running robot whose bus is `channel`, or None."""
    address = str(parse_channel(channel))
    for name in find_robots():
        try:
            with RobotClient.connect(name, timeout=2.0) as robot:
                listing = robot.ask(GetNodes())
        except ConfigError:
            continue  # it has ended meanwhile
        except RemoteError as error:
            if error.kind == "BusClosed":
                continue
            raise  # one that hangs may still hold the bus
        if any(bus.channel == address for bus in listing.buses.values()):
            return name, listing
    return None


class RobotTarget:
    """The nodes of a running robot."""

    def __init__(self, robot: RobotClient, eds: Path | None = None, timeout: float | None = None) -> None:
        self.robot = robot
        self._eds, self._timeout = eds, timeout
        self._carriers: dict[int, RobotTransfers] = {}
        self.listing = robot.ask(GetNodes())

    def __enter__(self) -> RobotTarget:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """Close the connection to the robot."""
        for carrier in self._carriers.values():
            carrier.close()
        self.robot.close()

    @property
    def nodes(self) -> list[TargetNode]:
        """All nodes, by node id."""
        nodes = sorted(self.listing.nodes, key=lambda node: node.node_id)
        return [TargetNode(node.node_id, node.name, self._eds or Path(node.eds)) for node in nodes]

    def node(self, word: str) -> TargetNode:
        """Return the node of a name or a node id; ConfigError with those there are."""
        for node in self.nodes:
            if word in (node.name, str(node.node_id)):
                return node
        names = ", ".join(f"{node.node_id} {node.name}" for node in self.nodes) or "none (mock hardware)"
        raise ConfigError(
            f"robot {self.robot.robot} has no node {word!r}; its nodes: {names}; for others on its bus use --can"
        )

    def transfers(self, node: TargetNode) -> RobotTransfers:
        """Return the SDO transport of a node."""
        if node.node_id not in self._carriers:
            label = f"{LABEL} (pid {os.getpid()})"
            self._carriers[node.node_id] = RobotTransfers(self.robot, node.node_id, self._timeout, label)
        return self._carriers[node.node_id]

    def read(self, node: TargetNode, index: int, subindex: int, *, block: bool = False) -> bytes:
        """Upload an object through the robot."""
        return self.transfers(node).read(index, subindex, block=block)

    def write(self, node: TargetNode, index: int, subindex: int, data: bytes) -> None:
        """Download an object through the robot."""
        self.transfers(node).write(index, subindex, data)

    def be_patient(self, node: TargetNode, seconds: float | None) -> None:
        """Set the timeout of each answer of the node."""
        self.transfers(node).be_patient(seconds)

    def progress(self, node: TargetNode) -> tuple[int, int | None]:
        """Return the progress of the present transfer."""
        return self.transfers(node).progress()


class BusTarget:
    """Nodes of a bus, except those of a robot that runs on it."""

    def __init__(self, channel: str, eds: Path | None = None, timeout: float | None = None) -> None:
        self.owner = robot_on(channel)
        self._eds = eds
        self.bus = DirectBus.open(channel, label=LABEL, timeout_s=timeout or 0.5)

    def __enter__(self) -> BusTarget:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """Close the bus."""
        self.bus.close()

    def node(self, word: str) -> TargetNode:
        """Return the node of a node id; ConfigError, also for a node that a running robot has."""
        node_id = parse_node_id(word)
        name, listing = self.owner or ("", NodeListing())
        if any(node_id == node.node_id for node in listing.nodes):
            raise ConfigError(
                f"node {node_id} on {self.bus.port.channel} belongs to the running robot {name}, the one client of its "
                f"SDO server; use --name {name} instead of --can"
            )
        return TargetNode(node_id, "", self._eds)

    def read(self, node: TargetNode, index: int, subindex: int, *, block: bool = False) -> bytes:
        """Upload an object."""
        return self.bus.read(node.node_id, index, subindex, block=block)

    def write(self, node: TargetNode, index: int, subindex: int, data: bytes) -> None:
        """Download an object."""
        self.bus.write(node.node_id, index, subindex, data)

    def be_patient(self, node: TargetNode, seconds: float | None) -> None:
        """Set the timeout of each answer of the node."""
        self.bus.client(node.node_id).timeout_ns = round((seconds or self.bus.timeout_s) * 1e9)

    def progress(self, node: TargetNode) -> tuple[int, int | None]:
        """Return the progress of the present transfer."""
        return self.bus.client(node.node_id).progress


def parse_node_id(text: str) -> int:
    """Return a node id, decimal or 0x; ConfigError with the valid range."""
    try:
        node_id = int(text, 0)
    except ValueError:
        raise ConfigError(f"node {text!r}: on a bare bus a node is a number, 1 to {MAX_NODE_ID}") from None
    if not 1 <= node_id <= MAX_NODE_ID:
        raise ConfigError(f"node {node_id}: node ids are 1 to {MAX_NODE_ID}")
    return node_id
