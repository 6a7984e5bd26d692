"""Power state machine of one axis: states, transitions, and stops of the motor (CiA 402-2, 6.3).

The table of `cia402.state` gives the command of the controlword in the current state. `_act` has a case for every
transition with an action; the option codes determine how the motor is stopped. The motor has power only in OPERATION
ENABLED, QUICK STOP ACTIVE and FAULT REACTION ACTIVE, and OPERATION ENABLED can be entered only while the node is
OPERATIONAL.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from canopen_control.cia402 import objects as o
from canopen_control.cia402.state import State
from canopen_control.virtual.trajectory import INFINITE, move_to, ramp_to

if TYPE_CHECKING:
    from canopen_control.virtual.axis_motion import AxisMotion, AxisObjects
    from canopen_control.virtual.device_model import Limit
    from canopen_control.virtual.node_outbox import NodeOutbox

from typing import TYPE_CHECKING, Protocol

from canopen_control.cia301.emcy import ErrorRegister
from canopen_control.cia301.nmt import NmtState
from canopen_control.cia402.objects import ABORT_CONNECTION, DEFAULTS, OPTION_CODES, Option, Reaction
from canopen_control.cia402.state import (
    HALT_BIT,
    POWERED_STATES,
    Command,
    Transition,
    command_of,
    transition_of,
)
from canopen_control.virtual.injection_point import InjectionPoint
from canopen_control.virtual.node_outbox import ControlwordIgnored, DriveFaulted, DriveStateChanged

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.cia301.nmt import NmtSlave
    from canopen_control.virtual.axis_motion import AxisMotion, AxisObjects
    from canopen_control.virtual.node_outbox import NodeOutbox

    TransitionAct = Callable[[Transition, int], None]


_MS = 1_000_000
_RISING = (Command.SWITCH_ON, Command.ENABLE_OPERATION)


class MotorMode(Protocol):
    """Active mode of operation as seen by the power state machine."""

    def start(self, now: int) -> None:
        """Start the mode in OPERATION ENABLED from the current motion; also called at the end of a halt."""

    def stop(self, now: int, reaction: Reaction) -> None:
        """Stop the motor with the ramp of `reaction`."""

    def can_halt(self) -> bool:
        """Whether the halt bit (bit 8) of the controlword has an effect."""

    def released(self) -> None:
        """Reset the mode after the motor has lost power."""


class PowerMachine:
    """Power state machine of one axis (CiA 402-2).

    `bits` are the state bits of the statusword, `controlword` is the last processed controlword, `stop_target` the
    state that follows the present ramp, and `halted` whether the halt bit holds the motor. `causes` are the codes of
    faults that cannot be reset yet.

    Quirks set `acts` (actions of transitions by number, instead of `_act`), `delays_ns` (their delays), `stop_states`
    (state in which a stop ends, by the state in which it starts; None: it never ends) and `unsupplied` (state after
    the supply is lost in a state with power). Injection points: `voltage` (whether the power stage has supply),
    `transition_delay_ns` (of every transition), `reset_deaf` (fault resets have no effect), `fault_on_enable` (a code)
    and `serves_preop` (the drive can also be enabled in PRE-OPERATIONAL).
    """

    def __init__(
        self, objects: AxisObjects, mover: AxisMotion, outbox: NodeOutbox, nmt: NmtSlave, motor: MotorMode
    ) -> None:
        self._objects, self._mover, self._outbox, self._nmt, self._motor = objects, mover, outbox, nmt, motor
        self.state = State.NOT_READY_TO_SWITCH_ON
        self.bits: int = self.state.value
        self.controlword = 0
        self.stop_target: State | None = None
        self.halted = False
        self.causes: set[int] = set()
        self._communication_causes: set[int] = set()
        self.voltage: InjectionPoint[bool] = InjectionPoint(True)
        self.transition_delay_ns: InjectionPoint[int] = InjectionPoint(0)
        self.reset_deaf: InjectionPoint[bool] = InjectionPoint(False)
        self.fault_on_enable: InjectionPoint[int] = InjectionPoint(0)
        self.serves_preop: InjectionPoint[bool] = InjectionPoint(False)
        self.delays_ns: dict[int, int] = {}
        self.stop_states: dict[State, State | None] = {}
        self.unsupplied = State.SWITCH_ON_DISABLED
        self._ignored: tuple[int, str] | None = None  # controlword and reason of the last report, in the current state
        self.acts: dict[int, TransitionAct] = {}

    @property
    def running(self) -> bool:
        """Whether the axis is in OPERATION ENABLED and no stop is in progress."""
        return self.state is State.OPERATION_ENABLED and self.stop_target is None

    @property
    def operational(self) -> bool:
        """Whether set-points are accepted: in OPERATIONAL, or with `serves_preop` also in PRE-OPERATIONAL."""
        state = self._nmt.state
        return state is NmtState.OPERATIONAL or (self.serves_preop.value and state is NmtState.PRE_OPERATIONAL)

    @property
    def live(self) -> bool:
        """Whether set-points move the motor: enabled, OPERATIONAL, not halted and not stopping."""
        return self.running and not self.halted and self.operational

    def _option(self, index: int) -> Option:
        """Return the meaning of an option code; manufacturer-specific codes are treated as the default."""
        codes = OPTION_CODES[index]
        return codes.get(self._objects.number(index, default=DEFAULTS[index])) or codes[DEFAULTS[index]]

    def obey(self, command: Command, now: int) -> None:
        """Execute a command in the current state; a command that the state does not permit has no effect."""
        if command is Command.ENABLE_OPERATION and self.running:
            return  # a cyclic RPDO repeats the controlword
        if "transition" in self._mover.timers and command is not Command.DISABLE_VOLTAGE:
            return  # a transition is in progress; the controlword is read again at its end
        # CiA 402-2, table 22: a command without a transition in this state has no effect
        transition = transition_of(self.state, command)
        if transition is not None:
            self._begin(transition, now)
        elif command is Command.ENABLE_OPERATION and self.state is State.READY_TO_SWITCH_ON:
            # CiA 402-2, table 24: 0x000F in READY TO SWITCH ON makes transitions 3 and 4
            self._begin_from_ready(now)
        elif command is Command.ENABLE_OPERATION and self.stop_target is not None and self.operational:
            self._resume(now)
        elif command in _RISING and self.state is State.SWITCH_ON_DISABLED:
            self._ignore("the drive is in SWITCH_ON_DISABLED; send controlword 0x0006 first")

    def _begin_from_ready(self, now: int) -> None:
        transition = transition_of(State.READY_TO_SWITCH_ON, Command.SWITCH_ON)
        if transition is not None:
            self._begin(transition, now)

    def _resume(self, now: int) -> None:
        """Restart the mode after the drive is enabled during the ramp of transition 5 or 8."""
        if self.state is State.OPERATION_ENABLED:
            self.stop_target = None
            self._motor.start(now)

    def _begin(self, transition: Transition, now: int) -> None:
        index = self._objects.model.delays.get(transition.number)
        delay = (self._objects.number(index) * _MS if index else 0) + self.transition_delay_ns.value
        delay += self.delays_ns.get(transition.number, 0)
        if delay and transition.target is not State.SWITCH_ON_DISABLED:
            self._mover.at("transition", now + delay, lambda then: self._perform(transition, then))
        else:
            self._perform(transition, now)

    def _perform(self, transition: Transition, now: int) -> None:
        before = self.state
        if before not in transition.sources:
            return  # another transition happened during the delay
        self.act_of(transition.number)(transition, now)
        # A command that arrived during a delay, or 0x0F in READY TO SWITCH ON, continues here.
        command = command_of(self.controlword, self.controlword)
        if self.state is not before and self.state is State.SWITCHED_ON and command is Command.ENABLE_OPERATION:
            self.obey(command, now)

    def act_of(self, number: int) -> TransitionAct:
        """Return the action of a transition, which a quirk may replace."""
        return self.acts.get(number, self._act)

    def _act(self, transition: Transition, now: int) -> None:
        """Execute the action of a transition; a transition without a special action only changes the state."""
        match transition.number:
            case 4:
                self._enable(transition, now)
            case 5 | 8:
                self._leave(transition, now)
            case 11:
                self._quick_stop(transition, now)
            case 15:
                self._reset_fault(transition, now)
            case 16:
                self._enable_again(transition, now)
            case _:
                self.enter(transition.target, now)

    def _enable(self, _transition: Transition, now: int) -> None:
        if not self.operational:
            self._ignore(f"the node is {self._nmt.state.name}; the drive can be enabled only in OPERATIONAL")
        # CiA 402-2, table 22: transition 4 needs the high-level power
        elif not self.voltage.value:
            self._ignore("the power stage has no supply")
        else:
            self.stop_target, self.halted = None, False
            if not self._mover.powered:
                self._mover.power(True, now)
            self.enter(State.OPERATION_ENABLED, now)
            self.halted = bool(self.controlword & HALT_BIT) and self._motor.can_halt()
            self._motor.start(now)
            if self.fault_on_enable.value:
                self.fault(self.fault_on_enable.value, now)

    def _enable_again(self, transition: Transition, now: int) -> None:
        # CiA 402-2, table 22: transition 16 is possible only if 0x605A (5 to 8) stays in QUICK STOP ACTIVE
        if self._option(o.QUICK_STOP_OPTION).final_state is State.QUICK_STOP_ACTIVE:
            self._enable(transition, now)

    def _leave(self, transition: Transition, now: int) -> None:
        """Perform transition 5 or 8: stop according to the option code, then enter the new state."""
        if self.stop_target is not transition.target:
            index = o.DISABLE_OPERATION_OPTION if transition.number == 5 else o.SHUTDOWN_OPTION
            self._stop_as(self._option(index).reaction, transition.target, now)

    def _quick_stop(self, _transition: Transition, now: int) -> None:
        """Perform transition 11: enter QUICK STOP ACTIVE at once and stop according to 0x605A."""
        option = self._option(o.QUICK_STOP_OPTION)
        self.enter(State.QUICK_STOP_ACTIVE, now)
        self._stop_as(option.reaction, option.final_state, now)

    def _reset_fault(self, transition: Transition, now: int) -> None:
        # CiA 402-2, table 22: transition 15 is made only when no fault condition is present
        if self.causes:
            codes = ", ".join(f"0x{code:04X}" for code in sorted(self.causes))
            self._ignore(f"the cause of fault {codes} persists")
        elif not self.reset_deaf.value:
            self._objects.set(o.ERROR_CODE, 0)
            self.enter(transition.target, now)
            self._outbox.clear_errors()

    def _ignore(self, why: str) -> None:
        """Report an ignored controlword, and again only after controlword, reason or state has changed."""
        if self._ignored != (self.controlword, why):
            self._ignored = self.controlword, why
            self._outbox.publish(ControlwordIgnored(self._objects.axis, self.controlword, why))

    def _stop_as(self, reaction: Reaction, target: State, now: int) -> None:
        self._mover.cancel("transition")
        self.halted = False
        if reaction is Reaction.DISABLE:
            self.finish(target, now)
            return
        self.stop_target = target
        self._motor.stop(now, reaction)

    def finish(self, target: State, now: int) -> None:
        """End a stop and enter the state `target`, unless a quirk replaces it."""
        end = self.stop_states.get(self.state, target)
        if end is None:
            return
        self.stop_target = None
        if end is not self.state:
            self.enter(end, now)

    def enter(self, state: State, now: int) -> None:
        """Enter `state`; power is switched off if the state is one without power."""
        previous, self.state, self.bits = self.state, state, state.value
        if previous in POWERED_STATES and state not in POWERED_STATES:
            self.power_off(now)
        if previous is not state:
            self._ignored = None
            self._outbox.publish(DriveStateChanged(self._objects.axis, previous, state))
            self._outbox.values_changed()

    def power_off(self, now: int) -> None:
        """Switch off the power, end the demand, and reset the modes."""
        self.stop_target, self.halted = None, False
        self._mover.cancel("transition", "homing", "window")
        self._mover.power(False, now)
        self._motor.released()

    def halt(self, on: bool, now: int) -> None:
        """Stop according to 0x605D when the halt (bit 8) begins, and continue the mode when it ends."""
        if on == self.halted or (on and not self._motor.can_halt()):
            return
        self.halted = on
        if on:
            self._motor.stop(now, self._option(o.HALT_OPTION).reaction)
        else:
            self._motor.start(now)

    def fault(self, code: int, now: int, *, register: int = ErrorRegister.GENERIC, data: bytes = b"") -> None:
        """Report the fault `code` (transition 13), stop according to 0x605E, then enter FAULT."""
        self._outbox.emergency(code, register, data)
        self.enter_fault(code, now)

    def hold_cause(self, code: int, *, until_communication_reset: bool = False) -> None:
        """Prevent fault resets until `drop_cause` or, if requested, until a reset of communication."""
        self.causes.add(code)
        if until_communication_reset:
            self._communication_causes.add(code)

    def drop_cause(self, code: int) -> None:
        """Remove the cause of a fault, so that the fault can be reset."""
        self.causes.discard(code)
        self._communication_causes.discard(code)

    def communication_reset(self) -> None:
        """Remove the causes that end with a reset of communication."""
        self.causes -= self._communication_causes

    def enter_fault(self, code: int, now: int) -> None:
        """Stop and enter FAULT without an EMCY; if already in FAULT or its reaction, only update 0x603F."""
        self._mover.advance(now)
        self._objects.set(o.ERROR_CODE, code)
        if self.state in (State.FAULT_REACTION_ACTIVE, State.FAULT):
            return
        self._outbox.publish(DriveFaulted(self._objects.axis, code))
        powered = self.state in POWERED_STATES and self.voltage.value
        self.enter(State.FAULT_REACTION_ACTIVE, now)
        if powered:
            self._stop_as(self._option(o.FAULT_REACTION_OPTION).reaction, State.FAULT, now)
        else:
            self.finish(State.FAULT, now)

    def lose_voltage(self, now: int) -> None:
        """Switch off the supply of the power stage, which ends the powered states without a fault."""
        self._mover.advance(now)
        self.voltage.inject(False)
        self._mover.cancel("transition")
        if self.state not in (State.NOT_READY_TO_SWITCH_ON, State.FAULT_REACTION_ACTIVE, State.FAULT):
            self.enter(self.unsupplied if self.state in POWERED_STATES else State.SWITCH_ON_DISABLED, now)
        if self.state is State.OPERATION_ENABLED:  # a quirk: the drive shows the loss only in bit 4
            self._mover.power(False, now)
        self._outbox.values_changed()

    def restore_voltage(self, now: int) -> None:
        """Switch the supply of the power stage on again; an axis that has stayed enabled follows its set-points."""
        self._mover.advance(now)
        self.voltage.clear()
        if self.state is State.OPERATION_ENABLED and not self._mover.powered:
            self._mover.power(True, now)
            self._motor.start(now)
        self._outbox.values_changed()

    def abort_connection(self, code: int, now: int) -> None:
        """React to lost communication according to 0x6007 (default: fault) if enabled or in a quick stop."""
        self._mover.advance(now)
        if self.state not in (State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE):
            return
        option = self._objects.number(o.ABORT_CONNECTION_OPTION, default=DEFAULTS[o.ABORT_CONNECTION_OPTION])
        action = ABORT_CONNECTION.get(option, State.FAULT)
        if isinstance(action, Command):
            self.obey(action, now)
        elif action is not None:
            self.enter_fault(code, now)


# Limits of the motion of an axis: software limits, limit switches, velocities, torques, the following error.
#
# A limit is reported once, when the motion ends at the limit (bit 11, and an EMCY if the device has one), until the
# next demand away from the limit. The software limits 0x607D apply if subindex 1 is below subindex 2; a value at the
# end of its type is not a limit.


_LOWEST, _HIGHEST = -0x7FFFFFFF, 0x7FFFFFFF  # at or beyond these values 0x607D is not a limit
FOLLOWING_ERROR = 0x8611  # EMCY


class DriveLimits:
    """Limits of position, velocity, torque and following error of one axis; `active` is bit 11 of the statusword."""

    def __init__(self, objects: AxisObjects, mover: AxisMotion, outbox: NodeOutbox, power: PowerMachine) -> None:
        self._objects, self._mover, self._outbox, self._power = objects, mover, outbox, power
        self.active = False
        self.following_error = 0.0
        self._bound: float | None = None  # position at which a limit ends the present demand
        self._side = 0
        self._max_velocity_inputs: tuple[object, ...] = ()  # inputs from which `_max_velocity` was computed
        self._max_velocity = 0.0

    def reset(self) -> None:
        """Clear the active limits after the motor has lost power."""
        self.active = False
        self.following_error = 0.0
        self._bound = None

    def bounds(self) -> tuple[float, float]:
        """Return the lowest and highest position in plant counts; infinite if unlimited."""
        objects, mover = self._objects, self._mover
        low, high = objects.number(o.SOFTWARE_POSITION_LIMIT, 1), objects.number(o.SOFTWARE_POSITION_LIMIT, 2)
        lowest, highest = -INFINITE, INFINITE
        if low < high:
            unit, zero = objects.units.position, objects.units.zero
            lowest = low * unit + zero if low > _LOWEST else math.copysign(INFINITE, -unit)
            highest = high * unit + zero if high < _HIGHEST else math.copysign(INFINITE, unit)
            lowest, highest = min(lowest, highest), max(lowest, highest)
        if mover.switches.wired and not objects.model.switches_disabled(objects.store):
            switch_low, switch_high = mover.switches.bounds(mover.plant.position)
            lowest, highest = max(lowest, switch_low), min(highest, switch_high)
        return lowest, highest

    def velocity(self, target: float) -> float:
        """Return `target` in counts/s, limited by 0x607F and the maximum velocity of the device model."""
        objects = self._objects
        inputs = objects.store.version, objects.units.speed, objects.model
        if inputs != self._max_velocity_inputs:
            self._max_velocity_inputs = inputs
            self._max_velocity = min(objects.speed(o.MAX_PROFILE_VELOCITY) or INFINITE, objects.model.max_velocity)
        highest = self._max_velocity
        return target if -highest <= target <= highest else highest if target > highest else -highest

    def target_velocity(self) -> float:
        """Return 0x60FF plus 0x60B1 in counts/s, limited like `velocity`."""
        number = self._objects.number
        return self.velocity((number(o.TARGET_VELOCITY) + number(o.VELOCITY_OFFSET)) * self._objects.units.velocity)

    def position(self, target: float) -> float:
        """Return `target` in plant counts, limited to the bounds; a limited target sets bit 11."""
        low, high = self.bounds()
        within = max(low, min(high, target))
        self.active, self._bound = within != target, None
        if within != target:
            self._bound, self._side = within, 1 if target > within else -1
        return within

    def torque(self, target: float) -> float:
        """Return `target` in per mille, limited by 0x6072, 0x60E0 and 0x60E1; a limited target sets bit 11."""
        number = self._objects.number
        maximum = float(number(o.MAX_TORQUE)) or INFINITE
        high = min(maximum, float(number(o.POSITIVE_TORQUE_LIMIT)) or INFINITE)
        low = min(maximum, float(number(o.NEGATIVE_TORQUE_LIMIT)) or INFINITE)
        self.active = not -low <= target <= high
        return max(-low, min(high, target))

    def ramp_velocity(self, target: float, up: float, down: float, now: int) -> None:
        """Change the velocity to `target` along ramps; the motion ends at a position limit in its way."""
        mover = self._mover
        position, velocity = mover.state(now)
        low, high = self.bounds()
        bound = high if target > 0.0 else low
        self.active, self._bound = False, None
        if target == 0.0 or abs(bound) == INFINITE:
            mover.run(ramp_to(now, position, velocity, target, up, down), now)
            return
        self._bound, self._side = bound, 1 if target > 0.0 else -1
        if (bound - position) * target > 0.0:
            mover.run(move_to(now, position, velocity, bound, abs(target), up, down), now)
        else:
            self.active = True
            mover.run(ramp_to(now, position, velocity, 0.0, up, down), now)

    def arrived(self, now: int) -> None:
        """Set bit 11 and report the position limit if the demand ended at a limit."""
        demand = self._mover.demand
        if self._bound is not None and demand.end_ns <= now and demand.final_position == self._bound:
            self.active = True
            self._report(self._objects.model.software_limit, self._side)

    def limit_switch_hit(self, side: int) -> None:
        """Set bit 11 and report the limit switch on `side` (-1 or 1)."""
        self.active = True
        self._report(self._objects.model.switch_limit, side)

    def _report(self, limit: Limit | None, side: int) -> None:
        if limit is not None:
            data = limit.positive if side > 0 else limit.negative
            self._outbox.report(limit.code, ErrorRegister.MANUFACTURER, data)

    # -- following error

    def check_following_error(self, error: float, now: int) -> None:
        """Raise fault 0x8611 if a following error in counts exceeds 0x6065 for longer than 0x6066."""
        self.following_error = error
        mover = self._mover
        if not self.exceeded:
            mover.cancel("following error")
        elif "following error" not in mover.timers and self._power.state is State.OPERATION_ENABLED:
            wait = self._objects.number(o.FOLLOWING_ERROR_TIMEOUT) * _MS
            mover.at("following error", now + wait, self._failed)

    @property
    def exceeded(self) -> bool:
        """Whether the following error exceeds the window 0x6065; 0 and 0xFFFFFFFF disable the window."""
        window = self._objects.number(o.FOLLOWING_ERROR_WINDOW)
        return 0 < window < 0xFFFFFFFF and abs(self.following_error) > window * self._objects.units.length

    def _failed(self, now: int) -> None:
        if self._power.state is State.OPERATION_ENABLED and self.exceeded:
            self._power.fault(FOLLOWING_ERROR, now, register=ErrorRegister.DEVICE_PROFILE)
