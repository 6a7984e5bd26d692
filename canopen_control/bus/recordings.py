"""Recordings of a bus in the formats that others read: .log (candump), .asc and .blf (Vector), .trc (PEAK).

The law of this file: what is written reads back the same, frame for frame; what a format cannot hold is left out and
counted, never bent. candump's format is written and PEAK's read here, the rest is python-can's. Its sqlite format is
not offered: it loses frames at the end. What is text may be packed, with .gz at the end of its name.

A recording that was cut (a full disk, no power) is read up to the cut, and says so.
"""

from __future__ import annotations

import contextlib
import gzip
import logging
import struct
import zlib
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple, NoReturn, TextIO

from canopen_control.bus.candump import interface_name, line_of, read_lines
from canopen_control.bus.trc import read_trc
from canopen_control.errors import ConfigError
from canopen_control.frame import CanFrame, frames_of
from canopen_control.host.files import failed, make_private

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from types import TracebackType

    import can

__all__ = ["FORMATS", "RecordedFrame", "Recording", "RecordingWriter", "format_of"]

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
