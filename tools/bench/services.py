#!/usr/bin/env python3
"""SDO and EDS, measured beside the `canopen` package in the same run, against the same server on the same bus.

Both clients live in this process and take turns: this package's `DirectBus`, and canopen's `RemoteNode`. The server is
this package's, in a process of its own. CPU is that of this process, all its threads; server and hub do not count.
Every figure is the best of several rounds, taken in turn. The EDS is TMCM-1270.eds, parsed anew each time.

"Same bus": canopen joins our `local:` bus by python-can's plugin; both wait for the same server and hub. "As it comes":
each on the bus that it brings where there is no CAN, ours `local:` between processes, canopen on python-can's `virtual`
between threads; canopen's own server has no block transfer, so ours serves it there too.

    tools/bench/services.py            figures and ratios
    tools/bench/services.py --json     the same as JSON
    tools/bench/services.py --check    exit 1 when a ratio is worse than it must be
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import select
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import can
import canopen

from canopen_control.bus.channel import open_port
from canopen_control.cia301.sdo_records import deliver
from canopen_control.cia301.sdo_server import SdoServer, SdoServerAbort
from canopen_control.data_files import data_path
from canopen_control.errors import BusClosed
from canopen_control.frame import CanFrame, pack_records
from canopen_control.interop.canopen import to_canopen
from canopen_control.master.direct import DirectBus
from canopen_control.od.eds import read_eds

if TYPE_CHECKING:
    from collections.abc import Iterator
    from contextlib import AbstractContextManager

NODE = 3
BUS = "services-bench"
EDS = data_path("eds", "TMCM-1270.eds")
NUMBER, BLOCK = (0x1000, 0), (0x2000, 0)
BLOCK_BYTES = 64 * 1024
ROUNDS = 7
CHECKED_ROUNDS = 20  # of what has a limit and waits for other processes: few rounds are undisturbed


@dataclass(frozen=True)
class Figure:
    """One quantity, ours and theirs; `ratio` is ours by theirs, `limit` what it must not pass, None if only shown."""

    name: str
    unit: str
    ours: float
    theirs: float
    limit: float | None = None
    wants_more: bool = False

    @property
    def ratio(self) -> float:
        return self.ours / self.theirs

    @property
    def good(self) -> bool:
        return self.limit is None or (self.ratio >= self.limit if self.wants_more else self.ratio <= self.limit)


# --- the server, in a process of its own ---


class Store:
    """A number and a block."""

    def __init__(self) -> None:
        self.objects = {NUMBER: (0x20192).to_bytes(4, "little"), BLOCK: bytes(BLOCK_BYTES)}

    def upload(self, index: int, subindex: int) -> bytes:
        self.size_of(index, subindex)
        return self.objects[index, subindex]

    def download(self, index: int, subindex: int, data: bytes) -> None:
        self.size_of(index, subindex)
        self.objects[index, subindex] = data

    def size_of(self, index: int, subindex: int) -> None:
        if (index, subindex) not in self.objects:
            raise SdoServerAbort(0x06020000)


def serve() -> None:
    """Answer until the hub or whoever started this process is gone."""
    parent = os.getppid()
    port, server = open_port(f"local:{BUS}", label="server"), SdoServer(NODE, Store())
    print("ready", flush=True)
    with contextlib.suppress(BusClosed):
        while os.getppid() == parent:
            if not select.select([port], [], [], 1.0)[0]:
                continue
            now = time.monotonic_ns()
            deliver(port.receive(), now, server.receive_records, server.receive)
            if answers := server.frames():
                port.send(pack_records(answers))
    port.close()


class VirtualServer:
    """The same server on a thread, on python-can's own bus."""

    def __init__(self) -> None:
        self._bus = can.Bus(interface="virtual", channel=BUS)
        self._server = SdoServer(NODE, Store())
        self._notifier = can.Notifier(self._bus, [self._answer], timeout=0.1)

    def _answer(self, message: can.Message) -> None:
        self._server.receive(CanFrame(message.arbitration_id, bytes(message.data)), time.monotonic_ns())
        for can_id, data in self._server.frames():
            self._bus.send(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))

    def close(self) -> None:
        self._notifier.stop()
        self._bus.shutdown()


