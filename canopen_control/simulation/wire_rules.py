"""Invariants of the wire: the master keeps time, the bus its budget, and SDO its order. Times in ns.

A master that is stalled, killed or cut off keeps no time; what it owes is judged again a second after that.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from canopen_control.frame import RECORD
from canopen_control.master.budget import budget_of
from canopen_control.simulation.simulated_robot import MASTER

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.simulation.simulated_robot import SimulatedRobot
    from canopen_control.simulation.simulated_wire import SimulatedWire
    from canopen_control.simulation.wire_view import WireView

__all__ = ["WireRules"]

_MS: Final = 1_000_000
_SECOND: Final = 1_000_000_000
_LATE: Final = 1.6  # periods between two heartbeats, or two SYNCs
_EXTRA_LOAD: Final = 0.15  # of the bit rate: SDO and EMCY of a robot that runs
_BOOT_NS: Final = 3 * _SECOND  # in which a boot may load the bus as it likes
_SDO_WAIT_NS: Final = 90 * _MS  # a client waits at least so long before it asks anew
_ABORT, _BLOCK = 4, (5, 6)


class WireRules:
    """Judges one bus; `tell(rule, text)` takes breaches. `heard` gets all frames, `sampled` the time now and then."""

    def __init__(
        self, robot: SimulatedRobot, wire: SimulatedWire, view: WireView, tell: Callable[[str, str], None]
    ) -> None:
        self._robot, self._wire, self._view, self._tell = robot, wire, view, tell
        master = view.config.master
        self._sync_ns, self._heartbeat_ns = master.sync_period * 1000, master.heartbeat_producer * _MS
        self._ours = master.sync_producer != "other"
        self._rate = master.baudrate * 1000
        period = self._sync_ns or robot.setup.cycle_ns
        self._budget = budget_of(view.config, period).load + _EXTRA_LOAD
        self._last: dict[str, int] = {}
        self._waiting: dict[int, tuple[int, bytes]] = {}  # SDO: node -> when and what it was asked
        self._in_block: set[int] = set()
        self._window, self._bits = robot.now_ns, 0
        self._quiet_until = 0
        self._heartbeat_id = 0x700 + master.node_id

    # -- frames

    def wants(self, can_id: int) -> bool:
        """Whether `heard` looks at frames with this identifier."""
        return can_id in (0x80, self._heartbeat_id) or 0x580 < can_id < 0x600 or 0x600 < can_id < 0x680

    def heard(self, now: int, label: str, record: bytes) -> None:
        """Take a frame that has passed."""
        can_id, length, data = RECORD.unpack(record)
        if label == MASTER:
            if can_id == 0x80:
                self._keeps_time("SYNC", self._sync_ns if self._ours else 0, now)
            elif can_id == self._heartbeat_id:
                self._keeps_time("heartbeat", self._heartbeat_ns, now)
            elif 0x600 < can_id < 0x680:
                self._request(can_id & 0x7F, data[:length], now)
        elif 0x580 < can_id < 0x600:
            self._waiting.pop(can_id & 0x7F, None)
            if length and data[0] >> 5 == _ABORT:
                self._in_block.discard(can_id & 0x7F)

    def _keeps_time(self, what: str, period: int, now: int) -> None:
        last, self._last[what] = self._last.get(what, 0), now
        gap = now - last
        if period and last > self._excused(now) and gap > period * _LATE:
            self._tell("late", f"{what} of the master came after {gap / 1e6:.1f} ms, its period is {period / 1e6:g} ms")

    def _request(self, node: int, data: bytes, now: int) -> None:
        """Judge an SDO request: one at a time, a new one only after the answer, an abort, or the time-out."""
        command = data[0] >> 5 if data else _ABORT
        if command == _ABORT:
            self._waiting.pop(node, None)
            self._in_block.discard(node)
            return
        if command in _BLOCK:
            self._in_block.add(node)
        elif command in (1, 2):
            self._in_block.discard(node)
        if node in self._in_block:
            self._waiting.pop(node, None)
            return
        asked = self._waiting.get(node)
        if asked is not None and 0 < now - asked[0] < _SDO_WAIT_NS and self._all_heard_since(asked[0]):
            again = f"{(now - asked[0]) / 1e6:.1f} ms after {asked[1].hex(' ')}, which has no answer yet"
            self._tell("sdo_overlap", f"node {node} is asked {data.hex(' ')} {again}")
        self._waiting[node] = (now, data)

    def _all_heard_since(self, asked_ns: int) -> bool:
        """Whether an abort would have been seen: no frame was lost meanwhile, and the master is the same."""
        return not self._wire.tampered and asked_ns > max(self._quiet_until, self._last_start)

    @property
    def _last_start(self) -> int:
        return self._robot.started_ns

    # -- time

    def sampled(self, now: int) -> None:
        """Judge how busy the bus was, a second at a time."""
        self._excused(now)
        if now - self._window < _SECOND:
            return
        bits = self._wire.bits - self._bits
        load = bits * 1e9 / (now - self._window) / self._rate
        self._window, self._bits = now, self._wire.bits
        booting = any(node.booted_at > now - _BOOT_NS for node in self._view.nodes.values())
        if load > self._budget and not booting and now > self._quiet_until and now > self._last_start + _BOOT_NS:
            self._tell("bus_budget", f"the bus is loaded to {load:.0%}, its budget is {self._budget:.0%}")

    def _excused(self, now: int) -> int:
        """Return until when the master may have been late: it was stalled, started, or could not send."""
        stalled_until = self._robot.host.stalled_until
        if now < stalled_until or self._wire.tampered:  # a cable that is cut, too
            self._quiet_until = now + _SECOND
        return max(self._quiet_until, stalled_until + 100 * _MS, self._robot.started_ns + _SECOND)
