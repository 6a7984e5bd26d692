"""Events of a joint: events of its drive, statusword bits, a wrong direction, the code of a fault."""

from types import SimpleNamespace

import pytest

from canopen_control.cia402 import events
from canopen_control.cia402.state import State
from canopen_control.hardware.axis import AxisObjectLimits
from canopen_control.hardware.joint_events import WRONG_CHECKS, FaultWatch, StatusWatch, joint_event_of
from canopen_control.master.event_log import Level
from canopen_control.rpc.messages.fault import FaultEvent

pytestmark = pytest.mark.sources  # stand-ins for an axis or a joint

WARNING, LIMIT, FOLLOWING = 1 << 7, 1 << 11, 1 << 13
CSP, PV = 8, 3


def make(action="stop", *, inputs=None):
    velocity, position = SimpleNamespace(value=0), SimpleNamespace(value=0)
    axis = SimpleNamespace(
        limits=AxisObjectLimits(),
        digital_inputs=None if inputs is None else SimpleNamespace(value=inputs, fresh=True),
        raw_position=0,
        velocity=SimpleNamespace(value=0, fresh=True),
        output=lambda index: {0x60FF: velocity, 0x607A: position}[index],
    )
    return StatusWatch(axis, action), axis, velocity, position


def test_each_is_reported_when_it_begins_and_not_while_it_lasts():
    watch, *_ = make()
    assert [item.kind for item in watch.check(WARNING, PV, None)] == ["warning"]
    assert watch.check(WARNING | 0x27, PV, None) == []
    assert watch.check(0x27, PV, None) == []
    assert [item.kind for item in watch.check(WARNING, PV, None)] == ["warning"]


@pytest.mark.parametrize(("action", "reported", "stops"), [("stop", 1, True), ("warn", 1, False), ("ignore", 0, None)])
def test_a_following_error_leads_to_the_action_that_was_chosen(action, reported, stops):
    watch, *_ = make(action)
    result = watch.check(FOLLOWING, CSP, None)
    assert len(result) == reported
    assert all(item.stops is stops for item in result)
    assert make(action)[0].check(FOLLOWING, PV, None) == [], "bit 13 means something else there"


@pytest.mark.parametrize(
    ("speed", "inputs", "blocked"), [(5, None, 1), (-5, None, -1), (5, 1, -1), (-5, 2, 1), (5, 3, 1)]
)
def test_a_limit_closes_the_side_of_its_switch_else_that_of_the_motion(speed, inputs, blocked):
    watch, axis, velocity, _ = make(inputs=inputs)
    velocity.value = speed
    (event,) = watch.check(LIMIT, PV, SimpleNamespace(interface="velocity"))
    assert axis.limits.blocked == blocked
    assert ("positive" if blocked > 0 else "negative") in event.text


def test_the_side_of_a_position_target_is_where_it_lies():
    watch, axis, _, position = make()
    position.value = -100
    watch.check(LIMIT, CSP, SimpleNamespace(interface="position"))
    assert axis.limits.blocked == -1


def test_a_limit_is_left_by_going_back_and_not_by_standing_still():
    watch, axis, velocity, _ = make()
    velocity.value = 5
    watch.check(LIMIT, PV, None)
    assert not watch.leaves_limit(), "it shows still"
    assert watch.check(0, PV, None) == []
    assert not watch.leaves_limit()
    assert watch.check(LIMIT, PV, None) == [], "touched again"
    watch.check(0, PV, None)
    axis.raw_position = -1
    assert watch.leaves_limit()
    assert axis.limits.blocked == 0
    assert not watch.leaves_limit()


@pytest.mark.parametrize(("speed", "place", "blocked"), [(-5, -1, -1), (-5, 0, 1), (5, -1, 1)])
def test_the_limit_at_the_other_end_of_a_short_way_closes_the_other_side(speed, place, blocked):
    watch, axis, velocity, _ = make()
    velocity.value = 5
    watch.check(LIMIT, PV, None)
    watch.check(0, PV, None)
    velocity.value, axis.raw_position = speed, place
    assert [event.kind for event in watch.check(LIMIT, PV, None)] == (["limit"] if blocked < 0 else [])
    assert axis.limits.blocked == blocked


