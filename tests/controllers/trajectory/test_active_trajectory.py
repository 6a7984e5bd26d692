import itertools
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.trajectories import cases, differences, message, point

from canopen_control.controllers.trajectory.active_trajectory import ActiveTrajectory, Segment
from canopen_control.controllers.trajectory.point import JointTrajectory, Point

S = 1_000_000_000
VALUES_OF_SEGMENT = st.floats(-10.0, 10.0)


def between(a: Point, b: Point, t: float, duration: float = 1.0) -> Point:
    segment, out = Segment(), Point()
    segment.fit(0, a, round(duration * S), b)
    segment.evaluate(round(t * S), out)
    return out


def goes_to_zero_of_segment(given) -> bool:
    """Accelerations in both points and velocities not: upstream commands zeros, wherever the joint is."""
    a, b = given["a"], given["b"]
    has_v = a.get("velocities") and b.get("velocities")
    within = given["ta_ns"] <= given["t_ns"] <= given["tb_ns"]
    return bool(a.get("accelerations") and b.get("accelerations") and not has_v and within)


@pytest.mark.parametrize("case", cases("jtc_interpolate_between_points"), ids=lambda case: case["name"])
def test_it_interpolates_as_upstream_does(case):
    inputs, segment, out = case["in"], Segment(), Point()
    segment.fit(inputs["ta_ns"], point(inputs["a"]), inputs["tb_ns"], point(inputs["b"]))
    segment.evaluate(inputs["t_ns"], out)
    wrong = differences(out, case["expect"])
    assert set(wrong) <= {"positions", "velocities"} if goes_to_zero_of_segment(inputs) else not wrong, wrong


def test_accelerations_without_velocities_are_a_line_and_not_a_jump_to_zero():
    half = between(Point([1.0], accelerations=[0.5]), Point([2.0], accelerations=[0.5]), 0.5)
    assert (half.positions, half.velocities) == ([1.5], [1.0])


@given(st.lists(VALUES_OF_SEGMENT, min_size=6, max_size=6), st.floats(0.01, 10.0))
def test_a_quintic_begins_and_ends_as_its_points_specify(values, duration):
    p0, v0, a0, p1, v1, a1 = values
    a, b = Point([p0], [v0], [a0]), Point([p1], [v1], [a1])
    for t, expected in ((0.0, (p0, v0, a0)), (duration, (p1, v1, a1))):
        result = between(a, b, t, round(duration * S) / S)
        for values_found, value in zip((result.positions, result.velocities), expected[:2], strict=True):
            assert values_found[0] == pytest.approx(value, rel=1e-6, abs=1e-4)


def test_points_in_the_wrong_order_are_joined_as_upstream_joins_them():
    segment, out = Segment(), Point()
    segment.fit(2 * S, Point([1.0], [3.0]), S, Point([2.0], [3.0]))
    segment.evaluate(S, out)
    assert out.positions == [2.0]


def test_nothing_is_reported_of_joints_whose_position_is_not_known():
    assert between(Point(velocities=[1.0], accelerations=[1.0]), Point([], [1.0], [1.0]), 0.5).positions == []


def samples(case):
    """Yield (found, wanted) of every sample of a case, and at last the points that it leaves."""
    inputs = case["in"]
    created = message(inputs)
    points = created.points
    trajectory = ActiveTrajectory(created, splines=inputs["method"] == "splines")
    before = inputs["before"]
    if before is not None:
        trajectory.set_before(before["time_ns"], point(before["point"]), before.get("wrap", []))
    for each, expected in zip(inputs["samples"], case["expect"]["samples"], strict=True):
        out = Point()
        ok = trajectory.sample(each["t_ns"], out, ahead=not each.get("monotonic", True))
        result = {
            "ok": ok,
            "start_index": trajectory.first,
            "end_index": trajectory.following,
            "last_sample_index": trajectory.reached,
            "trajectory_start_ns": trajectory.start,
            "out_time_from_start_ns": out.time,
        }
        for index, turns in enumerate(trajectory.shift if ok else ()):
            out.positions[index] -= turns  # upstream goes on on the turn of the message; the joint's is another
        keys = result.keys() & expected.keys() if expected["ok"] else {"ok"}
        wrong = {key: (result[key], expected[key]) for key in keys if result[key] != expected[key]}
        yield wrong | (differences(out, expected, case["tolerance"]) if ok else {}), each, expected
    for each, expected in zip(points, case["expect"].get("points_after", points), strict=True):
        if isinstance(expected, dict):
            yield differences(each, expected, case["tolerance"]), {}, expected


CASES = cases("jtc_trajectory_sample")


def goes_to_zero(case) -> bool:
    """Accelerations without velocities in two neighbours: upstream commands zeros there, wherever the joint is."""
    before = [] if case["in"]["before"] is None else [case["in"]["before"]["point"]]
    points = [point(item) for item in before + case["in"]["points"]]
    pairs = itertools.pairwise(points)
    return any(a.accelerations and b.accelerations and not (a.velocities and b.velocities) for a, b in pairs)


