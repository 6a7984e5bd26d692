"""Frames of the layer setting services in words (CiA 305, 6.4)."""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.cia301.lss import (
    AUTOMATIC_BIT_TIMING,
    BIT_TIMINGS,
    FAST_SCAN_START,
    UNCONFIGURED,
    LssCommand,
    LssMode,
)

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["lss_text"]

_PARTS = ("vendor", "product", "revision", "serial number")
_RANGES = ("vendor", "product", "lowest revision", "highest revision", "lowest serial", "highest serial")
_NODE_ID_ANSWERS = {0: "accepted", 1: "refused, out of range"}
_BIT_TIMING_ANSWERS = {0: "accepted", 1: "refused, not supported"}
_STORE_ANSWERS = {0: "stored", 1: "refused, not supported", 2: "failed, storage not accessible"}


def lss_text(data: bytes, *, from_master: bool) -> str:
    """Return what a frame of master or slave says; a command nobody knows is told by its number."""
    if not data:
        return "malformed: no data"
    data = data.ljust(8, b"\0")
    command = data[0]
    words = (_MASTER if from_master else _SLAVE).get(command)
    return words(data) if words is not None else f"unknown command 0x{command:02X}"


def _number(data: bytes) -> int:
    return int.from_bytes(data[1:5], "little")


def _node_id(value: int) -> str:
    return "no node id" if value == UNCONFIGURED else f"node id {value}"


def _bit_timing(data: bytes) -> str:
    if data[2] == AUTOMATIC_BIT_TIMING and not data[1]:
        return "configure bit rate: automatic"
    rate = BIT_TIMINGS.get(data[2]) if not data[1] else None
    return f"configure bit rate: {rate} bit/s" if rate else f"configure bit timing {data[2]} of table {data[1]}"


def _switch_global(data: bytes) -> str:
    known = {int(mode): mode.name.lower() for mode in LssMode}
    return f"all switch to {known.get(data[1], f'mode {data[1]}')}"


def _fast_scan(data: bytes) -> str:
    if data[5] == FAST_SCAN_START:
        return "fast scan: is anybody without a node id?"
    part = _PARTS[data[6]] if data[6] < len(_PARTS) else f"part {data[6]}"
    return f"fast scan: {part} 0x{_number(data):08X}, bits {data[5]} to 31"


def _answer(what: str, answers: dict[int, str]) -> Callable[[bytes], str]:
    def text(data: bytes) -> str:
        return f"{what}: {answers.get(data[1], f'error {data[1]}, detail {data[2]}')}"

    return text


def _part(prefix: str, part: str) -> Callable[[bytes], str]:
    return lambda data: f"{prefix} {part} 0x{_number(data):08X}"


def _said(text: str) -> Callable[[bytes], str]:
    return lambda _data: text


_C = LssCommand
_MASTER: dict[int, Callable[[bytes], str]] = {
    _C.SWITCH_GLOBAL: _switch_global,
    _C.CONFIGURE_NODE_ID: lambda data: f"configure {_node_id(data[1])}",
    _C.CONFIGURE_BIT_TIMING: _bit_timing,
    _C.ACTIVATE_BIT_TIMING: lambda data: f"activate bit rate after {data[1] | data[2] << 8} ms",
    _C.STORE: _said("store"),
    **{_C.SWITCH_SELECTIVE + n: _part("select", part) for n, part in enumerate(_PARTS)},
    **{_C.IDENTIFY + n: _part("identify", part) for n, part in enumerate(_RANGES)},
    _C.IDENTIFY_NON_CONFIGURED: _said("identify those without a node id"),
    _C.FAST_SCAN: _fast_scan,
    **{_C.INQUIRE + n: _said(f"inquire {part}") for n, part in enumerate(_PARTS)},
    _C.INQUIRE_NODE_ID: _said("inquire node id"),
}
_SLAVE: dict[int, Callable[[bytes], str]] = {
    _C.CONFIGURE_NODE_ID: _answer("node id", _NODE_ID_ANSWERS),
    _C.CONFIGURE_BIT_TIMING: _answer("bit rate", _BIT_TIMING_ANSWERS),
    _C.STORE: _answer("store", _STORE_ANSWERS),
    _C.SWITCHED: _said("selected"),
    _C.IDENTIFIED: _said("identified"),
    _C.IDENTIFIED_NON_CONFIGURED: _said("somebody has no node id"),
    **{_C.INQUIRE + n: _part("is", part) for n, part in enumerate(_PARTS)},
    _C.INQUIRE_NODE_ID: lambda data: _node_id(data[1]),
}
