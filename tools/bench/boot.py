#!/usr/bin/env python3
"""How long a boot takes: robby's two drives, and 64 such drives, on a `local:` bus between processes, without pacing.

The drives are on the bus before the clock starts (robby's in a process each, the 64 in two processes). The clock stops
when every node is OPERATIONAL, which a heartbeat or a TPDO has shown. Three rounds: the first configures drives that
know nothing; the others find what a reset of the communication leaves of that. CPU is the master's.

    tools/bench/boot.py            figures
    tools/bench/boot.py --json     the same as JSON
    tools/bench/boot.py --nodes 8  another number of drives
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from canopen_control.data_files import data_path
from canopen_control.host.reactor import Reactor
from canopen_control.master.config import read_bus
from canopen_control.runtime.bus import RobotBus
from canopen_control.runtime.pacer import Pacer

if TYPE_CHECKING:
    from collections.abc import Iterator

    from canopen_control.master.config import BusConfig

EDS = data_path("eds", "TMCM-1270.eds")
LIMITS_S = {2: 0.3, 64: 2.0}
ROUNDS = 3
GIVE_UP_S = 30.0


def bus_file(folder: Path, count: int) -> Path:
    """Write robby's bus.yml with `count` drives, ids from 2."""
    text = data_path("config", "robby").joinpath("bus.yml").read_text()
    head = text[: text.index("nodes:")]
    nodes = "".join(f"  drive_{node_id}: {{node_id: {node_id}}}\n" for node_id in range(2, count + 2))
    path = folder / f"bus{count}.yml"
    path.write_text(f"{head}nodes:\n{nodes}")
    return path


@contextlib.contextmanager
def drives(channel: str, count: int) -> Iterator[None]:
    """Run `count` drives in two processes."""
    half = count // 2
    ranges = [f"2-{1 + half}", f"{2 + half}-{1 + count}"]
    environment = {**os.environ, "_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1"}
    command = [sys.executable, "-m", "canopen_control", "drive", "--eds", str(EDS), "--can", channel, "--node-id"]
    children = [subprocess.Popen([*command, ids], stdout=subprocess.PIPE, text=True, env=environment) for ids in ranges]
    try:
        for child in children:
            assert child.stdout is not None
            child.stdout.readline()  # they are there
        yield
    finally:
        for child in children:
            child.terminate()
        for child in children:
            child.wait(10)


def boot(config: BusConfig, channel: str) -> dict[str, float]:
    """Boot all nodes once; return seconds, CPU seconds and SDO requests."""
    reactor = Reactor()
    cycle_ns = config.master.sync_period * 1000
    bus = RobotBus("can", channel, config, reactor, cycle_ns=cycle_ns, report=lambda _event: None, on_lost=print)

    def cycle(now: int) -> None:
        bus.receive()
        bus.tick(now)
        bus.send_cycle(now)
        if all(node.ready for node in bus.network.nodes.values()) or now > deadline:
            reactor.stop()

    bus.open()
    pacer = Pacer(reactor, cycle_ns, cycle)
    began, cpu, deadline = time.monotonic(), time.process_time(), reactor.now() + round(GIVE_UP_S * 1e9)
    bus.network.start(reactor.now())
    bus.send_waiting()
    pacer.start()
    reactor.run()
    nodes = bus.network.nodes.values()
    missing = [f"{node.name}: {node.error}" for node in nodes if not node.ready]
    result = {
        "seconds": time.monotonic() - began,
        "cpu_seconds": time.process_time() - cpu,
        "reads": sum(node.sdo_reads for node in nodes) / len(nodes),
        "writes": sum(node.sdo_writes for node in nodes) / len(nodes),
    }
    for name in ("reset", "identify", "configure", "heartbeat", "start"):
        result[name] = max((step.seconds for node in nodes for step in node.boot_steps if step.name == name), default=0)
    pacer.stop()
    bus.close()
    reactor.close()
    if missing:
        raise SystemExit(f"not booted within {GIVE_UP_S:g} s: {missing[:3]}")
    return result


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--nodes", type=int, action="append", help="how many drives (default: 2 and 64)")
    arguments = parser.parse_args()
    results: dict[int, list[dict[str, float]]] = {}
    with tempfile.TemporaryDirectory(prefix="boot-bench-") as folder:
        os.environ["XDG_RUNTIME_DIR"] = folder
        for count in arguments.nodes or (2, 64):
            channel = f"local:boot{count}"
            config = read_bus(bus_file(Path(folder), count))
            with drives(channel, count):
                results[count] = [boot(config, channel) for _ in range(ROUNDS)]
    if arguments.json:
        print(json.dumps(results))
        return 0
    for count, rounds in results.items():
        limit = f" (to be under {LIMITS_S[count]:g} s)" if count in LIMITS_S else ""
        print(f"{count} drives{limit}")
        for number, each in enumerate(rounds, 1):
            steps = ", ".join(f"{name} {each[name] * 1000:.0f}" for name in list(each)[4:])
            print(
                f"  round {number}: {each['seconds']:.3f} s, CPU {each['cpu_seconds']:.3f} s, "
                f"{each['reads']:.0f} reads and {each['writes']:.0f} writes per node; longest steps in ms: {steps}"
            )
    return 0


if __name__ == "__main__":
    sys.exit(main())
