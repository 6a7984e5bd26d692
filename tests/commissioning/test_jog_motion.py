import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.commissioning.jog_motion import JogEnd, JogKind, JogLimits, JogMotion

MS = 1_000_000
LIMITS = JogLimits(speed=2.0, travel=10.0, current=1000.0)


def jog(kind=JogKind.VELOCITY, value=1.0, seconds=None, limits=LIMITS):
    return JogMotion(kind, value, limits, seconds=seconds, now=0)


def at(motion, position, velocity=0.0, current=None, *, enabled=True):
    motion.see(position, velocity, current, enabled=enabled)


def test_a_held_key_moves_and_its_release_stops():
    motion = jog()
    assert (motion.by_keys, motion.command) == (True, 0.0)
    motion.key("right", 0)
    assert motion.command == 1.0
    for now in range(500, 1000, 40):
        motion.key("right", now * MS)
    motion.tick(1200 * MS)
    assert motion.command == 1.0
    motion.tick(1250 * MS)  # a quarter of a second after the last repetition
    assert motion.command == 0.0


def test_the_other_arrow_moves_the_other_way_and_any_other_key_stops():
    motion = jog()
    for key, command in (("up", 1.0), ("down", -1.0), ("left", -1.0), ("right", 1.0), ("space", 0.0), ("u", 0.0)):
        motion.key(key, 0)
        assert motion.command == command, key
    assert motion.ended is JogEnd.NONE


@pytest.mark.parametrize("key", ["ctrl-c", "ctrl-d"])
def test_ctrl_c_ends_a_jog_by_keys(key):
    motion = jog()
    motion.key("up", 0)
    motion.key(key, MS)
    assert (motion.ended, motion.command) == (JogEnd.REQUESTED, 0.0)


def test_the_speed_of_keys_stays_within_its_limit():
    motion = jog()
    for _ in range(50):
        motion.key("q", 0)
    motion.key("up", 0)
    assert motion.command == 2.0
    motion.key("z", 0)
    assert motion.command == pytest.approx(1.8)


def test_a_motion_for_a_time_begins_at_once_and_ends():
    motion = jog(value=-1.0, seconds=2.0)
    assert (motion.by_keys, motion.command, motion.next_deadline()) == (False, -1.0, 2000 * MS)
    motion.tick(1999 * MS)
    assert motion.command == -1.0
    motion.tick(2000 * MS)
    assert (motion.ended, motion.command) == (JogEnd.OVER, 0.0)


def test_any_key_ends_a_motion_that_was_not_held():
    motion = jog(seconds=2.0)
    motion.key("focus-in", 0)
    assert motion.ended is JogEnd.NONE
    motion.key("right", 0)
    assert (motion.ended, motion.command) == (JogEnd.REQUESTED, 0.0)


def test_a_position_is_from_where_the_drive_is_and_ends_there():
    motion = jog(JogKind.POSITION, 1.5)
    assert motion.command is None  # its position is not known yet
    at(motion, 100.0)
    assert (motion.command, motion.travelled) == (101.5, 0.0)
    at(motion, 101.49, velocity=1.0)
    assert motion.ended is JogEnd.NONE  # it is still moving
    at(motion, 101.499)
    assert motion.ended is JogEnd.THERE


def test_the_travel_limit_ends_a_motion_and_stops_a_key_in_its_direction_only():
    motion = jog(seconds=60.0)
    at(motion, 5.0)
    at(motion, 15.0)
    assert (motion.ended, motion.command) == (JogEnd.TRAVEL, 0.0)
    held = jog()
    at(held, 5.0)
    held.key("up", 0)
    at(held, 15.0)
    assert (held.ended, held.command) == (JogEnd.NONE, 0.0)
    assert "travel limit" in held.note
    held.key("down", 0)
    assert held.command == -1.0


@pytest.mark.parametrize(("current", "ended"), [(1000.0, JogEnd.NONE), (-1001.0, JogEnd.CURRENT), (None, JogEnd.NONE)])
def test_a_current_beyond_its_limit_ends_it_as_a_failure(current, ended):
    motion = jog(seconds=5.0)
    at(motion, 0.0, current=current)
    assert motion.ended is ended
    assert motion.ended.failed is (ended is JogEnd.CURRENT)


def test_a_drive_that_is_not_enabled_any_more_ends_it_and_the_first_reason_counts():
    motion = jog(seconds=5.0)
    at(motion, 0.0, enabled=False)
    motion.end(JogEnd.REQUESTED)
    assert (motion.ended, motion.ended.failed) == (JogEnd.STATE, True)


