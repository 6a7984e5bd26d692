"""What went wrong on a bus, read off its recorded frames, as acts of a scenario that does the same to virtual drives.

A recording shows what a cause did, not the cause: a node that is silent becomes a cut cable, one that boots after that
a supply that was away, an EMCY a fault with that code or, where no virtual drive has it, the over-temperature fault; a
master that is silent is stalled, or killed where it boots its nodes anew. Times in Unix ns.
"""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Final

from canopen_control.simulation.acts import Act
from canopen_control.simulation.simulated_robot import MASTER

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from canopen_control.frame import CanFrame
    from canopen_control.master.config import BusConfig
    from canopen_control.master.plan import NodePlan

    Frames = Sequence[tuple[int, CanFrame]]

__all__ = ["BusHistory"]

_MS: Final = 1_000_000
_S: Final = 1_000_000_000
_NMT_STOP, _NMT_PRE_OPERATIONAL = 0x02, 0x80
_NMT_RESETS: Final = (0x81, 0x82)
_RESET_NS: Final = 6 * _S  # within which a node boots that was told to
_QUIET_NS: Final = 1 * _S  # of a node without a heartbeat
_FAULTS: Final = {
    0x2320: "short_circuit",
    0x3220: "undervoltage",
    0x4310: "drive_fault",
    0x5000: "device_error",
    0x5441: "fault_on_enable",
    0x8120: "error_passive",
    0x8611: "following_error",
}
_PASSING: Final = ("device_error", "error_passive")  # whose EMCY "no error" comes with their end, without a reset
_OTHER: Final = "drive_fault"


@dataclass(slots=True)
class _Heard:
    """When a node was heard: anything, heartbeats, boot-ups, and its EMCY with their codes."""

    any: list[int]
    alive: list[int]
    boots: list[int]
    emcy: list[tuple[int, int]]


class BusHistory:
    """What happened on one bus; `acts` yields it at Unix ns. `resets` are when clients asked for a fault reset."""

    def __init__(self, config: BusConfig, frames: Frames, resets: Sequence[int] = ()) -> None:
        self._config, self._frames, self._resets = config, frames, sorted(resets)
        self._plans = {plan.node_id: plan for plan in config.plans.values()}
        self._heard = {node: _Heard([], [], [], []) for node in self._plans}
        self._nmt: list[tuple[int, int, int]] = []  # time, command, node
        self._master: list[int] = []
        self._end = frames[-1][0] if frames else 0
        self._sort()

    def _sort(self) -> None:
        owners = {base + node: node for node in self._plans for base in (0x080, 0x580, 0x700)}
        for node, plan in self._plans.items():
            owners |= {each.cob_id: node for each in plan.tpdos}
        ours = (0x080, 0x700 + self._config.master.node_id)
        for now, frame in self._frames:
            can_id, data = frame.can_id, frame.data
            if can_id in ours:
                self._master.append(now)
            elif can_id == 0 and len(data) >= 2:
                self._nmt.append((now, data[0], data[1]))
            elif can_id in owners:
                self._note(owners[can_id], now, frame)

    def _note(self, node: int, now: int, frame: CanFrame) -> None:
        heard, can_id, data = self._heard[node], frame.can_id, frame.data
        heard.any.append(now)
        if can_id == 0x080 + node and len(data) >= 2:
            heard.emcy.append((now, int.from_bytes(data[:2], "little")))
        elif can_id == 0x700 + node:
            (heard.boots if data[:1] == b"\0" else heard.alive).append(now)

    def acts(self) -> Iterator[Act]:
        """Yield what happened; `at_ns` is Unix time."""
        yield from self._of_master()
        for now, command, node in self._nmt:
            if command in (_NMT_STOP, _NMT_PRE_OPERATIONAL):
                yield Act(now, "frame", values=(0.0, float(command), float(node)))
        for node, plan in self._plans.items():
            yield from self._of_node(node, plan, self._heard[node])

    # -- the master

    def _of_master(self) -> Iterator[Act]:
        for begin, end in self._silences():
            booted = any(begin < now < (end or begin) + _S and command in _NMT_RESETS for now, command, _ in self._nmt)
            lasts = None if end is None else end - begin
            yield (
                Act(begin, "kill", for_ns=lasts) if booted or end is None else Act(begin, "stall", MASTER, for_ns=lasts)
            )

    def _silences(self) -> list[tuple[int, int | None]]:
        """Return from when to when the master kept no time; None: to the end."""
        config = self._config.master
        period = max(config.sync_period * 1000, 0 if config.sync_period else config.heartbeat_producer * _MS)
        return _gaps(self._master, 5 * period, self._end) if period else []

    # -- a node

    def _of_node(self, node: int, plan: NodePlan, heard: _Heard) -> Iterator[Act]:
        limit = plan.heartbeat_timeout_ns or _QUIET_NS
        silences = _gaps(heard.any, limit, self._end)
        for begin, end in silences:
            if end is None or end not in heard.boots:
                yield Act(begin, "cut", str(node), for_ns=None if end is None else end - begin)
            elif not self._was_reset(node, end):
                yield Act(begin, "power", str(node), for_ns=end - begin)
        if plan.heartbeat_timeout_ns:
            for begin, end in _gaps(heard.alive, limit, self._end):
                if not any(begin < (to or self._end) and at < (end or self._end) for at, to in silences):
                    lasts = None if end is None else end - begin
                    yield Act(begin, "fault", str(node), "heartbeat_lost", for_ns=lasts)
        ends = {end for _, end in silences}
        for boot in heard.boots:
            if heard.any[0] < boot and boot not in ends and not self._was_reset(node, boot):
                yield Act(boot, "fault", str(node), "spontaneous_reset")
        yield from self._emergencies(node, heard.emcy)

    def _was_reset(self, node: int, boot: int) -> bool:
        """Whether a boot follows a command to reset."""
        return any(
            command in _NMT_RESETS and about in (0, node) and boot - _RESET_NS < now < boot
            for now, command, about in self._nmt
        )

    def _emergencies(self, node: int, told: Sequence[tuple[int, int]]) -> Iterator[Act]:
        shown: str | None = None
        for number, (now, code) in enumerate(told):
            if code == 0:
                shown = None
            elif shown is None and not _is_consequence(code):
                shown = _FAULTS.get(code, _OTHER)
                gone = next((at for at, later in told[number:] if later == 0), None)
                off = None if gone is None else max(now + _MS, self._ended(gone, shown))
                yield Act(now, "fault", str(node), shown, for_ns=None if off is None else off - now)

    def _ended(self, gone: int, fault: str) -> int:
        """Return when the cause of a fault was gone, whose end was told at a time: before it was reset."""
        if fault in _PASSING:
            return gone
        at = bisect_left(self._resets, gone)
        return (self._resets[at - 1] if at and gone - self._resets[at - 1] < _S else gone) - 50 * _MS


def _gaps(times: Sequence[int], limit: int, end: int) -> list[tuple[int, int | None]]:
    """Return where nothing was heard for longer than a limit, from just after the last; None: to the end."""
    found: list[tuple[int, int | None]] = [
        (last + _MS, after) for last, after in pairwise(times) if after - last > limit
    ]
    return found + ([(times[-1] + _MS, None)] if times and end - times[-1] > limit else [])


def _is_consequence(code: int) -> bool:
    """Whether an EMCY tells of a trouble of communication, which others have: 0x81xx and 0x82xx, but error passive."""
    return code >> 8 in (0x81, 0x82) and code != 0x8120
