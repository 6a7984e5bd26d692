#!/usr/bin/env python3
"""Many virtual drives in one process: what they cost at a 10 ms SYNC with two RPDOs and two TPDOs each.

The drives are one `canopen-control drive --node-id 1-N` on a `local:` bus of its own; the master is this process, with
raw frames: it maps four synchronous PDOs on every drive, enables them all in profile velocity, and sends two RPDOs for
each drive and SYNC every 10 ms. CPU is that of the drives' process alone, from /proc; what arrives is counted here, so
that a drive that keeps silent is seen.

    tools/bench/virtual.py                       64 drives, 10 s
    tools/bench/virtual.py --drives 16 --seconds 5
    tools/bench/virtual.py --json                the same as JSON
    tools/bench/virtual.py --check               exit 1 when they need more than one core, or TPDOs are missing
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import platform
import select
import struct
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from canopen_control.bus.channel import open_port
from canopen_control.frame import CanFrame, frames_of, pack_records

if TYPE_CHECKING:
    from collections.abc import Iterator

    from canopen_control.bus.port import Port

ROOT = Path(__file__).resolve().parents[2]
BUS = "virtual-bench"
PERIOD_S = 0.010
CLEAR_BIT_30, OFF = 0x40000000, 0xC0000000
TICKS = os.sysconf("SC_CLK_TCK")
# index, value: what makes a TMCM-1270 ready to turn
RAMPS = ((0x6083, 100_000), (0x6084, 100_000), (0x6085, 100_000), (0x6081, 10_000))


class Master:
    """As much of a master as it takes."""

    def __init__(self, port: Port) -> None:
        self.port = port

    def frames(self, seconds: float) -> Iterator[CanFrame]:
        """Yield what arrives within a time."""
        deadline = time.perf_counter() + seconds
        while (rest := deadline - time.perf_counter()) > 0:
            if select.select([self.port], [], [], rest)[0]:
                yield from frames_of(self.port.receive())

    def write(self, node_id: int, index: int, sub: int, value: int, size: int) -> None:
        """Write an object, expedited."""
        command = {1: 0x2F, 2: 0x2B, 4: 0x23}[size]
        data = struct.pack("<BHBI", command, index, sub, value & 0xFFFFFFFF)
        self.port.send(pack_records([CanFrame(0x600 + node_id, data)]))
        for frame in self.frames(5.0):
            if frame.can_id == 0x580 + node_id:
                if frame.data[0] == 0x80:
                    raise SystemExit(f"node {node_id} refuses 0x{index:04X}:{sub:02X}: {frame.data[4:].hex()}")
                return
        raise SystemExit(f"node {node_id} does not answer")

    def map_pdo(self, node_id: int, communication: int, cob_id: int, mapping: tuple[int, ...]) -> None:
        """Make a synchronous PDO."""
        self.write(node_id, communication, 1, OFF | cob_id, 4)
        self.write(node_id, communication, 2, 1, 1)
        record = communication + 0x200
        self.write(node_id, record, 0, 0, 1)
        for number, entry in enumerate(mapping, 1):
            self.write(node_id, record, number, entry, 4)
        self.write(node_id, record, 0, len(mapping), 1)
        self.write(node_id, communication, 1, CLEAR_BIT_30 | cob_id, 4)

    def configure(self, node_id: int) -> None:
        """Map two PDOs each way, switch off the others, set ramps."""
        for communication, base in ((0x1402, 0x400), (0x1403, 0x500), (0x1802, 0x380), (0x1803, 0x480)):
            self.write(node_id, communication, 1, OFF | base + node_id, 4)
        self.map_pdo(node_id, 0x1400, 0x200 + node_id, (0x60400010, 0x60600008))
        self.map_pdo(node_id, 0x1401, 0x300 + node_id, (0x60FF0020,))
        self.map_pdo(node_id, 0x1800, 0x180 + node_id, (0x60410010, 0x60610008))
        self.map_pdo(node_id, 0x1801, 0x280 + node_id, (0x60640020, 0x606C0020))
        for index, value in RAMPS:
            self.write(node_id, index, 0, value, 4)

    def cycle(self, nodes: range, word: int, speed: int) -> None:
        """Send one cycle's frames."""
        commands = [CanFrame(0x200 + node, struct.pack("<Hb", word, 3)) for node in nodes]
        targets = [CanFrame(0x300 + node, struct.pack("<i", speed)) for node in nodes]
        self.port.send(pack_records([*commands, *targets, CanFrame(0x080)]))


