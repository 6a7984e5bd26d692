"""Master side of one axis: evaluates the statusword and computes the controlword for the next step to the goal.

Rules (CiA 402-2, 6.3, seen from the master):

- Methods set a goal and return; `update` makes one step towards the goal with each statusword. Nothing blocks.
- One command at a time, and the next command only when the statusword confirms the last one: 06, 07, 0F. The steps are
  those of `state.next_command`; `DriveRequest` adds the timeouts after which a step is abandoned.
- The goal belongs to an `EnableRequest`, which only `ENABLE_TABLE` changes; only `enable` makes it ENABLED. A fault, a
  lost enable, a missing or undefined statusword, or a transition or mode that is not confirmed in time sets the goal
  back to DISABLED. Only a new `enable` sets it again; a fault reset never does.
- 0x0F is sent only when the goal is ENABLED and, to a drive that is not enabled yet, only when 0x6061 shows the
  requested mode (or the drive shows no mode until it is enabled).
- Disabling uses the drive's own ramp: disable operation (0x605C), shutdown, disable voltage, each when the previous
  command is confirmed. A quick stop ends when the state shows it, for each value of 0x605A; power is not cut before.
- The mode-specific bits (4, 5, 6, 9) and halt (8) are sent only to an enabled drive, and the former are cleared when
  the drive is no longer enabled, so that no old set-point starts a motion.
- A drive in PP continues to its old set-point when the halt bit falls. It leaves OPERATION_ENABLED before, which clears
  its set-points (table 22, transition 4).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from canopen_control.cia402.drive_goal import (
    DISABLED_STATES,
    FAULT_STATES,
    LADDER,
    NEVER,
    SETTLE,
    DriveGoal,
    FaultReset,
    ModeRequest,
    StepTimer,
    SupplyWatch,
    is_stopped,
)
from canopen_control.cia402.drive_request import DriveRequest, EnableRequest, EnableTrigger
from canopen_control.cia402.events import (
    ControlChanged,
    EnableLost,
    FaultCleared,
    FaultEntered,
    ModeTimedOut,
    StateChanged,
    StatuswordUndefined,
)
from canopen_control.cia402.modes import OperationMode
from canopen_control.cia402.state import (
    HALT_BIT,
    MODE_SPECIFIC_BITS,
    REMOTE,
    TARGET_REACHED,
    VOLTAGE_ENABLED,
    Command,
    State,
    controlword_of,
    decode_statusword,
)
from canopen_control.errors import DriveError, LocalProtocolError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from canopen_control.cia402.events import DriveEvent


_AT_ONCE: Final = -1
# changes of other bits of the statusword need no evaluation
_WATCHED: Final = 0x6F | VOLTAGE_ENABLED | REMOTE | TARGET_REACHED
_SECOND: Final = 1_000_000_000
# Transition 16 is optional: a drive without this transition is soon taken through SWITCH ON DISABLED instead. A quick
# stop starts at once, unless 0x605A disables quick stops (Beckhoff AX8000: -1).
_DEFAULT_TIMEOUTS: Final = {16: _SECOND, 11: _SECOND}


class DriveMachine:
    """State machine of the master for one axis: goal, mode and controlword.

    Write the result of `update` to 0x6040, and `mode_request.sent` to 0x6060 unless it is None. `transition_timeouts`
    maps transition numbers to timeouts in ns that differ from `transition_timeout_ns` (number 0: the wait for a first
    statusword). `disabled_state` is the final state of a disabled drive: SWITCH_ON_DISABLED, READY_TO_SWITCH_ON or
    SWITCHED_ON. Undefined statuswords never change the state; after `undefined_limit` in a row they are reported and
    the goal ENABLED becomes DISABLED. After an enable that overtook a disable the drive counts as enabled again if it
    stays in OPERATION_ENABLED for `settle_ns`. `ignore_remote` is for drives that do not maintain bit 9.
    `switching_state` is for drives that change their mode only in this state or below: at standstill, an enabled drive
    is taken down to this state, its mode is changed, and it is enabled again (ros_canopen, issue 259).

    Attributes:
    - `state` (None: unknown), `statusword`, `controlword`, `halted` and `held_in_switched_on`.
    - `mode_request`: state of the requested mode, confirmed by 0x6061 or failed.
    - `undefined`: number of undefined statuswords.
    - `evaluations`: number of updates with an evaluation; nothing else has changed while this is constant.
    - `standstill`: set by a caller if the motor is known to be at standstill; it shortens the wait for the end of a
      quick stop and for a mode change.

    """

    def __init__(
        self,
        name: str,
        *,
        transition_timeout_ns: int = 5 * _SECOND,
        transition_timeouts: Mapping[int, int] | None = None,
        mode_timeout_ns: int = 2 * _SECOND,
        fault_reset_timeout_ns: int = 2 * _SECOND,
        settle_ns: int = _SECOND // 5,
        disabled_state: State = State.SWITCH_ON_DISABLED,
        undefined_limit: int = 10,
        ignore_remote: bool = False,
        switching_state: State = State.OPERATION_ENABLED,
    ) -> None:
        # CiA 402-2, table 22: the states without power on the motor
        if disabled_state not in DISABLED_STATES:
            raise LocalProtocolError(f"{name}: {disabled_state.name} is not a state of a disabled drive")
        self.name = name
        self.state: State | None = None
        self.statusword: int | None = None
        self.controlword = 0
        self.halted = False
        self.held_in_switched_on = False
        self.standstill = False
        self.undefined = 0
        self.evaluations = 0
        timeouts = {**_DEFAULT_TIMEOUTS, SETTLE: settle_ns, **(transition_timeouts or {})}
        self._step = StepTimer(transition_timeout_ns, timeouts)
        self._request = DriveRequest(self._step, disabled_state)
        self._undefined_limit = undefined_limit
        self._undefined_run = 0
        self._always_remote = REMOTE if ignore_remote else 0
        self._running_word = REMOTE  # last statusword with a valid bit 9, from a drive that has started
        self._events: list[DriveEvent] = []
        self.mode_request = ModeRequest(mode_timeout_ns)
        self._switching_state = switching_state
        self._awaits_switching_state = False
        self._clears_set_points = False  # halt ends when the drive has left OPERATION_ENABLED
        self._mode_bits = 0
        self._reset = FaultReset(fault_reset_timeout_ns)
        self._supply = SupplyWatch()
        self._deadline = NEVER
        self.next_update = _AT_ONCE
        """Time at which `update` must evaluate again, even with the same statusword and mode display."""

    # Requests; a repeated request has no effect.

    def enable(self) -> None:
        """Request OPERATION_ENABLED.

        Raise DriveError in a fault, and after a mode that was not confirmed, until `set_mode` requests a mode.
        """
        if self.goal is DriveGoal.ENABLED:
            return
        self.check_enable()
        overtaken = self.state is State.OPERATION_ENABLED and self._step.command is not Command.ENABLE_OPERATION
        self._fire(EnableTrigger.OVERTAKE if overtaken else EnableTrigger.ENABLE)

    def check_enable(self) -> None:
        """Raise the DriveError that `enable` would raise, without requesting anything."""
        if self.goal is DriveGoal.ENABLED:
            return
        # CiA 402-2, table 22: FAULT has only transition 15, the fault reset
        if self.fault:
            raise DriveError(
                f"{self.name}: cannot be enabled in a fault{self._statusword_text()}; reset the fault first"
            )
        if self.mode_request.failed:
            raise DriveError(
                f"{self.name}: cannot be enabled because its mode was not confirmed; set a mode first (`axis mode "
                "NODE MODE`)"
            )

    def disable(self) -> None:
        """Stop the motor with the drive's own ramp (0x605C), then switch power off down to `disabled_state`."""
        self._fire(EnableTrigger.DISABLE)

    def disable_voltage(self) -> None:
        """Send disable voltage (transitions 9 and 12), so that the motor coasts."""
        self._fire(EnableTrigger.DISABLE_VOLTAGE)

    def quick_stop(self) -> None:
        """Request a quick stop, as defined by 0x605A; the drive ends in QUICK_STOP_ACTIVE or SWITCH_ON_DISABLED.

        `enable` leads out of both states.
        """
        enabled = self.state is State.OPERATION_ENABLED
        self._fire(EnableTrigger.QUICK_STOP_ENABLED if enabled else EnableTrigger.QUICK_STOP)

    def halt(self, on: bool = True) -> None:
        """Set or clear the halt bit (bit 8, option code 0x605D), which is sent while the drive is enabled.

        To clear it, an enabled drive in mode PP is taken down to SWITCHED_ON and enabled again within some cycles.
        """
        # CiA 402-2, 0x6040 in mode PP: without halt the drive continues to its set-point
        clears = self.halted and not on and self.state is State.OPERATION_ENABLED and self.mode == OperationMode.PP
        if clears is not self._clears_set_points:
            self._clears_set_points = clears
            self._detour()
            self.next_update = _AT_ONCE
        if not clears and on is not self.halted:
            self.halted = on
            self.next_update = _AT_ONCE

    def hold_in_switched_on(self, on: bool = True) -> None:
        """Keep the drive in SWITCHED_ON until a call with False, so that several axes can be enabled in one cycle."""
        if on is not self.held_in_switched_on:
            self.held_in_switched_on = on
            self.next_update = _AT_ONCE

    def fault_reset(self) -> None:
        """Request one rising edge of bit 7; nothing is sent without a fault. The drive stays disabled."""
        if self.state is None or self.fault:
            self._reset.start()
            self.next_update = _AT_ONCE

    def set_mode(self, mode: int) -> None:
        """Request a mode of operation; OPERATION_ENABLED and every motion wait until 0x6061 shows this mode.

        A drive whose 0x6061 is 0 until it is enabled is enabled before its mode is shown, but its motion waits. Check
        first whether the drive supports the mode (0x6502): `modes.require_mode`.
        """
        request = self.mode_request
        if request.ask(mode):
            self.next_update = _AT_ONCE
            self._awaits_switching_state = self._switching_state is not State.OPERATION_ENABLED
        if not self._awaits_switching_state or self._may_switch:
            request.sent = request.mode

    @property
    def _may_switch(self) -> bool:
        """Whether the current state permits a mode change, according to `switching_state`.

        In an unknown state the mode is sent at once.
        """
        return self.state is None or self.fault or LADDER[self.state] <= LADDER[self._switching_state]

    @property
    def mode_bits(self) -> int:
        """Bits 4, 5, 6 and 9 of the controlword; 0 unless the drive is enabled in a confirmed mode, or in mode VL."""
        return self._mode_bits

    @mode_bits.setter
    def mode_bits(self, bits: int) -> None:
        # CiA 402-2, 0x6040: bits 4, 5, 6 and 9 belong to the mode of operation
        if bits & ~MODE_SPECIFIC_BITS:
            raise LocalProtocolError(
                f"{self.name}: 0x{bits:04X} has bits that are not mode-specific (0x{MODE_SPECIFIC_BITS:04X})"
            )
        if bits != self._mode_bits:
            self._mode_bits = bits
            self.next_update = _AT_ONCE

    # State.

    @property
    def disabled_state(self) -> State:
        return self._request.disabled_state

    @disabled_state.setter
    def disabled_state(self, state: State) -> None:
        self._request.disabled_state = state

    @property
    def goal(self) -> DriveGoal:
        return self._request.goal

    @property
    def mode(self) -> int | None:
        return self.mode_request.mode

    @property
    def waiting(self) -> bool:
        """Whether the drive is ready and only `hold_in_switched_on` delays the enabling controlword."""
        ready = self.state is State.SWITCHED_ON or self.state is State.QUICK_STOP_ACTIVE
        return ready and self.goal is DriveGoal.ENABLED and self.mode_request.may_enable

    @property
    def enabled(self) -> bool:
        """Whether the drive is in OPERATION_ENABLED without a pending request or event that ends this state."""
        return self.state is State.OPERATION_ENABLED and self._request.state is EnableRequest.ENABLED

    @property
    def may_move(self) -> bool:
        """Whether targets may be sent: the drive is enabled, in the requested mode, and not halted."""
        return self.enabled and self.mode_request.confirmed and not self.halted

    @property
    def fault(self) -> bool:
        """Whether the drive is in FAULT or FAULT_REACTION_ACTIVE."""
        return self.state in FAULT_STATES

    @property
    def remote(self) -> bool:
        """Whether the drive is controlled over the bus (bit 9 of the statusword).

        True until a statusword clears the bit, and always with `ignore_remote`.
        """
        # CiA 402-2, 0x6041 bit 9 (remote): 0 while the controlword is not processed
        return bool(self._running_word & REMOTE)

    @property
    def resetting(self) -> bool:
        return self._reset.active

    @property
    def reached(self) -> bool:
        """Whether the goal is reached: enabled in the requested mode, or stopped as defined by `is_stopped`."""
        if self.goal is DriveGoal.ENABLED:
            return self.enabled and self.mode_request.confirmed
        return is_stopped(self.goal, self.disabled_state, self.state)

    def events(self) -> list[DriveEvent]:
        """Return the events since the last call."""
        events, self._events = self._events, []
        return events

    def next_deadline(self) -> int | None:
        """Return the time in ns by which `update` must be called again, or None if no timeout is running."""
        return None if self._deadline == NEVER else self._deadline

    # Cycle.

    def update(self, statusword: int | None, mode_display: int | None, now: int) -> int:
        """Return the controlword for the latest 0x6041 and 0x6061 (None: not received).

        Call once per cycle; this method never raises an exception. A statusword that becomes None again means that the
        drive is lost.
        """
        mode = self.mode_request
        if mode_display == mode.display and now < self.next_update:
            last = self.statusword
            if statusword == last:
                return self.controlword
            if statusword is not None and last is not None and not (statusword ^ last) & _WATCHED:
                self.statusword = statusword
                return self.controlword
        self.next_update = NEVER
        self.evaluations += 1
        if statusword is None:
            self._without_statusword(now)
            mode.display = mode_display
        else:
            self._observe(statusword, now)
            self._supervise_mode(mode_display, now)
        step = self._step
        if now >= step.deadline:
            self._step_timed_out(now)
        command = self._choose()
        self._request.begin(command, self.state, now)
        self.controlword = self._word(command, now)
        self._deadline = min(step.deadline, mode.deadline, self._reset.deadline, self._supply.deadline)
        self.next_update = min(self.next_update, self._deadline)
        return self.controlword

    def _fire(self, trigger: EnableTrigger) -> None:
        if self._request.fire(trigger):
            self.next_update = _AT_ONCE

    def _statusword_text(self) -> str:
        return "" if self.statusword is None else f" (statusword 0x{self.statusword:04X})"

    def _without_statusword(self, now: int) -> None:
        """Wait for the first statusword, or clear the state of a drive that was lost."""
        if self.statusword is None:
            return
        self.statusword = None
        self._running_word = REMOTE
        self._undefined_run = 0
        self.mode_request.forget_display()
        self._reset.cancel()
        if self.state is not None:
            self._enter(None, now)
        if self.goal is DriveGoal.ENABLED:
            self._lose(now, self.state)

    def _observe(self, statusword: int, now: int) -> None:
        self.statusword = statusword
        state = decode_statusword(statusword)
        if state is State.NOT_READY_TO_SWITCH_ON and self._passes_unready():
            return
        if state is None:
            self._count_undefined(statusword, now)
            return
        self._undefined_run = 0
        if state is not self.state:
            self._change_state(self.state, state, statusword, now)
        # CiA 402-2, table 22: before transition 1 a drive still initialises, and bit 9 is not valid
        if state is not State.NOT_READY_TO_SWITCH_ON:
            word, before = statusword | self._always_remote, self._running_word
            self._running_word = word
            if (word ^ before) & REMOTE:
                self._events.append(ControlChanged(now, statusword))
        # CiA 402-2, 0x605A = 5 to 8: the drive stays in QUICK STOP ACTIVE after its stop
        if state is State.QUICK_STOP_ACTIVE:
            self._request.record_quick_stop(statusword)
        elif state is State.OPERATION_ENABLED and self._supply.lost(statusword, now) and self.goal is DriveGoal.ENABLED:
            self._events.append(EnableLost(now, state, statusword, supply_lost=True))
            self._fire(EnableTrigger.LOST)

    def _passes_unready(self) -> bool:
        """Whether NOT READY TO SWITCH ON is ignored: shown for some updates by a drive that is being enabled.

        There are drives that show 0x0000 during a transition. Their last command is kept, since the command of this
        state would disable them. A drive that has really restarted goes on to SWITCH ON DISABLED.
        """
        if self.goal is not DriveGoal.ENABLED or self.state not in DISABLED_STATES:
            return False
        self._undefined_run += 1
        self.next_update = _AT_ONCE
        return self._undefined_run < self._undefined_limit

    def _count_undefined(self, statusword: int, now: int) -> None:
        self.undefined += 1
        self._undefined_run += 1
        self.next_update = _AT_ONCE  # a repetition of the same statusword must be counted
        # CiA 402-2, table 30 defines no state for this pattern; single words of this kind occur at transitions
        if self._undefined_run == self._undefined_limit:
            self._events.append(StatuswordUndefined(now, statusword, self._undefined_run))
            if self.goal is DriveGoal.ENABLED:
                self._lose(now, None)  # the current state is unknown; commands still start from the last known state

    def _change_state(self, previous: State | None, state: State, statusword: int, now: int) -> None:
        self._enter(state, now)
        if state in FAULT_STATES:
            # CiA 402-2, table 22, transition 13 (fault reaction), then 14 (fault)
            if previous not in FAULT_STATES:
                self._events.append(FaultEntered(now, state, statusword, previous is State.OPERATION_ENABLED))
            self._fire(EnableTrigger.LOST)
            return
        self._reset.cancel()
        if previous in FAULT_STATES:
            self._events.append(FaultCleared(now, statusword))
        elif previous is not None and self._request.lost_enable(previous, state):
            self._lose(now, state)
        if self._clears_set_points:
            self._end_halt()

    def _enter(self, state: State | None, now: int) -> None:
        self._events.append(StateChanged(now, self.state, state, self.statusword))
        self.state = state
        self._supply.restart()
        self._request.on_state_entered(state)

    def _lose(self, now: int, state: State | None) -> None:
        self._events.append(EnableLost(now, state, self.statusword))
        self._fire(EnableTrigger.LOST)

    def _supervise_mode(self, display: int | None, now: int) -> None:
        request = self.mode_request
        if self._awaits_switching_state:
            if self._may_switch:
                request.sent = request.mode
            elif display != request.mode:
                self._detour()
                request.display = display
                return
        event = request.update(display, self.state is State.OPERATION_ENABLED, now)
        if request.strays:
            self.next_update = _AT_ONCE  # the same display must be counted again
        if self._awaits_switching_state:
            self._awaits_switching_state = not (request.may_enable or request.failed)
            self._detour()
        if event is None:
            return
        self._events.append(event)
        # A drive that stayed in its old mode continues; a drive that is not enabled, or is in neither mode, does not.
        stayed = self.mode_request.confirmed and self.state is State.OPERATION_ENABLED
        if isinstance(event, ModeTimedOut) and self.goal is DriveGoal.ENABLED and not stayed:
            self._lose(now, self.state)

    def _end_halt(self) -> None:
        """Clear the halt bit of a drive that has left OPERATION_ENABLED, so that it has no set-point."""
        self._clears_set_points = self.halted = False
        self._detour()

    def _detour(self) -> None:
        """Make an enabled drive pass through a lower state, to change its mode or to clear its set-points there."""
        detour = self._switching_state if self._awaits_switching_state else None
        # CiA 402-2, table 22, transition 4: the internal set-points are cleared
        if detour is None and self._clears_set_points:
            detour = State.SWITCHED_ON
        if detour is not self._request.detour:
            self._request.detour = detour
            self._step.rearm()

    def _step_timed_out(self, now: int) -> None:
        event = self._request.handle_timeout(self.state, self.statusword, now)
        if event is not None:
            self._events.append(event)
            self._fire(EnableTrigger.LOST if event.gave_up else EnableTrigger.SETTLED)

    def _choose(self) -> Command | None:
        may_enable = self.mode_request.may_enable and not self.held_in_switched_on
        command = self._request.choose(self.state, self.statusword, self.standstill, may_enable)
        leaves = self._awaits_switching_state or self._clears_set_points
        if leaves or (self.state is State.QUICK_STOP_ACTIVE and self._request.waits):
            self.next_update = _AT_ONCE  # `standstill` is not an input of update
        return command

    @property
    def _ramps_down(self) -> bool:
        """Whether the drive is in mode VL and still in OPERATION ENABLED.

        Bits 4 to 6 then stay set, so that its ramp generator is not frozen, and a drive that ignores a quick stop
        (0x605A = -1; Beckhoff AX8xxx) ramps to its target 0.
        """
        request = self.mode_request
        return self.state is State.OPERATION_ENABLED and request.confirmed and request.mode == OperationMode.VL

    def _word(self, command: Command | None, now: int) -> int:
        """Return the controlword for a command, with mode-specific bits, and halt if the drive is enabled."""
        if self._reset.active and self.state is not None and self.statusword is not None:
            event = self._reset.update(self.state, self.statusword, now)
            if event is not None:
                self._events.append(event)
            if self._reset.rising:
                self.next_update = _AT_ONCE
            return self._reset.bit
        enabled = self.enabled
        if not (enabled and self.mode_request.confirmed) and not self._ramps_down:
            self._mode_bits = 0
        if command is None:
            return 0
        # CiA 402-2, 0x6040: bit 8 (halt) is evaluated only in OPERATION ENABLED
        return controlword_of(command) | self._mode_bits | (HALT_BIT if self.halted and enabled else 0)
