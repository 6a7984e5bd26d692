"""Detects other masters on the bus: frames that only a master sends, and that this one did not.

The law of this file: a port never receives what was sent through it, so each of these frames is somebody else's. What
is seen within half a second is told in one sentence with the identifiers, once, and anew only when for a minute there
was nothing. An SDO request or an NMT command may be a tool's; SYNC, RPDOs and a heartbeat of this master's node id, or
of a number that masters have by custom, are another master's.
"""

from __future__ import annotations

import enum
from typing import TYPE_CHECKING, Final

from canopen_control.cia301.nmt import NmtCommand
from canopen_control.frame import Service, cob_id
from canopen_control.master.event_log import Event, Level
from canopen_control.rpc.messages.state import EventDetails

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from canopen_control.master.remote_node import RemoteNode

__all__ = ["Evidence", "ForeignMaster"]

_GATHER_NS: Final = 500_000_000
_FORGET_NS: Final = 60_000_000_000
_EXAMPLES: Final = 4
_SYNCS: Final = 20  # of the kernel, in which there are not half as many more
_CUSTOMARY: Final = (1, 127)  # node ids of masters
_COMMANDS: Final = {int(command): command.name.lower().replace("_", " ") for command in NmtCommand}


class Evidence(enum.IntEnum):
    """What somebody else sends, the clearer the higher."""

    SDO = 1
    NMT = 2
    MASTER = 3


class _Seen:
    """The frames of one identifier; `examples` are what they say, where that differs."""

    __slots__ = ("count", "evidence", "examples", "what")

    def __init__(self, evidence: Evidence, what: str) -> None:
        self.evidence, self.what, self.count = evidence, what, 0
        self.examples: list[str] = []

    def __str__(self) -> str:
        return f"{self.what} ({', '.join(self.examples) if self.examples else _times(self.count)})"


class ForeignMaster:
    """Takes the frames of others on the bus called `name` and reports who they come from; `wake` when it will."""

    def __init__(self, name: str, report: Callable[[Event], None], wake: Callable[[], None]) -> None:
        self.deadline: int | None = None
        """When `tick` has something to tell."""
        self._name, self._report, self._wake = name, report, wake
        self._seen: dict[int, _Seen] = {}
        self._told = 0
        self._sync_since = self._syncs = 0
        self._last = -_FORGET_NS

    def saw(self, can_id: int, evidence: Evidence, what: str, now: int, example: str = "") -> None:
        """Take a frame that this master did not send."""
        if now - self._last >= _FORGET_NS:
            self._told = 0
            self._seen.clear()
        self._last = now
        seen = self._seen.get(can_id)
        if seen is None:
            seen = self._seen[can_id] = _Seen(evidence, what)
        seen.count += 1
        if example and example not in seen.examples and len(seen.examples) < _EXAMPLES:
            seen.examples.append(example)
        if evidence > self._told and self.deadline is None:
            self.deadline = now + _GATHER_NS
            self._wake()

    def tick(self, now: int) -> None:
        """Tell what was gathered."""
        if self.deadline is None or now < self.deadline:
            return
        self.deadline = None
        clearest = max(seen.evidence for seen in self._seen.values())
        self._told = clearest
        seen = ", ".join(str(self._seen[can_id]) for can_id in sorted(self._seen))
        kind, level, text = _TELLING[clearest]
        details = EventDetails(identifiers=tuple(f"0x{can_id:03X}" for can_id in sorted(self._seen)))
        self._report(Event(now, kind, "", text.format(bus=self._name, seen=seen), level, details))

    def handlers(
        self, own_id: int, sync: int, nodes: dict[int, RemoteNode]
    ) -> Iterator[tuple[int, Callable[[bytes, int, int], None]]]:
        """Return what takes the frames of each identifier that only a master sends, RPDOs apart."""
        yield 0, self._on_nmt
        yield sync, self._handler(sync, Evidence.MASTER, f"SYNC 0x{sync:03X}")
        for node_id in {own_id, *_CUSTOMARY} - nodes.keys():
            can_id = cob_id(Service.HEARTBEAT, node_id)
            whose = "this master's own node id" if node_id == own_id else f"node {node_id}"
            yield can_id, self._handler(can_id, Evidence.MASTER, f"heartbeat 0x{can_id:03X} of {whose}")
        for node in nodes.values():
            can_id = cob_id(Service.SDO_CLIENT, node.node_id)
            yield can_id, self._on_sdo(can_id, node)

    def on_rpdo(self, can_id: int, node: RemoteNode) -> Callable[[bytes, int, int], None]:
        """Return what takes the frames of an RPDO."""
        return self._handler(can_id, Evidence.MASTER, f"RPDO 0x{can_id:03X} of {node.who}")

    def on_expected_sync(self, can_id: int, period_ns: int, now: int, late: bool) -> None:
        """Take a SYNC that is sent for this master, by the kernel: where too many come, not all of them are."""
        if late or now - self._sync_since >= _SYNCS * period_ns:  # what was read in one go says nothing of a rate
            self._sync_since, self._syncs = now, 0
        self._syncs += 1
        if self._syncs > _SYNCS + _SYNCS // 2:
            self.saw(can_id, Evidence.MASTER, f"SYNC 0x{can_id:03X} beside the kernel's", now)

    def _handler(self, can_id: int, evidence: Evidence, what: str) -> Callable[[bytes, int, int], None]:
        return lambda _data, _length, now: self.saw(can_id, evidence, what, now)

    def _on_sdo(self, can_id: int, node: RemoteNode) -> Callable[[bytes, int, int], None]:
        """Return what takes requests to a node that is used; whoever brings one asks first whether its id is free."""
        what = f"SDO 0x{can_id:03X} to {node.who}"
        return lambda _data, _length, now: self.saw(can_id, Evidence.SDO, what, now) if node.ready else None

    def _on_nmt(self, data: bytes, length: int, now: int) -> None:
        example = data[:length].hex() or "empty"
        if length == 2:
            name = _COMMANDS.get(data[0], f"0x{data[0]:02X}")
            example = f"{name}, {f'node {data[1]}' if data[1] else 'all nodes'}"
        self.saw(0, Evidence.NMT, "NMT 0x000", now, example)


def _times(count: int) -> str:
    return "once" if count == 1 else f"{count} times"


_TELLING: Final = {
    Evidence.SDO: (
        "other_sdo_client",
        Level.INFO,
        "bus {bus}: somebody else reads or writes objects: {seen}; its answers and this master's can be mixed up",
    ),
    Evidence.NMT: (
        "other_master",
        Level.WARNING,
        "bus {bus}: somebody else commands nodes: {seen}; if that is no tool of yours, another master is on the bus",
    ),
    Evidence.MASTER: (
        "other_master",
        Level.WARNING,
        "bus {bus}: another master is on it: {seen}; two masters fight over the drives, end one of them",
    ),
}
