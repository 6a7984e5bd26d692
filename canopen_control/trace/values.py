"""Values of objects as text, such as a statusword, a COB-ID or a mapping entry.

The number is always shown, followed by the text. Objects of the communication profile are those of CiA 301 (7.5.2);
objects from 0x6000 on are those of CiA 402-2, only for a node that is a drive.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, NamedTuple

from canopen_control.cia301.emcy import code_text, error_text, register_text
from canopen_control.cia301.pdo import DUMMY_TYPES, INVALID_BIT, parse_mapping_entry
from canopen_control.cia402 import objects
from canopen_control.cia402.modes import MODE_BITS, mode_name, supported_modes
from canopen_control.cia402.state import (
    HALT_BIT,
    INTERNAL_LIMIT,
    POWERED_STATES,
    REMOTE,
    TARGET_REACHED,
    VOLTAGE_ENABLED,
    WARNING,
    Command,
    State,
    command_of,
    decode_statusword,
)
from canopen_control.od.codec import decode
from canopen_control.trace.network_description import entry_name

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from canopen_control.od.model import DataType, ObjectDictionary, Value
    from canopen_control.trace.network_description import NodeDescription


_SHOWN_BYTES = 16
_NUMBER_SIZES = (1, 2, 4, 8)
_ERROR_BEHAVIOUR = {0: "to PRE-OPERATIONAL", 1: "no change of state", 2: "to STOPPED"}  # 0x1029 (CiA 301)
_SIGNATURES = {0x65766173: "save", 0x64616F6C: "load"}  # 0x1010 and 0x1011 (CiA 301, 7.5.2.13 and 7.5.2.14)


class SignalValue(NamedTuple):
    """Value of an object in a frame: its address and name, the value decoded by its data type, and its text."""

    index: int  # type: ignore[assignment]  # hides tuple.index, which means nothing here
    subindex: int
    name: str
    value: Value
    text: str


def is_faulty(state: State | None) -> bool:
    """Whether a CiA 402 state indicates a fault."""
    return state in (State.FAULT, State.FAULT_REACTION_ACTIVE)


def statusword_text(statusword: int, mode: int | None = None) -> str:
    """Return text such as ``0x0637 OPERATION ENABLED, target reached``; `mode` selects bits 10, 12 and 13."""
    state = decode_statusword(statusword)
    name = "undefined state" if state is None else state.name.replace("_", " ")
    return ", ".join((f"0x{statusword & 0xFFFF:04X} {name}", *_status_flags(statusword, state, mode)))


def _status_flags(statusword: int, state: State | None, mode: int | None) -> Iterator[str]:
    if state in POWERED_STATES and not statusword & VOLTAGE_ENABLED:
        yield "no voltage"
    if statusword & WARNING:
        yield "warning"
    if not statusword & REMOTE:
        yield "not remote"
    if statusword & INTERNAL_LIMIT:
        yield "internal limit"
    if state not in POWERED_STATES:
        return  # mode-specific bits have no meaning while the drive is not enabled (CiA 402-2)
    mode_bits = MODE_BITS.get(mode) if mode is not None else None
    if mode_bits is None:
        if statusword & TARGET_REACHED:
            yield "target reached"
        return
    for bit, text in mode_bits.statusword.items():
        if statusword >> bit & 1:
            yield text


def controlword_text(controlword: int, previous: int = 0, state: State | None = None, mode: int | None = None) -> str:
    """Return text such as ``0x000F ENABLE OPERATION``; `mode` selects the mode-specific bits.

    `previous` is the previous controlword, `state` the last state of the drive.
    """
    command = command_of(controlword, previous)
    if command is None:
        name = "FAULT RESET held" if controlword & 0x80 else "no command"
    elif command is Command.SWITCH_ON and state is State.OPERATION_ENABLED:
        name = "DISABLE OPERATION"  # one bit pattern with two names: the state of the drive decides (CiA 402-2)
    else:
        name = command.name.replace("_", " ")
    mode_bits = MODE_BITS.get(mode) if mode is not None else None
    bits = mode_bits.controlword if mode_bits is not None else {8: "halt"} if controlword & HALT_BIT else {}
    flags = [text for bit, text in bits.items() if controlword >> bit & 1]
    return ", ".join((f"0x{controlword & 0xFFFF:04X} {name}", *flags))


def bytes_text(data: bytes) -> str:
    """Return bytes in hexadecimal; long data is shortened to its first bytes and its length."""
    if len(data) <= _SHOWN_BYTES:
        return data.hex(" ") or "no bytes"
    return f"{data[:_SHOWN_BYTES].hex(' ')} ... ({len(data)} bytes)"


def decoded(data: bytes, data_type: DataType | None) -> Value:
    """Decode bytes by data type (without a type as a number); return the bytes if they do not fit."""
    if data_type is None:
        return int.from_bytes(data, "little") if len(data) in _NUMBER_SIZES else bytes(data)
    try:
        return decode(data, data_type)
    except ValueError:
        return bytes(data)


class ValueChange(enum.IntEnum):
    """Importance of a change in the values of a node."""

    NONE = 0
    STATE = 1  # another state, command or mode
    FAULT = 2  # a fault state was entered


@dataclass(slots=True)
class AxisWords:
    """Last known values of one axis, which affect the texts of later values."""

    mode: int | None = None
    state: State | None = None
    controlword: int = 0
    command: Command | None = None
    change: ValueChange = ValueChange.NONE


class NodeWords:
    """Converter of a node's values to texts, which remembers those values of the axes that affect later texts."""

    def __init__(self, node: NodeDescription) -> None:
        self._od: ObjectDictionary | None = node.od
        self._is_drive = node.is_drive
        self._axes: dict[int, AxisWords] = {}

    def name(self, index: int, subindex: int) -> str:
        """Return the name of an object from the EDS, or from CiA 402 for a drive, or "" if unknown."""
        name = entry_name(self._od, index, subindex)
        if name or not self._is_drive:
            return name
        return objects.object_name(index) or ""

    def take_change(self) -> ValueChange:
        """Return the most important change in the values of all axes since the previous call."""
        greatest = max((axis.change for axis in self._axes.values()), default=ValueChange.NONE)
        for axis in self._axes.values():
            axis.change = ValueChange.NONE
        return greatest

    def text(self, index: int, subindex: int, value: Value) -> str:
        """Return a value as text, and remember it if later texts depend on it."""
        if isinstance(value, str):
            return repr(value)
        if isinstance(value, bytes | bytearray):
            return bytes_text(bytes(value))
        if isinstance(value, float):
            return f"{value:.9g}"
        base, number = objects.axis_of(index)
        words = _DRIVE_WORDS.get(base) if self._is_drive and not subindex else None
        if words is not None:
            return words(self._axes.setdefault(number, AxisWords()), value)
        return self._communication(index, subindex, value) or str(value)

    def _communication(self, index: int, subindex: int, value: int) -> str:
        for first, last, lowest, words in _COMMUNICATION:
            if first <= index <= last and subindex >= lowest:
                return words(self, subindex, value)
        return ""

    def mapping(self, _subindex: int, value: int) -> str:
        index, subindex, bits = parse_mapping_entry(value)
        name = f"dummy {DUMMY_TYPES[index].name}" if index in DUMMY_TYPES else self.name(index, subindex)
        return f"0x{value:08X} (0x{index:04X}:{subindex:02X} {name}, {bits} bits)" if value else "0 (nothing)"


