"""List the SDO writes of the boot sequence of each node; with --against, only the writes that a live bus needs.

Exit codes: 0 success; 1 a node did not answer; 2 wrong usage or configuration.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.cli.support.arguments import Names
from canopen_control.cli.support.output import json_text
from canopen_control.rpc.messages.declare import Document

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterable, Iterator, Mapping
    from pathlib import Path

    from canopen_control.master.config import BusConfig
    from canopen_control.master.direct import DirectBus
    from canopen_control.master.plan import NodePlan
    from canopen_control.master.plan_builder import PlannedWrite


EXAMPLE = "canopen-control plan robby --against can0"


class WriteDocument(Document, frozen=True):
    """Planned write: `data` in hexadecimal, `value` as text; `reason` is None for writes that are in bus.yml."""

    index: int
    subindex: int
    name: str
    data: str
    value: str
    reason: str | None


class PlanDocument(Document, frozen=True):
    """SDO writes planned for a node, based on the EDS file `eds`."""

    node_id: int
    eds: str
    writes: list[WriteDocument]


class ComparedPlan(PlanDocument, frozen=True):
    """Writes that a node on a live bus still needs; `error` is the reason if the node could not be read."""

    error: str | None


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("config", nargs="?", metavar="ROBOT", help="a robot folder, or the name of a bundled robot")
    parser.add_argument("--bus", metavar="FILE", help="a bus.yml alone, without a robot folder")
    parser.add_argument(
        "--node", action=Names, metavar="N[,N..]", help="only these nodes, by node-ID or name (repeatable)"
    )
    parser.add_argument(
        "--against",
        action="append",
        default=[],
        metavar="[BUS=]CHANNEL",
        help="read the nodes on this channel and show only the differences",
    )
    parser.add_argument(
        "--peer-merge",
        action="store_true",
        help="let `defaults` of bus.yml take precedence over the nodes' own keys, as ros2_canopen does",
    )
    parser.add_argument(
        "--allow-unsupervised", action="store_true", help="accept drives that do not stop when the master is lost"
    )


def run(args: argparse.Namespace) -> int:
    """Print the plans and return 0; with --against, return 1 if a node does not answer."""
    from canopen_control.master.config import read_bus

    options = {"peer_merge": args.peer_merge, "allow_unsupervised": args.allow_unsupervised}
    buses = {name: read_bus(path, **options) for name, path in _files(args).items()}
    chosen = _chosen(buses, args.node)
    if args.against:
        return _against(buses, chosen, args)
    if args.json:
        print(json_text({plan.name: _document(plan) for _, plan in chosen}))
    else:
        sync = [f"bus {name}: {config.master.sync_words()}" for name, config in buses.items()]
        print("\n".join([*sync, *(line for _, plan in chosen for line in _lines(plan, plan.writes))]))
    return 0


def _files(args: argparse.Namespace) -> Mapping[str, Path]:
    from pathlib import Path

    from canopen_control.runtime.robot_files import MAIN_BUS, find_buses

    return {MAIN_BUS: Path(args.bus).expanduser()} if args.bus else find_buses(args.config)


def _chosen(buses: dict[str, BusConfig], names: list[str]) -> list[tuple[str, NodePlan]]:
    """Return the bus name and the plan of each selected node, or of all nodes if `names` is empty."""
    from canopen_control.errors import ConfigError, nearest

    plans = [(bus, plan) for bus, config in buses.items() for plan in config.plans.values()]
    known = [plan.name for _, plan in plans]
    node_ids = {str(plan.node_id) for _, plan in plans}
    for name in names:
        if name not in known and name not in node_ids:
            raise ConfigError(f"no node {name!r}{nearest(name, known)}")
    return [(bus, plan) for bus, plan in plans if not names or {plan.name, str(plan.node_id)} & set(names)]


def _against(buses: dict[str, BusConfig], chosen: list[tuple[str, NodePlan]], args: argparse.Namespace) -> int:
    """Read the planned objects from live buses and print the writes needed; return 1 if a node does not respond."""
    from canopen_control.cli.support.target import LABEL, robot_on
    from canopen_control.errors import ConfigError
    from canopen_control.master.direct import DirectBus

    channels = _channels(buses, args.against)
    differs: dict[str, ComparedPlan] = {}
    lines: list[str] = []
    silent = False
    for name, channel in channels.items():
        if (owner := robot_on(channel)) is not None:
            raise ConfigError(
                f"{channel} is the bus of the running robot {owner[0]}, the one client of its nodes; "
                f"end it first: canopen-control shutdown --name {owner[0]}"
            )
        with DirectBus.open(channel, label=LABEL) as bus:
            for plan in (plan for node, plan in chosen if node == name):
                writes, error = _differences(bus, plan)
                silent = silent or error is not None
                differs[plan.name] = ComparedPlan(plan.node_id, plan.source, _write_documents(writes), error)
                lines += [f"{_title(plan)}: {error}"] if error else _lines(plan, writes, "no differences")
    print(json_text(differs) if args.json else "\n".join(lines))
    return 1 if silent else 0


def _channels(buses: dict[str, BusConfig], options: Iterable[str]) -> dict[str, str]:
    from canopen_control.bus.channel import name_and_channel
    from canopen_control.errors import ConfigError, nearest
    from canopen_control.runtime.robot_files import MAIN_BUS

    channels = {}
    for text in options:
        name, channel = name_and_channel(text)
        name = name or MAIN_BUS
        if name not in buses:
            raise ConfigError(f"--against {text}: the robot has no bus {name!r}{nearest(name, buses)}")
        channels[name] = channel
    return channels


def _differences(bus: DirectBus, plan: NodePlan) -> tuple[list[PlannedWrite], str | None]:
    """Return the writes that a node needs, and None; if the node cannot be read, return no writes and the reason."""
    from canopen_control.errors import BusError, CanopenError, SdoAbort, without_node
    from canopen_control.master.boot_pdos import groups, needed_writes, reads_of

    values: dict[tuple[int, int], bytes | None] = {}
    for address in [(0x1000, 0), *(read for group in groups(plan.writes) for read in reads_of(group))]:
        try:
            values[address] = bus.read(plan.node_id, *address)
        except SdoAbort:
            values[address] = None
        except BusError:
            raise
        except CanopenError as error:
            return [], without_node(str(error), plan.node_id, plan.name)
    return [write for group in groups(plan.writes) for write in needed_writes(group, values)], None


def _title(plan: NodePlan) -> str:
    return f"node {plan.node_id} ({plan.name}, {plan.source})"


def _lines(plan: NodePlan, writes: Iterable[PlannedWrite], none: str = "nothing is written") -> Iterator[str]:
    writes = [write for write in writes if not write.fixed]
    width = max((len(_name(plan, write)) for write in writes), default=0)
    count = sum(not write.reason for write in writes)
    added = len(writes) - count
    yield f"{_title(plan)}: " + (f"{len(writes)} writes, {added} of them added" if writes else none)
    for number, write in enumerate(writes, 1):
        reason = f"   + {write.reason}" if write.reason else ""
        title = f"0x{write.index:04X}:{write.subindex:02X} {_name(plan, write):<{width}}"
        yield f"{number:4}  {title} = {_value(write)}{reason}"


def _name(plan: NodePlan, write: PlannedWrite) -> str:
    """Return the name of an entry, preceded by the name of its object if they differ."""
    parent = plan.object_names.get(write.index, "")
    return write.name if not parent or parent == write.name else f"{parent}: {write.name}"


def _value(write: PlannedWrite) -> str:
    """Return the data of a write as text: decoded by the data type, and as a hexadecimal number."""
    from canopen_control.od.codec import decode

    raw = f"0x{write.data[::-1].hex().upper()}" if write.data else "no bytes"
    if write.data_type is None:
        return raw
    value = decode(write.data, write.data_type)
    return raw if isinstance(value, bytes) else f"{value!r} ({raw})"


def _document(plan: NodePlan) -> PlanDocument:
    return PlanDocument(plan.node_id, plan.source, _write_documents(plan.writes))


def _write_documents(writes: Iterable[PlannedWrite]) -> list[WriteDocument]:
    return [
        WriteDocument(write.index, write.subindex, write.name, write.data.hex(), _value(write), write.reason or None)
        for write in writes
        if not write.fixed
    ]
