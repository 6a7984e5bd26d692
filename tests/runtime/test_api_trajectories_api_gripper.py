"""Goals of a gripper over the socket of a robot: the goal's answer is its end, and its connection's end is its own."""

import pytest
from support.apiclient import Client
from support.arm6 import copy_arm
from support.robots import Bench

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
def config(tmp_path_factory):
    folder = copy_arm(tmp_path_factory.mktemp("gripper"))
    control = folder / "ros2_controllers.yaml"
    control.write_text(control.read_text() + YAML)
    return folder


@pytest.fixture
def arm(config):
    bench = Bench("gripperapi", config=config, drives=range(2, 8), controllers=[GRIPPER])
    bench.api = ApiServer(bench.robot)
    bench.start()
    bench.until(lambda: bench.robot.joints["joint_6"].enabled)
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


def position(arm):
    return arm.robot.registry.state("joint_6/position").value


def test_a_goal_is_answered_when_it_has_ended_with_where_the_gripper_is(arm, client):
    result = client.ask("move_gripper", controller=GRIPPER, position=0.3)["result"]
    assert (result["state"], result["reached_goal"], result["stalled"]) == ("succeeded", True, False)
    assert result["position"] == pytest.approx(0.3, abs=0.011)
    assert result["text"] == "the goal was reached"
    client.close()
    arm.run(500)
    assert position(arm) == pytest.approx(0.3, abs=1e-3)


def test_one_that_is_sent_is_judged_at_once_and_its_end_is_told_to_who_asks(arm, client):
    verdict = client.ask("send_gripper", controller=GRIPPER, position=0.3)["result"]
    assert (verdict["accepted"], verdict["feedback_rate"]) == (True, 20.0)
    assert abs(position(arm)) < 0.1
    assert client.ask("gripper_end")["result"]["state"] == "succeeded"


@pytest.mark.rest
def test_the_end_of_its_connection_ends_it_and_the_joint_is_held(arm, client):
    client.ask("send_gripper", controller=GRIPPER, position=3.0, source="test")
    arm.run(300)
    client.close()
    arm.until(lambda: arm.texts("goal_aborted"))
    assert any("test is gone, so the goal of test was taken back" in text for text in arm.texts("goal_aborted"))
    arm.run(500)
    where = position(arm)
    assert 0.0 < where < 2.5
    arm.run(500)
    assert position(arm) == pytest.approx(where, abs=1e-3)


@pytest.mark.rest
def test_a_sender_that_falls_silent_is_gone_though_its_connection_stands(arm, client):
    client.ask("send_gripper", controller=GRIPPER, position=6.0, heartbeat=0.5)
    for _ in range(4):
        arm.run(200)
        client.ask("trajectory_heartbeat")
    assert arm.texts("goal_aborted") == []
    arm.run(700)
    assert any("has said nothing for 0.5 s and is gone" in text for text in arm.texts("goal_aborted"))


@pytest.mark.rest
def test_another_client_can_cancel_it_and_own_cancels_only_ones_own(arm, client, other):
    client.ask("send_gripper", controller=GRIPPER, position=3.0)
    client.send(id=7, method="gripper_end", params={})
    arm.run(200)
    assert other.ask("cancel_gripper", controller=GRIPPER, own=True)["result"] == {}
    arm.run(50)
    assert client.messages() == []
    assert other.ask("cancel_gripper", controller=GRIPPER, why="enough")["result"] == {}
    result = client.next()["result"]
    assert (result["state"], result["text"]) == ("canceled", "the goal was cancelled: enough")


@pytest.mark.rest
@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"position": 9.0}, "the limits of joint_6, got 9"),
        ({"max_effort": -1.0}, "with a max_effort of -1"),
        ({"controller": "joint_state_broadcaster"}, "is no gripper action controller"),
        ({"controller": "arm_controller"}, "arm_controller is unloaded"),
    ],
)
def test_a_goal_that_cannot_be_is_refused(client, wrong, words):
    verdict = client.ask("send_gripper", **{"controller": GRIPPER, "position": 0.1, **wrong})["result"]
    assert not verdict["accepted"]
    assert words in verdict["text"]


def test_without_a_goal_nothing_has_an_end(client):
    assert "no goal came on this connection" in client.ask("gripper_end")["error"]["message"]
