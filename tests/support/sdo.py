"""A store, a perfect wire and a bad one between an SDO client and an SDO server, on a manual clock."""

from __future__ import annotations

import random
from collections import deque
from typing import TYPE_CHECKING

from canopen_control.cia301.sdo_server import SdoServer, SdoServerAbort
from canopen_control.frame import CanFrame

if TYPE_CHECKING:
    from canopen_control.cia301.sdo_client import SdoClient
    from canopen_control.cia301.sdo_exchange import SdoRequest

NODE = 3
MS = 1_000_000
SECOND = 1_000_000_000


def frame(text: str) -> CanFrame:
    """Make a frame of candump's log form."""
    identifier, data = text.split("#")
    return CanFrame(int(identifier, 16), bytes.fromhex(data))


class MemoryStore:
    """Objects as bytes; `aborts` maps (index, subindex) to the code that every access gets."""

    def __init__(self, objects: dict[tuple[int, int], bytes] | None = None) -> None:
        self.objects = {(0x1000, 0): b"\x92\x01\x04\x00", (0x1001, 0): b"\0"} | (objects or {})
        self.aborts: dict[tuple[int, int], int] = {}
        self.sizes: dict[tuple[int, int], int] = {}
        self.uploads = 0
        self.downloads: list[tuple[int, int, bytes]] = []

    def upload(self, index: int, subindex: int) -> bytes:
        self._check(index, subindex)
        self.uploads += 1
        return self.objects[index, subindex]

    def download(self, index: int, subindex: int, data: bytes) -> None:
        self._check(index, subindex)
        size = self.sizes.get((index, subindex))
        if size is not None and len(data) != size:
            raise SdoServerAbort(0x06070012 if len(data) > size else 0x06070013)
        self.downloads.append((index, subindex, data))
        self.objects[index, subindex] = data

    def size_of(self, index: int, subindex: int) -> int | None:
        self._check(index, subindex)
        return self.sizes.get((index, subindex))

    def _check(self, index: int, subindex: int) -> None:
        code = self.aborts.get((index, subindex))
        if code is None and (index, subindex) not in self.objects:
            code = 0x06020000
        if code is not None:
            raise SdoServerAbort(code)


class Line:
    """Client and server with nothing between them; keeps what was said."""

    def __init__(self, client: SdoClient, server: SdoServer) -> None:
        self.client, self.server = client, server
        self.now = 0
        self.said: list[str] = []

    def run(self) -> None:
        """Carry frames until both are silent."""
        silent = False
        while not silent:
            silent = True
            for side, other in ((self.client, self.server), (self.server, self.client)):
                for one in side.frames():
                    silent = False
                    self.said.append(str(one))
                    other.receive(one, self.now)


class BadLine:
    """Frames get lost, doubled and late; those of one direction keep their order, as on a CAN bus."""

    def __init__(
        self,
        client: SdoClient,
        server: SdoServer,
        seed: int,
        *,
        loss: float = 0.0,
        double: float = 0.0,
        late: float = 0.0,
    ) -> None:
        self.client, self.server = client, server
        self.random = random.Random(seed)
        self.loss, self.double, self.late = loss, double, late
        self.now = 1
        self._ways: tuple[deque[tuple[int, CanFrame]], deque[tuple[int, CanFrame]]] = (deque(), deque())

    def run(self, request: SdoRequest, limit_ns: int = 3600 * SECOND) -> None:
        """Let time pass until `request` is done."""
        end = self.now + limit_ns
        self._drain()
        while not request.done:
            self.step()
            assert self.now < end, "the request never ends"

    def step(self) -> None:
        """Jump to the next thing that happens."""
        times = [way[0][0] for way in self._ways if way]
        times += [t for core in (self.client, self.server) if (t := core.next_deadline()) is not None]
        self.now = max(self.now, min(times))
        for way, core in zip(self._ways, (self.server, self.client), strict=True):
            while way and way[0][0] <= self.now:
                core.receive(way.popleft()[1], self.now)
        self.client.tick(self.now)
        self.server.tick(self.now)
        self._drain()

    def _drain(self) -> None:
        for way, core in zip(self._ways, (self.client, self.server), strict=True):
            for one in core.frames():
                self._put(way, one)

    def _put(self, way: deque[tuple[int, CanFrame]], one: CanFrame) -> None:
        if self.random.random() < self.loss:
            return
        delay = self.random.randrange(900 * MS) if self.random.random() < self.late else 100_000
        arrival = max(self.now + delay, way[-1][0] if way else 0)
        way.append((arrival, one))
        if self.random.random() < self.double:
            way.append((arrival, one))
