"""Show decoded bus traffic: every frame with its sender, its service and its objects by name.

The frames are live, or from a recording. Nothing is sent. Names come from the running robot, from a robot's files
(ROBOT), or from EDS files; without any of them the predefined connection set is shown. Ends with Ctrl-C, --count or
--for.

Exit codes: 0 success; 1 the bus is gone, or no frame was shown; 2 wrong usage, or no such file, channel or robot.
"""

from __future__ import annotations

import sys
from functools import partial
from typing import TYPE_CHECKING, Final

from canopen_control.cli.support.arguments import add_duration
from canopen_control.cli.support.bus_description import add_network_arguments, watched_bus
from canopen_control.cli.support.frame_output import add_view_arguments, show, show_file
from canopen_control.errors import ConfigError

if TYPE_CHECKING:
    import argparse

    from canopen_control.bus.port import BusEvent


EXAMPLE = """canopen-control trace
         canopen-control trace --events
         canopen-control trace --node left_drive --service sdo,emcy
         canopen-control trace robby --can can0 --changes
         canopen-control trace robby --file run.log --json"""
LABEL = "trace"
_RECORDINGS: Final = (".log", ".asc", ".blf", ".trc", ".gz", ".zip")


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


def run(args: argparse.Namespace) -> int:
    """Run the verb until Ctrl-C, --for, --count or the end of the file."""
    if args.file is not None:
        return show_file(args, args.file)
    if args.config is not None and args.config.lower().endswith(_RECORDINGS):
        raise ConfigError(f"{args.config} is not a robot; give a recording with --file {args.config}")
    from canopen_control.trace.listen import batches, open_listener

    watched = watched_bus(args, args.can)
    port = open_listener(watched.channel, LABEL, owner=watched.owner)
    watched.report_notes()
    nothing = ""
    try:
        nothing = show(
            args, watched.network, batches(port, args.duration, on_event=partial(_report, as_json=args.json))
        )
    except KeyboardInterrupt:
        pass
    finally:
        port.close()
    if port.stats.lost:
        print(
            f"canopen-control: {port.stats.lost} frames were lost: they arrived faster than they were read",
            file=sys.stderr,
        )
    if nothing:
        print(f"canopen-control: {watched.channel}: {nothing}", file=sys.stderr)
    return 1 if nothing else 0


def _report(event: BusEvent, *, as_json: bool) -> None:
    """Print a bus event between the frames, or to standard error if frames are printed as JSON."""
    print(f"{event.kind.value.upper()}: {event.text}", file=sys.stderr if as_json else sys.stdout, flush=True)
