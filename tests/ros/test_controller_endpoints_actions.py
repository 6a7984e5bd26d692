"""The action as seen by a client of rclpy.action in another process; the robot returns scripted results."""

from __future__ import annotations

import itertools
import json
import math
import signal
from pathlib import Path

import pytest
from support import ros
from support.ros import eventually

pytestmark = pytest.mark.ros
ACTION, KIND = "/arm/follow_joint_trajectory", "control_msgs/action/FollowJointTrajectory"
WIRE = json.loads((Path(__file__).parents[1] / "data/follow_joint_trajectory_wire.json").read_text())
SUCCEEDED, CANCELED, ABORTED = 4, 5, 6  # action_msgs/msg/GoalStatus
ARM = {
    "name": "arm", "type": "joint_trajectory_controller/JointTrajectoryController", "state": "active",
    "joints": ["a", "b"], "interface": "position", "claimed_interfaces": ["a/position", "b/position"],
    "tells": "trajectory", "is_broadcaster": False, "rejected": 0,
}  # fmt: skip
POINT = {"positions": [1.0, 2.0], "velocities": [0.0, 0.0], "time_from_start": {"sec": 1, "nanosec": 500_000_000}}
ENDED = {"state": "succeeded", "error_code": 0, "text": "the goal was reached"}


def goal(points=(POINT,), **parts):
    return {"trajectory": {"joint_names": ["a", "b"], "points": list(points)}, **parts}


def sample(time, **more):
    point = {"positions": [0.1, 0.2], "time_from_start": 0.25}
    return {
        "kind": "trajectory", "time": time, "joints": ["a", "b"], "executing": True, "holding": False,
        "reference": point, "feedback": {**point, "velocities": [0.5, 0.5]}, "error": {"positions": [0.0, 0.01]},
        "output": point, **more,
    }  # fmt: skip


@pytest.fixture(scope="module", autouse=True)
def arm(stage):
    """The controller, once its action is there."""
    stage.robot.controllers += [dict(ARM), {**ARM, "name": "free"}]
    return stage


@pytest.fixture
def robot(fresh):
    robot = fresh.robot
    robot.answers["send_trajectory"] = {"accepted": True, "feedback_rate": 50.0}
    robot.holds = ("trajectory_end",)
    yield robot
    robot.release()


def held(robot):
    return len(robot._held)


def accepted(robot, peer, name, data=None, action=ACTION, **options):
    """Have a goal accepted; returns what the robot was sent of it."""
    robot.collected.clear()
    before = held(robot)
    peer.order("goal", action=action, of=KIND, data=data or goal(), name=name, **options)
    assert peer.message(name, lambda message: "accepted" in message) == {"accepted": True}
    assert eventually(lambda: held(robot) == before + 1)
    return robot.commands("send_trajectory")[-1]


def result(peer, name):
    reported = peer.message(name, lambda message: "status" in message)
    return reported["status"], reported["error_code"], reported["error_string"]


def test_its_endpoints_are_those_of_upstreams_server(arm, maker):
    topics = {each.replace("/x/", f"{ACTION}/"): reported for each, reported in WIRE.items()}
    reported = {}

    def seen():
        reported.update(maker.order("wire", topics=list(topics))["found"])
        return set(reported) == set(topics)

    assert eventually(seen)
    assert reported == topics


def test_a_goal_is_accepted_followed_and_succeeds(robot, maker):
    tolerance = [{"name": "a", "position": 0.1, "velocity": -1.0}]
    sent = accepted(robot, maker, "one", goal(
        path_tolerance=tolerance, goal_tolerance=tolerance, goal_time_tolerance={"sec": 0, "nanosec": 500_000_000},
    ))  # fmt: skip
    reported = {"joint": "a", "position": 0.1, "velocity": -1.0, "acceleration": 0.0}
    assert sent == {
        "controller": "arm", "joints": ["a", "b"], "source": "ros", "dead_man": True, "goal_time_tolerance": 0.5,
        "heartbeat": 3.0,
        "points": [{"positions": [1.0, 2.0], "velocities": [0.0, 0.0], "accelerations": [], "effort": [],
                    "time_from_start": 1.5}],
        "path_tolerance": [reported], "goal_tolerance": [reported],
    }  # fmt: skip
    robot.samples = {"arm": sample(1_700_000_000.5)}
    feedback = maker.message("one", lambda message: "feedback" in message)["feedback"]
    assert feedback["joint_names"] == ["a", "b"]
    assert feedback["header"]["stamp"] == {"sec": 1_700_000_000, "nanosec": 500_000_000}
    assert feedback["desired"]["positions"] == [0.1, 0.2]
    assert feedback["actual"]["velocities"] == [0.5, 0.5]
    assert feedback["error"]["positions"] == [0.0, 0.01]
    assert feedback["actual"]["time_from_start"] == {"sec": 0, "nanosec": 250_000_000}
    robot.release_one(ENDED)
    assert result(maker, "one") == (SUCCEEDED, 0, "the goal was reached")


