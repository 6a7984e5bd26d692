from __future__ import annotations

import itertools
import math

import pytest

pytestmark = pytest.mark.ros
TOPIC = "/ground_truth"


@pytest.fixture(scope="module")
def listening(stage):
    stage.peer.order("subscribe", topic=TOPIC, of="geometry_msgs/msg/PoseStamped", qos="default")
    return stage


def odometry(frame="odom"):
    return {"base": {"kind": "odometry", "time": 1.0, "x": 0.0, "y": 0.0, "heading": 0.0, "frame_id": frame}}


def test_the_true_pose_is_told_in_the_frame_of_odometry(listening, fresh):
    fresh.robot.samples = odometry("two/odom")
    truth = {"time": 12.5, "x": 5.0, "y": 1.5, "z": 0.1, "heading": math.pi, "odom": [5.0, 0.0, math.pi / 2]}
    seconds = itertools.count(12)

    def tell():
        fresh.robot.more = {"true_pose": truth | {"time": next(seconds) + 0.5}}

    message = fresh.peer.hears(TOPIC, tell)
    assert message["header"]["frame_id"] == "two/odom"
    assert 12 <= message["header"]["stamp"]["sec"] < next(seconds)
    assert message["header"]["stamp"]["nanosec"] == 500_000_000
    place, turn = message["pose"]["position"], message["pose"]["orientation"]
    assert [place[axis] for axis in "xyz"] == pytest.approx([1.5, 0.0, 0.1])
    assert [turn[axis] for axis in "wxyz"] == pytest.approx([math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)])
    fresh.robot.more = {"true_pose": truth | {"time": 99_999.0, "x": 4.0}}
    place = fresh.peer.message(TOPIC, lambda message: message["header"]["stamp"]["sec"] == 99_999)["pose"]["position"]
    assert [place[axis] for axis in "xyz"] == pytest.approx([1.5, 1.0, 0.1])
