"""A bare timer on a CPU at top priority: when it is late, the whole machine was stalled.

    python -m canopen_control_bench.witness PROCESSOR PERIOD_NS

A hypervisor takes a virtual processor away for milliseconds, firmware a real one; no program on it can help that. It
watches until a line comes on standard input, and answers with its "stalls": [deadline, arrival] on the monotonic clock,
in ns, of each time that it came half a period late or later.
"""

from __future__ import annotations

import gc
import os
import sys
import threading
import time
from typing import TYPE_CHECKING

from canopen_control.runtime.realtime import HIGHEST_PRIORITY
from canopen_control_bench.turns import say

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence


def watch(
    period_ns: int,
    ended: Callable[[], bool],
    now: Callable[[], int] = time.monotonic_ns,
    sleep: Callable[[float], object] = time.sleep,
) -> list[tuple[int, int]]:
    """Wake every `period_ns` until `ended`, and return deadline and arrival of the late wake-ups."""
    stalls = []
    edge = now()
    while not ended():
        edge += period_ns
        sleep(max(0, edge - now()) / 1e9)
        woke = now()
        if woke - edge >= period_ns // 2:
            stalls.append((edge, woke))
            edge = woke
    return stalls


def unwitnessed(stalls: Sequence[tuple[int, int]], witnessed: Sequence[tuple[int, int]]) -> list[tuple[int, int]]:
    """Return those of `stalls` that do not overlap any witnessed stall."""
    return [(edge, woke) for edge, woke in stalls if not any(begin < woke and end > edge for begin, end in witnessed)]


def _wait_for_line(ended: threading.Event) -> None:
    sys.stdin.readline()
    ended.set()


def main(arguments: Sequence[str]) -> None:
    """Run until standard input receives a line."""
    cpu, period_ns = map(int, arguments)
    ended = threading.Event()
    threading.Thread(target=_wait_for_line, args=(ended,), daemon=True).start()
    gc.disable()
    os.sched_setaffinity(0, {cpu})
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(HIGHEST_PRIORITY))
    say({"ready": True})
    say({"stalls": watch(period_ns, ended.is_set)})


if __name__ == "__main__":
    main(sys.argv[1:])
