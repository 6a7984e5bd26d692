"""Protocol between the bench and a measured program: one line of JSON as order, one as result.

    {"cycles": 2000, "period_ns": 1000000}        on absolute deadlines; 0: as fast as the answers come
    -> {"cycles", "missed", "tpdos", "wall_ns", "cpu_ns", "late_ns": [...], "work_ns": [...], "whole_ns": [...],
        "stalls": [...]}

`late_ns` is from the deadline to the program's first own instruction, `work_ns` from there until all frames of the
cycle are handed to the bus, `whole_ns` until what follows them is done too (ours only). `stalls` are deadline and
arrival of the cycles that came a period late or later, on the monotonic clock (ours only). `cpu_ns` is the process',
all threads; `tpdos` how many came, where the program counts them. "end" ends it. Lists are empty where nothing is
paced.
"""

from __future__ import annotations

import json
import sys
import time
from array import array
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, MutableSequence


def _numbers() -> array[int]:
    """Return an array of one number per cycle, which the garbage collector of the measured program ignores."""
    return array("q")


@dataclass(slots=True)
class Turn:
    """The results of a turn; times in ns."""

    cycles: int = 0
    missed: int = 0
    tpdos: int = 0
    wall_ns: int = 0
    cpu_ns: int = 0
    late_ns: MutableSequence[int] = field(default_factory=_numbers)
    work_ns: MutableSequence[int] = field(default_factory=_numbers)
    whole_ns: MutableSequence[int] = field(default_factory=_numbers)
    stalls: list[tuple[int, int]] = field(default_factory=list)
    others_ns: dict[str, int] = field(default_factory=dict)
    wakeups: int = 0
    others_wakeups: dict[str, int] = field(default_factory=dict)

    @property
    def cpu_us(self) -> float:
        """CPU time per cycle in us."""
        return self.cpu_ns / self.cycles / 1000

    def say(self) -> None:
        """Print it as the answer."""
        say(asdict(self))


def say(message: Mapping[str, object]) -> None:
    """Print a line of JSON and flush it."""
    sys.stdout.write(json.dumps(message, default=list) + "\n")
    sys.stdout.flush()


def serve_turns(cycle: Callable[[int], None], wait: Callable[[], None]) -> None:
    """Run the turns ordered on standard input: `cycle(n)` sends the frames, `wait()` returns when answers are in."""
    say({"ready": True})
    for line in sys.stdin:
        order = json.loads(line)
        if order == "end":
            return
        turn = Turn()
        cpu, wall = time.process_time_ns(), time.monotonic_ns()
        if order["period_ns"]:
            _paced(turn, cycle, order["cycles"], order["period_ns"])
        else:
            for number in range(order["cycles"]):
                cycle(number)
                wait()
        turn.cycles = order["cycles"]
        turn.cpu_ns, turn.wall_ns = time.process_time_ns() - cpu, time.monotonic_ns() - wall
        turn.say()


def _paced(turn: Turn, cycle: Callable[[int], None], cycles: int, period_ns: int) -> None:
    now, sleep = time.monotonic_ns, time.sleep
    edge = now()
    for number in range(cycles):
        edge += period_ns
        if (rest := edge - now()) > 0:
            sleep(rest / 1e9)
        woke = now()
        late = woke - edge
        cycle(number)
        turn.work_ns.append(now() - woke)
        turn.late_ns.append(late)
        skipped = late // period_ns
        turn.missed += skipped
        edge += skipped * period_ns
