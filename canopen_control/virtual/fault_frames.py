"""Effects of faults and quirks on the frames that a node sends and receives.

A function returns the resulting frames, and changes nothing else. None of them has the name or the row of its fault:
those are in `fault_table` and in the modules of quirks.
"""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

from canopen_control.cia301.abort import AbortCode
from canopen_control.cia301.nmt import NmtCommand
from canopen_control.cia402 import objects as o
from canopen_control.frame import CanFrame, Service, cob_id

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.virtual.virtual_node import VirtualNode

    Outgoing = Callable[[VirtualNode, CanFrame, int], list[tuple[int, CanFrame]]]  # (delay in ns, frame)
    Incoming = Callable[[VirtualNode, CanFrame, int], CanFrame | None]


_MS = 1_000_000
_MUX = struct.Struct("<BHB")
_ABORT, _SEGMENTS = 0x80, (0x00, 0x10)


# -- which frame is it


def is_heartbeat(node: VirtualNode, frame: CanFrame) -> bool:
    """Whether the frame is the node's heartbeat or boot-up."""
    return frame.can_id == cob_id(Service.HEARTBEAT, node.node_id)


def is_sdo_answer(node: VirtualNode, frame: CanFrame) -> bool:
    """Whether the frame is an answer of the node's SDO server."""
    return frame.can_id == node.sdo.answer_cob_id and len(frame.data) == 8


def is_sdo_request(node: VirtualNode, frame: CanFrame) -> bool:
    """Whether the frame is a request to the node's SDO server."""
    return frame.can_id == node.sdo.request_cob_id and len(frame.data) == 8


def is_tpdo(node: VirtualNode, frame: CanFrame) -> bool:
    """Whether the frame is a TPDO of the node."""
    ids = {tpdo.producer.parameters.cob_id for tpdo in node.pdos.tpdos.values() if tpdo.producer.parameters.enabled}
    return frame.can_id in ids


# -- frames that leave


def drop_all(_node: VirtualNode, _frame: CanFrame, _now: int) -> list[tuple[int, CanFrame]]:
    """Drop all frames."""
    return []


def _on(
    matches: Callable[[VirtualNode, CanFrame], bool], change: Callable[[CanFrame], list[tuple[int, CanFrame]]]
) -> Outgoing:
    def outgoing(node: VirtualNode, frame: CanFrame, _now: int) -> list[tuple[int, CanFrame]]:
        return change(frame) if matches(node, frame) else [(0, frame)]

    return outgoing


def _data(frame: CanFrame, data: bytes) -> list[tuple[int, CanFrame]]:
    return [(0, CanFrame(frame.can_id, data))]


def _shortened(frame: CanFrame) -> list[tuple[int, CanFrame]]:
    return _data(frame, frame.data[:-1])


def _lengthened(frame: CanFrame) -> list[tuple[int, CanFrame]]:
    return _data(frame, (frame.data + b"\xa5")[:8])


def _wrong_mux(frame: CanFrame) -> list[tuple[int, CanFrame]]:
    command, index, subindex = _MUX.unpack_from(frame.data)
    return _data(frame, _MUX.pack(command, index + 1 & 0xFFFF, subindex) + frame.data[4:])


def _toggled(frame: CanFrame) -> list[tuple[int, CanFrame]]:
    """Invert the toggle bit of segment answers, 0x and 1x (upload) and 2x and 3x (download)."""
    if frame.data[0] >> 5 in (0, 1):
        return _data(frame, bytes((frame.data[0] ^ 0x10,)) + frame.data[1:])
    return [(0, frame)]


def _lost_segment(frame: CanFrame) -> list[tuple[int, CanFrame]]:
    return [] if frame.data[0] >> 5 == 0 else [(0, frame)]


def _one_byte(frame: CanFrame) -> list[tuple[int, CanFrame]]:
    """Reduce the size in an expedited upload of 2 or 4 bytes to one."""
    if frame.data[0] in (0x43, 0x47, 0x4B):
        return _data(frame, b"\x4f" + frame.data[1:5] + b"\0\0\0")
    return [(0, frame)]


