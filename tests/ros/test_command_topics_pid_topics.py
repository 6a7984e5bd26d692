"""The topics with stand-ins for ROS and the robot; nothing is sent."""

from __future__ import annotations

import math

import pytest
from msgspec.structs import replace

pytest.importorskip("std_msgs")

from support.endpoints import Ros, interface, publisher_of

from canopen_control.ros import command_topics, sample_publisher
from canopen_control.ros.command_topics import FeedForwardSwitch, PidMeasuredStates, PidReferences
from canopen_control.rpc.messages.declare import Done
from canopen_control.rpc.messages.robot import CommandController, SetFeedForward, SetMeasuredStates
from canopen_control.rpc.messages.samples import DofReading, PidSample
from canopen_control.rpc.messages.state import ControllerReading, StateSample

pytestmark = pytest.mark.ros
TOPIC = "pid/reference"
NAN = math.nan


def reading(*interfaces, state="active"):
    """Return a controller of two joints, whose references have names of their own."""
    return ControllerReading(
        name="pid", type="pid_controller/PidController", state=state, topic="reference", tells="pid",
        required_command_interfaces=("a/effort", "b/effort") if interfaces else (),
        reference_interfaces=tuple(f"pid/{dof}/{item}" for item in interfaces for dof in ("x", "left/y")),
    )  # fmt: skip


@pytest.fixture
def ros(monkeypatch):
    for module in (command_topics, sample_publisher):
        monkeypatch.setattr(module, "interface", interface, raising=False)
    return Ros()


class TestReferences:
    def take(self, ros, values, rates=(), names=()):
        created = interface("control_msgs/msg/MultiDOFCommand")
        ros.publish(TOPIC, created(dof_names=list(names), values=list(values), values_dot=list(rates)))
        return [item.values for item in ros.commanded]

    def test_the_subscription_is_as_upstreams(self, ros):
        references = PidReferences(ros, reading("position"))
        kind, _, quality = ros.subscriptions[TOPIC]
        assert kind.__name__ == "MultiDOFCommand"
        assert (quality.depth, quality.reliability.name, quality.durability.name) == (
            1,
            "BEST_EFFORT",
            "SYSTEM_DEFAULT",
        )
        references.close()
        assert ros.left == [TOPIC]

    def test_a_message_becomes_a_command_that_ends_with_the_bridge(self, ros):
        PidReferences(ros, reading("position"))
        self.take(ros, [1.0, 2.0])
        assert ros.commanded == [CommandController(controller="pid", values=[1.0, 2.0], source="ros", dead_man=True)]

    def test_values_and_derivatives_are_put_in_order_by_name(self, ros):
        PidReferences(ros, reading("position", "velocity"))
        assert self.take(ros, [1.0, 2.0], [0.1, 0.2], ["left/y", "x"]) == [[2.0, 1.0, 0.2, 0.1]]

    @pytest.mark.parametrize("rates", [[], [NAN, NAN], [NAN]])
    def test_derivatives_of_which_nothing_is_known_are_none(self, ros, rates):
        PidReferences(ros, reading("position", "velocity"))
        assert self.take(ros, [1.0, 2.0], rates) == [[1.0, 2.0]]
        assert ros.collected == []

    def test_derivatives_that_the_controller_does_not_take_are_reported_and_left_out(self, ros):
        PidReferences(ros, reading("position"))
        assert self.take(ros, [1.0, 2.0], [0.1, 0.2]) == [[1.0, 2.0]]
        assert "values_dot is ignored" in ros.collected[0]

    @pytest.mark.parametrize(
        ("values", "rates", "names", "reported"),
        [
            ([1.0], [], [], "values has 1 numbers for x, left/y; give 2"),
            ([], [], [], "values has 0 numbers for x, left/y; give 2"),
            ([1.0, NAN], [], [], "values of left/y is nan; give finite numbers"),
            ([math.inf, 1.0], [], ["left/y", "x"], "values of left/y is inf; give finite numbers"),
            ([1.0, 2.0], [0.1, NAN], [], "values_dot of left/y is nan; give finite numbers"),
            ([1.0, 2.0], [0.1], [], "values_dot has 1 numbers for x, left/y; give 2"),
            ([1.0, 2.0], [], ["x", "a"], "'a' is not one of x, left/y"),
            ([1.0, 2.0], [], ["x", "x"], "dof_names is x, x; give each of x, left/y once"),
            ([1.0], [], ["x"], "dof_names is x; give each of x, left/y once"),
        ],
    )
    def test_what_is_not_whole_is_dropped_with_the_joints_name(self, ros, values, rates, names, reported):
        PidReferences(ros, reading("position", "velocity"))
        assert self.take(ros, values, rates, names) == []
        assert ros.collected == [f"{TOPIC}: {reported}; the message was dropped"]


