from __future__ import annotations

import math

import pytest
from support.ros import eventually, stamp_of

pytestmark = pytest.mark.ros
TOPIC = "/joint_states"


@pytest.fixture(scope="module")
def listening(stage):
    stage.peer.order("subscribe", topic=TOPIC, of="sensor_msgs/msg/JointState", qos="default")
    stage.peer.message(TOPIC)
    return stage


def test_what_a_broadcaster_reports_becomes_a_joint_state_of_that_time(listening, fresh):
    message = fresh.peer.message(TOPIC)
    assert message["name"] == ["left", "right"]
    assert message["position"] == [1.0, 2.0]
    assert message["velocity"] == [10.0, 20.0]
    assert [math.isnan(value) for value in message["effort"]] == [True, True]
    assert stamp_of(message) == 1_700_000_000.25
    assert message["header"]["frame_id"] == "base_link"


def test_the_order_is_the_broadcasters(listening, fresh):
    before = fresh.robot.controllers[0]["joints"]
    fresh.robot.controllers[0]["joints"] = ["right", "left"]
    fresh.robot.switch(base="active")  # a change that makes the bridge ask again
    try:
        message = fresh.peer.message(TOPIC, lambda message: message["name"] == ["right", "left"])
        assert message["position"] == [2.0, 1.0]
    finally:
        fresh.robot.controllers[0]["joints"] = before
        fresh.robot.switch(base="inactive")


def second_of(message):
    return message["header"]["stamp"]["sec"]


def test_nothing_is_published_while_the_broadcaster_is_not_active(listening, fresh):
    fresh.robot.switch(joint_state_broadcaster="inactive")
    fresh.robot.time = 1_800_000_000.0
    # the samples with the new time may still come until the bridge has seen the switch; a later time never does
    marker = {"name": "marker", "type": "x/Y", "state": "active", "topic": "commands"}
    fresh.robot.controllers.append(marker)
    try:
        topic = "/marker/commands"
        while not fresh.peer.order("publish", topic=topic, of="std_msgs/msg/Float64MultiArray", data={"data": []})[
            "subscribers"
        ]:
            pass
        fresh.robot.time, pushed = 1_850_000_000.0, fresh.robot.pushed
        assert eventually(lambda: fresh.robot.pushed > pushed + 5)
        fresh.robot.time, seconds = 1_900_000_000.0, []
        fresh.robot.switch(joint_state_broadcaster="active")
        fresh.peer.message(TOPIC, lambda message: seconds.append(second_of(message)) or seconds[-1] == 1_900_000_000)
        assert 1_850_000_000 not in seconds
    finally:
        fresh.robot.controllers.remove(marker)
        fresh.robot.time = 1_700_000_000.25


def local(name, *joints, **more):
    """Return a broadcaster with topics of its own."""
    topics = [f"{name}/joint_states", f"{name}/dynamic_joint_states"]
    kind = "joint_state_broadcaster/JointStateBroadcaster"
    return {"name": name, "type": kind, "state": "active", "joints": joints, "topic": None, "is_broadcaster": True,
            "publishes": topics, "frame_id": f"{name}_base", **more}  # fmt: skip


def test_several_broadcasters_publish_on_their_own_with_their_own_frames(listening, fresh, maker):
    bare = local("bare", "right", publishes=["bare/joint_states"])
    one, dynamic = "sensor_msgs/msg/JointState", "control_msgs/msg/DynamicJointState"
    fresh.robot.controllers += [local("west", "left"), bare]
    try:
        for name, joint in (("west", "left"), ("bare", "right")):
            fresh.peer.order("subscribe", topic=f"/{name}/joint_states", of=one, qos="default")
            message = fresh.peer.message(f"/{name}/joint_states")
            assert (message["name"], message["header"]["frame_id"]) == ([joint], f"{name}_base")
        maker.order("subscribe", topic="/west/dynamic_joint_states", of=dynamic, qos="default")
        message = maker.message("/west/dynamic_joint_states")
        assert (message["joint_names"], message["header"]["frame_id"]) == (["left"], "west_base")
        assert "/bare/dynamic_joint_states" not in fresh.peer.order("graph")["topics"]
        fresh.peer.waiting(TOPIC)
        common = fresh.peer.message(TOPIC)
        assert (common["name"], common["header"]["frame_id"]) == (["left", "right"], "base_link")
    finally:
        del fresh.robot.controllers[-2:]


def test_there_is_one_message_per_update_of_the_broadcaster_however_often_the_state_comes(listening, fresh):
    reported = {"kind": "joint_states", "names": ["left"], "joints": {"left": {"position": 4.5}}}
    fresh.robot.samples["joint_state_broadcaster"] = {**reported, "time": 1_750_000_000.0}
    fresh.peer.message(TOPIC, lambda message: message["position"] == [4.5])
    pushed = fresh.robot.pushed
    assert eventually(lambda: fresh.robot.pushed > pushed + 30)
    assert fresh.peer.waiting(TOPIC) == []
    for second in (1_750_000_001, 1_750_000_002):
        fresh.robot.samples["joint_state_broadcaster"] = {**reported, "time": float(second)}
        assert fresh.peer.message(TOPIC)["header"]["stamp"] == {"sec": second, "nanosec": 0}
    assert fresh.peer.waiting(TOPIC) == []


def test_its_topics_move_when_it_is_configured_again(listening, fresh):
    late = local("late", publishes=[], state="unconfigured")
    fresh.robot.controllers.append(late)
    topics = lambda: fresh.peer.order("graph")["topics"]  # noqa: E731
    try:
        late.update(local("late", "left"))
        assert eventually(lambda: "/late/joint_states" in topics())
        late.update(local("late", publishes=[], state="unconfigured"))
        assert eventually(lambda: "/late/joint_states" not in topics())
    finally:
        fresh.robot.controllers.remove(late)
