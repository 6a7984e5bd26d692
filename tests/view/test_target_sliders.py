import pytest

from canopen_control.view.target_sliders import TargetSliders

LIMITS = {"min": -1.0, "max": 2.0, "step": 0.01}


class Clock:
    now = 100.0

    def __call__(self):
        return self.now


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def sliders(server):
    return {name: server.gui.add_slider(name, initial_value=0.0, **LIMITS) for name in ("a", "b")}


@pytest.fixture
def targets(sliders, clock):
    return TargetSliders(sliders, clock)


def shown(sliders):
    return [slider.value for slider in sliders.values()]


def test_a_slider_shows_where_its_joint_is_within_its_ends(targets, sliders):
    targets.follow({"a": 0.5, "b": 7.0})
    assert shown(sliders) == [0.5, 2.0]


def test_one_that_is_set_stays_until_the_drive_has_ended(targets, sliders, clock, hand):
    hand.choose(sliders["a"], 1.5)
    targets.follow({"a": 0.5, "b": 0.6})
    assert shown(sliders) == [1.5, 0.6]
    targets.targets({"a": 0.5, "b": 0.6})
    clock.now += 0.3
    targets.follow({"a": 0.9, "b": 0.7})
    assert shown(sliders) == [1.5, 0.6]
    clock.now += 1.0
    targets.follow({"a": 0.9, "b": 0.7})
    assert shown(sliders) == [0.9, 0.7]


def test_while_somebody_drives_a_joint_that_was_not_set_is_held_where_it_was(targets, sliders, clock, hand):
    hand.choose(sliders["a"], 1.5)
    assert targets.targets({"a": 0.0, "b": 0.6}) == [1.5, 0.6]
    clock.now += 0.05
    assert targets.targets({"a": 0.1, "b": 0.58}) == [1.5, 0.6]
    assert targets.rest({"a": 0.1, "b": None}) == [0.1, 0.6]
    clock.now += 5.0
    assert targets.targets({"a": 0.2, "b": 0.4}) == [1.5, 0.4]


def test_a_joint_that_nobody_knows_the_place_of_goes_where_its_slider_is(targets, sliders):
    targets.follow({})
    assert targets.targets({"a": None}) == [0.0, 0.0]


def test_pages_are_not_sent_what_nobody_could_see(targets, sliders, clock):
    targets.follow({"a": 0.5, "b": 0.0})
    clock.now += 0.05
    targets.follow({"a": 0.8, "b": 0.0})
    assert sliders["a"].value == 0.5
    clock.now += 1.0
    targets.follow({"a": 0.504, "b": 0.0})
    assert sliders["a"].value == 0.5
