from __future__ import annotations

import json
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.cia402.homing import (
    METHODS,
    HomingDone,
    HomingFailed,
    HomingPosition,
    HomingSequence,
    HomingStatus,
    homing_status,
    require_method,
)
from canopen_control.errors import DriveError

VECTORS = json.loads((Path(__file__).parents[1] / "data" / "cia402.json").read_text())["cia402_mode_bits"]
RUNNING, STOPPED, ATTAINED, DONE, ERROR_MOVING, ERROR = 0x0237, 0x0637, 0x1237, 0x1637, 0x2237, 0x2637
MEANINGS = {
    "in progress": HomingStatus.IN_PROGRESS,
    "interrupted or not started": HomingStatus.NOT_RUNNING,
    "attained, target not yet reached": HomingStatus.ATTAINED,
    "completed": HomingStatus.COMPLETED,
    "error, still moving": HomingStatus.ERROR_MOVING,
    "error, at standstill": HomingStatus.ERROR_STOPPED,
}


def home(words: list[int], method: int = 1, step: int = 10, **settings: int) -> tuple[HomingSequence, list[int], list]:
    """Start a homing and show it `words` from the update on that sends bit 4; before, the first of them."""
    machine = HomingSequence(**settings)
    machine.start(method)
    sent: list[int] = []
    now = 0
    while not sent or not sent[-1]:
        sent.append(machine.update(words[0], True, now))
        now += step
    for word in words[1:]:
        sent.append(machine.update(word, True, now))
        now += step
    return machine, sent, machine.events()


@pytest.mark.parametrize("example", VECTORS["homing_examples"], ids=lambda example: example["sw"])
def test_the_examples_of_the_vectors_decode(example):
    assert homing_status(int(example["sw"], 16)) is MEANINGS[example["meaning"]]


def test_the_three_bits_are_the_table_of_the_vectors():
    for bits, meaning in VECTORS["homing_status_bits_13_12_10"].items():
        status = HomingStatus(int(bits, 2))
        assert MEANINGS.get(meaning, status) is status


def test_homing_starts_by_an_edge_and_is_done_when_attained_and_reached():
    machine, sent, events = home([STOPPED, RUNNING, RUNNING, ATTAINED, DONE, DONE])
    assert sent == [0, 0, 0, 0x10, 0x10, 0x10, 0x10, 0, 0]
    assert events == [HomingDone(70, 1)]
    assert events[0].text == "homed by method 1"
    assert machine.homed
    assert not machine.active
    machine.forget()
    assert not machine.homed


def test_the_bits_of_the_last_homing_are_not_this_ones_end():
    machine, sent, events = home([DONE, DONE, DONE, RUNNING, DONE])
    assert sent[3:] == [0x10, 0x10, 0x10, 0x10, 0]
    assert [type(event) for event in events] == [HomingDone]
    machine, sent, events = home([DONE] * 30, start_timeout_ns=100)
    assert sent[-1] == 0
    assert not machine.homed
    assert events[0].reason.startswith("the drive did not start it in time; check in its manual that it supports")
    assert events[0].time == 130


@pytest.mark.parametrize("method", [35, 37])
def test_a_method_without_motion_may_be_over_between_two_statuswords(method):
    machine, _, events = home([DONE] * 10, method)
    assert events == [HomingDone(70, method)]
    machine, sent, events = home([STOPPED, DONE], method)
    assert machine.homed
    assert sent[-1] == 0


@pytest.mark.parametrize("word", [ERROR_MOVING, ERROR, 0x3237, 0x3637])
def test_an_error_ends_it(word):
    machine, sent, events = home([STOPPED, RUNNING, word])
    assert sent[-1] == 0
    assert isinstance(events[0], HomingFailed)
    assert events[0].status is homing_status(word)
    assert events[0].text == "homing by method 1 failed: the drive reports a homing error"
    assert not machine.homed


def test_an_interruption_ends_it_but_a_glimpse_of_one_does_not():
    machine, _, events = home([STOPPED, RUNNING, STOPPED, STOPPED, RUNNING, DONE])
    assert machine.homed
    machine, sent, events = home([STOPPED, RUNNING, *[STOPPED] * 5])
    assert events[0].reason == "the drive interrupted it"
    assert sent[-1] == 0


def test_one_that_does_not_start_or_does_not_end_has_its_time():
    _, _, events = home([STOPPED] * 30, start_timeout_ns=100)
    assert [(event.reason.partition(";")[0], event.time) for event in events] == [
        ("the drive did not start it in time", 130)
    ]
    machine, sent, events = home([STOPPED, *[RUNNING] * 200], timeout_ns=1000, start_timeout_ns=100)
    assert [(event.reason, event.time) for event in events] == [
        ("not done in time; `homing_timeout_seconds` in bus.yml allows more time", 1000)
    ]
    assert sent[-1] == 0
    assert machine.next_deadline() is None


def test_an_abort_or_a_drive_that_is_not_enabled_ends_it():
    for ready, word, reason in ((True, RUNNING, "stopped"), (False, RUNNING, "not enabled"), (True, None, "enabled")):
        machine = HomingSequence()
        machine.start(1)
        machine.start(2)
        for now in range(6):
            machine.update(RUNNING, True, now)
        assert machine.next_deadline() is not None
        if reason == "stopped":
            machine.abort(reason)
        assert machine.update(word, ready, 10) == 0
        (event,) = machine.events()
        assert event.method == 1
        assert reason in event.reason
        assert not machine.active


