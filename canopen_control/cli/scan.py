"""List the devices on a bus, their matching EDS, and differences to bus.yml.

0x1000, 0x1018 and 0x1008 are read from every node-ID; nothing is written. With --can it scans a bare bus, and compares
it with a robot's bus.yml if you give --config. Without --can it scans the bus of the running robot: the robot reads
from its own nodes, all other node-IDs are read directly on the bus.

Exit codes: 0 success; 1 no device answered, or a node of bus.yml is missing or is a different device; 2 wrong usage.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from canopen_control.bus.channel import parse_channel
from canopen_control.cli.support.arguments import timeout_seconds
from canopen_control.cli.support.output import Progress, Table, json_text
from canopen_control.cli.support.target import LABEL, RobotTarget, find_eds, robot_on
from canopen_control.client import RobotClient
from canopen_control.commissioning.identity import (
    FIELDS,
    NAME,
    DeviceIdentity,
    differences,
    identity_of,
    match_eds,
    read_known,
)
from canopen_control.data_files import data_names
from canopen_control.errors import CanopenError, ConfigError, RemoteError, RobotConfigError, SdoTimeout
from canopen_control.frame import MAX_NODE_ID, Service, service_of
from canopen_control.master.direct import PARALLEL, DirectBus
from canopen_control.master.known_drives import known_drive
from canopen_control.od.eds import SUFFIXES
from canopen_control.rpc.messages.declare import Document
from canopen_control.rpc.messages.robot import GetStatus, NodeIdentity, NodePlace

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterable, Iterator

    from canopen_control.commissioning.node_session import NodeSession
    from canopen_control.frame import CanFrame
    from canopen_control.personality import Personality


EXAMPLE = """canopen-control scan --can can0 --config robby
         canopen-control scan --can can0 --eds-dir ~/eds
         canopen-control scan"""

_DRIVE = 402  # device profile number, the low 16 bits of 0x1000 (CiA 301 7.5.2.1)
_PATIENCE_S = 1.0  # timeout of a node that has answered: on a busy computer a virtual drive may be late
_OBJECTS = [*(address for address, _ in FIELDS.values()), NAME]
_HEADINGS = ("node", "device type", "vendor", "product", "revision", "serial", "device name", "NMT", "EDS", "bus.yml")


@dataclass(slots=True)
class FoundNode:
    """Node that was found or that bus.yml expects; `identity` is None if it does not respond to SDO requests."""

    node_id: int
    identity: DeviceIdentity | None = None
    nmt_state: str | None = None
    name: str = ""
    eds: str | None = None
    remark: str = ""
    problems: list[str] = field(default_factory=list)


@dataclass(slots=True)
class ScanResult:
    """Result of a scan; `notes` lists parts that could not be read."""

    channel: str
    found: dict[int, FoundNode]
    expected: dict[int, NodePlace] | None = None
    master_id: int | None = None
    notes: list[str] = field(default_factory=list)


class NodeDocument(Document, frozen=True, kw_only=True):
    """Node in `scan --json`; `name` and `expected` are null if the node is not in bus.yml."""

    node_id: int
    answers: bool
    device_type: int | None
    vendor_id: int | None
    product_code: int | None
    revision_number: int | None
    serial_number: int | None
    device_name: str | None
    nmt_state: str | None
    eds: str | None
    eds_remark: str | None
    name: str | None
    problems: list[str]
    expected: NodeIdentity | None


class ScanDocument(Document, frozen=True):
    """Document that `scan --json` prints."""

    channel: str
    nodes: list[NodeDocument]
    notes: list[str]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    group = parser.add_mutually_exclusive_group()
    group.add_argument("--can", metavar="CHANNEL", help="channel to scan (can0, local:NAME, ...)")
    group.add_argument("--name", help="scan the bus of this running robot (default: the only one)")
    parser.add_argument(
        "--config", metavar="ROBOT", help="compare with this bus.yml: a folder, a bundled name, a ROS package or a file"
    )
    parser.add_argument(
        "--eds-dir", metavar="DIR", action="append", default=[], help="folder with EDS files to match (repeatable)"
    )
    parser.add_argument(
        "--timeout", type=timeout_seconds, default=0.2, metavar="S", help="timeout of each answer in s (default: 0.2)"
    )


def run(args: argparse.Namespace) -> int:
    """Run the verb."""
    folders = [_folder(text) for text in args.eds_dir]
    expected = _expected_of(args.config) if args.config is not None else None
    survey = survey_channel(args.can, args.timeout, name=args.name)
    if expected is not None:
        survey.expected = expected
    match_files(survey, _eds_files(folders))
    _report(survey, as_json=args.json)
    nodes = [device for node_id, device in survey.found.items() if node_id != survey.master_id]
    return 1 if not nodes or any(node.problems for node in nodes) else 0


# -- expected nodes


def _folder(text: str) -> Path:
    folder = Path(text).expanduser()
    if not folder.is_dir():
        raise ConfigError(f"--eds-dir {text}: no such folder")
    return folder


def _eds_files(folders: Iterable[Path]) -> list[Path]:
    files = [find_eds(name) for name in data_names("eds") if name.lower().endswith(".eds")]
    for folder in folders:
        files += sorted(path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES and path.is_file())
    return files


def _expected_of(config: str) -> dict[int, NodePlace]:
    from canopen_control.master.config import read_bus
    from canopen_control.runtime.robot_files import MAIN_BUS, find_buses

    path = Path(config).expanduser()
    try:
        bus = read_bus(path if path.is_file() else find_buses(config)[MAIN_BUS])
    except RobotConfigError as error:
        raise ConfigError(f"--config {config}: {error}") from None
    return {
        plan.node_id: NodePlace(name=name, node_id=plan.node_id, identity=plan.identity)
        for name, plan in bus.plans.items()
    }


# -- found nodes


def survey_channel(channel: str | None, timeout: float, *, name: str | None = None) -> ScanResult:
    """Scan a channel, directly or through the robot that runs on it; without a channel, scan through robot `name`."""
    owner = robot_on(channel) if channel is not None else None
    if channel is not None and owner is None:
        return _survey_bus(channel, timeout)
    with RobotTarget(RobotClient.connect(name if owner is None else owner[0])) as robot:
        return _survey_robot(robot, timeout)


def _survey_bus(channel: str, timeout: float) -> ScanResult:
    with DirectBus.open(channel, label=LABEL, timeout_s=timeout, retries=0) as bus:
        return ScanResult(channel, _read_identities(bus, range(1, MAX_NODE_ID + 1)))


class _Servers:
    """Listener that collects the node-IDs of all SDO answers on the bus, including late ones."""

    def __init__(self) -> None:
        self.node_ids: set[int] = set()

    def receive(self, frame: CanFrame, now: int) -> None:
        del now
        service, node_id = service_of(frame.can_id) or (None, 0)
        if service is Service.SDO_SERVER:
            self.node_ids.add(node_id)


def _read_identities(bus: DirectBus, node_ids: Iterable[int]) -> dict[int, FoundNode]:
    """Read 0x1000 of all node-IDs, then further objects of the nodes that respond; return the nodes found.

    A node whose answer comes too late counts as present: it is read again, with a longer timeout. So is a further
    object of a present node whose answer is lost.
    """
    servers = _Servers()
    bus.listeners.append(servers)
    requests = [(node_id, *_OBJECTS[0]) for node_id in node_ids]
    device_types: dict[tuple[int, int, int], bytes | CanopenError] = {}
    with Progress(f"reading on {bus.port.channel}", "node-IDs") as progress:
        for start in range(0, len(requests), PARALLEL):
            progress.at(start, len(requests))
            device_types |= bus.read_many(requests[start : start + PARALLEL])
    silent = [address for address, answer in device_types.items() if _is_silent(answer)]
    late = [address for address in silent if address[0] in servers.node_ids]
    device_types |= bus.read_many(late, timeout_s=_PATIENCE_S)
    bus.listeners.remove(servers)
    answering = [node_id for (node_id, _, _), answer in device_types.items() if not _is_silent(answer)]
    further = bus.read_many(
        ((node_id, *address) for node_id in answering for address in _OBJECTS[1:]), timeout_s=_PATIENCE_S
    )
    unanswered = [address for address, answer in further.items() if _is_silent(answer)]
    further |= bus.read_many(unanswered, timeout_s=_PATIENCE_S)
    answers = {**device_types, **further}
    nodes = {}
    for node_id in answering:
        data = {(index, subindex): answer for (node, index, subindex), answer in answers.items() if node == node_id}
        nodes[node_id] = FoundNode(node_id, identity_of(data))
    for node_id, state in bus.states.items():
        entry = nodes.setdefault(node_id, FoundNode(node_id))
        entry.nmt_state = None if state is None else state.name
    return dict(sorted(nodes.items()))


def _is_silent(answer: bytes | CanopenError) -> bool:
    return isinstance(answer, SdoTimeout)


def _survey_robot(robot: RobotTarget, timeout: float) -> ScanResult:
    buses, listing = robot.listing.buses, robot.listing.nodes
    if not buses:
        raise ConfigError(f"robot {robot.robot.robot} has no bus: it runs on mock hardware")
    bus = next(iter(buses.values()))
    expected = {node.node_id: node for node in listing}
    survey = ScanResult(bus.channel, {}, expected, bus.node_id or 0)
    states = robot.robot.ask(GetStatus()).nodes
    for node in robot.sessions:
        identity = _through_robot(node)
        if identity is not None:
            survey.found[node.node_id] = FoundNode(node.node_id, identity, states[node.name].nmt_state)
    if parse_channel(survey.channel).kind.shared:
        unused = [node_id for node_id in range(1, MAX_NODE_ID + 1) if node_id not in (*expected, survey.master_id)]
        with DirectBus.open(survey.channel, label=LABEL, timeout_s=timeout, retries=0) as direct:
            nodes = _read_identities(direct, unused)
        survey.found.update((node_id, identity) for node_id, identity in nodes.items() if node_id in unused)
    else:
        survey.notes.append(f"{survey.channel} can be opened only once, so nodes that are not in bus.yml are not found")
    survey.found = dict(sorted(survey.found.items()))
    return survey


def _through_robot(node: NodeSession) -> DeviceIdentity | None:
    """Read the identity of a node through the robot; None if the node does not respond."""
    data = dict[tuple[int, int], object]()
    for address in _OBJECTS:
        try:
            data[address] = node.read(*address)
        except RemoteError as error:
            if error.kind != "SdoAbort":
                return None
    return identity_of(data)


# -- comparison and output


def match_files(survey: ScanResult, files: Iterable[Path]) -> None:
    """Assign the matching EDS of `files` to each node, and compare the nodes with bus.yml."""
    candidates, refused = read_known(files)
    survey.notes += refused
    for node in survey.found.values():
        if node.identity is not None:
            eds, node.remark = match_eds(node.identity, candidates)
            node.eds = None if eds is None else str(eds.path)
    for node_id, expected in (survey.expected or {}).items():
        entry = survey.found.setdefault(node_id, FoundNode(node_id))
        entry.name = expected.name
        if entry.identity is not None:
            entry.problems = differences(entry.identity, expected.identity)
        elif entry.nmt_state is not None:
            entry.problems = ["does not answer SDO requests"]
        else:
            entry.problems = ["missing"]
    survey.found = dict(sorted(survey.found.items()))


def _report(survey: ScanResult, *, as_json: bool) -> None:
    if as_json:
        print(json_text(_document(survey)))
    elif survey.found:
        table = Table(_HEADINGS if survey.expected is not None else _HEADINGS[:-1])
        for node in survey.found.values():
            table.add(_row(survey, node))
        print("\n".join(table.lines()))
        for line in known_lines(survey.found.values()):
            print(line)
    else:
        print(
            f"canopen-control: no node answers on {survey.channel}; check power and bit rate",
            file=sys.stderr,
        )
    for note in survey.notes:
        print(f"canopen-control: {note}", file=sys.stderr)


def known_lines(nodes: Iterable[FoundNode]) -> Iterator[str]:
    """Yield lines that name known manufacturers' drives, and the keys that they need in bus.yml."""
    by_name: dict[str, tuple[Personality, list[int]]] = {}
    for node in nodes:
        identity = node.identity or DeviceIdentity()
        if (identity.device_type or 0) & 0xFFFF == _DRIVE and (
            drive := known_drive(identity.vendor_id or 0, identity.product_code or 0, identity.device_name or "")
        ):
            by_name.setdefault(drive.name, (drive, []))[1].append(node.node_id)
    for drive, ids in by_name.values():
        subject = f"node {ids[0]} is" if len(ids) == 1 else f"nodes {', '.join(map(str, ids))} are"
        yield f"{subject} known as {drive.title} (`canopen-control drive --like {drive.name}`)"
        for key in drive.bus_keys:
            yield f"  in bus.yml: `{key.text}`: {key.why} ({key.source})"