@contextlib.contextmanager
def server() -> Iterator[None]:
    """Start the server in folders of its own, so that no other bus is touched, and end it afterwards."""
    with tempfile.TemporaryDirectory(prefix="bench-") as folder:
        os.environ.update(XDG_RUNTIME_DIR=folder, XDG_STATE_HOME=folder + "/state", _ROS_WHEELS_BOOTSTRAP_COMPLETE="1")
        process = subprocess.Popen([sys.executable, __file__, "--serve"], stdout=subprocess.PIPE, text=True)
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "ready\n", "the server does not start"
            yield
        finally:
            process.terminate()
            process.wait(10)
            assert process.stdout is not None
            process.stdout.close()


# --- the two clients ---


@dataclass(frozen=True)
class Client:
    """What both can do: read a number, and move a block by segments or by block transfer."""

    read: Callable[[], object]
    upload: Callable[[bool], bytes]
    download: Callable[[bytes, bool], object]


@contextlib.contextmanager
def our_client() -> Iterator[Client]:
    with DirectBus.open(f"local:{BUS}", label="ours", timeout_s=5.0) as bus:
        yield Client(
            lambda: bus.read(NODE, *NUMBER),
            lambda block: bus.read(NODE, *BLOCK, block=block),
            lambda data, block: bus.write(NODE, *BLOCK, data, block=block),
        )


@contextlib.contextmanager
def their_virtual_client() -> Iterator[Client]:
    served = VirtualServer()
    try:
        with their_client("virtual") as client:
            yield client
    finally:
        served.close()


@contextlib.contextmanager
def their_client(interface: str = "canopen_control") -> Iterator[Client]:
    network = canopen.Network(can.Bus(interface=interface, channel=BUS))
    network.connect()
    node = canopen.RemoteNode(NODE, canopen.ObjectDictionary())  # type: ignore[no-untyped-call]  # canopen leaves it untyped
    network.add_node(node)
    node.sdo.RESPONSE_TIMEOUT = 5.0

    def upload(block: bool) -> bytes:
        with node.sdo.open(*BLOCK, "rb", block_transfer=block) as file:
            return bytes(file.read())

    def download(data: bytes, block: bool) -> None:
        with node.sdo.open(*BLOCK, "wb", size=len(data), block_transfer=block, buffering=0) as file:
            for start in range(0, len(data), 7):  # its writers take a segment at a time
                file.write(data[start : start + 7])

    try:
        yield Client(lambda: node.sdo.upload(*NUMBER), upload, download)
    finally:
        network.disconnect()


# --- measuring ---


Opener = Callable[[], "AbstractContextManager[Client]"]
Pair = tuple[float, float]  # ours, theirs
SAME_BUS: tuple[Opener, Opener] = (our_client, their_client)
AS_THEY_COME: tuple[Opener, Opener] = (our_client, their_virtual_client)


def best(
    work: Callable[[Client], object], clock: Callable[[], float], openers: tuple[Opener, Opener], rounds: int = ROUNDS
) -> Pair:
    """Return the shortest time of each client, ours first; a server has one client at a time, so they come and go."""
    times = [float("inf")] * len(openers)
    for _ in range(rounds):
        for number, opener in enumerate(openers):
            with opener() as client:
                client.read()  # connected and warm
                begin = clock()
                work(client)
                times[number] = min(times[number], clock() - begin)
    ours, theirs = times
    return ours, theirs


