"""The master's side of one axis: statusword in, controlword out, towards the goal somebody set.

Law of this file (CiA 402-2, 6.3, seen from the other end of the bus):

- Verbs set a goal and return; `update` makes one step towards it, whenever a statusword is there. Nothing blocks.
- One command at a time, and the next one only when the statusword shows that the last one was obeyed: 06, 07, 0F. The
  steps are `state.next_command`; `intent` adds when to stop asking.
- What is wanted is one `Intent`, which `intent.TABLE` alone changes: the goal is ENABLED only by `enable`. A fault, a
  lost enable, a vanished or senseless statusword, a transition or a mode that is not confirmed in time set it back to
  DISABLED. Nothing but a new `enable` sets it again; a fault reset never does.
- 0x0F is sent only when the goal is ENABLED and, to a drive that is not enabled yet, when the mode that was asked
  for stands in 0x6061.
- Down is the drive's own ramp: disable operation (0x605C), shutdown, disable voltage, each when the one before is
  seen done. A quick stop is over when the state says so, whatever 0x605A is; power is not cut while it lasts.
- The bits of the mode (4, 5, 6, 9) and halt (8) are sent only to an enabled drive, and the former are forgotten when it
  no longer is, so that no old set-point starts a motion.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from canopen_control.cia402.drive_goal import DISABLED_STATES, FAULT_STATES, Goal, is_stopped
from canopen_control.cia402.drive_steps import SETTLE, FaultReset, StepTimer
from canopen_control.cia402.events import (
    ControlChanged,
    EnableLost,
    FaultCleared,
    FaultEntered,
    ModeTimedOut,
    StateChanged,
    StatuswordUndefined,
)
from canopen_control.cia402.intent import DriveIntent, Intent, IntentTrigger
from canopen_control.cia402.mode_request import ModeRequest
from canopen_control.cia402.state import (
    HALT_BIT,
    MODE_SPECIFIC_BITS,
    REMOTE,
    TARGET_REACHED,
    Command,
    State,
    controlword_of,
    decode_statusword,
)
from canopen_control.errors import DriveError, LocalProtocolError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from canopen_control.cia402.events import DriveEvent

__all__ = ["DriveMachine", "Goal"]  # Goal lives in drive_goal.py: whoever has a machine speaks of its goals

_NEVER: Final = (1 << 62) - 1  # small enough to stay unboxed where this is compiled
_AT_ONCE: Final = -1
_WATCHED: Final = 0x6F | REMOTE | TARGET_REACHED  # a change of other bits of the statusword changes nothing here
_SECOND: Final = 1_000_000_000
# Transition 16 is optional: a drive that does not know it is soon led out of its quick stop the long way.
_DEFAULT_TIMEOUTS: Final = {16: _SECOND}


class DriveMachine:
    """The goal, the mode and the controlword of one axis.

    Write what `update` returns to 0x6040, and `mode` to 0x6060 unless it is None. `transition_timeouts` maps
    transition numbers to nanoseconds where `transition_timeout_ns` is not right (0: the wait for a first
    statusword). `disabled_state` is where a disabled drive ends: SWITCH_ON_DISABLED, READY_TO_SWITCH_ON or
    SWITCHED_ON. A statusword without a meaning leaves the state as it was for `undefined_limit` updates. After an
    enable that overtook a disable the drive counts as enabled again when it did not move for `settle_ns`.

    To be read: `state` (None: unknown), `statusword`, the orders `halted` and `held`, `controlword`,
    `undefined` (the number of undefined statuswords), `evaluations` (updates that had something to decide: while it
    stays the same, so does everything else). `ignore_remote` is for drives that leave bit 9 alone. `standstill` may be
    set by who knows that the motor stands; it shortens the wait for the end of a quick stop, nothing else.
    `mode_request` is what became of the mode that was asked for: confirmed by 0x6061, or failed to be.
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
    ) -> None:
        if disabled_state not in DISABLED_STATES:
            raise LocalProtocolError(f"{name}: {disabled_state.name} is no state of a disabled drive")
        self.name = name
        self.state: State | None = None
        self.statusword: int | None = None
        self.controlword = 0
        self.halted = False
        self.held = False
        self.standstill = False
        self.undefined = 0
        self.evaluations = 0
        timeouts = {**_DEFAULT_TIMEOUTS, SETTLE: settle_ns, **(transition_timeouts or {})}
        self._step = StepTimer(transition_timeout_ns, timeouts)
        self._intent = DriveIntent(self._step, disabled_state)
        self._undefined_limit = undefined_limit
        self._undefined_run = 0
        self._always_remote = REMOTE if ignore_remote else 0
        self._running_word = REMOTE  # the last one of a drive that had started: its bit 9 means something
        self._events: list[DriveEvent] = []
        self.mode_request = ModeRequest(mode_timeout_ns)
        self._mode_bits = 0
        self._reset = FaultReset(fault_reset_timeout_ns)
        self._deadline = _NEVER
        self._due = _AT_ONCE  # when there is something to decide, even if the drive says nothing new

    # What somebody wants. All of it may be said again, and does nothing then.

    def enable(self) -> None:
        """Bring the drive to OPERATION_ENABLED, from wherever it is but a fault.

        Raises DriveError in a fault, and after a mode was not confirmed until `set_mode` says which one it shall be.
        """
        if self.goal is Goal.ENABLED:
            return
        self.require_enable()
        overtaken = self.state is State.OPERATION_ENABLED and self._step.command is not Command.ENABLE_OPERATION
        self._fire(IntentTrigger.OVERTAKE if overtaken else IntentTrigger.ENABLE)

    def require_enable(self) -> None:
        """Raise the DriveError that `enable` would."""
        if self.goal is Goal.ENABLED:
            return
        if self.fault:
            raise DriveError(f"{self.name}: cannot be enabled in a fault{self._seen()}; reset the fault first")
        if self.mode_request.failed:
            raise DriveError(f"{self.name}: cannot be enabled, its mode was not confirmed; set a mode first")

    def disable(self) -> None:
        """Stop the motor by the drive's own ramp (0x605C), then take its power down to `disabled_state`."""
        self._fire(IntentTrigger.DISABLE)

    def disable_voltage(self) -> None:
        """Cut the power at once: the motor coasts. For a drive that does not obey `disable`."""
        self._fire(IntentTrigger.DISABLE_VOLTAGE)

    def quick_stop(self) -> None:
        """Stop as 0x605A says. The drive ends in QUICK_STOP_ACTIVE or SWITCH_ON_DISABLED; `enable` leaves both."""
        enabled = self.state is State.OPERATION_ENABLED
        self._fire(IntentTrigger.QUICK_STOP_ENABLED if enabled else IntentTrigger.QUICK_STOP)

    def halt(self, on: bool = True) -> None:
        """Set or clear the halt bit (0x605D) of an enabled drive; it holds until it is cleared."""
        if on is not self.halted:
            self.halted = on
            self._due = _AT_ONCE

    def hold(self, on: bool = True) -> None:
        """Wait before OPERATION_ENABLED, or go on: axes that are released in one cycle are enabled in one cycle."""
        if on is not self.held:
            self.held = on
            self._due = _AT_ONCE

    def fault_reset(self) -> None:
        """Reset a fault by one edge of bit 7; without a fault nothing is sent. Never enables anything."""
        if self.state is None or self.fault:
            self._reset.start()
            self._due = _AT_ONCE

    def set_mode(self, mode: int) -> None:
        """Ask for a mode of operation; OPERATION_ENABLED, and every motion, waits until 0x6061 shows it.

        A drive whose 0x6061 is 0 until it is enabled is enabled without, and its motion waits.

        Whether the drive has it (0x6502) was asked before: `modes.require_mode`.
        """
        if self.mode_request.ask(mode):
            self._due = _AT_ONCE

    @property
    def mode_bits(self) -> int:
        """Bits 4, 5, 6 and 9 of the controlword; zero whenever the drive is not enabled in a confirmed mode."""
        return self._mode_bits

    @mode_bits.setter
    def mode_bits(self, bits: int) -> None:
        if bits & ~MODE_SPECIFIC_BITS:
            raise LocalProtocolError(f"{self.name}: 0x{bits:04X} are not bits of a mode (0x{MODE_SPECIFIC_BITS:04X})")
        if bits != self._mode_bits:
            self._mode_bits = bits
            self._due = _AT_ONCE

    # What is.

    @property
    def disabled_state(self) -> State:
        """Where a disabled drive ends."""
        return self._intent.disabled_state

    @disabled_state.setter
    def disabled_state(self, state: State) -> None:
        self._intent.disabled_state = state

    @property
    def goal(self) -> Goal:
        """What it is to become."""
        return self._intent.goal

    @property
    def mode(self) -> int | None:
        """What to write to 0x6060; None: nobody asked for a mode, leave it as it is."""
        return self.mode_request.mode

    @property
    def waiting(self) -> bool:
        """Whether nothing but `hold` keeps the drive from being enabled by the next controlword."""
        ready = self.state is State.SWITCHED_ON or self.state is State.QUICK_STOP_ACTIVE
        return ready and self.goal is Goal.ENABLED and self.mode_request.may_enable

    @property
    def enabled(self) -> bool:
        """Whether the drive is in OPERATION_ENABLED, is meant to be, and nothing that ends it is on its way."""
        return self.state is State.OPERATION_ENABLED and self._intent.state is Intent.ENABLED

    @property
    def may_move(self) -> bool:
        """Whether a target may be sent: enabled, in the mode that was asked for, not halted."""
        return self.enabled and self.mode_request.confirmed and not self.halted

    @property
    def fault(self) -> bool:
        """Whether the drive is in a fault, or in its reaction to one."""
        return self.state in FAULT_STATES

    @property
    def remote(self) -> bool:
        """Bit 9: whether the drive obeys the bus; True until it says otherwise, and always with `ignore_remote`."""
        return bool(self._running_word & REMOTE)

    @property
    def resetting(self) -> bool:
        """Whether a fault reset is under way."""
        return self._reset.active

    @property
    def reached(self) -> bool:
        """Whether the goal is reached; the way of a stop is `drive_goal.is_stopped`."""
        if self.goal is Goal.ENABLED:
            return self.enabled and self.mode_request.confirmed
        return is_stopped(self.goal, self.disabled_state, self.state)

    def events(self) -> list[DriveEvent]:
        """Return what happened since the last call."""
        happened, self._events = self._events, []
        return happened

    def next_deadline(self) -> int | None:
        """Return when `update` must be called at the latest, None when nothing runs out."""
        return None if self._deadline == _NEVER else self._deadline

    # The cycle.

    def update(self, statusword: int | None, mode_display: int | None, now: int) -> int:
        """Take the newest 0x6041 and 0x6061 (None: not received) and return the controlword to send now.

        Call it once per cycle. Never raises. A statusword that becomes None again is a drive that is gone.
        """
        mode = self.mode_request
        if mode_display == mode.display and now < self._due:
            last = self.statusword
            if statusword == last:
                return self.controlword
            if statusword is not None and last is not None and not (statusword ^ last) & _WATCHED:
                self.statusword = statusword
                return self.controlword
        self._due = _NEVER
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
        self._intent.begin(command, self.state, now)
        self.controlword = self._word(command, now)
        self._deadline = min(step.deadline, mode.deadline, self._reset.deadline)
        self._due = min(self._due, self._deadline)
        return self.controlword

    def _fire(self, trigger: IntentTrigger) -> None:
        """Take the row of a trigger; another goal is gone for at once."""
        if self._intent.fire(trigger):
            self._due = _AT_ONCE

    def _seen(self) -> str:
        return "" if self.statusword is None else f" (statusword 0x{self.statusword:04X})"

    def _without_statusword(self, now: int) -> None:
        """Wait for a first statusword, or forget a drive that is gone."""
        if self.statusword is None:
            return
        self.statusword = None
        self._running_word = REMOTE
        self._undefined_run = 0
        self.mode_request.forget_display()
        self._reset.cancel()
        if self.state is not None:
            self._enter(None, now)
        if self.goal is Goal.ENABLED:
            self._lose(now, self.state)

    def _observe(self, statusword: int, now: int) -> None:
        self.statusword = statusword
        state = decode_statusword(statusword)
        if state is None:
            self._count_undefined(statusword, now)
            return
        self._undefined_run = 0
        if state is not self.state:
            self._change_state(self.state, state, statusword, now)
        if state is not State.NOT_READY_TO_SWITCH_ON:
            word, before = statusword | self._always_remote, self._running_word
            self._running_word = word
            if (word ^ before) & REMOTE:
                self._events.append(ControlChanged(now, statusword))
        if state is State.QUICK_STOP_ACTIVE:
            self._intent.stopping(statusword)

    def _count_undefined(self, statusword: int, now: int) -> None:
        self.undefined += 1
        self._undefined_run += 1
        self._due = _AT_ONCE  # the same word again counts again
        if self._undefined_run == self._undefined_limit:
            self._events.append(StatuswordUndefined(now, statusword, self._undefined_run))
            if self.goal is Goal.ENABLED:
                self._lose(now, None)  # the last state is what it is commanded from, not what it is in

    def _change_state(self, previous: State | None, state: State, statusword: int, now: int) -> None:
        self._enter(state, now)
        if state in FAULT_STATES:
            if previous not in FAULT_STATES:
                self._events.append(FaultEntered(now, state, statusword, previous is State.OPERATION_ENABLED))
            self._fire(IntentTrigger.LOST)
            return
        self._reset.cancel()
        if previous in FAULT_STATES:
            self._events.append(FaultCleared(now, statusword))
        elif previous is not None and self._intent.fell(previous, state):
            self._lose(now, state)

    def _enter(self, state: State | None, now: int) -> None:
        self._events.append(StateChanged(now, self.state, state, self.statusword))
        self.state = state
        self._intent.entered(state)

    def _lose(self, now: int, state: State | None) -> None:
        self._events.append(EnableLost(now, state, self.statusword))
        self._fire(IntentTrigger.LOST)

    def _supervise_mode(self, display: int | None, now: int) -> None:
        event = self.mode_request.update(display, self.state is State.OPERATION_ENABLED, now)
        if event is None:
            return
        self._events.append(event)
        # A drive that stayed in its old mode goes on in it; one that is not enabled yet, or in neither mode, does not.
        stayed = self.mode_request.confirmed and self.state is State.OPERATION_ENABLED
        if isinstance(event, ModeTimedOut) and self.goal is Goal.ENABLED and not stayed:
            self._lose(now, self.state)

    def _step_timed_out(self, now: int) -> None:
        event = self._intent.timed_out(self.state, self.statusword, now)
        if event is not None:
            self._events.append(event)
            self._fire(IntentTrigger.LOST if event.gave_up else IntentTrigger.ARRIVED)

    def _choose(self) -> Command | None:
        may_enable = self.mode_request.may_enable and not self.held
        command = self._intent.choose(self.state, self.statusword, self.standstill, may_enable)
        if self.state is State.QUICK_STOP_ACTIVE and self._intent.waits:
            self._due = _AT_ONCE  # `standstill` is no input of update
        return command

    def _word(self, command: Command | None, now: int) -> int:
        """Return the controlword: the command, and for an enabled drive the bits of its mode and halt."""
        if self._reset.active and self.state is not None and self.statusword is not None:
            event = self._reset.update(self.state, self.statusword, now)
            if event is not None:
                self._events.append(event)
            if self._reset.rising:
                self._due = _AT_ONCE
            return self._reset.bit
        enabled = self.enabled
        if not (enabled and self.mode_request.confirmed):
            self._mode_bits = 0
        if command is None:
            return 0
        return controlword_of(command) | self._mode_bits | (HALT_BIT if self.halted and enabled else 0)
