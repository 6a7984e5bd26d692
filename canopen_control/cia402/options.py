"""The option codes 0x605A to 0x605E and 0x6007: how a drive stops, and the state it is in afterwards.

Law of this file: a code is a row of a table (CiA 402-2, 6.3.5 and 6.2.5). Negative codes are the manufacturer's, and
no row means reserved; the drive's own default stands in `DEFAULTS`. A master never decides by an option code what
state a drive is in: it looks at the statusword. The tables are for those who are the drive, or explain one.
"""

from __future__ import annotations

from enum import Enum
from types import MappingProxyType
from typing import TYPE_CHECKING, NamedTuple

from canopen_control.cia402 import objects
from canopen_control.cia402.state import Command, State

if TYPE_CHECKING:
    from collections.abc import Mapping

__all__ = ["ABORT_CONNECTION", "DEFAULTS", "OPTION_CODES", "Option", "Reaction"]


class Reaction(Enum):
    """How the motor is brought to rest."""

    DISABLE = "drive function off, the motor coasts"
    SLOW_DOWN_RAMP = "slow-down ramp"
    QUICK_STOP_RAMP = "quick-stop ramp"
    CURRENT_LIMIT = "at the current limit"
    VOLTAGE_LIMIT = "at the voltage limit"


class Option(NamedTuple):
    """One code's meaning: how the drive stops, and the state it is in when it stands."""

    reaction: Reaction
    final_state: State


_RAMPS = (Reaction.SLOW_DOWN_RAMP, Reaction.QUICK_STOP_RAMP, Reaction.CURRENT_LIMIT, Reaction.VOLTAGE_LIMIT)


def _ramps(first: int, final_state: State) -> dict[int, Option]:
    return {code: Option(reaction, final_state) for code, reaction in enumerate(_RAMPS, first)}


def _two(final_state: State) -> dict[int, Option]:
    return {0: Option(Reaction.DISABLE, final_state), 1: Option(Reaction.SLOW_DOWN_RAMP, final_state)}


OPTION_CODES: Mapping[int, Mapping[int, Option]] = MappingProxyType(
    {
        objects.QUICK_STOP_OPTION: {
            0: Option(Reaction.DISABLE, State.SWITCH_ON_DISABLED),
            **_ramps(1, State.SWITCH_ON_DISABLED),
            **_ramps(5, State.QUICK_STOP_ACTIVE),
        },
        objects.SHUTDOWN_OPTION: _two(State.READY_TO_SWITCH_ON),
        objects.DISABLE_OPERATION_OPTION: _two(State.SWITCHED_ON),
        objects.HALT_OPTION: _ramps(1, State.OPERATION_ENABLED),
        objects.FAULT_REACTION_OPTION: {
            0: Option(Reaction.DISABLE, State.FAULT),
            **_ramps(1, State.FAULT),
        },
    }
)
"""Index of the option code object to its codes."""

ABORT_CONNECTION: Mapping[int, Command | State | None] = MappingProxyType(
    {0: None, 1: State.FAULT, 2: Command.DISABLE_VOLTAGE, 3: Command.QUICK_STOP}
)
"""0x6007, when the connection is lost: nothing, a fault, or a command as if it had been received."""

DEFAULTS: Mapping[int, int] = MappingProxyType(
    {
        objects.ABORT_CONNECTION_OPTION: 1,
        objects.QUICK_STOP_OPTION: 2,
        objects.SHUTDOWN_OPTION: 0,
        objects.DISABLE_OPERATION_OPTION: 1,
        objects.HALT_OPTION: 1,
        objects.FAULT_REACTION_OPTION: 2,
    }
)
"""The profile's default of each option code; it is also what an absent object means."""
