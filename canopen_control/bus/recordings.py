"""Recordings of a bus in the formats that others read: .log (candump), .asc and .blf (Vector), .trc (PEAK).

What is written reads back the same, frame for frame; what a format cannot hold is left out and
counted, never bent. candump's format is written and PEAK's read here, the rest is python-can's. Its sqlite format is
not offered: it loses frames at the end. What is text may be packed, with .gz at the end of its name.

A recording that was cut (a full disk, no power) is read up to the cut, and says so.
"""

from __future__ import annotations

import contextlib
import datetime
import gzip
import logging
import math
import re
import struct
import zlib
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
from canopen_control.frame import ERROR_FLAG, EXTENDED_FLAG, REMOTE_FLAG, CanFrame, frames_of
from canopen_control.host.files import failed, make_private

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from types import TracebackType

    import can


# Reading Vector's BLF recordings within bounds: python-can's reader, which believes every length that a file claims.
#
# A header may claim gigabytes, an object may claim to be shorter than its own header (and would
# be read again for ever), and a container may unpack to a thousand times its size. What is read is what is there, and
# what is unpacked is bounded; anything else is said as what is wrong with the file.


# PEAK's trace format, read line by line in its versions 1.0 to 2.1; python-can's writer makes 2.1.
#
# A line is a table row: the version, or the file's own ``$COLUMNS``, says which column is what. Rows of errors become
# error frames in the layout of linux/can/error.h: PEAK gives the kind of error, direction, place (as an SJA1000 codes
# it), receive and transmit counter; changes of the status as bits of PCAN-Basic; or the two counters alone.


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
_LONGEST_STANDARD: Final = 4  # digits of an identifier
_BYTE: Final = re.compile(r"[0-9A-Fa-f]{2}")
_NS_PER_US: Final = 1000

# Rows of errors
_ERROR_TYPES: Final = {"Error", "ER"}
_STATUS_TYPES: Final = {"Warng", "ST"}
_COUNTER_TYPE: Final = "EC"
_STATUS_ID: Final = "FFFFFFFF"  # of version 1.0, which has no types
_VIOLATION: Final = {1: 0x01, 2: 0x02, 4: 0x04}  # bit, form and stuff error: PEAK's and data[2] of an error frame
_SENDING: Final = 0x80
_STATUS: Final = (  # a bit of PCAN-Basic, class, detail of the controller
    (0x00010, BUS_OFF, 0),
    (0x40000, CONTROLLER, PASSIVE),
    (0x00008, CONTROLLER, RX_WARNING | TX_WARNING),
    (0x00004, CONTROLLER, RX_WARNING | TX_WARNING),
    (0x00002, CONTROLLER, RX_OVERFLOW),
)


