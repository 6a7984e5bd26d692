"""Trajectories over the socket of a robot: the goal's answer is its end, and its connection's end is its own."""

from types import SimpleNamespace

import pytest
from support.apiclient import Client
from support.arm6 import ENDS, JOINTS, copy_arm, planned
from support.robots import Bench

from canopen_control.controllers.command_timeout import CommandTimeout
from canopen_control.rpc.messages.trajectory import MAX_POINTS
from canopen_control.runtime import api_trajectories
from canopen_control.runtime.api import ApiServer

GRIPPER = "gripper"
YAML = """
gripper:
  ros__parameters:
    type: parallel_gripper_action_controller/GripperActionController
    joint: joint_6
    stall_timeout: 0.3
"""


@pytest.fixture(scope="module")
def config_of_api_gripper(tmp_path_factory):
    folder = copy_arm(tmp_path_factory.mktemp("gripper"))
    control = folder / "ros2_controllers.yaml"
    control.write_text(control.read_text() + YAML)
    return folder


@pytest.fixture
def arm_of_api_gripper(config_of_api_gripper):
    bench = Bench("gripperapi", config=config_of_api_gripper, drives=range(2, 8), controllers=[GRIPPER])
    bench.api = ApiServer(bench.robot)
    bench.start()
    bench.until(lambda: bench.robot.joints["joint_6"].enabled)
    bench.run(100)
    yield bench
    bench.api.close()
    bench.close()


@pytest.fixture
def client_of_api_gripper(arm_of_api_gripper):
    client_of_api_gripper = Client(arm_of_api_gripper)
    yield client_of_api_gripper
    client_of_api_gripper.close()


@pytest.fixture
def other_of_api_gripper(arm_of_api_gripper):
    client_of_api_gripper = Client(arm_of_api_gripper)
    yield client_of_api_gripper
    client_of_api_gripper.close()


def position(arm_of_api_gripper):
    return arm_of_api_gripper.robot.registry.state("joint_6/position").value


def test_a_goal_is_answered_when_it_has_ended_with_where_the_gripper_is(arm_of_api_gripper, client_of_api_gripper):
    result = client_of_api_gripper.ask("move_gripper", controller=GRIPPER, position=0.3)["result"]
    assert (result["state"], result["reached_goal"], result["stalled"]) == ("succeeded", True, False)
    assert result["position"] == pytest.approx(0.3, abs=0.011)
    assert result["text"] == "the goal was reached"
    client_of_api_gripper.close()
    arm_of_api_gripper.run(500)
    assert position(arm_of_api_gripper) == pytest.approx(0.3, abs=1e-3)


def test_a_sent_goal_is_accepted_at_once_and_its_end_is_reported_on_request(arm_of_api_gripper, client_of_api_gripper):
    verdict = client_of_api_gripper.ask("send_gripper", controller=GRIPPER, position=0.3)["result"]
    assert (verdict["accepted"], verdict["feedback_rate"]) == (True, 20.0)
    assert abs(position(arm_of_api_gripper)) < 0.1
    assert client_of_api_gripper.ask("gripper_end")["result"]["state"] == "succeeded"


@pytest.mark.rest
def test_the_end_of_its_connection_ends_it_and_the_joint_is_held(arm_of_api_gripper, client_of_api_gripper):
    client_of_api_gripper.ask("send_gripper", controller=GRIPPER, position=3.0, source="test")
    arm_of_api_gripper.run(300)
    client_of_api_gripper.close()
    arm_of_api_gripper.until(lambda: arm_of_api_gripper.texts("goal_aborted"))
    assert any(
        "test is gone, so the goal of test was aborted" in text for text in arm_of_api_gripper.texts("goal_aborted")
    )
    arm_of_api_gripper.run(500)
    where = position(arm_of_api_gripper)
    assert 0.0 < where < 2.5
    arm_of_api_gripper.run(500)
    assert position(arm_of_api_gripper) == pytest.approx(where, abs=1e-3)


