from __future__ import annotations

import math

import pytest
from support.ros import eventually

pytestmark = pytest.mark.ros
TRAJECTORY, STATE = "trajectory_msgs/msg/JointTrajectory", "control_msgs/msg/JointTrajectoryControllerState"
SCALING, QUERY = "control_msgs/msg/SpeedScalingFactor", "control_msgs/srv/QueryTrajectoryState"
ARM = {
    "name": "arm", "type": "joint_trajectory_controller/JointTrajectoryController", "state": "active",
    "joints": ["a", "b"], "interface": "position", "claimed_interfaces": ["a/position", "b/position"],
    "tells": "trajectory", "is_broadcaster": False, "rejected": 0,
}  # fmt: skip
POINT = {"positions": [1.0, 2.0], "time_from_start": {"sec": 1, "nanosec": 0}}


def trajectory(*points, **more):
    return {"joint_names": ["a", "b"], "points": list(points), **more}


@pytest.fixture(scope="module", autouse=True)
def arms(stage):
    """A controller of positions, and one of velocities, whose speed cannot be scaled."""
    stage.robot.controllers += [dict(ARM), {**ARM, "name": "fast", "interface": "velocity"}]
    return stage


@pytest.fixture
def robot(fresh):
    robot = fresh.robot
    yield robot
    robot.release()


def publish(peer, topic, kind, data, until, qos="reliable"):
    """Publish until it has come, since discovery takes its time."""
    peer.order("publish", topic=topic, of=kind, data=data, qos=qos, rate=20)
    assert eventually(until)
    peer.order("silence", topic=topic)
    peer.order("renew", topic=topic)


def test_a_trajectory_goes_to_the_robot_with_its_stamp(robot, maker):
    data = trajectory(POINT, header={"stamp": {"sec": 12, "nanosec": 500_000_000}})
    publish(maker, "/arm/joint_trajectory", TRAJECTORY, data, lambda: robot.commands("set_trajectory"))
    assert robot.commands("set_trajectory")[0] == {
        "controller": "arm", "joints": ["a", "b"], "stamp": 12.5, "source": "ros", "dead_man": True,
        "points": [{"positions": [1.0, 2.0], "velocities": [], "accelerations": [], "effort": [],
                    "time_from_start": 1.0}],
    }  # fmt: skip


def test_of_those_that_come_while_one_is_on_its_way_the_newest_counts(robot, maker):
    robot.holds = ("set_trajectory",)
    publish(maker, "/arm/joint_trajectory", TRAJECTORY, trajectory(POINT), lambda: robot.commands("set_trajectory"))
    for number in range(5):
        data = trajectory({**POINT, "positions": [float(number), 0.0]})
        publish(maker, "/arm/joint_trajectory", TRAJECTORY, data, lambda: True)
    bad = trajectory({**POINT, "positions": [0.0, math.nan]})
    publish(maker, "/arm/joint_trajectory", TRAJECTORY, bad, lambda: True)
    seen = len(robot.commands("set_trajectory"))
    robot.release()
    data = trajectory({**POINT, "positions": [9.0, 0.0]})
    publish(maker, "/arm/joint_trajectory", TRAJECTORY, data, lambda: len(robot.commands("set_trajectory")) > seen)
    firsts = [each["points"][0]["positions"][0] for each in robot.commands("set_trajectory")]
    assert firsts[0] == 1.0
    assert firsts[-1] == 9.0
    assert not any(each is None for each in firsts)


def test_its_state_is_published_once_for_each_sample(robot, maker):
    maker.order("subscribe", topic="/arm/controller_state", of=STATE, qos="latched")
    point = {"positions": [0.1, 0.2], "velocities": [0.3, 0.4], "time_from_start": -0.25}
    sample = {
        "kind": "trajectory", "time": 1_700_000_000.5, "joints": ["a", "b"], "executing": False, "holding": True,
        "reference": point, "feedback": {"positions": [0.5, 0.6]}, "error": {"positions": [-0.4, -0.4]},
        "output": point, "speed_scaling_factor": 0.5,
    }  # fmt: skip
    robot.samples = {"arm": sample}

    def renewed():
        robot.samples["arm"] = {**sample, "time": robot.samples["arm"]["time"] + 0.01}
        return not maker._messages["/arm/controller_state"].empty()

    assert eventually(renewed)
    state = maker.message("/arm/controller_state")
    assert (state["header"]["stamp"]["sec"], state["joint_names"]) == (1_700_000_000, ["a", "b"])
    assert state["reference"]["time_from_start"] == {"sec": -1, "nanosec": 750_000_000}
    told = [state[each]["positions"] for each in ("reference", "feedback", "error", "output")]
    assert told == [[0.1, 0.2], [0.5, 0.6], [-0.4, -0.4], [0.1, 0.2]]
    assert (state["output"]["velocities"], state["speed_scaling_factor"]) == ([0.3, 0.4], 0.5)


def test_what_it_says_at_a_time_can_be_asked_for(robot, maker):
    point = {"positions": [0.1, 0.2], "velocities": [0.3, 0.4], "accelerations": [0.5, 0.6]}
    robot.answers["query_trajectory"] = {"known": True, "joints": ["a", "b"], "point": point}
    told = maker.call("/arm/query_state", QUERY, time={"sec": 3, "nanosec": 500_000_000})
    assert told == {
        "success": True, "message": "", "name": ["a", "b"], "position": [0.1, 0.2], "velocity": [0.3, 0.4],
        "acceleration": [0.5, 0.6],
    }  # fmt: skip
    assert robot.commands("query_trajectory") == [{"controller": "arm", "time": 3.5}]
    robot.refusals["query_trajectory"] = {"kind": "ControlError", "message": "arm is gone"}
    assert maker.call("/arm/query_state", QUERY)["message"] == "arm is gone"


def test_the_speed_is_scaled_where_that_can_be_and_by_what_is_a_factor(robot, maker):
    topic = "/arm/speed_scaling_input"
    publish(maker, topic, SCALING, {"factor": 0.5}, lambda: robot.commands("scale_trajectory"), "latched")
    assert robot.commands("scale_trajectory")[0] == {"controller": "arm", "factor": 0.5}
    seen = len(robot.commands("scale_trajectory"))
    for bad in (-1.0, math.nan, math.inf):
        maker.order("publish", topic=topic, of=SCALING, data={"factor": bad}, qos="latched")
    publish(maker, topic, SCALING, {"factor": 2.0}, lambda: len(robot.commands("scale_trajectory")) > seen, "latched")
    assert {each["factor"] for each in robot.commands("scale_trajectory")} == {0.5, 2.0}
    told = maker.order("graph")["topics"]
    assert topic in told
    assert "/fast/speed_scaling_input" not in told
    assert "/fast/joint_trajectory" in told