def read_trc(file: TextIO) -> Iterator[tuple[int, CanFrame] | None]:
    """Yield time in Unix ns and frame of each row, None for one that is no frame of classic CAN.

    EOFError for a last row that is cut. Without a start time the times count from 0.
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
            found = _parsed(text, columns)
            if found is None and not line.endswith("\n"):
                raise EOFError
            yield None if found is None else (round((start + found[0] / 1000) * 1e6) * _NS_PER_US, found[1])


def _start(days: str) -> float:
    """Return the start in Unix seconds, 0 where it is none."""
    try:
        return (_DAY_ZERO + datetime.timedelta(days=float(days))).timestamp()
    except (ValueError, OverflowError):
        return 0.0


def _parsed(text: str, columns: str) -> tuple[float, CanFrame] | None:
    """Return the offset in ms and the frame of a row."""
    words = text.split()
    try:
        offset = float(words[columns.index("O")])
        kind = words[columns.index("T")] if "T" in columns else _kind_of(words, columns)
        if kind in _DATA_TYPES:
            frame = _data_frame(dict(zip(columns, text.split(maxsplit=len(columns) - 1), strict=False)), kind)
        else:
            frame = _report(kind, words, columns)
    except (ValueError, IndexError, KeyError):
        return None
    return None if frame is None or not math.isfinite(offset) else (offset, frame)


def _kind_of(words: list[str], columns: str) -> str:
    """Return the type of a row of version 1.0, in the words of 1.1."""
    if words[columns.index("I")] == _STATUS_ID:
        return "Warng"
    return "Error" if "ERROR" in words else "Rx"


def _data_frame(row: dict[str, str], kind: str) -> CanFrame | None:
    """Return the frame of a row; ValueError, IndexError or KeyError where it is none."""
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


def _report(kind: str, words: list[str], columns: str) -> CanFrame | None:
    """Return the error frame of a row of errors; such rows may lack the columns of identifier and length."""
    direction = next((at for at, word in enumerate(words) if word in ("Rx", "Tx")), columns.find("L"))
    data = bytes(int(word, 16) for word in words[direction + 1 :] if _BYTE.fullmatch(word))
    if kind in _ERROR_TYPES:
        if "d" not in columns:  # up to 1.3 the kind of error is the identifier
            data = bytes((int(words[columns.index("I")], 16) & 0xFF,)) + data
        what, way, place, receive, transmit = data[:5]
        detail = _VIOLATION.get(what, 0) | (0 if way else _SENDING)
        classes = PROTOCOL | BUS_ERROR | COUNTERS
        return CanFrame(ERROR_FLAG | classes, bytes((0, 0, detail, place, 0, 0, transmit, receive)))
    if kind in _STATUS_TYPES and len(data) >= 4:
        status = int.from_bytes(data[:4], "big")
        classes, detail = 0, 0
        for bit, each, more in _STATUS:
            if status & bit:
                classes, detail = classes | each, detail | more
        if not status:
            classes, detail = CONTROLLER, ACTIVE_AGAIN
        return CanFrame(ERROR_FLAG | classes, bytes((0, detail, 0, 0, 0, 0, 0, 0))) if classes else None
    if kind == _COUNTER_TYPE:
        receive, transmit = data[:2]
        return CanFrame(ERROR_FLAG | COUNTERS, bytes((0, 0, 0, 0, 0, 0, transmit, receive)))
    return None


# candump's log format, ``(1700000000.123456) can0 183#3706``, written and read frame by frame.
#
# As can-utils has it: error frames keep their classes and details and remote frames their length, which python-can's
# own writer leaves out.


_STANDARD_DIGITS = 3
_NS = 1_000_000_000
_LONGEST_NAME = 15  # IFNAMSIZ without the zero
_LONGEST_LINE = 4096  # of any that is a frame, by far
_LINE = re.compile(
    r"\((?P<sign>-?)(?P<seconds>\d{1,11})\.(?P<fraction>\d{1,18})\)\s+(?P<channel>\S+)\s+"
    r"(?P<id>[0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})#(?P<data>[Rr]\d?|(?:[0-9A-Fa-f]{2}\.?){0,8})(?:_[9A-Fa-f])?(?P<rest>\s+[RTrt])?\s*"
)


def interface_name(channel: str) -> str:
    """Return a channel as the name of a network interface, which other programs take it for."""
    return re.sub(r"[^A-Za-z0-9_.-]", "_", channel)[:_LONGEST_NAME] or "can0"


def line_of(time_ns: int, channel: str, frame: CanFrame) -> str:
    """Return the line of a frame with its end; `time_ns` in Unix time is cut to microseconds."""
    sign = "-" if time_ns < 0 else ""
    seconds, ns = divmod(abs(time_ns), _NS)
    # of an error frame candump writes the flag too
    text = f"{frame.can_id:08X}#{frame.data.hex().upper()}" if frame.is_error else str(frame)
    return f"({sign}{seconds:010d}.{ns // 1000:06d}) {channel} {text}\n"


def parse_line(line: str) -> tuple[int, CanFrame] | None:
    """Return time and frame of a line; None for what is none: CAN FD, or another format.

    A clock that was set can make times negative. A DLC above 8 (`_9` to `_F`, can-utils 2020 and later) means 8 bytes.
    """
    found = _LINE.fullmatch(line)
    if found is None:
        return None
    time_ns = int(found["seconds"]) * _NS + int(f"{found['fraction']:0<9}"[:9])
    time_ns = -time_ns if found["sign"] else time_ns
    can_id = int(found["id"], 16)
    if len(found["id"]) > _STANDARD_DIGITS and not can_id & ERROR_FLAG:
        can_id = can_id & ~REMOTE_FLAG | EXTENDED_FLAG
    data = found["data"]
    if data[:1] in ("R", "r"):
        return time_ns, CanFrame(can_id | REMOTE_FLAG, bytes(min(int(data[1:] or 0), 8)))
    return time_ns, CanFrame(can_id, bytes.fromhex(data.replace(".", "")))


def read_lines(file: TextIO) -> Iterator[tuple[int, CanFrame] | None]:
    """Yield the frames of a log, None for each line that is none; empty lines do not count."""
    while line := file.readline(_LONGEST_LINE):
        if text := line.strip():
            yield parse_line(text)


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
    """A frame and when it was heard, in Unix ns; a format may keep microseconds only."""

    time_ns: int
    frame: CanFrame


def _asc_writer(path: Path) -> can.io.generic.MessageWriter:
    import can

    class Writer(can.ASCWriter):
        """Writes the milliseconds of its start with three digits: `.5` would be read as half a second."""

        def _format_header_datetime(self, dt: Any) -> str:  # noqa: ANN401 - a datetime
            return str(dt.strftime(self.FORMAT_DATE.format(f"{dt.microsecond // 1000:03d}")))

    return Writer(str(path))


def _blf_writer(path: Path) -> can.io.generic.MessageWriter:
    import can

    return can.BLFWriter(str(path))


def _trc_writer(path: Path) -> can.io.generic.MessageWriter:
    import can

    return can.TRCWriter(str(path))


def _asc_reader(file: Any) -> Any:  # noqa: ANN401 - python-can's readers have no common base with __iter__
    import can

    return can.ASCReader(file, relative_timestamp=False)


def _blf_reader(file: Any) -> Any:  # noqa: ANN401 - as above
    from canopen_control.bus.blf import BlfReader

    return BlfReader(file)


class _Format(NamedTuple):
    """How a format is opened, and what it can hold."""

    writer: Callable[[Path], can.io.generic.MessageWriter] | None  # None: ours
    reader: Callable[[Any], Any] | None  # None: `lines` of ours
    holds: Callable[[CanFrame], bool]
    lines: Callable[[TextIO], Iterator[tuple[int, CanFrame] | None]] = read_lines
    is_text: bool = True


FORMATS = {
    ".log": _Format(None, None, lambda _frame: True),
    ".asc": _Format(
        _asc_writer, _asc_reader, lambda frame: not frame.is_error
    ),  # it keeps no more than that there was one
    ".blf": _Format(_blf_writer, _blf_reader, lambda _frame: True, is_text=False),
    ".trc": _Format(_trc_writer, None, lambda frame: not frame.is_error and not frame.is_remote, read_trc),
}
_PACKED: Final = ".gz"


def format_of(path: str | Path, *, writing: bool = False) -> str:
    """Return the suffix that names the format, without that of a packed one; ConfigError for one not offered."""
    path = Path(path)
    suffix = Path(path.stem).suffix.lower() if _is_packed(path) else path.suffix.lower()
    if suffix not in FORMATS:
        raise ConfigError(
            f"{path}: the end of a recording's name says its format: {', '.join(FORMATS)}, and .gz after it if packed"
        )
    if _is_packed(path) and not FORMATS[suffix].is_text:
        raise ConfigError(f"{path}: a {suffix} is packed by itself; name it without {_PACKED}, and unpack what is not")
    if writing and _is_packed(path) and FORMATS[suffix].writer is not None:
        raise ConfigError(f"{path}: a {suffix} is not written packed; name a .log.gz, or the same without {_PACKED}")
    return suffix


def _is_packed(path: Path) -> bool:
    return path.suffix.lower() == _PACKED


class RecordingWriter:
    """Writes a recording; `written` and `left_out` count frames. Close it, or the last frames are lost.

    A file of that name is replaced; a new one is its user's alone (mode 0600). ConfigError where it cannot be written,
    DiskFull where it cannot be finished: what was written before is kept then, and `written` counts it.
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
        """Append a frame heard at `time_ns` in Unix time; DiskFull where there is no room for it."""
        if not self._format.holds(frame):
            self.left_out += 1
            return
        try:
            if self._text is not None:
                self._text.write(line_of(time_ns, self._channel, frame))
            elif self._messages is not None:
                from canopen_control.bus.pythoncan import message_of

                # whole microseconds: what is a microsecond apart stays apart in a float of Unix time
                self._messages.on_message_received(message_of(frame, time_ns // 1000 / 1_000_000))
        except OSError as error:
            self._fail(error)
        self.written += 1

    def flush(self) -> None:
        """Hand what was written to the operating system, as far as the format allows; DiskFull."""
        file = self._file
        if file is not None and not file.closed:
            try:
                file.flush()
            except OSError as error:
                self._fail(error)

    def close(self) -> None:
        """Finish the file, DiskFull where that cannot be; a second call does nothing."""
        try:
            if self._text is not None:
                self._text.close()
            elif self._messages is not None:
                self._messages.stop()
        except OSError as error:
            self._fail(error)
        self._text = self._messages = None

    @property
    def _file(self) -> Any:  # noqa: ANN401 - text, or whatever python-can writes to
        return self._text if self._text is not None else getattr(self._messages, "file", None)

    def _fail(self, error: OSError) -> NoReturn:
        """Leave the file as it is, count what can be read of it, and raise."""
        file = self._file
        self._text = self._messages = None
        with contextlib.suppress(OSError, AttributeError):
            file.close()
        self.written = sum(1 for each in Recording(self.path))
        raise failed(self.path, error, f"{self.written} frames are in it") from error


class Recording:
    """A recording to be read, any number of times.

    After a reading `skipped` counts what is no frame of classic CAN, and `problem` says why there is not more, if there
    should be.
    ConfigError for a file that is not there, or whose name has another end.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.skipped = 0
        self.problem = ""
        self._ends = False  # whether a reader that failed had come to the end of the file
        self._format = FORMATS[format_of(path)]
        if self.path.is_dir():
            raise ConfigError(f"{path} is a folder, no recording; name one of its files")
        if not self.path.is_file():
            raise ConfigError(f"no recording {path}" if not self.path.exists() else f"{path} is no regular file")

    def __iter__(self) -> Iterator[RecordedFrame]:
        self.skipped, self.problem, self._ends, count = 0, "", False, 0
        try:
            for each in self._lines() if self._format.reader is None else self._messages():
                if each is None:
                    self.skipped += 1
                else:
                    count += 1
                    yield each
            if not count:
                self.problem = f"{self.path}: no frame is in it"
        except OSError as error:
            self.problem = f"{self.path} cannot be read: {error.strerror or error}"
        except Exception as error:  # whatever a parser makes of a file that was cut or is none
            if not isinstance(error, _UNREADABLE) and "Parse" not in type(error).__name__:
                raise
            reason = "it ends in the middle of a frame" if self._ends else str(error) or type(error).__name__
            self.problem = f"{self.path} cannot be read on after {count} frames: {reason}"

    def _lines(self) -> Iterator[RecordedFrame | None]:
        with self._open() as file:
            try:
                for each in self._format.lines(file):
                    yield None if each is None else RecordedFrame(*each)
            except EOFError:
                self._ends = not _is_packed(self.path)
                raise

    def _open(self) -> Any:  # noqa: ANN401 - text or bytes
        if _is_packed(self.path):
            return _open_packed(self.path, "rt")
        return self.path.open(encoding="utf-8", errors="replace") if self._format.is_text else self.path.open("rb")

    def _messages(self) -> Iterator[RecordedFrame | None]:
        from canopen_control.bus.pythoncan import record_of

        for name in ("can.io.asc", "can.io.blf"):
            logging.getLogger(name).setLevel(logging.ERROR)  # what it skips is counted here
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
                        yield RecordedFrame(round(message.timestamp * 1e6) * 1000, frame)
            except _UNREADABLE as error:  # the reader of .blf says itself when it misses something
                self._ends = isinstance(error, (EOFError, struct.error)) if binary else not file.read(1)
                raise
            if getattr(reader, "file_size", 0) > self.path.stat().st_size:  # a .blf says how long it was meant to be
                self._ends = True
                raise EOFError


def _open_packed(path: Path, mode: str) -> TextIO:
    found: Any = gzip.open(path, mode, encoding="utf-8", errors="replace")  # noqa: SIM115 - the caller closes it
    text: TextIO = found
    return text
