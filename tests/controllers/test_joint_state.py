from __future__ import annotations

from itertools import pairwise

import pytest
from support.control import BROADCASTER, Hardware, S, add, manager, same, vectors

from canopen_control.controllers.params import Params
from canopen_control.errors import ControlError
from canopen_control.ros.conversions import arrays_of

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
    sample = states.sample(0)
    arrays = arrays_of(sample.joints, sample.names)
    assert arrays.names == (case["expect_name_jazzy"] if "expect_name_jazzy" in case else case["expect_name"])
    for key, array in (("expect_velocity", arrays.velocity), ("expect_effort", arrays.effort)):
        assert all(same(a, b) for a, b in zip(array, case.get(key, array), strict=True))
    if "expect_extra_value" in case:
        assert arrays.position[3:] == [case["expect_extra_value"]] * 3
    if "expect_dynamic_names" in case:
        assert list(sample.joints) == case["expect_dynamic_names"]
    assert states.stamp == S
    del hardware


def collected(*states, **params):
    hardware = Hardware(states=states)
    for number, name in enumerate(states):
        hardware.set(name, number + 1.5)
    control = manager(hardware)
    add(control, "states", BROADCASTER, **params)
    assert control.running.samples(0) == {}
    control.switch(["states"], now=0)
    return control.running.samples(0)["states"]


def test_an_extra_joint_is_zero_unless_it_is_read():
    zero = dict.fromkeys(("position", "velocity", "effort"), 0.0)
    sample = collected("a/position", extra_joints=["x", "a", "x"])
    assert (sample.names, sample.joints) == (("a", "x"), {"a": {"position": 1.5}, "x": zero})


def test_a_mapped_interface_is_reported_by_the_name_of_its_column():
    sample = collected("a/angle", "a/position", "a/load", map_interface_to_joint_state__position="angle")
    assert sample.joints == {"a": {"position": 1.5, "load": 3.5}}
    assert sample.names == ("a",)


@pytest.mark.parametrize(("rate", "every"), [(0, 10), (100, 10), (50, 20), (60, 20), (30, 30), (10, 100), (200, 10)])
def test_it_publishes_once_per_update_at_its_own_rate(rate, every):
    """Every so many ms of a manager of 100 Hz; a cycle is taken when it is nearer to the period than the next one."""
    control = manager(Hardware(states=("a/position",)))
    add(control, "states", BROADCASTER, update_rate=rate)
    control.switch(["states"], now=0)
    stamps = []
    for step in range(1, 101):
        control.broadcast(step * S // 100, 0.01)
        stamps += [
            round(control.running.samples(0)["states"].time * 1000) for _ in range(2)
        ]  # every reader gets the same values
    published = list(dict.fromkeys(stamps))
    assert [later - earlier for earlier, later in pairwise(published[1:])] == [every] * (len(published) - 2)
    assert len(published) >= 1000 // every - 1


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


def test_the_list_reports_its_topics_once_it_is_configured():
    control = manager(Hardware(states=("a/position",)))
    control.load("states", BROADCASTER, Params.of({"frame_id": "world"}))
    assert control.list()[0].publishes == ()
    control.configure("states")
    (reported,) = control.list()
    assert reported.publishes == ("joint_states", "dynamic_joint_states")
    assert reported.frame_id == "world"
