"""Why a drive should not be moved now: a fault with what it says of it, or torque that somebody else has given it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from canopen_control.cia301.emcy import error_text, register_text
from canopen_control.cia402.objects import ERROR_CODE, axis_index
from canopen_control.cia402.state import State
from canopen_control.errors import ConfigError
from canopen_control.od.model import DataType

if TYPE_CHECKING:
    from canopen_control.service.node_session import NodeSession


_POWERED: Final = (State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE)
_FAULTS: Final = (State.FAULT, State.FAULT_REACTION_ACTIVE)
_REGISTER, _HISTORY = (0x1001, 0), (0x1003, 1)
_MOST_ERRORS: Final = 32


def fault_words(node: NodeSession) -> str:
    """Say what fault a drive has, by 0x603F, 0x1003 and 0x1001; "" for a drive without one."""
    axes = [axis for axis, state in node.drive_states().items() if state in _FAULTS]
    if not axes:
        return ""
    told = []
    code = next(filter(None, (node.number(axis_index(ERROR_CODE, axis), 0, DataType.UNSIGNED16) for axis in axes)), 0)
    code = code or (node.number(*_HISTORY) or 0) & 0xFFFF
    if code:
        told.append(f"0x{code:04X} {error_text(code)}")
    if register := node.number(*_REGISTER, DataType.UNSIGNED8):
        told.append(f"error register 0x{register:02X} ({register_text(register)})")
    return ", ".join(told) or "it does not say which"


def error_history(node: NodeSession) -> list[str]:
    """Read what errors a node remembers (0x1003), the newest first; ConfigError for one that keeps no history."""
    count = node.number(_HISTORY[0], 0, DataType.UNSIGNED8)
    if count is None:
        raise ConfigError(f"{node} keeps no error history (0x1003)")
    codes = (node.number(_HISTORY[0], subindex) for subindex in range(1, min(count, _MOST_ERRORS) + 1))
    return [f"0x{code & 0xFFFF:04X} {error_text(code & 0xFFFF)}{_own(code)}" for code in codes if code]


def _own(code: int) -> str:
    """Return the maker's part of an entry of the history."""
    return f" (0x{code >> 16:04X})" if code >> 16 else ""


def why_not_free(node: NodeSession) -> str:
    """Say that somebody else has enabled the drive, "" where nobody has."""
    powered = [state for state in node.drive_states().values() if state in _POWERED]
    if not powered or powered[0] is None:
        return ""
    words = powered[0].name.replace("_", " ")
    return f"{node} is {words}: somebody else has enabled it, and two must not move it; end that program first"
