"""Replay of a recording onto a bus with its original timing.

Deadlines are absolute, so that a late frame does not delay the next one. Error frames are skipped, because nodes cannot
send them.
"""

from __future__ import annotations

import select
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

from canopen_control.frame import pack_records

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from canopen_control.bus.port import Port
    from canopen_control.bus.recordings import RecordedFrame


_NS = 1_000_000_000
_LAST_FRAMES_S = 2.0
_TRY_S = 0.1


@dataclass(slots=True)
class PlayReport:
    """Result of a replay; `errors` is the number of skipped error frames, `late_max` the maximum delay in s."""

    frames: int = 0
    errors: int = 0
    late_max: float = 0.0


def play(
    frames: Iterable[RecordedFrame],
    port: Port,
    played: PlayReport,
    *,
    speed: float = 1.0,
    clock: Callable[[], int] = time.monotonic_ns,
    sleep: Callable[[float], None] = time.sleep,
) -> None:
    """Send `frames` at `speed` times the recorded rate; `played` counts them, even if the call is interrupted.

    A time before the previous one (the clock was set back) counts as no delay. BusClosed when the bus is gone.
    """
    begin, newest = clock(), 0
    first: int | None = None
    for recorded in frames:
        if recorded.frame.is_error:
            played.errors += 1
            continue
        first = recorded.time_ns if first is None else first
        newest = max(newest, recorded.time_ns - first)
        send_at = begin + round(newest / speed)
        late = clock() - send_at
        if late < 0:
            sleep(-late / _NS)
            late = clock() - send_at
        played.late_max = max(played.late_max, late / _NS)
        port.receive()  # received frames are discarded
        port.send(pack_records([recorded.frame]))
        _flush(port, 0.0)
        played.frames += 1
    _flush(port, _LAST_FRAMES_S)


def _flush(port: Port, seconds: float) -> None:
    end = time.monotonic() + seconds
    while port.wants_write:
        port.flush()
        remaining = end - time.monotonic()
        if remaining <= 0.0:
            return
        select.select([], [port.fileno()], [], min(remaining, _TRY_S))
