import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.cli.trajectory import STILL, TrajectoryRecording
from canopen_control.errors import CanopenError


def recorded(*samples, most=1000):
    recording = TrajectoryRecording(["a"], most)
    for time, position in samples:
        recording.add(time, [position])
    return recording


def test_it_begins_when_a_joint_begins_to_move_and_ends_when_it_rests():
    points = recorded(
        (10.0, 0.0), (10.1, 0.0), (10.2, 0.0), (10.3, 0.1), (10.4, 0.2), (10.5, 0.2), (10.6, 0.2)
    ).points()
    assert [point.time_from_start for point in points] == pytest.approx([0.0, 0.1, 0.2])
    assert [point.positions[0] for point in points] == [0.0, 0.1, 0.2]


def test_velocities_are_those_of_the_neighbours_and_it_rests_at_both_ends():
    points = recorded((0.0, 0.0), (0.1, 0.1), (0.3, 0.4), (0.4, 0.5)).points()
    assert [point.velocities[0] for point in points] == pytest.approx([0.0, 0.4 / 0.3, 0.4 / 0.3, 0.0], abs=1e-6)


def test_jitter_of_close_samples_makes_no_jumps_of_the_velocity():
    observed = [(0.01 * index + 0.008 * (index % 2), 0.01 * index) for index in range(100)]
    velocities = [point.velocities[0] for point in recorded(*observed).points()][8:-8]
    assert all(0.8 < velocity < 1.2 for velocity in velocities)


def test_a_pause_on_the_way_is_kept():
    points = recorded((0.0, 0.0), (0.1, 0.1), (0.2, 0.1), (0.3, 0.1), (0.4, 0.2)).points()
    assert [point.positions[0] for point in points] == [0.0, 0.1, 0.1, 0.1, 0.2]


@pytest.mark.parametrize(
    "samples", [[], [(0.0, 1.0)], [(0.1 * index, 1.0 + 0.4 * STILL * (index % 2)) for index in range(9)]]
)
def test_without_a_motion_there_is_nothing_to_play(samples):
    with pytest.raises(CanopenError, match="no joint moved"):
        recorded(*samples).points()


def test_it_is_full_at_as_many_points_as_a_trajectory_may_have():
    assert recorded((0.0, 0.0), (0.1, 1.0), most=2).is_full
    assert not recorded((0.0, 0.0), most=2).is_full


@pytest.mark.rest
@given(st.lists(st.tuples(st.floats(-1.0, 5.0), st.floats(-3.0, 3.0)), max_size=30))
def test_what_is_recorded_can_be_played_whatever_came(samples):
    recording = recorded(*samples)
    try:
        points = recording.points()
    except CanopenError:
        assert all(abs(position - samples[0][1]) < 10.0 for _, position in samples)
        return
    times = [point.time_from_start for point in points]
    assert times[0] == 0.0
    assert all(a < b or b - a < 1e-6 for a, b in itertools.pairwise(times))
    assert points[0].velocities == points[-1].velocities == [0.0]
    assert {point.positions[0] for point in points} <= {round(position, 6) for _, position in samples}
