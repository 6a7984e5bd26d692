"""Frame rates and bus load of the kernel's CAN interfaces, from their own counters.

A virtual interface hears what it sends and counts it both ways, so that one way is all there is. The load is that of
frames without stuff bits, as `runtime.robot_bus` works it out; the real one is up to a fifth higher.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

from canopen_control.bus.rawsocket import NETWORK_CLASS
from canopen_control.frame import FRAME_BITS

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable
    from pathlib import Path

    from canopen_control.bus.can_interfaces import CanInterface

__all__ = ["Traffic", "measure"]

_LOOPED = ("vcan",)
_COUNTERS = ("packets", "bytes")


@dataclass(frozen=True, slots=True)
class Traffic:
    """What went over an interface; `load` is the share of its bit rate, None for one without."""

    frames_per_second: float
    load: float | None


def measure(
    links: Iterable[CanInterface],
    seconds: float,
    *,
    sleep: Callable[[float], None] = time.sleep,
    clock: Callable[[], float] = time.monotonic,
    network_class: Path = NETWORK_CLASS,
) -> dict[str, Traffic]:
    """Return the traffic of interfaces by name, over `seconds`; one that goes away meanwhile is left out."""
    before = {link.name: (link, _counted(link, network_class)) for link in links if link.is_up}
    since = clock()
    if before:
        sleep(seconds)
    found = {}
    for name, (link, first) in before.items():
        last = _counted(link, network_class)
        if first is not None and last is not None:
            found[name] = _traffic(link, last[0] - first[0], last[1] - first[1], clock() - since)
    return found


def _traffic(link: CanInterface, frames: int, size: int, seconds: float) -> Traffic:
    bits = FRAME_BITS * frames + 8 * size
    return Traffic(frames / seconds, bits / seconds / link.bitrate if link.bitrate else None)


def _counted(link: CanInterface, network_class: Path) -> tuple[int, int] | None:
    """Return frames and bytes of data since the interface is there."""
    folder = network_class / link.name / "statistics"
    ways = ("tx",) if link.kind in _LOOPED else ("rx", "tx")
    try:
        frames, size = (sum(int((folder / f"{way}_{what}").read_text()) for way in ways) for what in _COUNTERS)
    except (OSError, ValueError):
        return None
    return frames, size
