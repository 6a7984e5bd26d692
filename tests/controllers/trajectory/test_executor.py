import itertools
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.controllers.trajectory.active_trajectory import ActiveTrajectory
from canopen_control.controllers.trajectory.executor import (
    MAX_WAITING,
    Blend,
    SpeedScaling,
    StopMotion,
    TrajectoryExecutor,
    scaled,
)
from canopen_control.controllers.trajectory.joint_group import JointGroup
from canopen_control.controllers.trajectory.params import JointConstraints, JointGains, TrajectoryParams
from canopen_control.controllers.trajectory.point import JointTrajectory, Point
from canopen_control.controllers.trajectory.validation import PointBuffer
from canopen_control.hardware.interfaces import CommandInterface, StateInterface
from canopen_control.rpc.messages.samples import TrajectoryPoint

S_OF_STOP = 1_000_000_000
JOINTS_OF_STOP = st.lists(
    st.tuples(st.floats(-3.0, 3.0), st.floats(-2.0, 2.0), st.floats(0.1, 10.0)), min_size=1, max_size=3
)


def stop(joints) -> StopMotion:
    positions, velocities, decelerations = zip(*joints, strict=True)
    stop_motion = StopMotion(decelerations)
    stop_motion.set_before(5 * S_OF_STOP, Point(positions, velocities), [False] * len(joints))
    return stop_motion


