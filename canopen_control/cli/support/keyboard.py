"""A terminal that hands over single keys, and is itself again afterwards, whatever happens.

The law of the file: canonical mode, echo, signals and flow control of the terminal are off while keys are read, so that
Ctrl-C, Ctrl-Z and Ctrl-S come as keys: none of them may leave a robot moving. The terminal tells when it loses the
focus where it can (xterm's mode 1004). A terminal that is gone (SIGHUP) reads as the end.
"""

from __future__ import annotations

import contextlib
import os
import select
import signal
import sys
import termios
from typing import TYPE_CHECKING, Any, Final

from canopen_control.errors import ConfigError
from canopen_control.host.signals import on_signals

if TYPE_CHECKING:
    from types import TracebackType

__all__ = ["Keyboard"]

_FOCUS_ON: Final = "\x1b[?1004h"
_FOCUS_OFF: Final = "\x1b[?1004l"
_CHUNK: Final = 1024
_ENDING: Final = (signal.SIGTERM, signal.SIGHUP)


class Keyboard:
    """Standard input as keys, as a context manager; ConfigError when it is no terminal.

    `ended` is True when nothing more will come: end of file, SIGTERM or SIGHUP.
    """

    def __init__(self) -> None:
        self.ended = False
        self._fd = -1
        self._saved: list[Any] = []
        self._signals = contextlib.ExitStack()

    def __enter__(self) -> Keyboard:
        if not sys.stdin.isatty():
            raise ConfigError("keys are read from a terminal, and standard input is none; run it in a terminal")
        self._fd = sys.stdin.fileno()
        self._saved = termios.tcgetattr(self._fd)
        self._signals.enter_context(on_signals(_ENDING, self._end))
        changed = termios.tcgetattr(self._fd)
        changed[0] &= ~(termios.IXON | termios.ICRNL)
        changed[3] &= ~(termios.ICANON | termios.ECHO | termios.ISIG | termios.IEXTEN)
        changed[6][termios.VMIN], changed[6][termios.VTIME] = 1, 0
        termios.tcsetattr(self._fd, termios.TCSADRAIN, changed)
        self._say(_FOCUS_ON)
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self._say(_FOCUS_OFF)
        with contextlib.suppress(OSError, termios.error):  # the terminal has gone: nothing is left to restore
            termios.tcsetattr(self._fd, termios.TCSAFLUSH, self._saved)
        self._signals.close()

    def read(self, timeout: float) -> bytes:
        """Return what has been typed within `timeout` seconds, b"" when nothing was or it has ended."""
        if self.ended or not select.select([self._fd], [], [], max(timeout, 0.0))[0]:
            return b""
        try:
            data = os.read(self._fd, _CHUNK)
        except OSError:  # EIO: the other side of the terminal is closed
            data = b""
        if not data:
            self.ended = True
        return data

    def _end(self) -> None:
        self.ended = True

    def _say(self, sequence: str) -> None:
        """Speak to the terminal itself, where standard output is one."""
        with contextlib.suppress(OSError, ValueError):
            if sys.stdout.isatty():
                sys.stdout.write(sequence)
                sys.stdout.flush()
