from __future__ import annotations

import dataclasses
import typing

import pytest

from canopen_control.cia402.events import (
    ControlChanged,
    DriveEvent,
    EnableLost,
    FaultCleared,
    FaultEntered,
    FaultResetFailed,
    ModeConfirmed,
    ModeTimedOut,
    StateChanged,
    StatuswordUndefined,
    TransitionTimedOut,
)
from canopen_control.cia402.state import Command, State

SAID = [
    (StateChanged(1, None, State.FAULT, 0x0208), "unknown -> FAULT (statusword 0x0208)"),
    (StateChanged(1, State.FAULT, None, None), "FAULT -> unknown (no statusword)"),
    (FaultEntered(1, State.FAULT, 0x0208, True), "fault (statusword 0x0208) while enabled"),
    (FaultEntered(1, State.FAULT, 0x0208, False), "fault (statusword 0x0208)"),
    (FaultCleared(1, 0x0240), "fault cleared (statusword 0x0240); enable it to continue"),
    (
        FaultResetFailed(1, 0x0208),
        "fault reset had no effect: the cause is still present (statusword 0x0208), or the drive needs more time "
        "(fault_reset_timeout_ms in bus.yml)",
    ),
    (
        FaultResetFailed(1, 0x020F, False),
        "still in FAULT_REACTION_ACTIVE (statusword 0x020F), in which a drive accepts no fault reset, so none was "
        "sent; reset "
        "again when it shows FAULT, or switch its supply off and on",
    ),
    (
        TransitionTimedOut(1, State.SWITCHED_ON, State.OPERATION_ENABLED, Command.ENABLE_OPERATION, 4, 0x0233, True),
        "did not leave SWITCHED_ON for OPERATION_ENABLED in time after ENABLE_OPERATION (statusword 0x0233); "
        "not enabled; `transition_timeouts_ms: {4: 20000}` in bus.yml allows more time",
    ),
    (
        TransitionTimedOut(1, None, State.OPERATION_ENABLED, None, None, None, False),
        "did not leave unknown for OPERATION_ENABLED in time (no statusword)",
    ),
    (ModeConfirmed(1, 8), "mode CSP confirmed"),
    (
        ModeTimedOut(1, 8, 0, None),
        "mode CSP not confirmed, 0x6061 shows NONE; mode_timeout_ms in bus.yml allows more time",
    ),
    (
        EnableLost(1, State.SWITCH_ON_DISABLED, 0x0240),
        "not enabled any more, now SWITCH_ON_DISABLED (statusword 0x0240, power stage off); enable it to continue",
    ),
    (
        EnableLost(1, State.SWITCHED_ON, 0x0233),
        "not enabled any more, now SWITCHED_ON (statusword 0x0233); enable it to continue",
    ),
    (EnableLost(1, None, None), "not enabled any more, now unknown (no statusword); enable it to continue"),
    (EnableLost(1, None, 0x0001), "not enabled any more, now unknown (statusword 0x0001); enable it to continue"),
    (
        EnableLost(1, State.OPERATION_ENABLED, 0x0237),
        "being disabled, still OPERATION_ENABLED (statusword 0x0237); enable it to continue",
    ),
    (
        ControlChanged(1, 0x0040),
        "under local control, so the controlword may be ignored (statusword 0x0040, bit 9 is 0); `ignore_remote: "
        "true` in "
        "bus.yml is for a drive that never sets this bit",
    ),
    (ControlChanged(1, 0x0240), "under remote control again (statusword 0x0240)"),
    (StatuswordUndefined(1, 0x0001, 10), "statusword 0x0001 shows no CiA 402 state, for 10 updates"),
]


@pytest.mark.parametrize(("event", "text"), SAID, ids=lambda value: type(value).__name__)
def test_an_event_reports_what_happened(event, text):
    assert event.text == text


def test_every_event_is_frozen_has_its_time_and_a_text():
    assert {type(event) for event, _ in SAID} == set(typing.get_args(DriveEvent))
    for event, _ in SAID:
        assert event.time == 1
        with pytest.raises(dataclasses.FrozenInstanceError):
            event.time = 2