def test_methods_are_those_of_the_profile_or_of_0x60e3():
    for method in (0, 1, 14, 17, 30, 33, 35, 37, -4):
        require_method(method)
    for method in (15, 16, 31, 32, 36, 38):
        with pytest.raises(DriveError, match="it is reserved"):
            require_method(method)
    require_method(17, {17, 35})
    with pytest.raises(DriveError, match=r"homing method 1 .*negative limit switch.*0x60E3 lists 17, 35"):
        require_method(1, {35, 17})
    assert METHODS[17] == "negative limit switch"
    assert METHODS[1] == "negative limit switch, and index pulse"


@given(st.lists(st.tuples(st.integers(0, 0xFFFF) | st.none(), st.booleans(), st.integers(0, 10**9), st.integers(0, 9))))
def test_whatever_comes_bit_4_is_up_only_while_it_runs_and_homed_needs_a_done(steps):
    machine = HomingSequence()
    now = 0
    homed = False
    for word, ready, passed, verb in steps:
        if verb == 0:
            homed = homed and machine.active
            machine.start(1)
            homed = False
        elif verb == 1:
            machine.abort()
        now += passed
        bits = machine.update(word, ready, now)
        events = machine.events()
        homed = homed or any(isinstance(event, HomingDone) for event in events)
        assert bits in (0, 0x10)
        assert not bits or (machine.active and ready and word is not None)
        assert len(events) <= 1
        assert not (events and machine.active)
        assert machine.homed <= homed


@pytest.mark.parametrize(
    ("words", "done"),
    [
        ([RUNNING] * 3 + [ATTAINED] * 12, True),
        ([RUNNING] * 3 + [ATTAINED] * 10, False),
        ([RUNNING] * 3 + [ATTAINED] * 6 + [RUNNING] + [ATTAINED] * 6, False),
        ([ATTAINED] * 30, False),  # that of the last homing
    ],
)
def test_a_drive_without_bit_10_has_homed_when_it_has_stood_still_for_a_second(words, done):
    """JVL's MIS motors set bit 12 alone (ros2_canopen, issue 245)."""
    for standing in (True, False):
        machine = HomingSequence(start_timeout_ns=10_000_000_000)
        machine.start(1)
        for turn, word in enumerate([words[0]] * 4 + words):
            machine.update(word, True, turn * 100_000_000, standing=standing)
        assert machine.homed is (done and standing)


def settling(positions, *, step=50_000_000, tolerance=10, offset=None):
    """Show a homing that is done, and then positions; return the number of updates until it has ended."""
    machine = HomingSequence(tolerance=tolerance) if offset is None else HomingSequence(tolerance=tolerance, near=50)
    machine.home_offset = offset or 0
    machine.start(37)
    for turn, word in enumerate([STOPPED, STOPPED, STOPPED, STOPPED, DONE]):
        assert not machine.homed
        machine.update(word, True, turn, position=HomingPosition(1000, 1))
    for turn, position in enumerate(positions):
        bit = machine.update(DONE, True, 5 + turn * step, position=position)
        assert bool(bit) is not machine.homed
        if machine.homed:
            return turn + 1
    return None


def test_a_homing_ends_when_the_new_zero_has_arrived():
    """The position comes in another TPDO than the statusword, and some drives update it later."""
    old = [HomingPosition(1000, 2 + turn) for turn in range(3)]
    new = [HomingPosition(turn, 10 + turn) for turn in range(20)]
    assert settling(old + new) == 3 + 5
    assert settling([HomingPosition(1000 + turn % 3, turn) for turn in range(20)]) == 5
    assert settling([HomingPosition(1000, 1)] * 20) is None, "no new position: it waits for frames"
    assert settling([HomingPosition(1000, 1 + turn // 10) for turn in range(40)]) == 21
    assert settling([None]) == 1, "no position is received"


@pytest.mark.parametrize(("offset", "updates"), [(1000, 5), (-1030, 5), (0, 41)])
def test_a_position_that_is_not_near_the_home_offset_has_two_seconds_to_change(offset, updates):
    assert settling([HomingPosition(1000, turn) for turn in range(60)], offset=offset) == updates


def test_a_new_zero_that_arrives_after_a_second_ends_the_homing():
    positions = [HomingPosition(1000 if turn < 20 else 0, turn) for turn in range(60)]
    assert settling(positions, offset=0) == 25


def test_a_position_that_never_settles_is_not_waited_for():
    assert settling([HomingPosition(100 * turn, turn) for turn in range(200)]) == 101


def test_an_axis_that_is_disabled_before_the_new_zero_has_arrived_is_not_homed():
    machine = HomingSequence()
    machine.start(37)
    for turn in range(5):
        machine.update(DONE if turn == 4 else STOPPED, True, turn, position=HomingPosition(1000, turn))
    assert machine.update(DONE, False, 10, position=HomingPosition(1000, 9)) == 0
    (event,) = machine.events()
    assert "not enabled" in event.text
    assert not machine.homed
