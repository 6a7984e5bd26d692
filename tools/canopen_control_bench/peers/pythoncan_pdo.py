"""python-can alone as master, with a hand-written codec: the process data of N drives, and nothing else.

One thread, `bus.recv` and `bus.send`, one compiled struct for each PDO. It maps the PDOs over SDO as the others do.

    python -m canopen_control_bench.peers.pythoncan_pdo local:BUS EDS FIRST_NODE COUNT
"""

from __future__ import annotations

import struct
import sys

import can

from canopen_control_bench.peers.pattern import MODE, RAMPS, STEPS, controlword, target
from canopen_control_bench.turns import serve_turns

ANSWER_S = 5.0
WORD_MODE, TARGETS, FEEDBACK = struct.Struct("<Hb"), struct.Struct("<ii"), struct.Struct("<ii")
OFF = 0xC0000000
PDOS = (
    (0x1400, 0x200, (0x60400010, 0x60600008)),
    (0x1401, 0x300, (0x607A0020, 0x60FF0020)),
    (0x1800, 0x180, (0x60410010, 0x60610008)),
    (0x1801, 0x280, (0x60640020, 0x606C0020)),
)
UNUSED = ((0x1402, 0x400), (0x1403, 0x500), (0x1802, 0x380), (0x1803, 0x480))


class Master:
    """The minimal master that is needed."""

    def __init__(self, bus: can.BusABC, nodes: range) -> None:
        self.bus, self.nodes = bus, nodes
        self.words: dict[int, tuple[int, ...]] = {}
        self.feedback: dict[int, tuple[int, ...]] = {}
        self.controlword = 0
        self.last = 0x280 + nodes[-1]

    def send(self, can_id: int, data: bytes) -> None:
        """Send a frame."""
        self.bus.send(can.Message(arbitration_id=can_id, data=data, is_extended_id=False, check=False))

    def write(self, node_id: int, index: int, sub: int, value: int, size: int) -> None:
        """Write an object, expedited."""
        command = {1: 0x2F, 2: 0x2B, 4: 0x23}[size]
        self.send(0x600 + node_id, struct.pack("<BHBI", command, index, sub, value))
        while (message := self.bus.recv(ANSWER_S)) is not None:
            if message.arbitration_id == 0x580 + node_id:
                if message.data[0] == 0x80:
                    raise SystemExit(f"node {node_id} refuses 0x{index:04X}:{sub:02X}: {message.data[4:].hex()}")
                return
        raise SystemExit(f"node {node_id} does not answer")

    def configure(self, node_id: int) -> None:
        """Map two synchronous PDOs in each direction; switch the others off."""
        for communication, base in UNUSED:
            self.write(node_id, communication, 1, OFF | base + node_id, 4)
        for communication, base, mapping in PDOS:
            self.write(node_id, communication, 1, OFF | base + node_id, 4)
            self.write(node_id, communication, 2, 1, 1)
            self.write(node_id, communication + 0x200, 0, 0, 1)
            for number, entry in enumerate(mapping, 1):
                self.write(node_id, communication + 0x200, number, entry, 4)
            self.write(node_id, communication + 0x200, 0, len(mapping), 1)
            self.write(node_id, communication, 1, 0x40000000 | base + node_id, 4)
        for index, value in RAMPS:
            self.write(node_id, index, 0, value, 4)

    def take(self, timeout: float) -> int:
        """Receive a frame and store its values; return its COB-ID, or 0 if there was none."""
        message = self.bus.recv(timeout)
        if message is None:
            return 0
        can_id, data = message.arbitration_id, message.data
        kind = can_id & 0x780
        if kind == 0x180:
            self.words[can_id] = WORD_MODE.unpack(data)
        elif kind == 0x280:
            self.feedback[can_id] = FEEDBACK.unpack(data)
        return can_id

    def cycle(self, number: int) -> None:
        """Process received frames, then send the RPDOs and SYNC."""
        while self.take(0):
            pass
        word = WORD_MODE.pack(self.controlword, MODE)
        for position, node in enumerate(self.nodes):
            self.send(0x200 + node, word)
            self.send(0x300 + node, TARGETS.pack(0, target(number, position)))
        self.send(0x080, b"")

    def wait(self) -> None:
        """Wait for the last TPDO and return its time."""
        while (can_id := self.take(ANSWER_S)) != self.last:
            if not can_id:
                raise SystemExit("the drives do not answer")


def main() -> None:
    """Map, enable, and serve turns."""
    channel, first, count = sys.argv[1], int(sys.argv[3]), int(sys.argv[4])
    bus = can.Bus(interface="canopen_control", channel=channel.removeprefix("local:"))
    master = Master(bus, range(first, first + count))
    for node in master.nodes:
        master.configure(node)
    master.send(0x000, b"\x01\x00")
    for step in range(STEPS):
        master.controlword = controlword(step)
        master.cycle(0)
        master.wait()
    serve_turns(master.cycle, master.wait)
    master.send(0x000, b"\x81\x00")
    bus.shutdown()


if __name__ == "__main__":
    main()