def measure_sdo(trips: int) -> Iterator[Figure]:
    payload = bytes(n % 251 for n in range(BLOCK_BYTES))

    def expedited(client: Client) -> None:
        for _ in range(trips):
            client.read()

    def check(client: Client) -> None:
        for block in (False, True):
            client.download(payload[::-1] if block else payload, block)
            assert client.upload(block) == (payload[::-1] if block else payload), "what came back is not what was sent"

    moves: list[tuple[str, Callable[[Client], object]]] = [
        ("segmented download", lambda client: client.download(payload, False)),
        ("segmented upload", lambda client: client.upload(False)),
        ("block download", lambda client: client.download(payload, True)),
        ("block upload", lambda client: client.upload(True)),
    ]
    with server():
        for openers in (SAME_BUS, AS_THEY_COME):
            for opener in openers:
                with opener() as client:
                    check(client)
        cpu = best(expedited, time.process_time, SAME_BUS, CHECKED_ROUNDS)
        yield Figure(
            "SDO CPU per round trip, same bus", "us", *_each(cpu, lambda seconds: 1e6 * seconds / trips), limit=0.5
        )
        rates = best(expedited, time.perf_counter, SAME_BUS)
        yield Figure("SDO round trips, same bus", "1/s", *_each(rates, lambda seconds: trips / seconds))
        for name, move in moves:
            yield Figure(f"{name}, same bus", "kB/s", *_throughput(move, SAME_BUS), wants_more=True)
        for name, move in moves[2:]:
            cpu = best(move, time.process_time, SAME_BUS)
            yield Figure(f"{name} CPU, same bus", "ms", *_each(cpu, lambda seconds: 1e3 * seconds))
            yield Figure(
                f"{name}, as it comes",
                "kB/s",
                *_throughput(move, AS_THEY_COME, CHECKED_ROUNDS),
                limit=5.0,
                wants_more=True,
            )


def _throughput(move: Callable[[Client], object], openers: tuple[Opener, Opener], rounds: int = ROUNDS) -> Pair:
    return _each(best(move, time.perf_counter, openers, rounds), lambda seconds: BLOCK_BYTES / seconds / 1e3)


def _each(times: Pair, quantity: Callable[[float], float]) -> Pair:
    ours, theirs = times
    return quantity(ours), quantity(theirs)


def measure_eds(loads: int) -> Figure:
    def run(load: Callable[[], object]) -> float:
        times = []
        for _ in range(loads):
            begin = time.perf_counter()
            load()
            times.append(time.perf_counter() - begin)
        return 1e3 * min(times)

    assert len(to_canopen(read_eds(EDS, NODE).od)) == len(canopen.import_od(str(EDS), NODE)), "not the same dictionary"
    ours, theirs = run(lambda: read_eds(EDS, NODE)), run(lambda: canopen.import_od(str(EDS), NODE))
    return Figure("EDS load, TMCM-1270", "ms", ours, theirs, limit=0.5)


def table(figures: list[Figure]) -> str:
    lines = [f"{'':<34}{'canopen_control':>18}{'canopen':>14}{'ratio':>9}  must be"]
    for each in figures:
        must = "" if each.limit is None else f"{'at least' if each.wants_more else 'at most'} {each.limit:g}"
        verdict = "" if each.good else "   MISSED"
        numbers = f"{each.ours:>12.1f} {each.unit:<5}{each.theirs:>8.1f} {each.unit:<5}{each.ratio:>9.2f}"
        lines.append(f"{each.name:<34}{numbers}  {must}{verdict}".rstrip())
    return "\n".join(lines)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="exit 1 when a ratio is worse than it must be")
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument("--trips", type=int, default=2000, metavar="N", help="round trips per measurement")
    parser.add_argument("--serve", action="store_true", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.serve:
        serve()
        return 0
    figures = [*measure_sdo(args.trips), measure_eds(10)]
    if args.json:
        print(json.dumps([{**asdict(each), "ratio": each.ratio, "good": each.good} for each in figures], indent=2))
    else:
        print(table(figures))
    return 1 if args.check and not all(each.good for each in figures) else 0


if __name__ == "__main__":
    sys.exit(main())
