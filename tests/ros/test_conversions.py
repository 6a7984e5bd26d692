from __future__ import annotations

import math
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.ros import CONTROLLERS
from support.samples import controllers_of

from canopen_control.ros.conversions import (
    command_refusal,
    diagonal,
    joint_arrays,
    located_frames,
    positions_of,
    seconds_of,
    stamp_of,
    transform_of,
)
from canopen_control.rpc.messages.samples import JointStatesSample, OdometrySample, PoseSample
from canopen_control.rpc.messages.state import JointReading, StateSample

JOINTS = {"right": JointReading("right", 2.0, 20.0, None, 1.0), "left": JointReading("left", 1.0, None)}
VIEWS = {each.name: each for each in controllers_of(CONTROLLERS)}


def test_joints_come_alphabetically_unless_the_broadcaster_has_an_order():
    assert joint_arrays(JOINTS).names == ["left", "right"]
    assert joint_arrays(JOINTS, ("right", "left")).names == ["right", "left"]


def test_a_joint_that_is_not_in_the_state_is_omitted():
    assert joint_arrays(JOINTS, ("gone", "left")).names == ["left"]


def broadcaster(**reported):
    (view,) = controllers_of([{"name": "states", **reported}])
    return view


def test_positions_are_those_of_the_joints_of_a_joint_state_that_are_known():
    joints = {"a": {"position": 1.0}, "b": {"position": None}, "c": {"velocity": 2.0}, "sensor": {"position": 9.0}}
    sample = JointStatesSample(time=0.0, names=("a", "b", "c"), joints=joints)
    assert positions_of(sample) == {"a": 1.0}


@given(st.floats(0, 4e9))
def test_a_stamp_is_the_time_in_valid_parts(time):
    seconds, nanoseconds = stamp_of(time)
    assert 0 <= nanoseconds < 1_000_000_000
    assert seconds + nanoseconds / 1e9 == pytest.approx(time, abs=1e-6)


def test_a_stamp_of_zero_is_none_and_any_other_is_a_time():
    assert seconds_of(0, 0) is None
    assert seconds_of(12, 500_000_000) == 12.5
    assert seconds_of(0, 1) == 1e-9


def test_a_covariance_is_a_diagonal_of_six():
    covariance = diagonal([1, 2, 3, 4, 5, 6])
    assert covariance[0::7] == [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
    assert sum(covariance) == 21.0
    assert diagonal(()) == [0.0] * 36


def test_controllers_are_read_as_the_api_reports_them():
    views = VIEWS
    assert list(views) == ["joint_state_broadcaster", "forward", "base"]
    assert (views["forward"].width, views["forward"].topic, views["forward"].active) == (2, "commands", True)
    assert (views["base"].topic, views["base"].active) == ("cmd_vel", False)
    states = views["joint_state_broadcaster"]
    assert states.is_broadcaster
    assert (states.publishes, states.frame_id) == (("joint_states", "dynamic_joint_states"), "base_link")
    assert (views["base"].publishes, views["base"].frame_id) == ((), "")


def test_a_topic_is_found_by_its_last_word():
    view = broadcaster(publishes=["x/dynamic_joint_states", "x/joint_states"])
    assert view.published("joint_states") == "x/joint_states"
    assert view.published("dynamic_joint_states") == "x/dynamic_joint_states"
    assert view.published("states") is None


def test_a_controller_has_the_width_that_it_claims_where_nothing_else_is_known():
    assert broadcaster(claimed_interfaces=["a/velocity"]).width == 1
    assert broadcaster().width == 0


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        ([1.0, 2.0], None),
        ([1.0], "forward expects 2 values, got 1; the command was dropped"),
        ([1.0, math.nan], r"forward: a value is not finite: \[1, nan\]; the command was dropped"),
        ([math.inf] * 20, r"not finite: \[inf, inf, inf, inf, inf, inf, inf, inf, \.\.\.\]"),
    ],
)
def test_a_command_that_the_robot_would_refuse_is_reported_with_why(values, sentence):
    refusal = command_refusal(values, VIEWS["forward"])
    if sentence is None:
        assert refusal is None
    else:
        assert re.search(sentence, refusal)


def test_a_command_for_a_controller_that_is_not_active_is_reported():
    assert command_refusal([1.0, 2.0], VIEWS["base"]) == "base is inactive; activate it before commanding it"


def test_a_transform_is_reported_alone():
    odometry = OdometrySample(time=1.0, x=1.0, y=2.0, heading=math.pi, child_frame_id="base")
    pose = PoseSample(
        time=1.0, frame_id="map", position=(1.0, 2.0, 3.0), orientation=(0.1, 0.2, 0.3, 0.9), child_frame_id="gps"
    )
    lost = PoseSample(
        time=1.0, frame_id="map", position=(1.0, None, 3.0), orientation=(0.0, 0.0, 0.0, 1.0), child_frame_id="lost"
    )
    silent = PoseSample(time=1.0, frame_id="map", position=(1.0, 2.0, 3.0), orientation=(0.0, 0.0, 0.0, 1.0))
    off = OdometrySample(time=1.0, x=1.0, y=2.0, heading=0.0, child_frame_id="off", enable_odom_tf=False)
    nowhere = OdometrySample(time=1.0, x=math.nan, y=2.0, heading=0.0, child_frame_id="nowhere")
    moved = transform_of(pose)
    assert moved is not None
    assert (moved.parent, moved.child, moved.pose.position) == ("map", "gps", (1.0, 2.0, 3.0))
    assert moved.pose.rotation == (0.9, 0.1, 0.2, 0.3)
    assert [transform_of(item) for item in (lost, silent, off, nowhere)] == [None] * 4
    samples = dict(enumerate((odometry, pose, lost, silent, off, nowhere)))
    assert located_frames(StateSample(samples={str(key): each for key, each in samples.items()})) == {"base", "gps"}
