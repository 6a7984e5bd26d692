"""`memory`: the memory growth of the runtime's process after a million cycles and nine million frames.

The complete robot runs in a process of its own on recorded frames, as fast as it can: two drives, 9 frames a cycle.
What is compared is the memory that the kernel counts for the process (resident set), after a warm-up and at the end.

    python -m canopen_control_bench.memory FOLDER DRIVES CYCLES [LEAK]      LEAK: bytes to lose in each cycle, to see it
"""

from __future__ import annotations

import gc
import json
import statistics
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from canopen_control_bench.figure import Figure, limited
from canopen_control_bench.machine import resident_bytes
from canopen_control_bench.recorded import RecordedFleet
from canopen_control_bench.stage import TIMEOUT_S, Stage, stage

if TYPE_CHECKING:
    from canopen_control_bench.runner import Options


LIMIT_MB = 1.0
CYCLES, QUICK_CYCLES = 1_000_000, 30_000
DRIVES = 2
_MEGABYTE = 1e6


def measure(options: Options) -> list[Figure]:
    """Run the cycles, and measure the cost of a cycle without a wire, with more drives."""
    cycles = QUICK_CYCLES if options.quick else CYCLES
    with stage() as played:
        found = run(played, DRIVES, cycles)
        costs = {count: run(played, count, 4000) for count in (() if options.quick else (2, 16, 64))}
    absolutes = {"cycles": cycles, "frames": found["frames"], "resident MB": round(found["end"] / _MEGABYTE, 1)}
    name = f"growth over {cycles:.0e} cycles"
    return [
        limited(
            name, "MB", [(found["end"] - found["begin"]) / _MEGABYTE], limit=LIMIT_MB, absolutes=absolutes, counted=True
        ),
        *(
            limited(f"a cycle without a wire, {count} drives", "us", [cost["cycle_us"]])
            for count, cost in costs.items()
        ),
    ]


def run(played: Stage, count: int, cycles: int, leak: int = 0) -> dict[str, float]:
    """Run the cycles in a separate process."""
    words = (str(played.folder / f"memory{count}_{cycles}"), str(count), str(cycles), str(leak))
    found: dict[str, float] = json.loads(
        played.start("canopen_control_bench.memory", *words).line(TIMEOUT_S + cycles / 1000)
    )
    return found


def grow(folder: Path, count: int, cycles: int, leak: int = 0) -> dict[str, float]:
    """Run the cycles in this process; return the results in bytes and us."""
    fleet, lost = RecordedFleet(folder, count), list[bytearray]()
    warm = max(2000, cycles // 50)
    times = [fleet.cycle() for _ in range(warm)]
    gc.collect()
    begin = resident_bytes()
    for _ in range(cycles):
        fleet.cycle()
        if leak:
            lost.append(bytearray(leak))
    fleet.check()
    gc.collect()
    end = resident_bytes()
    fleet.close()
    return {
        "begin": begin,
        "end": end,
        "frames": fleet.cycles * (4 * count + 1),
        "cycle_us": statistics.median(times) / 1000,
    }


if __name__ == "__main__":
    folder, drives, cycles, leak = sys.argv[1:5]
    sys.stdout.write(json.dumps(grow(Path(folder), int(drives), int(cycles), int(leak))) + "\n")
