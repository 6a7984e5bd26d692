import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.calibration.umbmark import Direction, Pace, SquarePath
from canopen_control.errors import ControlError

DT = 0.02


class Base:
    """A base that follows its commands a cycle later, up to an acceleration, and its odometry."""

    def __init__(self, x=0.0, y=0.0, heading=0.0, deaf=False):
        self.x, self.y, self.heading = x, y, heading
        self.linear = self.angular = 0.0
        self.deaf = deaf

    @property
    def pose(self):
        return self.x, self.y, self.heading

    def step(self, linear, angular):
        if self.deaf:
            return
        self.linear += max(-0.02, min(0.02, linear - self.linear))
        self.angular += max(-0.04, min(0.04, angular - self.angular))
        middle = self.heading + self.angular * DT / 2
        self.x += self.linear * DT * math.cos(middle)
        self.y += self.linear * DT * math.sin(middle)
        self.heading += self.angular * DT


def drive(path, base, seconds=300.0):
    """Let it drive to the end; returns every pose on the way."""
    now, way = 5.0, []
    while not path.done:
        base.step(*path.twist(base.pose, now))
        way.append(base.pose)
        now += DT
        assert now < seconds
    return way


@pytest.mark.parametrize("direction", Direction)
def test_it_ends_where_it_began_after_four_corners(direction):
    path, base = SquarePath(1.0, direction, Pace()), Base()
    way = drive(path, base)
    assert path.corner == 4
    assert (base.x, base.y) == pytest.approx((0.0, 0.0), abs=0.01)
    assert base.heading == pytest.approx(direction.value * math.tau, abs=0.01)
    corner = max(way, key=lambda pose: pose[0] + direction.value * pose[1])
    assert corner[:2] == pytest.approx((1.0, direction.value), abs=0.01)


def test_both_directions_mirror_exactly():
    ccw, cw = (drive(SquarePath(0.7, item, Pace()), Base()) for item in (Direction.CCW, Direction.CW))
    assert [(x, -y, -heading) for x, y, heading in ccw] == cw


@pytest.mark.rest
@given(
    start=st.tuples(st.floats(-5, 5), st.floats(-5, 5), st.floats(-7, 7)),
    side=st.floats(0.3, 1.5),
    direction=st.sampled_from(Direction),
)
def test_it_begins_wherever_the_base_is(start, side, direction):
    base = Base(*start)
    drive(SquarePath(side, direction, Pace(0.4, 1.0, 0.4, 1.0, 0.1)), base)
    assert (base.x, base.y) == pytest.approx(start[:2], abs=0.02), start


def test_it_keeps_to_its_speeds():
    path, base = SquarePath(1.0, Direction.CW, Pace(speed=0.3, turn=0.5)), Base()
    fastest = [0.0, 0.0]
    now = 0.0
    while not path.done:
        linear, angular = path.twist(base.pose, now)
        fastest = [max(fastest[0], abs(linear)), max(fastest[1], abs(angular))]
        base.step(linear, angular)
        now += DT
    assert fastest == [0.3, 0.5]


def test_a_side_that_is_begun_askew_is_steered_back():
    path = SquarePath(1.0, Direction.CCW, Pace())
    path.twist((0.0, 0.0, 0.0), 0.0)
    assert path.twist((0.1, 0.0, 0.05), 0.5)[1] < 0.0
    assert path.twist((0.1, 0.02, 0.0), 0.5)[1] < 0.0
    assert path.twist((0.1, -0.02, 0.0), 0.5)[1] > 0.0


def test_a_base_that_does_not_move_is_reported():
    path, base = SquarePath(1.0, Direction.CCW, Pace()), Base(deaf=True)
    with pytest.raises(ControlError, match=r"does not move as it is commanded: .* s at side 1 of the square"):
        drive(path, base)


def test_a_base_that_does_not_come_to_rest_is_reported():
    path = SquarePath(1.0, Direction.CCW, Pace())
    path.twist((0.0, 0.0, 0.0), 0.0)
    path.twist((1.0, 0.0, 0.0), 5.0)
    for tenth in range(60):
        path.twist((1.0 + 0.001 * tenth, 0.0, 0.0), 5.0 + 0.1 * tenth)
    with pytest.raises(ControlError, match="does not come to rest"):
        path.twist((1.07, 0.0, 0.0), 12.0)


def test_an_encoder_that_changes_by_a_count_at_rest_does_not_keep_it():
    path = SquarePath(1.0, Direction.CCW, Pace())
    path.twist((0.0, 0.0, 0.0), 0.0)
    path.twist((1.0, 0.0, 0.0), 5.0)
    twists = [path.twist((1.0, 0.0001 * (tenth % 2), 0.001 * (tenth % 2)), 5.1 + 0.1 * tenth) for tenth in range(8)]
    assert twists[-1][1] > 0.0, "it turns"


@pytest.mark.parametrize("pose", [(1.5, 0.0, 0.0), (0.5, -0.4, 0.0), (math.nan, 0.0, 0.0)])
def test_a_base_that_is_somewhere_else_is_reported(pose):
    path = SquarePath(1.0, Direction.CCW, Pace())
    path.twist((0.0, 0.0, 0.0), 0.0)
    with pytest.raises(ControlError, match="has left the square of 1 m"):
        path.twist(pose, 0.1)
