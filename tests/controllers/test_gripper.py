from __future__ import annotations

import math

import pytest
from support.control import Hardware, add, manager

from canopen_control.controllers.command_timeout import GoalState
from canopen_control.controllers.gripper import (
    EffortGripperActionController,
    EffortGripperParams,
    GripperParams,
    ParallelGripperActionController,
    PositionGripperActionController,
    read_params,
)
from canopen_control.controllers.params import Params
from canopen_control.controllers.request_protocols import GripperGoal
from canopen_control.errors import ControlError, RobotConfigError
from canopen_control.urdf.joint_element import Joint, UrdfLimits

POSITION = "position_controllers/GripperActionController"
EFFORT = "effort_controllers/GripperActionController"
PARALLEL = "parallel_gripper_action_controller/GripperActionController"
MS = 1_000_000
SUCCEEDED, ABORTED, CANCELED = GoalState.SUCCEEDED, GoalState.ABORTED, GoalState.CANCELED
LIMITS = {"max_effort_interface": "finger/max_effort", "max_velocity_interface": "finger/max_velocity"}


class Gripper:
    """A gripper with an active controller; `step` is a cycle of 10 ms in which the joint is somewhere."""

    def __init__(self, type_name=POSITION, *extra, limits=None, **params):
        commanded = "effort" if type_name == EFFORT else "position"
        states = tuple(f"finger/{name}" for name in ("position", "velocity", "effort"))
        self.hardware = Hardware(f"finger/{commanded}", *extra, states=states)
        self.control, self.now = manager(self.hardware), 0
        if limits is not None:
            self.control._description = {"finger": Joint("finger", "prismatic", "base", "finger", limits=limits)}
        self.controller = add(self.control, "gripper", type_name, joint="finger", **params)
        self.set(0.0)
        self.control.switch(["gripper"], now=0)
        self.control.events()

    def set(self, position, velocity=0.0, effort=0.0):
        for name, value in (("position", position), ("velocity", velocity), ("effort", effort)):
            self.hardware.set(f"finger/{name}", value)

    def send(self, position, max_effort=None, max_velocity=None, **how):
        goal = GripperGoal(position, max_effort, max_velocity)
        self.control.send_goal("gripper", goal, self.now, **how)
        return goal

    def step(self, position=None, velocity=0.0, *, count=1):
        for _ in range(count):
            self.now += 10 * MS
            if position is not None:
                self.set(position, velocity)
            self.control.update(self.now, 0.01)
        return [interface.value for interface in self.hardware.command_interfaces]


def same(found, *expected):
    return [repr(item) for item in found] == [repr(item) for item in expected]


def test_nothing_is_written_before_the_first_goal():
    assert same(Gripper().step(count=5), math.nan)
    assert Gripper(EFFORT, gains={"finger": {"p": 10.0}}, max_effort=5.0).step(0.3) == [0.0]


def test_a_goal_is_reached_within_its_tolerance_and_held():
    gripper = Gripper(state_interfaces=["position", "velocity", "effort"])
    goal = gripper.send(0.05)
    assert gripper.step(0.02, 0.1) == [0.05]
    assert not goal.ended
    gripper.set(0.0405, 0.1, effort=3.5)
    assert gripper.step() == [0.05]
    assert (goal.state, goal.reached, goal.stalled) == (SUCCEEDED, True, False)
    assert (goal.at, goal.effort) == (0.0405, 3.5)
    assert gripper.step(count=100) == [0.05]


def test_a_stall_aborts_and_the_joint_is_held_where_it_is():
    gripper = Gripper(stall_timeout=0.5)
    goal = gripper.send(0.05)
    gripper.step(0.02, 0.1, count=10)
    gripper.step(0.03, 0.0, count=50)
    assert not goal.ended
    assert same(gripper.step(), math.nan)
    assert (goal.state, goal.reached, goal.stalled, goal.at) == (ABORTED, False, True, 0.03)
    assert goal.text == "finger has stalled at 0.03, 0.02 before the goal; it is held there"
    assert [event.kind for event in gripper.control.events()] == ["goal_aborted"]


def test_a_stall_that_is_allowed_succeeds_and_continues_gripping():
    gripper = Gripper(stall_timeout=0.1, allow_stalling=True)
    goal = gripper.send(0.05)
    assert gripper.step(0.03, 0.0, count=12) == [0.05]
    assert (goal.state, goal.reached, goal.stalled) == (SUCCEEDED, False, True)
    assert gripper.step(count=100) == [0.05]


def test_a_grip_outlives_its_client_and_a_goal_does_not():
    gripper = Gripper(stall_timeout=0.1, allow_stalling=True)
    gripper.send(0.05, holder="me")
    gripper.step(0.03, count=12)
    gripper.control.running.client_disconnected("me")
    assert gripper.step() == [0.05]
    goal = gripper.send(0.0, source="ros", holder="me")
    gripper.step(0.03, -0.1)
    gripper.control.running.client_disconnected("me")
    assert same(gripper.step(), math.nan)
    assert goal.state is ABORTED
    assert goal.text == "ros is gone, so the goal of ros was aborted; send it again afterwards"


