from __future__ import annotations

import itertools
import math
from types import SimpleNamespace

import pytest

from canopen_control.ros.robot_topics import LaserScans
from canopen_control.rpc.messages.simulation import LaserScanReading
from canopen_control.rpc.messages.state import StateSample

pytestmark = pytest.mark.ros
SIMULATION = {"seconds": 1.5, "paused": True, "period": 0.02}
METHODS = {"set_pause": "pause_simulation", "step_simulation": "step_simulation", "reset_world": "reset_simulation"}


@pytest.fixture
def call(fresh, maker):
    fresh.robot.more = {"sim_time": 1.5, "sim_epoch": 1_700_000_000.0}
    fresh.robot.answers.update(dict.fromkeys(METHODS.values(), SIMULATION))

    def call(service, kind, **data):
        of = f"mujoco_ros2_control_msgs/srv/{kind}"
        return maker.order("call", service=service, of=of, data=data)["response"]

    return call


@pytest.mark.parametrize(
    ("service", "kind", "data", "requested"),
    [
        ("set_pause", "SetPause", {"paused": True}, {"paused": True}),
        ("step_simulation", "StepSimulation", {"steps": 7}, {"steps": 7}),
        ("reset_world", "ResetWorld", {"keyframe": "home"}, {"keyframe": "home"}),
    ],
)
def test_the_services_of_mujocos_plugin_ask_the_robot(fresh, call, service, kind, data, requested):
    answer = call(f"/ros2_control_node/{service}", kind, **data)
    assert answer == {"success": True, "message": "paused at 1.5 s; a step is a cycle of 20 ms"}
    assert fresh.robot.commands(METHODS[service])[-1] == requested


def test_what_the_robot_refuses_and_steps_that_are_none_are_reported(fresh, call):
    fresh.robot.refusals["step_simulation"] = {"kind": "ControlError", "message": "the simulation is not paused"}
    assert call("/mujoco_ros2_control_node/step_simulation", "StepSimulation", steps=1) == {
        "success": False,
        "message": "the simulation is not paused",
    }
    fresh.robot.refusals.clear()
    answer = call("/mujoco_ros2_control_node/step_simulation", "StepSimulation", steps=0)
    assert answer == {"success": False, "message": "steps is 0; give a number of cycles from 1 to 1000000"}
    assert fresh.robot.commands("step_simulation")[-1] == {"steps": 1}


SCAN = LaserScanReading(
    name="lidar",
    topic="/front/scan",
    frame_id="laser",
    seconds=2.25,
    angle_min=-1.5,
    angle_max=1.5,
    angle_increment=1.5,
    range_min=0.5,
    range_max=8.0,
    scan_time=0.2,
    ranges=[-1.0, 2.5, 3.0],
)


class Asked:
    """What an endpoint is given, of which it makes nothing but publishers; `asked` are the times of questions."""

    def __init__(self, *scans):
        self.scans, self.asked, self.now, self.published = scans, [], 0.0, []
        publisher = SimpleNamespace(publish=self.published.append)
        self.node = SimpleNamespace(create_publisher=lambda *_: publisher, destroy_publisher=lambda _: None)
        self.endpoint = LaserScans(self)

    def frame(self, name):
        return name

    def ask(self, _request, answer):
        self.asked.append(self.now)
        answer(self.scans, None)

    def run(self, seconds, *, unix=0.0):
        for cycle in range(1, round(seconds / 0.02) + 1):
            self.now = round(cycle * 0.02, 2)
            self.endpoint.on_state(StateSample(time=self.now + unix, sim_time=self.now, sim_epoch=1.0))


def test_a_lidar_is_asked_at_its_rate_in_simulated_time():
    ros = Asked(SCAN)
    ros.run(1.0)
    assert ros.asked == [0.02, 0.2, 0.4, 0.6, 0.8, 1.0]
    for _ in range(100):  # paused
        ros.endpoint.on_state(StateSample(time=1.0, sim_time=1.0, sim_epoch=1.0))
    assert len(ros.asked) == 6


def test_a_robot_without_a_lidar_is_asked_once_and_a_real_one_never():
    ros = Asked()
    ros.run(2.0)
    assert ros.asked == [0.02]
    real = Asked(SCAN)
    real.endpoint.on_state(StateSample(time=1.0))
    assert real.asked == []


@pytest.mark.parametrize(("unix", "stamp"), [(0.0, 2.25), (1000.0, 1002.25)])
def test_the_message_has_the_time_of_its_scan_on_the_clock_of_the_bridge(unix, stamp):
    ros = Asked(SCAN)
    ros.run(0.02, unix=unix)
    (message,) = ros.published
    assert message.header.stamp.sec + message.header.stamp.nanosec / 1e9 == pytest.approx(stamp)
    assert (message.header.frame_id, list(message.ranges)) == ("laser", [-1.0, 2.5, 3.0])
    assert (message.range_max, message.angle_increment) == (8.0, 1.5)
    ros.endpoint.close()


TOPIC = "/ground_truth"


@pytest.fixture(scope="module")
def listening(stage):
    stage.peer.order("subscribe", topic=TOPIC, of="geometry_msgs/msg/PoseStamped", qos="default")
    return stage


def odometry(frame="odom"):
    return {"base": {"kind": "odometry", "time": 1.0, "x": 0.0, "y": 0.0, "heading": 0.0, "frame_id": frame}}


def test_the_true_pose_is_reported_in_the_frame_of_odometry(listening, fresh):
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
