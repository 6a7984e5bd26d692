"""Lines for people, printed by a thread of their own: a terminal that is stopped must not stop the robot."""

from __future__ import annotations

import queue
import threading
from typing import TextIO

__all__ = ["Announcer"]

_CAPACITY = 1000
_PATIENCE_S = 1.0


class Announcer:
    """Prints lines to `stream`; what a stalled reader cannot take is dropped and counted in `dropped`."""

    def __init__(self, stream: TextIO) -> None:
        self.dropped = 0
        self._stream = stream
        self._lines: queue.Queue[str | None] = queue.Queue(_CAPACITY)
        self._thread = threading.Thread(target=self._print, name="announcer", daemon=True)
        self._thread.start()

    def say(self, line: str) -> None:
        """Hand over a line; never waits."""
        try:
            self._lines.put_nowait(line)
        except queue.Full:
            self.dropped += 1

    def close(self) -> None:
        """Print what waits, for a second at most."""
        try:
            self._lines.put(None, timeout=_PATIENCE_S)
        except queue.Full:
            return
        self._thread.join(_PATIENCE_S)

    def _print(self) -> None:
        while (line := self._lines.get()) is not None:
            try:
                print(line, file=self._stream, flush=True)
            except (OSError, ValueError):  # the reader has gone; the robot goes on
                self.dropped += 1
