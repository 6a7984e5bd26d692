from __future__ import annotations

import pytest

from canopen_control.cia301.abort import AbortCode
from canopen_control.cia301.nmt import TRANSITIONS, ErrorReaction, NmtState, check_reaction, reaction

PRE, OP, STOPPED, INIT = (
    NmtState.PRE_OPERATIONAL,
    NmtState.OPERATIONAL,
    NmtState.STOPPED,
    NmtState.INITIALISING,
)


@pytest.mark.parametrize(
    ("value", "state", "after"),
    [
        (ErrorReaction.PRE_OPERATIONAL, OP, PRE),
        (ErrorReaction.PRE_OPERATIONAL, PRE, PRE),
        (ErrorReaction.PRE_OPERATIONAL, STOPPED, STOPPED),
        (ErrorReaction.NO_CHANGE, OP, OP),
        (ErrorReaction.STOPPED, OP, STOPPED),
        (ErrorReaction.STOPPED, PRE, STOPPED),
        (ErrorReaction.STOPPED, STOPPED, STOPPED),
        (ErrorReaction.STOPPED, INIT, INIT),
        (0x80, OP, OP),
    ],
)
def test_reactions(value, state, after):
    command = reaction(value, state)
    assert (state if command is None else TRANSITIONS[state, command]) is after


def test_other_values_are_refused():
    assert [check_reaction(value) for value in (0, 1, 2)] == [None] * 3
    assert check_reaction(3) is AbortCode.INVALID_VALUE
