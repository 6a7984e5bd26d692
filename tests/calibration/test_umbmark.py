import math

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from canopen_control.calibration.umbmark import (
    Correction,
    Direction,
    ImplausibleEnds,
    Pace,
    SquarePath,
    SquareRun,
    WheelFactors,
    correction,
    relative,
)
from canopen_control.errors import ControlError

CCW, CW = Direction.CCW, Direction.CW


def square(direction, side, separation, left=1.0, right=1.0, track=1.0):
    """A base that believes to drive an exact square; its wheels and track are so many times what it believes."""
    x = y = heading = 0.0
    for _ in range(4):
        for way_left, way_right in ((side, side), turn(direction, separation)):
            way = (way_left * left + way_right * right) / 2
            angle = (way_right * right - way_left * left) / (separation * track)
            chord = way * (math.sin(angle / 2) / (angle / 2) if angle else 1.0)
            x += chord * math.cos(heading + angle / 2)
            y += chord * math.sin(heading + angle / 2)
            heading += angle
    return SquareRun(direction, x, y)


def turn(direction, separation):
    way = direction.value * math.pi / 4 * separation
    return -way, way


def both(side, separation, **true):
    return [square(item, side, separation, **true) for item in Direction]


def passes(count, side, separation, left, right, track):
    """Yield what each pass finds, the values of the one before in use."""
    known = WheelFactors()
    for _ in range(count):
        result = correction(
            both(
                side,
                separation * known.separation,
                left=left / known.left,
                right=right / known.right,
                track=track / known.separation,
            ),
            side,
            separation * known.separation,
        )
        yield result, known
        known = result.factors.after(known)


@pytest.mark.parametrize("unequal", [1.005, 1 / 1.005])
@pytest.mark.parametrize("track", [1.02, 0.98])
@pytest.mark.parametrize(("side", "separation"), [(4.0, 0.5), (4.0, 0.24), (1.0, 0.24)])
def test_the_largest_error_falls_a_hundredfold_in_two_passes(side, separation, unequal, track):
    (before, _), _, (after, _) = passes(3, side, separation, 1.0, unequal, track)
    assert before.largest > 0.1
    assert before.largest / after.largest > 1000


@given(unequal=st.floats(0.99, 1.01), track=st.floats(0.95, 1.05), side=st.floats(1.0, 4.0))
@example(unequal=0.99, track=1.05, side=4.0)  # it ends 2.07 m off, which is more than half of the side
@example(unequal=1.01, track=1.05, side=4.0)
@example(unequal=0.99, track=0.95, side=4.0)
def test_an_invented_robot_is_recovered(unequal, track, side):
    left, right = 2 / (1 + unequal), 2 * unequal / (1 + unequal)  # their mean is one
    known = [known for _, known in passes(5, side, 0.4, left, right, track)][-1]
    assert known.right / known.left == pytest.approx(unequal, rel=1e-6)
    mean = (known.left + known.right) / 2  # a scale of distances that does not affect squares
    assert known.separation / mean == pytest.approx(track, rel=1e-6)
    assert mean == pytest.approx(1.0, abs=1e-4)


@pytest.mark.parametrize("unequal", [0.99, 1.01])
@pytest.mark.parametrize("track", [0.9, 1.1])
def test_the_worst_base_that_is_put_together_is_taken_and_recovered(unequal, track):
    """0.24 m wide, on squares of 4 m: its ends are up to 0.93 of the side away."""
    left, right = 2 / (1 + unequal), 2 * unequal / (1 + unequal)
    assert max(math.hypot(run.x, run.y) for run in both(4.0, 0.24, left=left, right=right, track=track)) > 3.1
    known = [known for _, known in passes(6, 4.0, 0.24, left, right, track)][-1]
    assert known.right / known.left == pytest.approx(unequal, rel=1e-5)
    assert known.separation / ((known.left + known.right) / 2) == pytest.approx(track, rel=1e-5)


@given(way=st.floats(0.9, 1.1), side=st.floats(0.5, 4.0), separation=st.floats(0.1, 0.5))
def test_a_robot_that_is_only_larger_has_the_factors_of_one_that_is_not(way, side, separation):
    result = correction(both(side, separation, left=way, right=way, track=way), side, separation)
    assert result.e_d == pytest.approx(1.0, abs=1e-9)
    assert result.e_b == pytest.approx(1.0, abs=1e-9)


def test_the_example_of_the_method_gives_its_figures():
    ends = [SquareRun(CCW, 0.004, -0.004), SquareRun(CW, -0.453, -0.564)]
    result = correction(ends, 4.0, 0.5)
    assert (result.e_b, result.e_d) == pytest.approx((1.0205, 1.00401), abs=5e-5)
    assert result.largest == pytest.approx(math.hypot(0.453, 0.564))
    assert result.factors.left == pytest.approx(2 / (result.e_d + 1))
    assert result.factors.right / result.factors.left == pytest.approx(result.e_d)


