"""A mode of operation that was asked for, until 0x6061 confirms it (CiA 402-2, 6.4).

Law of this file: a mode is one only when the drive's display shows it. What is not confirmed in time goes back to the
last mode that was, and has failed until somebody asks again. 0 is never asked for by itself. `TABLE` says what each
trigger leads to; what has no row changes nothing.

Some drives show 0, no mode, until they are enabled (ros-industrial/ros2_canopen, issue 444). Such a drive may be
enabled in a mode that it has not shown; nothing but its targets at rest is sent before it shows the mode, in time.
"""

from __future__ import annotations

from enum import Enum
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

from canopen_control.cia402.events import ModeConfirmed, ModeTimedOut

if TYPE_CHECKING:
    from collections.abc import Mapping

    from canopen_control.cia402.events import DriveEvent

__all__ = ["CONFIRMED", "FAILED", "TABLE", "ModeRequest", "ModeState", "ModeTrigger"]

_NEVER: Final = (1 << 62) - 1


class ModeState(Enum):
    """How far a request for a mode is; the value says what it means."""

    NONE = "nobody asked for a mode: the drive's own is right"
    ASKED = "a mode is asked for, and 0x6061 does not show it"
    UNSHOWN = "the drive shows no mode while it is off: it may be enabled, and has to show the mode then"
    CONFIRMED = "0x6061 shows the mode that was asked for"
    REFUSED = "the mode was not confirmed in time, and there is none to go back to"
    RETURNING = "the mode was not confirmed in time; the one before it is asked for again, and 0x6061 does not show it"
    RETURNED = "the mode was not confirmed in time; 0x6061 shows the one before it"


class ModeTrigger(Enum):
    """What makes the table take a row; the value says when."""

    ASK = "somebody asks for another mode"
    ASK_AGAIN = "somebody asks for the mode that is asked for already"
    SHOWN = "0x6061 shows the mode"
    NOT_SHOWN = "0x6061 shows another mode, or nothing"
    NONE_SHOWN = "half of the time is over, and 0x6061 of a drive that is off shows 0"
    GONE = "the drive is gone"
    OVERDUE = "the time is over, and no other mode was confirmed before"
    OVERDUE_RETURN = "the time is over, and another mode was confirmed before"
    OVERDUE_STAYED = "the time is over, and 0x6061 shows the mode that was confirmed before"


_S, _T = ModeState, ModeTrigger
_ANEW: Final = {_T.ASK: _S.ASKED}
_TIMED: Final = {_T.OVERDUE: _S.REFUSED, _T.OVERDUE_RETURN: _S.RETURNING, _T.OVERDUE_STAYED: _S.RETURNED}

TABLE: Final[Mapping[ModeState, Mapping[ModeTrigger, ModeState]]] = MappingProxyType(
    {
        _S.NONE: _ANEW,
        _S.ASKED: {**_ANEW, **_TIMED, _T.SHOWN: _S.CONFIRMED, _T.NONE_SHOWN: _S.UNSHOWN},
        _S.UNSHOWN: {**_ANEW, **_TIMED, _T.SHOWN: _S.CONFIRMED, _T.NONE_SHOWN: _S.UNSHOWN, _T.GONE: _S.ASKED},
        _S.CONFIRMED: {**_ANEW, _T.NOT_SHOWN: _S.ASKED, _T.GONE: _S.ASKED},
        _S.REFUSED: _ANEW,
        _S.RETURNING: {**_ANEW, _T.ASK_AGAIN: _S.ASKED, _T.OVERDUE: _S.REFUSED, _T.SHOWN: _S.RETURNED},
        _S.RETURNED: {
            **_ANEW,
            _T.ASK_AGAIN: _S.CONFIRMED,
            _T.NOT_SHOWN: _S.RETURNING,
            _T.GONE: _S.RETURNING,
        },
    }
)
"""State and trigger to the next state; a trigger without a row changes nothing."""

CONFIRMED: Final = (_S.NONE, _S.CONFIRMED, _S.RETURNED)
"""The states in which the drive is in the mode that it shall have."""
FAILED: Final = (_S.REFUSED, _S.RETURNING, _S.RETURNED)
"""The states after a mode that was not confirmed; they end when somebody asks again."""


class ModeRequest:
    """What to write to 0x6060, and whether 0x6061 shows it.

    `mode` is None as long as none is asked for; `deadline` is when an unconfirmed one has failed, `_NEVER` for none.
    """

    def __init__(self, timeout_ns: int) -> None:
        self.state = ModeState.NONE
        self.mode: int | None = None
        self.display: int | None = None
        self.deadline = _NEVER
        self._timeout = timeout_ns
        self._last_confirmed: int | None = None

    @property
    def confirmed(self) -> bool:
        """Whether 0x6061 shows `mode`, or none was asked for."""
        return self.state in CONFIRMED

    @property
    def may_enable(self) -> bool:
        """Whether the drive may be enabled: in the mode, or without showing any until it is enabled."""
        return self.state in CONFIRMED or self.state is ModeState.UNSHOWN

    @property
    def failed(self) -> bool:
        """Whether the last mode asked for was not confirmed in time."""
        return self.state in FAILED

    def ask(self, mode: int) -> bool:
        """Ask for `mode` and return whether that is anything new."""
        if mode == self.mode:
            self._fire(ModeTrigger.ASK_AGAIN)
            return False
        self.mode, self.deadline = mode, _NEVER
        self._fire(ModeTrigger.ASK)
        return True

    def forget_display(self) -> None:
        """Forget what a drive that is gone showed; what it shall do stays."""
        self.display = None
        self.deadline = _NEVER
        self._fire(ModeTrigger.GONE)

    def update(self, display: int | None, enabled: bool, now: int) -> DriveEvent | None:
        """Take the newest 0x6061 (None: not received) and return what happened, None for nothing.

        `enabled` is whether the drive is in OPERATION_ENABLED.
        """
        self.display = display
        mode = self.mode
        if mode is None:
            return None
        if display == mode:
            return self._confirm(mode, now)
        unshown = display == 0 and not enabled
        if self.deadline == _NEVER:
            if not (unshown and self.state is ModeState.UNSHOWN):
                self.deadline = now + (self._timeout // 2 if unshown else self._timeout)
                self._fire(ModeTrigger.NOT_SHOWN)
        elif now >= self.deadline:
            if not (unshown and self._fire(ModeTrigger.NONE_SHOWN)):
                return self._time_out(mode, now)
            self.deadline = _NEVER
        return None

    def _fire(self, trigger: ModeTrigger) -> bool:
        """Take the row of a trigger; returns whether there is one."""
        state = TABLE[self.state].get(trigger)
        if state is not None:
            self.state = state
        return state is not None

    def _confirm(self, mode: int, now: int) -> DriveEvent | None:
        self.deadline = _NEVER
        if not self._fire(ModeTrigger.SHOWN):
            return None
        self._last_confirmed = mode
        return ModeConfirmed(now, mode)

    def _time_out(self, mode: int, now: int) -> DriveEvent:
        back = self._last_confirmed if self._last_confirmed != mode else None
        self.mode, self.deadline = back, _NEVER
        if back is None:
            self._fire(ModeTrigger.OVERDUE)
        else:
            self._fire(ModeTrigger.OVERDUE_STAYED if back == self.display else ModeTrigger.OVERDUE_RETURN)
        return ModeTimedOut(now, mode, self.display, back)
