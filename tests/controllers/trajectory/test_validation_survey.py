import itertools
import math

from hypothesis import given
from hypothesis import strategies as st

from canopen_control.controllers.trajectory.point import JointTrajectory, Point
from canopen_control.controllers.trajectory.validation import NONE, Rule, Rules, Survey, broken_rule

JOINTS = ("a", "b")
NUMBERS = st.one_of(st.floats(-5.0, 5.0), st.sampled_from([math.nan, math.inf, -math.inf]))
VECTORS = st.one_of(st.just([]), st.lists(NUMBERS, min_size=2, max_size=2), st.lists(NUMBERS, max_size=3))
POINTS = st.lists(
    st.builds(Point, VECTORS, VECTORS, VECTORS, VECTORS, time=st.integers(-2, 12)), min_size=1, max_size=12
)


def survey(*pieces: list[Point]) -> Survey:
    made = Survey()
    for piece in pieces:
        made.add(piece, [each.time for each in piece])
    return made


def split(points: list[Point], cuts: list[int]) -> list[list[Point]]:
    at = sorted({0, len(points), *(each % (len(points) + 1) for each in cuts)})
    return [points[a:b] for a, b in itertools.pairwise(at)]


def told(found: Survey) -> object:
    return found.count, found.not_increasing, found.empty, found.infinite, found.sizes


WAYS = st.lists(st.tuples(st.integers(1, 10**9), st.floats(-9.0, 9.0), st.floats(-9.0, 9.0)), min_size=1, max_size=12)


@given(WAYS, st.lists(st.integers(0, 20), max_size=4))
def test_the_mean_velocities_between_points_are_those_of_the_whole_however_it_came(ways, cuts):
    times = list(itertools.accumulate(gap for gap, _, _ in ways))
    points = [Point([a, b], time=time) for time, (_, a, b) in zip(times, ways, strict=True)]
    means = survey(*split(points, cuts)).means
    pairs = list(itertools.pairwise(points))
    for joint in range(2 if pairs else 0):
        found = [(q.positions[joint] - p.positions[joint]) / ((q.time - p.time) * 1e-9) for p, q in pairs]
        assert math.isclose(means.lowest[joint], min(found), rel_tol=1e-6, abs_tol=1e-6)
        assert math.isclose(means.highest[joint], max(found), rel_tol=1e-6, abs_tol=1e-6)
    assert [at for each in means.ranges for at in range(each.begin, each.end)] == list(range(1, len(points)))


@given(POINTS, st.lists(st.integers(0, 20), max_size=4))
def test_pieces_come_to_the_same_as_the_whole(points, cuts):
    assert told(survey(*split(points, cuts))) == told(survey(points))


@given(POINTS, st.lists(st.integers(0, 20), max_size=4))
def test_it_tells_the_first_point_of_each_kind(points, cuts):
    found = survey(*split(points, cuts))

    def first(wrong):
        return next((index for index, each in enumerate(points) if wrong(index, each)), NONE)

    assert found.not_increasing == first(lambda index, each: index and each.time <= points[index - 1].time)
    assert found.empty == first(lambda _, each: not (each.positions or each.velocities or each.accelerations))
    values = lambda each: (*each.positions, *each.velocities, *each.accelerations, *each.effort)  # noqa: E731
    assert found.infinite == first(lambda _, each: not all(map(math.isfinite, values(each))))
    assert found.sized(0, (2,)) == first(lambda _, each: len(each.positions) != 2)


@given(st.lists(st.lists(st.floats(-9.0, 9.0), min_size=2, max_size=2), min_size=1, max_size=12), st.integers(1, 4))
def test_extremes_are_those_of_all_pieces_and_each_piece_says_where_its_own_are(positions, size):
    points = [Point(each, time=index) for index, each in enumerate(positions)]
    extremes = survey(*(points[at : at + size] for at in range(0, len(points), size))).positions
    for joint in range(2):
        assert extremes.lowest[joint] == min(each[joint] for each in positions)
        assert extremes.highest[joint] == max(each[joint] for each in positions)
        for each in extremes.ranges:
            column = [position[joint] for position in positions[each.begin : each.end]]
            assert (each.lowest[joint], each.highest[joint]) == (min(column), max(column))


def naive(message: JointTrajectory, rules: Rules) -> Rule | None:
    """Upstream's rules of points as they are written down: one point after the other."""
    for index, each in enumerate(message.points):
        if index and each.time <= message.points[index - 1].time:
            return Rule.TIME_NOT_INCREASING
        sizes = [len(each.positions), len(each.velocities), len(each.accelerations)]
        if rules.integration and not any(sizes):
            return Rule.POINT_EMPTY
        if sizes[0] != 2 and (sizes[0] or not rules.integration):
            return Rule.SIZE_POSITIONS
        if sizes[1] not in (0, 2):
            return Rule.SIZE_VELOCITIES
        if sizes[2] not in (0, 2):
            return Rule.SIZE_ACCELERATIONS
        if each.effort and not rules.effort:
            return Rule.EFFORT_NOT_SUPPORTED
    return None


@given(POINTS, st.lists(st.integers(0, 20), max_size=4), st.booleans(), st.booleans())
def test_the_first_broken_rule_is_the_one_that_a_walk_through_all_points_finds(points, cuts, integration, effort):
    rules = Rules(JOINTS, False, True, integration, effort)
    message = JointTrajectory(JOINTS, points)
    refused = broken_rule(message, survey(*split(points, cuts)), rules, 0)
    assert (None if refused is None else refused.rule) == naive(message, rules)
