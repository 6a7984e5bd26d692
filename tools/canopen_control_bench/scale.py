"""`scale`: from 2 to 126 drives on one bus, and on several: CPU time of the complete runtime per drive and cycle.

CPU is measured free-running, one cycle after the other. Then the same robot runs at the shortest period that a bus of
1 Mbit/s has room for, by the worst case of its frames (`canopen_control.master.budget`), on a hub that takes as long
for each frame as that wire. What other bit rates leave is told by arithmetic.
"""

from __future__ import annotations

import functools
from dataclasses import replace
from typing import TYPE_CHECKING

from canopen_control.bus.local import ask_hub
from canopen_control.errors import CanopenError
from canopen_control.master.budget import budget_of
from canopen_control.master.config import read_bus
from canopen_control.rpc.messages.hub import GetHubStatus, SetBitrate
from canopen_control.rpc.messages.robot import GetStatus
from canopen_control_bench.cycle import CANOPEN, OURS, Arena, absolutes_of, ask_robot, rounds_of
from canopen_control_bench.figure import AT_LEAST, Figure, compared, limited
from canopen_control_bench.fleet import write_fleet
from canopen_control_bench.stage import Contender, Stage, stage

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control_bench.runner import Options
    from canopen_control_bench.turns import Turn


MAX = 126  # drives: 127 nodes together with the master
COUNTS = (2, 8, 16, 32, 64, MAX)
QUICK_COUNTS = (2, 16)
LIMITS_US = {16: 8.0, 64: 6.0}
CANOPEN_LIMIT, FLAT_LIMIT = 0.25, 1.05
DRIVES_LIMIT = 1 / 3  # fraction of a core, for 64 virtual drives in one process at 100 Hz
BUSES_LIMIT = 0.5  # fraction of a core, for a runtime with eight buses of 16 drives at 100 Hz
BITRATES = (125_000, 250_000, 500_000, 1_000_000)
ROUNDS, QUICK_ROUNDS = 5, 3
_FREE_PERIOD_US = 10_000
_PACED_S = 10.0
_CYCLES = 500
_DRIVE_US = 500  # maximum cycle time of a virtual drive while it boots, on a busy machine
_GRANULE_US = 500
FULL = 0.95  # mean fraction of the bandwidth; SDO and EMCY use the rest
_LATE = 10  # last cycles whose TPDOs may be in transit, since a machine may be busy for that long


