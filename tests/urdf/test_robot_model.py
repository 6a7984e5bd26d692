import math

import pytest

from canopen_control.data_files import data_path
from canopen_control.errors import RobotConfigError
from canopen_control.urdf.description import read_description
from canopen_control.urdf.robot_model import WheelGeometry, read_model


def robot(left='xyz="0 0.2 0"', right='xyz="0 -0.2 0"', between='xyz="0 0 0"') -> WheelGeometry:
    wheel = '<collision><geometry><cylinder radius="0.05" length="0.02"/></geometry></collision>'
    return WheelGeometry(
        read_model(f"""<robot name="r"><link name="base"/><link name="arm"/>
        <link name="lw">{wheel}</link><link name="rw">{wheel}</link>
        <joint name="b" type="fixed"><parent link="base"/><child link="arm"/><origin {between}/></joint>
        <joint name="l" type="continuous"><parent link="arm"/><child link="lw"/><origin {left}/>
        <axis xyz="0 1 0"/></joint>
        <joint name="r" type="continuous"><parent link="base"/><child link="rw"/><origin {right}/></joint></robot>""")
    )


def test_robbys_wheels_are_where_its_controllers_report():
    wheels = WheelGeometry(read_description(data_path("config", "robby") / "robby.urdf.xacro").model)
    left, right = ["left_wheel_joint"], ["right_wheel_joint"]
    assert wheels.separation(left, right) == pytest.approx(0.24)
    assert wheels.radius([*left, *right]) == pytest.approx(0.035)


def test_fixed_joints_between_are_followed():
    wheels = robot(left='xyz="0.1 0 0"', between=f'xyz="0 0.1 0" rpy="0 0 {math.pi / 2}"')
    link, point = wheels.place("l")
    assert link == "base"
    assert point == pytest.approx((0.0, 0.2, 0.0))
    assert wheels.separation(["l"], ["r"]) == pytest.approx(0.4)


def test_what_the_description_does_not_report_is_none():
    wheels = robot()
    assert wheels.separation(["l"], ["nobody"]) is None
    assert wheels.separation([], []) is None
    assert wheels.radius(["l", "nobody"]) is None
    assert wheels.axis("nobody") is None
    assert wheels.axis("l") == pytest.approx((0.0, 1.0, 0.0))


ARM = """<robot name="arm"><link name="tip"/><link name="base"/><link name="slide"/>
<joint name="second" type="continuous"><parent link="slide"/><child link="tip"/></joint>
<joint name="first" type="continuous"><parent link="base"/><child link="slide"/></joint>
<joint name="copy" type="continuous"><parent link="base"/><child link="other"/></joint><link name="other"/></robot>"""


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


def test_what_is_not_a_urdf_is_reported():
    with pytest.raises(RobotConfigError, match="not valid XML"):
        read_model("<robot>")
    with pytest.raises(RobotConfigError, match="root element is <bot>"):
        read_model("<bot/>")
