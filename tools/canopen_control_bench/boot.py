"""`boot`: from the first frame to every drive OPERATIONAL, configured, on a `local:` bus between processes, unpaced.

The drives are on the bus before the clock starts, in two processes. The clock stops when a heartbeat or a TPDO has
shown that the last node is OPERATIONAL. Each round resets the communication, so that each configures everything. CPU
is the master's.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

from canopen_control.errors import CanopenError
from canopen_control.host.reactor import Reactor
from canopen_control.master.config import read_bus
from canopen_control.runtime.pacer import Pacer
from canopen_control.runtime.robot_bus import RobotBus
from canopen_control_bench.figure import Figure, limited
from canopen_control_bench.fleet import FIRST_NODE, write_fleet
from canopen_control_bench.stage import Stage, stage

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.errors import BusError
    from canopen_control.master.boot import FinishedStep
    from canopen_control.master.config import BusConfig
    from canopen_control_bench.runner import Options


LIMITS_S = {2: 0.3, 64: 2.0}
ROUNDS = 5
_PERIOD_US = 20_000
_GIVE_UP_NS = 30_000_000_000
_STEPS = ("reset", "identify", "configure", "heartbeat", "start")


@dataclass(frozen=True, slots=True)
class Boot:
    """One boot: its duration, the master's CPU time, and SDO requests per node."""

    seconds: float
    cpu_s: float
    reads: float
    writes: float
    steps_ms: dict[str, float]


def measure(options: Options) -> list[Figure]:
    """Measure the boot of two drives and of 64."""
    figures = []
    for count, limit in LIMITS_S.items():
        if options.quick and count > min(LIMITS_S):
            continue
        with stage() as played:
            boots, used = boots_of(played, count), played.cpu_s()
        best = min(boots, key=lambda boot: boot.seconds)
        absolutes = {
            "master CPU s": round(best.cpu_s, 3),
            "reads for each node": best.reads,
            "writes": best.writes,
            **{f"longest {name} ms": round(value) for name, value in best.steps_ms.items()},
            **{f"{name}, {ROUNDS} boots and start": value for name, value in used.items()},
        }
        seconds = [measured.seconds for measured in boots]
        figures.append(limited(f"boot, {count} drives", "s", seconds, limit=limit, absolutes=absolutes))
    return figures


def boots_of(played: Stage, count: int) -> list[Boot]:
    """Start drives on a bus and boot them several times."""
    channel = f"local:boot{count}"
    last, half = FIRST_NODE + count - 1, FIRST_NODE + count // 2
    played.drives(channel, f"{FIRST_NODE}-{half - 1}")
    played.drives(channel, f"{half}-{last}")
    config = read_bus(write_fleet(played.folder, count, _PERIOD_US) / "bus.yml")
    return [boot(config, channel) for _ in range(ROUNDS)]


def boot(config: BusConfig, channel: str) -> Boot:
    """Boot all nodes once; raises CanopenError with the first node that did not boot."""
    reactor = Reactor()
    lost: list[BusError] = []
    cycle_ns = config.master.sync_period * 1000
    bus = RobotBus("can", channel, config, reactor, cycle_ns=cycle_ns, report=lambda _event: None, on_lost=lost.append)
    nodes = bus.network.nodes.values()

    def cycle(now: int) -> None:
        bus.receive()
        bus.tick(now)
        bus.send_cycle(now)
        if lost or all(node.ready for node in nodes) or now > deadline:
            reactor.stop()

    bus.open()
    pacer = Pacer(reactor, cycle_ns, cycle)
    began, cpu, deadline = time.monotonic(), time.process_time(), reactor.now() + _GIVE_UP_NS
    try:
        bus.network.start(reactor.now())
        bus.send_waiting()
        pacer.start()
        reactor.run()
        found = Boot(
            time.monotonic() - began,
            time.process_time() - cpu,
            sum(node.sdo_reads for node in nodes) / len(nodes),
            sum(node.sdo_writes for node in nodes) / len(nodes),
            {step: 1000 * max((_seconds(node.boot_steps, step) for node in nodes), default=0.0) for step in _STEPS},
        )
    finally:
        pacer.stop()
        bus.close()
        reactor.close()
    for node in nodes:
        if not node.ready:
            raise CanopenError(f"{node.name} has not booted within {_GIVE_UP_NS / 1e9:g} s: {node.error}")
    return found


def _seconds(steps: Sequence[FinishedStep], name: str) -> float:
    return max((step.seconds for step in steps if step.name == name), default=0.0)
