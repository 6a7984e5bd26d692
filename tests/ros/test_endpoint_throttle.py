from __future__ import annotations

from canopen_control.ros.endpoint import Refusals, Throttle, without_numbers


def test_a_sentence_is_reported_at_once_and_then_once_per_interval():
    throttle = Throttle(100)
    assert [now for now in range(0, 350, 10) if throttle.allows("x", now)] == [0, 100, 200, 300]


def test_a_reason_is_reported_once_and_the_number_at_the_end():
    refusals = Refusals()
    assert refusals.answered("base", "not enabled") == "not enabled"
    assert [refusals.answered("base", "not enabled") for _ in range(50)] == [None] * 50
    assert refusals.answered("arm", "not enabled") == "not enabled"
    assert refusals.answered("base", None) == "base accepts commands again; 51 were refused"
    assert refusals.answered("base", None) is None
    assert refusals.answered("base", "not enabled") == "not enabled"


def test_another_reason_is_reported_again_and_another_number_in_it_is_not():
    refusals = Refusals()
    assert refusals.answered("base", "a twist that is 0.712 s old") is not None
    assert refusals.answered("base", "a twist that is 13.4 s old") is None
    assert refusals.answered("base", "latched") == "latched"


def test_a_sentence_is_known_whatever_numbers_are_in_it():
    assert without_numbers("point 3 at -1.5e-3 rad") == without_numbers("point 12 at 7 rad") == "point # at # rad"
