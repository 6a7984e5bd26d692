from __future__ import annotations

import math

import pytest

from canopen_control.errors import RobotConfigError
from canopen_control.urdf.description import parse_description
from canopen_control.urdf.document import read_document
from canopen_control.urdf.geometry import ORIGIN, Pose, rotate
from canopen_control.urdf.joint_element import Dynamics, Joint, Mimic, SoftLimits, UrdfLimits, read_interfaces
from canopen_control.urdf.robot_model import read_model

URDF = """<robot name="r">
  <link name="a"/><link name="b"/><link name="c"/><link name="d"/><link name="e"/><link name="f"/>
  <joint name="plain" type="fixed"><parent link="a"/><child link="b"/></joint>
  <joint name="wheel" type="continuous"><parent link="b"/><child link="c"/>
    <origin xyz="1 2 3" rpy="0 0 1.5707963267948966"/><axis xyz="0 2 0"/></joint>
  <joint name="lift" type="prismatic"><parent link="b"/><child link="d"/>
    <origin xyz="0 0 1" rpy="0 0 1.5707963267948966"/><limit/></joint>
  <joint name="follower" type="revolute"><parent link="c"/><child link="e"/><axis xyz="0 0 1"/>
    <mimic joint="wheel" multiplier="-2" offset="0.5"/><limit/></joint>
  <joint name="free" type="floating"><parent link="a"/><child link="f"/></joint>
</robot>"""


def transform(name, **positions):
    return read_model(URDF).joints[name].transform(positions)


def test_a_wheel_turns_about_its_axis_after_its_origin():
    created = transform("wheel", wheel=math.pi / 2)
    assert created.pose.position == (1.0, 2.0, 3.0)
    # the axis y of the joint is -x of the parent: what pointed along the joint's x points down
    assert rotate(created.pose.rotation, (1.0, 0.0, 0.0)) == pytest.approx((0, 0, -1), abs=1e-9)
    assert rotate(created.pose.rotation, (0.0, 1.0, 0.0)) == pytest.approx((-1, 0, 0), abs=1e-9)


def test_a_mimic_joint_follows():
    assert transform("follower", wheel=0.25).pose.rotation == pytest.approx((1, 0, 0, 0))
    assert transform("follower", wheel=-0.25).pose.rotation == pytest.approx((math.cos(0.5), 0, 0, math.sin(0.5)))


@pytest.mark.parametrize("name", ["wheel", "lift", "follower", "free"])
def test_a_joint_whose_position_is_not_known_has_no_transform(name):
    assert transform(name) is None


def test_the_position_of_a_joint_is_unknown_until_it_or_its_mimicked_joint_has_one():
    follower = Joint("f", "revolute", "a", "b", mimic=Mimic("l", -2.0, 1.0))
    assert follower.position_in({"l": 0.25, "f": 9.0}) == 0.5
    assert math.isnan(follower.position_in({"l": None}))
    assert math.isnan(Joint("l", "continuous", "a", "b").position_in({}))


def test_limits_are_known_by_the_name_of_an_interface():
    limits = UrdfLimits(-1.0, 2.0, 3.0, 4.0)
    lift, wheel = (Joint("j", kind, "a", "b", limits=limits) for kind in ("prismatic", "continuous"))
    spans = [lift.range_of(name) for name in ("position", "velocity", "effort", "acceleration")]
    assert spans == [(-1.0, 2.0), (-3.0, 3.0), (-4.0, 4.0), (-math.inf, math.inf)]
    assert (wheel.range_of("position"), wheel.range_of("velocity")) == ((-math.inf, math.inf), (-3.0, 3.0))
    speeds = [Joint("j", "continuous", "a", "b", limits=UrdfLimits(velocity=most)) for most in (-3.0, 0.0)]
    assert [joint.range_of("velocity") for joint in speeds] == [(-3.0, 3.0), (-math.inf, math.inf)]


def test_a_wheel_turns_and_a_slide_slides_whatever_the_length_of_the_axis():
    wheel = Joint("w", "continuous", "a", "b", Pose((0, 0, 1)), (0, 2, 0))
    assert wheel.pose(math.pi).position == (0, 0, 1)
    assert wheel.pose(math.pi).rotation == pytest.approx((0, 0, 1, 0), abs=1e-12)
    slide = Joint("s", "prismatic", "a", "b", Pose((1, 0, 0)), (0, 0, 2))
    assert slide.pose(0.4).position == pytest.approx((1, 0, 0.4))
    assert Joint("f", "fixed", "a", "b").pose(3.0) == ORIGIN


def test_a_safety_controller_is_the_soft_limits_of_its_joint():
    safety = '<safety_controller soft_lower_limit="-1" soft_upper_limit="2" k_position="15" k_velocity="3"/>'
    joints = read_model(URDF.replace('<axis xyz="0 2 0"/>', safety)).joints
    assert joints["wheel"].soft == SoftLimits(-1.0, 2.0, 15.0, 3.0)
    assert joints["lift"].soft is None


def test_dynamics_are_kept_and_what_is_not_given_stays_unknown():
    urdf = (
        "<robot name='r'><link name='a'/><link name='b'/><joint name='j' type='continuous'><parent link='a'/>"
        "<child link='b'/>{}</joint></robot>"
    )
    joint = parse_description(urdf.format("<dynamics damping='0.5' friction='0'/>")).joints["j"]
    assert joint.dynamics == Dynamics(0.5, 0.0)
    assert parse_description(urdf.format("<dynamics damping='0.5'/>")).joints["j"].dynamics == Dynamics(0.5)
    assert parse_description(urdf.format("")).joints["j"].dynamics == Dynamics()


# -- declared interface


JOINT = """<joint name="j">
<command_interface name="velocity"><param name="min">-2</param><param name="max">3</param></command_interface>
<command_interface name="effort"><limits enable="false"/></command_interface>
<state_interface name="position"><param name="initial_value">0.5</param></state_interface>{}</joint>"""


def read(tag, more=""):
    document = read_document(JOINT.format(more), "r.urdf")
    interfaces = read_interfaces(document, document.root, tag)
    document.raise_if_any()
    return interfaces


def test_bounds_initial_values_and_switched_off_limits():
    commands = read("command_interface")
    assert list(commands) == ["velocity", "effort"]
    assert (commands["velocity"].minimum, commands["velocity"].maximum, commands["velocity"].limited) == (-2, 3, True)
    assert not commands["effort"].limited
    assert read("state_interface")["position"].initial_value == 0.5
    assert not read("command_interface", "<limits enable=' FALSE '/>")["velocity"].limited


def test_an_interface_given_twice_is_an_error():
    with pytest.raises(RobotConfigError, match=r"r\.urdf:4:\d+: j: state_interface 'position' is defined twice"):
        read("state_interface", '<state_interface name="position"/>')