@pytest.mark.rest
def test_a_sender_that_falls_silent_is_gone_though_its_connection_stands(arm_of_api_gripper, client_of_api_gripper):
    client_of_api_gripper.ask("send_gripper", controller=GRIPPER, position=6.0, heartbeat=0.5)
    for _ in range(4):
        arm_of_api_gripper.run(200)
        client_of_api_gripper.ask("trajectory_heartbeat")
    assert arm_of_api_gripper.texts("goal_aborted") == []
    arm_of_api_gripper.run(700)
    assert any(
        "has sent no heartbeat for 0.5 s and is gone" in text for text in arm_of_api_gripper.texts("goal_aborted")
    )


@pytest.mark.rest
def test_another_client_can_cancel_it_and_own_cancels_only_ones_own(
    arm_of_api_gripper, client_of_api_gripper, other_of_api_gripper
):
    client_of_api_gripper.ask("send_gripper", controller=GRIPPER, position=3.0)
    client_of_api_gripper.send(id=7, method="gripper_end", params={})
    arm_of_api_gripper.run(200)
    assert other_of_api_gripper.ask("cancel_gripper", controller=GRIPPER, own=True)["result"] == {}
    arm_of_api_gripper.run(50)
    assert client_of_api_gripper.messages() == []
    assert other_of_api_gripper.ask("cancel_gripper", controller=GRIPPER, why="enough")["result"] == {}
    result = client_of_api_gripper.next()["result"]
    assert (result["state"], result["text"]) == ("canceled", "the goal was cancelled: enough")


@pytest.mark.rest
@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"position": 9.0}, "the limits of joint_6, got 9"),
        ({"max_effort": -1.0}, "with a max_effort of -1"),
        ({"controller": "joint_state_broadcaster"}, "is not a gripper action controller"),
        ({"controller": "arm_controller"}, "arm_controller is unloaded"),
    ],
)
def test_a_goal_that_cannot_be_is_refused(client_of_api_gripper, wrong, words):
    verdict = client_of_api_gripper.ask("send_gripper", **{"controller": GRIPPER, "position": 0.1, **wrong})["result"]
    assert not verdict["accepted"]
    assert words in verdict["text"]


def test_without_a_goal_nothing_has_an_end(client_of_api_gripper):
    assert "this connection has sent no goal" in client_of_api_gripper.ask("gripper_end")["error"]["message"]


ARM = "arm_controller"


@pytest.fixture(scope="module")
def config(tmp_path_factory):
    return copy_arm(tmp_path_factory.mktemp("arm"))


@pytest.fixture
def arm(config):
    bench = Bench("armapi", config=config, drives=range(2, 8))
    bench.api = ApiServer(bench.robot)
    bench.start()
    bench.until(lambda: all(joint.enabled for joint in bench.robot.joints.values()))
    bench.run(100)
    yield bench
    bench.api.close()
    bench.close()


@pytest.fixture
def client(arm):
    client = Client(arm)
    yield client
    client.close()


@pytest.fixture
def other(arm):
    client = Client(arm)
    yield client
    client.close()


def points(count=20, seconds=1.5):
    return [
        {
            "positions": point.positions,
            "velocities": point.velocities,
            "accelerations": point.accelerations,
            "time_from_start": point.time / 1e9,
        }
        for point in planned([0.0] * 6, ENDS, seconds, count).points
    ]


def goal(**how):
    return {"controller": ARM, "joints": JOINTS, "points": points(), **how}


def points_from(where):
    return [{"positions": [item * 1.01 for item in where], "time_from_start": 1.0}]


def positions(arm):
    return [arm.robot.registry.state(f"{joint}/position").value for joint in JOINTS]


@pytest.mark.rest
def test_a_goal_is_answered_when_it_has_ended(arm, client):
    begin = arm.reactor.now()
    answer = client.ask("follow_trajectory", **goal(source="test"))
    assert answer["result"] == {"state": "succeeded", "error_code": 0, "text": "the goal was reached"}
    assert (arm.reactor.now() - begin) / 1e9 == pytest.approx(1.5, abs=0.1)
    assert arm.robot.commander == "test"
    arm.run(300)
    assert positions(arm) == pytest.approx(ENDS, abs=1e-3)


