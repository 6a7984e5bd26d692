"""Events of a drive's state machines: frozen records, each with its time and one sentence.

`time` is the monotonic time in ns of the update that detected it, `statusword` the word that showed it (None: none
received). Texts do not name the drive; the owner of the events adds its name.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from canopen_control.cia402.modes import mode_name, mode_words
from canopen_control.cia402.state import REMOTE, VOLTAGE_ENABLED, State

if TYPE_CHECKING:
    from canopen_control.cia402.state import Command


_QUICK_STOP = 11  # the transition


def _word(statusword: int | None) -> str:
    return "no statusword" if statusword is None else f"statusword 0x{statusword:04X}"


def _name(state: State | None) -> str:
    return "unknown" if state is None else state.name


@dataclass(frozen=True, slots=True)
class StateChanged:
    """Change of the drive's state; None is unknown, before the first statusword or without one."""

    time: int
    previous: State | None
    state: State | None
    statusword: int | None

    @property
    def text(self) -> str:
        """Sentence for users."""
        return f"{_name(self.previous)} -> {_name(self.state)} ({_word(self.statusword)})"


@dataclass(frozen=True, slots=True)
class FaultEntered:
    """Fault reported by the drive; the goal is now DISABLED. `was_enabled`: it was in OPERATION_ENABLED before."""

    time: int
    state: State
    statusword: int
    was_enabled: bool

    @property
    def text(self) -> str:
        """Sentence for users."""
        return f"fault ({_word(self.statusword)}){' while enabled' if self.was_enabled else ''}"


@dataclass(frozen=True, slots=True)
class FaultCleared:
    """End of a fault; the drive stays disabled until an enable."""

    time: int
    statusword: int

    @property
    def text(self) -> str:
        """Sentence for users."""
        return f"fault cleared ({_word(self.statusword)}); enable to go on"


@dataclass(frozen=True, slots=True)
class FaultResetFailed:
    """Failed fault reset: the drive is still in its fault; not `sent`: it is in its fault reaction."""

    time: int
    statusword: int
    sent: bool = True

    @property
    def text(self) -> str:
        """Sentence for users."""
        if not self.sent:
            return (
                f"still in FAULT REACTION ACTIVE ({_word(self.statusword)}), where no fault reset counts, so none was "
                "sent; reset again when it shows FAULT, or switch its supply off and on"
            )
        return (
            f"fault reset had no effect: cause still present ({_word(self.statusword)}), or the drive takes longer "
            "(fault_reset_timeout_ms in bus.yml)"
        )


@dataclass(frozen=True, slots=True)
class TransitionTimedOut:
    """Timeout of a transition: the drive did not go from `state` to `target` in time.

    `transition` is the number of the transition requested by `command`, or of the one by itself to SWITCH ON DISABLED;
    None if no statusword was received. `gave_up`: enabling was abandoned, the goal is now DISABLED; otherwise the
    request is repeated.
    """

    time: int
    state: State | None
    target: State
    command: Command | None
    transition: int | None
    statusword: int | None
    gave_up: bool

    @property
    def text(self) -> str:
        """Sentence for users."""
        cause = "" if self.command is None else f", asked by {self.command.name}"
        end = "; not enabled" if self.gave_up else ""
        if self.gave_up and self.transition is not None:
            end += f"; `transition_timeouts_ms: {{{self.transition}: 20000}}` in bus.yml gives it more time"
        if self.transition == _QUICK_STOP:
            end += "; 0x605A may switch its quick stop off (0, or a value of the manufacturer's): write 2 under `sdo:`"
        return (
            f"did not leave {_name(self.state)} for {self.target.name} in time{cause} ({_word(self.statusword)}){end}"
        )


@dataclass(frozen=True, slots=True)
class ModeConfirmed:
    """Confirmation of the requested mode by 0x6061."""

    time: int
    mode: int

    @property
    def text(self) -> str:
        """Sentence for users."""
        return f"{mode_words(self.mode)} confirmed"


@dataclass(frozen=True, slots=True)
class ModeTimedOut:
    """Timeout of a mode: 0x6061 shows `display` instead of `mode`; `restored` is requested again (None: none).

    `enabled`: in OPERATION_ENABLED. An EnableLost follows unless the drive continues in the restored mode.
    """

    time: int
    mode: int
    display: int | None
    restored: int | None
    enabled: bool = False

    @property
    def text(self) -> str:
        """Sentence for users."""
        shown = "nothing" if self.display is None else mode_name(self.display)
        back = "" if self.restored is None else f"; back to {mode_name(self.restored)}"
        keys = "; mode_timeout_ms in bus.yml gives it more time" if self.display is not None else ""
        if self.enabled and keys:
            keys += ", and switching_state: 2 serves a drive that changes its mode only while it is disabled"
        return f"{mode_words(self.mode)} not confirmed, 0x6061 shows {shown}{back}{keys}"


@dataclass(frozen=True, slots=True)
class EnableLost:
    """Enable that ended, or failed, without a command; the goal is DISABLED.

    `state` is the current one: below OPERATION_ENABLED, None without a valid statusword, still OPERATION_ENABLED when
    the mode was not confirmed and the drive is being disabled.
    """

    time: int
    state: State | None
    statusword: int | None

    @property
    def power_stage_off(self) -> bool:
        """Whether bit 4 reports a power stage without voltage: mains lost, or safe torque off."""
        return self.state is not None and self.statusword is not None and not self.statusword & VOLTAGE_ENABLED

    @property
    def text(self) -> str:
        """Sentence for users."""
        if self.state is State.OPERATION_ENABLED:
            return f"being disabled, still {_name(self.state)} ({_word(self.statusword)}); enable to go on"
        cause = ", power stage off" if self.power_stage_off else ""
        return f"no longer enabled, now {_name(self.state)} ({_word(self.statusword)}{cause}); enable to go on"


@dataclass(frozen=True, slots=True)
class ControlChanged:
    """Change of bit 9, or 0 in the first statusword: a drive under local control ignores its controlword."""

    time: int
    statusword: int

    @property
    def remote(self) -> bool:
        """Whether the drive obeys the bus."""
        return bool(self.statusword & REMOTE)

    @property
    def text(self) -> str:
        """Sentence for users."""
        if self.remote:
            return f"under remote control again ({_word(self.statusword)})"
        return (
            f"under local control, controlword may be ignored ({_word(self.statusword)}, bit 9 is 0); "
            "`ignore_remote: true` in bus.yml is for a drive that never sets it"
        )


@dataclass(frozen=True, slots=True)
class StatuswordUndefined:
    """Undefined statusword for `updates` consecutive updates; an enabled drive is being disabled."""

    time: int
    statusword: int
    updates: int

    @property
    def text(self) -> str:
        """Sentence for users."""
        return f"{_word(self.statusword)} shows no state, for {self.updates} updates"


FAULT_EVENTS = (FaultEntered, FaultCleared, FaultResetFailed)
DriveEvent = (
    StateChanged
    | FaultEntered
    | FaultCleared
    | FaultResetFailed
    | TransitionTimedOut
    | ModeConfirmed
    | ModeTimedOut
    | EnableLost
    | ControlChanged
    | StatuswordUndefined
)
