"""`load`: a full bus of 1 Mbit/s, received, decoded and supervised by the complete runtime.

8,749 frames a second is what such a wire carries of frames with 8 bytes, mean stuffing (114.3 bits each). They reach
the runtime one by one, as from a wire: TPDOs of eight drives, their own on SYNC and a talker's in between, and their
heartbeats. Each one is counted where it was decoded: one that is missing fails the run.
"""

from __future__ import annotations

import json
import time
from typing import TYPE_CHECKING

from canopen_control.bus.local import ask_hub
from canopen_control.errors import CanopenError
from canopen_control.rpc.messages.hub import DropFrames, GetHubStatus
from canopen_control_bench.cycle import OURS, Arena, absolutes_of
from canopen_control_bench.figure import Figure, limited
from canopen_control_bench.stage import stage

if TYPE_CHECKING:
    from canopen_control_bench.runner import Options
    from canopen_control_bench.turns import Turn


FULL_BUS = 8749  # frames/s
LIMIT = 0.35  # fraction of a core
DRIVES, PERIOD_US = 8, 20_000
ROUNDS = 5
# frames/s of the drives: two TPDOs per cycle, ten heartbeats a second
_OWN = DRIVES * (2 * 1_000_000 // PERIOD_US + 10)
SECONDS = 4.0
_MARGIN = 10  # cycles before and after the extra traffic


def measure(options: Options) -> list[Figure]:
    """Measure the CPU use of the runtime on a full bus; a quick run is too unsteady to measure this."""
    if options.quick:
        return []
    with stage() as played:
        arena = Arena(played, DRIVES, PERIOD_US, base=False)
        turns = [full_turn(arena, SECONDS) for _ in range(ROUNDS)]
    cores = [turn.cpu_ns / turn.wall_ns for turn in turns]
    received = [turn.tpdos * 1e9 / turn.wall_ns for turn in turns]
    absolutes = {"TPDOs/s": round(sum(received) / len(received)), **absolutes_of(turns)}
    return [limited("a full bus of 1 Mbit/s: cores", "", cores, limit=LIMIT, absolutes=absolutes)]


def full_turn(arena: Arena, seconds: float, *, drop: int = 0) -> Turn:
    """Run the robot on a full bus; raises CanopenError if a frame is missing. `drop` loses some, to test this check."""
    with arena.contender(OURS, check=False) as contender:
        nodes, rate = arena.nodes, FULL_BUS - _OWN
        words = (arena.channel, str(nodes[0]), str(arena.count), str(rate), str(seconds))
        talker = arena.stage.start("canopen_control_bench.talker", *words)
        talker.line()
        if drop:
            ask_hub(arena.buses[0], DropFrames(can_id=0x280 + nodes[0], count=drop))
        cycles = round(seconds * 1e6 / PERIOD_US)
        contender.others["talker"] = talker.pid
        contender.order(cycles + _MARGIN, PERIOD_US * 1000)
        time.sleep(_MARGIN / 2 * PERIOD_US / 1e6)
        talker.tell("go")
        sent = json.loads(talker.line())["sent"]
        turn = contender.answer()
        dropped = ask_hub(arena.buses[0], GetHubStatus()).dropped
    due = sent + 2 * arena.count * (turn.cycles - 1)
    if turn.tpdos < due or dropped:
        raise CanopenError(f"{due - turn.tpdos} of {due} TPDOs are missing, the hub dropped {dropped}")
    return turn
