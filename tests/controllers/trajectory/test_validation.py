import itertools
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.trajectories import cases, message

from canopen_control.controllers.params import Params
from canopen_control.controllers.trajectory.params import TrajectoryParams, read_params
from canopen_control.controllers.trajectory.point import JointTrajectory, Point
from canopen_control.controllers.trajectory.validation import (
    NONE,
    JointLimits,
    PointBuffer,
    Rule,
    TrajectorySummary,
    broken_rule,
    far_start,
    limit_error,
    lost_start,
    survey_of,
    unreachable,
)
from canopen_control.errors import ControlError
from canopen_control.rpc.messages.samples import TrajectoryPoint

JOINTS = ("a", "b")
NUMBERS = st.one_of(st.floats(-5.0, 5.0), st.sampled_from([math.nan, math.inf, -math.inf]))
VECTORS = st.one_of(st.just([]), st.lists(NUMBERS, min_size=2, max_size=2), st.lists(NUMBERS, max_size=3))
POINTS = st.lists(
    st.builds(Point, VECTORS, VECTORS, VECTORS, VECTORS, time=st.integers(-2, 12)), min_size=1, max_size=12
)


def survey(*pieces: list[Point]) -> TrajectorySummary:
    trajectory_summary = TrajectorySummary()
    for piece in pieces:
        trajectory_summary.add(piece, [item.time for item in piece])
    return trajectory_summary


def split(points: list[Point], cuts: list[int]) -> list[list[Point]]:
    at = sorted({0, len(points), *(cut % (len(points) + 1) for cut in cuts)})
    return [points[a:b] for a, b in itertools.pairwise(at)]


def collected(found: TrajectorySummary) -> object:
    return found.count, found.not_increasing, found.empty, found.infinite, found.sizes


WAYS = st.lists(st.tuples(st.integers(1, 10**9), st.floats(-9.0, 9.0), st.floats(-9.0, 9.0)), min_size=1, max_size=12)


@given(WAYS, st.lists(st.integers(0, 20), max_size=4))
def test_the_mean_velocities_between_points_are_those_of_the_whole_however_it_came(ways, cuts):
    times = list(itertools.accumulate(gap for gap, _, _ in ways))
    points = [Point([a, b], time=time) for time, (_, a, b) in zip(times, ways, strict=True)]
    means = survey(*split(points, cuts)).means
    pairs = list(itertools.pairwise(points))
    for joint in range(2 if pairs else 0):
        result = [(q.positions[joint] - p.positions[joint]) / ((q.time - p.time) * 1e-9) for p, q in pairs]
        assert math.isclose(means.lowest[joint], min(result), rel_tol=1e-6, abs_tol=1e-6)
        assert math.isclose(means.highest[joint], max(result), rel_tol=1e-6, abs_tol=1e-6)
    assert [at for item in means.ranges for at in range(item.begin, item.end)] == list(range(1, len(points)))


@given(POINTS, st.lists(st.integers(0, 20), max_size=4))
def test_pieces_come_to_the_same_as_the_whole(points, cuts):
    assert collected(survey(*split(points, cuts))) == collected(survey(points))


@given(POINTS, st.lists(st.integers(0, 20), max_size=4))
def test_it_reports_the_first_point_of_each_kind(points, cuts):
    result = survey(*split(points, cuts))

    def first(wrong):
        return next((index for index, each in enumerate(points) if wrong(index, each)), NONE)

    assert result.not_increasing == first(lambda index, each: index and each.time <= points[index - 1].time)
    assert result.empty == first(lambda _, each: not (each.positions or each.velocities or each.accelerations))
    values = lambda each: (*each.positions, *each.velocities, *each.accelerations, *each.effort)  # noqa: E731
    assert result.infinite == first(lambda _, each: not all(map(math.isfinite, values(each))))
    assert result.sized(0, (2,)) == first(lambda _, each: len(each.positions) != 2)


@given(st.lists(st.lists(st.floats(-9.0, 9.0), min_size=2, max_size=2), min_size=1, max_size=12), st.integers(1, 4))
def test_extremes_are_those_of_all_pieces_and_each_piece_reports_where_its_own_are(positions, size):
    points = [Point(item, time=index) for index, item in enumerate(positions)]
    extremes = survey(*(points[at : at + size] for at in range(0, len(points), size))).positions
    for joint in range(2):
        assert extremes.lowest[joint] == min(item[joint] for item in positions)
        assert extremes.highest[joint] == max(item[joint] for item in positions)
        for item in extremes.ranges:
            column = [position[joint] for position in positions[item.begin : item.end]]
            assert (item.lowest[joint], item.highest[joint]) == (min(column), max(column))


