"""Power state machine of CiA 402-2 (IEC 61800-7-201, 6.3) as tables: states, commands, the 17 transitions.

The tables define which statusword means which state, which controlword means which command, and which command leads
from one state to another. Master and virtual drive use the same tables; only `next_command`, the master's sequence,
makes a decision.

- A statusword matches a state when ``(statusword ^ value) & mask == 0``. Bit 4 (voltage enabled) is never in the mask,
  bit 5 only if the mask is 0x6F. 53,248 of the 65,536 statuswords match no state.
- ``SWITCH_ON`` and ``DISABLE_OPERATION`` have the same bits, as have ``ENABLE_OPERATION`` and
  ``SWITCH_ON_AND_ENABLE``: they are aliases of one member here; only the drive's state distinguishes them.
- A fault is reset by the rising edge of bit 7, never by its level.
"""

from __future__ import annotations

from enum import Enum
from types import MappingProxyType
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Mapping


# Statusword bits that are not part of the state (CiA 402-2, table 30).
VOLTAGE_ENABLED = 1 << 4
WARNING = 1 << 7
REMOTE = 1 << 9
TARGET_REACHED = 1 << 10
INTERNAL_LIMIT = 1 << 11

# Controlword bits that are not part of a command (CiA 402-2, table 27).
MODE_SPECIFIC_BITS = 0x0270  # bits 4, 5, 6 and 9
FAULT_RESET_BIT = 1 << 7
HALT_BIT = 1 << 8


class State(Enum):
    """State of the power state machine; each value is the statusword of the state without the optional bits."""

    NOT_READY_TO_SWITCH_ON = 0x00
    SWITCH_ON_DISABLED = 0x40
    READY_TO_SWITCH_ON = 0x21
    SWITCHED_ON = 0x23
    OPERATION_ENABLED = 0x27
    QUICK_STOP_ACTIVE = 0x07
    FAULT_REACTION_ACTIVE = 0x0F
    FAULT = 0x08


POWERED_STATES = (State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE, State.FAULT_REACTION_ACTIVE)
"""States in which the motor has, or may have, torque."""

STATUSWORD_MASKS: Mapping[State, int] = MappingProxyType(
    {
        State.NOT_READY_TO_SWITCH_ON: 0x4F,
        State.SWITCH_ON_DISABLED: 0x4F,
        State.READY_TO_SWITCH_ON: 0x6F,
        State.SWITCHED_ON: 0x6F,
        State.OPERATION_ENABLED: 0x6F,
        State.QUICK_STOP_ACTIVE: 0x6F,
        State.FAULT_REACTION_ACTIVE: 0x4F,
        State.FAULT: 0x4F,
    }
)
_ALL_MASKS = 0x6F


def _state_of_bits(bits: int) -> State | None:
    matches = (state for state, mask in STATUSWORD_MASKS.items() if not (bits ^ state.value) & mask)
    return next(matches, None)


# One entry for each pattern of the relevant bits: 112 pointers instead of 65,536.
_STATE_BY_BITS = tuple(_state_of_bits(bits) for bits in range(_ALL_MASKS + 1))


def decode_statusword(statusword: int) -> State | None:
    """Return the state for a value of 0x6041, or None if its bits match no state; accepts every int."""
    return _STATE_BY_BITS[statusword & _ALL_MASKS]


class Command(Enum):
    """Command in the controlword, as (mask, bits); commands with the same bits are aliases."""

    SHUTDOWN = (0x87, 0x06)
    SWITCH_ON = (0x8F, 0x07)
    DISABLE_OPERATION = SWITCH_ON
    ENABLE_OPERATION = (0x8F, 0x0F)
    SWITCH_ON_AND_ENABLE = ENABLE_OPERATION
    DISABLE_VOLTAGE = (0x82, 0x00)
    QUICK_STOP = (0x86, 0x02)
    FAULT_RESET = (0x80, 0x80)


def controlword_of(command: Command) -> int:
    """Return the controlword for a command; all bits outside the command are 0."""
    return command.value[1]


_LEVEL_COMMANDS = tuple(command for command in Command if command is not Command.FAULT_RESET)


def _command_of_bits(bits: int) -> Command | None:
    matches = (command for command in _LEVEL_COMMANDS if bits & command.value[0] == command.value[1])
    return next(matches, None)


_COMMAND_BY_BITS = tuple(_command_of_bits(bits) for bits in range(0x100))


def command_of(controlword: int, previous: int) -> Command | None:
    """Return the command in a controlword (CiA 402-2, table 24); `previous` is the last controlword, 0 at the start.

    A rising bit 7 is FAULT_RESET regardless of the other bits; while bit 7 stays 1 the result is None.
    """
    # CiA 402-2, table 24: the fault reset is the rising edge of bit 7
    if controlword & ~previous & FAULT_RESET_BIT:
        return Command.FAULT_RESET
    return _COMMAND_BY_BITS[controlword & 0xFF]


class Transition(NamedTuple):
    """Transition of the state diagram (CiA 402-2, table 22).

    `sources` is empty for power-on, `commands` is empty for automatic transitions. `condition` is a further condition,
    or the option code that decides how the transition is performed.
    """

    number: int
    sources: tuple[State, ...]
    target: State
    commands: tuple[Command, ...] = ()
    condition: str = ""


