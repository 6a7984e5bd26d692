"""Bits of the statusword beside the state, and a wrong direction."""

from types import SimpleNamespace

import pytest

from canopen_control.hardware.axis import AxisLimits
from canopen_control.hardware.watch import PATIENCE, Watch

pytestmark = pytest.mark.sources  # stand-ins for an axis or a joint

WARNING, LIMIT, FOLLOWING = 1 << 7, 1 << 11, 1 << 13
CSP, PV = 8, 3


def make(action="stop", *, inputs=None):
    velocity, position = SimpleNamespace(value=0), SimpleNamespace(value=0)
    axis = SimpleNamespace(
        limits=AxisLimits(),
        digital_inputs=None if inputs is None else SimpleNamespace(value=inputs, fresh=True),
        raw_position=0,
        velocity=SimpleNamespace(value=0, fresh=True),
        output=lambda index: {0x60FF: velocity, 0x607A: position}[index],
    )
    return Watch(axis, action), axis, velocity, position


def test_each_is_told_when_it_begins_and_not_while_it_lasts():
    watch, *_ = make()
    assert [news.kind for news in watch.look(WARNING, PV, None)] == ["warning"]
    assert watch.look(WARNING | 0x27, PV, None) == []
    assert watch.look(0x27, PV, None) == []
    assert [news.kind for news in watch.look(WARNING, PV, None)] == ["warning"]


@pytest.mark.parametrize(("action", "told", "stops"), [("stop", 1, True), ("warn", 1, False), ("ignore", 0, None)])
def test_a_following_error_leads_to_the_action_that_was_chosen(action, told, stops):
    watch, *_ = make(action)
    news = watch.look(FOLLOWING, CSP, None)
    assert len(news) == told
    assert all(each.stops is stops for each in news)
    assert make(action)[0].look(FOLLOWING, PV, None) == [], "bit 13 means something else there"


@pytest.mark.parametrize(
    ("speed", "inputs", "blocked"), [(5, None, 1), (-5, None, -1), (5, 1, -1), (-5, 2, 1), (5, 3, 1)]
)
def test_a_limit_closes_the_side_of_its_switch_else_that_of_the_motion(speed, inputs, blocked):
    watch, axis, velocity, _ = make(inputs=inputs)
    velocity.value = speed
    (news,) = watch.look(LIMIT, PV, SimpleNamespace(interface="velocity"))
    assert axis.limits.blocked == blocked
    assert ("positive" if blocked > 0 else "negative") in news.text


def test_the_side_of_a_position_target_is_where_it_lies():
    watch, axis, _, position = make()
    position.value = -100
    watch.look(LIMIT, CSP, SimpleNamespace(interface="position"))
    assert axis.limits.blocked == -1


def test_a_limit_is_left_by_going_back_and_not_by_standing_still():
    watch, axis, velocity, _ = make()
    velocity.value = 5
    watch.look(LIMIT, PV, None)
    assert not watch.leaves_limit(), "it shows still"
    assert watch.look(0, PV, None) == []
    assert not watch.leaves_limit()
    assert watch.look(LIMIT, PV, None) == [], "touched again"
    watch.look(0, PV, None)
    axis.raw_position = -1
    assert watch.leaves_limit()
    assert axis.limits.blocked == 0
    assert not watch.leaves_limit()


def test_an_axis_that_turns_against_its_command_is_told_once():
    watch, axis, velocity, _ = make()
    velocity.value, axis.velocity.value = 1000, -900
    seen = [watch.turns_the_wrong_way(enabled=True) for _ in range(3 * PATIENCE)]
    assert seen.index(True) == PATIENCE, "the first look only learns the target"
    assert sum(seen) == 1


@pytest.mark.parametrize(
    ("target", "speed", "enabled"), [(1000, 900, True), (1000, -400, True), (1000, -900, False), (0, -900, True)]
)
def test_lagging_coasting_or_standing_is_not_that(target, speed, enabled):
    watch, axis, velocity, _ = make()
    velocity.value, axis.velocity.value = target, speed
    assert not any(watch.turns_the_wrong_way(enabled) for _ in range(20))
