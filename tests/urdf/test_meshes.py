import struct

import pytest

from canopen_control.errors import ConfigError
from canopen_control.urdf.meshes import dae_triangles, find_mesh, obj_triangles, read_mesh

DAE = """<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema">
<asset><unit meter="0.001"/><up_axis>{up}</up_axis></asset>
<library_geometries><geometry id="g"><mesh><source id="p">
<float_array count="12">
0 0 0 1000 0 0 1000 1000 0 0 1000 0</float_array></source>

<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>{part}</mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="s">
<node><translate>0 0 2000</translate><rotate>0 0 1 90</rotate>
<node><scale>2 1 1</scale>
<instance_geometry url="#g"/></node></node></visual_scene></library_visual_scenes></COLLADA>"""
TRIANGLE = """<triangles count="1"><input semantic="VERTEX" source="#v" offset="0"/>
<input semantic="NORMAL" source="#n" offset="1"/>
<p>0 0 1 0 2 0</p></triangles>"""


def test_collada_is_read_where_its_nodes_put_it_in_metres():
    ((a, b, c),) = dae_triangles(DAE.format(up="Z_UP", part=TRIANGLE).encode())
    assert a == pytest.approx((0, 0, 2))
    assert b == pytest.approx((0, 2, 2))  # scaled, turned, then moved
    assert c == pytest.approx((-1, 2, 2))


def test_damaged_data_is_an_error_declared_by_the_reader():
    for text in (b"<COLLADA", DAE.format(up="Z_UP", part=TRIANGLE).replace("#g", "#x").encode()):
        with pytest.raises((ValueError, KeyError, IndexError)):
            dae_triangles(text)
    with pytest.raises(IndexError):
        obj_triangles(b"f 1 2 3\n")


TETRAHEDRON = """solid t
facet normal 0 0 -1
outer loop
vertex 0 0 0
vertex 0 1 0
vertex 1 0 0
endloop
endfacet
facet normal 0 -1 0
outer loop
vertex 0 0 0
vertex 1 0 0
vertex 0 0 1
endloop
endfacet
endsolid t
"""


@pytest.fixture
def robot(tmp_path):
    """Return the path of a description in a package, with a mesh beside it."""
    folder = tmp_path / "my_robot" / "urdf"
    folder.mkdir(parents=True)
    meshes = tmp_path / "my_robot" / "meshes"
    meshes.mkdir()
    (meshes / "wheel.stl").write_text(TETRAHEDRON)
    return folder / "my_robot.urdf"


@pytest.mark.parametrize("uri", ["package://my_robot/meshes/wheel.stl", "../meshes/wheel.stl"])
def test_a_mesh_is_found_from_where_the_description_is(robot, uri):
    assert find_mesh(uri, str(robot), {}).resolve() == robot.parents[1] / "meshes" / "wheel.stl"


@pytest.mark.rest
def test_a_package_is_found_where_ros_has_it(robot, tmp_path):
    share = tmp_path / "opt" / "share" / "other" / "m.stl"
    share.parent.mkdir(parents=True)
    share.write_text(TETRAHEDRON)
    environment = {"AMENT_PREFIX_PATH": f"{tmp_path / 'nothing'}:{tmp_path / 'opt'}"}
    assert find_mesh("package://other/m.stl", str(robot), environment) == share


@pytest.mark.rest
@pytest.mark.parametrize(
    ("uri", "words"),
    [
        ("http://evil.example/a.stl", "only local files"),
        ("package://absent/a.stl", "AMENT_PREFIX_PATH"),
        ("a.stl", "does not exist"),
    ],
)
def test_what_is_not_there_is_a_sentence(robot, uri, words):
    with pytest.raises(ConfigError, match=words):
        find_mesh(uri, str(robot), {})


def test_a_binary_mesh_is_read_as_it_is_and_a_text_as_binary(robot, tmp_path):
    mesh = read_mesh(find_mesh("../meshes/wheel.stl", str(robot), {}))
    assert (mesh.format, len(mesh.content)) == ("stl", 84 + 2 * 50)
    assert struct.unpack("<12fH", mesh.content[84:134]) == (0, 0, -1, 0, 0, 0, 0, 1, 0, 1, 0, 0, 0)
    (tmp_path / "again.stl").write_bytes(mesh.content)
    assert read_mesh(tmp_path / "again.stl") == mesh


def test_other_formats_become_stl(tmp_path):
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    mesh = read_mesh(tmp_path / "a.obj")
    assert mesh.format == "stl"
    assert struct.unpack("<12fH", mesh.content[84:]) == (0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0)


def test_what_is_not_a_mesh_is_a_sentence(tmp_path):
    for name, words in (
        ("a.ply", "is not supported"),
        ("b.stl", "not an STL"),
        ("c.dae", "cannot be read"),
        ("d.obj", "no faces"),
        ("e.glb", "not a binary"),
        ("cut.stl", "7 corners are not whole triangles"),
    ):
        nonsense = f"solid facet{7 * f'{chr(10)}vertex 0 0 1'}" if name == "cut.stl" else "nonsense"
        (tmp_path / name).write_text(nonsense)
        with pytest.raises(ConfigError, match=words):
            read_mesh(tmp_path / name)


def test_an_stl_that_ends_too_early_is_a_sentence(tmp_path):
    (tmp_path / "a.stl").write_bytes(bytes(80) + (1000).to_bytes(4, "little") + bytes(50))
    with pytest.raises(ConfigError, match="1000 faces are announced"):
        read_mesh(tmp_path / "a.stl")
