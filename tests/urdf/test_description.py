from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.arm import ARM
from support.properties import examples

from canopen_control.errors import RobotConfigError
from canopen_control.urdf.description import parse_description, read_description
from canopen_control.urdf.geometry import IDENTITY, from_rpy
from canopen_control.urdf.joint_element import Mimic, UrdfLimits

ROBBY = Path(__file__).parents[2] / "config" / "robby" / "robby.urdf.xacro"


def complaints(text: str) -> list[str]:
    with pytest.raises(RobotConfigError) as caught:
        parse_description(text, "r.urdf")
    return str(caught.value).splitlines()


def test_links_joints_limits_and_mimics_are_read():
    arm = parse_description(ARM)
    assert (arm.model.name, tuple(arm.links)) == ("arm", ("base", "upper", "finger", "thumb"))
    shoulder = arm.joints["shoulder"]
    assert (shoulder.parent, shoulder.child, shoulder.place.line) == ("base", "upper", 3)
    assert (shoulder.origin, shoulder.axis) == (((1, 2, 3), from_rpy((0, 0, 1.5))), (0, 0, 1))
    assert shoulder.limits == UrdfLimits(-1.0, 2.0, 3.0, 4.0)
    assert arm.joints["grip2"].mimic == Mimic("grip", -1.0, 0.5)
    assert arm.movable_joints == ("shoulder", "grip", "grip2")
    assert arm.urdf_xml == ARM


def test_robby_has_the_geometry_of_the_tutorial_and_its_wheels_turn_forward_together():
    robby = read_description(ROBBY)
    (system,) = robby.hardware
    assert (system.kind, system.plugin) == ("system", "canopen_ros2_control/RobotSystem")
    assert {item.name: item.parameters["device_name"] for item in system.joints} == {
        "left_wheel_joint": "left_drive",
        "right_wheel_joint": "right_drive",
    }
    left, right = robby.joints["left_wheel_joint"], robby.joints["right_wheel_joint"]
    assert left.origin.position[1] - right.origin.position[1] == pytest.approx(0.24)
    # positive about +y of a frame that is not turned: the wheel's top moves to +x, the robot forward
    assert left.axis == right.axis == (0.0, 1.0, 0.0)
    assert left.origin.rotation == right.origin.rotation == IDENTITY
    assert robby.joints["base_joint"].origin.position[2] + left.origin.position[2] == pytest.approx(0.035)
    assert robby.joints["base_joint"].origin.position[0] + left.origin.position[0] == pytest.approx(0.0)
    assert all(list(item.command_interfaces) == ["velocity"] for item in system.joints)
    assert all(list(item.state_interfaces) == ["position", "velocity"] for item in system.joints)
    children = {joint.child for joint in robby.joints.values()}
    assert set(robby.links) - children == {"base_footprint"}
    assert "mesh" not in robby.urdf_xml


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (
            '<state_interface name="position"/>',
            '<state_interfaces name="position"/>',
            "<state_interfaces> is not allowed in <joint> (did you mean 'state_interface'?)",
        ),
        (
            '<command_interface name="out"/>',
            '<comand_interface name="out"/>',
            "<comand_interface> is not allowed in <gpio> (did you mean 'command_interface'?)",
        ),
        ('<parent link="base"/>', '<parent link=""/>', "joint shoulder: <parent link=...> is missing"),
    ],
)
def test_a_misspelt_tag_of_a_joint_and_an_empty_link_are_refused(old, new, said):
    assert old in ARM
    assert any(said in each for each in complaints(ARM.replace(old, new, 1)))


def test_every_error_is_reported_at_once_with_its_place():
    text = (
        ARM.replace('type="revolute"', 'type="revolut"')
        .replace('<parent link="upper"/><child link="finger"/>', '<parent link="uper"/>')
        .replace('xyz="1 2 3"', 'xyz="1 2"')
        .replace('velocity="3"', 'velocity="fast"')
        .replace('<joint name="shoulder">', '<joint name="sholder">')
        .replace('type="system"', 'type="sistem"')
        .replace("<gpio ", "<gpoi ")
        .replace("</gpio>", "</gpoi>")
        .replace('<param name="min">-1.5', '<param name="min">low')
    )
    result = complaints(text)
    assert [line.split(":")[1] for line in result] == sorted([line.split(":")[1] for line in result], key=int)
    expected = [
        "r.urdf:3:3: joint shoulder: unknown type 'revolut' (did you mean 'revolute'?)",
        "r.urdf:5:5: xyz='1 2' of <origin> is not three numbers",
        "r.urdf:7:5: velocity='fast' of <limit> is not a number",
        "r.urdf:9:3: joint grip: <child link=...> is missing",
        "r.urdf:9:3: joint grip: link 'uper' does not exist (did you mean 'upper'?)",
        "r.urdf:18:3: <ros2_control name='arm'>: type 'sistem' (did you mean 'system'?)",
        "r.urdf:23:5: <ros2_control> names joint 'sholder', which does not exist (did you mean 'shoulder'?)",
        "r.urdf:25:7: min='low' of <command_interface> is not a number",
        "r.urdf:32:5: <gpoi> is not allowed in <ros2_control> (did you mean 'gpio'?)",
    ]
    assert result == expected


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("<plugin> canopen_ros2_control/RobotSystem </plugin>", "", "18:3: <ros2_control name='arm'>: <hardware>"),
        ('<joint name="grip2"><state', '<joint name="grip2"><command_interface name="position"/><state',
         'no command interface of its own; remove its command interfaces, or give it mimic="false" if it has its own '
         "drive"),
        ('type="prismatic">\n    <parent link="upper"/><child link="thumb"/>',
         'type="fixed">\n    <parent link="upper"/><child link="thumb"/>', "grip2 is fixed and cannot be driven"),
        ('<child link="thumb"/>', '<child link="finger"/>', "link finger is the child of two joints: grip, grip2"),
        ('mimic joint="grip"', 'mimic joint="grp"', "mimics 'grp', which does not exist (did you mean 'grip'"),
        ('<joint name="grip2"><state', '<joint name="shoulder"><state', "'shoulder' is defined twice"),
        ('<limit lower="-1" upper="2" velocity="3" effort="4"/>', "", "a revolute joint needs <limit"),
        ('<sensor name="force">', "<sensor>", "<sensor> has no name"),
        ('<state_interface name="position"/>\n', '<state_interface name="position"/>' * 2,
         "'position' is defined twice"),
        ("<robot", "<robt", "the root element is <robt>"),
        ('<limit lower="-1" upper="2" velocity', '<limit lower="2" upper="-1" velocity',
         "joint shoulder: lower 2 of <limit> is greater than upper -1; exchange them"),
        ('<param name="min">-1.5</param>', '<param name="min">3</param>',
         "shoulder: min 3 of the command interface 'position' is greater than max 1.5; exchange them"),
        ('<param name="min">-1.5</param><param name="max">1.5</param>',
         '<param name="min">2.5</param><param name="max">3</param>',
         "min 2.5 to max 3 of the command interface 'position' lies outside the joint's <limit>, -1 to 2; correct"),
        ('<command_interface name="out"/>',
         '<command_interface name="out"><param name="min">1</param><param name="max">0</param></command_interface>',
         "io: min 1 of the command interface 'out' is greater than max 0"),
    ],
)  # fmt: skip
def test_what_ros2_control_refuses_is_refused(old, new, expected):
    text = ARM.replace(old, new).replace("</robot>", "</robt>" if "<robt" in new else "</robot>")
    assert any(expected in line for line in complaints(text)), complaints(text)


