import pytest

from canopen_control.data_files import data_path
from canopen_control.errors import RobotConfigError
from canopen_control.urdf.description import read_description
from canopen_control.urdf.robot_model import read_model

ARM = """<robot name="arm"><link name="tip"/><link name="base"/><link name="slide"/>
<joint name="second" type="continuous"><parent link="slide"/><child link="tip"/></joint>
<joint name="first" type="continuous"><parent link="base"/><child link="slide"/></joint>
<joint name="copy" type="continuous"><parent link="base"/><child link="other"/></joint><link name="other"/></robot>"""


def test_robby_is_two_wheels_on_a_body():
    model = read_model(read_description(data_path("config", "robby") / "robby.urdf.xacro").urdf_xml)
    assert (model.name, model.root, model.notes) == ("robby", "base_footprint", ())
    wheel = model.joints["left_wheel_joint"]
    assert (wheel.type, wheel.axis, wheel.parent) == ("continuous", (0.0, 1.0, 0.0), "base_link")
    tyre = model.links["left_wheel"].visuals[0]
    assert (tyre.shape, tyre.size, tyre.color) == ("cylinder", (0.035, 0.02), (26, 26, 26))


@pytest.mark.parametrize(
    "path", sorted(data_path("config", "robby").parent.glob("*/*.urdf*")), ids=lambda path: path.name
)
def test_every_bundled_robot_can_be_drawn_whole(path):
    description = read_description(path)
    model = read_model(description.urdf_xml)
    assert model.notes == ()
    assert {joint.name for joint in model.from_root} == set(description.joints) == set(model.joints)
    assert set(model.links) == set(description.links)


def test_parents_come_first_whatever_the_order_of_the_file():
    model = read_model(ARM)
    assert model.root == "base"
    assert [joint.name for joint in model.from_root] == ["first", "copy", "second"]


def test_a_circle_of_joints_ends():
    model = read_model(
        "<robot><link name='a'/><link name='b'/>"
        "<joint name='1' type='fixed'><parent link='a'/><child link='b'/></joint>"
        "<joint name='2' type='fixed'><parent link='b'/><child link='a'/></joint></robot>"
    )
    assert model.root == "a"
    assert [joint.name for joint in model.from_root] == ["1"]


def test_what_is_no_urdf_is_told():
    with pytest.raises(RobotConfigError, match="no XML"):
        read_model("<robot>")
    with pytest.raises(RobotConfigError, match="root element is <bot>"):
        read_model("<bot/>")
