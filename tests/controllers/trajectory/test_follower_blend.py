import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.controllers.trajectory.followed import Trajectory
from canopen_control.controllers.trajectory.follower import MOST_WAITING, Blend
from canopen_control.controllers.trajectory.point import JointTrajectory, Point

S, MS = 1_000_000_000, 1_000_000
WRAP = [False, False]


def line(*points, start=10.0):
    """Return a trajectory of two joints through (time in s, position, position), from 0 at rest at 10 s."""
    made = Trajectory(JointTrajectory(["a", "b"], [Point([p, q], time=round(t * S)) for t, p, q in points]))
    made.start = round(start * S)
    return made


def running(*points):
    made = line(*points)
    made.begin(10 * S)
    made.set_before(10 * S, Point([0.0, 0.0]), WRAP)
    made.sample(10 * S, Point())
    return made


def at(motion, t):
    out = Point()
    assert motion.sample(round(t * S), out)
    return out.positions


def blended(new, handoff, joints=(0, 1), old=None):
    blend = Blend(running((4.0, 4.0, 8.0)) if old is None else old, WRAP)
    blend.take(new, round(handoff * S), joints)
    return blend


def test_until_the_start_of_the_new_one_the_old_one_is_followed_and_from_there_the_new_one():
    blend = blended(line((1.0, 0.0, 0.0), start=12.0), 12.0)
    assert at(blend, 11.0) == [1.0, 2.0]
    assert at(blend, 12.0) == pytest.approx([2.0, 4.0])
    assert at(blend, 12.5) == pytest.approx([1.0, 2.0])
    assert at(blend, 13.0) == [0.0, 0.0]
    assert blend.is_over
    assert blend.end_point().positions == [0.0, 0.0]


def test_joints_that_are_not_named_follow_the_old_one_to_its_end():
    blend = blended(line((1.0, 0.0, 9.0), start=12.0), 12.0, [0])
    assert at(blend, 12.5) == pytest.approx([1.0, 5.0])
    assert at(blend, 13.5) == [0.0, 7.0]
    assert not blend.is_over
    assert at(blend, 14.0) == [0.0, 8.0]
    assert blend.is_over
    assert blend.start + blend.time_of(0) == 14 * S


def test_the_new_one_begins_with_the_velocity_of_the_old_one():
    new = Trajectory(JointTrajectory(["a", "b"], [Point([3.0, 6.0], [0.0, 0.0], time=S)]))
    new.start = 12 * S
    blend, out, before = blended(new, 12.0), Point(), Point()
    blend.sample(12 * S - 1, before)
    blend.sample(12 * S, out)
    assert before.velocities == pytest.approx([1.0, 2.0])
    assert out.velocities == pytest.approx([1.0, 2.0])


def test_what_was_to_begin_later_is_dropped_by_what_begins_before():
    blend = blended(line((1.0, 5.0, 5.0), start=13.0), 13.0)
    blend.take(line((1.0, 0.0, 0.0), start=12.0), 12 * S, (0, 1))
    assert at(blend, 13.5) == [0.0, 0.0]


def test_those_that_wait_are_bounded():
    blend = Blend(running((100.0, 1.0, 1.0)), WRAP)
    for index in range(50):
        blend.take(line((1.0, index, index), start=20.0 + index), (20 + index) * S, (0, 1))
    assert len(blend._waiting) == MOST_WAITING
    assert at(blend, 99.0)[0] == 49.0


def test_a_blend_goes_on_in_the_next_one_and_nothing_that_is_done_is_kept():
    motion = running((100.0, 1.0, 1.0))
    for index in range(100):
        motion = blended(line((0.5, index, 0.0), start=11.0 + index), 11.0 + index, [index % 2], motion)
        at(motion, 11.4 + index)
    assert len(motion._tracks) <= 2


def test_a_question_changes_nothing():
    blend, out = blended(line((1.0, 0.0, 0.0), start=12.0), 12.0), Point()
    assert blend.query(13 * S, out)
    assert out.positions == [0.0, 0.0]
    assert blend.query(round(11.5 * S), out)
    assert out.positions == [1.5, 3.0]
    assert at(blend, 11.0) == [1.0, 2.0]


TIMES = st.lists(st.floats(0.05, 2.0), min_size=1, max_size=4)


@given(
    TIMES,
    st.lists(st.floats(-1.0, 1.0), min_size=8, max_size=8),
    st.floats(10.0, 14.0),
    st.sampled_from([[0], [1], [0, 1]]),
)
def test_positions_never_jump_wherever_it_takes_over(times, places, handoff, joints):
    points, time = [], 0.0
    for index, each in enumerate(times):
        time += each
        points.append((time, places[index], places[-1 - index]))
    handoff = round(handoff, 3)
    blend, before = blended(line(*points, start=handoff), handoff, joints), [0.0, 0.0]
    for step in range(1, 650):
        now = at(blend, 10.0 + step * 0.02)
        assert max(abs(a - b) for a, b in zip(now, before, strict=True)) < 10.0 / 0.05 * 0.02 + 1e-9
        before = now
    for joint in range(2):
        assert before[joint] == pytest.approx(points[-1][1 + joint] if joint in joints else [4.0, 8.0][joint])
