"""The way out of QUICK_STOP_ACTIVE for a master (CiA 402-2, transitions 12 and 16).

Law of this file: what the drive does after a quick stop is its own affair (0x605A) and is read from its state. To be
enabled it is asked at once by transition 16, which is optional; if that does not do, or if it is to be disabled, the
end of the stop is waited for, since power cut before it lets the motor coast. A drive with 0x605A = 0 to 4 leaves by
itself then; the others are told by transition 12, when the stop is seen done or has lasted too long.
"""

from __future__ import annotations

from enum import Enum

from canopen_control.cia402.state import TARGET_REACHED, Command

__all__ = ["QuickStopExit", "StopStage"]


class StopStage(Enum):
    """What is tried; each when the one before did not do."""

    ENABLE = "transition 16"
    WAIT = "for the end of the stop"
    DISABLE = "transition 12"


class QuickStopExit:
    """The stage reached since the drive was first seen in its quick stop, or since the goal changed."""

    def __init__(self) -> None:
        self.stage = StopStage.ENABLE
        self._moved = False

    def restart(self) -> None:
        """Begin again, for another goal."""
        self.stage = StopStage.ENABLE

    def enter(self) -> None:
        """Begin again, for another stop."""
        self.stage = StopStage.ENABLE
        self._moved = False

    def advance(self) -> None:
        """Give up the stage: its time is over."""
        self.stage = StopStage.WAIT if self.stage is StopStage.ENABLE else StopStage.DISABLE

    def look(self, statusword: int) -> None:
        """Take a statusword of the drive in its stop."""
        if not statusword & TARGET_REACHED:
            self._moved = True

    def command(self, enable: bool, statusword: int, standstill: bool, may_enable: bool) -> Command:
        """Return what to send: `enable` is wanted, `may_enable` at once, the motor is known to stand (`standstill`)."""
        if self.stage is StopStage.ENABLE and enable:
            return Command.ENABLE_OPERATION if may_enable else Command.QUICK_STOP
        if self.stage is not StopStage.DISABLE:
            # Bit 10 tells the end of the stop only if it was seen 0 in it: before, it may be an old target's.
            over = standstill or (self._moved and bool(statusword & TARGET_REACHED))
            self.stage = StopStage.DISABLE if over else StopStage.WAIT
        return Command.DISABLE_VOLTAGE if self.stage is StopStage.DISABLE else Command.QUICK_STOP
