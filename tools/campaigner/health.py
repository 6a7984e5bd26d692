"""Monitors what the bus does not show: memory, output and logs of the processes, and survivors of kills."""

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
    """The resident memory of one runtime: must be flat after warm-up."""

    def __init__(self) -> None:
        self.first: float | None = None
        self.most = 0.0
        self._told = False

    @property
    def growth(self) -> float:
        """The maximum growth so far, in MB."""
        return 0.0 if self.first is None else self.most - self.first

    def look(self, age: float, megabytes: float | None, now: float) -> Breach | None:
        """Take a sample at a given age in seconds; return the breach, once."""
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
    """Follows growing log files: they must contain neither tracebacks nor floods of lines."""

    def __init__(self) -> None:
        self._read: dict[Path, int] = {}
        self._lines: dict[Path, deque[tuple[float, int]]] = {}
        self._told: set[Path] = set()

    def look(self, paths: Iterable[Path], now: float) -> list[Breach]:
        """Read new lines; return those that must not occur."""
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
                file.seek(at if at <= size else 0)  # a smaller file belongs to a restarted process
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
    """Check in a thread that no process of a killed run survives longer than `GONE_S`."""
    killed = time.monotonic()

    def watch() -> None:
        while left := run.survivors() or run.survivors():  # one listing of /proc may omit a process
            now = time.monotonic()
            if now - killed > GONE_S:
                names = "; ".join(f"{line.strip()} (pid {pid})" for pid, line in left.items())
                report(Breach(now, "orphan", f"{now - killed:.1f} s after the run was killed there still is: {names}"))
                return
            time.sleep(0.1)

    thread = threading.Thread(target=watch, daemon=True)
    thread.start()
    return thread
