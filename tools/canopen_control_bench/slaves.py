"""The slaves of the bench: virtual drives that can answer a SYNC with almost no work.

    python -m canopen_control_bench.slaves CHANNEL FIRST_NODE COUNT

Live they are the drives of `canopen-control drive`. On the line "replay" each SYNC is answered with the TPDOs that they
sent last, positions moving, as drives of iron do it: without a processor of this machine. Everything but SYNC and RPDOs
still reaches the drives, and their heartbeats go on. "live" gives them the bus back.
"""

from __future__ import annotations

import os
import signal
import struct
import sys
from typing import TYPE_CHECKING

from canopen_control.bus.channel import open_port
from canopen_control.data_files import data_path
from canopen_control.frame import RECORD, RECORD_SIZE, CanFrame, pack_records
from canopen_control.host.reactor import Reactor
from canopen_control.virtual.control import NodeControl
from canopen_control.virtual.device import make_device
from canopen_control.virtual.node_host import NodeHost

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.bus.port import BusEvent, Port, PortStats, Records


_SYNC = 0x080
_TPDOS, _RPDOS = (0x180, 0x280), (0x200, 0x300)
_VARIANTS = 64
_STEP = 50  # counts


class ReplayPort:
    """A port that stores the latest TPDO of each COB-ID, and answers SYNCs with them while `replaying`."""

    def __init__(self, port: Port) -> None:
        self._port = port
        self.channel = port.channel
        self.replaying = False
        self._newest: dict[int, bytes] = {}
        self._answers: list[bytes] = []
        self._number = 0

    @property
    def stats(self) -> PortStats:
        """The statistics of the port."""
        return self._port.stats

    @property
    def wants_write(self) -> bool:
        """Whether the port has frames to write."""
        return self._port.wants_write

    def replay(self, on: bool) -> None:
        """Start answering by itself, or return control of the bus to the drives."""
        self.replaying = on
        self._answers = replays([CanFrame(can_id, data) for can_id, data in self._newest.items()])

    def fileno(self) -> int:
        """Return the port's descriptor."""
        return self._port.fileno()

    def receive(self) -> bytes:
        """Return the received frames that the drives are to process."""
        records = self._port.receive()
        if not self.replaying:
            return records
        left = bytearray()
        for start in range(0, len(records), RECORD_SIZE):
            (can_id,) = struct.unpack_from("=I", records, start)
            if can_id == _SYNC:
                self._port.send(self._answers[self._number % len(self._answers)])
                self._number += 1
            elif can_id & ~0x7F not in _RPDOS:
                left += records[start : start + RECORD_SIZE]
        return bytes(left)

    def send(self, records: Records) -> None:
        """Send frames, and store the TPDOs among them."""
        for can_id, length, data in RECORD.iter_unpack(bytes(records)):
            if can_id & ~0x7F in _TPDOS:
                self._newest[can_id] = data[:length]
        self._port.send(records)

    def flush(self) -> None:
        """Flush the port."""
        self._port.flush()

    def events(self) -> list[BusEvent]:
        """The events of the port."""
        return self._port.events()

    def close(self) -> None:
        """Close the port."""
        self._port.close()


def replays(frames: Sequence[CanFrame]) -> list[bytes]:
    """Return the records of one round of cycles with positions moving back and forth: a jump would stop the robot."""
    steps = [*range(_VARIANTS), *range(_VARIANTS, 0, -1)]
    return [pack_records([_moved(frame, _STEP * step) for frame in frames]) for step in steps]


def _moved(frame: CanFrame, counts: int) -> CanFrame:
    """Return a TPDO with its position advanced; one without a position is unchanged."""
    if frame.can_id & ~0x7F != _TPDOS[1]:
        return frame
    position = (int.from_bytes(frame.data[:4], "little") + counts) & 0xFFFFFFFF
    return CanFrame(frame.can_id, position.to_bytes(4, "little") + frame.data[4:])


def main(channel: str, first: int, count: int) -> None:
    """Serve until SIGTERM, or until standard input ends."""
    reactor = Reactor()
    port = ReplayPort(open_port(channel, label="drives"))
    nodes = [make_device(data_path("eds", "TMCM-1270.eds"), node_id) for node_id in range(first, first + count)]
    host = NodeHost(reactor, port, nodes)
    controls = [NodeControl(host, node) for node in nodes]

    def on_order() -> None:
        words = os.read(0, 4096).split()
        if not words:
            reactor.stop()
        for word in words:
            port.replay(word == b"replay")
            sys.stdout.write("done\n")
            sys.stdout.flush()

    reactor.handle_signals({signal.SIGTERM: reactor.stop, signal.SIGINT: reactor.stop})
    reactor.add_reader(0, on_order)
    reactor.run_for(0)
    sys.stdout.write("ready\n")
    sys.stdout.flush()
    reactor.run()
    host.close()
    for control in controls:
        control.close()
    port.close()


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]))
