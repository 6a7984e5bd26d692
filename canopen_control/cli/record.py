"""Record every frame of a bus, or a robot as a ROS 2 bag, until Ctrl-C or for --for seconds; nothing is sent.

The suffix of the file chooses the format: .log (candump; .log.gz compressed), .asc or .blf (Vector), .trc (PEAK).

Exit codes: 0 success; 1 no frame was received, the bus is gone, or the disk is full; 2 wrong usage, no such channel
or robot.
"""

from __future__ import annotations

import argparse
import contextlib
import sys
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from canopen_control.bus.channel import parse_channel
from canopen_control.bus.recordings import FORMATS, RecordingWriter, format_of
from canopen_control.cli.support.arguments import add_duration
from canopen_control.cli.support.bus_description import choose_bus
from canopen_control.cli.support.output import Progress, json_text
from canopen_control.cli.support.parsers import add_robot_name
from canopen_control.cli.support.target import robot_on
from canopen_control.client import RobotClient, find_robots
from canopen_control.client.robot_client import outpaced, stream_rate
from canopen_control.errors import BusClosed, ConfigError, DiskFull, RemoteError
from canopen_control.host.signals import ENDING, on_signals
from canopen_control.rpc.messages.robot import MAX_RATE, GetDescription, GetNodes, GetStatus, ListControllers, Subscribe
from canopen_control.rpc.messages.state import RobotEvent, StateSample
from canopen_control.trace.listen import batches, open_listener

if TYPE_CHECKING:
    from canopen_control.bus.port import Port
    from canopen_control.rpc.messages.robot import RobotPush
    from canopen_control.trace.bag import BagWriter


# `record --bag` records a ROS 2 bag of a running robot until Ctrl-C, for a given time, or until the robot ends.


_POLL_S = 0.25  # interval of the checks for Ctrl-C while no message arrives


@dataclass(slots=True)
class RecordedBag:
    """Result of recording a ROS 2 bag: numbers of messages, samples and events.

    `left_out` is a sentence about the controllers that publish more often than samples are recorded, or None.
    """

    bag: str
    robot: str
    messages: int = 0
    samples: int = 0
    events: int = 0
    seconds: float = 0.0
    left_out: str | None = None

    def sentence(self) -> str:
        text = (
            f"{self.bag}: {self.messages} messages of {self.robot} in {self.seconds:.1f} s "
            f"({self.samples} samples, {self.events} events)"
        )
        return text if self.left_out is None else f"{text}; {self.left_out}; record more with --rate"


def record_bag(name: str | None, folder: str, seconds: float | None, rate: float | None = None) -> RecordedBag:
    """Record a ROS 2 bag until `seconds` have passed, a signal arrives or the robot ends.

    `rate` is the sample rate in Hz; by default it is the rate of the controllers. Raise ConfigError if no robot runs,
    rosbags is missing, `folder` exists or `rate` is invalid.
    """
    if rate is not None and not 0 < rate <= MAX_RATE:
        raise ConfigError(f"--rate {rate:g} Hz: it must be above 0 and at most {MAX_RATE:g}")
    from canopen_control.trace.bag import BagWriter

    stopping = threading.Event()
    with RobotClient.connect(name) as robot:
        controllers, urdf = robot.ask(ListControllers()), robot.ask(GetDescription()).urdf
        writer = BagWriter(Path(folder), robot.robot, controllers=controllers, urdf=urdf)
        with on_signals(ENDING, stopping.set), writer as bag:
            begin = time.monotonic()  # importing rosbags takes half a second
            stream = stream_rate(robot.ask(GetStatus()).cycle, rate or 0.0)
            recorded = RecordedBag(folder, robot.robot, left_out=outpaced(controllers, stream))
            _record(robot, bag, recorded, stream, stopping, None if seconds is None else begin + seconds)
            recorded.seconds = round(time.monotonic() - begin, 3)
    recorded.messages = bag.messages
    return recorded


def _record(
    robot: RobotClient,
    bag: BagWriter,
    recorded: RecordedBag,
    rate: float,
    stopping: threading.Event,
    end: float | None,
) -> None:
    robot.ask(Subscribe(state_rate=rate, events=True))
    try:
        while not stopping.is_set() and (end is None or time.monotonic() < end):
            for message in robot.messages(_POLL_S if end is None else min(_POLL_S, max(end - time.monotonic(), 0.0))):
                _write(bag, message, recorded)
                if stopping.is_set() or (end is not None and time.monotonic() >= end):
                    break
    except RemoteError as error:  # the robot has ended: the bag is complete up to here
        if error.kind != "BusClosed":
            raise


def _write(bag: BagWriter, message: RobotPush, recorded: RecordedBag) -> None:
    if isinstance(message, StateSample):
        bag.state(message)
        recorded.samples += 1
    elif isinstance(message, RobotEvent):
        bag.event(message)
        recorded.events += 1


EXAMPLE = """canopen-control record -o run.log
         canopen-control record --can can0 -o run.blf --for 60
         canopen-control record --bag run --for 60"""
LABEL = "record"
FLUSH_S = 0.5  # a crash loses at most this much, in formats that are written frame by frame


