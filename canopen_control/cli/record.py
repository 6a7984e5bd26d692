"""Record every frame of a bus, or a robot as a ROS 2 bag, until Ctrl-C or for --duration seconds; it only listens.

The end of the file's name says the format: .log (candump), .asc or .blf (Vector), .trc (PEAK).
"""

from __future__ import annotations

import json
import signal
import sys
import threading
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from canopen_control.bus.channel import parse_channel
from canopen_control.bus.record import RecordingWriter, format_of
from canopen_control.cli.progress import Progress
from canopen_control.cli.record_bag import RATE, record_bag, sentence
from canopen_control.cli.target import robot_on
from canopen_control.cli.trace import positive_seconds
from canopen_control.client import RobotClient, find_robots
from canopen_control.errors import BusClosed, ConfigError
from canopen_control.host.signals import on_signals
from canopen_control.trace.listen import batches, open_listener

if TYPE_CHECKING:
    import argparse

    from canopen_control.bus.port import Port

__all__ = ["EXAMPLE", "Recorded", "add_arguments", "record_frames", "run"]

EXAMPLE = """canopen-control record --can run.log
         canopen-control record can0 --can run.blf --duration 60
         canopen-control record --bag run --duration 60"""
LABEL = "record"
FLUSH_S = 0.5  # what a crash may cost of the formats that are written frame by frame
_ENDS = (signal.SIGINT, signal.SIGTERM)  # noted, so that no frame is cut in the middle


@dataclass(slots=True)
class Recorded:
    """What became of a recording: `frames` are in the file, `lost` never came, `left_out` the format cannot hold."""

    file: str
    channel: str
    frames: int = 0
    lost: int = 0
    left_out: int = 0
    seconds: float = 0.0
    problem: str = ""

    def as_dict(self) -> dict[str, Any]:
        """Return it as plain data."""
        return {
            "file": self.file,
            "channel": self.channel,
            "frames": self.frames,
            "lost": self.lost,
            "left_out": self.left_out,
            "seconds": round(self.seconds, 3),
        }

    def sentence(self) -> str:
        """Return it for people."""
        text = f"{self.file}: {self.frames} frames of {self.channel} in {self.seconds:.1f} s"
        text += f", {self.lost} lost: they came faster than they were read" if self.lost else ", none lost"
        return text + (f", {self.left_out} left out: the format cannot hold them" if self.left_out else "")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("channel", nargs="?", metavar="CHANNEL", help="this bus (default: that of the running robot)")
    parser.add_argument("--can", metavar="FILE", help="write the frames to this file: .log, .asc, .blf or .trc")
    parser.add_argument("--bag", metavar="DIR", help="write a ROS 2 bag (MCAP) of the running robot to this new folder")
    parser.add_argument(
        "--rate", type=float, default=RATE, metavar="HZ", help=f"with --bag: samples (default: {RATE:g})"
    )
    parser.add_argument("--name", help="the running robot (default: the only one)")
    parser.add_argument("--bus", metavar="NAME", help="which one, of a robot with several buses")
    parser.add_argument("--duration", type=positive_seconds, metavar="S", help="end after so many seconds")
    parser.add_argument("--json", action="store_true", help="print the result as JSON")


def run(args: argparse.Namespace) -> int:
    """Run the verb; 1 when the bus went away meanwhile."""
    if (args.can is None) is (args.bag is None):
        raise ConfigError("say where to record to, as in: canopen-control record --can run.log, or record --bag run")
    if args.bag is not None:
        return _bag(args)
    _check_file(args.can)
    channel, owner = _bus_of(args)
    recorded = record_frames(open_listener(channel, LABEL, owner=owner), args.can, args.duration)
    print(json.dumps(recorded.as_dict()) if args.json else recorded.sentence())
    if recorded.problem:
        print(f"canopen-control: {recorded.problem}", file=sys.stderr)
    return 1 if recorded.problem else 0


def _bag(args: argparse.Namespace) -> int:
    if args.channel is not None:
        raise ConfigError("--bag is of a robot, not of a bus: choose it with --name, without CHANNEL")
    recorded = record_bag(args.name, args.bag, args.duration, args.rate)
    print(json.dumps(recorded) if args.json else sentence(recorded))
    return 0


def _check_file(path: str) -> None:
    """Refuse a wrong name before a bus is opened; ConfigError, also for a bus in the place of the file."""
    try:
        format_of(path)
    except ConfigError:
        if not _is_channel(path):
            raise
        raise ConfigError(
            f"--can names the file to write, and the bus goes before it: canopen-control record {path} --can run.log"
        ) from None


def _is_channel(text: str) -> bool:
    try:
        parse_channel(text)
    except ConfigError:
        return False
    return True


def _bus_of(args: argparse.Namespace) -> tuple[str, str]:
    """Return the channel to listen to, and the robot that runs there."""
    if args.channel is not None:
        channel = str(parse_channel(args.channel))
        owner = robot_on(channel) if find_robots() else None
        return channel, "" if owner is None else owner[0]
    with RobotClient.connect(args.name) as robot:
        buses = robot.call("nodes")["buses"]
    if not buses:
        raise ConfigError(f"robot {robot.robot} has no bus: it runs on mock hardware, or simulated")
    if args.bus is None and len(buses) > 1:
        raise ConfigError(f"robot {robot.robot} has several buses; choose with --bus: {', '.join(buses)}")
    if args.bus is not None and args.bus not in buses:
        raise ConfigError(f"robot {robot.robot} has no bus {args.bus!r}; it has: {', '.join(buses)}")
    return str(buses[args.bus or next(iter(buses))]["channel"]), robot.robot


def record_frames(port: Port, path: str, seconds: float | None) -> Recorded:
    """Write what `port` hears until Ctrl-C, SIGTERM, the end of `seconds` or of the bus; the port is closed."""
    recorded, begin = Recorded(path, port.channel), time.monotonic()
    progress, stopping, flush = (
        Progress(f"recording {port.channel}, Ctrl-C ends it", "frames"),
        threading.Event(),
        begin,
    )
    try:
        with on_signals(_ENDS, stopping.set), RecordingWriter(path, port.channel) as writer:
            try:
                for batch in batches(port, seconds):
                    for each in batch:
                        writer.write(*each)
                    if time.monotonic() >= flush + FLUSH_S:
                        flush = time.monotonic()
                        writer.flush()
                    progress.at(writer.written)
                    if stopping.is_set():
                        break
            except BusClosed as error:
                recorded.problem = str(error)
            recorded.frames, recorded.left_out = writer.written, writer.left_out
    finally:
        port.close()
        progress.end()
    recorded.lost, recorded.seconds = port.stats.lost, time.monotonic() - begin
    return recorded
