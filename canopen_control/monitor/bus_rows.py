"""The tables of a bare bus, made of what its nodes say by themselves: heartbeats, TPDOs, emergencies, SDO answers.

Sans-IO, times in ns; nobody is asked anything. When a node should be heard again is learnt from
the node: its longest silence so far. Twice that is stale, five times that is dead; a node heard once is given a second.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from canopen_control.cia301.emcy import EmcyMessage
from canopen_control.cia301.nmt import NmtState, state_of_byte
from canopen_control.cia402 import objects
from canopen_control.cia402.modes import OperationMode, mode_name
from canopen_control.cia402.state import decode_statusword
from canopen_control.frame import CanFrame
from canopen_control.monitor.monitor_content import (
    Cell,
    LogLine,
    MonitorContent,
    Tone,
    age_cell,
    plain,
    sdo_cell,
    state_cell,
)
from canopen_control.trace.decoder import Mark
from canopen_control.trace.values import statusword_text

if TYPE_CHECKING:
    from canopen_control.trace.decoder import DecodedFrame
    from canopen_control.trace.network_description import NetworkDescription
    from canopen_control.trace.values import SignalValue

__all__ = ["BusTable"]

_SECOND: Final = 1_000_000_000
_UNKNOWN_PACE_NS: Final = (
    500_000_000  # of a node whose pace is not known yet: stale after twice, dead after five times that
)
_OWN: Final = ("hb", "emcy", "pdo", "sdo")  # services in which a node speaks for itself
_LEVELS: Final = {Mark.ERROR: Tone.BAD, Mark.WARNING: Tone.WARN}
_LOGGED: Final = ("nmt", "hb", "emcy", "error", "lss")


@dataclass(slots=True)
class _Axis:
    """What was last heard of an axis; numbers in the device's own units."""

    statusword: int | None = None
    mode: int | None = None
    values: dict[int, int] = field(default_factory=dict)


@dataclass(slots=True)
class _Node:
    """What was last heard of a node."""

    last_ns: int
    longest_ns: int = 0
    nmt: NmtState | None = None
    error: str = ""
    reads: int = 0
    writes: int = 0
    failed: int = 0
    axes: dict[int, _Axis] = field(default_factory=dict)


#: column of the joints' table -> its object
_ACTUAL: Final = {"velocity": 0x606C, "position": 0x6064, "effort": 0x6077}
_TARGET_POSITION, _TARGET_VELOCITY, _TARGET_TORQUE = 0x607A, 0x60FF, 0x6071
#: mode displayed -> the target that it follows
_TARGETS: Final[dict[int, int]] = {
    **dict.fromkeys((OperationMode.PP, OperationMode.IP, OperationMode.CSP), _TARGET_POSITION),
    **dict.fromkeys((OperationMode.PV, OperationMode.CSV), _TARGET_VELOCITY),
    **dict.fromkeys((OperationMode.TQ, OperationMode.CST), _TARGET_TORQUE),
}
_VALUES: Final = frozenset((*_ACTUAL.values(), *_TARGETS.values()))


