"""Output of a running robot to the terminal, on a separate thread so that it never blocks the robot."""

from __future__ import annotations

import queue
import threading
from typing import Final, TextIO

from canopen_control.cli.support.output import with_token

_WAITING_LINES: Final = 1000
_CLOSE_S: Final = 1.0  # for queuing the end mark, and again for printing the queued lines


class Announcer:
    """Printer of lines on a separate thread, so that a stopped terminal cannot stop the robot.

    Lines are printed from `start` on, or at the latest at `close`. `dropped` counts the lines that were dropped because
    the queue was full or the output could not be written.
    """

    def __init__(self, stream: TextIO) -> None:
        self.dropped = 0
        self._stream = stream
        self._lines: queue.Queue[tuple[str, bool] | None] = queue.Queue(_WAITING_LINES)
        self._thread = threading.Thread(target=self._print, name="announcer", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def say(self, line: str, *, token: bool = False) -> None:
        """Queue a line, without waiting; `token` adds the page's token when the line is printed (`with_token`)."""
        try:
            self._lines.put_nowait((line, token))
        except queue.Full:
            self.dropped += 1

    def close(self) -> None:
        """Print the queued lines and end the thread; wait two seconds at most."""
        if self._thread.ident is None:
            self.start()
        try:
            self._lines.put(None, timeout=_CLOSE_S)
        except queue.Full:
            return
        self._thread.join(_CLOSE_S)

    def _print(self) -> None:
        while (item := self._lines.get()) is not None:
            line, token = item
            try:
                print(with_token(line) if token else line, file=self._stream, flush=True)
            except (OSError, ValueError):  # the output was closed; the robot keeps running
                self.dropped += 1
