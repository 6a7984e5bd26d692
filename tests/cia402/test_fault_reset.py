from __future__ import annotations

from canopen_control.cia402.events import FaultResetFailed
from canopen_control.cia402.fault_reset import FaultReset
from canopen_control.cia402.state import State

WORD = 0x0218


def test_bit_7_is_seen_low_then_high_once():
    reset = FaultReset(100)
    reset.start()
    assert [(reset.update(State.FAULT, WORD, now), reset.bit) for now in range(3)] == [
        (None, 0),
        (None, 0x80),
        (None, 0x80),
    ]
    reset.cancel()
    assert (reset.active, reset.bit) == (False, 0)


def test_asking_again_does_not_start_another_edge():
    reset = FaultReset(100)
    reset.start()
    reset.update(State.FAULT, WORD, 0)
    reset.update(State.FAULT, WORD, 1)
    reset.start()
    reset.update(State.FAULT, WORD, 2)
    assert reset.bit == 0x80


def test_the_edge_waits_for_the_end_of_the_fault_reaction():
    reset = FaultReset(100)
    reset.start()
    for now in range(5):
        reset.update(State.FAULT_REACTION_ACTIVE, WORD, now)
        assert reset.bit == 0
        assert not reset.rising
    reset.update(State.FAULT, WORD, 5)
    assert (reset.bit, reset.rising) == (0, True)
    reset.update(State.FAULT, WORD, 6)
    assert (reset.bit, reset.rising) == (0x80, False)


def test_a_cause_that_is_still_there_is_told_when_the_time_is_over_and_bit_7_falls():
    reset = FaultReset(100)
    reset.start()
    for now in range(0, 100, 10):
        assert reset.update(State.FAULT, WORD, now) is None
    assert reset.deadline == 100
    event = reset.update(State.FAULT, WORD, 100)
    assert event == FaultResetFailed(100, WORD)
    assert "cause still present (statusword 0x0218)" in event.text
    assert (reset.active, reset.bit) == (False, 0)