def _statusword(axis: AxisWords, value: int) -> str:
    state = decode_statusword(value)
    if state is not axis.state:
        axis.change = max(
            axis.change, ValueChange.FAULT if is_faulty(state) and not is_faulty(axis.state) else ValueChange.STATE
        )
    axis.state = state
    return statusword_text(value, axis.mode)


def _controlword(axis: AxisWords, value: int) -> str:
    text = controlword_text(value, axis.controlword, axis.state, axis.mode)
    command, axis.controlword = command_of(value, axis.controlword), value
    if command is not axis.command:
        axis.change = max(axis.change, ValueChange.STATE)
    axis.command = command
    return text


def _mode_display(axis: AxisWords, value: int) -> str:
    if value != axis.mode:
        axis.change = max(axis.change, ValueChange.STATE)
    axis.mode = value
    return _mode_text(value)


def _mode_text(mode: int) -> str:
    # values below zero are manufacturer-specific (CiA 402-2)
    return f"{mode} {mode_name(mode)}" if mode >= 0 else f"{mode}"


def _supported(_axis: AxisWords, value: int) -> str:
    names = ", ".join(mode.name for mode in supported_modes(value))
    return f"0x{value:08X} ({names or 'no mode'})"


def _communication_record(_words: NodeWords, subindex: int, value: int) -> str:
    if subindex == 1:
        cob_id = f"0x{value & 0x1FFFFFFF:03X}"
        return f"0x{value:08X} ({cob_id}, off)" if value & INVALID_BIT else f"0x{value:08X} ({cob_id}, on)"
    if subindex == 2:
        return f"{value} ({_transmission(value)})"
    units = {3: f"{value * 0.1:g} ms", 5: f"{value} ms"}
    return f"{value} ({units[subindex]})" if subindex in units and value else str(value)


