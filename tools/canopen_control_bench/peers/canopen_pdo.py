"""The `canopen` package as master: the process data of N drives, and nothing else.

Its documented idiom at its fastest: the PDOs are mapped and saved over SDO, variables are looked up once, `raw` is set
and read on them, `transmit()` sends a PDO, `network.sync.transmit()` the SYNC; the newest TPDOs are kept by the
package's own receiving thread. With --inline the bus is read in this thread instead and handed to `network.notify`, as
its chapter on own interfaces has it.

    python -m canopen_control_bench.peers.canopen_pdo local:BUS EDS FIRST_NODE COUNT [--inline]
"""

from __future__ import annotations

import sys
import threading

import can
import canopen

from canopen_control_bench.peers.pattern import MODE, RAMPS, STEPS, controlword, target
from canopen_control_bench.turns import serve_turns

ANSWER_S = 5.0
LEAVE_S = 0.05  # interval at which its thread checks for its end without traffic; the package waits for this


class Drive:
    """A node with its PDOs mapped, and its variables."""

    def __init__(self, network: canopen.Network, node_id: int, eds: str) -> None:
        self.node = node = network.add_node(node_id, eds)
        node.sdo.RESPONSE_TIMEOUT = ANSWER_S
        node.rpdo.read()  # type: ignore[no-untyped-call]  # canopen leaves it untyped
        node.tpdo.read()  # type: ignore[no-untyped-call]  # as above
        for number in (3, 4):
            for unused in (node.rpdo[number], node.tpdo[number]):
                unused.enabled = False
                unused.save()
        word_mode = self._map(node.rpdo[1], "Controlword", "Modes of operation")
        targets = self._map(node.rpdo[2], "Target position", "Target velocity")
        self.controlword, self.mode = word_mode
        self.position_target, self.velocity_target = targets
        self.inputs = [
            *self._map(node.tpdo[1], "Statusword", "Modes of operation display"),
            *self._map(node.tpdo[2], "Position actual value", "Velocity actual value"),
        ]
        self.rpdos = [node.rpdo[1], node.rpdo[2]]
        for index, value in RAMPS:
            node.sdo[index].raw = value

    @staticmethod
    def _map(pdo: canopen.pdo.base.PdoMap, *names: str) -> list[canopen.pdo.base.PdoVariable]:
        pdo.clear()
        variables = [pdo.add_variable(_INDEX[name]) for name in names]
        pdo.trans_type, pdo.enabled = 1, True
        pdo.save()
        return variables


_INDEX = {
    "Controlword": 0x6040,
    "Modes of operation": 0x6060,
    "Target position": 0x607A,
    "Target velocity": 0x60FF,
    "Statusword": 0x6041,
    "Modes of operation display": 0x6061,
    "Position actual value": 0x6064,
    "Velocity actual value": 0x606C,
}


class Master:
    """The drives, and the data received from them."""

    def __init__(self, bus: can.BusABC, *, inline: bool) -> None:
        self.bus, self.inline, self.controlword = bus, inline, 0
        self.network = canopen.Network(bus)
        self.network.NOTIFIER_CYCLE = LEAVE_S
        self.network.connect()
        self.arrived = threading.Event()
        self.drives: list[Drive] = []
        self.seen: list[object] = []

    def add(self, nodes: range, eds: str) -> None:
        """Map the drives' PDOs and set them operational."""
        self.drives = [Drive(self.network, node_id, eds) for node_id in nodes]
        self.drives[-1].node.tpdo[2].add_callback(lambda _pdo: self.arrived.set())
        if self.inline and self.network.notifier is not None:
            self.network.notifier.stop()
        self.network.nmt.state = "OPERATIONAL"

    def cycle(self, number: int) -> None:
        """Process received messages, then send the RPDOs and SYNC."""
        while self.inline and self.take(0):
            pass
        self.seen = [variable.raw for drive in self.drives for variable in drive.inputs]
        for position, drive in enumerate(self.drives):
            drive.controlword.raw = self.controlword
            drive.mode.raw = MODE
            drive.position_target.raw = 0
            drive.velocity_target.raw = target(number, position)
            for pdo in drive.rpdos:
                pdo.transmit()
        self.arrived.clear()
        self.network.sync.transmit()

    def take(self, timeout: float) -> bool:
        """Pass the next message to the package in this thread; return False if there was none."""
        message = self.bus.recv(timeout)
        if message is not None:
            self.network.notify(message.arbitration_id, message.data, message.timestamp)
        return message is not None

    def wait(self) -> None:
        """Wait for the last TPDO and return its time."""
        if not self.inline:
            if not self.arrived.wait(ANSWER_S):
                raise SystemExit("the drives do not answer")
            return
        while not self.arrived.is_set():
            if not self.take(ANSWER_S):
                raise SystemExit("the drives do not answer")


def main() -> None:
    """Map, enable, and serve turns."""
    channel, eds, first, count = sys.argv[1], sys.argv[2], int(sys.argv[3]), int(sys.argv[4])
    bus = can.Bus(interface="canopen_control", channel=channel.removeprefix("local:"))
    master = Master(bus, inline="--inline" in sys.argv)
    master.add(range(first, first + count), eds)
    for step in range(STEPS):
        master.controlword = controlword(step)
        master.cycle(0)
        master.wait()
    serve_turns(master.cycle, master.wait)
    master.network.nmt.state = "RESET"
    master.network.disconnect()
    bus.shutdown()


if __name__ == "__main__":
    main()