@pytest.mark.rest
def test_one_of_500_points_comes_in_pieces(client):
    all_points = points(500)
    while len(all_points) > 50:
        assert client.ask("trajectory_data", points=all_points[:50]) == {"id": 1, "result": {}}
        all_points = all_points[50:]
    assert client.ask("follow_trajectory", **goal(points=all_points))["result"]["state"] == "succeeded"


@pytest.mark.rest
def test_the_end_of_its_connection_ends_it_and_the_joints_brake(arm, client):
    client.send(id=1, method="follow_trajectory", params=goal())
    arm.run(500)
    client.close()
    arm.until(lambda: arm.texts("commander_gone"))
    assert any("was aborted; send" in text for text in arm.texts("goal_aborted"))
    arm.run(1000)
    where = positions(arm)
    assert all(0.1 < abs(a) < abs(b) - 0.01 for a, b in zip(where, ENDS, strict=True))
    arm.run(500)
    assert positions(arm) == pytest.approx(where, abs=1e-4)


@pytest.mark.rest
def test_without_a_dead_man_it_continues_without_its_connection(arm, client):
    client.send(id=1, method="follow_trajectory", params=goal(dead_man=False))
    arm.run(500)
    client.close()
    arm.run(2000)
    assert positions(arm) == pytest.approx(ENDS, abs=1e-3)


@pytest.mark.rest
def test_a_sender_that_promised_a_heartbeat_and_falls_silent_is_gone_though_its_connection_stands(arm, client):
    client.send(id=1, method="follow_trajectory", params=goal(heartbeat=0.5, source="test"))
    arm.run(600)
    assert client.next()["result"] == {
        "state": "aborted",
        "error_code": -1,
        "text": "test has sent no heartbeat for 0.5 s and is gone, so the command of test was aborted; "
        "send it again once the joints are enabled",
    }
    assert (
        "test has sent no heartbeat for 0.5 s and is gone, so its command has ended" in arm.texts("commander_gone")[0]
    )
    arm.run(1000)
    where = positions(arm)
    assert all(abs(a) < abs(b) - 0.01 for a, b in zip(where, ENDS, strict=True))
    answer = client.ask("follow_trajectory", **goal(points=points_from(where)))
    assert answer["result"]["state"] == "succeeded"  # without a promise nothing is kept of the one before


@pytest.mark.rest
def test_a_heartbeat_that_comes_keeps_it_and_one_that_is_not_awaited_does_nothing(arm, client):
    assert client.ask("trajectory_heartbeat")["result"] == {}
    client.send(id=7, method="follow_trajectory", params=goal(heartbeat=0.5))
    for _ in range(5):
        arm.run(400)
        client.send(method="trajectory_heartbeat", params={})
    assert client.next()["result"]["state"] == "succeeded"
    client.send(id=8, method="follow_trajectory", params=goal(points=points_from(positions(arm)), dead_man=True))
    arm.run(900)  # it is silent now, and what it promised is over with the goal before
    assert client.next()["result"]["state"] == "succeeded"
    assert not arm.texts("commander_gone")


@pytest.mark.parametrize(("holder", "gone"), [("me", ["me"]), ("another", []), (None, [])])
def test_a_promise_counts_for_its_own_trajectory_and_for_nothing_that_came_after_it(holder, gone):
    let_go = []
    robot = SimpleNamespace(observers=[], client_disconnected=lambda connection, why: let_go.append(connection))
    methods = api_trajectories.GoalMethods(robot, SimpleNamespace(register=lambda *_: None), print)
    life = CommandTimeout()
    life.holder = holder
    methods._heartbeats["me"] = api_trajectories._RequiredHeartbeat(life, 10, 0)
    (observer,) = robot.observers
    observer.after_cycle(10)
    assert (let_go, list(methods._heartbeats)) == ([], ["me"])
    observer.after_cycle(11)
    assert (let_go, list(methods._heartbeats)) == (gone, [])


