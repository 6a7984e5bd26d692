"""Bus for verbs that only listen: its description, from a robot or files, and the frames of recordings.

The files of a robot take precedence over the running robot. Without any description, every frame is still shown, by
the predefined connection set.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias, TypeVar

from canopen_control.bus.channel import parse_channel
from canopen_control.bus.recordings import RecordedFrame, Recording
from canopen_control.cli.support.parsers import add_robot_name
from canopen_control.cli.support.target import find_eds, robot_on
from canopen_control.client import RobotClient, find_robots
from canopen_control.errors import CanopenError, ConfigError
from canopen_control.rpc.messages.robot import GetLayout
from canopen_control.trace.flight_file import is_flight_file
from canopen_control.trace.network_description import NetworkDescription, network_of_eds, network_of_layout

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator, Mapping

    from canopen_control.master.config import BusConfig
    from canopen_control.master.pdo_layout import LinearAxes
    from canopen_control.rpc.messages.layout import BusLayout


T = TypeVar("T")
_NO_NAMES = "canopen-control: object names are unknown: give ROBOT, --name or --eds"


@dataclass(frozen=True, slots=True)
class WatchedBus:
    """Bus from which frames are received; `owner` is the robot that runs on it, or "".

    `report_notes` prints notes about object names to standard error; call it once the bus is open.
    """

    channel: str
    network: NetworkDescription
    owner: str = ""
    nameless: bool = False

    def report_notes(self) -> None:
        """Print the notes of the description, and first a note if object names are unknown."""
        if self.nameless:
            print(_NO_NAMES, file=sys.stderr)
        _report(self.network)


def add_network_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare ROBOT, --name, --bus and --eds."""
    parser.add_argument(
        "config", nargs="?", metavar="ROBOT", help="use the names of this robot: a folder or a bundled robot"
    )
    add_robot_name(parser)
    parser.add_argument("--bus", metavar="NAME", help="bus of a robot with several buses")
    parser.add_argument(
        "--eds",
        action="append",
        default=[],
        metavar="[NODE=]FILE",
        help="use the names of an EDS, for one node or all; or a folder of DCF files (repeatable)",
    )


def watched_bus(args: argparse.Namespace, channel: str | None) -> WatchedBus:
    """Return the bus on `channel` (None: a bus of the running robot); raise ConfigError if it does not exist."""
    layout: BusLayout | None
    if channel is None:
        _refuse_channel(args.config)
        with RobotClient.connect(args.name) as robot:
            layouts, owner = robot.ask(GetLayout()).buses, robot.robot
        layout = chosen = choose_bus(layouts, args.bus, f"robot {owner}")
        channel = chosen.channel
    else:
        channel = str(parse_channel(channel))
        owner, layout = _robot_on(channel)
    network = _described(args, channel)
    nameless = network is None and layout is None
    if network is None:
        network = NetworkDescription(channel) if layout is None else network_of_layout(layout)
    return WatchedBus(channel, replace(network, channel=channel), owner, nameless)


def _refuse_channel(config: str | None) -> None:
    """Raise ConfigError with advice if a channel was given in place of ROBOT."""
    if config is None or Path(config).is_dir():
        return
    try:
        channel = parse_channel(config)
    except ConfigError:
        return
    raise ConfigError(f"{channel} is a bus, not a robot: write --can {channel}")


def described(args: argparse.Namespace, *, units: bool = False) -> NetworkDescription:
    """Return the network description of ROBOT, --eds or --name; an empty description without these options.

    With `units` it includes the units of values, which requires reading the robot's description.
    """
    network = _described(args, "", units=units)
    if network is None and args.name is not None:
        with RobotClient.connect(args.name) as robot:
            network = network_of_layout(choose_bus(robot.ask(GetLayout()).buses, args.bus, f"robot {args.name}"))
    if network is None:
        print(_NO_NAMES, file=sys.stderr)
        network = NetworkDescription()
    _report(network)
    return network


def _described(args: argparse.Namespace, channel: str, *, units: bool = False) -> NetworkDescription | None:
    """Return the network of ROBOT and the --eds files, or None if neither is given; ROBOT takes precedence."""
    by_eds = network_of_eds(channel, args.eds, find_eds) if args.eds else None
    if args.config is None:
        return by_eds
    network = network_of_layout(config_layout(args.config, args.bus, units=units))
    return network if by_eds is None else replace(network, nodes={**by_eds.nodes, **network.nodes})