def cpu_s(pid: int) -> float:
    """Return the CPU seconds that a process has used, in user mode and in the kernel."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / TICKS


def machine() -> str:
    """Return the machine's name, and its processor's."""
    with contextlib.suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return f"{platform.node()}: {line.partition(':')[2].strip()}, Python {platform.python_version()}"
    return f"{platform.node()}: {platform.machine()}, Python {platform.python_version()}"


@contextlib.contextmanager
def drives(count: int) -> Iterator[int]:
    """Run the drives; yield their process id."""
    command = [sys.executable, "-m", "canopen_control", "drive", "--node-id", f"1-{count}", "--eds", "TMCM-1270.eds"]
    process = subprocess.Popen([*command, "--can", f"local:{BUS}"], cwd=ROOT, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        if "ready" not in process.stdout.readline():
            raise SystemExit("the drives did not start")
        # What they log is read by nobody: it must not fill the pipe.
        devnull = subprocess.Popen(["cat"], stdin=process.stdout, stdout=subprocess.DEVNULL)
        yield process.pid
        process.terminate()
        process.wait(10)
        devnull.wait(10)
    finally:
        process.kill()


def measure(count: int, seconds: float) -> dict[str, object]:
    """Run the bench; return its figures."""
    nodes = range(1, count + 1)
    with drives(count) as pid, contextlib.closing(open_port(f"local:{BUS}", label="bench")) as port:
        master = Master(port)
        for node in nodes:
            master.configure(node)
        port.send(pack_records([CanFrame(0, b"\x01\x00")]))
        for word in (0x06, 0x07, 0x0F, 0x0F):
            master.cycle(nodes, word, 0)
            time.sleep(2 * PERIOD_S)
        port.receive()
        arrived: Counter[int] = Counter()
        cycles = round(seconds / PERIOD_S)
        cpu, start = cpu_s(pid), time.perf_counter()
        for cycle in range(cycles):
            master.cycle(nodes, 0x0F, 5000 if cycle // 100 % 2 else -5000)
            rest = start + (cycle + 1) * PERIOD_S - time.perf_counter()
            for frame in master.frames(max(rest, 0.0)):
                arrived[frame.can_id & ~0x7F] += 1
        elapsed, used = time.perf_counter() - start, cpu_s(pid) - cpu
        for frame in master.frames(0.2):
            arrived[frame.can_id & ~0x7F] += 1
    return {
        "machine": machine(),
        "drives": count,
        "cycles": cycles,
        "elapsed_s": round(elapsed, 3),
        "cpu_s": round(used, 2),
        "cores": round(used / elapsed, 3),
        "us_per_drive_and_cycle": round(1e6 * used / cycles / count, 2),
        "tpdos": arrived[0x180] + arrived[0x280],
        "tpdos_expected": 2 * count * cycles,
    }


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--drives", type=int, default=64, metavar="N")
    parser.add_argument("--seconds", type=float, default=10.0, metavar="S")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--check", action="store_true", help="exit 1 for more than one core, or missing TPDOs")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="cc-bench-") as folder:
        os.environ.update(XDG_RUNTIME_DIR=folder, XDG_STATE_HOME=f"{folder}/state", _ROS_WHEELS_BOOTSTRAP_COMPLETE="1")
        found = measure(args.drives, args.seconds)
    if args.json:
        print(json.dumps(found, indent=2))
    else:
        print(found["machine"])
        print(f"{found['drives']} drives, {found['cycles']} cycles of 10 ms with 2 RPDOs and 2 TPDOs each")
        print(f"CPU {found['cpu_s']} s in {found['elapsed_s']} s: {found['cores']} cores")
        print(f"{found['us_per_drive_and_cycle']} us for each drive and cycle")
        print(f"TPDOs {found['tpdos']} of {found['tpdos_expected']}")
    good = float(str(found["cores"])) < 1.0 and found["tpdos"] == found["tpdos_expected"]
    return 0 if good or not args.check else 1


if __name__ == "__main__":
    sys.exit(main())
