"""What a drive's events mean for its joint."""

import pytest

from canopen_control.cia402 import events
from canopen_control.cia402.state import State
from canopen_control.hardware.news import news_of
from canopen_control.master.events import Level

# ruff: noqa: E501 - a table
EVENTS = [
    (events.StateChanged(0, None, State.FAULT, 8), "state", False),
    (events.FaultEntered(0, State.FAULT, 8, was_enabled=True), "fault", True),
    (events.FaultCleared(0, 0x40), "fault_cleared", False),
    (events.FaultResetFailed(0, 8), "fault_reset_failed", False),
    (events.TransitionTimedOut(0, State.SWITCHED_ON, State.OPERATION_ENABLED, None, 4, 0x23, gave_up=True), "transition_timeout", True),
    (events.TransitionTimedOut(0, State.SWITCHED_ON, State.READY_TO_SWITCH_ON, None, 6, 0x23, gave_up=False), "transition_timeout", False),
    (events.ModeConfirmed(0, 3), "mode", False),
    (events.ModeTimedOut(0, 3, 1, 1), "mode_timeout", False),
    (events.EnableLost(0, None, None), "enable_lost", True),
    (events.ControlChanged(0, 0x0027), "control", True),
    (events.ControlChanged(0, 0x0227), "control", False),
    (events.StatuswordUndefined(0, 1, 10), "statusword", False),
]  # fmt: skip


@pytest.mark.parametrize(("event", "kind", "stops"), EVENTS)
def test_every_event_has_its_name_and_says_whether_it_stops(event, kind, stops):
    news = news_of(event)
    assert (news.kind, news.stops) == (kind, stops)
    assert news.text == event.text


def test_control_that_comes_back_is_good_news():
    assert news_of(events.ControlChanged(0, 0x0227)).level is Level.INFO
    assert news_of(events.ControlChanged(0, 0x0027)).level is Level.ERROR
