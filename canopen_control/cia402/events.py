"""Events of a drive's state machine, each with a time and a text.

`time` is the monotonic time in ns of the update that detected the event; `statusword` is the statusword at that time
(None: none received). Texts do not name the drive; the owner of the events adds the name.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from canopen_control.cia402.modes import mode_name, mode_words
from canopen_control.cia402.state import REMOTE, VOLTAGE_ENABLED, State

if TYPE_CHECKING:
    from canopen_control.cia402.state import Command


_QUICK_STOP = 11  # the transition
ENABLE_ADVICE: Final = "; enable it to continue"
"""End of the texts of events after which the drive stays disabled."""


def _word(statusword: int | None) -> str:
    return "no statusword" if statusword is None else f"statusword 0x{statusword:04X}"


def _name(state: State | None) -> str:
    return "unknown" if state is None else state.name


@dataclass(frozen=True, slots=True)
class StateChanged:
    """Change of the drive's state; None means unknown."""

    time: int
    previous: State | None
    state: State | None
    statusword: int | None

    @property
    def text(self) -> str:
        return f"{_name(self.previous)} -> {_name(self.state)} ({_word(self.statusword)})"


@dataclass(frozen=True, slots=True)
class FaultEntered:
    """Fault of the drive, after which the goal is DISABLED; `was_enabled`: it was in OPERATION_ENABLED."""

    time: int
    state: State
    statusword: int
    was_enabled: bool

    @property
    def text(self) -> str:
        return f"fault ({_word(self.statusword)}){' while enabled' if self.was_enabled else ''}"


@dataclass(frozen=True, slots=True)
class FaultCleared:
    """End of a fault; the drive stays disabled until it is enabled."""

    time: int
    statusword: int

    @property
    def text(self) -> str:
        return f"fault cleared ({_word(self.statusword)}){ENABLE_ADVICE}"


@dataclass(frozen=True, slots=True)
class FaultResetFailed:
    """Fault reset without effect; `sent` is False if the drive never left FAULT_REACTION_ACTIVE."""

    time: int
    statusword: int
    sent: bool = True

    @property
    def text(self) -> str:
        if not self.sent:
            return (
                f"still in FAULT_REACTION_ACTIVE ({_word(self.statusword)}), in which a drive accepts no fault reset, "
                "so none was sent; reset again when it shows FAULT, or switch its supply off and on"
            )
        return (
            f"fault reset had no effect: the cause is still present ({_word(self.statusword)}), or the drive needs "
            "more time (fault_reset_timeout_ms in bus.yml)"
        )


@dataclass(frozen=True, slots=True)
class TransitionTimedOut:
    """Timeout of a transition: the drive did not change from `state` to `target` in time.

    `transition` is the number of the transition that `command` requests, or 1 for a drive that should enter SWITCH ON
    DISABLED by itself; None without a transition. `gave_up` is True if enabling was abandoned and the goal is DISABLED;
    otherwise the command is repeated.
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
        cause = "" if self.command is None else f" after {self.command.name}"
        end = "; not enabled" if self.gave_up else ""
        if self.gave_up and self.transition is not None:
            end += f"; `transition_timeouts_ms: {{{self.transition}: 20000}}` in bus.yml allows more time"
        if self.transition == _QUICK_STOP:
            end += (
                "; 0x605A may disable its quick stop (0, or a manufacturer-specific value): write 2 to it under `sdo:`"
            )
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
        return f"{mode_words(self.mode)} confirmed"


@dataclass(frozen=True, slots=True)
class ModeTimedOut:
    """Requested `mode` that 0x6061 did not show in time; `restored` is the earlier mode requested again, or None.

    `enabled` is True if the drive is in OPERATION_ENABLED. An EnableLost follows if the drive was to be enabled, unless
    it continues in the restored mode.
    """

    time: int
    mode: int
    display: int | None
    restored: int | None
    enabled: bool = False

    @property
    def text(self) -> str:
        shown = "nothing" if self.display is None else mode_name(self.display)
        back = "" if self.restored is None else f"; back to {mode_name(self.restored)}"
        keys = "; mode_timeout_ms in bus.yml allows more time" if self.display is not None else ""
        if self.enabled and keys:
            keys += ", and switching_state: 2 is for a drive that changes its mode only while disabled"
        return f"{mode_words(self.mode)} not confirmed, 0x6061 shows {shown}{back}{keys}"


@dataclass(frozen=True, slots=True)
class EnableLost:
    """Loss of the enabled state, or failure to reach it, without a command by the master; the goal is DISABLED.

    `state` is the current state: below OPERATION_ENABLED; None without a valid statusword; or still OPERATION_ENABLED
    if the drive is being disabled because the mode was not confirmed, or because bit 4 has fallen (`supply_lost`).
    """

    time: int
    state: State | None
    statusword: int | None
    supply_lost: bool = False

    @property
    def power_stage_off(self) -> bool:
        """Whether bit 4 (voltage enabled) is 0, as without mains or with safe torque off."""
        return self.state is not None and self.statusword is not None and not self.statusword & VOLTAGE_ENABLED

    @property
    def text(self) -> str:
        if self.supply_lost:
            return (
                f"its power stage has lost its supply, or STO is active ({_word(self.statusword)}, bit 4 is 0), "
                f"although it shows {_name(self.state)}; being disabled{ENABLE_ADVICE}"
            )
        if self.state is State.OPERATION_ENABLED:
            return f"being disabled, still {_name(self.state)} ({_word(self.statusword)}){ENABLE_ADVICE}"
        cause = ", power stage off" if self.power_stage_off else ""
        return f"not enabled any more, now {_name(self.state)} ({_word(self.statusword)}{cause}){ENABLE_ADVICE}"


@dataclass(frozen=True, slots=True)
class ControlChanged:
    """Change of bit 9 (remote); a drive under local control (0) may ignore its controlword."""

    time: int
    statusword: int

    @property
    def remote(self) -> bool:
        return bool(self.statusword & REMOTE)

    @property
    def text(self) -> str:
        if self.remote:
            return f"under remote control again ({_word(self.statusword)})"
        return (
            f"under local control, so the controlword may be ignored ({_word(self.statusword)}, bit 9 is 0); "
            "`ignore_remote: true` in bus.yml is for a drive that never sets this bit"
        )


@dataclass(frozen=True, slots=True)
class StatuswordUndefined:
    """Statusword without a CiA 402 state in `updates` consecutive updates; an enabled drive is disabled."""

    time: int
    statusword: int
    updates: int

    @property
    def text(self) -> str:
        return f"{_word(self.statusword)} shows no CiA 402 state, for {self.updates} updates"


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
