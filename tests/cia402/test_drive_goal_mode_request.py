from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.cia402.drive_goal import CONFIRMED, FAILED, ModeRequest, ModeState, ModeTrigger
from canopen_control.cia402.drive_goal import MODE_TABLE as TABLE
from canopen_control.cia402.events import ModeConfirmed, ModeTimedOut


def test_nothing_asked_for_is_confirmed_whatever_the_display_shows():
    request = ModeRequest(100)
    assert request.update(0, False, 0) is None
    assert request.update(8, False, 1) is None
    assert request.confirmed
    assert request.mode is None


def test_a_mode_is_confirmed_by_the_display_alone_and_reported_once():
    request = ModeRequest(100)
    assert request.ask(8)
    assert not request.ask(8)
    assert not request.confirmed
    assert request.update(None, False, 0) is None
    assert request.update(1, False, 50) is None
    assert request.update(8, False, 99) == ModeConfirmed(99, 8)
    assert request.update(8, False, 200) is None
    assert request.confirmed


def test_a_display_that_never_follows_goes_back_to_the_last_mode_that_was_confirmed():
    request = ModeRequest(100)
    request.ask(1)
    request.update(1, False, 0)
    request.ask(8)
    request.update(1, False, 10)
    assert request.deadline == 110
    event = request.update(1, False, 110)
    assert event == ModeTimedOut(110, 8, 1, 1)
    assert (
        event.text == "mode CSP not confirmed, 0x6061 shows PP; back to PP; mode_timeout_ms in bus.yml allows more time"
    )
    assert (request.mode, request.confirmed, request.failed) == (1, True, True)
    request.ask(1)
    assert not request.failed


def test_a_first_mode_that_is_never_shown_leaves_none():
    request = ModeRequest(100)
    request.ask(8)
    request.update(None, False, 0)
    event = request.update(None, False, 100)
    assert event == ModeTimedOut(100, 8, None, None)
    assert "0x6061 shows nothing" in event.text
    assert (request.mode, request.confirmed, request.failed) == (None, False, True)


def test_a_mode_that_the_drive_leaves_by_itself_is_no_longer_confirmed():
    request = ModeRequest(100)
    request.ask(8)
    request.update(8, False, 0)
    assert request.update(6, False, 10) is None
    assert not request.confirmed
    assert request.update(8, False, 20) == ModeConfirmed(20, 8)
    request.update(6, False, 30)
    assert request.update(6, False, 130) == ModeTimedOut(130, 8, 6, None)
    assert not request.confirmed


def test_a_drive_that_shows_no_mode_until_it_is_enabled_may_be_enabled_and_shows_it_then():
    request = ModeRequest(100)
    request.ask(3)
    assert request.update(0, False, 0) is None
    assert (request.may_enable, request.deadline) == (False, 50)
    assert request.update(0, False, 50) is None
    assert (request.state, request.may_enable, request.confirmed) == (ModeState.UNSHOWN, True, False)
    assert request.update(0, False, 10_000) is None  # off for long: nothing runs out
    assert request.update(0, True, 10_010) is None
    assert request.update(3, True, 10_020) == ModeConfirmed(10_020, 3)
    assert request.update(0, False, 20_000) is None  # disabled: shows none again
    assert not request.may_enable
    assert request.update(0, False, 20_050) is None
    assert request.may_enable


def test_a_drive_that_is_enabled_and_shows_no_mode_in_time_has_failed():
    request = ModeRequest(100)
    request.ask(3)
    request.update(0, False, 0)
    request.update(0, False, 50)
    assert request.update(0, True, 60) is None
    assert request.update(0, True, 160) == ModeTimedOut(160, 3, 0, None, True)
    assert (request.failed, request.may_enable) == (True, False)


@pytest.mark.parametrize("display", [None, 1, -2])
def test_a_drive_that_shows_another_mode_or_nothing_is_not_enabled_without(display):
    request = ModeRequest(100)
    request.ask(3)
    request.update(display, False, 0)
    assert not request.may_enable
    assert request.update(display, False, 100) == ModeTimedOut(100, 3, display, None)
    assert not request.may_enable


def test_a_display_of_minus_one_is_a_change_under_way_and_has_five_times_the_time():
    request = ModeRequest(100)
    request.ask(7)
    for now in (0, 100, 499):
        assert request.update(-1, False, now) is None
    assert request.update(7, False, 499) == ModeConfirmed(499, 7)
    request.ask(8)
    request.update(-1, False, 500)
    assert request.update(-1, False, 1000) == ModeTimedOut(1000, 8, -1, 7)


def test_a_drive_that_was_gone_confirms_again():
    request = ModeRequest(100)
    request.ask(8)
    request.update(8, False, 0)
    request.forget_display()
    assert not request.confirmed
    assert request.update(8, False, 1000) == ModeConfirmed(1000, 8)


def test_every_state_and_every_trigger_has_its_rows_and_can_be_reached():
    assert set(TABLE) == set(ModeState)
    reached = {ModeState.NONE}
    for _ in ModeState:
        reached |= {after for state in reached for after in TABLE[state].values()}
    assert reached == set(ModeState)
    assert {trigger for rows in TABLE.values() for trigger in rows} == set(ModeTrigger)


@pytest.mark.parametrize("state", ModeState)
def test_only_what_0x6061_shows_or_an_ask_for_what_it_shows_confirms(state):
    for trigger, after in TABLE[state].items():
        if after in CONFIRMED and state not in CONFIRMED:
            assert trigger in (ModeTrigger.SHOWN, ModeTrigger.OVERDUE_STAYED)
        if state in FAILED and after not in FAILED:
            assert trigger in (ModeTrigger.ASK, ModeTrigger.ASK_AGAIN), "until somebody asks again"
    assert TABLE[state][ModeTrigger.ASK] is ModeState.REQUESTED


STEPS = st.one_of(
    st.tuples(st.just("ask"), st.integers(1, 3)),
    st.tuples(st.just("show"), st.none() | st.integers(0, 3)),
    st.just(("gone", None)),
)


@given(st.lists(st.tuples(STEPS, st.integers(0, 60)), max_size=60))
def test_a_confirmed_mode_is_the_one_that_0x6061_showed_last(steps):
    request, now, display, requested = ModeRequest(100), 0, None, set()
    for (what, value), passed in steps:
        now += passed
        if what == "ask":
            requested.add(value)
            before = request.mode
            assert request.ask(value) is (value != before)
            assert not request.failed
        elif what == "gone":
            display = None
            request.forget_display()
        else:
            display = value
            event = request.update(display, False, now)
            assert request.failed or not isinstance(event, ModeTimedOut)
            assert request.state in CONFIRMED + FAILED or request.deadline > now
        assert request.mode is None or request.mode in requested
        assert (request.mode is None) is (request.state in (ModeState.NONE, ModeState.REFUSED))
        assert request.confirmed <= (request.mode in (None, display))


def test_a_mode_that_was_not_confirmed_in_time_is_kept_until_it_is():
    request = ModeRequest(100)
    request.ask(3)
    for now in (0, 100):
        assert request.missed is None
        request.update(0, True, now)
    assert request.missed == 3
    request.ask(3)
    request.update(0, True, 200)
    assert request.missed == 3
    request.update(3, True, 210)
    assert request.missed is None
