import math
import struct

import numpy as np
import pytest

from canopen_control.physics.physics_file import PhysicsError
from canopen_control.physics.scene_file import read_world_description
from canopen_control.physics.sdf_world import convex_parts, read_sdf_world


def stl(*triangles):
    """Return triangles as binary STL."""
    rows = b"".join(
        struct.pack("<12fH", *(0.0,) * 3, *(n for corner in triangle for n in corner), 0) for triangle in triangles
    )
    return bytes(80) + struct.pack("<I", len(triangles)) + rows


def cube(x, size):
    """Return two triangles for each side of a cube that begins at x."""
    at = [(x + i * size, j * size, k * size) for i in (0, 1) for j in (0, 1) for k in (0, 1)]
    sides = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    return [(at[a], at[b], at[c]) for s in sides for a, b, c in ((s[0], s[1], s[2]), (s[0], s[2], s[3]))]


def test_each_piece_that_hangs_together_is_a_part_at_the_scale():
    parts = convex_parts(stl(*cube(0.0, 1.0), *cube(3.0, 0.5)), (1.0, 2.0, 1.0))
    bounds = sorted((*part.corners.min(axis=0), *part.corners.max(axis=0)) for part in parts)
    assert np.allclose(bounds, [(0, 0, 0, 1, 2, 1), (3, 0, 0, 3.5, 1, 0.5)])


@pytest.mark.parametrize(
    ("content", "why"),
    [
        (stl(((0, 0, 0), (1, 0, 0), (0, float("nan"), 0))), "a coordinate is not a finite number"),
        (stl(*(((10 * n, 0, 0), (10 * n + 1, 0, 0), (10 * n, 1, 0)) for n in range(501))), "501 separate pieces"),
        (bytes(80) + struct.pack("<I", 200_001), "200001 faces are more than the possible 200000"),
    ],
)
def test_what_cannot_be_simulated_is_reported(content, why):
    with pytest.raises(ValueError, match=why):
        convex_parts(content, (1.0, 1.0, 1.0))


SHAPE = '<collision name="c"><geometry>{}</geometry></collision>'
BOX = SHAPE.format("<box><size>0.2 0.4 0.6</size></box>")
TRIANGLE = struct.pack("<12fH", 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0)


def sdf(inside):
    return f'<?xml version="1.0"?>\n<sdf version="1.9">\n{inside}\n</sdf>\n'


def world_of(tmp_path, inside):
    path = tmp_path / "hall.sdf"
    path.write_text(sdf(f'<world name="hall">\n{inside}\n</world>'))
    return read_sdf_world(path)


def model(inside, name="m", static=True):
    return f'<model name="{name}">{"<static>true</static>" if static else ""}{inside}</model>'


def link(inside, pose=""):
    return f'<link name="l">{pose}{inside}</link>'


def places(world):
    return [tuple(round(number, 9) for number in solid.pose.position) for solid in world.solids]


@pytest.mark.parametrize(
    ("shape", "kind", "size"),
    [
        ("<box><size>0.2 0.4 0.6</size></box>", "box", (0.1, 0.2, 0.3)),
        ("<sphere><radius>0.5</radius></sphere>", "sphere", (0.5,)),
        ("<ellipsoid><radii>1 2 3</radii></ellipsoid>", "ellipsoid", (1.0, 2.0, 3.0)),
        ("<cylinder><radius>0.5</radius><length>2</length></cylinder>", "cylinder", (0.5, 1.0)),
        ("<capsule><radius>0.5</radius><length>2</length></capsule>", "capsule", (0.5, 1.0)),
    ],
)
def test_a_shape_has_half_its_lengths(tmp_path, shape, kind, size):
    (solid,) = world_of(tmp_path, model(link(SHAPE.format(shape)))).solids
    assert (solid.name, solid.kind, solid.size) == ("m::l::c", kind, pytest.approx(size))


def test_poses_of_models_links_and_collisions_follow_each_other(tmp_path):
    turned = '<pose degrees="true">1 2 0 0 0 90</pose>'
    shape = BOX.replace("<geometry>", "<pose>0.5 0 0 0 0 0</pose><geometry>")
    world = world_of(tmp_path, model(turned + link(shape, "<pose>1 0 0.3 0 0 0</pose>")))
    assert places(world) == [(1.0, 3.5, 0.3)]
    quarter = math.sqrt(0.5)
    assert world.solids[0].pose.rotation == pytest.approx((quarter, 0.0, 0.0, quarter))


