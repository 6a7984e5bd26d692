"""The fault switches of one node, between it and the wire.

With nothing switched on nothing stands in the node's way. Frames pass the hooks of all
faults that are on, in the order of the table; what they delay is kept here and leaves on time.
"""

from __future__ import annotations

import heapq
from typing import TYPE_CHECKING

from canopen_control.errors import ConfigError
from canopen_control.virtual import device_faults
from canopen_control.virtual.fault_table import FAULTS, Fault, find_fault, parse_fault
from canopen_control.virtual.node_events import FaultSwitched
from canopen_control.virtual.virtual_node import VirtualNode

if TYPE_CHECKING:
    from canopen_control.frame import CanFrame

__all__ = ["FaultSwitches", "second_node"]

_FLOOD_NS = 1_000_000
_OTHER_SERIAL = 1000
_DEVICES = {"axis": "a drive", "program": "one whose program can be loaded (0x1F51)"}


class FaultSwitches:
    """Switches faults of `node` on and off; `active` are the names of those that are on."""

    def __init__(self, node: VirtualNode) -> None:
        self._node = node
        self._on: dict[str, Fault] = {}
        self._held: list[tuple[int, int, CanFrame]] = []  # due, order, frame
        self._due: list[CanFrame] = []
        self._order = 0
        self._planned: list[tuple[int, str]] = []  # delay from the first tick, or due
        self._started = False
        self._flood_at: int | None = None
        self._second: VirtualNode | None = None
        node.switches = self

    @property
    def active(self) -> list[str]:
        """The names of the faults that are on."""
        return list(self._on)

    def schedule(self, text: str) -> None:
        """Switch on ``name`` at the start, or ``name@seconds`` after it; ConfigError for what is neither."""
        fault, delay_ns = parse_fault(text)
        self._require(fault)
        self._planned.append((delay_ns, fault.name))
        self._node.filter = self

    def _require(self, fault: Fault) -> None:
        """Raise ConfigError for a fault that this kind of node cannot show."""
        node = self._node
        if not fault.fits(node):
            which = _DEVICES.get(fault.acts) or f"no drive, of a profile with {fault.acts}s"
            raise ConfigError(
                f"{fault.name} is a fault of a device that is {which}; node {node.node_id} is {node.name}"
            )

    def set(self, name: str, on: bool, now: int) -> None:
        """Switch a fault; no-op where it is as wanted. ConfigError for a name that this node does not have."""
        fault = find_fault(name)
        if on == (name in self._on):
            return
        self._require(fault)
        self._node.advance_drives(now)
        self._node.filter = self
        if on:
            self._on = {n: f for n, f in FAULTS.items() if n in self._on or n == name}
        else:
            del self._on[name]
        if fault.floods:
            self._flood_at = now if on else None
        if fault.second_node:
            self._second = second_node(self._node, now) if on else None
        self._node.outbox.tell(FaultSwitched(name, on))
        if fault.switched is not None:
            fault.switched(self._node, on, now)
            if on and fault.once:
                self._off(name)
        self._node.outbox.values_changed()
        self._node.follow(now)
        self._retire()

    def incoming(self, frame: CanFrame, now: int) -> CanFrame | None:
        """Return what the node hears."""
        heard: CanFrame | None = frame
        if self._second is not None:
            self._second.receive(frame, now)
        for fault in tuple(self._on.values()):
            if fault.incoming is not None and heard is not None:
                heard = fault.incoming(self._node, heard, now)
                if heard is None and fault.once:
                    self._off(fault.name)
        return heard

    def outgoing(self, frames: list[CanFrame], now: int) -> list[CanFrame]:
        """Return what leaves the node now."""
        leaving, self._due = self._due, []
        if self._second is not None:
            self._second.events()  # nobody is told what happens to it
            leaving += self._second.frames()
        for frame in frames:
            for delay, changed in self._changed(frame, now):
                if delay > 0:
                    self._order += 1
                    heapq.heappush(self._held, (now + delay, self._order, changed))
                else:
                    leaving.append(changed)
        return leaving

    def tick(self, now: int) -> None:
        """Switch what was planned, send what was held."""
        if not self._started:
            self._started = True
            self._planned = [(now + delay, name) for delay, name in self._planned]
        while self._planned and (first := min(self._planned))[0] <= now:
            self._planned.remove(first)
            self.set(first[1], True, now)
        if self._second is not None:
            self._second.tick(now)
        while self._held and self._held[0][0] <= now:
            self._due.append(heapq.heappop(self._held)[2])
        while self._flood_at is not None and self._flood_at <= now:
            device_faults.flood(self._node, now)
            self._flood_at = max(self._flood_at + _FLOOD_NS, now - 20 * _FLOOD_NS)

    def next_deadline(self) -> int | None:
        """Return when something is due."""
        if not self._started or self._due:
            return 0
        deadlines = [due for due, _ in self._planned] + [due for due, _, _ in self._held[:1]]
        if self._flood_at is not None:
            deadlines.append(self._flood_at)
        second = None if self._second is None else self._second.next_deadline()
        if second is not None:
            deadlines.append(second)
        return min(deadlines, default=None)

    def _changed(self, frame: CanFrame, now: int) -> list[tuple[int, CanFrame]]:
        changed = [(0, frame)]
        for fault in self._on.values():
            if fault.outgoing is not None:
                hook = fault.outgoing
                changed = [(a + b, last) for a, first in changed for b, last in hook(self._node, first, now)]
        return changed

    def _off(self, name: str) -> None:
        if self._on.pop(name, None) is not None:
            self._node.outbox.tell(FaultSwitched(name, on=False))

    def _retire(self) -> None:
        """Get out of the way when nothing is on, planned or held."""
        if not (self._on or self._planned or self._held or self._due) and self._started:
            self._node.filter = None


def second_node(node: VirtualNode, now: int) -> VirtualNode:
    """Return a second node with the same id, what a wrong DIP switch puts on the bus.

    The same device with another serial number; it was just plugged in and boots by itself.
    """
    serial = (node.store.number(0x1018, 4) + _OTHER_SERIAL) & 0xFFFFFFFF
    second = VirtualNode(node.od, node.node_id, serial=serial, model=node.model)
    second.store.preset(0x1018, 4, serial)
    second.tick(now)
    return second