def measure(options: Options) -> list[Figure]:
    """Measure each size; the peer is the canopen package with 16 drives."""
    figures: list[Figure] = []
    per_drive: dict[int, list[float]] = {}
    for count in QUICK_COUNTS if options.quick else COUNTS:
        names = (OURS, CANOPEN) if count == 16 else (OURS,)
        cycles = max(100, (4000 if options.quick else 8000) // count)
        with stage() as played:
            arena = Arena(played, count, max(_FREE_PERIOD_US, count * _DRIVE_US), base=False)
            run = functools.partial(Contender.turn, cycles=cycles, period_ns=0)
            rounds = QUICK_ROUNDS if options.quick else ROUNDS
            turns = rounds_of(arena, names, rounds, run, as_is=options.as_is)
            per_drive[count] = [turn.cpu_us / count for turn in turns[OURS]]
            figures += _figures(count, turns, options)
            if not options.quick:
                figures.append(_on_the_wire(arena, options.seconds or _PACED_S))
    smallest, largest = min(per_drive), max(per_drive)
    flat = list(zip(per_drive[largest], per_drive[smallest], strict=True))
    figures.append(
        compared(f"CPU for each drive, {largest}", "us", flat, peer_name=f"{smallest} drives", limit=FLAT_LIMIT)
    )
    if not options.quick:
        figures += [_several_buses(buses, per_drive[16], as_is=options.as_is) for buses in (2, 4)]
        figures += [_virtual_drives(), _eight_buses()]
    return figures


def _figures(count: int, turns: dict[str, list[Turn]], options: Options) -> list[Figure]:
    ours = [turn.cpu_us / count for turn in turns[OURS]]
    found = [
        limited(
            f"{count} drives: CPU for each drive and cycle",
            "us",
            ours,
            limit=None if options.quick else LIMITS_US.get(count),
            absolutes=absolutes_of(turns[OURS]),
        )
    ]
    if CANOPEN in turns:
        rounds = [(mine.cpu_us, peer.cpu_us) for mine, peer in zip(turns[OURS], turns[CANOPEN], strict=True)]
        found.append(compared(f"{count} drives: CPU of a cycle", "us", rounds, peer_name=CANOPEN, limit=CANOPEN_LIMIT))
    return found


def shortest_period_us(played: Stage, count: int, bitrate: int) -> int:
    """Return the shortest period at which the frames of the drives fill a bus to `FULL`, heartbeats included."""
    folder = played.folder / f"budget{bitrate}"
    config = read_bus(write_fleet(folder, count, _FREE_PERIOD_US) / "bus.yml")
    period_us = _GRANULE_US
    while True:
        period_us += _GRANULE_US
        budget = replace(budget_of(config, period_us * 1000), bitrate=bitrate)
        if budget.load <= FULL and budget.fits:
            return period_us


def _on_the_wire(arena: Arena, seconds: float) -> Figure:
    """Run at the shortest period on a hub as slow as the wire; no frame and no cycle may be missing."""
    periods = {bitrate: shortest_period_us(arena.stage, arena.count, bitrate) for bitrate in BITRATES}
    period_us = periods[max(BITRATES)]
    arena.pace(period_us)
    cycles = round(seconds * 1e6 / period_us)
    with arena.contender(OURS, check=False) as contender:
        ask_hub(arena.buses[0], SetBitrate(max(BITRATES)))
        turn = contender.turn(cycles, period_us * 1000)
        status = ask_robot(GetStatus())
        hub = ask_hub(arena.buses[0], GetHubStatus())
        ask_hub(arena.buses[0], SetBitrate(0))
    lost = [f"{name}: {node.error}" for name, node in status.nodes.items() if not node.ready or node.error]
    said = [event.text for event in status.events]
    if hub.dropped:
        lost.append(f"the hub dropped {hub.dropped} frames")
    if lost or status.state != "running":
        raise CanopenError(
            f"{arena.count} drives, each {period_us} us: {status.state}, {'; '.join(lost[:3] or said[-3:])}"
        )
    return limited(
        f"{arena.count} drives at 1 Mbit/s, each {period_us / 1000:g} ms: TPDOs of those due",
        "",
        [_share_of_tpdos(turn, arena.count)],
        limit=1.0,
        direction=AT_LEAST,
        absolutes={
            **absolutes_of([turn]),
            "core %": round(100 * turn.cpu_ns / turn.wall_ns, 1),
            "bus load": round(hub.load or 0.0, 2),
            **{f"period at {rate // 1000}k ms": period / 1000 for rate, period in periods.items()},
        },
    )


def _several_buses(count: int, on_one: Sequence[float], *, as_is: bool) -> Figure:
    """Distribute sixteen drives over several buses; the peer is a single bus."""
    with stage() as played:
        arena = Arena(played, 16, _FREE_PERIOD_US, base=False, buses=[f"bench{number}" for number in range(count)])
        run = functools.partial(Contender.turn, cycles=_CYCLES, period_ns=0)
        turns = rounds_of(arena, (OURS,), ROUNDS, run, check=False, as_is=as_is)[OURS]
    rounds = [(turn.cpu_us / 16, alone) for turn, alone in zip(turns, on_one, strict=True)]
    return compared(
        f"16 drives on {count} buses: CPU for each drive",
        "us",
        rounds,
        peer_name="1 bus",
        absolutes=absolutes_of(turns),
    )


def _virtual_drives() -> Figure:
    """Measure the cost of 64 virtual drives in one process at a cycle of 10 ms."""
    turn, absolutes = _at_100_hz(64)
    cores = turn.others_ns["drives"] / turn.wall_ns
    return limited("64 virtual drives at 10 ms: cores", "", [cores], limit=DRIVES_LIMIT, absolutes=absolutes)


def _eight_buses() -> Figure:
    """Measure the cost of 16 drives on each of eight buses for the runtime at a cycle of 10 ms."""
    turn, absolutes = _at_100_hz(16 * 8, 8)
    cores = turn.cpu_ns / turn.wall_ns
    return limited("8 buses of 16 drives at 10 ms: cores", "", [cores], limit=BUSES_LIMIT, absolutes=absolutes)


def _at_100_hz(count: int, buses: int = 1) -> tuple[Turn, dict[str, float | str]]:
    """Run live drives at a cycle of 10 ms; CanopenError if a TPDO is missing."""
    with stage() as played:
        names = [f"bench{number}" for number in range(buses)]
        arena = Arena(played, count, _FREE_PERIOD_US, base=False, buses=names)
        with arena.contender(OURS, check=False) as contender:
            turn = contender.turn(_CYCLES, _FREE_PERIOD_US * 1000)
    came = _share_of_tpdos(turn, count)
    if came < 1.0:
        raise CanopenError(f"{count} drives each 10 ms: {came:.4f} of the TPDOs came")
    return turn, {**absolutes_of([turn]), "TPDOs of those due": came}


def _share_of_tpdos(turn: Turn, count: int) -> float:
    """Return the share of due TPDOs that arrived; 1.0 if all did."""
    return min(1.0, turn.tpdos / (2 * count * max(1, turn.cycles - _LATE)))