def test_a_pose_is_relative_to_a_frame_and_a_frame_to_what_it_is_attached_to(tmp_path):
    frames = '<frame name="a"><pose>1 0 0 0 0 0</pose></frame>'
    frames += '<frame name="b" attached_to="a"><pose>0 2 0 0 0 0</pose></frame>'
    quat = '<pose relative_to="b" rotation_format="quat_xyzw">0 0 3 0 0 0 2</pose>'
    assert places(world_of(tmp_path, model(frames + link(BOX, quat)))) == [(1.0, 2.0, 3.0)]
    nested = model("<pose>5 0 0 0 0 0</pose>" + model(link(BOX), "inner"), "outer")
    world = world_of(tmp_path, nested)
    assert places(world) == [(5.0, 0.0, 0.0)]
    assert world.solids[0].name == "outer::inner::l::c"


def test_the_floor_is_there_already_and_another_plane_stands(tmp_path):
    flat = link(SHAPE.format("<plane><normal>0 0 1</normal><size>9 9</size></plane>"))
    slope = link(SHAPE.format("<plane><normal>0 -1 1</normal></plane>"), "<pose>0 1 0 0 0 0</pose>")
    (solid,) = world_of(tmp_path, model(flat) + model(slope, "slope")).solids
    assert (solid.name, solid.kind) == ("slope::l::c", "plane")
    assert solid.pose.of((0.0, 0.0, 1.0)) == pytest.approx((0.0, 1.0 - math.sqrt(0.5), math.sqrt(0.5)))


def test_a_file_that_is_included_has_the_pose_and_the_name_of_the_include(tmp_path, monkeypatch):
    folder = tmp_path / "models" / "shelf"
    folder.mkdir(parents=True)
    (folder / "model.config").write_text("<model><sdf>old.sdf</sdf><sdf>new.sdf</sdf></model>")
    (folder / "new.sdf").write_text(sdf(model("<pose>9 0 0 0 0 0</pose>" + link(BOX))))
    include = "<include><uri>{}</uri>{}</include>"
    here = include.format("models/shelf", "<name>s1</name><pose>2 0 0 0 0 0</pose>")
    named = include.format("models/shelf/new.sdf", "")
    world = world_of(tmp_path, here + named + include.format("model://sun", ""))
    assert places(world) == [(2.0, 0.0, 0.0), (9.0, 0.0, 0.0)]
    assert [solid.name for solid in world.solids] == ["s1::l::c", "m::l::c"]
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.setenv("GZ_SIM_RESOURCE_PATH", str(tmp_path / "models"))
    assert places(world_of(tmp_path / "elsewhere", include.format("model://shelf", ""))) == [(9.0, 0.0, 0.0)]


def test_a_mesh_is_its_convex_parts_and_what_differs_from_gazebo_is_reported(tmp_path):
    (tmp_path / "roof.stl").write_bytes(bytes(80) + struct.pack("<I", 1) + TRIANGLE)
    mesh = SHAPE.format("<mesh><uri>roof.stl</uri><scale>2 1 1</scale></mesh>")
    world = world_of(tmp_path, model(link(mesh)) + model(link(BOX), "crate", static=False))
    assert world.solids[0].parts[0].corners.max(axis=0) == pytest.approx((2.0, 1.0, 0.0005))
    path = tmp_path / "hall.sdf"
    assert world.notes == (
        f"{path}: these models are not static in the file, but fixed here: crate",
        f"{path}: each part of a mesh has the contacts of its convex hull: roof.stl (1 part)",
    )


