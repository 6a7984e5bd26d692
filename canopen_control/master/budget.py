"""Bus load of process data: bits of the longest cycle, average load and shortest possible SYNC period.

The longest cycle contains every PDO that may be sent in one cycle, with the maximum number of stuff bits, and decides
whether the period is possible. The load is the average over all frames at their rates, with the maximum number of
stuff bits. SDO, EMCY and NMT are not included: a load above `HIGH` leaves too little bandwidth for them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from canopen_control.bus.arbitration import duration_ns, worst_case_bits
from canopen_control.cia301.nmt import ERROR_CONTROL_COB_ID
from canopen_control.cia301.sync import SYNC_COB_ID
from canopen_control.frame import FRAME_BITS
from canopen_control.master.cycle import CYCLIC_SYNCHRONOUS

if TYPE_CHECKING:
    from collections.abc import Iterator

    from canopen_control.master.config import BusConfig
    from canopen_control.master.keys import NodeConfig
    from canopen_control.master.plan_builder import PlannedPdo


HIGH = 0.70  # fraction of the bit rate
_ON_REMOTE = (252, 253)  # sent on a remote frame only (CiA 301, 7.5.2.37)


@dataclass(frozen=True, slots=True)
class Share:
    """Frame with `length` data bytes, sent `per_cycle` times per cycle; `cyclic` frames belong to the longest cycle."""

    name: str
    cob_id: int
    length: int
    per_cycle: float
    cyclic: bool = True

    @property
    def worst_bits(self) -> int:
        """Length of the frame in bits, including the maximum number of stuff bits."""
        return bits_of(self.length)[1]


@dataclass(frozen=True, slots=True)
class Budget:
    """Frames of a bus, with the bit rate in bit/s and the period of the cycle in ns."""

    shares: tuple[Share, ...]
    bitrate: int
    period_ns: int
    unbounded: tuple[str, ...] = ()  # event-driven PDOs without an inhibit time, counted once per cycle

    @property
    def bits(self) -> int:
        """Number of bits in the longest cycle, without stuff bits."""
        return sum(bits_of(share.length)[0] for share in self.shares if share.cyclic)

    @property
    def worst_bits(self) -> int:
        """Number of bits in the longest cycle, including the maximum number of stuff bits."""
        return sum(share.worst_bits for share in self.shares if share.cyclic)

    @property
    def shortest_period_ns(self) -> int:
        """Duration of the longest cycle on the bus in ns."""
        return duration_ns(self.worst_bits, self.bitrate)

    @property
    def load(self) -> float:
        """Average bus load as a fraction of the bit rate, including heartbeats and guarding."""
        bits = sum(share.worst_bits * share.per_cycle for share in self.shares)
        return bits * 1e9 / (self.period_ns * self.bitrate)

    @property
    def fits(self) -> bool:
        """Whether the longest cycle fits into the period."""
        return self.shortest_period_ns <= self.period_ns


def bits_of(length: int) -> tuple[int, int]:
    """Return the length of a frame in bits: without stuff bits, and with the maximum number of stuff bits."""
    return FRAME_BITS + 8 * length, worst_case_bits(length)


def budget_of(config: BusConfig, period_ns: int) -> Budget:
    """Return the budget of a bus for a cycle of `period_ns`."""
    unbounded: list[str] = []
    shares = list(_shares(config, period_ns, unbounded))
    return Budget(tuple(shares), config.master.baudrate * 1000, period_ns, tuple(unbounded))


def _shares(config: BusConfig, period_ns: int, unbounded: list[str]) -> Iterator[Share]:
    master = config.master
    if master.sync_period:
        yield Share("SYNC", SYNC_COB_ID, 1 if master.sync_overflow else 0, 1.0)
    yield _error_control("heartbeat of the master", master.node_id, master.heartbeat_ms, period_ns)
    for name, plan in config.plans.items():
        node = config.nodes[name]
        if plan.heartbeat_timeout_ns:
            ms = round(plan.heartbeat_timeout_ns / node.supervision.multiplier / 1e6)
            yield _error_control(f"heartbeat of {name}", node.node_id, ms, period_ns)
        elif plan.guard:
            for title in ("guarding request", "guarding answer"):
                yield _error_control(f"{title}, {name}", node.node_id, node.supervision.guard_time, period_ns)
        for layout in plan.rpdos:
            yield Share(f"RPDO {layout.number} of {name}", layout.cob_id, _length(layout), 1.0)
        for layout in plan.tpdos:
            yield from _tpdo(name, node, layout, period_ns, unbounded)


def _tpdo(name: str, node: NodeConfig, layout: PlannedPdo, period_ns: int, unbounded: list[str]) -> Iterator[Share]:
    """Yield a TPDO with its rate per cycle; a TPDO that is sent only on request is omitted."""
    kind, title = layout.transmission_type, f"TPDO {layout.number} of {name}"
    if kind in _ON_REMOTE:
        return
    if kind in CYCLIC_SYNCHRONOUS:
        yield Share(title, layout.cob_id, _length(layout), 1 / kind)
        return
    pdo = node.boot.tpdo.get(layout.number)
    inhibit_ns = (pdo.inhibit_time or 0) * 100_000 if pdo is not None else 0
    if kind and not inhibit_ns:
        unbounded.append(title)
    yield Share(title, layout.cob_id, _length(layout), min(1.0, period_ns / inhibit_ns) if inhibit_ns else 1.0)


def _error_control(name: str, node_id: int, period_ms: int, period_ns: int) -> Share:
    return Share(
        name, ERROR_CONTROL_COB_ID + node_id, 1, period_ns / (period_ms * 1e6) if period_ms else 0.0, cyclic=False
    )


def _length(layout: PlannedPdo) -> int:
    return (sum(mapped.bits for mapped in layout.objects) + 7) // 8