@dataclass(slots=True)
class Recorded:
    """Result of a recording; `lost` frames were not read in time, `left_out` frames do not fit the file format."""

    file: str
    channel: str
    frames: int = 0
    lost: int = 0
    left_out: int = 0
    seconds: float = 0.0

    def sentence(self) -> str:
        text = f"{self.file}: {self.frames} frames of {self.channel} in {self.seconds:.1f} s"
        text += f", {self.lost} lost: they arrived faster than they were read" if self.lost else ", none lost"
        return text + (f", {self.left_out} left out: the format cannot hold them" if self.left_out else "")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("channel", nargs="?", help=argparse.SUPPRESS)  # the old form: record CHANNEL --can FILE
    parser.add_argument("--can", metavar="CHANNEL", help="channel to record (default: channel of the running robot)")
    parser.add_argument("-o", "--output", metavar="FILE", help="write the frames to this file: .log, .asc, .blf, .trc")
    parser.add_argument("--bag", metavar="DIR", help="write a ROS 2 bag (MCAP) of the running robot to this new folder")
    parser.add_argument(
        "--rate",
        type=float,
        metavar="HZ",
        help="with --bag: samples of the state per second (default: the rate of the controllers)",
    )
    add_robot_name(parser)
    parser.add_argument("--bus", metavar="NAME", help="bus of a robot with several buses")
    parser.add_argument("--overwrite", action="store_true", help="replace an existing file")
    add_duration(parser, "end after S seconds", former="--duration", dest="duration")
    parser.add_argument("--json", action="store_true", help="print the result as JSON")


def run(args: argparse.Namespace) -> int:
    """Run the verb; return 1 if no frame came, the bus was lost or the disk was full, else 0."""
    _convert_old_form(args)
    if (args.output is None) is (args.bag is None):
        raise ConfigError("give a destination, as in: canopen-control record -o run.log, or record --bag run")
    if args.bag is not None:
        return _bag(args)
    format_of(args.output, writing=True)  # a wrong name is reported before a bus is opened
    if Path(args.output).is_file() and not args.overwrite:
        raise ConfigError(f"{args.output} already exists; choose another name, or replace it with --overwrite")
    channel, owner = _bus_of(args)
    recorded, problem = record_frames(open_listener(channel, LABEL, owner=owner), args.output, args.duration)
    print(json_text(recorded, indent=None) if args.json else recorded.sentence())
    if problem:
        print(f"canopen-control: {problem}", file=sys.stderr)
    return 1 if problem else 0


def _convert_old_form(args: argparse.Namespace) -> None:
    """Convert the old form `record [CHANNEL] --can FILE` to the current options, and print a notice."""
    old_file = args.output is None and args.can is not None and Path(args.can).suffix.lower() in FORMATS
    if args.channel is None and not old_file:
        return
    if args.channel is not None and not old_file and args.can is not None:
        raise ConfigError(f"two buses, {args.channel} and {args.can}: write --can CHANNEL -o FILE")
    if old_file:
        args.output, args.can = args.can, None
    if args.channel is not None:
        args.can, args.channel = args.channel, None
    new = "".join(f" {option} {value}" for option, value in (("--can", args.can), ("-o", args.output)) if value)
    print(f"canopen-control: these options are deprecated; write: record{new}", file=sys.stderr)


def _bag(args: argparse.Namespace) -> int:
    if args.can is not None:
        raise ConfigError("--bag records a robot, not a bus; choose the robot with --name, and omit --can")
    recorded = record_bag(args.name, args.bag, args.duration, args.rate)
    print(json_text(recorded, indent=None) if args.json else recorded.sentence())
    return 0


def _bus_of(args: argparse.Namespace) -> tuple[str, str]:
    """Return the channel to record, and the name of the robot that runs on it, or ""."""
    if args.can is not None:
        channel = str(parse_channel(args.can))
        owner = robot_on(channel) if find_robots() else None
        return channel, "" if owner is None else owner[0]
    with RobotClient.connect(args.name) as robot:
        buses = robot.ask(GetNodes()).buses
    return choose_bus(buses, args.bus, f"robot {robot.robot}").channel, robot.robot


def record_frames(port: Port, path: str, seconds: float | None) -> tuple[Recorded, str]:
    """Record frames until `seconds` have passed, a signal arrives, the bus is lost or the disk is full; close the port.

    Return the result, and the reason why the recording ended early, or "".
    """
    recorded, problem, stopping = Recorded(path, port.channel), "", threading.Event()
    begin = flushed = time.monotonic()
    with (
        contextlib.closing(port),
        Progress(f"recording {port.channel}, Ctrl-C ends it", "frames") as progress,
        on_signals(ENDING, stopping.set),
    ):
        writer = RecordingWriter(path, port.channel)
        try:
            with writer:
                for batch in batches(port, seconds):
                    for frame in batch:
                        writer.write(*frame)
                    if time.monotonic() >= flushed + FLUSH_S:
                        flushed = time.monotonic()
                        writer.flush()
                    progress.at(writer.written)
                    if stopping.is_set():
                        break
        except (BusClosed, DiskFull) as error:
            problem = str(error)
    recorded.frames, recorded.left_out = writer.written, writer.left_out
    recorded.lost, recorded.seconds = port.stats.lost, round(time.monotonic() - begin, 3)
    if not recorded.frames and not problem:
        problem = f"no frame was received on {port.channel}; see canopen-control bus status {port.channel}"
    return recorded, problem
