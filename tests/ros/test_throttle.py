from __future__ import annotations

from canopen_control.ros.throttle import Throttle


def test_a_sentence_is_said_at_once_and_then_once_per_interval():
    throttle = Throttle(100)
    assert [now for now in range(0, 350, 10) if throttle.allows("x", now)] == [0, 100, 200, 300]


def test_sentences_do_not_silence_each_other():
    throttle = Throttle(100)
    assert throttle.allows("x", 0)
    assert throttle.allows("y", 1)
    assert not throttle.allows("x", 2)
