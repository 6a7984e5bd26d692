"""A file descriptor that is readable while there is something to fetch, for ports that have none of their own."""

from __future__ import annotations

import socket

__all__ = ["Wake"]


class Wake:
    """A level: `set` makes `fileno` readable, `clear` ends that. Any thread may call any verb."""

    def __init__(self) -> None:
        self._reader, self._writer = socket.socketpair()
        self._reader.setblocking(False)
        self._writer.setblocking(False)

    def fileno(self) -> int:
        """Return the descriptor to wait on, -1 once closed."""
        return self._reader.fileno()

    def set(self) -> None:
        """Make the descriptor readable."""
        try:
            self._writer.send(b"!")
        except OSError:  # full: it is readable already; closed: nobody waits
            return

    def clear(self) -> None:
        """Make the descriptor unreadable."""
        try:
            while len(self._reader.recv(4096)) == 4096:
                pass
        except OSError:  # nothing there
            return

    def close(self) -> None:
        """Give the descriptors back."""
        self._reader.close()
        self._writer.close()
