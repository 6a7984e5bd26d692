"""Recordings of a bus in common formats: .log (candump), .asc and .blf (Vector), .trc (PEAK), and their replay.

Written files read back identically, frame for frame; frames that a format cannot represent are omitted and counted.
candump's format is written and PEAK's format read here, the others by python-can. Its sqlite format is not offered,
because it loses frames at the end. Text formats may be compressed, with .gz at the end of the name.

A truncated recording (disk full, power lost) is read up to the truncation, and this is reported.

A replay keeps the original timing: its deadlines are absolute, so that a late frame does not delay the next one. Error
frames are skipped, because nodes cannot send them.
"""

from __future__ import annotations

import contextlib
import datetime
import math
import re
import select
import shlex
import struct
import time
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple, NoReturn, TextIO

from canopen_control.bus.error_frames import (
    ACTIVE_AGAIN,
    BUS_ERROR,
    BUS_OFF,
    CONTROLLER,
    COUNTERS,
    PASSIVE,
    PROTOCOL,
    RX_OVERFLOW,
    RX_WARNING,
    TX_WARNING,
)
from canopen_control.errors import ConfigError
from canopen_control.frame import ERROR_FLAG, EXTENDED_FLAG, REMOTE_FLAG, CanFrame, frames_of, pack_records
from canopen_control.host.files import failed, make_private

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator
    from types import TracebackType

    import can

    from canopen_control.bus.port import Port


# PEAK's trace format, versions 1.0 to 2.1; python-can's writer creates 2.1. A line is a table row; the version, or the
# file's own ``$COLUMNS``, defines the columns. Rows of errors become error frames in the layout of linux/can/error.h:
# PEAK gives the kind of error, direction, position (with the codes of an SJA1000), receive and transmit counter; status
# changes as bits of PCAN-Basic; or only the two counters.


_COLUMNS: Final = {  # N number, O offset in ms, T type, B bus, I identifier, d direction, R reserved, L length, D data
    "1.0": "NOILD",
    "1.1": "NOTILD",
    "1.2": "NOBTILD",
    "1.3": "NOBTIRLD",
    "2.0": "NOTIdlD",
    "2.1": "NOTBIdRLD",
}
_DAY_ZERO: Final = datetime.datetime(1899, 12, 30, tzinfo=datetime.UTC)
_DATA_TYPES: Final = {"Rx", "Tx", "DT", "RR"}
_REMOTE_TYPE: Final = "RR"
_LONGEST_STANDARD: Final = 4  # length of a standard identifier in digits
_BYTE: Final = re.compile(r"[0-9A-Fa-f]{2}")
_NS_PER_US: Final = 1000

# rows of errors
_ERROR_TYPES: Final = {"Error", "ER"}
_STATUS_TYPES: Final = {"Warng", "ST"}
_COUNTER_TYPE: Final = "EC"
_STATUS_ID: Final = "FFFFFFFF"  # in version 1.0, which has no types
_VIOLATION: Final = {1: 0x01, 2: 0x02, 4: 0x04}  # bit, form and stuff error: PEAK's code and data[2] of an error frame
_SENDING: Final = 0x80
_STATUS: Final = (  # bit of PCAN-Basic, error class, controller detail
    (0x00010, BUS_OFF, 0),
    (0x40000, CONTROLLER, PASSIVE),
    (0x00008, CONTROLLER, RX_WARNING | TX_WARNING),
    (0x00004, CONTROLLER, RX_WARNING | TX_WARNING),
    (0x00002, CONTROLLER, RX_OVERFLOW),
)


def read_trc(file: TextIO, buses: set[str]) -> Iterator[tuple[int, CanFrame] | None]:
    """Yield the Unix time in ns and the frame of each row of a PEAK trace; None for rows without a classic frame.

    The bus numbers of the frames are added to `buses`. Raise EOFError for a truncated last row. Without a start time
    the times begin at 0.
    """
    columns, start = _COLUMNS["1.0"], 0.0
    for line in file:
        text = line.strip()
        if text.startswith(";"):
            name, _, value = text.partition("=")
            if name == ";$FILEVERSION":
                columns = _COLUMNS.get(value.strip(), columns)
            elif name == ";$COLUMNS":
                columns = value.replace(",", "").strip()
            elif name == ";$STARTTIME":
                start = _start(value)
        elif text:
            row = _parsed(text, columns)
            if row is None and not line.endswith("\n"):
                raise EOFError
            if row is not None and "B" in columns:
                buses.add(text.split(maxsplit=len(columns) - 1)[columns.index("B")])
            yield None if row is None else (round((start + row[0] / 1000) * 1e6) * _NS_PER_US, row[1])


