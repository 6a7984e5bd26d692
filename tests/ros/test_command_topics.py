from __future__ import annotations

import math
import re

import pytest
from support.ros import Peer, eventually

pytestmark = pytest.mark.ros
TOPIC, TYPE = "/forward/commands", "std_msgs/msg/Float64MultiArray"


def commands(stage):
    return stage.robot.commands()


def test_a_message_becomes_a_command_of_that_controller(fresh):
    fresh.peer.order("publish", topic=TOPIC, of=TYPE, data={"data": [10.0, -5.5]}, rate=20)
    assert eventually(lambda: commands(fresh))
    fresh.peer.order("silence", topic=TOPIC)
    assert commands(fresh)[0] == {"controller": "forward", "values": [10.0, -5.5], "source": "ros", "dead_man": True}


def test_every_quality_of_service_is_accepted(fresh):
    assert fresh.peer.order("publish", topic=TOPIC, of=TYPE, data={"data": [7.0, 7.0]}, rate=50)
    for number, qos in enumerate(("best_effort", "latched", "default"), 8):
        topic = TOPIC
        fresh.peer.order("renew", topic=topic)
        fresh.peer.order("publish", topic=topic, of=TYPE, data={"data": [number, 7.0]}, qos=qos, rate=50)
        assert eventually(
            lambda expected=[number, 7.0]: any(command["values"] == expected for command in commands(fresh))
        ), qos
    fresh.peer.order("silence", topic=TOPIC)


def test_values_that_are_not_finite_and_wrong_sizes_never_reach_the_robot(fresh):
    for data in ([math.nan, 1.0], [math.inf, 1.0], [1.0], [1.0, 2.0, 3.0], []):
        for _ in range(3):
            fresh.peer.order("publish", topic=TOPIC, of=TYPE, data={"data": data})
    fresh.peer.order("publish", topic=TOPIC, of=TYPE, data={"data": [3.0, 3.0]}, rate=50)
    assert eventually(lambda: any(command["values"] == [3.0, 3.0] for command in commands(fresh)))
    fresh.peer.order("silence", topic=TOPIC)
    assert {len(command["values"]) for command in commands(fresh)} == {2}
    assert not any(value in (1.0, 2.0) for command in commands(fresh)[:-1] for value in command["values"])


def test_a_controller_that_is_not_active_gets_nothing_until_it_is(fresh):
    fresh.robot.switch(forward="inactive")
    fresh.peer.order("publish", topic=TOPIC, of=TYPE, data={"data": [4.0, 4.0]}, rate=50)
    watched = len(fresh.robot.collected)
    assert eventually(lambda: any(item["method"] == "controllers" for item in fresh.robot.collected))
    before = len(commands(fresh))
    fresh.robot.switch(forward="active")
    assert eventually(lambda: len(commands(fresh)) > before)
    fresh.peer.order("silence", topic=TOPIC)
    assert watched < len(fresh.robot.collected)


def test_a_flood_arrives_as_one_command_per_cycle_with_the_newest_value(fresh):
    fresh.peer.order("flood", topic=TOPIC, of=TYPE, count=3000)
    # again and again, since the subscription is best effort: in a flood any message may be the one that is dropped
    fresh.peer.order("publish", topic=TOPIC, of=TYPE, data={"data": [3000.0, 0.0]}, rate=20)
    assert eventually(lambda: commands(fresh) and commands(fresh)[-1]["values"] == [3000.0, 0.0])
    fresh.peer.order("silence", topic=TOPIC)
    values = [command["values"][0] for command in commands(fresh)]
    assert values == sorted(values)
    assert 0 < sum(value < 3000.0 for value in values) < 1000, "superseded, not queued"


def test_two_publishers_that_alternate_are_named_in_one_warning_of_the_robot(fresh):
    def collected():
        return [command["text"] for command in fresh.robot.commands("tell") if "publish alternately" in command["text"]]

    with Peer(fresh.domain) as other:
        for peer, value in ((fresh.peer, 1.0), (other, 2.0)):
            peer.order("publish", topic=TOPIC, of=TYPE, data={"data": [value, value]}, rate=20)
        assert eventually(collected)
        sent = len(commands(fresh))
        assert eventually(lambda: len(commands(fresh)) > sent + 20)
        fresh.peer.order("silence", topic=TOPIC)
    assert len(collected()) == 1
    assert re.match(
        r"ROS: forward/commands: \d publishers of /peer publish alternately, so the motion jerks", collected()[0]
    )