def looks_beyond(case) -> int | None:
    """The sample after which upstream says the last point for ever: a look beyond the end, and the joints not there."""
    inputs, size = zip(case["in"]["samples"], case["expect"]["samples"], strict=True), len(case["in"]["points"])
    looks = (index for index, (each, expected) in enumerate(inputs) if not each.get("monotonic", True) and
             expected["ok"] and expected["end_index"] == size)  # fmt: skip
    return next(looks, None)


@pytest.mark.parametrize("case", CASES, ids=lambda case: case["name"])
def test_it_samples_as_upstream_does(case):
    beyond = looks_beyond(case)
    for index, (wrong, _, expected) in enumerate(samples(case)):
        if wrong and beyond is not None and index >= beyond:
            assert expected["last_sample_index"] == len(case["in"]["points"]) - 1
            continue
        if wrong and goes_to_zero(case):
            assert wrong.keys() <= {"positions", "velocities"}
            assert not any(expected["positions"])
            continue
        assert not wrong, wrong


def test_what_deviates_is_there():
    """Both deviations are met by a case; the tests below say what is done instead."""
    for deviates in (goes_to_zero, looks_beyond):
        assert any(deviates(case) and any(wrong for wrong, *_ in samples(case)) for case in CASES)


def ramp(*points: tuple[float, float], **how) -> ActiveTrajectory:
    """Return a trajectory of one joint through (time in s, position), from 0 at rest at 10 s."""
    active_trajectory = ActiveTrajectory(
        JointTrajectory(["a"], [Point([p], time=round(t * S)) for t, p in points]), **how
    )
    active_trajectory.set_before(10 * S, Point([0.0]), [False])
    return active_trajectory


def at(trajectory: ActiveTrajectory, t: float, *, ahead: bool = False) -> float:
    out = Point()
    assert trajectory.sample(round(t * S), out, ahead=ahead)
    return out.positions[0]


def test_a_look_ahead_beyond_the_end_does_not_end_it():
    created = ramp((1.0, 1.0), (2.0, 3.0))
    assert at(created, 10.0) == 0.0
    assert at(created, 12.5, ahead=True) == 3.0
    assert created.is_over
    assert at(created, 11.5) == 2.0
    assert not created.is_over


def test_accelerations_without_velocities_lead_from_point_to_point():
    active_trajectory = ActiveTrajectory(
        JointTrajectory(["a"], [Point([p], accelerations=[1.0], time=t * S) for t, p in ((1, 1.0), (2, 3.0))])
    )
    active_trajectory.set_before(10 * S, Point([0.5], accelerations=[0.0]), [False])
    assert [at(active_trajectory, t) for t in (10.0, 10.5, 11.0, 11.5, 12.0)] == [0.5, 0.75, 1.0, 2.0, 3.0]


def test_without_splines_the_next_point_is_commanded_until_it_is_reached():
    created = ramp((1.0, 1.0), (2.0, 3.0), splines=False)
    assert [at(created, t) for t in (10.0, 10.9, 11.0, 11.9, 12.0)] == [0.0, 0.0, 3.0, 3.0, 3.0]


def turning(begin: float, *points: Point, wrap: bool = True) -> ActiveTrajectory:
    """Return a trajectory of a joint without end that is at `begin` at 10 s."""
    active_trajectory = ActiveTrajectory(JointTrajectory(["a"], points))
    active_trajectory.set_before(10 * S, Point([begin], [0.0]), [wrap])
    return active_trajectory


@pytest.mark.parametrize(
    ("begin", "first", "goes"),
    [
        (0.0, 10.0, 10.0 - 4 * math.pi),
        (0.0, 3.0, 3.0),
        (0.0, -3.5, -3.5 + 2 * math.pi),
        (100.0, 0.5, 0.5 + 32 * math.pi),
        (-7.0, 0.0, -2 * math.pi),
        (0.0, math.pi, math.pi),
        (0.0, -math.pi, -math.pi),
    ],
)
def test_a_joint_without_end_begins_where_it_is_and_goes_at_most_half_a_turn(begin, first, goes):
    created = turning(begin, Point([first], time=3 * S))
    way = [at(created, 10.0 + number / 10) for number in range(31)]
    assert way[0] == begin
    assert way[-1] == pytest.approx(goes)
    assert all(abs(b - a) < 0.11 for a, b in itertools.pairwise(way))
    assert created.end_point().positions == [way[-1]]
    out = Point()
    assert created.query(14 * S, out)
    assert out.positions == [way[-1]]


def test_later_points_keep_their_distances_from_the_first_one():
    created = turning(0.0, *(Point([p], time=round(t * S)) for t, p in ((1.0, 10.0), (2.0, 20.0), (3.0, 10.0))))
    first = 10.0 - 4 * math.pi
    assert [at(created, t) for t in (10.0, 11.0, 12.0, 13.0)] == pytest.approx([0.0, first, first + 10.0, first])