def course(made: StopMotion, ms: int) -> list[Point]:
    points = []
    for index in range(ms):
        points.append(Point())
        assert made.sample(5 * S_OF_STOP + index * S_OF_STOP // 1000, points[-1])
    return points


def test_a_joint_comes_to_rest_with_its_deceleration():
    created = stop([(1.0, 2.0, 4.0), (0.0, -1.0, 4.0)])
    begin, middle, end = (course(created, 701)[index] for index in (0, 250, 700))
    assert (begin.positions, begin.velocities, begin.accelerations) == ([1.0, 0.0], [2.0, -1.0], [-4.0, 4.0])
    assert middle.positions == pytest.approx([1.375, -0.125])
    assert middle.velocities == [1.0, 0.0]
    assert (end.positions, end.velocities, end.accelerations) == ([1.5, -0.125], [0.0, 0.0], [0.0, 0.0])
    assert (created.is_over, created.time_of(0), end.time) == (True, S_OF_STOP // 2, 700 * S_OF_STOP // 1000)


@given(JOINTS_OF_STOP)
def test_no_joint_jumps_turns_back_or_goes_faster_than_before(joints):
    points = course(stop(joints), 200)
    for index, (position, velocity, _) in enumerate(joints):
        assert points[0].positions[index] == pytest.approx(position, abs=1e-9)
        way = [point.positions[index] for point in points]
        for a, b in itertools.pairwise(way):
            assert abs(b - a) <= abs(velocity) / 1000 + 1e-9
            assert (b - a) * velocity >= -1e-9


def test_a_joint_with_an_unknown_speed_stays_where_it_is():
    assert course(stop([(1.0, math.nan, 4.0), (0.0, 1.0, 4.0)]), 500)[-1].positions == pytest.approx([1.0, 0.125])


def test_a_user_sets_it_and_the_command_interface_receives_of_it():
    scaling, command = SpeedScaling(0.5, allowed=True), CommandInterface("arm", "speed")
    scaling.set_interfaces(None, command)
    scaling.update()
    assert (scaling.factor, command.value) == (0.5, 0.5)
    scaling.set(0.25)
    scaling.update()
    assert (scaling.factor, command.value) == (0.25, 0.25)


@pytest.mark.parametrize(("value", "factor"), [(0.3, 0.3), (2.0, 2.0), (-1.0, 0.0), (math.nan, 0.0), (math.inf, 0.0)])
def test_a_state_interface_gives_the_time_and_an_unknown_value_stops_it(value, factor):
    scaling = SpeedScaling(1.0, allowed=True)
    scaling.set_interfaces(StateInterface("arm", "speed", value), None)
    scaling.set(0.9)
    scaling.update()
    assert scaling.factor == factor


@pytest.mark.parametrize("factor", [-0.1, math.nan, math.inf])
def test_a_factor_that_is_none_is_a_sentence(factor):
    assert "give 0 or more" in SpeedScaling(allowed=True).mistake(factor)
    assert SpeedScaling(allowed=True).mistake(0.0) is None


def test_where_more_than_positions_is_commanded_it_runs_at_its_own_speed():
    scaling = SpeedScaling(0.5, allowed=False)
    assert scaling.factor == 1.0
    assert "only position commands" in scaling.mistake(0.5)


@pytest.mark.parametrize(
    ("time", "factor", "expected"),
    [(10_000_000, 1.0, 10_000_000), (10_000_000, 0.3, 2_999_999), (10_000_000, 0.1, 1_000_000),
     (3_333_333, 0.5, 1_666_666), (10_000_000, 0.0, 0)],
)  # fmt: skip
def test_a_scaled_time_is_cut_to_whole_nanoseconds(time, factor, expected):
    assert scaled(time, factor) == expected


S, MS = 1_000_000_000, 1_000_000
WRAP = [False, False]


def line_of_blend(*points, start=10.0):
    """Return a trajectory of two joints through (time in s, position, position), from 0 at rest at 10 s."""
    active_trajectory = ActiveTrajectory(
        JointTrajectory(["a", "b"], [Point([p, q], time=round(t * S)) for t, p, q in points])
    )
    active_trajectory.start = round(start * S)
    return active_trajectory


def running(*points):
    created = line_of_blend(*points)
    created.begin(10 * S)
    created.set_before(10 * S, Point([0.0, 0.0]), WRAP)
    created.sample(10 * S, Point())
    return created


def at(motion, t):
    out = Point()
    assert motion.sample(round(t * S), out)
    return out.positions


def blended(new, handoff, joints=(0, 1), old=None):
    blend = Blend(running((4.0, 4.0, 8.0)) if old is None else old, WRAP)
    blend.queue(new, round(handoff * S), joints)
    return blend


def test_until_the_start_of_the_new_one_the_old_one_is_followed_and_from_there_the_new_one():
    blend = blended(line_of_blend((1.0, 0.0, 0.0), start=12.0), 12.0)
    assert at(blend, 11.0) == [1.0, 2.0]
    assert at(blend, 12.0) == pytest.approx([2.0, 4.0])
    assert at(blend, 12.5) == pytest.approx([1.0, 2.0])
    assert at(blend, 13.0) == [0.0, 0.0]
    assert blend.is_over
    assert blend.end_point().positions == [0.0, 0.0]


def test_joints_that_are_not_named_follow_the_old_one_to_its_end():
    blend = blended(line_of_blend((1.0, 0.0, 9.0), start=12.0), 12.0, [0])
    assert at(blend, 12.5) == pytest.approx([1.0, 5.0])
    assert at(blend, 13.5) == [0.0, 7.0]
    assert not blend.is_over
    assert at(blend, 14.0) == [0.0, 8.0]
    assert blend.is_over
    assert blend.start + blend.time_of(0) == 14 * S


def test_the_new_one_begins_with_the_velocity_of_the_old_one():
    new = ActiveTrajectory(JointTrajectory(["a", "b"], [Point([3.0, 6.0], [0.0, 0.0], time=S)]))
    new.start = 12 * S
    blend, out, before = blended(new, 12.0), Point(), Point()
    blend.sample(12 * S - 1, before)
    blend.sample(12 * S, out)
    assert before.velocities == pytest.approx([1.0, 2.0])
    assert out.velocities == pytest.approx([1.0, 2.0])


def test_what_was_to_begin_later_is_dropped_by_what_begins_before():
    blend = blended(line_of_blend((1.0, 5.0, 5.0), start=13.0), 13.0)
    blend.queue(line_of_blend((1.0, 0.0, 0.0), start=12.0), 12 * S, (0, 1))
    assert at(blend, 13.5) == [0.0, 0.0]


def test_those_that_wait_are_bounded():
    blend = Blend(running((100.0, 1.0, 1.0)), WRAP)
    for index in range(50):
        blend.queue(line_of_blend((1.0, index, index), start=20.0 + index), (20 + index) * S, (0, 1))
    assert len(blend._waiting) == MAX_WAITING
    assert at(blend, 99.0)[0] == 49.0


def test_a_blend_continues_in_the_next_one_and_nothing_that_is_done_is_kept():
    motion = running((100.0, 1.0, 1.0))
    for index in range(100):
        motion = blended(line_of_blend((0.5, index, 0.0), start=11.0 + index), 11.0 + index, [index % 2], motion)
        at(motion, 11.4 + index)
    assert len(motion._tracks) <= 2


def test_a_question_changes_nothing():
    blend, out = blended(line_of_blend((1.0, 0.0, 0.0), start=12.0), 12.0), Point()
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
    blend, before = blended(line_of_blend(*points, start=handoff), handoff, joints), [0.0, 0.0]
    for step in range(1, 650):
        now = at(blend, 10.0 + step * 0.02)
        assert max(abs(a - b) for a, b in zip(now, before, strict=True)) < 10.0 / 0.05 * 0.02 + 1e-9
        before = now
    for joint in range(2):
        assert before[joint] == pytest.approx(points[-1][1 + joint] if joint in joints else [4.0, 8.0][joint])


JOINTS = ("a", "b")


class Joints:
    """Two joints under a follower; they are where they are put."""

    def __init__(self, *commands, states=("position", "velocity"), **params):
        self.params = TrajectoryParams(
            joints=JOINTS,
            command_interfaces=commands,
            state_interfaces=states,
            gains=(JointGains(p=2.0, ff_velocity_scale=1.0),) * 2,
            constraints=(JointConstraints(),) * 2,
            **params,
        )
        self.group = JointGroup(JOINTS, JOINTS, commands, states)
        self.commands = [CommandInterface(*name.split("/")) for name in self.group.command_names]
        self.states = [StateInterface(*name.split("/"), 0.0) for name in self.group.state_names]
        self.group.set_interfaces(self.commands, self.states)
        self.group.read()
        self.follower = TrajectoryExecutor(self.params, self.group, 10 * MS)
        self.follower.begin()
        self.follower.hold()
        self.now = S

    def cycle(self, scaling=1.0):
        self.now += 10 * MS
        self.follower.start_queued()
        self.group.read()
        if self.follower.sample(self.now, 0.01, scaling):
            self.group.compare(self.follower.desired)
            self.follower.write(self.now, 0.01)

    def commanded(self):
        return [command.value for command in self.commands]


def line(end, seconds, names=JOINTS):
    packed = PointBuffer()
    packed.add(
        [TrajectoryPoint(positions=[p] * len(names), time_from_start=t) for p, t in ((0.0, 0.0), (end, seconds))]
    )
    return JointTrajectory(names, packed)


def test_it_holds_then_follows_and_holds_the_end():
    joints = Joints("position")
    joints.cycle()
    assert joints.follower.holding
    assert joints.commanded() == [0.0, 0.0]
    joints.follower.follow(line(1.0, 0.1))
    for _ in range(5):
        joints.cycle()
    assert joints.commanded() == pytest.approx([0.5, 0.5])  # one period ahead
    for _ in range(10):
        joints.cycle()
    joints.follower.hold_at_end()
    joints.cycle()
    assert joints.follower.holding
    assert joints.commanded() == [1.0, 1.0]


def test_a_joint_that_is_not_named_stays_and_the_others_get_their_own():
    joints = Joints("position")
    joints.states[0].value = 0.7
    joints.group.read()
    joints.follower.follow(line(1.0, 0.1, ("b",)))
    for _ in range(20):
        joints.cycle()
    assert joints.commanded() == pytest.approx([0.7, 1.0])


def test_velocities_alone_are_those_of_the_trajectory_and_of_a_loop_over_each_joint():
    joints = Joints("velocity")
    joints.follower.follow(line(1.0, 1.0))
    for _ in range(6):
        joints.cycle()
    assert joints.commanded() == pytest.approx([1.0 + 2.0 * 0.05] * 2)  # the joints stand


def test_it_brakes_on_the_way_that_a_deceleration_takes():
    joints = Joints("position")
    joints.states[1].value = joints.states[3].value = 1.0  # rad/s
    joints.group.read()
    joints.follower.brake([2.0, 4.0])
    for _ in range(100):
        joints.cycle()
    assert joints.commanded() == pytest.approx([1.0 / 4.0, 1.0 / 8.0])


def test_points_whose_positions_are_to_be_deduced_are_kept_as_points():
    joints = Joints("position", allow_integration_in_goal_trajectories=True)
    packed = PointBuffer()
    packed.add([TrajectoryPoint(velocities=[1.0, 1.0], time_from_start=t) for t in (0.1, 0.2)])
    message = JointTrajectory(JOINTS, packed)
    joints.follower.follow(message)
    assert isinstance(message.points, list)
    for _ in range(30):
        joints.cycle()
    assert joints.commanded() == pytest.approx([0.15, 0.15])


def test_a_query_reports_where_the_joints_are_when_nothing_is_followed():
    joints, out = Joints("position"), Point()
    joints.follower.clear(holding=True)
    assert not joints.follower.query(S, out)
    assert out.positions == [0.0, 0.0]


def test_a_velocity_that_nobody_knows_moves_nothing():
    joints = Joints("velocity")
    joints.states[1].value = math.nan
    joints.cycle()
    assert joints.commanded() == [0.0, 0.0]


@pytest.mark.parametrize(("from_desired", "way"), [(False, 0.02 - 0.0004), (True, 0.0002 - 0.00001)])
def test_a_stop_takes_its_own_time_however_slow_trajectories_run(from_desired, way):
    joints = Joints("position", interpolate_from_desired_state=from_desired)
    joints.cycle()
    joints.follower.follow(line(1.0, 5.0))
    for _ in range(3):
        joints.cycle(0.1)
    for each, value in zip(joints.states, (0.5, 2.0) * 2, strict=True):
        each.value = value
    before = joints.commanded()[0] if from_desired else 0.5
    joints.follower.brake([8.0, 8.0] if not from_desired else [0.2, 0.2])
    joints.cycle(0.1)
    assert joints.commanded()[0] - before == pytest.approx(way, abs=1e-9)