class TestState:
    def sample(self, time):
        x = DofReading(name="x", reference=1.0, feedback=0.75, feedback_dot=0.5, error=0.25, error_dot=-0.5,
                       time_step=0.01, output=2.0)  # fmt: skip
        y = DofReading(name="left/y", reference=None, feedback=None, feedback_dot=None, error=None, error_dot=None,
                       time_step=0.01, output=0.0)  # fmt: skip
        return StateSample(samples={"pid": PidSample(time=time, dofs=[x, y])})

    def test_what_is_not_known_is_nan(self, ros):
        publisher_of(ros, reading("position"), "controller_state").on_state(self.sample(1.0))
        fields = ("name", "reference", "feedback", "feedback_dot", "error", "error_dot", "time_step", "output")
        x, y = ([getattr(state, name) for name in fields] for state in ros.publishers[0].collected[0].dof_states)
        assert x == ["x", 1.0, 0.75, 0.5, 0.25, -0.5, 0.01, 2.0]
        assert [y[0], y[6], y[7]] == ["left/y", 0.01, 0.0]
        assert all(map(math.isnan, y[1:6]))


class TestFeedForward:
    NAME = "pid/set_feedforward_control"

    def ask(self, ros, wanted, error):
        kind, handler = ros.services[self.NAME]
        replies = []
        handler(kind.Request(data=wanted), kind.Response(), replies.append)
        request, answer = ros.asked[-1]
        assert request == SetFeedForward(controller="pid", enabled=wanted)
        answer(None if error else Done(), error)
        return [(reply.success, reply.message) for reply in replies]

    def test_it_is_switched_and_a_refusal_is_the_response(self, ros):
        switch = FeedForwardSwitch(ros, reading("position"))
        assert self.ask(ros, True, None) == [(True, "")]
        assert self.ask(ros, False, None) == [(True, "")]
        assert self.ask(ros, True, "no controller 'pid' is loaded") == [(False, "no controller 'pid' is loaded")]
        switch.close()
        assert ros.left == [self.NAME]


class TestMeasuredStates:
    TOPIC = "pid/measured_state"

    def test_the_topic_is_there_once_the_controller_claims_no_states(self, ros):
        measured = PidMeasuredStates(ros, replace(reading("position"), required_state_interfaces=("x/position",)))
        assert self.TOPIC not in ros.subscriptions
        measured.on_controller(reading("position"))
        kind, _, quality = ros.subscriptions[self.TOPIC]
        assert (kind.__name__, quality.depth, quality.reliability.name) == ("MultiDOFCommand", 1, "BEST_EFFORT")
        measured.close()
        assert ros.left == [self.TOPIC]

    def test_a_message_becomes_what_was_measured_in_the_order_of_the_degrees_of_freedom(self, ros):
        PidMeasuredStates(ros, reading("position", "velocity"))
        created = interface("control_msgs/msg/MultiDOFCommand")
        message = created(dof_names=["left/y", "x"], values=[1.0, 2.0], values_dot=[0.1, 0.2])
        ros.publish(self.TOPIC, message)
        ((request, answer),) = ros.asked
        assert request == SetMeasuredStates(controller="pid", values=[2.0, 1.0, 0.2, 0.1])
        assert ros.commanded == []
        answer(None, "no")
        assert ros.collected == [f"{self.TOPIC}: no"]
