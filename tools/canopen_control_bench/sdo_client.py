"""The SDO server of the `services` family, run as a separate process, and our client.

python -m canopen_control_bench.sdo_client        serves until the hub or whoever started it is gone
"""

from __future__ import annotations

import contextlib
import os
import select
import sys
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

from canopen_control.bus.channel import open_port
from canopen_control.cia301.abort import AbortCode
from canopen_control.cia301.sdo_codec import deliver
from canopen_control.cia301.sdo_server import SdoServer, SdoServerAbort
from canopen_control.errors import BusClosed
from canopen_control.frame import pack_records
from canopen_control.master.direct import DirectBus

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator


NODE = 3
BUS = "services"
NUMBER, BLOCK = (0x1000, 0), (0x2000, 0)
BLOCK_BYTES = 64 * 1024
_LOOK_S = 1.0


@dataclass(frozen=True, slots=True)
class Client:
    """The interface of each client: read a number, and move a block by segments or by block transfer."""

    read: Callable[[], object]
    upload: Callable[[bool], bytes]
    download: Callable[[bytes, bool], object]


class Store:
    """A number and a block."""

    def __init__(self) -> None:
        self.objects = {NUMBER: (0x20192).to_bytes(4, "little"), BLOCK: bytes(BLOCK_BYTES)}

    def upload(self, index: int, subindex: int) -> bytes:
        """Return the value of an object."""
        self.size_of(index, subindex)
        return self.objects[index, subindex]

    def download(self, index: int, subindex: int, data: bytes) -> None:
        """Set the value of an object."""
        self.size_of(index, subindex)
        self.objects[index, subindex] = data

    def size_of(self, index: int, subindex: int) -> None:
        """Abort if an object does not exist; any size is accepted."""
        if (index, subindex) not in self.objects:
            raise SdoServerAbort(AbortCode.NO_OBJECT)


@contextlib.contextmanager
def our_client() -> Iterator[Client]:
    """Return this package's client on the bus."""
    with DirectBus.open(f"local:{BUS}", label="ours", timeout_s=5.0) as bus:
        yield Client(
            lambda: bus.read(NODE, *NUMBER),
            lambda block: bus.read(NODE, *BLOCK, block=block),
            lambda data, block: bus.write(NODE, *BLOCK, data, block=block),
        )


def serve() -> None:
    """Serve until the hub or the parent process ends."""
    parent = os.getppid()
    port, server = open_port(f"local:{BUS}", label="server"), SdoServer(NODE, Store())
    sys.stdout.write("ready\n")
    sys.stdout.flush()
    with contextlib.suppress(BusClosed):
        while os.getppid() == parent:
            if not select.select([port], [], [], _LOOK_S)[0]:
                continue
            now = time.monotonic_ns()
            deliver(port.receive(), now, server.receive_records, server.receive)
            if answers := server.frames():
                port.send(pack_records(answers))
    port.close()


if __name__ == "__main__":
    serve()
