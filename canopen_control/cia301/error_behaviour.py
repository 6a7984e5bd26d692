"""What a device does to its NMT state after an error: object 0x1029 as a table (CiA 301, 7.5.2.29).

Subindex 1 is for communication errors: bus-off, life guard, heartbeat, RPDO timeout. Later ones are the profile's.
"""

from __future__ import annotations

import enum

from canopen_control.cia301.abort import AbortCode
from canopen_control.cia301.nmt import NmtCommand, NmtState

__all__ = ["REACTIONS", "ErrorReaction", "check_reaction", "reaction"]


class ErrorReaction(enum.IntEnum):
    """The values of 0x1029."""

    PRE_OPERATIONAL = 0  # only from OPERATIONAL
    NO_CHANGE = 1
    STOPPED = 2


# What the node does to itself; a missing pair is: nothing.
REACTIONS: dict[tuple[ErrorReaction, NmtState], NmtCommand] = {
    (ErrorReaction.PRE_OPERATIONAL, NmtState.OPERATIONAL): NmtCommand.ENTER_PRE_OPERATIONAL,
    (ErrorReaction.STOPPED, NmtState.PRE_OPERATIONAL): NmtCommand.STOP,
    (ErrorReaction.STOPPED, NmtState.OPERATIONAL): NmtCommand.STOP,
}

_REACTIONS = {int(value): value for value in ErrorReaction}


def reaction(value: int, state: NmtState) -> NmtCommand | None:
    """Return the command a node gives itself, None: nothing; a manufacturer's value means nothing here."""
    known = _REACTIONS.get(value)
    return None if known is None else REACTIONS.get((known, state))


def check_reaction(value: int) -> AbortCode | None:
    """Return the abort code of a write to 0x1029, or None: accepted."""
    return None if value in _REACTIONS else AbortCode.INVALID_VALUE
