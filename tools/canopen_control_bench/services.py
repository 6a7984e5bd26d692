"""`services`: SDO and EDS against the `canopen` package in the same run, with the same server on the same bus.

Both clients live in this process and take turns; the server is ours, in a process of its own. CPU is that of this
process, all its threads; it has a processor for itself, bus and server the other. "As it comes": each on the bus that
it brings where there is no CAN, ours `local:` between processes, canopen's python-can's `virtual` between threads. What
is moved is compared with what came back first.

A round moves a block once; segments, which take canopen seconds for 64 KiB, are moved in two rounds only. EDS files are
the drive's and large ones that are made up in the shapes of public ones: the two readers take turns with each of them,
the least CPU of each counts (what neighbours of the machine take comes on top of it), and judged are the median of the
shapes' ratios and the largest, since who is slow for one shape is slow for somebody.
"""

from __future__ import annotations

import contextlib
import os
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from canopen_control.bus.local import ask_hub
from canopen_control.errors import CanopenError
from canopen_control.interop.canopen import to_canopen
from canopen_control.od.eds import read_eds
from canopen_control.rpc.messages.hub import GetHubStatus
from canopen_control_bench.eds_files import DUMMIES, SHAPES, written
from canopen_control_bench.figure import AT_LEAST, Figure, compared
from canopen_control_bench.machine import apart
from canopen_control_bench.peers.sdo_canopen import import_eds, their_client, their_virtual_client
from canopen_control_bench.sdo_client import BLOCK_BYTES, BUS, NODE, Client, our_client
from canopen_control_bench.stage import EDS, stage

if TYPE_CHECKING:
    from collections.abc import Sequence
    from contextlib import AbstractContextManager

    from canopen_control_bench.eds_files import Shape
    from canopen_control_bench.runner import Options


CANOPEN = "canopen"
CPU_LIMIT, EDS_LIMIT, LARGE_EDS_LIMIT, BLOCK_LIMIT = 0.5, 0.5, 0.35, 5.0
TRIPS, QUICK_TRIPS = 1000, 400
ROUNDS, BEST_OF, SEGMENTED_ROUNDS, LOADS, LARGE_ROUNDS, QUICK_SHAPES = 9, 20, 2, 5, 3, 3

Opener = Callable[[], "AbstractContextManager[Client]"]
Work = Callable[[Client], object]
SAME_BUS: tuple[Opener, Opener] = (our_client, their_client)
AS_THEY_COME: tuple[Opener, Opener] = (our_client, their_virtual_client)
PAYLOAD = bytes(number % 251 for number in range(BLOCK_BYTES))


@dataclass(frozen=True, slots=True)
class Spent:
    """The cost of a piece of work: CPU time of this process, and duration."""

    cpu_s: float
    wall_s: float


Pair = tuple[Spent, Spent]  # of one round, for this package and for the peer


def measure(options: Options) -> list[Figure]:
    """Measure round trips, transfers and reading an EDS."""
    trips = QUICK_TRIPS if options.quick else TRIPS
    with stage() as played:
        server = played.start("canopen_control_bench.sdo_client")
        server.line()
        for opener in (our_client, their_client, their_virtual_client):
            with opener() as client:
                check(client, PAYLOAD if not options.quick else PAYLOAD[:4096])
        others = (server.pid, ask_hub(BUS, GetHubStatus()).pid)
        with contextlib.nullcontext() if options.as_is else apart(os.getpid(), others):
            figures = [*_round_trips(trips), *_blocks(quick=options.quick)]
            if not options.quick:
                figures += _segmented()
    return [*figures, _eds(), *_large_eds(quick=options.quick)]


def check(client: Client, payload: bytes) -> None:
    """Transfer a block in both directions and in both ways; raises CanopenError if the data differ."""
    for block in (False, True):
        sent = payload[::-1] if block else payload
        client.download(sent, block)
        if (back := client.upload(block)) != sent:
            raise CanopenError(f"{len(sent)} bytes were sent and {len(back)} others came back")


def _round_trips(trips: int) -> list[Figure]:
    def expedited(client: Client) -> None:
        for _ in range(trips):
            client.read()

    rounds = _rounds(expedited, SAME_BUS, ROUNDS)
    cpu = _each(rounds, lambda spent: 1e6 * spent.cpu_s / trips)
    rate = _each(rounds, lambda spent: trips / spent.wall_s)
    return [
        compared("SDO round trip, same bus: CPU", "us", cpu, peer_name=CANOPEN, limit=CPU_LIMIT),
        compared("SDO round trips, same bus", "1/s", rate, peer_name=CANOPEN),
    ]


