import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.robots import Bench

from canopen_control.host.sockets import socket_path
from canopen_control.rpc.messages.drive import DRIVE, BasePose, DriveHello, GetWorld, WorldState
from canopen_control.rpc.messages.state import TruePose
from canopen_control.rpc.server import Server
from canopen_control.runtime.ground_truth import PERIOD_NS, TruePoseQuery, TruePoseTracker, odometry_at
from canopen_control.runtime.status import state_sample, status_message

BASE = "robby_base_controller"
poses = st.tuples(*[st.floats(-5.0, 5.0)] * 3)


def taken(tracker, truth, odometry, name="base"):
    tracker.take(BasePose(*truth, 7_000_000_000), None if odometry is None else (name, odometry), 500_000_000)
    return tracker.reading


@given(start=poses, odometry=poses, x=st.floats(-3, 3), y=st.floats(-3, 3), turn=st.floats(-3, 3))
def test_a_base_whose_odometry_is_right_has_no_error_wherever_the_world_begins(start, odometry, x, y, turn):
    def moved(pose):
        cosine, sine = math.cos(pose[2]), math.sin(pose[2])
        return pose[0] + cosine * x - sine * y, pose[1] + sine * x + cosine * y, pose[2] + turn

    tracker = TruePoseTracker()
    taken(tracker, start, odometry)
    reading = taken(tracker, moved(start), moved(odometry))
    assert reading.error == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)
    assert reading.in_odometry == pytest.approx(moved(odometry), abs=1e-9)


def test_the_error_is_the_true_pose_minus_odometry_in_the_odometry_frame():
    tracker = TruePoseTracker()
    assert taken(tracker, (1.0, 2.0, math.pi / 2), (0.0, 0.0, 0.0)).error == pytest.approx((0.0, 0.0, 0.0))
    reading = taken(tracker, (1.0, 3.0, math.pi / 2 + 0.1), (0.9, 0.0, 0.0))
    assert reading.error == pytest.approx((0.1, 0.0, 0.1))
    assert (reading.x, reading.y, reading.time) == (1.0, 3.0, 7.5)


@pytest.mark.parametrize("again", [TruePoseTracker.align, lambda t: taken(t, (9, 0, 0), (0, 0, 0), "other")])
def test_the_frames_are_brought_together_again_when_odometry_restarts(again):
    tracker = TruePoseTracker()
    taken(tracker, (1.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    again(tracker)
    reading = taken(tracker, (2.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    assert reading.odom == (2.0, 0.0, 0.0)


def test_what_happens_while_odometry_does_not_count_is_an_error_of_it():
    tracker = TruePoseTracker()
    taken(tracker, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    assert taken(tracker, (0.5, 0.0, 0.0), None).error is None
    assert taken(tracker, (0.5, 0.0, 0.0), (0.0, 0.0, 0.0)).error == pytest.approx((0.5, 0.0, 0.0))


def test_without_odometry_the_pose_is_known_and_no_error():
    reading = taken(TruePoseTracker(), (1.0, 0.5, 0.2), None)
    assert (reading.x, reading.error, reading.in_odometry) == (1.0, None, None)
    assert reading.with_odometry_error((0.0, 0.0, 0.0)) is reading
    assert TruePose(time=0.0, x=0.0, y=0.0, heading=0.0).odom is None


class World:
    """The control socket of a drive that moves a base, or none."""

    def __init__(self, bench, node_id, base):
        self.base, self.asked = base, 0
        hello = DriveHello(node_id=node_id)
        name = f"{bench.channel.replace('memory:', '')}-{node_id}"
        self.server = Server(DRIVE, bench.reactor, socket_path("drive", name), lambda: hello)
        self.server.register(GetWorld, self.answer)

    def answer(self, call):
        self.asked += 1
        call.reply(WorldState(self.base))


def query_of(bench):
    def take(base):
        robot = bench.robot
        robot.truth.take(base, odometry_at(robot.manager, base.time_ns - bench.reactor.now()), robot.wall_offset_ns)

    names = [f"{bench.channel.replace('memory:', '')}-{node_id}" for node_id in (3, 2)]
    return TruePoseQuery(names, bench.reactor, take)


def test_the_drive_that_moves_the_base_is_found_and_asked_again_and_again():
    bench = Bench("truth", controllers=[BASE])
    other, world = World(bench, 3, None), World(bench, 2, BasePose(4.0, 0.0, 0.0, 0, z=0.1))
    query = query_of(bench)
    try:
        bench.start()
        query.start()
        bench.run(300)
        assert (other.asked, world.asked) == (1, pytest.approx(300e6 / PERIOD_NS, abs=1))
        sample = state_sample(bench.robot)
        assert (sample.true_pose.x, sample.true_pose.z) == (4.0, 0.1)
        assert sample.true_pose.error == pytest.approx((0.0, 0.0, 0.0))
        world.base = BasePose(4.25, 0.0, 0.0, bench.reactor.now())
        bench.run(100)
        assert status_message(bench.robot).true_pose.error == pytest.approx((0.25, 0.0, 0.0))
        query.close()
        requested = world.asked
        bench.run(200)
        assert world.asked == requested
    finally:
        for item in (other, world):
            item.server.close()
        bench.close()


def test_a_robot_whose_drives_move_no_base_asks_no_more():
    bench = Bench("untrue")
    worlds = [World(bench, node_id, None) for node_id in (2, 3)]
    query = query_of(bench)
    try:
        bench.start()
        query.start()
        bench.run(500)
        assert [world.asked for world in worlds] == [1, 1]
        assert state_sample(bench.robot).true_pose is None
    finally:
        query.close()
        for world in worlds:
            world.server.close()
        bench.close()


def test_a_robot_whose_drives_have_no_socket_has_no_true_pose():
    bench = Bench("bare")
    query = query_of(bench)
    bench.start()
    query.start()
    bench.run(100)
    assert status_message(bench.robot).true_pose is None
    bench.close()


def test_odometry_is_carried_to_the_time_of_the_true_pose():
    bench = Bench("carried", controllers=[BASE])
    try:
        bench.start()
        for _ in range(10):
            bench.robot.command(BASE, [0.2, 0.0], "test")
            bench.run(100)
        (name, before), (_, present) = (odometry_at(bench.robot.manager, ahead) for ahead in (-50_000_000, 0))
        assert name == BASE
        assert present[0] - before[0] == pytest.approx(0.2 * 0.05, rel=0.02)
        assert present[0] > 0.1
    finally:
        bench.close()
