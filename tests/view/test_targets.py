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


def test_while_somebody_drives_a_joint_that_was_not_set_is_held_where_it_was(targets, clock):
    targets.set("a", 1.5)
    assert targets.targets({"a": 0.0, "b": 0.6}) == [1.5, 0.6]
    clock.now += 0.05
    assert targets.targets({"a": 0.1, "b": 0.58}) == [1.5, 0.6]
    assert targets.rest({"a": 0.1, "b": None}) == [0.1, 0.6]
    clock.now += 5.0
    assert targets.targets({"a": 0.2, "b": 0.4}) == [1.5, 0.4]


def test_a_joint_that_nobody_knows_the_place_of_goes_where_its_slider_is(targets):
    assert targets.follow({}) == {}
    assert targets.targets({"a": None}) == [0.0, 0.0]


def test_what_nobody_could_see_does_not_move_a_slider_and_none_leaves_its_ends(targets):
    targets.follow({"a": 0.5, "b": 0.0})
    assert targets.follow({"a": 0.504, "b": 0.0}) == {}
    targets.set("a", 99.0)
    assert targets.values["a"] == 2.0
