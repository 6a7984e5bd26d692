"""A blocking client of a server of JSON lines, for scripts, threads and the command line."""

from __future__ import annotations

import contextlib
import time
from typing import TYPE_CHECKING, Final

from canopen_control.errors import LocalProtocolError, RemoteError
from canopen_control.host import sockets
from canopen_control.host.lines import MAX_LINE, LineBuffer, Message, decode, encode_strict

if TYPE_CHECKING:
    from pathlib import Path

__all__ = ["LineClient"]

_CHUNK: Final = 1 << 16


class LineClient:
    """A blocking connection to a `LineServer`, for one thread.

    RemoteError of kind "BusClosed" when the other side is gone, "Timeout" when it takes too long, "RemoteProtocolError"
    when it talks nonsense. `label` names the other side in those sentences.
    """

    def __init__(self, path: Path, timeout: float = 5.0, *, label: str = "") -> None:
        self.label = label or path.stem
        self._input = LineBuffer()
        try:
            self._socket = sockets.connect(path, timeout)
        except (FileNotFoundError, ConnectionRefusedError):
            raise RemoteError("BusClosed", f"{self.label} is not running (nobody listens at {path})") from None
        except OSError as error:
            raise RemoteError("BusClosed", f"{self.label} cannot be reached: {error}") from error

    def fileno(self) -> int:
        """Return the descriptor, readable when `receive` may find something; -1 once it is closed."""
        return self._socket.fileno()

    def send(self, message: Message, timeout: float = 5.0) -> None:
        """Send a message; LocalProtocolError when it holds a number that is not finite."""
        try:
            line = encode_strict(message)
        except ValueError as error:
            raise LocalProtocolError(f"cannot be sent to {self.label}: {error}") from error
        try:
            self._socket.settimeout(timeout)
            self._socket.sendall(line)
        except TimeoutError:
            self.close()  # part of the line may have left: whatever followed would be garbage
            raise RemoteError("Timeout", f"{self.label} has not read for {timeout:g} s; does it hang?") from None
        except OSError as error:
            raise self._gone() from error

    def receive(self, timeout: float | None = 5.0) -> Message | None:
        """Return the next message, or None when none came within `timeout` seconds; 0 only looks, None waits."""
        deadline = None if timeout is None else time.monotonic() + timeout
        while (line := self._input.next_line()) is None:
            left = None if deadline is None else max(deadline - time.monotonic(), 0)
            data = self._recv(left)
            if data is None:
                return None
            self._input.feed(data)
            if self._input.overflow:
                raise RemoteError("RemoteProtocolError", f"{self.label} sent a line longer than {MAX_LINE} bytes")
        try:
            return decode(line)
        except ValueError as error:
            raise RemoteError("RemoteProtocolError", f"{self.label} sent garbage: {error}") from error

    def _recv(self, timeout: float | None) -> bytes | None:
        try:
            self._socket.settimeout(timeout)
            data = self._socket.recv(_CHUNK)
        except (TimeoutError, BlockingIOError):
            return None
        except OSError as error:
            raise self._gone() from error
        if not data:
            raise self._gone()
        return data

    def _gone(self) -> RemoteError:
        return RemoteError("BusClosed", f"{self.label} has closed the connection; it was shut down or has died")

    def close(self) -> None:
        """Close; a second close is a no-op."""
        with contextlib.suppress(OSError):
            self._socket.close()
