"""`buses`: the capacity of the embedded bus: hubs and a listener, one bus at its maximum, and eight full ones.

A sender hands over each millisecond what a wire would carry in one. The listener, a process of its own, has to hear
every frame; what counts is the CPU of hubs and listener together.
"""

from __future__ import annotations

import json
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

from canopen_control.bus.local import ask_hub
from canopen_control.rpc.messages.hub import GetHubStatus
from canopen_control_bench.figure import Figure, limited
from canopen_control_bench.load import FULL_BUS
from canopen_control_bench.machine import cpu_ns
from canopen_control_bench.stage import stage

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control_bench.runner import Options


MAX = 140_000  # frames a second on one bus
EIGHT = 8  # number of buses, each at full load
CORES_LIMIT = 1.0
ROUNDS, SECONDS = 3, 3.0
_QUIET_S, _WAIT_S = 0.2, 10.0
_MODULE = "canopen_control_bench.bus_traffic"


@dataclass(frozen=True, slots=True)
class Carried:
    """The result of one run; `cores` is the CPU time of hubs and listener per second."""

    sent: int
    heard: int
    dropped: int
    cores: float
    hubs: float

    @property
    def lost(self) -> int:
        """Number of frames sent but not received."""
        return self.sent - self.heard


def measure(options: Options) -> list[Figure]:
    """Measure one bus and eight; a quick run is too unsteady to measure this."""
    if options.quick:
        return []
    return [*_figures(1, MAX, "one bus, 140,000 frames/s"), *_figures(EIGHT, FULL_BUS, "eight full buses of 1 Mbit/s")]


def _figures(buses: int, rate: float, label: str) -> list[Figure]:
    rounds = [carried([f"bench{number}" for number in range(buses)], rate, SECONDS) for _ in range(ROUNDS)]
    told = {
        "frames": sum(result.sent for result in rounds),
        "dropped by hubs": sum(result.dropped for result in rounds),
        "hubs alone, cores": round(max(result.hubs for result in rounds), 3),
    }
    return [
        limited(f"{label}: frames lost", "", [sum(result.lost for result in rounds)], limit=0.0, absolutes=told),
        limited(f"{label}: cores of bus and listener", "", [result.cores for result in rounds], limit=CORES_LIMIT),
    ]


def carried(names: Sequence[str], rate: float, seconds: float) -> Carried:
    """Send the given number of frames per second on each bus, with one process listening to all of them."""
    channels = [f"local:{name}" for name in names]
    with stage() as played:
        listener = played.start(_MODULE, "hear", *channels)
        listener.line()
        sender = played.start(_MODULE, "send", str(rate), str(seconds), *channels)
        sender.line()
        hubs = [ask_hub(name, GetHubStatus()).pid for name in names]
        before, before_hubs, begin = cpu_ns(listener.pid), sum(map(cpu_ns, hubs)), time.monotonic()
        sender.tell("go")
        sent = json.loads(sender.line())["sent"]
        passed = time.monotonic() - begin
        _settle(names)
        used_hubs = (sum(map(cpu_ns, hubs)) - before_hubs) / 1e9
        used = used_hubs + (cpu_ns(listener.pid) - before) / 1e9
        dropped = sum(ask_hub(name, GetHubStatus()).dropped for name in names)
        listener.tell("enough")
        heard = json.loads(listener.line())["heard"]
    return Carried(sent, heard, dropped, used / passed, used_hubs / passed)


def _settle(names: Sequence[str]) -> None:
    """Wait until no hub has frames left to relay."""
    end, known = time.monotonic() + _WAIT_S, -1
    while time.monotonic() < end:
        frames = sum(member.rx for name in names for member in ask_hub(name, GetHubStatus()).members)
        if frames == known:
            return
        known = frames
        time.sleep(_QUIET_S)
