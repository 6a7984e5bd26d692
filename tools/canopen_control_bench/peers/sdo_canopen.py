"""The `canopen` package as SDO client: on our bus through python-can's plugin, and on python-can's own bus.

Its own server has no block transfer, so ours serves it on python-can's `virtual` bus too.
"""

from __future__ import annotations

import contextlib
import time
from typing import TYPE_CHECKING

import can
import canopen

from canopen_control.cia301.sdo_server import SdoServer
from canopen_control.frame import CanFrame
from canopen_control_bench.peers.canopen_pdo import LEAVE_S
from canopen_control_bench.sdo_client import BLOCK, BUS, NODE, NUMBER, Client, Store

if TYPE_CHECKING:
    from collections.abc import Iterator


_SEGMENT = 7  # its writers transfer one segment at a time
_ANSWER_S = 5.0


class VirtualServer:
    """Our server on a thread, on python-can's own bus."""

    def __init__(self) -> None:
        self._bus = can.Bus(interface="virtual", channel=BUS)
        self._server = SdoServer(NODE, Store())
        self._notifier = can.Notifier(self._bus, [self._answer], timeout=0.1)

    def _answer(self, message: can.Message) -> None:
        self._server.receive(CanFrame(message.arbitration_id, bytes(message.data)), time.monotonic_ns())
        for can_id, data in self._server.frames():
            self._bus.send(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))

    def close(self) -> None:
        """Leave the bus."""
        self._notifier.stop()
        self._bus.shutdown()


@contextlib.contextmanager
def their_virtual_client() -> Iterator[Client]:
    """Client and server on threads of this process, in the default configuration of the package."""
    served = VirtualServer()
    try:
        with their_client("virtual") as client:
            yield client
    finally:
        served.close()


@contextlib.contextmanager
def their_client(interface: str = "canopen_control") -> Iterator[Client]:
    """Return a client on a bus of python-can."""
    network = canopen.Network(can.Bus(interface=interface, channel=BUS))
    network.NOTIFIER_CYCLE = LEAVE_S
    network.connect()
    node = canopen.RemoteNode(NODE, canopen.ObjectDictionary())  # type: ignore[no-untyped-call]  # it is untyped
    network.add_node(node)
    node.sdo.RESPONSE_TIMEOUT = _ANSWER_S

    def upload(block: bool) -> bytes:
        with node.sdo.open(*BLOCK, "rb", block_transfer=block) as file:
            return bytes(file.read())

    def download(data: bytes, block: bool) -> None:
        with node.sdo.open(*BLOCK, "wb", size=len(data), block_transfer=block, buffering=0) as file:
            for start in range(0, len(data), _SEGMENT):
                file.write(data[start : start + _SEGMENT])

    try:
        yield Client(lambda: node.sdo.upload(*NUMBER), upload, download)
    finally:
        network.disconnect()


def import_eds(path: str, node_id: int) -> canopen.ObjectDictionary:
    """Read an EDS with the package."""
    return canopen.import_od(path, node_id)
