import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.controllers.trajectory.point import JointTrajectory, Point
from canopen_control.controllers.trajectory.validation import PackedPoints, survey_of
from canopen_control.errors import ControlError
from canopen_control.rpc.messages.samples import TrajectoryPoint

VALUES = st.lists(st.floats(-9.0, 9.0), max_size=3)
COMING = st.lists(
    st.builds(
        TrajectoryPoint,
        positions=VALUES,
        velocities=VALUES,
        accelerations=VALUES,
        effort=VALUES,
        time_from_start=st.floats(-10.0, 10.0),
    ),
    max_size=10,
)


def values(point: Point) -> object:
    return point.positions, point.velocities, point.accelerations, point.effort, point.time


@given(st.lists(COMING, max_size=4))
def test_every_point_is_as_it_came_whatever_pieces_it_came_in(pieces):
    packed = PackedPoints()
    for each in pieces:
        packed.add(each)
    came = [point for each in pieces for point in each]
    assert len(packed) == packed.survey.count == len(came)
    for index, each in enumerate(came):
        wanted = (each.positions, each.velocities, each.accelerations, each.effort, round(each.time_from_start * 1e9))
        assert values(packed[index]) == wanted
    if came:
        assert values(packed[-1]) == values(packed[len(came) - 1])
    assert [values(each) for each in packed] == [values(packed[index]) for index in range(len(came))]


def test_each_point_is_its_own():
    packed = PackedPoints()
    packed.add([TrajectoryPoint(positions=[1.0])])
    packed[0].positions[0] = 5.0
    assert packed[0].positions == [1.0]


@pytest.mark.parametrize("time", [float("nan"), float("inf"), -1e12])
def test_a_time_that_no_clock_holds_is_a_sentence_and_nothing_is_taken(time):
    packed = PackedPoints()
    packed.add([TrajectoryPoint(positions=[1.0])])
    with pytest.raises(ControlError, match="point 2 has a time_from_start of"):
        packed.add([TrajectoryPoint(positions=[1.0]), TrajectoryPoint(positions=[1.0], time_from_start=time)])
    assert len(packed) == packed.survey.count == 1


def test_a_trajectory_keeps_them_packed_and_their_survey():
    packed = PackedPoints()
    packed.add([TrajectoryPoint(positions=[1.0], time_from_start=1.0)])
    message = JointTrajectory(["a"], packed)
    assert message.points is packed
    assert survey_of(message) is packed.survey


@given(st.lists(COMING, max_size=4), st.data())
def test_positions_alone_are_those_of_the_points(pieces, data):
    packed = PackedPoints()
    for each in pieces:
        packed.add(each)
    end = data.draw(st.integers(0, len(packed)))
    begin = data.draw(st.integers(0, end))
    found = [list(each) for each in packed.positions(begin, end)]
    assert found == [packed[index].positions for index in range(begin, end)]