def _start(days: str) -> float:
    """Return the start time in Unix s of a day number; 0 if it is invalid."""
    try:
        return (_DAY_ZERO + datetime.timedelta(days=float(days))).timestamp()
    except (ValueError, OverflowError):
        return 0.0


def _parsed(text: str, columns: str) -> tuple[float, CanFrame] | None:
    """Return the offset in ms and the frame of a row; None if the row has no valid frame."""
    words = text.split()
    try:
        offset = float(words[columns.index("O")])
        kind = words[columns.index("T")] if "T" in columns else _kind_of(words, columns)
        if kind in _DATA_TYPES:
            frame = _data_frame(dict(zip(columns, text.split(maxsplit=len(columns) - 1), strict=False)), kind)
        else:
            frame = _error_frame(kind, words, columns)
    except (ValueError, IndexError, KeyError):
        return None
    return None if frame is None or not math.isfinite(offset) else (offset, frame)


def _kind_of(words: list[str], columns: str) -> str:
    """Return the type of a row of version 1.0, named as in version 1.1."""
    if words[columns.index("I")] == _STATUS_ID:
        return "Warng"
    return "Error" if "ERROR" in words else "Rx"


def _data_frame(row: dict[str, str], kind: str) -> CanFrame | None:
    """Return the data or remote frame of a row; return None, or raise an exception, if the row is malformed."""
    identifier = row["I"]
    can_id = int(identifier, 16) | (EXTENDED_FLAG if len(identifier) > _LONGEST_STANDARD else 0)
    length = int(row["L"] if "L" in row else row["l"])
    words = row.get("D", "").split()
    if can_id & 0x1FFFFFFF > (0x1FFFFFFF if can_id & EXTENDED_FLAG else 0x7FF) or not 0 <= length <= 15:
        return None
    length = min(length, 8)
    if kind == _REMOTE_TYPE or words[:1] == ["RTR"]:
        return CanFrame(can_id | REMOTE_FLAG, bytes(length))
    if len(words) < length:
        raise IndexError
    return CanFrame(can_id, bytes(int(word, 16) for word in words[:length]))


def _error_frame(kind: str, words: list[str], columns: str) -> CanFrame | None:
    """Return the error frame of an error row, whose identifier and length may be missing; None for other rows."""
    direction = next((at for at, word in enumerate(words) if word in ("Rx", "Tx")), columns.find("L"))
    data = bytes(int(word, 16) for word in words[direction + 1 :] if _BYTE.fullmatch(word))
    if kind in _ERROR_TYPES:
        if "d" not in columns:  # up to version 1.3 the kind of error is in the identifier
            data = bytes((int(words[columns.index("I")], 16) & 0xFF,)) + data
        kind_code, way, place, receive, transmit = data[:5]
        detail = _VIOLATION.get(kind_code, 0) | (0 if way else _SENDING)
        classes = PROTOCOL | BUS_ERROR | COUNTERS
        return CanFrame(ERROR_FLAG | classes, bytes((0, 0, detail, place, 0, 0, transmit, receive)))
    if kind in _STATUS_TYPES and len(data) >= 4:
        status = int.from_bytes(data[:4], "big")
        classes, detail = 0, 0
        for bit, error_class, more in _STATUS:
            if status & bit:
                classes, detail = classes | error_class, detail | more
        if not status:
            classes, detail = CONTROLLER, ACTIVE_AGAIN
        return CanFrame(ERROR_FLAG | classes, bytes((0, detail, 0, 0, 0, 0, 0, 0))) if classes else None
    if kind == _COUNTER_TYPE:
        receive, transmit = data[:2]
        return CanFrame(ERROR_FLAG | COUNTERS, bytes((0, 0, 0, 0, 0, 0, transmit, receive)))
    return None


# candump's log format, ``(1700000000.123456) can0 183#3706``, as in can-utils: error frames keep their classes and
# details and remote frames their length, which python-can's own writer omits.


