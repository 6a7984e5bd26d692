import pytest

from canopen_control.errors import ConfigError
from canopen_control.view.meshes import find_mesh, read_mesh

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


def test_a_mesh_is_found_by_its_whole_path(robot):
    file = robot.parents[1] / "meshes" / "wheel.stl"
    assert find_mesh(f"file://{file}", str(robot), {}) == file


def test_a_package_is_found_where_ros_has_it(robot, tmp_path):
    share = tmp_path / "opt" / "share" / "other" / "m.stl"
    share.parent.mkdir(parents=True)
    share.write_text(TETRAHEDRON)
    environment = {"AMENT_PREFIX_PATH": f"{tmp_path / 'nothing'}:{tmp_path / 'opt'}"}
    assert find_mesh("package://other/m.stl", str(robot), environment) == share


@pytest.mark.parametrize(
    ("uri", "words"),
    [
        ("http://evil.example/a.stl", "only files of this computer"),
        ("package://absent/a.stl", "AMENT_PREFIX_PATH"),
        ("a.stl", "there is no file"),
    ],
)
def test_what_is_not_there_is_a_sentence(robot, uri, words):
    with pytest.raises(ConfigError, match=words):
        find_mesh(uri, str(robot), {})


def test_a_mesh_is_read(robot):
    mesh = read_mesh(find_mesh("../meshes/wheel.stl", str(robot), {}))
    assert len(mesh.faces) == 2
    assert mesh.visual.kind is None


def test_what_is_no_mesh_is_a_sentence(tmp_path):
    for name, words in (("a.dae", "is not read"), ("b.stl", "cannot be read|no faces")):
        (tmp_path / name).write_text("nonsense")
        with pytest.raises(ConfigError, match=words):
            read_mesh(tmp_path / name)