def test_feedback_comes_at_the_controllers_rate_and_only_while_it_is_executed(robot, maker):
    accepted(robot, maker, "fed")
    for index in range(30):
        robot.samples, pushed = {"arm": sample(1_700_000_010.0 + index / 100)}, robot.pushed
        assert eventually(lambda pushed=pushed: robot.pushed > pushed)
    robot.samples = {"arm": sample(1_700_000_020.0, executing=False)}
    received = [maker.message("fed", lambda message: "feedback" in message), *maker.waiting("fed")]
    stamps = [item["feedback"]["header"]["stamp"] for item in received]
    times = [stamp["sec"] + stamp["nanosec"] / 1e9 for stamp in stamps]
    assert max(times) < 1_700_000_020.0
    assert all(later - earlier > 0.0199 for earlier, later in itertools.pairwise(times))
    robot.release_one(ENDED)
    assert result(maker, "fed")[0] == SUCCEEDED


def test_what_the_robot_refuses_is_refused_and_its_result_reports_why(robot, maker):
    text = "arm refuses the trajectory: it names 'c', which is not a joint of this controller"
    robot.answers["send_trajectory"] = {"accepted": False, "error_code": -2, "text": text}
    maker.order("goal", action=ACTION, of=KIND, data=goal(), name="refused")
    assert maker.message("refused") == {"accepted": False}
    assert result(maker, "refused") == (ABORTED, -2, text)


@pytest.mark.parametrize(
    ("name", "data", "points", "why"),
    [
        ("nan", goal([{**POINT, "positions": [0.0, math.nan]}]), 0, "point 0: the position of b is nan"),
        ("multi", goal(multi_dof_trajectory={"joint_names": ["a"], "points": [{}]}), 0, "multi_dof_trajectory"),
        ("many", goal([{}]), 20_001, "the trajectory has 20001 points"),
    ],
)
def test_what_cannot_even_be_sent_to_the_robot_is_refused_with_its_reason(robot, maker, name, data, points, why):
    maker.order("goal", action=ACTION, of=KIND, data=data, name=name, points=points)
    assert maker.message(name) == {"accepted": False}
    status, code, text = result(maker, name)
    assert (status, code) == (ABORTED, -1)
    assert why in text
    assert robot.commands("send_trajectory") == []


def test_what_the_robot_aborts_is_aborted_with_its_code(robot, maker):
    accepted(robot, maker, "off")
    robot.release_one({"state": "aborted", "error_code": -4, "text": "a is 0.3 off its path"})
    assert result(maker, "off") == (ABORTED, -4, "a is 0.3 off its path")


def test_it_is_cancelled_by_its_client_and_by_others(robot, maker):
    accepted(robot, maker, "mine")
    assert maker.order("cancel", name="mine")["goals"] == 1
    assert eventually(lambda: robot.commands("cancel_trajectory"))
    assert robot.commands("cancel_trajectory") == [{"controller": "arm", "own": True}]
    robot.release_one({"state": "canceled", "error_code": 0, "text": "the goal was cancelled"})
    assert result(maker, "mine") == (CANCELED, 0, "the goal was cancelled")
    accepted(robot, maker, "others")
    robot.release_one({"state": "canceled", "error_code": 0, "text": "the goal was cancelled"})
    assert result(maker, "others") == (ABORTED, -1, "the goal was cancelled")


def test_a_newer_goal_goes_to_the_robot_at_once_and_the_one_before_ends_as_the_robot_reports(robot, maker):
    accepted(robot, maker, "old")
    accepted(robot, maker, "new")
    robot.release_one({"state": "aborted", "error_code": -1, "text": "another goal has replaced it"})
    assert result(maker, "old") == (ABORTED, -1, "another goal has replaced it")
    robot.release_one(ENDED)
    assert result(maker, "new")[0] == SUCCEEDED


def test_the_death_of_the_client_ends_its_goal_unless_that_is_to_continue(arm, robot):
    robot.answers["send_trajectory"] = lambda goal: {"accepted": True, "outlives_client": goal["controller"] == "free"}
    with ros.Peer(arm.domain, "--interfaces") as mortal:
        accepted(robot, mortal, "free", action="/free/follow_joint_trajectory")
        accepted(robot, mortal, "orphan")
        mortal.kill()

        def cancelled():
            robot.time += 0.05  # of the looks
            return robot.commands("cancel_trajectory")

        assert eventually(cancelled)
    why = "the action client that sent the goal has left the ROS graph"
    assert robot.commands("cancel_trajectory") == [{"controller": "arm", "own": True, "why": why}]


def test_the_end_of_the_bridge_ends_its_goals_and_their_clients_are_notified(arm, robot, maker):
    accepted(robot, maker, "last")
    accepted(robot, maker, "late", ask=False)
    arm.bridge.send_signal(signal.SIGSTOP)
    maker.order("result", name="late")  # this request and the signal wait for the bridge together
    arm.bridge.terminate()
    arm.bridge.send_signal(signal.SIGCONT)
    ended = (ABORTED, -1, "the ROS bridge has ended, which aborts the goal")
    assert (result(maker, "last"), result(maker, "late")) == (ended, ended)
    assert arm.bridge.wait(60) == 0