def _row(survey: ScanResult, node: FoundNode) -> tuple[str, ...]:
    identity = node.identity or DeviceIdentity()
    numbers = [getattr(identity, key) for key in FIELDS]
    eds = "-" if node.eds is None else Path(node.eds).name + (f" ({node.remark})" if node.remark else "")
    row = (
        f"{node.node_id}",
        *("-" if number is None else f"0x{number:08X}" for number in numbers),
        identity.device_name or "-",
        (node.nmt_state or "-").replace("_", " "),
        eds,
    )
    return row if survey.expected is None else (*row, _verdict(survey, node))


def _verdict(survey: ScanResult, node: FoundNode) -> str:
    if node.node_id == survey.master_id:
        return "the master"
    if not node.name:
        return "not listed"
    return f"{node.name}: {', '.join(node.problems) or 'as expected'}"


def _document(survey: ScanResult) -> ScanDocument:
    nodes = [_node_document(node, (survey.expected or {}).get(node.node_id)) for node in survey.found.values()]
    return ScanDocument(survey.channel, nodes, survey.notes)


def _node_document(node: FoundNode, expected: NodePlace | None) -> NodeDocument:
    identity = node.identity or DeviceIdentity()
    return NodeDocument(
        node_id=node.node_id,
        answers=node.identity is not None,
        **{field: getattr(identity, field) for field in FIELDS},
        device_name=identity.device_name,
        nmt_state=node.nmt_state,
        eds=node.eds,
        eds_remark=node.remark or None,
        name=node.name or None,
        problems=node.problems,
        expected=None if expected is None else expected.identity,
    )