_STANDARD_DIGITS = 3
_NS = 1_000_000_000
_LONGEST_NAME = 15  # Linux: IFNAMSIZ without the terminating zero
_LONGEST_LINE = 4096  # longer than any valid line
_LINE = re.compile(
    r"\((?P<sign>-?)(?P<seconds>\d{1,11})\.(?P<fraction>\d{1,18})\)\s+(?P<channel>\S+)\s+"
    r"(?P<id>[0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})#(?P<data>[Rr]\d?|(?:[0-9A-Fa-f]{2}\.?){0,8})(?:_[9A-Fa-f])?(?P<rest>\s+[RTrt])?\s*"
)


def interface_name(channel: str) -> str:
    """Convert a channel name to a valid network interface name, for other programs."""
    return re.sub(r"[^A-Za-z0-9_.-]", "_", channel)[:_LONGEST_NAME] or "can0"


def line_of(time_ns: int, channel: str, frame: CanFrame) -> str:
    """Return the candump line of a frame, with line end; `time_ns` is Unix time, truncated to us."""
    sign = "-" if time_ns < 0 else ""
    seconds, ns = divmod(abs(time_ns), _NS)
    # candump writes the flag of an error frame too
    text = f"{frame.can_id:08X}#{frame.data.hex().upper()}" if frame.is_error else str(frame)
    return f"({sign}{seconds:010d}.{ns // 1000:06d}) {channel} {text}\n"


def parse_line(line: str) -> tuple[int, CanFrame] | None:
    """Return the time in Unix ns and the frame of a candump line; None for CAN FD and other formats.

    A clock that was set can cause negative times. A DLC above 8 (`_9` to `_F`, can-utils 2020 and later) means 8 bytes.
    """
    match = _LINE.fullmatch(line)
    if match is None:
        return None
    time_ns = int(match["seconds"]) * _NS + int(f"{match['fraction']:0<9}"[:9])
    time_ns = -time_ns if match["sign"] else time_ns
    can_id = int(match["id"], 16)
    if len(match["id"]) > _STANDARD_DIGITS and not can_id & ERROR_FLAG:
        can_id = can_id & ~REMOTE_FLAG | EXTENDED_FLAG
    data = match["data"]
    if data[:1] in ("R", "r"):
        return time_ns, CanFrame(can_id | REMOTE_FLAG, bytes(min(int(data[1:] or 0), 8)))
    return time_ns, CanFrame(can_id, bytes.fromhex(data.replace(".", "")))


def read_lines(file: TextIO, buses: set[str]) -> Iterator[tuple[int, CanFrame] | None]:
    """Yield the time and frame of each candump line, or None for a line without a frame; skip empty lines.

    The interfaces of the frames are added to `buses`.
    """
    while line := file.readline(_LONGEST_LINE):
        if text := line.strip():
            parsed = parse_line(text)
            if parsed is not None:
                buses.add(text.split(maxsplit=2)[1])
            yield parsed


_ASC_HEADER_LINES: Final = 20  # `date` and `base` are the first lines, after comments
_ASC_RELATIVE: Final = re.compile(r"\s*base\s+(?:hex|dec)\s+timestamps\s+relative", re.IGNORECASE)
_ASC_EVENT: Final = re.compile(r"\s*(\d+\.\d+)(?=\s)")

_UNREADABLE = (
    EOFError,
    ValueError,
    IndexError,
    KeyError,
    struct.error,
    zlib.error,
    TypeError,
    OverflowError,
    ArithmeticError,
    MemoryError,
)


class RecordedFrame(NamedTuple):
    """Recorded frame, and its time in Unix ns, which some formats store in whole microseconds."""

    time_ns: int
    frame: CanFrame


def _asc_writer(path: Path) -> can.io.generic.MessageWriter:
    import can

    class Writer(can.ASCWriter):
        """ASC writer whose dates are the start of the measurement, with three digits for the milliseconds.

        Readers take `.5` for half a second. Some take `date` for the time 0 of the rows (asc2log of can-utils), others
        the date of the trigger block (python-can), which is the time of the first frame.
        """

        def _format_header_datetime(self, dt: Any) -> str:  # noqa: ANN401 - a datetime
            return str(dt.strftime(self.FORMAT_DATE.format(f"{dt.microsecond // 1000:03d}")))

        def log_event(self, message: str, timestamp: float | None = None) -> None:
            if not self.header_written:
                start = datetime.datetime.fromtimestamp(timestamp or 0.0)  # noqa: DTZ006 - ASC has local times
                self.file.seek(0)
                self.file.truncate()
                self.file.write(f"date {self._format_header_datetime(start)}\n")
                self.file.write("base hex  timestamps absolute\ninternal events logged\n")
            super().log_event(message, timestamp)

    return Writer(str(path))


