"""File of a flight recorder, and its trigger: a zip archive for bug reports, readable without this package.

    meta.json     `FlightMeta`: robot, `reason` and time, `buses` {name: channel}, `layout` and `status` of the robot
    can.log       all frames of the window in candump's log format; the interface is the name of the bus in bus.yml
    events.jsonl  events of the run as in the robot's stream, one per line, including those before the window
    states.jsonl  samples of the state stream, read as `TimedSnapshot`
    requests.jsonl  requests of clients other than reads
    eds/          EDS files of the nodes, so that the frames can be decoded with names anywhere

Times are Unix s, those of frames Unix ns. A file is complete or absent, because it gets its name only when complete. A
folder keeps `MAX_FILES`; older files are deleted.

Files may come from anywhere: sizes are limited before unpacking, the declared structures are checked, and the first
error is reported with its place. Undeclared content is ignored, so that recordings of other versions can be read.

A file follows a fault and the reaction to it, at a limited rate. A fault is an event of level error, or an event that
reports a lost bus. The file is written `AFTER_NS` after the last fault, so that it contains the reaction, but at most
`LONGEST_NS` after the first fault. The next file follows `GAP_NS` later at the earliest; while faults continue, this
gap doubles up to `WIDEST_GAP_NS`, so that a series of faults overnight does not displace the file of its first minute.
A fault that is outside of the window at the end of the gap gets no file, but is counted in `left_out`.
"""

from __future__ import annotations

import bisect
import heapq
import itertools
import lzma
import operator
import os
import re
import struct
import time
import zipfile
import zlib
from array import array
from collections import deque
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple, TypeVar

from canopen_control.bus.recordings import interface_name, line_of, parse_line
from canopen_control.bus.subscription import STAMP_STEP_NS
from canopen_control.errors import ConfigError
from canopen_control.frame import RECORD_SIZE, CanFrame, frames_of
from canopen_control.host.files import make_private, telling
from canopen_control.rpc.messages.declare import Count, Document, UnixTime
from canopen_control.rpc.messages.drive import WorldShape
from canopen_control.rpc.messages.layout import Layout
from canopen_control.rpc.messages.robot import RequestSeen
from canopen_control.rpc.messages.state import RobotEvent, StateSample, Status, TimedSnapshot
from canopen_control.rpc.wire import decode, text_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence


SECOND = 1_000_000_000
AFTER_NS = 3 * SECOND
LONGEST_NS = 10 * SECOND
GAP_NS = 30 * SECOND
WIDEST_GAP_NS = 960 * SECOND
CALM_NS = 300 * SECOND  # after this time without a fault the gap is reset
_KINDS = frozenset({"bus_bus_off", "bus_down", "bus_closed", "bus_lost"})
_NEVER = 1 << 62


def is_fault(event: RobotEvent) -> bool:
    """Whether an event of the API's stream is a fault that triggers a file."""
    return event.level == "error" or event.kind in _KINDS


def is_sum(event: RobotEvent) -> bool:
    """Whether an event summarises earlier events."""
    return event.since not in (None, event.time)


class RecordingTrigger:
    """Trigger for files; times are in monotonic ns, `keep_ns` is the age at which a fault leaves the window."""

    def __init__(self, keep_ns: int) -> None:
        self.left_out = 0
        self._keep_ns = keep_ns
        self._reason: RobotEvent | None = None
        self._first = self._last = -_NEVER
        self._not_before = -_NEVER
        self._gap = GAP_NS

    def fault(self, event: RobotEvent, now: int) -> None:
        """Record a fault; the first fault since the last file is the reason for the next file."""
        if now - self._last >= CALM_NS:
            self._gap = GAP_NS
        if self._reason is not None and now - self._first > self._keep_ns:
            self._reason = None  # the gap delayed it until it was outside the window
            self.left_out += 1
        if self._reason is None:
            self._reason, self._first = event, now
        self._last = now

    def next_deadline(self) -> int | None:
        """Return the time at which `due` must be called, or None if no file is pending."""
        if self._reason is None:
            return None
        return max(min(self._last + AFTER_NS, self._first + LONGEST_NS), self._not_before)

    def due(self, now: int) -> RobotEvent | None:
        """Return the fault for which a file must be written now, or None; each fault is returned only once."""
        deadline = self.next_deadline()
        if deadline is None or now < deadline:
            return None
        return self._take(now)

    def end(self, now: int) -> RobotEvent | None:
        """At the end of the recording, return the fault that has no file yet, or None."""
        return None if self._reason is None else self._take(now)

    def _take(self, now: int) -> RobotEvent | None:
        reason, self._reason = self._reason, None
        if now - self._last > self._keep_ns:
            self.left_out += 1
            return None
        self._not_before, self._gap = now + self._gap, min(2 * self._gap, WIDEST_GAP_NS)
        return reason