@pytest.mark.parametrize(
    ("inside", "message"),
    [
        (
            "<include><uri>https://fuel.gazebosim.org/1.0/a/models/t</uri></include>",
            "t is not on this computer; download",
        ),
        ("<include><uri>model://t</uri></include>", "model://t: no such model next to this file, in GZ_SIM_"),
        ("<include><uri>t</uri></include>", "t: no such model at "),
        ("<include/>", "<include> has no <uri>"),
        (model(link(SHAPE.format("<heightmap/>"))), "<heightmap> is not a supported shape; use one of box, sphere, "),
        (model(link(SHAPE.format("<mesh><uri>no.stl</uri></mesh>"))), "mesh no.stl: file "),
        (model(link(SHAPE.format("<mesh/>"))), "<mesh> has no <uri>"),
        (
            model(link(SHAPE.format("<mesh><uri>hall.sdf</uri></mesh>"))),
            "hall.sdf: .sdf is not supported; use .stl, .obj",
        ),
        (
            model(link(SHAPE.format("<mesh><uri>a.stl</uri><scale>1 0 1</scale></mesh>"))),
            "<scale> of <mesh> must be three",
        ),
        (model(link(SHAPE.format("<box><size>1 0 1</size></box>"))), "<size> of <box> must be 3 numbers above 0, in m"),
        (
            model(link(SHAPE.format("<sphere><radius>inf</radius></sphere>"))),
            "<radius> of <sphere> must be a number above 0",
        ),
        (
            model(link(SHAPE.format("<cylinder><radius>1</radius></cylinder>"))),
            "<length> of <cylinder> must be a number",
        ),
        (model(link(SHAPE.format("<plane><normal>0 0</normal></plane>"))), "<normal> of <plane> must be three numbers"),
        (model(link('<collision name="c"/>')), "<collision> has no shape"),
        (model(link(BOX, "<pose>0 0 x 0 0 0</pose>")), "<pose> '0 0 x 0 0 0' is not six numbers, x y z in m and roll"),
        (model(link(BOX, '<pose rotation_format="quat_xyzw">0 0 0 0 0 0 0</pose>')), "the quaternion of <pose> is 0"),
        (model(link(BOX, '<pose relative_to="k">0 0 0 0 0 0</pose>')), "no frame 'k' in this scope; known: l"),
        (
            model('<frame name="a"><pose relative_to="a"/></frame>' + link(BOX, '<pose relative_to="a"/>')),
            "of 'a' depends",
        ),
    ],
)
def test_what_cannot_stand_is_one_sentence_with_its_line(tmp_path, inside, message):
    with pytest.raises(PhysicsError) as caught:
        world_of(tmp_path, inside)
    (line,) = str(caught.value).splitlines()
    assert line.startswith(f"{tmp_path}/hall.sdf:4:")
    assert message in line


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (sdf(model(link(BOX))), "hall.sdf:2:1: no <world> in this file; give the file of a world, not of a model"),
        ("<robot/>", "hall.sdf:1:1: <robot> is not SDF"),
        ("text", "hall.sdf:1:1: not valid XML"),
        (sdf('<world name="a"/><world name="b"/>'), "hall.sdf:3:18: a second <world>"),
        (None, "hall.sdf: cannot be read: No such file or directory"),
    ],
)
def test_a_file_that_is_not_a_world_is_reported(tmp_path, content, message):
    path = tmp_path / "hall.sdf"
    if content is not None:
        path.write_text(content)
    with pytest.raises(PhysicsError) as caught:
        read_world_description(path)
    assert message in str(caught.value)


def test_all_errors_of_a_world_are_reported_at_once_and_a_file_that_includes_itself_ends(tmp_path):
    (tmp_path / "ring.sdf").write_text(sdf(model("<include><uri>ring.sdf</uri></include>")))
    with pytest.raises(PhysicsError) as caught:
        world_of(tmp_path, "<include/><include/><include><uri>ring.sdf</uri></include>")
    lines = str(caught.value).splitlines()
    assert len(lines) == 3
    assert "ring.sdf:3:1: more than 16 nested models; does a model include itself?" in lines[2]


def test_a_world_in_yaml_names_one_in_sdf(tmp_path):
    world_of(tmp_path, model(link(BOX)))
    (tmp_path / "hall.yml").write_text("sdf: hall.sdf\nwalls: [{from: [0, 2], to: [4, 2]}]\n")
    world = read_world_description(tmp_path / "hall.yml")
    assert [solid.name for solid in world.solids] == ["m::l::c"]
    assert len(world.walls) == 1
