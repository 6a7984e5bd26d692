import xml.etree.ElementTree as ET

import pytest

from canopen_control.physics.body_model import compiled, read_spec
from canopen_control.physics.physics_file import PhysicsError
from canopen_control.physics.urdf_repair import repaired
from canopen_control.urdf.description import parse_description
from canopen_control.urdf.meshes import obj_triangles

WEDGE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
FLAT = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 3 2\n"
COLLADA = """<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema">
<asset><unit meter="1"/><up_axis>Z_UP</up_axis></asset><library_geometries><geometry id="g"><mesh>
<source id="p"><float_array count="12">0 0 0 1 0 0 0 1 0 0 0 1</float_array></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<triangles count="4"><input semantic="VERTEX" source="#v" offset="0"/><p>0 2 1 0 1 3 0 3 2 1 2 3</p></triangles>
</mesh></geometry></library_geometries><library_visual_scenes><visual_scene id="s">
<node><instance_geometry url="#g"/></node></visual_scene></library_visual_scenes></COLLADA>"""

HEAD = """<robot name="r"><link name="base"><collision><geometry><box size="1 1 1"/></geometry></collision></link>
<joint name="turn" type="continuous"><parent link="base"/><child link="part"/><axis xyz="0 0 1"/></joint>
"""


def repair(body, path="<urdf>"):
    return repaired(parse_description(f"{HEAD}{body}</robot>", path))


def shapes(text, link):
    root = ET.fromstring(text)
    return [item.find("geometry")[0].tag for item in root.find(f"link[@name='{link}']").findall("collision")]


def test_what_is_only_seen_touches_and_weighs():
    created = repair('<link name="part"><visual><geometry><sphere radius="1"/></geometry></visual></link>')
    assert shapes(created.text, "part") == ["sphere"]
    assert created.guessed == ("base", "part")


def test_a_collision_is_taken_and_what_is_seen_dropped():
    body = (
        '<link name="part"><visual><geometry><box size="1 1 1"/></geometry></visual>'
        '<collision><geometry><sphere radius="1"/></geometry></collision>'
        '<inertial><mass value="2"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    )
    created = repair(body)
    assert shapes(created.text, "part") == ["sphere"]
    assert created.guessed == ("base",)
    assert "<visual>" not in created.text


@pytest.mark.parametrize("inertial", ["", '<inertial><mass value="0"/></inertial>'])
def test_a_moving_link_without_mass_and_shape_is_reported_with_the_line_of_its_joint(inertial):
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
        ("package://nowhere_at_all/a.stl", "no package nowhere_at_all with this file"),
        ("part.ply", ".ply is not supported; use .stl, .obj, .dae, .glb"),
        ("part.glb", ".glb is only displayed; use STL, OBJ or DAE"),
        ("broken.stl", "it is not an STL file"),
        ("flat.obj", "it is flat"),
        ("gone.stl", "does not exist"),
    ],
)
def test_a_mesh_that_cannot_be_used_is_left_out_and_reported(tmp_path, name, why):
    mesh = f'<collision><geometry><mesh filename="{name}"/></geometry></collision>'
    body = f'<link name="part">{mesh}<collision><geometry><sphere radius="1"/></geometry></collision></link>'
    for file, content in (("part.ply", ""), ("part.glb", "glTF"), ("broken.stl", "no mesh"), ("flat.obj", FLAT)):
        (tmp_path / file).write_text(content)
    created = repair(body, str(tmp_path / "robot.urdf"))
    assert shapes(created.text, "part") == ["sphere"]
    assert why in created.notes[0]
    assert created.notes[0].startswith("link part: ")


def test_a_mesh_is_found_next_to_the_description_and_in_its_package_and_read_once(tmp_path):
    folder = tmp_path / "my_robot"
    folder.mkdir()
    (folder / "part.obj").write_text(WEDGE)
    shapes = "".join(
        f'<visual><geometry><mesh filename="{name}"/></geometry></visual>'
        for name in ("part.obj", "package://my_robot/part.obj")
    )
    created = repair(f'<link name="part">{shapes}</link>', str(folder / "robot.urdf"))
    assert created.text.count('filename="part_0.stl"') == 2
    assert list(created.meshes) == ["part_0.stl"]
    assert created.notes == ()