# Memory of a flight recorder: the newest frames and the newest lines, both bounded. An append has constant cost, and
# nothing is decoded. Frames remain 16-byte records with their times. Memory is bounded by age and by bytes, whichever
# is less; if bytes are the limit, the window is shorter, and `begin` is its start.


_SEGMENT_NS = 1_000_000_000
_SEGMENTS_OF_LIMIT = 8  # fraction of the limit per segment, so that memory is released in small steps


class KeptFrame(NamedTuple):
    """Recorded frame: monotonic time in ns, number of the bus, and the 16-byte record."""

    time: int
    bus: int
    record: bytes


class _Segment:
    """About one second of frames of one bus, as concatenated records in `data` with their times in `times`."""

    __slots__ = ("begin", "bus", "data", "times")

    def __init__(self, bus: int, begin: int) -> None:
        self.bus, self.begin = bus, begin
        self.data = bytearray()
        self.times = array("q")


class FrameRing:
    """Buffer for the frames of the last `window_ns`, of about `limit` bytes; old frames are released by segments."""

    def __init__(self, window_ns: int, limit: int) -> None:
        self._window_ns, self._limit = window_ns, limit
        self._segments: deque[_Segment] = deque()
        self._newest: dict[int, _Segment] = {}  # by bus: the segments still growing
        self._size = 0  # bytes of all complete segments

    def add(self, bus: int, records: bytes, times: Sequence[int]) -> None:
        """Append records with their times, which must be in ascending order for each bus."""
        segment, now = self._newest.get(bus), times[-1]
        if segment is None or now - segment.begin >= _SEGMENT_NS or self._is_long(segment):
            segment = self._begin_segment(bus, times[0], now)
        segment.times.extend(times)
        segment.data += records

    @property
    def size(self) -> int:
        """Number of stored bytes, including those of the times."""
        return self._size + sum(map(_size_of, self._newest.values()))

    def frames(self, since: int) -> Iterator[KeptFrame]:
        """Yield the frames of all buses received at or after `since`, in order of time."""
        buses = {segment.bus for segment in self._segments}
        return heapq.merge(*(self._frames_of(bus, since) for bus in sorted(buses)), key=operator.itemgetter(0))

    def _frames_of(self, bus: int, since: int) -> Iterator[KeptFrame]:
        for segment in self._segments:
            if segment.bus == bus:
                for number in range(bisect.bisect_left(segment.times, since), len(segment.times)):
                    at = number * RECORD_SIZE
                    yield KeptFrame(segment.times[number], bus, bytes(segment.data[at : at + RECORD_SIZE]))

    def _is_long(self, segment: _Segment) -> bool:
        return len(segment.data) * _SEGMENTS_OF_LIMIT > self._limit

    def _begin_segment(self, bus: int, begin: int, now: int) -> _Segment:
        segments = self._segments
        if (full := self._newest.get(bus)) is not None:
            self._size += _size_of(full)
        newest = self._newest[bus] = _Segment(bus, begin)
        segments.append(newest)
        self._forget(now)
        return newest

    def _forget(self, now: int) -> None:
        """Release the oldest segments that are outside the window or exceed the limit, except the last segment."""
        while len(self._segments) > 1 and (
            self._segments[0].times[-1] < now - self._window_ns or self._size > self._limit
        ):
            oldest = self._segments.popleft()
            if self._newest[oldest.bus] is oldest:  # the bus is silent
                del self._newest[oldest.bus]
            else:
                self._size -= _size_of(oldest)