def test_an_axis_that_turns_against_its_command_is_reported_once():
    watch, axis, velocity, _ = make()
    velocity.value, axis.velocity.value = 1000, -900
    observed = [watch.turns_the_wrong_way(enabled=True) for _ in range(3 * WRONG_CHECKS)]
    assert observed.index(True) == WRONG_CHECKS, "the first look only learns the target"
    assert sum(observed) == 1


@pytest.mark.parametrize(
    ("target", "speed", "enabled"), [(1000, 900, True), (1000, -400, True), (1000, -900, False), (0, -900, True)]
)
def test_lagging_coasting_or_standing_is_not_that(target, speed, enabled):
    watch, axis, velocity, _ = make()
    velocity.value, axis.velocity.value = target, speed
    assert not any(watch.turns_the_wrong_way(enabled) for _ in range(20))


def test_an_axis_that_slows_down_along_a_slow_ramp_before_it_turns_is_not_that():
    watch, axis, velocity, _ = make()
    velocity.value = 1000
    for speed in range(-3000, 0, 100):
        axis.velocity.value = speed
        assert not watch.turns_the_wrong_way(enabled=True)


# ruff: noqa: E501 - a table
EVENTS = [
    (events.StateChanged(0, None, State.FAULT, 8), "state", False),
    (events.FaultEntered(0, State.FAULT, 8, was_enabled=True), "fault", True),
    (events.FaultCleared(0, 0x40), "fault_cleared", False),
    (events.FaultResetFailed(0, 8), "fault_reset_failed", False),
    (events.TransitionTimedOut(0, State.SWITCHED_ON, State.OPERATION_ENABLED, None, 4, 0x23, gave_up=True), "transition_timeout", True),
    (events.TransitionTimedOut(0, State.SWITCHED_ON, State.READY_TO_SWITCH_ON, None, 6, 0x23, gave_up=False), "transition_timeout", False),
    (events.ModeConfirmed(0, 3), "mode", False),
    (events.ModeTimedOut(0, 3, 1, 1), "mode_timeout", False),
    (events.EnableLost(0, None, None), "enable_lost", True),
    (events.ControlChanged(0, 0x0027), "control", True),
    (events.ControlChanged(0, 0x0227), "control", False),
    (events.StatuswordUndefined(0, 1, 10), "statusword", False),
]  # fmt: skip


@pytest.mark.parametrize(("event", "kind", "stops"), EVENTS)
def test_every_event_has_its_name_and_reports_whether_it_stops(event, kind, stops):
    reported = joint_event_of(event)
    assert (reported.kind, reported.stops) == (kind, stops)
    assert reported.text == event.text


def test_control_that_returns_is_reported_as_good():
    assert joint_event_of(events.ControlChanged(0, 0x0227)).level is Level.INFO
    assert joint_event_of(events.ControlChanged(0, 0x0027)).level is Level.ERROR


FAULT = FaultEvent(statusword=0x0238)


def test_an_event_of_a_fault_has_its_statusword_for_programs():
    assert joint_event_of(events.FaultEntered(0, State.FAULT, 0x0238, True)).fault == FAULT
    assert joint_event_of(events.FaultCleared(0, 0x0240)).fault == FaultEvent(statusword=0x0240)
    assert joint_event_of(events.ControlChanged(0, 0x0227)).fault is None


def make_watch(*, has=True):
    requested, happened = [], []
    node = SimpleNamespace(read=lambda index, subindex, done: requested.append(done))
    axis = SimpleNamespace(node=node, has=lambda _index: has, index=lambda index: index)
    return FaultWatch(axis, happened), requested, happened


def test_the_code_is_read_once_and_reported_in_words():
    watch, requested, happened = make_watch()
    watch.enter(FAULT)
    watch.enter(FAULT)
    assert len(requested) == 1
    assert watch.asking
    requested[0](SimpleNamespace(error=None, data=b"\x10\x43"))
    assert not watch.asking
    assert watch.fault == FaultEvent(error_code=0x4310, statusword=0x0238)
    (event,) = happened
    assert (event.kind, event.text) == ("error_code", "0x603F is 0x4310 (drive temperature too high)")
    assert event.fault is watch.fault


def test_a_drive_without_one_is_not_asked_and_a_failed_answer_is_not_a_code():
    watch, requested, happened = make_watch(has=False)
    watch.enter(FAULT)
    assert requested == []
    watch, requested, happened = make_watch()
    watch.enter(FAULT)
    requested[0](SimpleNamespace(error="timeout", data=b""))
    assert watch.fault == FAULT
    assert happened == []
