import math

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from canopen_control.calibration.umbmark import (
    Correction,
    Direction,
    ImplausibleEnds,
    SquareRun,
    WheelFactors,
    correction,
    relative,
)

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
