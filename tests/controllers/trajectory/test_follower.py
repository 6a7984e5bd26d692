import gc
import math
import sys

import pytest

from canopen_control.controllers.trajectory.follower import Follower
from canopen_control.controllers.trajectory.joint_group import JointGroup
from canopen_control.controllers.trajectory.params import JointConstraints, JointGains, TrajectoryParams
from canopen_control.controllers.trajectory.point import JointTrajectory, Point
from canopen_control.controllers.trajectory.validation import PackedPoints
from canopen_control.hardware.interfaces import CommandInterface, StateInterface
from canopen_control.rpc.messages.samples import TrajectoryPoint

S, MS = 1_000_000_000, 1_000_000
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
        self.group.take(self.commands, self.states)
        self.group.read()
        self.follower = Follower(self.params, self.group, 10 * MS)
        self.follower.begin()
        self.follower.hold()
        self.now = S

    def cycle(self, scaling=1.0):
        self.now += 10 * MS
        self.follower.take_queued()
        self.group.read()
        if self.follower.sample(self.now, 0.01, scaling):
            self.group.compare(self.follower.desired)
            self.follower.write(self.now, 0.01)

    def commanded(self):
        return [each.value for each in self.commands]


def line(end, seconds, names=JOINTS):
    packed = PackedPoints()
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


def test_time_runs_as_it_is_scaled():
    joints = Joints("position")
    joints.follower.follow(line(1.0, 1.0))
    for _ in range(101):
        joints.cycle(0.5)
    assert joints.follower.desired.positions == pytest.approx([0.5, 0.5])
    assert joints.follower.past == pytest.approx(0.5)


def test_points_whose_positions_are_to_be_deduced_are_kept_as_points():
    joints = Joints("position", allow_integration_in_goal_trajectories=True)
    packed = PackedPoints()
    packed.add([TrajectoryPoint(velocities=[1.0, 1.0], time_from_start=t) for t in (0.1, 0.2)])
    message = JointTrajectory(JOINTS, packed)
    joints.follower.follow(message)
    assert isinstance(message.points, list)
    for _ in range(30):
        joints.cycle()
    assert joints.commanded() == pytest.approx([0.15, 0.15])


def test_a_query_says_where_the_joints_are_when_nothing_is_followed():
    joints, out = Joints("position"), Point()
    joints.follower.drop(holding=True)
    assert not joints.follower.query(S, out)
    assert out.positions == [0.0, 0.0]


@pytest.mark.parametrize("kind", ["position", "velocity", "effort"])
def test_following_leaves_no_object_behind(kind):
    joints = Joints(kind)
    joints.follower.follow(line(1.0, 1000.0))
    for _ in range(300):
        joints.cycle()
    gc.collect()
    gc.disable()
    try:
        before, waiting = sys.getallocatedblocks(), gc.get_count()[0]
        for _ in range(2000):
            joints.cycle()
        assert sys.getallocatedblocks() - before < 20
        assert gc.get_count()[0] - waiting < 10
    finally:
        gc.enable()


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