def test_links_and_joints_of_one_name_are_reported_with_both_places_alongside_the_other_errors():
    text = """<robot name="r">
  <link name="base"/>
  <link name="wheel"/> <link name="wheel"/>
  <joint name="left" type="fixed"><parent link="base"/><child link="wheel"/></joint>
  <joint name="left" type="revolut"><parent link="base"/><child link="caster"/></joint>
  <link name="wheel"/>
  <link name="left"/>
</robot>"""
    assert complaints(text) == [
        "r.urdf:3:24: link 'wheel' is defined twice, first at r.urdf:3:3; rename one",
        "r.urdf:5:3: joint 'left' is defined twice, first at r.urdf:4:3; rename one",
        "r.urdf:5:3: joint left: unknown type 'revolut' (did you mean 'revolute'?)",
        "r.urdf:6:3: link 'wheel' is defined twice, first at r.urdf:3:3; rename one",
    ]


def test_a_macro_that_is_called_twice_with_one_name_is_reported():
    source = """<robot name="r" xmlns:xacro="x">
<xacro:macro name="wheel" params="side"><link name="${side}_wheel"/></xacro:macro>
<xacro:wheel side="left"/><xacro:wheel side="left"/></robot>"""
    with pytest.raises(RobotConfigError) as caught:
        parse_description("<robot><link name='left_wheel'/><link name='left_wheel'/></robot>", "r.xacro", source=source)
    (reported,) = str(caught.value).splitlines()
    assert reported.startswith("r.xacro:2:41: link 'left_wheel' is defined twice, ")
    assert reported.endswith("both are created here; call the macro with another name")


def test_a_file_that_cannot_be_read_is_one_sentence(tmp_path):
    with pytest.raises(RobotConfigError, match=r"none\.urdf: cannot be read: No such file"):
        read_description(tmp_path / "none.urdf")
    (tmp_path / "bad.urdf").write_bytes(b"\xff")
    with pytest.raises(RobotConfigError, match=r"bad\.urdf: cannot be read"):
        read_description(tmp_path / "bad.urdf")


PIECES = st.lists(
    st.sampled_from(
        [
            *("<robot name='r'>", "</robot>", "<link name='a'/>", "<link/>", "<joint name='j' type='continuous'>"),
            *("</joint>", "<parent link='a'/>", "<child link='b'/>", "<limit lower='x'/>", "<axis xyz='1 0'/>"),
            *(
                "<ros2_control name='s' type='system'>",
                "</ros2_control>",
                "<hardware/>",
                "<joint name='j'/>",
                "text",
                "&x;",
            ),
            *(
                "<mimic/>",
                "<command_interface/>",
                "<hardware><plugin>p</plugin></hardware>",
                "<!-- -->",
                "<a b='c' b='d'/>",
            ),
        ]
    ),
    max_size=14,
)


@pytest.mark.rest
@given(st.one_of(PIECES.map("".join), PIECES.map(lambda each: f"<robot name='r'>{''.join(each)}</robot>"), st.text()))
@settings(max_examples=examples(300))
def test_any_text_gives_a_description_or_the_one_error(text):
    try:
        assert parse_description(text).urdf_xml == text
    except RobotConfigError as error:
        assert str(error).startswith("<urdf>:")  # noqa: PT017 - either outcome is right


def test_gazebos_plugins_are_known_with_their_lines():
    text = '<robot name="r">\n<gazebo reference="x"/>\n<gazebo>\n<plugin name="a" filename="liba.so"/></gazebo></robot>'
    (plugin,) = parse_description(text).gazebo
    assert (plugin.name, plugin.filename, plugin.line) == ("a", "liba.so", 4)
