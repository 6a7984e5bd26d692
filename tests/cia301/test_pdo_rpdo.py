from __future__ import annotations

import pytest
from support.services import MS, frame

from canopen_control.cia301.pdo import EMCY_OF, PdoParameters, RpdoConsumer, RpdoEvent, RpdoEventKind

KIND = RpdoEventKind


def running(transmission_type: int = 255, length: int = 3, **settings: int) -> RpdoConsumer:
    window_ns = settings.pop("window_ns", 0)
    rpdo = RpdoConsumer(
        PdoParameters(0x203, transmission_type=transmission_type, **settings), length, window_ns=window_ns
    )
    rpdo.start()
    return rpdo


def applied(rpdo: RpdoConsumer) -> list[str]:
    return [event.data.hex() for event in rpdo.events() if event.kind is KIND.APPLY]


@pytest.mark.parametrize("transmission_type", [254, 255])
def test_an_event_driven_rpdo_is_applied_at_once(transmission_type):
    rpdo = running(transmission_type)
    rpdo.receive(frame("203#0F0003"), 0)
    assert rpdo.events() == [RpdoEvent(KIND.APPLY, bytes.fromhex("0F0003"), 3)]


@pytest.mark.parametrize("transmission_type", [0, 1, 240])
def test_a_synchronous_rpdo_is_held_until_the_next_sync_and_the_newest_counts(transmission_type):
    rpdo = running(transmission_type)
    assert not rpdo.holds
    rpdo.receive(frame("203#010000"), 0)
    rpdo.receive(frame("203#020000"), 1)
    assert rpdo.events() == []
    assert rpdo.holds
    rpdo.sync(2)
    assert not rpdo.holds
    rpdo.sync(3)
    assert applied(rpdo) == ["020000"]
    assert rpdo.received == 2


def test_short_data_are_dropped_and_told():
    rpdo = running()
    rpdo.receive(frame("203#0F00"), 0)
    assert rpdo.events() == [RpdoEvent(KIND.TOO_SHORT, length=2)]
    assert (rpdo.short, rpdo.received, EMCY_OF[KIND.TOO_SHORT]) == (1, 0, 0x8210)


def test_of_long_data_the_mapped_part_counts_and_the_rest_is_told():
    rpdo = running()
    rpdo.receive(frame("203#0F00030405"), 0)
    assert rpdo.events() == [
        RpdoEvent(KIND.TOO_LONG, length=5),
        RpdoEvent(KIND.APPLY, bytes.fromhex("0F0003"), 5),
    ]
    assert (rpdo.long, EMCY_OF[KIND.TOO_LONG]) == (1, 0x8220)


def test_the_deadline_starts_with_the_first_data_and_is_told_once():
    rpdo = running(event_timer_ms=10)
    assert rpdo.next_deadline() is None
    rpdo.receive(frame("203#0F0003"), 0)
    rpdo.tick(10 * MS - 1)
    assert applied(rpdo) == ["0f0003"]
    rpdo.tick(10 * MS)
    rpdo.tick(99 * MS)
    assert rpdo.events() == [RpdoEvent(KIND.TIMEOUT)]
    rpdo.receive(frame("203#0F0003"), 100 * MS)
    assert [event.kind for event in rpdo.events()] == [KIND.RESOLVED, KIND.APPLY]
    assert EMCY_OF[KIND.TIMEOUT] == 0x8250


def test_data_behind_the_deadline_do_not_hide_the_timeout():
    rpdo = running(event_timer_ms=1)
    rpdo.receive(frame("203#0F0003"), 0)
    rpdo.receive(frame("203#0F0003"), 2 * MS)
    assert [event.kind for event in rpdo.events()] == [KIND.APPLY, KIND.TIMEOUT, KIND.RESOLVED, KIND.APPLY]


def test_synchronous_data_outside_the_window_are_dropped_and_counted():
    rpdo = running(1, window_ns=50)
    rpdo.sync(100)
    rpdo.receive(frame("203#010000"), 150)
    rpdo.receive(frame("203#020000"), 151)
    rpdo.sync(200)
    assert (applied(rpdo), rpdo.late) == (["010000"], 1)


def test_foreign_and_remote_frames_are_ignored():
    rpdo = running()
    for text in ("204#0F0003", "203#R3", "080#"):
        rpdo.receive(frame(text), 0)
    assert (rpdo.events(), rpdo.received) == ([], 0)


@pytest.mark.parametrize("settings", [{"enabled": False}, {"transmission_type": 243}, {"transmission_type": 252}])
def test_an_invalid_rpdo_is_deaf(settings):
    rpdo = running(**settings)
    rpdo.receive(frame("203#0F0003"), 0)
    rpdo.sync(1)
    assert rpdo.events() == []


def test_stopping_forgets_held_data_and_deadline():
    rpdo = running(1, event_timer_ms=1)
    rpdo.receive(frame("203#0F0003"), 0)
    rpdo.stop()
    rpdo.receive(frame("203#0F0003"), 0)
    rpdo.sync(1)
    rpdo.tick(10**12)
    assert (rpdo.events(), rpdo.next_deadline()) == ([], None)


def test_new_parameters_and_length_count_at_once():
    rpdo = running(1)
    rpdo.receive(frame("203#0F0003"), 0)
    rpdo.configure(PdoParameters(0x303, transmission_type=255), 2)
    rpdo.sync(1)
    rpdo.receive(frame("303#0F00"), 2)
    assert (applied(rpdo), rpdo.parameters.cob_id) == (["0f00"], 0x303)


@pytest.mark.parametrize(
    ("kind", "data", "settings"),
    [
        (1, "010203", {}),
        (255, "010203", {}),
        (1, "0102", {}),
        (1, "01020304", {}),
        (1, "010203", {"event_timer_ms": 5}),
        (1, "010203", {"window_ns": 5 * MS}),
        (1, "010203", {"enabled": False}),
    ],
)
def test_what_is_held_without_a_look_is_what_would_be_held_after_one(kind, data, settings):
    looked, held = running(kind, **settings), running(kind, **settings)
    looked.receive(frame(f"203#{data}"), 0)
    usual = kind == 1 and data == "010203" and not settings
    assert held.hold(bytes.fromhex(data)) is usual
    if not usual:
        assert (held.received, held.holds, held.events()) == (0, False, [])
        held.receive(frame(f"203#{data}"), 0)
    for rpdo in (looked, held):
        rpdo.sync(1)
    assert (held.received, held.events()) == (looked.received, looked.events())


def test_nothing_is_held_without_a_look_after_a_wrong_length_or_before_the_start():
    rpdo = running(1)
    rpdo.receive(frame("203#0102"), 0)
    assert not rpdo.hold(b"123")
    rpdo.receive(frame("203#010203"), 1)
    assert rpdo.hold(b"123")
    rpdo.stop()
    assert not rpdo.hold(b"123")
