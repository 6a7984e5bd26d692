"""Write one HTML page about a run or a recording: first fault, states, plots, events, boot, jitter, bus load.

FILE is a flight recording (.zip) or a recording of frames (.log, .asc, .blf, .trc; with object names from --config or
--eds). Without FILE, the newest flight recording of the robot --name, or of any robot, is used. With --for, the running
robot is observed for S seconds. The page needs no network and no other file.

Exit codes: 0 written; 1 the robot does not answer, or the disk is full; 2 wrong usage, or no recording.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

from canopen_control.cli.support.arguments import add_duration, number
from canopen_control.cli.support.parsers import add_robot_name
from canopen_control.errors import CanopenError, ConfigError
from canopen_control.host.files import write_whole

if TYPE_CHECKING:
    import argparse

    from canopen_control.trace.flight_file import FlightFile
    from canopen_control.trace.network_description import NetworkDescription


EXAMPLE = """canopen-control report
         canopen-control report --list
         canopen-control report --for 5 -o run.html
         canopen-control report run.log --config robby --json"""


_watching = number("time in seconds from above 0 to 3600", lambda value: 0 < value <= 3600)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("file", nargs="?", metavar="FILE", help="a flight recording, or a recording of frames")
    parser.add_argument(
        "-o", "--output", metavar="FILE.html", help="page to write (default: next to FILE, or ROBOT.html here)"
    )
    parser.add_argument("--list", action="store_true", help="list the flight recordings, the newest last")
    parser.add_argument("--json", action="store_true", help="print the same facts as JSON instead of writing a page")
    add_duration(
        parser, "observe the running robot for S seconds", former="--duration", dest="duration", read=_watching
    )
    add_robot_name(parser)
    parser.add_argument(
        "--config", metavar="ROBOT", help="use the names in this robot's files for a recording of frames"
    )
    parser.add_argument("--bus", metavar="NAME", help="bus of a robot with several buses")
    parser.add_argument(
        "--eds", action="append", default=[], metavar="[NODE=]FILE", help="use the names of an EDS file (repeatable)"
    )


def run(args: argparse.Namespace) -> int:
    """Run the verb."""
    from canopen_control.cli.support.output import json_text
    from canopen_control.trace.report_build import facts_of
    from canopen_control.trace.report_page import page_of

    if args.list:
        return _list(args)
    path, file, networks = _recording(args)
    facts = facts_of(file, networks)
    if args.json:
        print(json_text(facts, indent=None))
        return 0
    output = Path(args.output) if args.output else _page_path(path, facts.robot)
    write_whole(output, page_of(facts).encode())
    print("\n".join(facts.summary))
    print(f"\nwritten: {output.resolve()}")
    return 0


def _recording(
    args: argparse.Namespace,
) -> tuple[Path | None, FlightFile, dict[str, NetworkDescription] | None]:
    """Return the path, the content and the networks of the selected recording.

    The path is None if a running robot is observed; the networks are None except for a recording of frames.
    """
    from canopen_control.trace.flight_file import is_flight_file, read_flight

    if args.duration is not None:
        if args.file is not None:
            raise ConfigError("--for watches the running robot; omit FILE")
        return None, _watched(args), None
    path = Path(args.file) if args.file is not None else _newest(args.name)
    if is_flight_file(path):
        return path, read_flight(path), None
    return path, *_frames_only(args, path)


def _list(args: argparse.Namespace) -> int:
    """Print the time, robot and reason of every flight recording; damaged files are reported on stderr."""
    from canopen_control.cli.support.output import json_text
    from canopen_control.trace.flight_file import read_meta
    from canopen_control.trace.report_facts import clock

    listed = []
    for path in _flights(args.name):
        try:
            meta = read_meta(path)
        except ConfigError as error:
            print(f"canopen-control: {error}", file=sys.stderr)
            continue
        listed.append((path, meta))
    if args.json:
        recordings = [{"file": str(path), "robot": meta.robot, "reason": meta.reason} for path, meta in listed]
        print(json_text(recordings, indent=None))
        return 0
    for path, meta in listed:
        text = " ".join(meta.reason.text.split())
        print(f"{clock(meta.reason.time, date=True)}  {meta.robot}: {text}\n    {path}")
    return 0


def _flights(name: str | None) -> list[Path]:
    """Return the flight recordings of the robot `name`, or of all robots, oldest first.

    Raise ConfigError if none exist.
    """
    from canopen_control.host.files import state_dir

    # the first 19 characters of a file name are the time
    paths = sorted(
        state_dir().glob(f"{name or '*'}/flight/*.zip"), key=lambda path: (path.name[:19], path.stat().st_mtime)
    )
    if not paths:
        of_robot = f"of {name} " if name else ""
        raise ConfigError(
            f"no flight recording {of_robot}in {state_dir()}: no fault has been recorded; "
            "watch a running robot with --for 10"
        )
    return paths


def _newest(name: str | None) -> Path:
    """Return the path of the latest flight recording of the robot `name`, or of any robot."""
    paths = _flights(name)
    if sys.stderr.isatty():
        print(f"canopen-control: the newest flight recording: {paths[-1]}", file=sys.stderr)
    return paths[-1]


def _watched(args: argparse.Namespace) -> FlightFile:
    from canopen_control.trace.report_build import watch

    file = watch(args.name, args.duration)
    if not file.states:
        raise CanopenError(
            f"robot {file.meta.robot} sent no sample within {args.duration:g} s; its process may be stopped or blocked"
        )
    return file


def _frames_only(args: argparse.Namespace, path: Path) -> tuple[FlightFile, dict[str, NetworkDescription]]:
    """Read a recording of frames as a flight recording whose only bus is called "can"."""
    from canopen_control.cli.support.bus_description import described, frames_of_file
    from canopen_control.trace.flight_file import NO_FAULT, FlightFile, FlightMeta

    recording = frames_of_file(path)  # a page without frames, and so without faults, would be misleading
    frames = [(time_ns, "can", frame) for time_ns, frame in recording]
    notes = tuple(text for text in (recording.mixture, recording.problem) if text)
    meta = FlightMeta(robot="", reason=NO_FAULT, buses={"can": path.name})
    file = FlightFile(meta, frames=frames, unread_lines=recording.skipped, notes=notes)
    return file, {"can": described(args)}


def _page_path(path: Path | None, robot: str) -> Path:
    return Path(f"{robot or 'report'}.html") if path is None else path.with_suffix(".html")
