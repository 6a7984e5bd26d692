"""Watches what is not on the bus: memory, output and logs of the processes, who is left of those that were killed."""

from __future__ import annotations

import threading
import time
from collections import deque
from typing import TYPE_CHECKING, Final

from campaigner.observer import Breach

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable
    from pathlib import Path

    from campaigner.processes import Run


GROWTH_MB: Final = 16.0
WARM_UP_S: Final = 20.0
LINES_PER_MINUTE: Final = 1000
GONE_S: Final = 10.0
_MINUTE_S: Final = 60.0
_BAD: Final = ("Traceback (most recent call last)", "a fault of this program")
_CONTEXT: Final = 400


class Memory:
    """The resident memory of one runtime: flat after its warm-up."""

    def __init__(self) -> None:
        self.first: float | None = None
        self.most = 0.0
        self._told = False

    @property
    def growth(self) -> float:
        """By how many MB it has grown at most."""
        return 0.0 if self.first is None else self.most - self.first

    def look(self, age: float, megabytes: float | None, now: float) -> Breach | None:
        """Take a sample at an age in seconds since it ran; returns the breach, once."""
        if megabytes is None or age < WARM_UP_S:
            return None
        if self.first is None:
            self.first = megabytes
        self.most = max(self.most, megabytes)
        if megabytes - self.first <= GROWTH_MB or self._told:
            return None
        self._told = True
        return Breach(
            now, "memory", f"the runtime has grown from {self.first:.1f} to {megabytes:.1f} MB in {age:.0f} s"
        )


class Logs:
    """Reads on in files that grow: no traceback, and no flood of lines."""

    def __init__(self) -> None:
        self._read: dict[Path, int] = {}
        self._lines: dict[Path, deque[tuple[float, int]]] = {}
        self._told: set[Path] = set()

    def look(self, paths: Iterable[Path], now: float) -> list[Breach]:
        """Read what is new; returns what must not be in it."""
        found = []
        for path in paths:
            text = self._news(path)
            if text:
                found += [Breach(now, "traceback", f"{path.name}: {_around(text, bad)}") for bad in _BAD if bad in text]
                found += self._flooded(path, text.count("\n"), now)
        return found

    def _news(self, path: Path) -> str:
        try:
            with path.open("rb") as file:
                size = file.seek(0, 2)
                at = self._read.get(path, 0)
                file.seek(at if at <= size else 0)  # else it was started again
                data = file.read()
                self._read[path] = file.tell()
        except OSError:
            return ""
        return data.decode(errors="replace")

    def _flooded(self, path: Path, lines: int, now: float) -> list[Breach]:
        seen = self._lines.setdefault(path, deque())
        seen.append((now, lines))
        while seen[0][0] < now - _MINUTE_S:
            seen.popleft()
        total = sum(count for _, count in seen)
        if total <= LINES_PER_MINUTE or path in self._told:
            return []
        self._told.add(path)
        return [Breach(now, "output", f"{path.name}: {total} lines within a minute")]


def _around(text: str, bad: str) -> str:
    begin = text.index(bad)
    return " | ".join(text[begin : begin + _CONTEXT].split("\n"))


def watch_orphans(run: Run, report: Callable[[Breach], None]) -> threading.Thread:
    """Watch, in a thread, that nobody of a killed run lives for longer than `GONE_S`."""
    killed = time.monotonic()

    def watch() -> None:
        while left := run.survivors() or run.survivors():  # a listing of /proc may miss a process once
            now = time.monotonic()
            if now - killed > GONE_S:
                names = "; ".join(f"{line.strip()} (pid {pid})" for pid, line in left.items())
                report(Breach(now, "orphan", f"{now - killed:.1f} s after the run was killed there still is: {names}"))
                return
            time.sleep(0.1)

    thread = threading.Thread(target=watch, daemon=True)
    thread.start()
    return thread
