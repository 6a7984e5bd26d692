"""arm6 as used by MoveIt: an action client in a separate process, the bridge, the runtime, six virtual drives."""

from __future__ import annotations

import os
import signal
from types import SimpleNamespace

import pytest
from support import ros
from support.arm6 import ENDS, JOINTS, copy_patient_arm, planned
from support.host import eventually
from support.processes import cycles_pass

from canopen_control.client import RobotClient
from canopen_control.rpc.messages.robot import GetStatus

pytestmark = pytest.mark.ros
ACTION, KIND = "/arm_controller/follow_joint_trajectory", "control_msgs/action/FollowJointTrajectory"
SUCCEEDED, CANCELED, ABORTED = 4, 5, 6  # action_msgs/msg/GoalStatus
LONG_S = 20.0  # of a goal that is cut off: on a busy computer seconds pass before the test sees that it has begun


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    """The arm with its bridge, and a client of the action; for all tests of this module."""
    folder = tmp_path_factory.mktemp("arm")
    with ros.stage(folder) as stage:
        config = copy_patient_arm(folder)
        robot = stage.start("run", config, "--ros", "--as", "rosarm", "--can", "local:rosarm", **stage.environment)
        robot.until("rosarm runs")
        with ros.Peer(stage.domain, "--interfaces") as peer, RobotClient.connect("rosarm") as client:
            yield SimpleNamespace(peer=peer, robot=robot, client=client, stage=stage, domain=stage.domain)


def joints(arm):
    return arm.client.ask(GetStatus()).joints


def positions(arm):
    reported = joints(arm)
    return [reported[joint].position for joint in JOINTS]