def test_another_client_can_cancel_it(arm, client, other):
    client.send(id=1, method="follow_trajectory", params=goal())
    arm.run(500)
    assert other.ask("cancel_trajectory", controller=ARM)["result"] == {}
    assert client.next()["result"]["state"] == "canceled"
    refused = other.ask("cancel_trajectory", controller=ARM)["error"]
    assert "is not executing a trajectory; nothing was cancelled" in str(refused)


@pytest.mark.rest
@pytest.mark.parametrize(
    ("wrong", "text"),
    [
        ({"joints": JOINTS[:5]}, "it names 5 of 6 joints"),
        ({"joints": [*JOINTS[:5], "joint_7"]}, "'joint_7'"),
        ({"points": []}, "it has no points"),
        ({"points": [{"positions": [9.0] * 6, "time_from_start": 9.0}]}, "joint_1 at 9 is beyond its limits of -3.1"),
        ({"points": [{"positions": [1.0] * 6}]}, "it begins with joint_1 at 1 after 0 s, but joint_1 is at"),
        ({"controller": "joint_state_broadcaster"}, "is not a joint trajectory controller"),
        ({"stamp": 1.0}, "it ended"),
    ],
)
def test_a_bad_goal_is_refused_with_its_reason_and_nothing_moves(arm, client, wrong, text):
    where = positions(arm)
    assert text in client.ask("follow_trajectory", **goal(**wrong))["error"]["message"]
    arm.run(500)
    assert positions(arm) == pytest.approx(where, abs=1e-4)