def _size_of(segment: _Segment) -> int:
    return len(segment.data) + segment.times.itemsize * len(segment.times)


class LineRing:
    """Buffer for text lines as bytes, limited to `limit` bytes and to the age `window_ns` (None: any age).

    Old lines are released one by one.
    """

    def __init__(self, window_ns: int | None, limit: int) -> None:
        self._window_ns, self._limit = window_ns, limit
        self._lines: deque[tuple[int, bytes]] = deque()
        self.size = 0

    def add(self, line: bytes, now: int) -> None:
        lines = self._lines
        lines.append((now, line))
        self.size += len(line)
        while self.size > self._limit or (self._window_ns is not None and lines[0][0] < now - self._window_ns):
            self.size -= len(lines.popleft()[1])

    def lines(self, since: int = 0) -> Iterator[bytes]:
        """Yield the lines added at or after `since`, oldest first."""
        for added, line in self._lines:
            if added >= since:
                yield line


T = TypeVar("T")
FORMAT: Final = "canopen_control flight recording"
VERSION: Final = 1
MAX_FILES: Final = 20
_LOST: Final = "this recording is lost, earlier recordings are kept"
_CHUNK: Final = 10_000  # log lines formatted at once
_STEP: Final = 1 << 16  # bytes unpacked at once
_META, _CAN, _EVENTS, _STATES, _EDS = "meta.json", "can.log", "events.jsonl", "states.jsonl", "eds/"
_REQUESTS: Final = "requests.jsonl"  # absent from files of earlier versions
#: start of a name -> bytes that it may unpack to: more than the text form of the recorder's limits
_LARGEST: Final = {_META: 16 << 20, _CAN: 96 << 20, _EVENTS: 4 << 20, _STATES: 32 << 20, _EDS: 16 << 20,
                   _REQUESTS: 32 << 20}  # fmt: skip
_MAX_MEMBERS: Final = 1000
_MAX_EDS: Final = 64 << 20  # bytes of all EDS files
_UNREADABLE: Final = (
    zipfile.BadZipFile, zlib.error, lzma.LZMAError, struct.error, KeyError, ValueError, EOFError, OverflowError,
    RuntimeError, MemoryError,  # a password is a RuntimeError, an unknown compression a NotImplementedError
)  # fmt: skip
FlightFrame = tuple[int, str, CanFrame]  # Unix ns, name of the bus, frame


NO_FAULT: Final = RobotEvent(time=0.0, kind="", node=None, level="info", text="no error was reported")


class FlightFileError(ValueError):
    """Error in a flight recording, with its place in the file."""


class FlightFormat(Document, frozen=True, kw_only=True):
    """Format and version of a flight recording."""

    format: str = ""
    version: int = 0


class FlightMeta(FlightFormat, frozen=True, kw_only=True):
    """Metadata of a flight recording; `written` and `begin` (the start of the window) are in Unix s.

    `unheard` are buses that could not be opened, `frames_lost` counts frames that arrived too fast, `faults_left_out`
    faults without a file of their own. `status` is None if the robot never answered. `world` is the world of a
    simulated robot when the file was written.
    """

    format: str = FORMAT
    version: int = VERSION
    robot: str
    reason: RobotEvent
    written: UnixTime = 0.0
    begin: float = 0.0
    buses: dict[str, str] = {}  # noqa: RUF012 - msgspec makes a new one each time
    unheard: tuple[str, ...] = ()
    frames_lost: Count = 0
    faults_left_out: Count = 0
    layout: Layout = Layout()
    status: Status | None = None
    world: tuple[WorldShape, ...] = ()