def goal_to(arm, end, seconds=0.6, count=50, **more):
    points = [
        {
            "positions": point.positions,
            "velocities": point.velocities,
            "accelerations": point.accelerations,
            "time_from_start": {"sec": point.time // 10**9, "nanosec": point.time % 10**9},
        }
        for point in planned(positions(arm), end, seconds, count).points
    ]
    return {"trajectory": {"joint_names": JOINTS, "points": points}, **more}


def near(factor):
    """A place that no count of an encoder is."""
    return [0.123456789 * factor * (1 if end > 0 else -1) for end in ENDS]


def send(arm, name, data, peer=None):
    peer = peer or arm.peer
    peer.order("goal", action=ACTION, of=KIND, data=data, name=name)
    return peer.message(name, lambda message: "accepted" in message)["accepted"]


def result(arm, name, peer=None):
    reported = (peer or arm.peer).message(name, lambda message: "status" in message)
    return reported["status"], reported["error_code"], reported["error_string"]


def moving(arm, name, peer=None):
    """Wait until it is on its way."""
    (peer or arm.peer).message(name, lambda message: "feedback" in message)


def at_rest(arm):
    return eventually(lambda: all(abs(joint.velocity) < 1e-3 for joint in joints(arm).values()))


def test_a_goal_of_500_points_is_followed_with_feedback_and_reached(arm):
    assert send(arm, "reached", goal_to(arm, near(1), count=500))
    moving(arm, "reached")
    assert result(arm, "reached") == (SUCCEEDED, 0, "the goal was reached")
    assert at_rest(arm)
    assert positions(arm) == pytest.approx(near(1), abs=1e-3)


def there_or_published_again(arm, topic, kind, data, end):
    """Whether the joints are at `end`; a publisher that knows of a subscriber may not be known to that one yet."""
    if eventually(lambda: positions(arm) == pytest.approx(end, abs=1e-3), 5):
        return True
    arm.peer.order("publish", topic=topic, of=kind, data=data)
    return False


def test_its_topics_and_its_query_are_there_over_dds(arm):
    arm.peer.order("subscribe", topic="/arm_controller/controller_state", qos="latched",
                   of="control_msgs/msg/JointTrajectoryControllerState")  # fmt: skip
    state = arm.peer.message("/arm_controller/controller_state")
    assert state["joint_names"] == JOINTS
    assert state["feedback"]["positions"] == pytest.approx(positions(arm), abs=1e-3)
    assert state["speed_scaling_factor"] == 1.0
    arm.peer.order("unsubscribe", topic="/arm_controller/controller_state")
    topic, kind = "/arm_controller/speed_scaling_input", "control_msgs/msg/SpeedScalingFactor"
    assert eventually(lambda: arm.peer.order("publish", topic=topic, of=kind, data={"factor": 1.0}, qos="latched")
                      ["subscribers"] == 1)  # fmt: skip
    topic, kind = "/arm_controller/joint_trajectory", "trajectory_msgs/msg/JointTrajectory"
    data = goal_to(arm, near(2), 0.3)["trajectory"]
    assert eventually(lambda: arm.peer.order("publish", topic=topic, of=kind, data=data)["subscribers"] == 1)
    assert eventually(lambda: there_or_published_again(arm, topic, kind, data, near(2)), 30)
    reported = arm.peer.call("/arm_controller/query_state", "control_msgs/srv/QueryTrajectoryState")
    assert (reported["success"], reported["name"]) == (False, JOINTS)


def test_a_joint_off_its_path_or_its_goal_aborts_with_its_code(arm):
    strict = [{"name": "joint_1", "position": 1e-9}]
    assert send(arm, "path", goal_to(arm, near(2), path_tolerance=strict))
    status, code, text = result(arm, "path")
    assert (status, code) == (ABORTED, -4)
    assert text.startswith("joint_1 is ")
    assert at_rest(arm)
    late = goal_to(arm, near(1), 0.4, goal_tolerance=strict, goal_time_tolerance={"sec": 0, "nanosec": 100_000_000})
    assert send(arm, "late", late)
    status, code, text = result(arm, "late")
    assert (status, code) == (ABORTED, -5)
    assert "off its goal 0.1 s after the end" in text


def test_a_newer_goal_takes_its_place_and_is_cancelled_and_the_joints_rest(arm):
    assert send(arm, "old", goal_to(arm, near(3), 1.5))
    moving(arm, "old")
    assert send(arm, "new", goal_to(arm, near(1), 1.5))
    assert result(arm, "old") == (ABORTED, -1, "another goal has replaced it")
    assert arm.peer.order("cancel", name="new")["goals"] == 1
    assert result(arm, "new") == (CANCELED, 0, "the goal was cancelled")
    assert at_rest(arm)


def test_what_is_refused_names_its_rule_and_nothing_moves(arm):
    where = positions(arm)
    good = goal_to(arm, near(1))["trajectory"]
    bad = {
        "few": ({**good, "joint_names": JOINTS[:5]}, -2, "it names 5 of 6 joints"),
        "strange": ({**good, "joint_names": [*JOINTS[:5], "joint_7"]}, -2, "'joint_7'"),
        "past": ({**good, "header": {"stamp": {"sec": 5, "nanosec": 0}}}, -3, "it ended"),
        "none": ({**good, "points": []}, -1, "it has no points"),
        "falling": ({**good, "points": good["points"][::-1]}, -1, "time_from_start must increase"),
        "sizes": ({**good, "points": [{"positions": [0.0]}]}, -1, "point 0 has 1 positions for 6 joints"),
    }
    for name, (trajectory, code, why) in bad.items():
        assert not send(arm, name, {"trajectory": trajectory})
        status, reported, text = result(arm, name)
        assert (status, reported) == (ABORTED, code)
        assert why in text
    assert positions(arm) == pytest.approx(where, abs=1e-3)


def events(arm):
    return [event.text for event in arm.client.ask(GetStatus()).events]


@pytest.mark.timed
def test_a_bridge_that_is_stopped_for_long_loses_its_goal_and_the_next_one_takes_goals(arm):
    end, bridge = near(4), arm.stage.pid_of("canopen_control.ros.bridge")
    assert send(arm, "hung", goal_to(arm, end, LONG_S))
    moving(arm, "hung")
    cycles_pass(arm.client, 170)  # 3.4 s, longer than it may be silent: its heartbeats come
    assert not any("has sent no heartbeat" in event for event in events(arm))
    os.kill(bridge, signal.SIGSTOP)
    # Its connection is silent for 3 s, or what watches it has ended it by then: the goal ends either way.
    ends = ("ros has sent no heartbeat for 3 s and is gone", "ros is gone, so its command has ended")
    assert eventually(lambda: any(end in event for event in events(arm) for end in ends), 8.0), events(arm)
    assert at_rest(arm)
    arm.robot.until("process ros: it is restarted")
    assert abs(positions(arm)[0] - end[0]) > 0.05
    with ros.Peer(arm.domain, "--interfaces") as late:  # others hold the server that was killed for alive a while
        assert send(arm, "after it", goal_to(arm, near(1)), late)
        assert result(arm, "after it", late)[0] == SUCCEEDED


@pytest.mark.timed
def test_the_death_of_the_client_and_of_the_bridge_stop_the_arm_on_its_way(arm):
    end = near(4)
    with ros.Peer(arm.domain, "--interfaces") as mortal:
        assert send(arm, "orphan", goal_to(arm, end, LONG_S), mortal)
        moving(arm, "orphan", mortal)
        mortal.kill()
        why = "the goal was cancelled: the action client that sent the goal has left the ROS graph"
        assert eventually(lambda: any(why in event for event in events(arm)), 2.0)
    assert at_rest(arm)
    assert abs(positions(arm)[0] - end[0]) > 0.05
    end = near(-4)
    assert send(arm, "last", goal_to(arm, end, LONG_S))
    moving(arm, "last")
    os.kill(arm.stage.pid_of("canopen_control.ros.bridge"), signal.SIGKILL)
    assert eventually(lambda: any("ros is gone, so its command has ended" in event for event in events(arm)), 2.0)
    assert at_rest(arm)
    assert abs(positions(arm)[0] - end[0]) > 0.05
    assert arm.robot.running