def _pre_operational(frame: CanFrame) -> list[tuple[int, CanFrame]]:
    return _data(frame, b"\x7f") if frame.data != b"\0" else [(0, frame)]


def _twice(frame: CanFrame) -> list[tuple[int, CanFrame]]:
    return [(0, frame), (0, frame)]


def jittered(node: VirtualNode, frame: CanFrame, now: int) -> list[tuple[int, CanFrame]]:
    """Delay heartbeats by up to 60 % of their period, each by another amount."""
    if not is_heartbeat(node, frame) or frame.data == b"\0":
        return [(0, frame)]
    period = node.heartbeat.period_ns
    step = now // period if period else 0
    return [(period * ((step * step * 7 + step * 13) % 61) // 100, frame)]


heartbeat_dropped: Outgoing = _on(is_heartbeat, lambda _frame: [])
heartbeat_wrong: Outgoing = _on(is_heartbeat, _pre_operational)
heartbeat_twice: Outgoing = _on(is_heartbeat, _twice)
tpdo_dropped: Outgoing = _on(is_tpdo, lambda _frame: [])
tpdo_shortened: Outgoing = _on(is_tpdo, _shortened)
tpdo_lengthened: Outgoing = _on(is_tpdo, _lengthened)
tpdo_delayed: Outgoing = _on(is_tpdo, lambda frame: [(70 * _MS, frame)])
sdo_wrong_mux: Outgoing = _on(is_sdo_answer, _wrong_mux)
sdo_toggled: Outgoing = _on(is_sdo_answer, _toggled)
sdo_segment_lost: Outgoing = _on(is_sdo_answer, _lost_segment)
sdo_one_byte: Outgoing = _on(is_sdo_answer, _one_byte)


# -- frames that reach the node


def deaf(_node: VirtualNode, _frame: CanFrame, _now: int) -> CanFrame | None:
    """Drop all received frames."""
    return None


def deaf_to_sdo(node: VirtualNode, frame: CanFrame, _now: int) -> CanFrame | None:
    """Drop SDO requests."""
    return None if is_sdo_request(node, frame) else frame


def deaf_to_start(_node: VirtualNode, frame: CanFrame, _now: int) -> CanFrame | None:
    """Drop NMT start."""
    return None if frame.can_id == 0 and frame.data[:1] == bytes((NmtCommand.START,)) else frame


def deaf_to_sync(node: VirtualNode, frame: CanFrame, _now: int) -> CanFrame | None:
    """Drop SYNC."""
    return None if frame.can_id == node.sync.cob_id else frame


def refusing(code: AbortCode, concerns: Callable[[int, int], bool]) -> Incoming:
    """Answer SDO initiates selected by `concerns` (command, index) with an abort, before the server receives them."""

    def incoming(node: VirtualNode, frame: CanFrame, _now: int) -> CanFrame | None:
        if not is_sdo_request(node, frame):
            return frame
        command, index, subindex = _MUX.unpack_from(frame.data)
        if command >> 5 not in (1, 2, 5, 6) or not concerns(command, index):
            return frame
        answer = _MUX.pack(_ABORT, index, subindex) + int(code).to_bytes(4, "little")
        node.outbox.send(CanFrame(node.sdo.answer_cob_id, answer))
        return None

    return incoming


_OPTIONAL = frozenset((o.ERROR_CODE, o.ABORT_CONNECTION_OPTION, o.INTERPOLATION_TIME_PERIOD))
refuses_writes: Incoming = refusing(AbortCode.DEVICE_STATE, lambda command, _index: command >> 5 in (1, 6))
lacks_optional: Incoming = refusing(AbortCode.NO_OBJECT, lambda _command, index: index in _OPTIONAL)
refuses_mapping: Incoming = refusing(
    AbortCode.READ_ONLY,
    lambda command, index: command >> 5 in (1, 6) and (0x1600 <= index < 0x1800 or 0x1A00 <= index < 0x1C00),
)
refuses_blocks: Incoming = refusing(AbortCode.UNKNOWN_COMMAND, lambda command, _index: command >> 5 in (5, 6))
