"""Terminals for tests: a pseudo-terminal as standard input of this process, and tmux, which types real keys."""

from __future__ import annotations

import contextlib
import io
import itertools
import os
import pty
import subprocess
import sys
import threading
import time

from support.host import TIMEOUT_S
from support.lockstep import typed_into


class _Typist(io.FileIO):
    """The end of a pseudo-terminal that is typed into; `screen_side` is the other one."""

    screen_side = -1

    def write(self, keys):
        count = super().write(keys)
        typed_into(self.screen_side)
        return count


@contextlib.contextmanager
def typed(monkeypatch):
    """Make a pseudo-terminal standard input; yield its other end, to type into. Closing it hangs up."""
    master, slave = pty.openpty()
    with os.fdopen(slave, "r") as stdin, _Typist(master, "wb") as typist:
        typist.screen_side = slave
        monkeypatch.setattr(sys, "stdin", stdin)
        yield typist


@contextlib.contextmanager
def in_background(work, on_failure=lambda: None):
    """Run `work` on a thread while this one is busy; what it raised is raised at the end, after `on_failure`."""
    failed = []

    def guarded():
        try:
            work()
        except (Exception, AssertionError) as error:  # noqa: BLE001 - raised again below
            failed.append(error)
            on_failure()

    thread = threading.Thread(target=guarded)
    thread.start()
    yield
    thread.join(60)
    assert not thread.is_alive()
    if failed:
        raise failed[0]


_numbers = itertools.count(1)


class Tmux:
    """A tmux server of its own with one window; `keys` types, `screen` is what stands there."""

    def __init__(self, folder, width=120, height=40):
        # with its own socket: a server that was asked to end accepts clients until it has ended
        self._socket = str(folder / f"tmux{next(_numbers)}")
        size = ["-x", str(width), "-y", str(height)]
        self._run("-f", "/dev/null", "new-session", "-d", "-s", "test", *size, "env", "PS1=$ ", "bash", "--norc")
        self._run("set-option", "-g", "focus-events", "on")
        self.until("$")

    def _run(self, *arguments):
        done = subprocess.run(["tmux", "-S", self._socket, *arguments], capture_output=True, text=True, timeout=60)
        assert done.returncode == 0, done.stderr
        return done.stdout

    def keys(self, *keys):
        """Type keys by tmux's names (Enter, C-c, Space, i, ...)."""
        self._run("send-keys", "-t", "test", *keys)

    def run(self, line):
        """Type a command line."""
        self._run("send-keys", "-t", "test", "-l", line)
        self.keys("Enter")

    @property
    def screen(self):
        return self._run("capture-pane", "-p", "-t", "test")

    def until(self, text, seconds=TIMEOUT_S):
        """Wait until `text` stands on the screen; returns the screen."""
        end = time.monotonic() + seconds
        while text not in (screen := self.screen):
            assert time.monotonic() < end, f"{text!r} is not on the screen:\n{screen}"
            time.sleep(0.05)
        return screen

    def close(self):
        """End the server and everything in it."""
        self._run("kill-server")
