"""Write files for other tools: the PDO layout of a robot as DBC, or a recording as a CSV table.

Exit codes: 0 written; 1 the disk is full; 2 wrong usage, or no such file or robot.
"""

from __future__ import annotations

import contextlib
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from canopen_control.cli.support.bus_description import add_network_arguments, described
from canopen_control.cli.support.output import print_result
from canopen_control.errors import ConfigError
from canopen_control.host.files import telling
from canopen_control.trace.network_description import is_gap, mapped_name

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterable, Iterator
    from typing import TextIO

    from canopen_control.trace.decoder import DecodedFrame
    from canopen_control.trace.network_description import NetworkDescription


EXAMPLE = """canopen-control export dbc robby -o robby.dbc
         canopen-control export csv run.log robby -o run.csv
         canopen-control export csv run.log robby --wide -o run.csv"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    kinds = parser.add_subparsers(dest="kind", metavar="WHAT", required=True)
    dbc = kinds.add_parser("dbc", help="write the PDO layout as a DBC file, for SavvyCAN, cantools and others")
    table = kinds.add_parser("csv", help="write a decoded recording: time, id, node, service, signal, value")
    table.add_argument(
        "file", metavar="FILE", help="a recording: .log, .asc, .blf, .trc (text also as .gz), or a flight recording"
    )
    table.add_argument("--wide", action="store_true", help="a row for each PDO, a column for each signal")
    for kind in (dbc, table):
        add_network_arguments(kind)
        kind.add_argument("-o", "--output", metavar="FILE", help="file to write (default: standard output)")


def run(args: argparse.Namespace) -> int:
    """Run the verb; return 1 if a recording could not be read to its end, else 0."""
    if args.json and args.output is None:
        raise ConfigError("--json prints a summary, but standard output carries the data; give -o FILE")
    return _dbc(args) if args.kind == "dbc" else _csv(args)


def _dbc(args: argparse.Namespace) -> int:
    from canopen_control.trace.dbc import dbc_text

    if args.config is None and args.name is None and not args.eds:
        raise ConfigError("give the robot to export: a folder, a bundled robot, --name, or --eds")
    network = described(args, units=True)
    with _output(args.output) as out:
        out.write(dbc_text(network))
    pdos = sum(len(node.pdos) for node in network.nodes.values())
    _report(args, nodes=len(network.nodes), PDOs=pdos)
    return 0


def _csv(args: argparse.Namespace) -> int:
    from canopen_control.cli.support.bus_description import network_for, open_frames, report_gaps
    from canopen_control.trace.frame_lines import write_long, write_wide

    recording = open_frames(args.file, args.bus)
    network = network_for(args, recording)
    with _output(args.output) as out:
        if args.wide:
            rows = write_wide(_decoded(recording, network), _signals(network), out)
        else:
            rows = write_long(_decoded(recording, network), out)
    _report(args, rows=rows)
    report_gaps(recording)
    return 1 if recording.problem else 0


def _decoded(recording: Iterable[tuple[int, object]], network: NetworkDescription) -> Iterator[DecodedFrame]:
    from canopen_control.trace.decoder import Decoder

    decoder = Decoder(network)
    for time_ns, frame in recording:
        yield decoder.decode(frame, time_ns)  # type: ignore[arg-type]  # a CanFrame


def _signals(network: NetworkDescription) -> list[str]:
    """Return the column names, one for each object mapped to a PDO, in the order of nodes and PDOs."""
    names = (
        f"{node.name or f'node {node_id}'}.{mapped_name(entry)}"
        for node_id, node in sorted(network.nodes.items())
        for pdo in node.pdos
        for entry in pdo.objects
        if not is_gap(entry)
    )
    return list(dict.fromkeys(names))


@contextlib.contextmanager
def _output(path: str | None) -> Iterator[TextIO]:
    if path is None:
        yield sys.stdout
        sys.stdout.flush()
        return
    with (
        telling(path, "the file ends there"),
        Path(path).expanduser().open("w", encoding="utf-8", newline="") as out,
    ):
        yield out


def _report(args: argparse.Namespace, **counts: int) -> None:
    if args.output is not None:
        text = ", ".join(f"{count} {unit}" for unit, count in counts.items())
        print_result(args, {"file": args.output, **counts}, f"{args.output}: {text}")
