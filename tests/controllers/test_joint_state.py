from __future__ import annotations

import math

import pytest
from support.control import BROADCASTER, Hardware, S, add, manager, same, vectors

from canopen_control.controllers.params import Params
from canopen_control.errors import ControlError

CASES = [case for case in vectors("joint_state_broadcaster") if "expect_topic" not in case]
TOPICS = [case for case in vectors("joint_state_broadcaster") if "expect_topic" in case]


def robot(case):
    joints = case.get("joints", ["joint1", "joint2", "joint3"])
    kinds = ("position", "velocity", "effort")
    hardware = Hardware(states=tuple(f"{joint}/{kind}" for joint in joints for kind in kinds))
    for number, joint in enumerate(joints):
        for kind in kinds:
            hardware.set(f"{joint}/{kind}", number + 1.1)
    urdf = case.get("urdf_joints")
    control = manager(hardware, joints=None if urdf is None else tuple(urdf))
    return hardware, control, add(control, "states", BROADCASTER, **case.get("params", {}))


@pytest.mark.parametrize("case", CASES, ids=lambda case: case["name"])
def test_it_gathers_what_upstream_gathers(case):
    hardware, control, states = robot(case)
    if case.get("expect") == "activate ERROR":
        with pytest.raises(ControlError, match="no state interface exists"):
            control.switch(["states"], now=0)
        return
    control.switch(["states"], now=0)
    control.broadcast(S, 0.01)
    assert states.names == (case["expect_name_jazzy"] if "expect_name_jazzy" in case else case["expect_name"])
    assert len(states.positions) == len(states.velocities) == len(states.efforts) == len(states.names)
    for key, array in (("expect_velocity", states.velocities), ("expect_effort", states.efforts)):
        assert all(same(a, b) for a, b in zip(array, case.get(key, array), strict=True))
    if "expect_extra_value" in case:
        assert states.positions[3:] == [case["expect_extra_value"]] * 3
    if "expect_dynamic_names" in case:
        assert list(states.dynamic_joint_states()) == case["expect_dynamic_names"]
    assert states.stamp == S
    del hardware


def test_values_are_overwritten_in_place_and_missing_interfaces_stay_nan():
    hardware = Hardware(states=("a/position", "b/velocity", "b/temperature"))
    control = manager(hardware)
    states = add(control, "states", BROADCASTER)
    control.switch(["states"], now=0)
    positions = states.positions
    hardware.set("a/position", 1.5)
    hardware.set("b/velocity", 2.5)
    control.broadcast(S, 0.01)
    assert states.positions is positions
    assert states.names == ["a", "b"]
    assert positions[0] == 1.5
    assert math.isnan(positions[1])
    assert states.velocities[1] == 2.5
    assert math.isnan(states.dynamic_joint_states()["b"]["temperature"])


def told(*states, **params):
    control = manager(Hardware(states=states))
    add(control, "states", BROADCASTER, **params)
    control.switch(["states"], now=0)
    return control.list()[0]


def test_the_list_tells_what_it_reads_once_it_runs():
    control = manager(Hardware(states=("a/position",)))
    add(control, "states", BROADCASTER)
    assert control.list()[0].tells == {}
    assert told("a/position", "b/velocity", "b/temperature").tells == {
        "a": {"position": "position"},
        "b": {"velocity": "velocity", "temperature": "temperature"},
    }
    few = told("a/position", "a/velocity", "b/position", joints=["a"], interfaces=["position"])
    assert few.as_dict()["tells"] == {"a": {"position": "position"}}


def test_an_extra_joint_is_a_constant_unless_it_is_read():
    zero = dict.fromkeys(("position", "velocity", "effort"))
    info = told("a/position", extra_joints=["x", "a", "x"])
    assert (info.joints, info.tells) == (("a", "x"), {"a": {"position": "position"}, "x": zero})
    hardware = Hardware(states=("a/position",))
    control = manager(hardware)
    states = add(control, "states", BROADCASTER, extra_joints=["a", "x"])
    hardware.set("a/position", 1.5)
    control.switch(["states"], now=0)
    assert states.positions == [1.5, 0.0]
    assert math.isnan(states.velocities[0])
    assert states.dynamic_joint_states() == {"a": {"position": 1.5}, "x": dict.fromkeys(zero, 0.0)}


def test_a_mapped_interface_is_told_by_the_name_of_its_column():
    info = told("a/angle", "a/position", "a/load", map_interface_to_joint_state__position="angle")
    assert info.tells == {"a": {"position": "angle", "load": "load"}}


def test_an_interface_may_be_mapped_to_another_column():
    hardware = Hardware(states=("a/angle",))
    control = manager(hardware)
    states = add(control, "states", BROADCASTER, map_interface_to_joint_state__position="angle")
    hardware.set("a/angle", 0.5)
    control.switch(["states"], now=0)
    assert states.positions == [0.5]


@pytest.mark.parametrize("case", TOPICS, ids=lambda case: case["name"])
def test_it_publishes_where_upstream_publishes(case):
    control = manager(Hardware(states=("a/position",)))
    states = add(control, "joint_state_broadcaster", BROADCASTER, **case["params"])
    assert states.publishes[0] == case["expect_topic"]
    assert states.publishes[1] == case["expect_topic"].replace("joint_states", "dynamic_joint_states")
    assert states.frame_id == "base_link"


def test_several_broadcasters_have_topics_and_frames_of_their_own():
    control = manager(Hardware(states=("a/position",)))
    left = add(control, "left", BROADCASTER, use_local_topics=True, frame_id="left_base")
    right = add(control, "right", BROADCASTER, use_local_topics=True, publish_dynamic_joint_states=False, frame_id="")
    assert (left.publishes, left.frame_id) == (("left/joint_states", "left/dynamic_joint_states"), "left_base")
    assert (right.publishes, right.frame_id) == (("right/joint_states",), "")


def test_the_list_tells_its_topics_once_it_is_configured():
    control = manager(Hardware(states=("a/position",)))
    control.load("states", BROADCASTER, Params.of({"frame_id": "world"}))
    assert control.list()[0].publishes == ()
    control.configure("states")
    (told,) = control.list()
    assert told.as_dict()["publishes"] == ["joint_states", "dynamic_joint_states"]
    assert told.frame_id == "world"
