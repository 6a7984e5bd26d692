"""Counts the system calls of a process by name.

Counted by strace, which makes each call dearer and changes nothing of their number.
"""

from __future__ import annotations

import re
import shutil
import signal
import subprocess
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator


_LINE = re.compile(r"^ *[\d.]+ +[\d.]+ +\d+ +(\d+) +(?:\d+ +)?(\w+)$", re.MULTILINE)
_ATTACH_S = 5.0


def count_calls(pid: int, seconds: float) -> dict[str, int]:
    """Return the number of system calls of a process in a time by name; empty if strace cannot attach."""
    strace = shutil.which("strace")
    if strace is None:
        return {}
    with tempfile.TemporaryDirectory(prefix="bench-") as folder:
        table, said = Path(folder, "calls"), Path(folder, "said")
        with said.open("wb") as errors:
            command = [strace, "-f", "-c", "-p", str(pid), "-o", str(table)]
            process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stderr=errors)
        if _attached(process, said):
            time.sleep(seconds)
        process.send_signal(signal.SIGINT)
        process.wait()
        return parse_calls(table.read_text() if table.exists() else "")


def parse_calls(table: str) -> dict[str, int]:
    """Parse a table of `strace -c` and return the calls by name."""
    return dict(_rows(table))


def _rows(table: str) -> Iterator[tuple[str, int]]:
    for match in _LINE.finditer(table):
        if match[2] != "total":
            yield match[2], int(match[1])


def _attached(process: subprocess.Popen[bytes], said: Path) -> bool:
    """Wait until strace reports that it is attached; return False if it may not attach."""
    end = time.monotonic() + _ATTACH_S
    while process.poll() is None and time.monotonic() < end:
        if b"attached" in said.read_bytes():
            return True
        time.sleep(0.01)
    return False