@pytest.mark.parametrize("name", ["part.obj", "part.dae", "part.stl"])
def test_a_mesh_weighs_what_it_does_at_its_scale_whatever_its_format(tmp_path, name):
    (tmp_path / name).write_text({"part.obj": WEDGE, "part.dae": COLLADA, "part.stl": solid()}[name])
    mesh = f'<mesh filename="{name}" scale="0.1 0.1 0.2"/>'
    created = repair(
        f'<link name="part"><visual><geometry>{mesh}</geometry></visual></link>', str(tmp_path / "robot.urdf")
    )
    model = compiled(read_spec(created, "robot.urdf"), "robot.urdf")
    assert created.notes == ()
    assert model.body("part").mass[0] == pytest.approx(1000.0 * 0.1 * 0.1 * 0.2 / 6)
    assert model.body("part").ipos == pytest.approx([0.025, 0.025, 0.05])


def solid():
    """Return the wedge as the text of an STL file."""
    return "solid part\n" + "".join(
        "facet normal 0 0 0\n" + "".join(f"vertex {x} {y} {z}\n" for x, y, z in corners)
        for corners in obj_triangles(WEDGE.encode())
    )


def with_inertia(moments, mass="2"):
    xx, yy, zz, xy, xz, yz = moments
    return (
        f'<link name="part"><inertial><mass value="{mass}"/><inertia ixx="{xx}" iyy="{yy}" izz="{zz}" ixy="{xy}" '
        f'ixz="{xz}" iyz="{yz}"/></inertial></link>'
    )


def simulated(made):
    model = compiled(read_spec(made, "<urdf>"), "<urdf>")
    return sorted(model.body_inertia[model.body("part").id])


def test_an_inertia_that_no_body_has_is_reported_with_its_link_and_the_nearest_possible_one_counts():
    created = repair(with_inertia((1, 2, 5, 0, 0, 0)))
    assert created.notes == (
        "<urdf>:3:1: link part: its moments of inertia 1, 2, 5 kg m² are impossible, the largest is more than the sum "
        "of the others; simulated with 3 instead of 5",
    )
    assert simulated(created) == pytest.approx([1.0, 2.0, 3.0])


def test_rounded_numbers_of_a_flat_body_are_neither_reported_nor_replaced_by_a_mean():
    created = repair(with_inertia((1, 1, 2.0000001, 0, 0, 0)))
    assert created.notes == ()
    assert simulated(created) == pytest.approx([1.0, 1.0, 2.0], rel=1e-6)


@pytest.mark.parametrize("moments", [(1, 1, -1, 0, 0, 0), (0, 0, 0, 0, 0, 0), (1, 1, 1, 3, 0, 0)])
def test_moments_that_are_not_above_zero_are_an_error_with_the_line_of_their_link(moments):
    with pytest.raises(PhysicsError, match=r"<urdf>:3:1: link part: no body of 2 kg has the moments of inertia"):
        repair(with_inertia(moments))


def test_a_number_of_an_inertia_that_is_none_is_an_error():
    with pytest.raises(PhysicsError, match=r"link part: a value of its <inertia> is not a number"):
        repair(with_inertia((1, 1, "nan", 0, 0, 0)))


def test_a_friction_below_zero_is_an_error_with_the_line_of_its_joint():
    head = HEAD.replace("</joint>", '<dynamics damping="-1" friction="0.1"/></joint>')
    with pytest.raises(PhysicsError, match=r"<urdf>:2:1: joint turn: damping=-1 of <dynamics> is below 0"):
        repaired(parse_description(f"{head}{with_inertia((1, 1, 1, 0, 0, 0))}</robot>", "<urdf>"))
