from __future__ import annotations

from canopen_control.cia402.events import ModeConfirmed, ModeTimedOut
from canopen_control.cia402.mode_request import ModeRequest


def test_nothing_asked_for_is_confirmed_whatever_the_display_shows():
    request = ModeRequest(100)
    assert request.update(0, 0) is None
    assert request.update(8, 1) is None
    assert request.confirmed
    assert request.mode is None


def test_a_mode_is_confirmed_by_the_display_alone_and_told_once():
    request = ModeRequest(100)
    assert request.ask(8)
    assert not request.ask(8)
    assert not request.confirmed
    assert request.update(None, 0) is None
    assert request.update(1, 50) is None
    assert request.update(8, 99) == ModeConfirmed(99, 8)
    assert request.update(8, 200) is None
    assert request.confirmed


def test_a_display_that_never_follows_goes_back_to_the_last_mode_that_was_confirmed():
    request = ModeRequest(100)
    request.ask(1)
    request.update(1, 0)
    request.ask(8)
    request.update(1, 10)
    assert request.deadline == 110
    event = request.update(1, 110)
    assert event == ModeTimedOut(110, 8, 1, 1)
    assert event.text == "mode CSP not confirmed, 0x6061 shows PP; back to PP"
    assert (request.mode, request.confirmed, request.failed) == (1, True, True)
    request.ask(1)
    assert not request.failed


def test_a_first_mode_that_is_never_shown_leaves_none():
    request = ModeRequest(100)
    request.ask(8)
    request.update(None, 0)
    event = request.update(None, 100)
    assert event == ModeTimedOut(100, 8, None, None)
    assert "0x6061 shows nothing" in event.text
    assert (request.mode, request.confirmed, request.failed) == (None, False, True)


def test_a_mode_that_the_drive_leaves_by_itself_is_no_longer_confirmed():
    request = ModeRequest(100)
    request.ask(8)
    request.update(8, 0)
    assert request.update(6, 10) is None
    assert not request.confirmed
    assert request.update(8, 20) == ModeConfirmed(20, 8)
    request.update(6, 30)
    assert request.update(6, 130) == ModeTimedOut(130, 8, 6, None)
    assert not request.confirmed


def test_a_drive_that_was_gone_confirms_again():
    request = ModeRequest(100)
    request.ask(8)
    request.update(8, 0)
    request.forget_display()
    assert not request.confirmed
    assert request.update(8, 1000) == ModeConfirmed(1000, 8)