STEPS = st.one_of(
    st.tuples(st.just("key"), st.sampled_from(["up", "down", "left", "right", "q", "z", "space", "k", "other"])),
    st.tuples(st.just("wait"), st.integers(0, 800)),
    st.tuples(st.just("see"), st.floats(-20, 20)),
)


@given(st.lists(STEPS, max_size=40))
def test_a_command_is_bounded_and_comes_from_a_key_that_is_young(steps):
    motion, now, pressed = jog(), 0, -(10**12)
    for what, value in steps:
        if what == "key":
            motion.key(value, now)
            pressed = now if value in ("up", "down", "left", "right") else pressed
        elif what == "wait":
            now += value * MS
            motion.tick(now)
        else:
            at(motion, value)
        command = motion.command
        assert command is not None
        assert abs(command) <= LIMITS.speed
        if command:
            assert now - pressed <= 700 * MS
            assert not motion.travelled * math.copysign(1, command) >= LIMITS.travel


COUNT = 0.001


def test_a_shaft_that_turns_is_one():
    motion = jog(seconds=2.0)
    at(motion, 5.0)
    at(motion, 7.0)
    motion.tick(2000 * MS)
    assert motion.nothing_turned(COUNT) is None


@pytest.mark.parametrize(
    ("kind", "value", "seconds", "places"),
    [
        (JogKind.VELOCITY, 1.0, 2.0, (5.0, 5.0)),
        (JogKind.VELOCITY, 1.0, 2.0, (5.0, 5.03, 5.0)),  # within the play of what holds it
        (JogKind.TORQUE, 300.0, 2.0, (5.0, 5.002)),  # two counts
        (JogKind.POSITION, -2.0, 2.0, (5.0, 4.97)),
    ],
)
def test_a_shaft_that_stays_where_it_is_reported(kind, value, seconds, places):
    motion = jog(kind, value, seconds)
    for place in places:
        at(motion, place)
    motion.tick(2000 * MS)
    assert motion.nothing_turned(COUNT).startswith("the shaft did not turn although a motion was commanded")


def test_one_that_is_ended_early_is_not_judged_by_its_whole_time():
    motion = jog(seconds=100.0)
    at(motion, 5.0)
    at(motion, 5.5)
    motion.key("space", MS)
    assert motion.nothing_turned(COUNT) is None


def test_a_jog_by_keys_that_holds_none_reports_this():
    motion = jog()
    at(motion, 5.0)
    motion.key("ctrl-c", MS)
    assert motion.nothing_turned(COUNT) == "the shaft did not turn: no key was held"


def test_without_a_position_the_velocity_shows_it():
    motion = jog(seconds=1.0)
    assert "reports no position" in motion.nothing_turned(COUNT)
    at(motion, None, 0.5)
    assert motion.nothing_turned(COUNT) is None


def test_a_small_step_is_not_reached_before_it_was_made():
    motion = jog(JogKind.POSITION, 0.004)
    at(motion, 5.0)
    assert motion.ended is JogEnd.NONE
    at(motion, 5.004)
    assert motion.ended is JogEnd.THERE
    assert motion.nothing_turned(COUNT) is None


@pytest.mark.parametrize(
    ("kind", "velocity", "why", "least"),
    [
        (JogKind.VELOCITY, 2.0, JogEnd.TRAVEL, 4.9),
        (JogKind.VELOCITY, None, JogEnd.TRAVEL, 4.9),
        (JogKind.TORQUE, 2.0, JogEnd.TRAVEL, 4.9),
        (JogKind.TORQUE, math.nan, JogEnd.BLIND, 0.1),
    ],
)
def test_a_drive_without_a_position_is_limited_by_its_velocity_and_a_torque_needs_feedback(kind, velocity, why, least):
    motion, seconds = jog(kind, 2.0, seconds=60.0), 0.0
    while motion.ended is JogEnd.NONE and seconds < 10.0:
        seconds += 0.02
        motion.tick(round(seconds * 1e9))
        at(motion, None, velocity)
    assert motion.ended is why
    assert seconds == pytest.approx(least, abs=0.15)
    assert motion.command == 0.0
    assert math.isnan(motion.travelled)


@pytest.mark.parametrize("seconds", [None, 5.0])
def test_a_torque_does_not_accelerate_beyond_the_speed_limit(seconds):
    motion = jog(JogKind.TORQUE, 100.0, seconds=seconds)
    if seconds is None:
        motion.key("up", 0)
    for velocity, command in ((1.9, 100.0), (2.0, 0.0), (3.0, 0.0), (-3.0, 100.0), (1.0, 100.0)):
        at(motion, 0.0, velocity)
        assert motion.command == command, velocity
    assert motion.ended is JogEnd.NONE