def test_the_first_point_that_has_positions_counts_after_those_that_have_none():
    """1 s at 2 rad/s on the average brings it to 1 rad: the way to 7.5 rad is 0.2 rad then, on the turn below."""
    points = Point(velocities=[2.0], time=S), Point([7.5], [0.0], time=2 * S)
    created = turning(0.0, *points)
    way = [at(created, 10.0 + number / 10) for number in range(21)]
    assert (way[0], way[10], way[20]) == pytest.approx((0.0, 1.0, 7.5 - 2 * math.pi))


def test_a_joint_with_ends_is_led_as_commanded():
    created = turning(0.0, Point([10.0], time=3 * S), wrap=False)
    assert [at(created, t) for t in (10.0, 13.0)] == [0.0, 10.0]


def test_without_points_there_is_nothing():
    assert not ramp().sample(10 * S, Point())


VALUES = st.floats(-3.0, 3.0)


@st.composite
def messages(draw, most=8):
    """A valid trajectory of two joints: positions, with velocities, with both, or mixed."""
    points, time = [], draw(st.integers(0, S))
    for _ in range(draw(st.integers(1, most))):
        degree = draw(st.integers(0, 2))
        values = [draw(st.lists(VALUES, min_size=2, max_size=2)) for _ in range(degree + 1)]
        points.append(Point(*values, time=time))
        time += draw(st.integers(S // 100, 2 * S))
    return JointTrajectory(["a", "b"], points)


def followed(message: JointTrajectory) -> ActiveTrajectory:
    copies = JointTrajectory(message.joint_names, [item.copy() for item in message.points])
    active_trajectory = ActiveTrajectory(copies)
    active_trajectory.set_before(10 * S, Point([0.0, 0.0], [0.0, 0.0]), [False, False])
    active_trajectory.sample(10 * S, Point())
    return active_trajectory


@given(messages(), st.lists(st.tuples(st.integers(0, S), st.integers(0, 20 * S)), max_size=30))
def test_look_aheads_do_not_change_samples(message, steps):
    created, now, result, fresh = followed(message), 10 * S, Point(), Point()
    for step, ahead in steps:
        now += step
        created.sample(now, result)
        followed(message).sample(now, fresh)
        assert result.positions == fresh.positions
        created.sample(now + ahead, result, ahead=True)
        followed(message).sample(now + ahead, fresh)
        assert result.positions == fresh.positions


@given(messages(), st.lists(st.sampled_from(["cycle", "cycle", "half", "query", "back"]), max_size=40))
def test_what_was_seen_ahead_is_what_its_cycle_then_samples(message, steps):
    created, now, period, desired, output, fresh = followed(message), 10 * S, S // 4, Point(), Point(), Point()
    for step in steps:
        if step == "query":
            requested = Point()
            created.query(now + period, requested)
            requested.positions[:] = [9.0, 9.0]
        now += {"cycle": period, "half": period // 2, "back": 0, "query": period}[step]
        for out, time, ahead in ((desired, now, False), (output, now + period, True)):
            created.sample(time, out, ahead=ahead)
            followed(message).sample(time, fresh)
            assert (out.positions, out.velocities, out.time) == (fresh.positions, fresh.velocities, fresh.time)


def test_a_cycle_uses_the_result_of_the_look_ahead():
    created, observed, out = ramp((0.0, 0.0), (1.0, 1.0)), Point(), Point()
    created.sample(10 * S, out)
    created.sample(10 * S + S // 10, observed, ahead=True)
    observed.positions[0] = 42.0
    created.sample(10 * S + S // 10, out)
    assert out.positions == [42.0], "it was not worked out again"
    created.sample(10 * S + S // 10, out)
    assert out.positions == [pytest.approx(0.1)], "it is taken once"


@given(messages())
def test_positions_are_continuous_in_time_and_meet_every_point(message):
    created, before, after = followed(message), Point(), Point()
    for index, each in enumerate(message.points[1:], 1):
        arrival = 10 * S + each.time
        assert created.sample(arrival - 1, before, ahead=True)
        assert created.sample(arrival, after, ahead=True)
        for joint in range(2):
            assert after.positions[joint] == pytest.approx(each.positions[joint], abs=1e-9), index
            assert before.positions[joint] == pytest.approx(after.positions[joint], abs=1e-5)


def test_an_effort_that_was_never_commanded_is_none():
    active_trajectory = ActiveTrajectory(JointTrajectory(["a"], [Point([1.0], effort=[4.0], time=S)]))
    active_trajectory.set_before(10 * S, Point([0.0], effort=[math.nan]), [False])
    out = Point()
    assert active_trajectory.sample(10 * S, out)
    assert active_trajectory.sample(10 * S + S // 2, out)
    assert out.effort == [2.0]