_S, _C = State, Command
TRANSITIONS: tuple[Transition, ...] = (
    Transition(0, (), _S.NOT_READY_TO_SWITCH_ON, (), "power-on or application reset"),
    Transition(1, (_S.NOT_READY_TO_SWITCH_ON,), _S.SWITCH_ON_DISABLED, (), "self-test and initialisation done"),
    Transition(2, (_S.SWITCH_ON_DISABLED,), _S.READY_TO_SWITCH_ON, (_C.SHUTDOWN,)),
    Transition(3, (_S.READY_TO_SWITCH_ON,), _S.SWITCHED_ON, (_C.SWITCH_ON,)),
    Transition(4, (_S.SWITCHED_ON,), _S.OPERATION_ENABLED, (_C.ENABLE_OPERATION,)),
    Transition(5, (_S.OPERATION_ENABLED,), _S.SWITCHED_ON, (_C.DISABLE_OPERATION,), "as 0x605C says"),
    Transition(6, (_S.SWITCHED_ON,), _S.READY_TO_SWITCH_ON, (_C.SHUTDOWN,)),
    Transition(7, (_S.READY_TO_SWITCH_ON,), _S.SWITCH_ON_DISABLED, (_C.DISABLE_VOLTAGE, _C.QUICK_STOP)),
    Transition(8, (_S.OPERATION_ENABLED,), _S.READY_TO_SWITCH_ON, (_C.SHUTDOWN,), "as 0x605B says"),
    Transition(9, (_S.OPERATION_ENABLED,), _S.SWITCH_ON_DISABLED, (_C.DISABLE_VOLTAGE,), "at once: the motor coasts"),
    Transition(10, (_S.SWITCHED_ON,), _S.SWITCH_ON_DISABLED, (_C.DISABLE_VOLTAGE, _C.QUICK_STOP)),
    Transition(11, (_S.OPERATION_ENABLED,), _S.QUICK_STOP_ACTIVE, (_C.QUICK_STOP,), "as 0x605A says"),
    Transition(
        12,
        (_S.QUICK_STOP_ACTIVE,),
        _S.SWITCH_ON_DISABLED,
        (_C.DISABLE_VOLTAGE,),
        "also by itself when the stop is done and 0x605A is 0 to 4",
    ),
    Transition(
        13,
        tuple(state for state in _S if state not in (_S.FAULT_REACTION_ACTIVE, _S.FAULT)),
        _S.FAULT_REACTION_ACTIVE,
        (),
        "a fault, as 0x605E says",
    ),
    Transition(14, (_S.FAULT_REACTION_ACTIVE,), _S.FAULT, (), "the reaction is done"),
    Transition(15, (_S.FAULT,), _S.SWITCH_ON_DISABLED, (_C.FAULT_RESET,), "the cause is gone"),
    Transition(16, (_S.QUICK_STOP_ACTIVE,), _S.OPERATION_ENABLED, (_C.ENABLE_OPERATION,), "0x605A is 5 to 8; optional"),
)

_BY_COMMAND = {
    (source, command): transition
    for transition in TRANSITIONS
    for source in transition.sources
    for command in transition.commands
}


def transition_of(state: State, command: Command) -> Transition | None:
    """Return the transition that a command triggers in a state, or None if the state diagram has none."""
    return _BY_COMMAND.get((state, command))


# Commands of the master by goal (row) and present state (column): one step at a time, each confirmed by the statusword
# before the next step, so that 0x0F is never sent to a drive that was not seen in SWITCHED_ON (or in a quick stop,
# transition 16). Disabling never uses a transition that enables. In the goal state the command is sent that keeps it.
_DOWN_TO_SWITCHED_ON = {
    _S.SWITCH_ON_DISABLED: _C.DISABLE_VOLTAGE,
    _S.READY_TO_SWITCH_ON: _C.SHUTDOWN,
    _S.SWITCHED_ON: _C.SWITCH_ON,
    _S.OPERATION_ENABLED: _C.DISABLE_OPERATION,
    _S.QUICK_STOP_ACTIVE: _C.DISABLE_VOLTAGE,
}
_DOWN_TO_READY = {**_DOWN_TO_SWITCHED_ON, _S.SWITCHED_ON: _C.SHUTDOWN}
_NEXT: dict[State, dict[State, Command]] = {
    _S.SWITCH_ON_DISABLED: {**_DOWN_TO_READY, _S.READY_TO_SWITCH_ON: _C.DISABLE_VOLTAGE},
    _S.READY_TO_SWITCH_ON: _DOWN_TO_READY,
    _S.SWITCHED_ON: _DOWN_TO_SWITCHED_ON,
    _S.OPERATION_ENABLED: {
        _S.SWITCH_ON_DISABLED: _C.SHUTDOWN,
        _S.READY_TO_SWITCH_ON: _C.SWITCH_ON,
        _S.SWITCHED_ON: _C.ENABLE_OPERATION,
        _S.OPERATION_ENABLED: _C.ENABLE_OPERATION,
        _S.QUICK_STOP_ACTIVE: _C.ENABLE_OPERATION,
    },
    _S.QUICK_STOP_ACTIVE: {
        _S.SWITCH_ON_DISABLED: _C.DISABLE_VOLTAGE,
        _S.READY_TO_SWITCH_ON: _C.QUICK_STOP,
        _S.SWITCHED_ON: _C.QUICK_STOP,
        _S.OPERATION_ENABLED: _C.QUICK_STOP,
        _S.QUICK_STOP_ACTIVE: _C.QUICK_STOP,
    },
}


def next_command(state: State, goal: State) -> Command | None:
    """Return the command for one step from `state` towards `goal`, or the command that holds `state`.

    Goals are SWITCH_ON_DISABLED, READY_TO_SWITCH_ON and SWITCHED_ON (never upwards to them), OPERATION_ENABLED and
    QUICK_STOP_ACTIVE (also reached in SWITCH_ON_DISABLED). None means that no command helps, because the drive is
    starting or in a fault (only an explicit reset ends a fault), or because `goal` is not one of these states.
    """
    row = _NEXT.get(goal)
    return row.get(state) if row is not None else None