def _blf_writer(path: Path) -> can.io.generic.MessageWriter:
    import can

    return can.BLFWriter(str(path))


def _trc_writer(path: Path) -> can.io.generic.MessageWriter:
    import can

    return can.TRCWriter(str(path))


class _TimesFromStart:
    """Lines of an ASC file with `timestamps relative`, with the time of each since the start of the measurement.

    In such a file each time is that since the event before, whatever its kind; python-can reads all times as absolute.
    """

    def __init__(self, lines: Iterable[str]) -> None:
        self._lines = iter(lines)
        self._elapsed_ns = 0

    def __iter__(self) -> _TimesFromStart:
        return self

    def __next__(self) -> str:
        line = next(self._lines)
        if match := _ASC_EVENT.match(line):
            self._elapsed_ns += round(float(match[1]) * _NS)
            return f"{self._elapsed_ns / _NS:.9f}{line[match.end() :]}"
        if line.lower().startswith("begin triggerblock"):
            self._elapsed_ns = 0
        return line

    def close(self) -> None:
        """Do nothing: the file belongs to the caller."""


def _asc_reader(file: Any) -> Any:  # noqa: ANN401 - python-can's readers have no common base with __iter__
    import can

    head = [file.readline(_LONGEST_LINE) for _ in range(_ASC_HEADER_LINES)]
    file.seek(0)
    is_relative = any(_ASC_RELATIVE.match(line) for line in head)
    lines: Any = _TimesFromStart(file) if is_relative else file
    return can.ASCReader(lines, relative_timestamp=False)


def _blf_reader(file: Any) -> Any:  # noqa: ANN401 - as above
    from canopen_control.bus.pythoncan import BlfReader

    return BlfReader(file)


class _Format(NamedTuple):
    writer: Callable[[Path], can.io.generic.MessageWriter] | None  # None: written here
    reader: Callable[[Any], Any] | None  # None: `lines`, read here
    holds: Callable[[CanFrame], bool]
    lines: Callable[[TextIO, set[str]], Iterator[tuple[int, CanFrame] | None]] = read_lines
    is_text: bool = True


FORMATS = {
    ".log": _Format(None, None, lambda _frame: True),
    ".asc": _Format(
        _asc_writer, _asc_reader, lambda frame: not frame.is_error
    ),  # it stores only that there was an error
    ".blf": _Format(_blf_writer, _blf_reader, lambda _frame: True, is_text=False),
    ".trc": _Format(_trc_writer, None, lambda frame: not frame.is_error and not frame.is_remote, read_trc),
}
_PACKED: Final = ".gz"


def format_of(path: str | Path, *, writing: bool = False) -> str:
    """Return the suffix of a recording's format, without .gz; raise ConfigError for an unsupported format."""
    path = Path(path)
    suffix = Path(path.stem).suffix.lower() if _is_packed(path) else path.suffix.lower()
    if suffix not in FORMATS:
        raise ConfigError(
            f"{path}: unknown recording format; the name ends with {', '.join(FORMATS)}, and {_PACKED} if compressed"
        )
    if _is_packed(path) and not FORMATS[suffix].is_text:
        raise ConfigError(f"{path}: {suffix} files are compressed already; use a name without {_PACKED}")
    if writing and _is_packed(path) and FORMATS[suffix].writer is not None:
        raise ConfigError(
            f"{path}: {suffix} files cannot be written compressed; use .log.gz, or a name without {_PACKED}"
        )
    return suffix


def _is_packed(path: Path) -> bool:
    return path.suffix.lower() == _PACKED


