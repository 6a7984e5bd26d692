"""A mode of operation that was asked for, until 0x6061 confirms it (CiA 402-2, 6.4).

Law of this file: a mode is one only when the drive's display shows it. What is not confirmed in time goes back to the
last mode that was, and has failed until somebody asks again. 0 is never asked for by itself.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from canopen_control.cia402.events import ModeConfirmed, ModeTimedOut

if TYPE_CHECKING:
    from canopen_control.cia402.events import DriveEvent

__all__ = ["ModeRequest"]

_NEVER: Final = (1 << 62) - 1


class ModeRequest:
    """What to write to 0x6060, and whether 0x6061 shows it.

    `mode` is None as long as none is asked for; `confirmed` is then True. `failed` tells that the last one asked for
    was never confirmed; `deadline` when that will be decided, `_NEVER` for none.
    """

    def __init__(self, timeout_ns: int) -> None:
        self.mode: int | None = None
        self.confirmed = True
        self.failed = False
        self.display: int | None = None
        self.deadline = _NEVER
        self._timeout = timeout_ns
        self._last_confirmed: int | None = None

    def ask(self, mode: int) -> bool:
        """Ask for `mode` and return whether that is anything new."""
        self.failed = False
        if mode == self.mode:
            return False
        self.mode, self.confirmed, self.deadline = mode, False, _NEVER
        return True

    def forget_display(self) -> None:
        """Forget what a drive that is gone showed; what it shall do stays."""
        self.display = None
        self.confirmed = self.mode is None
        self.deadline = _NEVER

    def update(self, display: int | None, now: int) -> DriveEvent | None:
        """Take the newest 0x6061 (None: not received) and return what happened, None for nothing."""
        self.display = display
        mode = self.mode
        if mode is None:
            return None
        if display == mode:
            return self._confirm(mode, now)
        if self.deadline == _NEVER:
            self.confirmed = False
            self.deadline = now + self._timeout
        elif now >= self.deadline:
            return self._time_out(mode, now)
        return None

    def _confirm(self, mode: int, now: int) -> DriveEvent | None:
        self.deadline = _NEVER
        if self.confirmed:
            return None
        self.confirmed, self._last_confirmed = True, mode
        return ModeConfirmed(now, mode)

    def _time_out(self, mode: int, now: int) -> DriveEvent:
        self.mode = self._last_confirmed if self._last_confirmed != mode else None
        self.confirmed = self.mode is not None and self.mode == self.display
        self.failed = True
        self.deadline = _NEVER
        return ModeTimedOut(now, mode, self.display, self.mode)
