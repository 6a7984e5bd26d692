"""One fault reset: bit 7 of the controlword 0, then 1, then 0 (CiA 402-2, transition 15).

Law of this file: the edge is sent once per request, in FAULT only, since a drive still in its fault reaction would not
see it. Bit 7 falls again when the fault is gone, or when the time is over and the cause is still there.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from canopen_control.cia402.events import FaultResetFailed
from canopen_control.cia402.state import FAULT_RESET_BIT, State

if TYPE_CHECKING:
    from canopen_control.cia402.events import DriveEvent

__all__ = ["FaultReset"]

_NEVER: Final = (1 << 62) - 1


class FaultReset:
    """The sequence of one reset. `active` from the request to its end, `deadline` is when it has failed."""

    def __init__(self, timeout_ns: int) -> None:
        self.active = False
        self.bit = 0
        self.deadline = _NEVER
        self._timeout = timeout_ns
        self._low_sent = False

    def start(self) -> None:
        """Ask for a reset; nothing while one is under way."""
        if not self.active:
            self.active, self._low_sent, self.deadline = True, False, _NEVER

    def cancel(self) -> None:
        """End it, because the fault is gone, or the drive: bit 7 is 0 again."""
        self.active, self.bit, self.deadline = False, 0, _NEVER

    def update(self, state: State, statusword: int, now: int) -> DriveEvent | None:
        """Set `bit` for this cycle (0 or 0x80), for a drive in one of its two fault states."""
        if self.deadline == _NEVER:
            self.deadline = now + self._timeout
        if now >= self.deadline:
            self.cancel()
            return FaultResetFailed(now, statusword)
        if state is State.FAULT:
            self.bit = FAULT_RESET_BIT if self._low_sent else 0
            self._low_sent = True
        return None

    @property
    def rising(self) -> bool:
        """Whether the next update will raise bit 7 without anything else having to happen."""
        return self.active and self._low_sent and not self.bit