def naive(message: JointTrajectory, *, integration: bool, effort: bool) -> Rule | None:
    """Upstream's rules of points as they are written down: one point after the other."""
    for index, each in enumerate(message.points):
        if index and each.time <= message.points[index - 1].time:
            return Rule.TIME_NOT_INCREASING
        sizes = [len(each.positions), len(each.velocities), len(each.accelerations)]
        if integration and not any(sizes):
            return Rule.POINT_EMPTY
        if sizes[0] != 2 and (sizes[0] or not integration):
            return Rule.SIZE_POSITIONS
        if sizes[1] not in (0, 2):
            return Rule.SIZE_VELOCITIES
        if sizes[2] not in (0, 2):
            return Rule.SIZE_ACCELERATIONS
        if each.effort and not effort:
            return Rule.EFFORT_NOT_SUPPORTED
    return None


@given(POINTS, st.lists(st.integers(0, 20), max_size=4), st.booleans(), st.booleans())
def test_the_first_broken_rule_is_the_one_that_a_walk_through_all_points_finds(points, cuts, integration, effort):
    params = TrajectoryParams(
        joints=JOINTS, allow_nonzero_velocity_at_trajectory_end=True, allow_integration_in_goal_trajectories=integration
    )
    message = JointTrajectory(JOINTS, points)
    refused = broken_rule(message, survey(*split(points, cuts)), params, 0, effort=effort)
    assert (None if refused is None else refused.rule) == naive(message, integration=integration, effort=effort)


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
    packed = PointBuffer()
    for piece in pieces:
        packed.add(piece)
    came = [point for piece in pieces for point in piece]
    assert len(packed) == packed.survey.count == len(came)
    for index, piece in enumerate(came):
        expected = (
            piece.positions,
            piece.velocities,
            piece.accelerations,
            piece.effort,
            round(piece.time_from_start * 1e9),
        )
        assert values(packed[index]) == expected
    if came:
        assert values(packed[-1]) == values(packed[len(came) - 1])
    assert [values(item) for item in packed] == [values(packed[index]) for index in range(len(came))]


@pytest.mark.parametrize("time", [float("nan"), float("inf"), -1e12])
def test_a_time_that_no_clock_holds_is_a_sentence_and_nothing_is_taken(time):
    packed = PointBuffer()
    packed.add([TrajectoryPoint(positions=[1.0])])
    with pytest.raises(ControlError, match="point 2 has a time_from_start of"):
        packed.add([TrajectoryPoint(positions=[1.0]), TrajectoryPoint(positions=[1.0], time_from_start=time)])
    assert len(packed) == packed.survey.count == 1


def test_a_trajectory_keeps_them_packed_and_their_survey():
    packed = PointBuffer()
    packed.add([TrajectoryPoint(positions=[1.0], time_from_start=1.0)])
    message = JointTrajectory(["a"], packed)
    assert message.points is packed
    assert survey_of(message) is packed.survey


@given(st.lists(COMING, max_size=4), st.data())
def test_positions_alone_are_those_of_the_points(pieces, data):
    packed = PointBuffer()
    for piece in pieces:
        packed.add(piece)
    end = data.draw(st.integers(0, len(packed)))
    begin = data.draw(st.integers(0, end))
    result = [list(position) for position in packed.positions(begin, end)]
    assert result == [packed[index].positions for index in range(begin, end)]


S = 1_000_000_000
LIMITS = {"a": JointLimits(-1.0, 1.0, 2.0), "b": JointLimits(continuous=True)}


@pytest.mark.parametrize("case", cases("jtc_validate_trajectory"), ids=lambda case: case["name"])
def test_the_first_rule_that_is_broken_is_upstreams(case):
    inputs = case["in"]
    params = read_params(Params.of(inputs["params"]), "arm")
    created = message(inputs["trajectory"])
    effort = "effort" in params.command_interfaces
    refused = broken_rule(created, survey_of(created), params, inputs["now_ns"], effort=effort)
    assert (refused is None) is case["expect"]["accept"]
    if refused is not None:
        assert refused.rule.name == case["expect"]["reason"]
        assert ";" in refused.text or "did you mean" in refused.text or "there" in refused.text, refused.text


def to(*positions: float, time: float = 1.0, **more: list[float]) -> JointTrajectory:
    return JointTrajectory(["a", "b"][: len(positions)], [Point(positions, time=round(time * S), **more)])