class RecordingWriter:
    """Writer of a recording; `written` and `left_out` count frames. Without `close`, the last frames may be lost.

    An existing file is replaced; a new one is accessible to its user only (mode 0600). Raise ConfigError if it
    cannot be written, DiskFull if it cannot be completed: the frames written so far are kept and counted in `written`.
    """

    def __init__(self, path: str | Path, channel: str = "") -> None:
        self.path = Path(path)
        self.written = 0
        self.left_out = 0
        self._channel = interface_name(channel)
        self._format = FORMATS[format_of(path, writing=True)]
        self._text: TextIO | None = None
        self._messages: can.io.generic.MessageWriter | None = None
        try:
            make_private(self.path)
            if self._format.writer is None:
                self._text = (
                    _open_packed(self.path, "wt") if _is_packed(self.path) else self.path.open("w", encoding="ascii")
                )
            else:
                self._messages = self._format.writer(self.path)
        except OSError as error:
            raise failed(path, error, "nothing was written") from error

    def __enter__(self) -> RecordingWriter:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self.close()

    def write(self, time_ns: int, frame: CanFrame) -> None:
        """Append a frame with its Unix time in ns; raise DiskFull if the disk is full."""
        if not self._format.holds(frame):
            self.left_out += 1
            return
        try:
            if self._text is not None:
                self._text.write(line_of(time_ns, self._channel, frame))
            elif self._messages is not None:
                from canopen_control.bus.pythoncan import message_of

                # whole microseconds, so that frames 1 us apart remain apart in a float of Unix time
                self._messages.on_message_received(message_of(frame, time_ns // 1000 / 1_000_000))
        except OSError as error:
            self._fail(error)
        self.written += 1

    def flush(self) -> None:
        """Pass the written frames to the operating system, if the format allows it.

        Raise DiskFull if the disk is full.
        """
        file = self._file
        if file is not None and not file.closed:
            try:
                file.flush()
            except OSError as error:
                self._fail(error)

    def close(self) -> None:
        """Complete the file; raise DiskFull if that fails. A second call does nothing."""
        try:
            if self._text is not None:
                self._text.close()
            elif self._messages is not None:
                self._messages.stop()
        except OSError as error:
            self._fail(error)
        self._text = self._messages = None

    @property
    def _file(self) -> Any:  # noqa: ANN401 - a path, or any file object that python-can accepts
        return self._text if self._text is not None else getattr(self._messages, "file", None)

    def _fail(self, error: OSError) -> NoReturn:
        """Keep the file, count the frames that can be read from it, and raise DiskFull."""
        file = self._file
        self._text = self._messages = None
        with contextlib.suppress(OSError, AttributeError):
            file.close()
        self.written = sum(1 for _frame in Recording(self.path))
        raise failed(self.path, error, f"it contains {self.written} frames") from error


class Recording:
    """Recording that can be read any number of times.

    After reading, `skipped` counts rows without a classic CAN frame, and `problem` is the reason why reading
    stopped early or found no frames, or "". Raise ConfigError for a missing file or an unknown suffix.

    `buses` are the interfaces (.log), channels (.asc, .blf) or bus numbers (.trc) of the frames read. Frames of several
    buses are read as those of one; `mixture` says so.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.buses: set[str] = set()
        self.skipped = 0
        self.problem = ""
        self._ends = False  # whether a reader that failed had reached the end of the file
        self._format = FORMATS[format_of(path)]
        if self.path.is_dir():
            raise ConfigError(f"{path} is a folder; name a recording in it")
        if not self.path.is_file():
            raise ConfigError(
                f"recording {path} does not exist" if not self.path.exists() else f"{path} is not a regular file"
            )

    @property
    def mixture(self) -> str:
        """Sentence about the frames of several buses that were read, or ""."""
        if len(self.buses) < 2:
            return ""
        names = sorted(self.buses)
        text = f"{self.path} contains the frames of {len(names)} buses ({', '.join(names)}); keep those of one"
        if self._format.reader is not None or self._format.lines is not read_lines:
            return text
        grep, path = "zgrep" if _is_packed(self.path) else "grep", shlex.quote(str(self.path))
        return f"{text}: {grep} ' {names[0]} ' {path} > {names[0]}.log"

    def __iter__(self) -> Iterator[RecordedFrame]:
        self.skipped, self.problem, self._ends, count = 0, "", False, 0
        try:
            for frame in self._lines() if self._format.reader is None else self._messages():
                if frame is None:
                    self.skipped += 1
                else:
                    count += 1
                    yield frame
            if not count:
                self.problem = f"{self.path}: contains no frames"
        except OSError as error:
            self.problem = f"{self.path} cannot be read: {error.strerror or error}"
        except Exception as error:  # parsers raise exceptions of any class for a truncated or invalid file
            if not isinstance(error, _UNREADABLE) and "Parse" not in type(error).__name__:
                raise
            reason = "the file ends in the middle of a frame" if self._ends else str(error) or type(error).__name__
            self.problem = f"{self.path}: reading stopped after {count} frames: {reason}"

    def _lines(self) -> Iterator[RecordedFrame | None]:
        with self._open() as file:
            try:
                for frame in self._format.lines(file, self.buses):
                    yield None if frame is None else RecordedFrame(*frame)
            except EOFError:
                self._ends = not _is_packed(self.path)
                raise

    def _open(self) -> Any:  # noqa: ANN401 - text or bytes
        if _is_packed(self.path):
            return _open_packed(self.path, "rt")
        return self.path.open(encoding="utf-8", errors="replace") if self._format.is_text else self.path.open("rb")

    def _messages(self) -> Iterator[RecordedFrame | None]:
        import logging  # python-can has it; a flight recorder needs none

        from canopen_control.bus.pythoncan import record_of

        for name in ("can.io.asc", "can.io.blf"):
            logging.getLogger(name).setLevel(logging.ERROR)  # the rows that it skips are counted here
        if self._format.reader is None:
            return
        binary = not self._format.is_text
        with self._open() as file:
            reader = None
            try:
                reader = self._format.reader(file)
                for message in reader:
                    record = record_of(message)
                    if record is None:
                        yield None
                    else:
                        (frame,) = frames_of(record)
                        if message.channel is not None:
                            self.buses.add(str(message.channel + 1))  # python-can counts from 0, the files from 1
                        yield RecordedFrame(round(message.timestamp * 1e6) * 1000, frame)
            except _UNREADABLE as error:  # the reader of .blf reports missing data itself
                self._ends = isinstance(error, (EOFError, struct.error)) if binary else not file.read(1)
                raise
            if getattr(reader, "file_size", 0) > self.path.stat().st_size:  # a .blf file contains its intended size
                self._ends = True
                raise EOFError


def _open_packed(path: Path, mode: str) -> TextIO:
    import gzip  # few files are packed, and every start of a flight recorder imports this module

    file: Any = gzip.open(path, mode, encoding="utf-8", errors="replace")  # noqa: SIM115 - the caller closes it
    text: TextIO = file
    return text


_LAST_FRAMES_S = 2.0
_TRY_S = 0.1


@dataclass(slots=True)
class PlayReport:
    """Result of a replay; `errors` is the number of skipped error frames, `late_max` the maximum delay in s."""

    frames: int = 0
    errors: int = 0
    late_max: float = 0.0


def play(
    frames: Iterable[RecordedFrame],
    port: Port,
    played: PlayReport,
    *,
    speed: float = 1.0,
    clock: Callable[[], int] = time.monotonic_ns,
    sleep: Callable[[float], None] = time.sleep,
) -> None:
    """Send `frames` at `speed` times the recorded rate; `played` counts them, even if the call is interrupted.

    A time before the previous one (the clock was set back) counts as no delay. Raise BusClosed when the bus is gone.
    """
    begin, newest = clock(), 0
    first: int | None = None
    for recorded in frames:
        if recorded.frame.is_error:
            played.errors += 1
            continue
        first = recorded.time_ns if first is None else first
        newest = max(newest, recorded.time_ns - first)
        send_at = begin + round(newest / speed)
        late = clock() - send_at
        if late < 0:
            sleep(-late / _NS)
            late = clock() - send_at
        played.late_max = max(played.late_max, late / _NS)
        port.receive()  # received frames are discarded
        port.send(pack_records([recorded.frame]))
        _flush(port, 0.0)
        played.frames += 1
    _flush(port, _LAST_FRAMES_S)


def _flush(port: Port, seconds: float) -> None:
    end = time.monotonic() + seconds
    while port.wants_write:
        port.flush()
        remaining = end - time.monotonic()
        if remaining <= 0.0:
            return
        select.select([], [port.fileno()], [], min(remaining, _TRY_S))
