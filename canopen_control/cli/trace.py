"""Show decoded bus traffic: every frame with its sender, its service and its objects by name.

The frames are live, or from a recording. Nothing is sent. Names come from the running robot, from a robot's files
(ROBOT), or from EDS files; without any of them the predefined connection set is shown. Ends with Ctrl-C, --count or
--for.

Exit codes: 0 success; 1 the bus is gone; 2 wrong usage, or no such file, channel or robot.
"""

from __future__ import annotations

import itertools
import os
import sys
from functools import partial
from typing import TYPE_CHECKING

from canopen_control.cli.support.arguments import Names, add_duration, argument, whole_number
from canopen_control.cli.support.bus_description import (
    add_network_arguments,
    network_for,
    open_frames,
    report_gaps,
    watched_bus,
)
from canopen_control.cli.support.output import json_line
from canopen_control.trace.decoder import Decoder
from canopen_control.trace.frame_lines import Filter, LineWriter, document_of, node_ids_of, parse_ids, parse_services

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Iterable, Iterator

    from canopen_control.bus.port import BusEvent
    from canopen_control.bus.recordings import RecordedFrame
    from canopen_control.trace.network_description import NetworkDescription


EXAMPLE = """canopen-control trace
         canopen-control trace --events
         canopen-control trace --node left_drive --service sdo,emcy
         canopen-control trace robby --can can0 --changes
         canopen-control trace robby --file run.log --json"""
LABEL = "trace"
CHUNK = 256  # frames of a file that are printed at once


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    group = parser.add_mutually_exclusive_group()
    group.add_argument("--can", metavar="CHANNEL", help="channel to listen to (default: channel of the running robot)")
    group.add_argument(
        "--file", metavar="FILE", help="a recording: .log, .asc, .blf, .trc (text also as .gz), or a flight recording"
    )
    add_duration(parser, "end after S seconds", former="--duration", dest="duration")
    add_network_arguments(parser)
    add_view_arguments(parser)


def add_view_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options that select frames, and the format in which frames are shown."""
    parser.add_argument(
        "--node", action=Names, metavar="N[,N..]", help="show only these nodes, by node-ID or name (repeatable)"
    )
    parser.add_argument(
        "--service",
        type=argument(parse_services),
        default=frozenset(),
        metavar="S,...",
        help="show only these services: pdo, sdo, emcy, nmt, hb, sync, time, lss, error, raw",
    )
    parser.add_argument(
        "--id",
        action="append",
        default=[],
        type=argument(parse_ids),
        metavar="ID",
        help="show only this identifier or range, in hex: 181, 180-1FF (repeatable)",
    )
    parser.add_argument("--changes", action="store_true", help="show cyclic frames only when their data change")
    parser.add_argument(
        "--events",
        action="store_true",
        help="show only events: changes of state, commands, modes, boot-ups, EMCY, aborts, errors",
    )
    parser.add_argument(
        "--count",
        type=whole_number("whole number above 0", range(1, sys.maxsize)),
        metavar="N",
        help="end after N lines",
    )
    parser.add_argument(
        "--absolute", action="store_true", help="show times of day instead of seconds since the first frame"
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object for each frame")


def run(args: argparse.Namespace) -> int:
    """Run the verb until Ctrl-C, --for, --count or the end of the file."""
    if args.file is not None:
        return show_file(args, args.file)
    from canopen_control.trace.listen import batches, open_listener

    watched = watched_bus(args, args.can)
    port = open_listener(watched.channel, LABEL, owner=watched.owner)
    watched.report_notes()
    try:
        show(args, watched.network, batches(port, args.duration, on_event=partial(_report, as_json=args.json)))
    except KeyboardInterrupt:
        pass
    finally:
        port.close()
    if port.stats.lost:
        print(
            f"canopen-control: {port.stats.lost} frames were lost: they arrived faster than they were read",
            file=sys.stderr,
        )
    return 0


def _report(event: BusEvent, *, as_json: bool) -> None:
    """Print a bus event between the frames, or to standard error if frames are printed as JSON."""
    print(f"{event.kind.value.upper()}: {event.text}", file=sys.stderr if as_json else sys.stdout, flush=True)


def show_file(args: argparse.Namespace, path: str) -> int:
    """Print a recording; return 1 if it could not be read to its end, else 0."""
    recording = open_frames(path, args.bus)
    show(args, network_for(args, recording), _chunks(recording))
    report_gaps(recording)
    return 1 if recording.problem else 0


def _chunks(recording: Iterable[RecordedFrame]) -> Iterator[list[RecordedFrame]]:
    frames = iter(recording)
    while chunk := list(itertools.islice(frames, CHUNK)):
        yield chunk


def show(args: argparse.Namespace, network: NetworkDescription, source: Iterable[list[RecordedFrame]]) -> int:
    """Decode the frames of `source` and print the selected ones; return the number of lines."""
    decoder, selects = Decoder(network), _filter(args, network)
    line = _line_of(args, network)
    shown = 0
    for batch in source:
        lines = []
        for time_ns, frame in batch:
            decoded = decoder.decode(frame, time_ns)
            if selects.wants(decoded):
                lines.append(line(decoded))
            if args.count is not None and shown + len(lines) >= args.count:
                break
        _print(lines)
        shown += len(lines)
        if args.count is not None and shown >= args.count:
            break
    sys.stdout.flush()
    return shown


def _print(lines: list[str]) -> None:
    if lines:
        sys.stdout.write("\n".join(lines) + "\n")
        sys.stdout.flush()


def _filter(args: argparse.Namespace, network: NetworkDescription) -> Filter:
    return Filter(node_ids_of(network, args.node), args.service, tuple(args.id), args.changes, args.events)


def _line_of(args: argparse.Namespace, network: NetworkDescription) -> Callable[..., str]:
    if args.json:
        return lambda decoded: json_line(document_of(decoded))
    colour = sys.stdout.isatty() and "NO_COLOR" not in os.environ
    return LineWriter(network, absolute=args.absolute, colour=colour).line