def test_squares_of_an_ideal_robot_mirror_exactly():
    ccw, cw = both(1.0, 0.24)
    assert (ccw.x, ccw.y) == (cw.x, -cw.y)
    assert math.hypot(ccw.x, ccw.y) < 1e-12


@given(x=st.floats(-0.1, 0.1), y=st.floats(-0.1, 0.1))
def test_ends_that_mirror_are_a_wrong_track_alone_and_ends_turned_by_half_unequal_wheels_alone(x, y):
    assert correction([SquareRun(CCW, x, y), SquareRun(CW, x, -y)], 1.0, 0.3).e_d == 1.0
    assert correction([SquareRun(CCW, x, y), SquareRun(CW, -x, y)], 1.0, 0.3).e_b == 1.0


def test_the_scatter_is_that_of_the_runs_about_their_means():
    runs = [SquareRun(CCW, 0.01, 0.0), SquareRun(CCW, 0.03, 0.0), SquareRun(CW, 0.0, 0.02), SquareRun(CW, 0.0, 0.02)]
    result = correction(runs, 1.0, 0.3)
    assert result.scatter == pytest.approx(3 * math.sqrt(2 * 0.01**2 / 2))
    assert result.largest == pytest.approx(0.02)
    assert correction(runs[1:3], 1.0, 0.3).scatter is None


GOOD = [SquareRun(CCW, 0.01, 0.02), SquareRun(CW, 0.01, -0.02)]


@pytest.mark.parametrize(
    ("runs", "side", "separation", "least", "words"),
    [
        (GOOD, math.nan, 0.3, 1, "the side of the square is nan m"),
        (GOOD, 1.0, 0.0, 1, "the wheel separation is 0 m"),
        (GOOD, 0.2, 0.3, 1, "drive a larger square"),
        ([GOOD[0], SquareRun(CW, math.nan, 0.0)], 1.0, 0.3, 1, r"run 2 \(clockwise\) ended at nan, 0.0"),
        ([GOOD[0], SquareRun(CW, 0.0, math.inf)], 1.0, 0.3, 1, "which is not a position"),
        ([SquareRun(CCW, 12.0, 4.0), GOOD[1]], 1.0, 0.3, 1, r"run 1 \(counter-clockwise\) ended 12.65 m from"),
        (
            [SquareRun(CCW, 0.8, 0.7), GOOD[1]],
            1.0,
            0.3,
            1,
            "ended 1.06 m from .* more than the side of 1 m; were metres",
        ),
        (GOOD[:1], 1.0, 0.3, 1, "no run is clockwise"),
        (GOOD[1:], 1.0, 0.3, 1, "no run is counter-clockwise"),
        ([], 1.0, 0.3, 1, "no run is"),
        (GOOD, 1.0, 0.3, 3, "1 run is counter-clockwise; 3 of each direction"),
        ([*GOOD, *GOOD], 1.0, 0.3, 3, "2 runs are counter-clockwise; 3 of each direction"),
    ],
)
def test_what_cannot_be_is_refused_in_a_sentence(runs, side, separation, least, words):
    with pytest.raises(ImplausibleEnds, match=words):
        correction(runs, side, separation, least)


@given(
    ends=st.lists(st.tuples(st.sampled_from(Direction), st.floats(), st.floats()), max_size=6),
    side=st.floats(),
    separation=st.floats(),
)
def test_whatever_is_measured_gives_finite_factors_or_a_refusal(ends, side, separation):
    try:
        result = correction([SquareRun(*end) for end in ends], side, separation)
    except ImplausibleEnds:
        return
    factors = result.factors
    assert all(0.5 < item < 2.0 for item in (factors.left, factors.right, factors.separation))


@given(*[st.tuples(*[st.floats(-3, 3)] * 3)] * 2)
def test_a_pose_seen_from_another_one_is_where_it_was(start, way):
    cosine, sine = math.cos(start[2]), math.sin(start[2])
    end = start[0] + cosine * way[0] - sine * way[1], start[1] + sine * way[0] + cosine * way[1], start[2] + way[2]
    assert relative(end, start) == pytest.approx(way, abs=1e-9)


def test_factors_continue_top_of_those_in_use():
    assert WheelFactors(1.1, 1.0, 2.0).after(WheelFactors(2.0, 0.5, 3.0)) == WheelFactors(2.2, 0.5, 6.0)
    assert Correction(1.0, 1.0, 0.0, None).factors == WheelFactors()


# -- square path


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
