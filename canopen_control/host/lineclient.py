"""Blocking client of a line server, for scripts, threads and the command line; and a splitter of byte streams."""

from __future__ import annotations

import contextlib
import select
import socket
import time

from canopen_control.errors import LocalProtocolError, RemoteError
from canopen_control.host import sockets

TYPE_CHECKING = False  # the module typing takes longer to import than this one
if TYPE_CHECKING:
    from pathlib import Path
    from types import TracebackType
    from typing import Final


# A line ends with a newline. An answer has at most 1 MiB, a request 64 KiB and 4096 values, because processing it must
# not block other work.


MAX_LINE: Final = 1 << 20
MAX_REQUEST: Final = 1 << 16
MAX_VALUES: Final = 4096  # maximum number of values in a request: the decoding time depends on values, not on bytes
_COSTLY: Final = b",[{\\"  # every value, or escaped letter, that takes time contains one of these


def too_many_values(line: bytes) -> bool:
    """Whether a line of JSON has more than `MAX_VALUES` values, estimated without decoding it."""
    return sum(map(line.count, _COSTLY)) > MAX_VALUES


class LineBuffer:
    """Splitter of a byte stream into lines, no matter how the stream is divided into pieces.

    `overflow` becomes True when a line is longer than `limit` bytes; no line is returned after that.
    """

    __slots__ = ("_data", "_limit", "_searched", "overflow")

    def __init__(self, limit: int = MAX_LINE) -> None:
        self._data = bytearray()
        self._searched = 0  # there is no newline before this position
        self._limit = limit
        self.overflow = False

    def feed(self, data: bytes) -> None:
        if not self.overflow:
            self._data += data

    def next_line(self) -> bytes | None:
        """Return the next line without its newline, or None if no line is complete; empty lines are skipped."""
        if self.overflow:
            return None
        data = self._data
        if self._searched == 0 and data[:1].isspace():
            del data[: len(data) - len(data.lstrip())]  # removes all empty lines at once
        end = data.find(b"\n", self._searched)
        length = len(data) if end < 0 else end
        if length > self._limit:
            self.overflow = True
            data.clear()
            return None
        if end < 0:
            self._searched = length
            return None
        line = bytes(data[:end])
        del data[: end + 1]
        self._searched = 0
        return line


_CHUNK: Final = 1 << 16


class LineClient:
    """Connection to a `LineServer` with blocking methods; one thread may send while another receives.

    RemoteError is raised with kind "BusClosed" when the server is gone, "Timeout" when the server takes too long, and
    "RemoteProtocolError" when a line is too long. `label` names the server in messages. Times are in s.
    """

    def __init__(self, path: Path, timeout: float = 5.0, *, label: str = "") -> None:
        self.label = label or path.stem
        self._input = LineBuffer()
        try:
            self._socket = sockets.connect(path, timeout)
        except (FileNotFoundError, ConnectionRefusedError):
            raise RemoteError("BusClosed", f"{self.label} is not running (no program listens at {path})") from None
        except OSError as error:
            raise RemoteError("BusClosed", f"{self.label} cannot be reached: {error}") from error
        # poll() waits, because a socket timeout applies to both directions.
        self._socket.setblocking(False)

    def __enter__(self) -> LineClient:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self.close()

    def fileno(self) -> int:
        """Return the descriptor, which is readable when `receive` may return a line, or -1 after `close`."""
        return self._socket.fileno()

    def send(self, line: bytes, timeout: float = 5.0) -> None:
        """Send a line that ends with a newline; raise LocalProtocolError if the line is too long."""
        if len(line) > MAX_REQUEST:
            raise LocalProtocolError(f"request to {self.label} too long: {len(line)} bytes, more than {MAX_REQUEST}")
        deadline = time.monotonic() + timeout
        remaining = memoryview(line)
        while remaining:
            sent = self._write(remaining)
            remaining = remaining[sent:]
            if not sent and not self._poll(select.POLLOUT, deadline):
                self.hang_up()  # part of the line may have been sent, so that the stream is unusable
                raise RemoteError(
                    "Timeout", f"{self.label} has not read for {timeout:g} s; check whether it is stopped or blocked"
                )

    def receive(self, timeout: float | None = 5.0) -> bytes | None:
        """Return the next line without its newline, or None if no line arrived within `timeout` s.

        With 0 the method does not wait, with None it waits without limit.
        """
        deadline = None if timeout is None else time.monotonic() + timeout
        while (line := self._input.next_line()) is None:
            if self._input.overflow:
                raise RemoteError("RemoteProtocolError", f"{self.label} sent a line longer than {MAX_LINE} bytes")
            data = self._read()
            if data is not None:
                self._input.feed(data)
            elif not self._poll(select.POLLIN, deadline):
                return None
        return line

    def hang_up(self) -> None:
        """Shut the connection down in both directions, which ends a `receive` waiting in another thread."""
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        self._socket.close()

    def _write(self, data: memoryview) -> int:
        try:
            return self._socket.send(data)
        except BlockingIOError:
            return 0
        except OSError as error:
            raise self._closed_error() from error

    def _read(self) -> bytes | None:
        try:
            data = self._socket.recv(_CHUNK)
        except BlockingIOError:
            return None
        except OSError as error:
            raise self._closed_error() from error
        if not data:
            raise self._closed_error()
        return data

    def _poll(self, event: int, deadline: float | None) -> bool:
        """Wait until the socket is ready for `event`; return False after the deadline."""
        if self._socket.fileno() < 0:
            raise self._closed_error()
        poll = select.poll()
        poll.register(self._socket, event)
        wait_ms = None if deadline is None else max(deadline - time.monotonic(), 0) * 1000
        return bool(poll.poll(wait_ms))

    def _closed_error(self) -> RemoteError:
        return RemoteError("BusClosed", f"{self.label} has closed the connection; it was shut down or killed")
