"""The file of a flight recorder: one zip that can be attached to a bug report and opened without this package.

    meta.json     robot, `reason` and when, `buses` {name: channel}, `layout` and `status` as the API has them
    can.log       all frames of the window in candump's log format, the bus' name of bus.yml as the interface
    events.jsonl  the run's events as in the API's stream, one a line; older than the window too
    states.jsonl  the samples of the state stream
    eds/          the EDS files of the nodes, so that the frames can be decoded by name anywhere

Times are Unix seconds, those of frames Unix ns. A file is complete or not there: it gets its name when it is whole. A
folder keeps `MAX_FILES`; the oldest go.
"""

from __future__ import annotations

import contextlib
import io
import itertools
import json
import os
import re
import time
import zipfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeVar

from canopen_control.bus.candump import interface_name, line_of, parse_line
from canopen_control.errors import ConfigError
from canopen_control.frame import CanFrame, frames_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from canopen_control.trace.flight_ring import Batch

__all__ = [
    "MAX_FILES",
    "FlightFile",
    "FlightFrame",
    "candump_lines",
    "is_flight_file",
    "newest",
    "read_flight",
    "read_meta",
    "save",
]

T = TypeVar("T")
FORMAT: Final = "canopen_control flight recording"
VERSION: Final = 1
MAX_FILES: Final = 20
_CHUNK: Final = 10_000  # lines of the log that are made at once
_META, _CAN, _EVENTS, _STATES, _EDS = "meta.json", "can.log", "events.jsonl", "states.jsonl", "eds/"
FlightFrame = tuple[int, str, CanFrame]  # Unix ns, name of the bus, frame


@dataclass(slots=True)
class FlightFile:
    """What is in a file; `frames` are in order of time, `eds` holds the texts of the EDS files by file name."""

    meta: dict[str, Any]
    events: list[dict[str, Any]] = field(default_factory=list)
    states: list[dict[str, Any]] = field(default_factory=list)
    frames: list[FlightFrame] = field(default_factory=list)
    eds: dict[str, bytes] = field(default_factory=dict)


def candump_lines(batches: Iterable[Batch], buses: Iterable[str], wall_offset_ns: int) -> Iterator[str]:
    """Yield a line for each record; `buses` are their names by number, the offset makes Unix time of the batches'."""
    interfaces = [interface_name(bus) for bus in buses]
    for now, bus, records in batches:
        for frame in frames_of(records):
            yield line_of(now + wall_offset_ns, interfaces[bus], frame)


def save(
    folder: Path,
    meta: dict[str, Any],
    can: Iterator[str],
    events: Iterable[bytes],
    states: Iterable[bytes],
) -> Path:
    """Write a file about `meta["reason"]` into `folder`, and forget the oldest there; raises OSError."""
    folder.mkdir(parents=True, exist_ok=True)
    path = _free_path(folder, meta)
    part = path.with_suffix(".part")
    try:
        with zipfile.ZipFile(part, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
            archive.writestr(_META, json.dumps({"format": FORMAT, "version": VERSION, **meta}, indent=1))
            for name, lines in ((_EVENTS, events), (_STATES, states)):
                archive.writestr(name, b"".join(line.rstrip(b"\n") + b"\n" for line in lines))
            with archive.open(_CAN, "w", force_zip64=True) as log:
                while chunk := "".join(itertools.islice(can, _CHUNK)):
                    log.write(chunk.encode("ascii"))
            for path_of_eds in _eds_paths(meta):
                with contextlib.suppress(OSError):
                    archive.write(path_of_eds, _EDS + Path(path_of_eds).name)
        part.rename(path)
    finally:
        part.unlink(missing_ok=True)
    _forget_oldest(folder)
    return path


def _eds_paths(meta: dict[str, Any]) -> set[str]:
    buses = meta.get("layout", {}).get("buses", {}).values()
    return {node["eds"] for bus in buses for node in bus["nodes"] if node.get("eds")}


def _free_path(folder: Path, meta: dict[str, Any]) -> Path:
    """Name it after when and why; the names of a folder sort by time."""
    reason = meta["reason"]
    stamp = time.strftime("%Y-%m-%dT%H-%M-%S", time.localtime(meta["written"]))
    words = "-".join(re.sub(r"\W+", "_", str(word), flags=re.ASCII) for word in _words(reason))
    path, number = folder / f"{stamp}-{words}.zip", 1
    while path.exists():
        number += 1
        path = folder / f"{stamp}-{words}-{number}.zip"
    return path


def _words(reason: dict[str, Any]) -> list[str]:
    return [str(reason[key])[:40] for key in ("kind", "node") if reason.get(key)]


def _forget_oldest(folder: Path) -> None:
    for path in sorted(folder.glob("*.zip"))[:-MAX_FILES]:
        path.unlink(missing_ok=True)


def newest(folder: Path) -> Path | None:
    """Return the newest file of a folder, None if there is none."""
    return max(folder.glob("*.zip"), default=None)


def is_flight_file(path: Path) -> bool:
    """Whether a path names a file of a flight recorder, by its ending."""
    return path.suffix.lower() == ".zip"


def read_flight(path: Path) -> FlightFile:
    """Read a file; ConfigError in a sentence when it is none. Lines that cannot be read are counted in `meta`."""
    return _opened(path, _read)


def read_meta(path: Path) -> dict[str, Any]:
    """Read only what a file says of itself; ConfigError as above."""
    return _opened(path, lambda _archive, meta: meta)


def _opened(path: Path, read: Callable[[zipfile.ZipFile, dict[str, Any]], T]) -> T:
    try:
        with zipfile.ZipFile(path) as archive:
            meta = json.loads(archive.read(_META))
            if not isinstance(meta, dict) or meta.get("format") != FORMAT or meta.get("version") != VERSION:
                raise ConfigError(f"{path}: this is no flight recording that this version can read")
            return read(archive, meta)
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror or error}") from error
    except (zipfile.BadZipFile, KeyError, ValueError, NotImplementedError) as error:
        raise ConfigError(f"{path}: this is no flight recording: {error}") from error


def _read(archive: zipfile.ZipFile, meta: dict[str, Any]) -> FlightFile:
    names = archive.namelist()
    events, states = ([json.loads(line) for line in archive.read(name).splitlines()] for name in (_EVENTS, _STATES))
    file = FlightFile(meta, events, states)
    buses, unread = {interface_name(bus): bus for bus in meta.get("buses", {})}, 0
    with io.TextIOWrapper(archive.open(_CAN), "ascii", "replace") as log:
        for line in log:
            found = parse_line(line)
            if found is None:
                unread += 1
            else:
                interface = line.split()[1]
                file.frames.append((found[0], buses.get(interface, interface), found[1]))
    file.meta["unread_lines"] = unread
    file.eds = {os.path.basename(name): archive.read(name) for name in names if name.startswith(_EDS)}
    return file
