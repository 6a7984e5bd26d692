"""An independent witness on a bus: the `canopen` package, joined through python-can and, on `local:`, our plugin.

It shares no code with the master and none with the virtual drives, the hub's port apart: frames are decoded by the
`canopen` package, with the EDS as it reads it and the PDO mapping as it reads it out of the drives.
"""

from __future__ import annotations

import threading
from collections import Counter
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import can
import canopen
from support.channel import python_can_of
from support.guest import scaled

from canopen_control.data_files import data_path

if TYPE_CHECKING:
    from collections.abc import Callable

SYNC = 0x080


class Witness(can.Listener):
    """Hears a bus from construction on; `frames` are (seconds, identifier, data) in the order they came."""

    def __init__(self, name: str) -> None:
        self.frames: list[tuple[float, int, bytes]] = []
        self.values: dict[int, list[tuple[float, dict[int, int]]]] = {}
        self.nodes: dict[int, canopen.RemoteNode] = {}
        self._lock = threading.Lock()
        self.network = canopen.Network()
        self.network.listeners.append(self)
        self.network.connect(**python_can_of(name))

    @property
    def lost(self) -> int:
        """How many frames this end has lost, as far as it knows."""
        port = getattr(self.network.bus, "_port", None)
        return 0 if port is None else port.stats.lost

    def on_message_received(self, msg: can.Message) -> None:
        assert not msg.is_error_frame
        self.frames.append((msg.timestamp, msg.arbitration_id, bytes(msg.data)))

    def join(self, node_id: int) -> canopen.RemoteNode:
        """Make a node known, read its PDO mapping out of it, and keep what its TPDOs say in `values`."""
        node = self.network.add_node(node_id, str(data_path("eds", "TMCM-1270.eds")))
        node.sdo.RESPONSE_TIMEOUT = scaled(0.5)
        self.nodes[node_id] = node
        self.values[node_id] = []
        self.patiently(node.tpdo.read)
        for pdo in node.tpdo.values():
            pdo.add_callback(lambda pdo, node_id=node_id: self._keep(node_id, pdo))
        return node

    def patiently(self, work: Callable[[], Any]) -> Any:
        """Do SDO transfers; a server has one client, so that a clash with the master's is tried again."""
        for _ in range(50):
            with suppress(canopen.SdoCommunicationError, canopen.SdoAbortedError):
                return work()
        return work()

    def _keep(self, node_id: int, pdo: Any) -> None:
        self.values[node_id].append((pdo.timestamp, {variable.index: variable.raw for variable in pdo}))

    def series(self, node_id: int, index: int) -> list[tuple[float, int]]:
        """Return (seconds, value) of an object as the TPDOs of a node showed it."""
        return [(time, values[index]) for time, values in list(self.values[node_id]) if index in values]

    def close(self) -> None:
        self.network.disconnect()


def missing(frames: list[tuple[float, int, bytes]], identifiers: set[int]) -> tuple[int, list[str]]:
    """Return over how many SYNCs was looked, and which identifiers did not come exactly that often.

    A drive on a busy machine may answer a SYNC after the next one: late, and not lost. So frames are counted from the
    first to the last SYNC that everybody has answered before the next one.
    """
    cycles: list[list[int]] = []
    for _, identifier, _ in frames:
        if identifier == SYNC:
            cycles.append([])
        elif identifier in identifiers and cycles:
            cycles[-1].append(identifier)
    whole = [number for number, cycle in enumerate(cycles) if sorted(cycle) == sorted(identifiers)]
    counted = Counter(identifier for cycle in cycles[whole[0] : whole[-1] + 1] for identifier in cycle)
    count = whole[-1] + 1 - whole[0]
    return count, [f"{number:03X}: {counted[number]} of {count}" for number in identifiers if counted[number] != count]
