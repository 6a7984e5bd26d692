import xml.etree.ElementTree as ET

import pytest

from canopen_control.physics.physics_file import PhysicsError
from canopen_control.physics.urdf_repair import repaired
from canopen_control.urdf.description import parse_description

HEAD = """<robot name="r"><link name="base"><collision><geometry><box size="1 1 1"/></geometry></collision></link>
<joint name="turn" type="continuous"><parent link="base"/><child link="part"/><axis xyz="0 0 1"/></joint>
"""


def repair(body, path="<urdf>"):
    return repaired(parse_description(f"{HEAD}{body}</robot>", path))


def shapes(text, link):
    root = ET.fromstring(text)
    return [each.find("geometry")[0].tag for each in root.find(f"link[@name='{link}']").findall("collision")]


def test_what_is_only_seen_touches_and_weighs():
    made = repair('<link name="part"><visual><geometry><sphere radius="1"/></geometry></visual></link>')
    assert shapes(made.text, "part") == ["sphere"]
    assert made.guessed == ("base", "part")


def test_a_collision_is_taken_and_what_is_seen_dropped():
    body = (
        '<link name="part"><visual><geometry><box size="1 1 1"/></geometry></visual>'
        '<collision><geometry><sphere radius="1"/></geometry></collision>'
        '<inertial><mass value="2"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    )
    made = repair(body)
    assert shapes(made.text, "part") == ["sphere"]
    assert made.guessed == ("base",)
    assert "<visual>" not in made.text


def test_the_tags_of_others_go():
    made = repair('<link name="part"><visual><geometry><sphere radius="1"/></geometry></visual></link><gazebo/>')
    assert [each.tag for each in ET.fromstring(made.text)] == ["link", "joint", "link", "mujoco"]


@pytest.mark.parametrize("inertial", ["", '<inertial><mass value="0"/></inertial>'])
def test_a_moving_link_without_mass_and_shape_is_told_with_the_line_of_its_joint(inertial):
    with pytest.raises(PhysicsError, match=r"<urdf>:2:1: joint turn moves link part, which has neither a mass"):
        repair(f'<link name="part">{inertial}</link>')


def test_what_is_fixed_to_it_may_have_the_mass():
    body = (
        '<link name="part"/><link name="more"><visual><geometry><sphere radius="1"/></geometry></visual></link>'
        '<joint name="hold" type="fixed"><parent link="part"/><child link="more"/></joint>'
    )
    assert repair(body).guessed == ("base", "more")


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("package://nowhere_at_all/a.stl", "the package of its mesh"),
        ("part.dae", "is none of .stl, .obj"),
        ("gone.stl", "is not there"),
    ],
)
def test_a_mesh_that_cannot_be_used_is_left_out_and_told(tmp_path, name, why):
    mesh = f'<collision><geometry><mesh filename="{name}"/></geometry></collision>'
    body = f'<link name="part">{mesh}<collision><geometry><sphere radius="1"/></geometry></collision></link>'
    made = repair(body, str(tmp_path / "robot.urdf"))
    assert shapes(made.text, "part") == ["sphere"]
    assert why in made.notes[0]
    assert made.notes[0].startswith("link part: ")


def test_a_mesh_is_found_beside_the_description_and_in_its_package(tmp_path):
    folder = tmp_path / "my_robot"
    folder.mkdir()
    (folder / "part.stl").write_bytes(b"")
    for name in ("part.stl", "package://my_robot/part.stl"):
        body = f'<link name="part"><visual><geometry><mesh filename="{name}"/></geometry></visual></link>'
        made = repair(body, str(folder / "robot.urdf"))
        assert f'filename="{folder / "part.stl"}"' in made.text
        assert made.notes == ()