@dataclass(slots=True)
class FlightFile:
    """Content of a flight recording; `frames` are in order of time, `eds` maps file names to EDS texts.

    `unread_lines` is the number of log lines that contain no frame; `notes` are sentences about other missing parts.
    """

    meta: FlightMeta
    events: list[RobotEvent] = field(default_factory=list)
    states: list[TimedSnapshot] = field(default_factory=list)
    frames: list[FlightFrame] = field(default_factory=list)
    requests: list[RequestSeen] = field(default_factory=list)
    eds: dict[str, bytes] = field(default_factory=dict)
    unread_lines: int = 0
    notes: tuple[str, ...] = ()


def candump_lines(frames: Iterable[KeptFrame], buses: Iterable[str], wall_offset_ns: int) -> Iterator[str]:
    """Yield a candump line for each frame; `wall_offset_ns` converts the times to Unix time.

    Times are strictly increasing, even if frames of two buses arrived in the same microsecond.
    """
    interfaces = [interface_name(bus) for bus in buses]
    earliest = 0
    for time_ns, bus, record in frames:
        at = max(time_ns, earliest)
        earliest = at + STAMP_STEP_NS
        for frame in frames_of(record):
            yield line_of(at + wall_offset_ns, interfaces[bus], frame)


def save(
    folder: Path,
    meta: FlightMeta,
    can: Iterator[str],
    events: Iterable[bytes],
    states: Iterable[bytes],
    requests: Iterable[bytes] = (),
) -> Path:
    """Write a recording to `folder` and delete the oldest recordings; raise ConfigError or DiskFull on failure."""
    with telling(folder, "no recording was written"):
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    path = _free_path(folder, meta)
    write_flight(path, meta, can, events, states, requests)
    _forget_oldest(folder)
    return path


def write_flight(
    path: Path,
    meta: FlightMeta,
    can: Iterator[str],
    events: Iterable[bytes],
    states: Iterable[bytes],
    requests: Iterable[bytes],
) -> None:
    """Write a recording to `path`, which exists only once complete; raise ConfigError or DiskFull on failure."""
    part = path.with_suffix(".part")
    try:
        with telling(path, _LOST):
            make_private(part)
        with telling(path, _LOST), zipfile.ZipFile(part, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
            archive.writestr(_META, text_of(meta, indent=1))
            for name, lines in ((_EVENTS, events), (_STATES, states), (_REQUESTS, requests)):
                archive.writestr(name, b"".join(line.rstrip(b"\n") + b"\n" for line in lines))
            with archive.open(_CAN, "w", force_zip64=True) as log:
                while chunk := "".join(itertools.islice(can, _CHUNK)):
                    log.write(chunk.encode("ascii"))
            for path_of_eds in _eds_paths(meta):
                if text := _bytes_of(path_of_eds):
                    archive.writestr(_EDS + Path(path_of_eds).name, text)
        with telling(path, _LOST):
            part.rename(path)
    finally:
        part.unlink(missing_ok=True)


def _bytes_of(path: str) -> bytes:
    """Return the content of an EDS file, or b"" if it cannot be read."""
    try:
        return Path(path).read_bytes()
    except OSError:
        return b""


def _eds_paths(meta: FlightMeta) -> set[str]:
    return {node.eds for bus in meta.layout.buses.values() for node in bus.nodes if node.eds}


def _free_path(folder: Path, meta: FlightMeta) -> Path:
    """Return an unused path whose name has the time and the reason, so that sorting by name sorts by time."""
    stamp = time.strftime("%Y-%m-%dT%H-%M-%S", time.localtime(meta.written))
    why = [word[:40] for word in (meta.reason.kind, meta.reason.node) if word]
    words = "-".join(re.sub(r"\W+", "_", word, flags=re.ASCII) for word in why)
    path, number = folder / f"{stamp}-{words}.zip", 1
    while path.exists():
        number += 1
        path = folder / f"{stamp}-{words}-{number}.zip"
    return path


def _forget_oldest(folder: Path) -> None:
    for path in sorted(folder.glob("*.zip"))[:-MAX_FILES]:
        path.unlink(missing_ok=True)


def newest(folder: Path) -> Path | None:
    """Return the newest recording in a folder, or None."""
    return max(folder.glob("*.zip"), default=None)


def is_flight_file(path: Path) -> bool:
    """Whether a path has the suffix of a flight recording, ".zip"."""
    return path.suffix.lower() == ".zip"


def read_flight(path: Path) -> FlightFile:
    """Read a flight recording; raise ConfigError if the file is invalid.

    Log lines that contain no frame are counted in `unread_lines`.
    """
    return _opened(path, _read)


def read_samples(path: Path) -> list[StateSample]:
    """Read the state samples of a recording with all their data; raise ConfigError if the file is invalid."""
    return _opened(path, lambda archive, _meta: _lines(archive, _STATES, StateSample))


def read_meta(path: Path) -> FlightMeta:
    """Read only the metadata of a recording; raise ConfigError if the file is invalid."""
    return _opened(path, lambda _archive, meta: meta)


def _opened(path: Path, read: Callable[[zipfile.ZipFile, FlightMeta], T]) -> T:
    try:
        with zipfile.ZipFile(path) as archive:
            if len(archive.infolist()) > _MAX_MEMBERS:
                raise ConfigError(
                    f"{path}: this is not a flight recording: it contains {len(archive.infolist())} files"
                )
            text = _content(archive, _META)
            file_format = _parsed(_META, text, FlightFormat)
            if (file_format.format, file_format.version) != (FORMAT, VERSION):
                raise ConfigError(f"{path}: this is not a flight recording that this version can read")
            return read(archive, _parsed(_META, text, FlightMeta))
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror or error}") from error
    except FlightFileError as error:
        raise ConfigError(f"{path}: this is not a flight recording, or it is damaged: {error}") from error
    except _UNREADABLE as error:
        raise ConfigError(f"{path}: this is not a flight recording: {error}") from error