def config_layout(config: str, bus: str | None = None, *, units: bool = False) -> BusLayout:
    """Return the layout of one bus of a robot's files; `units` adds the units of values."""
    from canopen_control.master.config import read_bus
    from canopen_control.master.pdo_layout import layout_of
    from canopen_control.runtime.robot_files import find_buses

    read = read_bus(choose_bus(find_buses(config), bus, config))
    return layout_of(read, linear=_linear_axes(config, read) if units else None)


def _linear_axes(config: str, bus: BusConfig) -> LinearAxes:
    """Return the axes of prismatic joints; if the URDF cannot be read, print a note and return an empty set."""
    from canopen_control.runtime.robot_files import find_robot
    from canopen_control.runtime.sync_choice import linear_axes
    from canopen_control.urdf.description import DescriptionReader

    try:
        files = find_robot(config)
        if files.bus_alone:
            return frozenset()
        with DescriptionReader(files.description, mappings=files.mappings()) as reader:
            return linear_axes(bus, reader.result())
    except CanopenError as error:
        print(
            f"canopen-control: joint types are unknown, so all joints are in rad: {error}",
            file=sys.stderr,
        )
        return frozenset()


def choose_bus(buses: Mapping[str, T], name: str | None, owner: str) -> T:
    """Return the bus `name`, or the only bus if `name` is None; raise ConfigError if this selects no bus."""
    if not buses:
        raise ConfigError(f"{owner} has no bus, as on mock hardware or in a simulation")
    if name is None and len(buses) == 1:
        return next(iter(buses.values()))
    if name is None or name not in buses:
        problem = f"{owner} has several buses" if name is None else f"{owner} has no bus {name!r}"
        raise ConfigError(f"{problem}; choose with --bus: {', '.join(buses)}")
    return buses[name]


def _robot_on(channel: str) -> tuple[str, BusLayout | None]:
    """Return the name of the robot on `channel` and the layout of that bus; "" and None without a robot."""
    if not find_robots() or (running := robot_on(channel)) is None:
        return "", None
    with RobotClient.connect(running[0]) as robot:
        layouts = robot.ask(GetLayout()).buses.values()
    return running[0], next((layout for layout in layouts if layout.channel == channel), None)


def _report(network: NetworkDescription) -> None:
    for note in network.notes:
        print(f"canopen-control: {note}", file=sys.stderr)


# Frames of FILE, which is a recording of frames, or a flight recording, which also contains the object names.
#
# One bus of a flight recording is read; --bus chooses among several. A description from the arguments (ROBOT, --eds)
# takes precedence over the description in the recording.


class FlightSource:
    """Frames of one bus of a flight recording, with the interface of `Recording`; `network` describes the bus."""

    def __init__(self, path: str, bus: str | None) -> None:
        from canopen_control.trace.flight_file import read_flight
        from canopen_control.trace.report_build import networks_of

        file = read_flight(Path(path))
        chosen = choose_bus({name: name for name in file.meta.buses}, bus, path)
        self.path = Path(path)
        self.network = networks_of(file).get(chosen)
        self.skipped = file.unread_lines
        self._frames = [RecordedFrame(time_ns, frame) for time_ns, name, frame in file.frames if name == chosen]
        self.problem = "" if self._frames else f"{path} contains no frame of bus {chosen}"
        self.mixture = ""

    def __iter__(self) -> Iterator[RecordedFrame]:
        return iter(self._frames)


Source: TypeAlias = Recording | FlightSource


def open_frames(path: str, bus: str | None = None) -> Source:
    """Open a recording of frames or a flight recording; `bus` selects one of several buses.

    Raise ConfigError if a recording of frames contains none.
    """
    return FlightSource(path, bus) if is_flight_file(Path(path)) else frames_of_file(path)


def frames_of_file(path: str | Path) -> Recording:
    """Open a recording of frames; raise ConfigError if it contains no readable frame."""
    recording = Recording(path)
    if next(iter(recording), None) is None:
        raise ConfigError(recording.problem or f"{path}: contains no frames")
    return recording


def report_gaps(source: Source) -> None:
    """Report skipped lines, frames of several buses, and the reason if reading ended early, on standard error."""
    if source.skipped:
        lines = "1 line is not a frame" if source.skipped == 1 else f"{source.skipped} lines are not frames"
        print(f"canopen-control: {source.path}: {lines} of classic CAN, left out", file=sys.stderr)
    for text in filter(None, (source.mixture, source.problem)):
        print(f"canopen-control: {text}", file=sys.stderr)


def network_for(args: argparse.Namespace, source: Source) -> NetworkDescription:
    """Return the network description for a recording: from the arguments, else from the recording, else empty."""
    recorded = source.network if isinstance(source, FlightSource) else None
    by_arguments = args.config is not None or args.name is not None or bool(args.eds)
    return described(args) if by_arguments or recorded is None else recorded
