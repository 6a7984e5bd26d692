import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.data_files import data_path
from canopen_control.hardware.description import read_description
from canopen_control.view.model import GREY, Joint, joint_pose, read_model

ARM = """<robot name="arm">
<material name="red"><color rgba="1 0 0 0.5"/></material>
<link name="tip"><visual><geometry><mesh filename="package://a/b.stl" scale="2 2 2"/></geometry></visual></link>
<link name="base"><visual><origin xyz="0 0 1" rpy="0 0 1.5707963"/><geometry><box size="1 2 3"/></geometry>
 <material name="red"/></visual><visual><geometry><capsule radius="1" length="2"/></geometry></visual></link>
<link name="slide"><visual><geometry><sphere radius="0.5"/></geometry></visual></link>
<joint name="second" type="prismatic"><parent link="slide"/><child link="tip"/><axis xyz="0 0 2"/>
 <origin xyz="1 0 0"/><limit lower="0" upper="0.4" velocity="1"/></joint>
<joint name="first" type="revolute"><parent link="base"/><child link="slide"/><axis xyz="0 0 1"/>
 <limit lower="-1" upper="1" effort="5" velocity="2"/></joint>
<joint name="copy" type="revolute"><parent link="base"/><child link="other"/>
 <mimic joint="first" multiplier="-2" offset="1"/>
</joint><link name="other"/></robot>"""


def test_robby_is_two_wheels_on_a_body():
    model = read_model(read_description(data_path("config", "robby") / "robby.urdf.xacro").urdf_xml)
    assert (model.name, model.root, model.notes) == ("robby", "base_footprint", ())
    wheel = next(joint for joint in model.joints if joint.name == "left_wheel_joint")
    assert (wheel.kind, wheel.axis, wheel.parent) == ("continuous", (0.0, 1.0, 0.0), "base_link")
    tyre = model.visuals["left_wheel"][0]
    assert (tyre.shape, tyre.size, tyre.color) == ("cylinder", (0.035, 0.02), (26, 26, 26))


@pytest.mark.parametrize(
    "path", sorted(data_path("config", "robby").parent.glob("*/*.urdf*")), ids=lambda path: path.name
)
def test_every_bundled_robot_can_be_drawn_whole(path):
    description = read_description(path)
    model = read_model(description.urdf_xml)
    assert model.notes == ()
    assert {joint.name for joint in model.joints} == set(description.joints)
    assert set(model.visuals) == set(description.links)


def test_parents_come_first_whatever_the_order_of_the_file():
    model = read_model(ARM)
    assert model.root == "base"
    assert [joint.name for joint in model.joints] == ["first", "copy", "second"]


def test_shapes_materials_and_origins():
    model = read_model(ARM)
    box = model.visuals["base"][0]
    assert (box.size, box.position, box.color, box.opacity) == ((1, 2, 3), (0, 0, 1), (255, 0, 0), 0.5)
    assert model.visuals["slide"][0].color == GREY
    mesh = model.visuals["tip"][0]
    assert (mesh.shape, mesh.file, mesh.size) == ("mesh", "package://a/b.stl", (2, 2, 2))
    assert model.notes == ("link base: <capsule> is not drawn; box, cylinder, sphere and mesh are",)


def test_a_mimicking_joint_stands_where_its_leader_says():
    model = read_model(ARM)
    copy = next(joint for joint in model.joints if joint.name == "copy")
    assert model.angle(copy, {"first": 0.25}) == 0.5
    assert model.angle(copy, {"first": None}) is None


def test_a_wheel_turns_and_a_slide_slides():
    wheel = Joint("w", "continuous", "a", "b", position=(0, 0, 1), axis=(0, 1, 0))
    position, wxyz = joint_pose(wheel, math.pi)
    assert position == (0, 0, 1)
    assert wxyz == pytest.approx((0, 0, 1, 0), abs=1e-12)
    slide = Joint("s", "prismatic", "a", "b", position=(1, 0, 0), axis=(0, 0, 2))
    assert joint_pose(slide, 0.4)[0] == pytest.approx((1, 0, 0.4))
    assert joint_pose(Joint("f", "fixed", "a", "b"), 3.0)[1] == (1, 0, 0, 0)


@pytest.mark.parametrize("urdf", ["", "<robot", "<robot/>", "<robot><link/><joint/></robot>"])
def test_what_cannot_be_drawn_is_no_error(urdf):
    assert read_model(urdf).visuals.get("nothing") is None


@given(st.text("<>/ robtlinkjxyz=\"'0.1", max_size=80))
def test_no_text_raises(text):
    read_model(
        f"<robot name='x'><link name='a'><visual><origin xyz='{text.replace(chr(39), '')}'/></visual></link></robot>"
    )
    read_model(text)


def test_a_circle_of_joints_ends():
    model = read_model(
        "<robot><link name='a'/><link name='b'/>"
        "<joint name='1' type='fixed'><parent link='a'/><child link='b'/></joint>"
        "<joint name='2' type='fixed'><parent link='b'/><child link='a'/></joint></robot>"
    )
    assert [joint.name for joint in model.joints] == ["1"]