def _content(archive: zipfile.ZipFile, name: str) -> bytes:
    """Return a member of the archive; raise FlightFileError if it is larger than a recorder can write."""
    limit = next(size for start, size in _LARGEST.items() if name.startswith(start))
    if archive.getinfo(name).file_size > limit:
        raise _too_large(name, limit)
    content = bytearray()
    with archive.open(name) as member:
        while chunk := member.read(_STEP):
            content += chunk
            if len(content) > limit:
                raise _too_large(name, limit)
    return bytes(content)


def _too_large(name: str, limit: int) -> FlightFileError:
    return FlightFileError(f"{name} is larger than {limit >> 20} MiB, which no recorder writes")


def _parsed(place: str, text: bytes, kind: type[T]) -> T:
    try:
        document: T = decode(text, kind)
    except ValueError as error:
        raise FlightFileError(f"{place}: {error}") from None
    return document


def _lines(archive: zipfile.ZipFile, name: str, kind: type[T]) -> list[T]:
    lines = enumerate(_content(archive, name).splitlines(), 1)
    return [_parsed(f"{name}, line {number}", line, kind) for number, line in lines]


def _states(archive: zipfile.ZipFile) -> list[TimedSnapshot]:
    """Return the samples; if an earlier version wrote the controllers' data in another form, omit that data."""
    samples = _lines(archive, _STATES, TimedSnapshot)  # raises if even these are invalid
    try:
        return list(_lines(archive, _STATES, StateSample))
    except FlightFileError:
        return samples


def _read(archive: zipfile.ZipFile, meta: FlightMeta) -> FlightFile:
    file = FlightFile(meta, _lines(archive, _EVENTS, RobotEvent), _states(archive))
    buses = {interface_name(bus): bus for bus in meta.buses}
    for line in _content(archive, _CAN).decode("ascii", "replace").splitlines():
        parsed = parse_line(line)
        if parsed is None:
            file.unread_lines += 1
        else:
            interface = line.split()[1]
            file.frames.append((parsed[0], buses.get(interface, interface), parsed[1]))
    if _REQUESTS in archive.namelist():
        file.requests += _lines(archive, _REQUESTS, RequestSeen)
    for name in archive.namelist():
        if name.startswith(_EDS) and os.path.basename(name):
            file.eds[os.path.basename(name)] = _content(archive, name)
            if sum(map(len, file.eds.values())) > _MAX_EDS:
                raise _too_large("the content of " + _EDS, _MAX_EDS)
    return file
