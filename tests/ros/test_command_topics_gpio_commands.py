"""The topic with stand-ins for ROS and the robot; the transport by ROS is that of the other topics."""

from __future__ import annotations

import math

import pytest

pytest.importorskip("std_msgs")

from support.endpoints import Ros, interface

from canopen_control.ros import command_topics
from canopen_control.ros.command_topics import GpioCommands
from canopen_control.rpc.messages.robot import CommandByName
from canopen_control.rpc.messages.state import ControllerReading

pytestmark = pytest.mark.ros
TOPIC = "outputs/commands"


def reading(state="active", outputs=("io/lamp", "io/horn", "valve/open")):
    return ControllerReading(
        name="outputs", type="gpio_controllers/GpioCommandController", state=state, topic="gpio_commands", tells="gpio",
        required_command_interfaces=outputs,
    )  # fmt: skip


def command(**values):
    named = {name.replace("__", "/"): value for name, value in values.items()}
    return CommandByName(controller="outputs", values=named, source="ros", dead_man=True)


def message(*parts):
    """Return a message of (gpio, names, values)."""
    created, inner = (
        interface(f"control_msgs/msg/{name}") for name in ("DynamicInterfaceGroupValues", "InterfaceValue")
    )
    values = [inner(interface_names=list(names), values=list(values)) for _, names, values in parts]
    return created(interface_groups=[gpio for gpio, _, _ in parts], interface_values=values)


@pytest.fixture
def ros(monkeypatch):
    monkeypatch.setattr(command_topics, "interface", interface)
    return Ros()


def asked(ros):
    return [request for request, _ in ros.asked]


def test_the_subscription_is_as_upstreams(ros):
    commands = GpioCommands(ros, reading())
    kind, _, quality = ros.subscriptions[TOPIC]
    assert (kind.__name__, quality.reliability.name) == ("DynamicInterfaceGroupValues", "SYSTEM_DEFAULT")
    commands.close()
    assert ros.left == [TOPIC]


def test_a_message_sets_what_it_names_and_ends_with_the_bridge(ros):
    GpioCommands(ros, reading())
    ros.publish(TOPIC, message(("io", ["horn"], [1.0]), ("valve", ["open"], [0.25])))
    assert asked(ros) == [command(io__horn=1.0, valve__open=0.25)]
    assert ros.collected == []


@pytest.mark.parametrize(
    ("parts", "reported"),
    [
        ([("io", ["lamp", "horn"], [1.0])], "io: 2 interface_names with 1 values; give equal numbers"),
        ([("io", ["lamp"], [1.0, 1.0])], "io: 1 interface_names with 2 values; give equal numbers"),
        ([("io", ["lamp"], [1.0]), ("io", ["bell"], [1.0])],
         "'io/bell' is not an output; the outputs are: io/lamp, io/horn, valve/open"),
        ([("io", ["lamp"], [math.nan])], "io/lamp is nan; give finite numbers"),
        ([("valve", ["open"], [math.inf])], "valve/open is inf; give finite numbers"),
        ([("io", ["lamp"], [1.0]), ("io", ["lamp"], [0.0])], "io/lamp is named twice"),
    ],
)  # fmt: skip
def test_a_message_that_does_not_fit_is_dropped_whole_with_a_sentence(ros, parts, reported):
    GpioCommands(ros, reading())
    ros.publish(TOPIC, message(*parts))
    assert ros.asked == []
    assert ros.collected == [f"{TOPIC}: {reported}; the message was dropped"]


def test_what_comes_before_the_answer_is_put_together_and_nothing_is_lost(ros):
    GpioCommands(ros, reading())
    for step in range(50):
        ros.publish(TOPIC, message(("io", ["lamp" if step % 2 else "horn"], [float(step)])))
    assert asked(ros) == [command(io__horn=0.0)]
    ros.asked[0][1](None, None)
    assert asked(ros)[1:] == [command(io__lamp=49.0, io__horn=48.0)]
    ros.asked[1][1](None, None)
    assert len(ros.asked) == 2


def test_what_waits_for_a_controller_that_was_deactivated_is_gone(ros):
    commands = GpioCommands(ros, reading())
    ros.publish(TOPIC, message(("io", ["lamp"], [1.0])))
    ros.publish(TOPIC, message(("io", ["horn"], [1.0])))
    commands.on_controller(reading("inactive"))
    ros.asked[0][1](None, None)
    assert asked(ros) == [command(io__lamp=1.0)]


def test_a_refusal_of_the_robot_is_reported_and_the_next_message_goes_out(ros):
    GpioCommands(ros, reading())
    ros.publish(TOPIC, message(("io", ["lamp"], [1.0])))
    ros.asked[0][1](None, "a stop is latched")
    ros.publish(TOPIC, message(("io", ["lamp"], [0.0])))
    assert ros.collected == [f"{TOPIC}: a stop is latched"]
    assert asked(ros) == [command(io__lamp=1.0), command(io__lamp=0.0)]
