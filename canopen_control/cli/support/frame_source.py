"""Which frames a FILE holds and how they are named: a recording of frames, or a flight recording, which names its own.

Of a flight recording with several buses one is read, chosen by --bus. What the arguments describe (ROBOT, --eds) wins
over what the recording says of itself.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

from canopen_control.bus.recordings import RecordedFrame, Recording
from canopen_control.cli.support.heard_bus import described
from canopen_control.errors import ConfigError
from canopen_control.trace.flight_file import is_flight_file

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator

    from canopen_control.trace.flight_file import FlightFile
    from canopen_control.trace.network_description import NetworkDescription

__all__ = ["FlightSource", "Source", "network_for", "open_frames", "tell_gaps"]


class FlightSource:
    """The frames of one bus of a flight recording, to be read as a `Recording` is; `network` says who is on it."""

    def __init__(self, path: str, bus: str | None) -> None:
        from canopen_control.trace.flight_file import read_flight
        from canopen_control.trace.report_build import networks_of

        file = read_flight(Path(path))
        chosen = _chosen(path, file, bus)
        self.path = Path(path)
        self.network = networks_of(file).get(chosen)
        self.skipped = file.unread_lines
        self._frames = [RecordedFrame(time_ns, frame) for time_ns, name, frame in file.frames if name == chosen]
        self.problem = "" if self._frames else f"{path}: no frame of bus {chosen} is in it"

    def __iter__(self) -> Iterator[RecordedFrame]:
        return iter(self._frames)


Source: TypeAlias = Recording | FlightSource


def open_frames(path: str, bus: str | None = None) -> Source:
    """Open FILE, of several buses `bus`; ConfigError where it cannot be read."""
    return FlightSource(path, bus) if is_flight_file(Path(path)) else Recording(path)


def tell_gaps(source: Source) -> None:
    """Say on standard error, after a reading, what of a source was left out and why it ends too early, if it does."""
    if source.skipped:
        lines = "1 line is no frame" if source.skipped == 1 else f"{source.skipped} lines are no frames"
        print(f"canopen-control: {source.path}: {lines} of classic CAN, left out", file=sys.stderr)
    if source.problem:
        print(f"canopen-control: {source.problem}", file=sys.stderr)


def network_for(args: argparse.Namespace, source: Source) -> NetworkDescription:
    """Describe the bus of a source by the arguments, else by what the source knows, else not at all."""
    own = source.network if isinstance(source, FlightSource) else None
    by_arguments = args.config is not None or args.name is not None or bool(args.eds)
    return described(args) if by_arguments or own is None else own


def _chosen(path: str, file: FlightFile, wanted: str | None) -> str:
    """Return the bus that is meant."""
    buses = list(file.meta.buses)
    if wanted is None and len(buses) == 1:
        return buses[0]
    if wanted is not None and wanted in buses:
        return wanted
    if not buses:
        raise ConfigError(f"{path}: the robot had no bus: it ran on mock hardware, or simulated")
    problem = "several buses are in it" if wanted is None else f"no bus {wanted!r} is in it"
    raise ConfigError(f"{path}: {problem}; choose with --bus: {', '.join(buses)}")
