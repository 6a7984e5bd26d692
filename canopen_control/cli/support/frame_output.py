"""Decoded frames as lines or JSON, for the verbs that show them; and the options that select frames."""

from __future__ import annotations

import itertools
import os
import sys
from typing import TYPE_CHECKING

from canopen_control.cli.support.arguments import Names, argument, whole_number
from canopen_control.cli.support.bus_description import network_for, open_frames, report_gaps
from canopen_control.cli.support.output import json_line

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Iterable, Iterator

    from canopen_control.bus.recordings import RecordedFrame
    from canopen_control.trace.decoder import DecodedFrame
    from canopen_control.trace.network_description import NetworkDescription


_CHUNK = 256  # frames of a file that are printed at once


def add_view_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options that select frames, and the format in which frames are shown."""
    from canopen_control.trace.frame_lines import parse_ids, parse_services

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


def show_file(args: argparse.Namespace, path: str) -> int:
    """Print a recording; return 1 if it could not be read to its end or no frame is selected, else 0."""
    recording = open_frames(path, args.bus)
    nothing = show(args, network_for(args, recording), _chunks(recording))
    report_gaps(recording)
    if nothing:
        print(f"canopen-control: {nothing}", file=sys.stderr)
    return 1 if recording.problem or nothing else 0


def _chunks(recording: Iterable[RecordedFrame]) -> Iterator[list[RecordedFrame]]:
    frames = iter(recording)
    while chunk := list(itertools.islice(frames, _CHUNK)):
        yield chunk


def show(args: argparse.Namespace, network: NetworkDescription, source: Iterable[list[RecordedFrame]]) -> str:
    """Decode the frames of `source` and print the selected ones; return why no line was printed, or ""."""
    from canopen_control.trace.decoder import Decoder
    from canopen_control.trace.frame_lines import Filter, node_ids_of

    selected = node_ids_of(network, args.node)
    decoder = Decoder(network)
    selects = Filter(selected, args.service, tuple(args.id), args.changes, args.events)
    line = _line_of(args, network)
    shown = received = 0
    for batch in source:
        lines = []
        received += len(batch)
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
    if shown:
        return ""
    return f"none of {received} frames is selected by the options" if received else "no frame was received"


def _print(lines: list[str]) -> None:
    if lines:
        sys.stdout.write("\n".join(lines) + "\n")
        sys.stdout.flush()


def _line_of(args: argparse.Namespace, network: NetworkDescription) -> Callable[[DecodedFrame], str]:
    from canopen_control.trace.frame_lines import LineWriter, document_of

    if args.json:
        return lambda decoded: json_line(document_of(decoded))
    colour = sys.stdout.isatty() and "NO_COLOR" not in os.environ
    return LineWriter(network, absolute=args.absolute, colour=colour).line