def _blocks(*, quick: bool) -> list[Figure]:
    """Compare CPU time, and throughput of the best round, since throughput depends on other processes."""
    figures = []
    for name, move in (
        ("block download", lambda client: client.download(PAYLOAD, True)),
        ("block upload", lambda client: client.upload(True)),
    ):
        cpu = _each(_rounds(move, SAME_BUS, ROUNDS), lambda spent: 1e3 * spent.cpu_s)
        figures.append(compared(f"{name}, same bus: CPU", "ms", cpu, peer_name=CANOPEN, limit=CPU_LIMIT))
        if quick:
            continue
        ours, theirs = zip(*_each(_rounds(move, AS_THEY_COME, BEST_OF), _kilobytes), strict=True)
        best = [(max(ours), max(theirs))]
        figures.append(
            compared(f"{name}, as it comes", "kB/s", best, peer_name=CANOPEN, limit=BLOCK_LIMIT, direction=AT_LEAST)
        )
    return figures


def _segmented() -> list[Figure]:
    return [
        compared(
            f"segmented {name}, same bus",
            "kB/s",
            _each(_rounds(move, SAME_BUS, SEGMENTED_ROUNDS), _kilobytes),
            peer_name=CANOPEN,
        )
        for name, move in (
            ("download", lambda client: client.download(PAYLOAD, False)),
            ("upload", lambda client: client.upload(False)),
        )
    ]


def _rounds(work: Work, openers: tuple[Opener, Opener], rounds: int) -> list[Pair]:
    """Run both in turns; a server has one client at a time, so each reconnects for its turn."""
    found = []
    for _ in range(rounds):
        ours, theirs = (_spent(work, opener) for opener in openers)
        found.append((ours, theirs))
    return found


def _spent(work: Work, opener: Opener) -> Spent:
    with opener() as client:
        client.read()  # connected and warmed up
        cpu, wall = time.process_time(), time.perf_counter()
        work(client)
        return Spent(time.process_time() - cpu, time.perf_counter() - wall)


def _each(rounds: Sequence[Pair], quantity: Callable[[Spent], float]) -> list[tuple[float, float]]:
    """Return a quantity of each round, ours first."""
    return [(quantity(ours), quantity(theirs)) for ours, theirs in rounds]


def _kilobytes(spent: Spent) -> float:
    return BLOCK_BYTES / spent.wall_s / 1e3


def _eds() -> Figure:
    """Read the same EDS with both packages; their dictionaries must be equal."""
    if len(to_canopen(read_eds(EDS, NODE).od)) != len(import_eds(EDS, NODE)):
        raise CanopenError(f"{EDS}: the two readers do not find the same objects")
    return compared("EDS load, TMCM-1270: CPU", "ms", _loads(EDS, ROUNDS, LOADS), peer_name=CANOPEN, limit=EDS_LIMIT)


def _large_eds(*, quick: bool) -> list[Figure]:
    """Read a file of each shape with both packages; show the median, some shapes, and the worst one."""
    shapes = SHAPES[:QUICK_SHAPES] if quick else SHAPES
    with tempfile.TemporaryDirectory() as folder:
        figures = [_shape(shape, Path(folder, "large.eds")) for shape in shapes]
    rounds = [(figure.ours, figure.peer or 0.0) for figure in figures]
    worst = max(figures, key=lambda figure: figure.judged)
    ratios = {figure.name: figure.judged for figure in figures}
    return [
        compared(
            f"EDS load, {len(shapes)} large files: CPU",
            "ms",
            rounds,
            peer_name=CANOPEN,
            limit=None if quick else LARGE_EDS_LIMIT,
            absolutes=ratios,
        ),
        replace(worst, name=f"the least good of them ({worst.name})", limit=1.0),
    ]


def _shape(shape: Shape, path: Path) -> Figure:
    path.write_bytes(written(shape))
    ours, theirs = len(read_eds(path, NODE).od.objects), len(import_eds(str(path), NODE)) - DUMMIES
    if ours != theirs:
        raise CanopenError(f"{shape.name}: the two readers find {ours} and {theirs} objects")
    loads = _loads(str(path), LARGE_ROUNDS, 1)
    best = [(min(ours for ours, _ in loads), min(theirs for _, theirs in loads))]
    return compared(shape.name, "ms", best, peer_name=CANOPEN)


def _loads(path: str, rounds: int, loads: int) -> list[tuple[float, float]]:
    """Return the CPU time in ms of one load per round, ours and theirs."""

    def milliseconds(load: Callable[[], object]) -> float:
        begin = time.process_time()
        for _ in range(loads):
            load()
        return 1e3 * (time.process_time() - begin) / loads

    return [
        (milliseconds(lambda: read_eds(path, NODE)), milliseconds(lambda: import_eds(path, NODE)))
        for _ in range(rounds)
    ]
