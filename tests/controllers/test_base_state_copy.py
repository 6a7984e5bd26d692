import math

from canopen_control.controllers.base import StateCopy, finite
from canopen_control.hardware.interfaces import StateInterface


def test_a_copy_is_of_the_moment_it_was_taken_and_keeps_its_layout():
    turn, heat = StateInterface("a", "angle", 1.0), StateInterface("a", "temperature")
    copy = StateCopy({"b": {"position": None}, "a": {"position": turn, "temperature": heat}, "empty": {}})
    first = {"b": {"position": 0.0}, "a": {"position": 1.0, "temperature": None}, "empty": {}}
    assert copy.by_joint() == first
    assert [*copy.by_joint()] == copy.joints == ["b", "a", "empty"]
    turn.value, heat.value = 2.0, 41.5
    assert copy.by_joint() == first
    copy.take()
    assert copy.by_joint()["a"] == {"position": 2.0, "temperature": 41.5}


def test_what_is_not_finite_is_not_known():
    assert [finite(value) for value in (1.5, math.nan, math.inf, -math.inf)] == [1.5, None, None, None]
