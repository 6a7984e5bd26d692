from __future__ import annotations

import json

import pytest
from support.ros import eventually

pytestmark = pytest.mark.ros
TYPE = "std_msgs/msg/Float64MultiArray"


def topics(stage):
    return stage.peer.order("graph")["topics"]


def test_the_topics_of_a_controller_come_and_go_with_it(fresh):
    loaded = {"name": "later", "type": "x/Y", "state": "inactive", "topic": "commands", "joints": []}
    fresh.robot.controllers.append(loaded)
    assert eventually(lambda: "/later/commands" in topics(fresh))
    fresh.robot.controllers.remove(loaded)
    assert eventually(lambda: "/later/commands" not in topics(fresh))


def test_a_controller_of_another_kind_under_the_same_name_has_other_topics(fresh):
    loaded = {"name": "later", "type": "x/Y", "state": "inactive", "topic": "commands", "joints": []}
    fresh.robot.controllers.append(loaded)
    assert eventually(lambda: "/later/commands" in topics(fresh))
    loaded.update(topic=None, state="active")
    assert eventually(lambda: "/later/commands" not in topics(fresh))
    fresh.robot.controllers.remove(loaded)


def test_a_controller_whose_name_ros_refuses_has_no_topics_and_the_next_one_has(fresh):
    odd = {"name": "not-ros", "type": "x/Y", "state": "active", "topic": "commands", "joints": []}
    later = {**odd, "name": "later"}
    fresh.peer.order("subscribe", topic="/rosout", of="rcl_interfaces/msg/Log", qos="latched")
    fresh.robot.controllers += [odd, later]
    try:
        assert eventually(lambda: "/later/commands" in topics(fresh))
        told = fresh.peer.message("/rosout", lambda message: "not-ros" in message["msg"])["msg"]
    finally:
        del fresh.robot.controllers[-2:]
    assert told.startswith("not-ros has no topics, ROS refuses them: Invalid node name")
    assert "\n" not in told


def knows_that_base_is_inactive(robot):
    """Wait until the bridge has asked for the controllers, and for nothing of them since."""
    assert eventually(lambda: robot.listed.get("base") == "inactive")
    samples = robot._published
    assert eventually(lambda: robot._published > samples + 10)


def test_a_controller_that_is_switched_while_the_bridge_asks_is_not_taken_for_what_it_was_then(fresh):
    robot = fresh.robot
    knows_that_base_is_inactive(robot)
    robot.holds = ("controllers",)
    robot.switch(base="active")
    assert eventually(lambda: robot._held)  # a sample has told it, and the bridge asks for all of them
    robot.switch(base="inactive")
    answer = json.loads(json.dumps(robot._list_controllers()))
    robot.switch(base="active")
    robot.holds = ()
    robot.release_one(answer)
    assert eventually(lambda: robot.listed["base"] == "active")


def test_who_publishes_more_often_than_ros_is_given_is_told_once(fresh):
    knows_that_base_is_inactive(fresh.robot)
    states = fresh.robot.controllers[0]
    states["publish_rate"] = 500.0
    try:
        for state in ("active", "inactive", "active"):  # the bridge asks for the controllers each time
            fresh.robot.switch(base=state)
            assert eventually(lambda state=state: fresh.robot.listed.get("base") == state)
            assert eventually(lambda: fresh.robot.commands("tell"))
    finally:
        del states["publish_rate"]
    (told,) = fresh.robot.commands("tell")
    assert told["kind"] == "ros_rate"
    assert told["text"].startswith("ROS: joint_state_broadcaster (500 Hz): published more often than the state comes")


def test_what_the_bridge_cannot_make_of_a_sample_does_not_end_it(fresh):
    fresh.peer.order("subscribe", topic="/joint_states", of="sensor_msgs/msg/JointState", qos="default")
    before = fresh.robot.joints
    fresh.robot.joints = {"left": {"position": "garbage"}}
    assert eventually(lambda: fresh.bridge.poll() is None and _warned(fresh))
    fresh.robot.joints = before
    fresh.peer.waiting("/joint_states")
    assert fresh.peer.message("/joint_states")["name"] == ["left", "right"]


def _warned(stage):
    if not hasattr(stage, "logging"):
        stage.logging = stage.peer.order("subscribe", topic="/rosout", of="rcl_interfaces/msg/Log", qos="latched")
    return any("sent garbage" in message["msg"] for message in stage.peer.waiting("/rosout"))