@pytest.mark.rest
def test_more_points_than_anybody_plans_are_refused_and_forgotten(client):
    empty = [{}] * 1000
    for _ in range(MAX_POINTS // 1000):
        assert client.ask("trajectory_data", points=empty)["result"] == {}
    assert f"{MAX_POINTS} points at most" in client.ask("trajectory_data", points=empty)["error"]["message"]
    assert client.ask("follow_trajectory", **goal())["result"]["state"] == "succeeded"


@pytest.mark.rest
def test_a_goal_that_is_sent_is_accepted_at_once_and_its_end_is_reported_later(arm, client):
    assert "send_trajectory" in client.ask("trajectory_end")["error"]["message"]
    begin = arm.reactor.now()
    verdict = client.ask("send_trajectory", **goal())["result"]
    assert verdict == {
        "accepted": True, "error_code": 0, "text": "", "feedback_rate": 20.0, "outlives_client": False,
    }  # fmt: skip
    assert (arm.reactor.now() - begin) / 1e9 < 0.1
    assert client.ask("trajectory_end")["result"]["state"] == "succeeded"
    assert client.ask("trajectory_end")["result"]["state"] == "succeeded"  # it has ended, whenever one asks
    arm.run(300)
    assert positions(arm) == pytest.approx(ENDS, abs=1e-3)


@pytest.mark.rest
@pytest.mark.parametrize(
    ("wrong", "code"),
    [
        ({"joints": JOINTS[:5]}, -2),
        ({"joints": []}, -2),
        ({"joints": [*JOINTS[:5], "joint_7"]}, -2),
        ({"stamp": 1.0}, -3),
        ({"points": []}, -1),
        ({"points": [{"positions": [0.0] * 6, "velocities": [1.0] * 6, "time_from_start": 1.0}]}, -1),
        ({"points": [{"positions": [0.0] * 6, "time_from_start": value} for value in (1.0, 1.0)]}, -1),
        ({"points": [{"positions": [0.0] * 5, "time_from_start": 1.0}]}, -1),
        ({"points": [{"positions": [0.0] * 6, "effort": [1.0] * 6, "time_from_start": 1.0}]}, -1),
        ({"points": [{"positions": [9.0] * 6, "time_from_start": 9.0}]}, -1),
    ],
)
def test_a_goal_that_is_sent_and_refused_has_the_code_of_its_rule(client, wrong, code):
    verdict = client.ask("send_trajectory", **goal(**wrong))["result"]
    assert (verdict["accepted"], verdict["error_code"]) == (False, code)
    assert "refuses the trajectory" in verdict["text"]


def test_a_goal_that_nothing_could_follow_is_refused_by_the_same_answer(arm, client):
    assert client.ask("stop", latch=True)["result"] == {}
    verdict = client.ask("send_trajectory", **goal())["result"]
    assert (verdict["accepted"], verdict["error_code"]) == (False, -1)
    assert "latched" in verdict["text"]
    assert "latched" in client.ask("scale_trajectory", controller=ARM, factor=0.5)["error"]["message"]


@pytest.mark.rest
def test_a_newer_goal_takes_the_place_of_one_and_only_its_own_can_be_cancelled(arm, client, other):
    assert client.ask("send_trajectory", **goal())["result"]["accepted"]
    arm.run(500)
    here = dict(zip(JOINTS, positions(arm), strict=True))
    more = [{"positions": [*here.values()], "time_from_start": 0.5}]
    assert other.ask("send_trajectory", **goal(points=more))["result"]["accepted"]
    ended = client.ask("trajectory_end")["result"]
    assert (ended["state"], ended["error_code"], ended["text"]) == ("aborted", -1, "another goal has replaced it")
    assert client.ask("cancel_trajectory", controller=ARM, own=True)["result"] == {}  # it has ended already
    assert other.ask("trajectory_end")["result"]["state"] == "succeeded"


def test_why_a_goal_was_cancelled_is_in_its_result(arm, client):
    assert client.ask("send_trajectory", **goal())["result"]["accepted"]
    assert client.ask("cancel_trajectory", controller=ARM, own=True, why="lunch")["result"] == {}
    ended = client.ask("trajectory_end")["result"]
    assert (ended["state"], ended["text"]) == ("canceled", "the goal was cancelled: lunch")


@pytest.mark.rest
def test_a_trajectory_that_is_not_a_goal_is_followed_and_ends_with_its_connection(arm, client, other):
    trajectory = {"controller": ARM, "joints": JOINTS, "points": points()}
    assert client.ask("set_trajectory", **trajectory)["result"] == {}
    arm.run(500)
    client.close()
    arm.until(lambda: arm.texts("commander_gone"))
    arm.run(1000)
    assert all(0.1 < abs(a) < abs(b) - 0.01 for a, b in zip(positions(arm), ENDS, strict=True))
    refused = other.ask("set_trajectory", **{**trajectory, "points": []})["error"]
    assert (refused["kind"], "no points" in refused["message"]) == ("TrajectoryRefused", True)


@pytest.mark.rest
def test_what_the_trajectory_reports_can_be_asked_for_and_its_time_scaled(arm, client):
    assert client.ask("scale_trajectory", controller=ARM, factor=0.5)["result"] == {}
    assert client.ask("send_trajectory", **goal())["result"]["accepted"]
    arm.run(100)
    now = (arm.reactor.now() + arm.robot.wall_offset_ns) / 1e9
    then = client.ask("query_trajectory", controller=ARM, time=now + 0.5)["result"]
    assert then["known"]
    assert then["joints"] == JOINTS
    assert 0.0 < then["point"]["positions"][0] < ENDS[0]
    late = client.ask("query_trajectory", controller=ARM, time=now + 99.0)["result"]
    assert not late["known"]
    assert "no trajectory at that time" in late["text"]
    begin = arm.reactor.now()
    assert client.ask("trajectory_end")["result"]["state"] == "succeeded"
    assert 2.5 < (arm.reactor.now() - begin) / 1e9 < 3.2


def test_a_controller_that_follows_nothing_reports_this(arm, client):
    for method, more in (("query_trajectory", {"time": 0.0}), ("scale_trajectory", {"factor": 1.0})):
        error = client.ask(method, controller="joint_state_broadcaster", **more)["error"]
        assert "is not a joint trajectory controller" in error["message"]
    arm.robot.switch([], [ARM], strict=True)
    assert "is inactive" in client.ask("query_trajectory", controller=ARM, time=0.0)["result"]["text"]


def test_while_a_stop_is_latched_no_trajectory_is_taken(client):
    assert client.ask("stop", latch=True)["result"] == {}
    assert "latched" in client.ask("follow_trajectory", **goal())["error"]["message"]
