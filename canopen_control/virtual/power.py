"""The power state machine of one axis: states, transitions, and how each stops the motor (CiA 402-2, 6.3).

The law of this file: a command is what the table of `cia402.state` makes of the controlword in the present state. What
a transition does is a row of `_PERFORM`; how a stop is made is what the option code says. The motor has power in
OPERATION_ENABLED, QUICK_STOP_ACTIVE and FAULT_REACTION_ACTIVE only, and the first begins only while the node is
OPERATIONAL.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

from canopen_control.cia402 import objects as o
from canopen_control.cia402.options import ABORT_CONNECTION, DEFAULTS, OPTION_CODES, Option, Reaction
from canopen_control.cia402.state import (
    HALT_BIT,
    POWERED_STATES,
    Command,
    State,
    Transition,
    command_of,
    transition_of,
)
from canopen_control.virtual.events import DriveFaulted, DriveStateChanged

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.virtual.drive import VirtualDrive

__all__ = ["PowerMachine"]

_MS = 1_000_000


class PowerMachine:
    """The state of one drive's power stage.

    `stop_target` is the state that a ramp under way ends in, `halted` whether the halt bit holds the motor. Whoever
    injects faults uses `voltage` (the power stage has supply), `causes` (of faults, that cannot be reset yet),
    `extra_delay_ns` (of every transition), `reset_deaf` and `fault_on_enable` (its code).
    """

    def __init__(self, drive: VirtualDrive) -> None:
        self._drive = drive
        self.state = State.NOT_READY_TO_SWITCH_ON
        self.stop_target: State | None = None
        self.halted = False
        self.voltage = True
        self.causes: set[int] = set()
        self.extra_delay_ns = 0
        self.reset_deaf = False
        self.fault_on_enable = 0

    @property
    def running(self) -> bool:
        """Whether operation is enabled and not on its way out."""
        return self.state is State.OPERATION_ENABLED and self.stop_target is None

    def _option(self, index: int) -> Option:
        """Return what an option code object says; a vendor's code is taken for the default."""
        codes = OPTION_CODES[index]
        return codes.get(self._drive.number(index, default=DEFAULTS[index])) or codes[DEFAULTS[index]]

    def obey(self, command: Command, now: int) -> None:
        """Do what a command asks for in the present state; nothing where the table knows no transition."""
        if "transition" in self._drive.mover.timers and command is not Command.DISABLE_VOLTAGE:
            return  # under way; the controlword is looked at again when it is done
        transition = transition_of(self.state, command)
        if transition is not None:
            self._begin(transition, now)
        elif command is Command.ENABLE_OPERATION and self.state is State.READY_TO_SWITCH_ON:
            self._begin_from_ready(now)  # 3 and 4 in one write
        elif command is Command.ENABLE_OPERATION and self.stop_target is not None and self._drive.node.operational:
            self._resume(now)

    def _begin_from_ready(self, now: int) -> None:
        transition = transition_of(State.READY_TO_SWITCH_ON, Command.SWITCH_ON)
        if transition is not None:
            self._begin(transition, now)

    def _resume(self, now: int) -> None:
        """Go on with the mode: enabled again on the ramp down of transition 5 or 8."""
        if self.state is State.OPERATION_ENABLED:
            self.stop_target = None
            self._drive.handler.start(self._drive, now)

    def _begin(self, transition: Transition, now: int) -> None:
        index = self._drive.personality.delays.get(transition.number)
        delay = (self._drive.number(index) * _MS if index else 0) + self.extra_delay_ns
        if delay and transition.target is not State.SWITCH_ON_DISABLED:
            self._drive.mover.at("transition", now + delay, lambda then: self._perform(transition, then))
        else:
            self._perform(transition, now)

    def _perform(self, transition: Transition, now: int) -> None:
        before = self.state
        if before not in transition.sources:
            return  # something else happened during its delay
        self._PERFORM.get(transition.number, PowerMachine._plain)(self, transition, now)
        # A command that was held during a delay, or 0x0F in READY_TO_SWITCH_ON, goes on from here.
        command = command_of(self._drive.controlword, self._drive.controlword)
        if self.state is not before and self.state is State.SWITCHED_ON and command is Command.ENABLE_OPERATION:
            self.obey(command, now)

    def _plain(self, transition: Transition, now: int) -> None:
        self.enter(transition.target, now)

    def _enable(self, _transition: Transition, now: int) -> None:
        """Transition 4: only with supply, and only while set-points can come (NMT OPERATIONAL)."""
        if self.voltage and self._drive.node.operational:
            self.stop_target, self.halted = None, False
            if not self._drive.mover.powered:
                self._drive.mover.power(True, now)
            self.enter(State.OPERATION_ENABLED, now)
            self.halted = bool(self._drive.controlword & HALT_BIT) and self._drive.handler.can_halt(self._drive)
            self._drive.handler.start(self._drive, now)
            if self.fault_on_enable:
                self._drive.fault(self.fault_on_enable, now)

    def _enable_again(self, transition: Transition, now: int) -> None:
        """Transition 16: from a quick stop that stays, 0x605A = 5 to 8."""
        if self._option(o.QUICK_STOP_OPTION).final_state is State.QUICK_STOP_ACTIVE:
            self._enable(transition, now)

    def _leave(self, transition: Transition, now: int) -> None:
        """Transitions 5 and 8: stop as the option code says, then the new state."""
        if self.stop_target is not transition.target:
            index = o.DISABLE_OPERATION_OPTION if transition.number == 5 else o.SHUTDOWN_OPTION
            self._stop_as(self._option(index).reaction, transition.target, now)

    def _quick_stop(self, _transition: Transition, now: int) -> None:
        """Transition 11: the state shows it at once, the option code says what follows."""
        option = self._option(o.QUICK_STOP_OPTION)
        self.enter(State.QUICK_STOP_ACTIVE, now)
        self._stop_as(option.reaction, option.final_state, now)

    def _reset_fault(self, transition: Transition, now: int) -> None:
        """Transition 15: only when every cause is gone."""
        if not self.causes and not self.reset_deaf:
            self._drive.node.store.set(o.ERROR_CODE + self._drive.offset, 0, 0)
            self.enter(transition.target, now)
            self._drive.node.clear_errors()

    def _stop_as(self, reaction: Reaction, target: State, now: int) -> None:
        self._drive.mover.cancel("transition")
        self.halted = False
        if reaction is Reaction.DISABLE:
            self.finish(target, now)
            return
        self.stop_target = target
        self._drive.stop(now, reaction)

    def finish(self, target: State, now: int) -> None:
        """End a stop: transition 5, 8, 14, or 12 by itself."""
        self.stop_target = None
        if target is not self.state:
            self.enter(target, now)

    def enter(self, state: State, now: int) -> None:
        """Be in `state`; what leaves the powered ones takes the power away."""
        previous, self.state = self.state, state
        if previous in POWERED_STATES and state not in POWERED_STATES:
            self.power_off(now)
        if previous is not state:
            self._drive.node.tell(DriveStateChanged(self._drive.axis, previous, state))
            self._drive.touch()

    def power_off(self, now: int) -> None:
        """Take power and demand away, and what the modes remember."""
        self.stop_target, self.halted = None, False
        self._drive.mover.cancel("transition", "homing", "window")
        self._drive.mover.power(False, now)
        self._drive.limits.reset()
        for handler in self._drive.handlers.values():
            handler.reset()

    def halt(self, wanted: bool, now: int) -> None:
        """Controlword bit 8, as 0x605D says; the mode goes on where it was."""
        if wanted == self.halted or (wanted and not self._drive.handler.can_halt(self._drive)):
            return
        self.halted = wanted
        if wanted:
            self._drive.stop(now, self._option(o.HALT_OPTION).reaction)
        else:
            self._drive.handler.start(self._drive, now)

    def enter_fault(self, code: int, now: int) -> None:
        """Go to FAULT without an EMCY of its own; in a fault it only shows the newer code."""
        self._drive.mover.advance(now)
        self._drive.node.store.set(o.ERROR_CODE + self._drive.offset, 0, code)
        if self.state in (State.FAULT_REACTION_ACTIVE, State.FAULT):
            return
        self._drive.node.tell(DriveFaulted(self._drive.axis, code))
        powered = self.state in POWERED_STATES and self.voltage
        self.enter(State.FAULT_REACTION_ACTIVE, now)
        if powered:
            self._stop_as(self._option(o.FAULT_REACTION_OPTION).reaction, State.FAULT, now)
        else:
            self.finish(State.FAULT, now)

    def lose_voltage(self, now: int) -> None:
        """Lose the supply of the power stage: every state above falls to SWITCH_ON_DISABLED, without a fault."""
        self._drive.mover.advance(now)
        self.voltage = False
        self._drive.mover.cancel("transition")
        if self.state not in (State.NOT_READY_TO_SWITCH_ON, State.FAULT_REACTION_ACTIVE, State.FAULT):
            self.enter(State.SWITCH_ON_DISABLED, now)
        self._drive.touch()

    def abort_connection(self, code: int, now: int) -> None:
        """Do what 0x6007 says, in operation; an absent object is its default, a fault."""
        self._drive.mover.advance(now)
        if self.state not in (State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE):
            return
        option = self._drive.number(o.ABORT_CONNECTION_OPTION, default=DEFAULTS[o.ABORT_CONNECTION_OPTION])
        action = ABORT_CONNECTION.get(option, State.FAULT)
        if isinstance(action, Command):
            self.obey(action, now)
        elif action is not None:
            self.enter_fault(code, now)

    _PERFORM: ClassVar[dict[int, Callable[[PowerMachine, Transition, int], None]]] = {
        4: _enable,
        5: _leave,
        8: _leave,
        11: _quick_stop,
        15: _reset_fault,
        16: _enable_again,
    }
    """Transition number to what it does; the others only change the state."""