def _transmission(value: int) -> str:
    # CiA 301, 7.5.2.37
    named = {0: "at SYNC when it changed", 1: "every SYNC", 252: "at SYNC, on request", 253: "on request"}
    return named.get(value) or (f"every {value} SYNCs" if value <= 240 else "on events" if value >= 254 else "reserved")


def _hex(_words: NodeWords, _subindex: int, value: int) -> str:
    return f"0x{value:08X}"


def _consumer(_words: NodeWords, _subindex: int, value: int) -> str:
    node_id, ms = value >> 16 & 0xFF, value & 0xFFFF
    return f"0x{value:08X} (node {node_id} within {ms} ms)" if node_id and ms else f"0x{value:08X} (no node)"


def _store(_words: NodeWords, _subindex: int, value: int) -> str:
    return f"0x{value:08X}" + (f" ({_SIGNATURES[value]!r})" if value in _SIGNATURES else "")


def _device_type(_words: NodeWords, _subindex: int, value: int) -> str:
    return f"0x{value:08X} (profile {value & 0xFFFF})"


def _register(_words: NodeWords, _subindex: int, value: int) -> str:
    return f"0x{value:02X} ({register_text(value) or 'no error'})"


def _history(_words: NodeWords, _subindex: int, value: int) -> str:
    return f"0x{value:08X} ({error_text(value & 0xFFFF)})"


def _error_behaviour(_words: NodeWords, _subindex: int, value: int) -> str:
    return f"{value} ({_ERROR_BEHAVIOUR[value]})" if value in _ERROR_BEHAVIOUR else str(value)


def _milliseconds(_words: NodeWords, _subindex: int, value: int) -> str:
    return f"{value} ms"


def _microseconds(_words: NodeWords, _subindex: int, value: int) -> str:
    return f"{value} us"


_DRIVE_WORDS: Final[dict[int, Callable[[AxisWords, int], str]]] = {
    objects.STATUSWORD: _statusword,
    objects.CONTROLWORD: _controlword,
    objects.MODES_OF_OPERATION: lambda _axis, mode: _mode_text(mode),
    objects.MODES_OF_OPERATION_DISPLAY: _mode_display,
    objects.ERROR_CODE: lambda _axis, code: code_text(code),
    objects.SUPPORTED_DRIVE_MODES: _supported,
}
# first and last index, lowest subindex, text; CiA 301, 7.5.2
_COMMUNICATION: tuple[tuple[int, int, int, Callable[[NodeWords, int, int], str]], ...] = (
    (0x1000, 0x1000, 0, _device_type),
    (0x1001, 0x1001, 0, _register),
    (0x1003, 0x1003, 1, _history),
    (0x1005, 0x1005, 0, _hex),
    (0x1006, 0x1007, 0, _microseconds),
    (0x100C, 0x100C, 0, _milliseconds),
    (0x1010, 0x1011, 1, _store),
    (0x1012, 0x1014, 0, _hex),
    (0x1016, 0x1016, 1, _consumer),
    (0x1017, 0x1017, 0, _milliseconds),
    (0x1018, 0x1018, 1, _hex),
    (0x1029, 0x1029, 1, _error_behaviour),
    (0x1200, 0x12FF, 1, _hex),
    (0x1400, 0x15FF, 1, _communication_record),
    (0x1600, 0x17FF, 1, NodeWords.mapping),
    (0x1800, 0x19FF, 1, _communication_record),
    (0x1A00, 0x1BFF, 1, NodeWords.mapping),
)
