"""The actions as seen by a client of rclpy.action in another process; the robot returns scripted results."""

from __future__ import annotations

import math

import pytest
from support.ros import eventually

pytestmark = pytest.mark.ros
SUCCEEDED, CANCELED, ABORTED = 4, 5, 6  # action_msgs/msg/GoalStatus
KINDS = {
    "hand": ("position_controllers/GripperActionController", "control_msgs/action/GripperCommand"),
    "jaws": (
        "parallel_gripper_action_controller/GripperActionController",
        "control_msgs/action/ParallelGripperCommand",
    ),
}
GOALS = {
    "hand": {"command": {"position": 0.04, "max_effort": 20.0}},
    "jaws": {"command": {"position": [0.04], "effort": [20.0], "velocity": [0.05]}},
}
STALLED = {"state": "succeeded", "text": "finger has stalled", "position": 0.03, "effort": 19.5, "stalled": True,
           "reached_goal": False}  # fmt: skip


@pytest.fixture(scope="module", autouse=True)
def grippers(stage):
    """The controllers, once their actions are there."""
    stage.robot.controllers += [
        {
            "name": name,
            "type": kind,
            "state": "active",
            "joints": ["finger"],
            "interface": "position",
            "tells": "gripper",
            "offers": ["parallel_gripper_goals" if kind.startswith("parallel") else "gripper_goals"],
        }
        for name, (kind, _) in KINDS.items()
    ]
    return stage


@pytest.fixture
def robot(fresh):
    robot = fresh.robot
    robot.answers["send_gripper"] = {"accepted": True, "feedback_rate": 50.0}
    robot.holds = ("gripper_end",)
    yield robot
    robot.release()


def send(robot, peer, which, data=None):
    """Send a goal, and return whether it is accepted."""
    before = len(robot._held)
    peer.order("goal", action=f"/{which}/gripper_cmd", of=KINDS[which][1], data=data or GOALS[which], name=which)
    accepted = peer.message(which, lambda message: "accepted" in message)["accepted"]
    if accepted:
        assert eventually(lambda: len(robot._held) == before + 1)
    return accepted


def ended(peer, which):
    return peer.message(which, lambda message: "status" in message)


@pytest.mark.parametrize(("which", "velocity"), [("hand", None), ("jaws", 0.05)])
def test_a_goal_is_sent_reported_of_and_answered_with_its_result(robot, maker, which, velocity):
    assert send(robot, maker, which)
    (sent,) = robot.commands("send_gripper")
    assert sent == {
        key: value
        for key, value in {
            "controller": which, "position": 0.04, "max_effort": 20.0, "max_velocity": velocity, "source": "ros",
            "dead_man": True, "heartbeat": 3.0,
        }.items()
        if value is not None
    }  # fmt: skip
    robot.samples = {which: {
        "kind": "gripper", "time": 1_700_000_000.5, "joint": "finger", "position": 0.02, "velocity": 0.01,
        "effort": None, "target": 0.04, "executing": True, "stalled": False, "reached_goal": False,
    }}  # fmt: skip
    feedback = maker.message(which, lambda message: "feedback" in message)["feedback"]
    where = feedback if which == "hand" else {key: value[0] for key, value in feedback["state"].items()
                                              if key in ("position", "effort")}  # fmt: skip
    assert where["position"] == 0.02
    assert math.isnan(where["effort"])
    robot.release_one(STALLED)
    result = ended(maker, which)
    assert (result["status"], result["stalled"], result["reached_goal"]) == (SUCCEEDED, True, False)
    if which == "hand":
        assert (result["position"], result["effort"]) == (0.03, 19.5)
    else:
        state = result["state"]
        assert (state["name"], state["position"], state["effort"]) == (["finger"], [0.03], [19.5])


def test_cancelling_asks_the_robot_and_ends_as_cancelled(robot, maker):
    assert send(robot, maker, "hand")
    maker.order("cancel", name="hand")
    assert eventually(lambda: robot.commands("cancel_gripper"))
    (cancelled,) = robot.commands("cancel_gripper")
    assert (cancelled["controller"], cancelled["own"]) == ("hand", True)
    robot.release_one({"state": "canceled", "text": "the goal was cancelled", "position": 0.01})
    assert ended(maker, "hand")["status"] == CANCELED


@pytest.mark.parametrize(
    ("which", "data"),
    [
        ("hand", {"command": {"position": math.nan, "max_effort": 1.0}}),
        ("hand", {"command": {"position": 0.01, "max_effort": math.inf}}),
        ("jaws", {"command": {"position": []}}),
        ("jaws", {"command": {"position": [0.01, 0.02]}}),
    ],
)
def test_a_goal_that_is_none_is_refused_without_asking_the_robot(robot, maker, which, data):
    assert not send(robot, maker, which, data)
    assert robot.commands("send_gripper") == []