def test_cancelling_holds_and_only_what_is_meant_is_cancelled():
    gripper = Gripper()
    goal = gripper.send(0.05)
    gripper.step(0.01, 0.1)
    gripper.controller.cancel_grip("no more", only=GripperGoal(0.0))
    assert not goal.ended
    gripper.controller.cancel_grip("the client is gone", only=goal)
    assert (goal.state, goal.text) == (CANCELED, "the goal was cancelled: the client is gone")
    assert same(gripper.step(), math.nan)
    gripper.controller.cancel_grip()


def test_a_newer_goal_takes_the_place_of_the_one_under_way():
    gripper = Gripper()
    first, second = gripper.send(0.05), gripper.send(0.02)
    assert (first.state, first.text) == (ABORTED, "another goal has replaced it")
    assert gripper.step(0.0, 0.1) == [0.02]
    assert not second.ended


def test_limits_go_with_the_goal_through_their_interfaces():
    gripper = Gripper(PARALLEL, "finger/max_effort", "finger/max_velocity", **LIMITS)
    assert same(gripper.step(), math.nan, math.nan, math.nan)
    gripper.send(0.05)
    assert gripper.step(0.0, 0.1) == [0.05, 10.0, 0.1]
    gripper.send(0.05, 25.0, 0.02)
    assert gripper.step(0.0, 0.1) == [0.05, 25.0, 0.02]
    gripper.send(0.05, 0.0, 0.0)
    assert gripper.step(0.0, 0.1) == [0.05, 10.0, 0.1]


def test_an_effort_that_nothing_limits_is_reported_once():
    gripper = Gripper()
    gripper.send(0.05)
    assert gripper.control.events() == ()
    gripper.send(0.05, 20.0)
    gripper.send(0.05, 20.0)
    texts = [event.text for event in gripper.control.events() if event.kind == "max_effort"]
    assert texts == [
        "gripper: the max_effort of goals has no effect: set max_effort_interface, or limit the drive (0x6072)"
    ]


@pytest.mark.parametrize("end", ["deactivate", "stop", "disable"])
def test_any_other_end_takes_the_goal_back(end):
    gripper = Gripper()
    goal = gripper.send(0.05)
    gripper.step(0.01, 0.1)
    if end == "deactivate":
        gripper.control.switch((), ["gripper"], now=gripper.now)
    elif end == "stop":
        gripper.control.running.forget(gripper.now, "stop was commanded by me")
    else:
        gripper.hardware.command_interfaces[0].enabled = False
        gripper.step()
        gripper.hardware.command_interfaces[0].enabled = True
    assert goal.state is ABORTED
    if end != "deactivate":
        assert same(gripper.step(count=5), math.nan)


@pytest.mark.parametrize(
    ("sent", "words"),
    [
        ((math.nan,), "cannot move finger to nan; give a finite number"),
        ((math.inf,), "cannot move finger to inf; give a finite number"),
        ((0.01, -1.0), "with a max_effort of -1"),
        ((0.01, math.inf), "with a max_effort of inf"),
        ((0.01, 1.0, -0.5), "with a max_velocity of -0.5"),
        ((0.09,), "expects 0 to 0.08, the limits of finger, got 0.09; nothing was applied"),
        ((-0.01,), "expects 0 to 0.08, the limits of finger, got -0.01"),
    ],
)
def test_a_goal_that_cannot_be_is_refused_and_the_one_before_continues(sent, words):
    gripper = Gripper(limits=UrdfLimits(0.0, 0.08))
    before = gripper.send(0.05)
    with pytest.raises(ControlError) as caught:
        gripper.send(*sent)
    assert words in str(caught.value)
    assert gripper.step(0.0, 0.1) == [0.05]
    assert not before.ended


def test_a_position_that_the_object_behind_cannot_hold_is_refused():
    gripper = Gripper()
    gripper.hardware.command_interfaces[0].highest = 0.04
    with pytest.raises(ControlError, match=r"cannot send 0\.05: the range of finger/position is"):
        gripper.send(0.05)


def test_one_that_is_not_active_takes_no_goal():
    gripper = Gripper()
    gripper.control.switch((), ["gripper"], now=0)
    with pytest.raises(ControlError, match="is inactive; activate it before sending it goals"):
        gripper.send(0.05)


