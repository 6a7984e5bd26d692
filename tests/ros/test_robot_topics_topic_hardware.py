"""The topics of joint_state_topic_hardware_interface, with the messages of that package."""

from __future__ import annotations

import contextlib
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support import ros
from support.control import vectors

pytestmark = pytest.mark.ros
ARGUMENTS = ("--ros-args", "-p", "topic_hardware:=true", "-p", "rate:=100.0")
COMMANDS, STATES, TYPE = "/robot_joint_commands", "/robot_joint_states", "sensor_msgs/msg/JointState"


def send(stage, **data):
    stage.peer.order("publish", topic=COMMANDS, of=TYPE, data=data)


def settled(stage):
    """Return the commands once a last one has come through."""
    send(stage, name=["left", "right"], velocity=[99.0, 99.0])
    last = {"controller": "forward", "source": "ros", "dead_man": True, "values": [99.0, 99.0]}
    assert ros.eventually(lambda: last in commands(stage))
    return [command["values"] for command in commands(stage) if command["values"] != [99.0, 99.0]]


def commands(stage):
    return stage.robot.commands()


@pytest.fixture(scope="module")
def matched(stage):
    def through():
        send(stage, name=["left", "right"], velocity=[99.0, 99.0])
        return commands(stage)

    assert ros.eventually(through)


def test_velocities_go_to_the_forward_controller_in_its_order(matched, fresh):
    send(fresh, name=["right", "left"], velocity=[2.0, 1.0])
    assert ros.eventually(lambda: [1.0, 2.0] in [command["values"] for command in commands(fresh)])


@pytest.mark.parametrize("velocity", [[1.0], [1.0, 2.0, 3.0]])
def test_an_array_of_ambiguous_length_is_refused_with_all_of_the_message(matched, fresh, velocity):
    send(fresh, name=["left", "right"], velocity=velocity, position=[0.0, 0.0])
    assert settled(fresh) == []


def test_the_states_of_all_joints_are_there_for_best_effort_subscribers(matched, fresh):
    fresh.peer.order("subscribe", topic=STATES, of=TYPE, qos="best_effort")
    message = fresh.peer.message(STATES)
    assert (message["name"], message["position"]) == (["left", "right"], [1.0, 2.0])


@given(st.lists(st.sampled_from(["a", "b", "c"])), st.lists(st.floats()), st.lists(st.floats()))
def test_any_message_gives_finite_values_of_named_joints_or_a_sentence(names, one, other):
    from canopen_control.ros.robot_topics import commanded  # imports ROS messages

    values = {}
    with contextlib.suppress(ValueError):
        values = commanded(names, {"velocity": one, "position": other})
    assert {joint for joint, _ in values} <= set(names)
    assert all(map(math.isfinite, values.values()))


def upstream_message(case):
    """What that package's write() publishes in a case, restated; None for silence."""
    command, state = [list(map(float, case[key])) for key in ("command", "state")]
    quiet = all(abs(expected - result) <= case["threshold"] for expected, result in zip(command, state, strict=True))
    return None if quiet else {"position": [], "velocity": command, "effort": []}


@pytest.mark.parametrize("case", vectors("joint_state_topic_hardware_interface"), ids=lambda case: case["name"])
def test_what_upstream_publishes_commands_what_it_means(case):
    from canopen_control.ros.robot_topics import commanded  # imports ROS messages

    message, wheels = upstream_message(case), ["left_wheel_joint", "right_wheel_joint"]
    if message is None:
        assert case["expect"] == "no JointState published"  # nothing to take: the controller's timeout decides
        return
    assert str(message["velocity"]) == str([float(item) for item in case["expect"]["velocity"]])  # nan is nan
    moving = [float(value) for value in case["command"] if math.isfinite(float(value))]
    assert list(commanded(wheels, message).values()) == moving