class BusTable:
    """Learns from decoded frames who is there and how he is."""

    def __init__(self, network: NetworkDescription) -> None:
        self.network = network
        self._nodes: dict[int, _Node] = {}
        self._log: list[LogLine] = []
        self._emergencies: list[LogLine] = []

    def feed(self, decoded: DecodedFrame) -> None:
        """Take a frame; its time is Unix ns."""
        if decoded.mark > Mark.PLAIN and decoded.service in _LOGGED:
            self._note(decoded)
        if decoded.node_id is None or decoded.service not in _OWN:
            return
        if self._from_node(decoded):
            node = self._heard(decoded.node_id, decoded.time)
        else:
            node = self._nodes.get(decoded.node_id) or _Node(decoded.time)  # of one never heard nothing is kept
        self._take(node, decoded)

    def content(self, now: int, title: str, facts: tuple[str, ...]) -> MonitorContent:
        """Return the tables at `now`, Unix ns."""
        rows = sorted(self._nodes.items())
        state = Cell("listening", Tone.GOOD) if rows else Cell("listening, nobody is heard", Tone.WARN)
        drives = {str(node_id): self._row(node_id, node, now) for node_id, node in rows}
        joints = {
            f"{node_id}/{number}": self._joint(node_id, number, axis)
            for node_id, node in rows
            for number, axis in sorted(node.axes.items())
            if axis.values
        }
        return MonitorContent(title, state, "", facts, drives, joints)

    def log(self) -> list[LogLine]:
        """Return what happened since the last call."""
        lines, self._log = self._log, []
        return lines

    def emergencies(self) -> list[LogLine]:
        """Return the emergencies since the last call."""
        lines, self._emergencies = self._emergencies, []
        return lines

    # -- frames

    def _from_node(self, decoded: DecodedFrame) -> bool:
        """Whether the node itself sent it; what others send to it proves nothing."""
        return not decoded.subject.startswith(("RPDO", "SDO request")) and "request" not in decoded.text

    def _heard(self, node_id: int, time: int) -> _Node:
        node = self._nodes.get(node_id)
        if node is None:
            node = self._nodes[node_id] = _Node(time)
        silence = time - node.last_ns
        if node.longest_ns and silence > 5 * node.longest_ns:
            node.longest_ns = 0  # it was gone: its pace is learnt anew
        else:
            node.longest_ns = max(node.longest_ns, silence)
        node.last_ns = time
        return node

    def _take(self, node: _Node, decoded: DecodedFrame) -> None:
        if decoded.service == "hb" and len(decoded.data) == 1:
            self._heartbeat(node, decoded.data[0])
        elif decoded.service == "emcy":
            message = EmcyMessage.parse(CanFrame(decoded.can_id, decoded.data), decoded.node_id)
            node.error = "" if message is None or message.is_reset else f"0x{message.error_code:04X} {message.text}"
        elif decoded.service == "sdo":
            node.reads += decoded.text.startswith("read ") and decoded.subject == "SDO request"
            node.writes += decoded.text.startswith("write ") and decoded.subject == "SDO request"
            node.failed += decoded.mark is Mark.ERROR
        for value in decoded.values:
            _take_value(node, value)

    def _heartbeat(self, node: _Node, byte: int) -> None:
        state = state_of_byte(byte)
        if state is NmtState.INITIALISING:  # a boot-up: what was known of it is over
            node.axes.clear()
            node.error, state = "", NmtState.PRE_OPERATIONAL
        node.nmt = state or node.nmt

    def _note(self, decoded: DecodedFrame) -> None:
        who = "" if decoded.node_id is None or decoded.service == "nmt" else f"{self._who(decoded.node_id)}: "
        text = f"{who}{decoded.subject}: {decoded.text}"
        line = LogLine(decoded.time / _SECOND, text, _LEVELS.get(decoded.mark, Tone.PLAIN))
        self._log.append(line)
        if decoded.service == "emcy":
            self._emergencies.append(line)

    def _who(self, node_id: int) -> str:
        name = self.network.name_of(node_id)
        return f"node {node_id} ({name})" if name else f"node {node_id}"

    # -- rows

    def _row(self, node_id: int, node: _Node, now: int) -> tuple[Cell, ...]:
        name = self.network.name_of(node_id)
        axis = node.axes.get(0) or _Axis()
        pace = max(node.longest_ns, _UNKNOWN_PACE_NS) / _SECOND
        state = None if axis.statusword is None else decode_statusword(axis.statusword)
        return (
            plain(f"{name} ({node_id})" if name else f"node {node_id}"),
            _nmt_cell(node.nmt),
            state_cell(state),
            Cell(node.error, Tone.BAD if node.error else Tone.PLAIN),
            age_cell((now - node.last_ns) / _SECOND, stale=2 * pace, dead=5 * pace),
            plain("-" if axis.mode is None else mode_name(axis.mode)),
            sdo_cell(node.reads, node.writes, node.failed),
            plain(_flags(axis)),
        )

    def _joint(self, node_id: int, number: int, axis: _Axis) -> tuple[Cell, ...]:
        name = self.network.name_of(node_id) or f"node {node_id}"
        which = f"{name} axis {number}" if number else name
        values = (axis.values.get(index) for index in (_TARGETS.get(axis.mode or 0, -1), *_ACTUAL.values()))
        return (plain(f"{which} (device units)"), *(plain("-" if value is None else str(value)) for value in values))


def _nmt_cell(state: NmtState | None) -> Cell:
    if state is None:
        return plain("-")
    return Cell(state.name.replace("_", " "), Tone.GOOD if state is NmtState.OPERATIONAL else Tone.IDLE)


def _flags(axis: _Axis) -> str:
    if axis.statusword is None:
        return "-"
    number, _, rest = statusword_text(axis.statusword, axis.mode).partition(" ")
    _, _, flags = rest.partition(", ")
    return f"{number} {flags}".rstrip()


def _take_value(node: _Node, value: SignalValue) -> None:
    if not 0x6000 <= value.index < 0xA000 or not isinstance(value.value, int):
        return
    base, number = objects.axis_of(value.index)
    axis = node.axes.setdefault(number, _Axis())
    if base == objects.STATUSWORD:
        axis.statusword = value.value
    elif base == objects.MODES_OF_OPERATION_DISPLAY:
        axis.mode = value.value
    elif base in _VALUES:
        axis.values[base] = value.value