@pytest.mark.parametrize(
    ("inputs", "text"),
    [
        (to(math.nan, 0.0), "point 0: the position of a is nan; give finite numbers"),
        (to(0.0, math.inf), "point 0: the position of b is inf"),
        (to(0.0, 0.0, velocities=[0.0, math.nan]), "the velocity of b is nan"),
        (to(0.0, 0.0, accelerations=[math.nan, 0.0]), "the acceleration of a is nan"),
        (to(0.0, 0.0, effort=[math.nan]), "the effort of a is nan"),
        (to(1.1, 0.0), "point 0: a at 1.1 is beyond its limits of -1 to 1"),
        (to(0.0, 0.0, velocities=[-2.1, 0.0]), "point 0: a with a velocity of -2.1 is beyond its limit of 2"),
        (JointTrajectory(["a", "a"], [Point([0.0, 0.0])]), "names a twice"),
    ],
)
def test_what_no_joint_can_bear_is_named_with_its_joint(inputs, text):
    assert text in limit_error(inputs, survey_of(inputs), LIMITS)


def through(*points):
    """Return a trajectory through (time, a, b)."""
    return JointTrajectory(["a", "b"], [Point([a, b], time=round(time * S)) for time, a, b in points])


@pytest.mark.parametrize(
    ("inputs", "reported"),
    [
        (through((0.0, -0.9, 0.0), (1.0, 0.9, 0.0), (2.0, 0.9, 40.0)), None),
        (through((0.0, -0.9, 0.0), (0.895, 0.9, 0.0)), None),  # 2.01 rad/s: times are written with few digits
        (
            through((0.0, 0.0, 0.0), (0.5, 0.9, 0.0), (1.0, 0.9, 0.0), (1.5, -0.9, 0.0)),
            "point 3: a would have to move -1.8 in 0.5 s, faster than its limit of 2; give it 0.9 s, or set unreach",
        ),
    ],
)
def test_a_point_that_cannot_be_reached_in_time_is_named_with_the_time_it_needs(inputs, reported):
    result = unreachable(inputs, survey_of(inputs), LIMITS)
    assert (result is None) is (reported is None)
    assert reported is None or reported in result


def test_a_joint_that_may_not_move_reaches_nothing_and_points_without_positions_report_nothing_of_the_way():
    inputs = through((0.0, 0.0, 0.0), (0.001, 1.0, 0.0))
    result = unreachable(inputs, survey_of(inputs), {"a": JointLimits(velocity=0.0)})
    assert "faster than its limit of 0; leave it where it is, or set unreachable_points" in result
    mixed = JointTrajectory(["a"], [Point([0.0]), Point(velocities=[0.0], time=1), Point([1.0], time=2)])
    assert unreachable(mixed, survey_of(mixed), LIMITS) is None


def test_limits_bear_the_rounding_of_a_planner_and_turns_without_end():
    inputs = to(1.0 + 1e-7, 100.0)
    assert limit_error(inputs, survey_of(inputs), LIMITS) is None


@pytest.mark.parametrize(
    ("position", "time", "far"), [(0.05, 0.0, False), (0.2, 0.0, True), (0.9, 0.5, False), (0.9, 0.3, True)]
)
def test_a_start_is_far_that_the_joint_cannot_reach_by_then(position, time, far):
    text = far_start(to(position, time=time), {"a": 0.0}, LIMITS, 0.1)
    assert (text is not None) is far
    if text is not None:
        assert f"begins with a at {position:g}" in text
        assert "allowed_start_tolerance" in text


def test_a_start_is_judged_by_the_short_way_round_and_not_at_all_with_a_tolerance_of_zero():
    here = {"a": 0.0, "b": math.pi - 0.01}
    assert far_start(to(0.0, 0.01 - math.pi, time=0.0), here, LIMITS, 0.1) is None
    assert far_start(to(0.0, 1.0, time=0.0), here, LIMITS, 0.1) is not None
    assert far_start(to(0.0, 1.0, time=0.0), here, LIMITS, 0.0) is None


@pytest.mark.parametrize(
    ("point", "stamp", "lost"),
    [
        (Point([0.0], time=0), 0, False),
        (Point(velocities=[1.0], time=S), 0, False),
        (Point(velocities=[1.0], time=0), 0, True),
        (Point(velocities=[1.0], time=S), 5 * S, True),
        (Point(velocities=[1.0], time=S), 9 * S + 1, False),
    ],
)
def test_nothing_leads_to_a_first_point_of_velocities_that_is_past(point, stamp, lost):
    text = lost_start(JointTrajectory(["a"], [point], stamp), 10 * S)
    assert (text is not None) is lost
    assert text is None or "give it positions" in text


@pytest.mark.parametrize(("now", "word"), [(12 * S, "1 s ago"), (100_000 * S, "1 days (by another clock?) ago")])
def test_how_long_ago_it_ended_is_reported(now, word):
    joint_trajectory = JointTrajectory(["a"], [Point([0.0], time=S)], 10 * S)
    assert (
        word
        in broken_rule(
            joint_trajectory, survey_of(joint_trajectory), TrajectoryParams(joints=("a",)), now, effort=False
        ).text
    )
