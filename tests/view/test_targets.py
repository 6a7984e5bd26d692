import pytest

from canopen_control.view.targets import TargetSliders

LIMITS = {"a": (-1.0, 2.0), "b": (-1.0, 2.0)}


class Clock:
    now = 100.0

    def __call__(self):
        return self.now


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def targets(clock):
    return TargetSliders(LIMITS, clock)


def test_one_that_is_set_stays_until_the_drive_has_ended(targets, clock):
    targets.set("a", 1.5)
    assert targets.follow({"a": 0.5, "b": 0.6}) == {"b": 0.6}
    targets.targets({"a": 0.5, "b": 0.6})
    clock.now += 0.3
    assert targets.follow({"a": 0.9, "b": 0.7}) == {}
    assert targets.values == {"a": 1.5, "b": 0.6}
    clock.now += 1.0
    assert targets.follow({"a": 0.9, "b": 0.7}) == {"a": 0.9, "b": 0.7}


def test_during_teleoperation_an_unset_joint_is_held_where_it_was(targets, clock):
    targets.set("a", 1.5)
    assert targets.targets({"a": 0.0, "b": 0.6}) == [1.5, 0.6]
    clock.now += 0.05
    assert targets.targets({"a": 0.1, "b": 0.58}) == [1.5, 0.6]
    assert targets.rest({"a": 0.1, "b": None}) == [0.1, 0.6]
    clock.now += 5.0
    assert targets.targets({"a": 0.2, "b": 0.4}) == [1.5, 0.4]


def test_a_joint_with_an_unknown_position_moves_to_its_slider(targets):
    assert targets.follow({}) == {}
    assert targets.targets({"a": None}) == [0.0, 0.0]


def test_an_invisible_change_does_not_move_a_slider_and_sliders_stay_in_range(targets):
    targets.follow({"a": 0.5, "b": 0.0})
    assert targets.follow({"a": 0.504, "b": 0.0}) == {}
    targets.set("a", 99.0)
    assert targets.values["a"] == 2.0