class TestEffort:
    def gripper(self, **params):
        return Gripper(EFFORT, gains={"finger": {"p": 100.0, "d": 2.0}}, **params)

    def test_the_loop_is_limited_by_the_effort_of_the_goal(self):
        gripper = self.gripper()
        gripper.send(0.05, 3.0)
        assert gripper.step(0.03, 0.1) == [pytest.approx(100.0 * 0.02 - 2.0 * 0.1)]
        assert gripper.step(0.0, 0.0) == [3.0]
        assert gripper.step(0.2, 0.0) == [-3.0]

    def test_without_any_effort_a_goal_is_refused(self):
        with pytest.raises(ControlError, match="cannot move: max_effort is 0"):
            self.gripper().send(0.05)

    def test_the_effort_of_the_parameters_is_the_default(self):
        gripper = self.gripper(max_effort=1.5)
        gripper.send(0.05)
        assert gripper.step(0.0) == [1.5]

    def test_an_end_holds_the_joint_where_it_is_with_the_effort_of_the_goal(self):
        gripper = self.gripper(stall_timeout=0.1)
        goal = gripper.send(0.05, 3.0)
        gripper.step(0.03, count=12)
        assert (goal.state, goal.stalled) == (ABORTED, True)
        assert gripper.step(0.03) == [0.0]
        assert gripper.step(0.02) == [pytest.approx(1.0)]

    def test_a_joint_that_is_disabled_has_nothing_to_continue_with(self):
        gripper = self.gripper()
        goal = gripper.send(0.05, 3.0)
        gripper.step(0.0)
        gripper.hardware.command_interfaces[0].enabled = False
        assert gripper.step(0.0) == [0.0]
        gripper.hardware.command_interfaces[0].enabled = True
        assert gripper.step(0.0, count=5) == [0.0]
        assert goal.state is ABORTED

    def test_a_position_that_is_unknown_has_no_effort(self):
        gripper = self.gripper()
        gripper.send(0.05, 3.0)
        assert gripper.step(math.nan) == [0.0]

    def test_a_deactivation_ends_every_effort(self):
        gripper = self.gripper()
        gripper.send(0.05, 3.0)
        gripper.step(0.0)
        gripper.control.switch((), ["gripper"], now=gripper.now)
        assert gripper.hardware.values() == [0.0]


def test_where_it_is_and_was_to_be_is_reported():
    gripper = Gripper(state_interfaces=["position", "velocity", "effort"])
    assert gripper.control.list()[0].tells == "gripper"
    gripper.send(0.05)
    gripper.set(0.02, 0.1, 4.0)
    gripper.step()
    sample = gripper.controller.sample(0)
    assert (sample.time, sample.joint, sample.position, sample.velocity) == (0.01, "finger", 0.02, 0.1)
    assert (sample.effort, sample.target, sample.executing) == (4.0, 0.05, True)
    gripper.step(0.05)
    sample = gripper.controller.sample(0)
    assert (sample.executing, sample.reached_goal, sample.stalled) == (False, True, False)


# -- params


def read(cls=GripperParams, **params):
    return read_params(Params.of({"joint": "finger", **params}), "gripper", cls)


def test_the_gains_of_the_joint_stand_below_its_name():
    inputs = read(EffortGripperParams, gains={"finger": {"p": 20.0, "d": 0.5, "i_clamp_max": 3.0, "i_clamp_min": -3.0}})
    assert (inputs.gains.p, inputs.gains.i, inputs.gains.d) == (20.0, 0.0, 0.5)
    assert (inputs.gains.i_clamp_max, inputs.gains.i_clamp_min) == (3.0, -3.0)
    assert read(EffortGripperParams).gains.p == 0.0


@pytest.mark.parametrize(
    ("params", "words"),
    [
        ({"joint": ""}, "no 'joint'; give it under"),
        ({"state_interfaces": ["position"]}, "state_interfaces lacks velocity"),
        ({"state_interfaces": ["position", "velocity", "position"]}, "contain an interface twice"),
        ({"max_effort_interface": "f/x", "max_velocity_interface": "f/x"}, "contain an interface twice"),
        ({"max_effort": -1.0}, "max_effort"),
        ({"goal_tolerance": -0.1}, "goal_tolerance"),
        ({"action_monitor_rate": 0.05}, "action_monitor_rate"),
    ],
)
def test_what_cannot_be_is_reported(params, words):
    with pytest.raises(RobotConfigError, match=words):
        read(**params)


def test_all_mistakes_are_reported_at_once_each_on_a_line():
    with pytest.raises(RobotConfigError) as refused:
        read(joint="", state_interfaces=["position"])
    assert len(str(refused.value).splitlines()) == 2


@pytest.mark.parametrize(
    ("kind", "params", "key"),
    [
        (EffortGripperActionController, {"max_effort": 0.0}, "max_effort"),
        (EffortGripperActionController, {}, None),  # the default
        (PositionGripperActionController, {"max_effort": 0.0}, None),  # no interface limits the effort
        (PositionGripperActionController, {"max_effort": 0.0, "max_effort_interface": "f/e"}, "max_effort"),
        (ParallelGripperActionController, {"max_velocity": 0.0, "max_velocity_interface": "f/v"}, "max_velocity"),
        (ParallelGripperActionController, {"max_velocity": 0.0}, None),
    ],
)
def test_limits_of_zero_are_reported(kind, params, key):
    controller = kind("gripper")
    controller.on_configure(Params.of({"joint": "finger", **params}))
    texts = [event.text for event in controller.notices if event.kind == "immobile"]
    assert [text.partition(",")[0] for text in texts] == ([f"gripper: {key} is 0"] if key else [])
