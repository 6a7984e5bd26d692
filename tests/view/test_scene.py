import math

import pytest

from canopen_control.data_files import data_path
from canopen_control.hardware.description import read_description
from canopen_control.view.model import Joint, Model, Visual, read_model
from canopen_control.view.scene import BASE, RobotScene, extent_of

WHEEL = f"{BASE}/base_footprint/base_link/left_wheel"


@pytest.fixture
def robby():
    return read_model(read_description(data_path("config", "robby") / "robby.urdf.xacro").urdf_xml)


@pytest.fixture
def scene(server, robby):
    return RobotScene(server, robby, "robby.urdf")


def node(server, path):
    return server.scene.get_handle_by_name(path)


def test_the_tree_of_frames_is_that_of_the_urdf(server, scene):
    assert tuple(node(server, WHEEL).position) == pytest.approx((-0.05, 0.12, 0.021))
    assert node(server, f"{WHEEL}/visual_0").radius == 0.035
    assert scene.notes == []


def test_a_wheel_turns_and_the_base_stands_where_nobody_knows_its_way(server, scene):
    scene.move({"left_wheel_joint": math.pi / 2, "right_wheel_joint": None}, None)
    assert tuple(node(server, WHEEL).wxyz) == pytest.approx((math.sqrt(0.5), 0, math.sqrt(0.5), 0))
    assert tuple(node(server, BASE).position) == (0, 0, 0)


def test_the_world_moves_under_a_robot_that_is_followed(server, scene):
    scene.move({}, (1.0, 2.0, math.pi))
    assert tuple(node(server, BASE).position) == (1, 2, 0)
    assert tuple(node(server, BASE).wxyz) == pytest.approx((0, 0, 0, 1), abs=1e-12)
    assert tuple(node(server, "/world").position) == (-1, -2, 0)
    scene.follow_robot(False)
    assert tuple(node(server, "/world").position) == (0, 0, 0)


def test_the_trail_grows_with_the_way_and_begins_anew_after_a_jump(server, scene):
    for step in range(11):
        scene.move({}, (step / 100, 0.0, 0.0))
    scene.draw_trail()
    points = node(server, "/world/trail").points
    assert points.shape == (11, 2, 3)
    assert points[-1][1][0] == pytest.approx(0.1)
    handle = node(server, "/world/trail")
    for step in range(11, 15):
        scene.move({}, (step / 100, 0.0, 0.0))
    scene.draw_trail()
    assert node(server, "/world/trail") is handle  # it grows, and is not made anew
    assert handle.points.shape == (15, 2, 3)
    scene.move({}, (50.0, 0.0, 0.0))
    assert node(server, "/world/trail") is None


def test_a_robot_that_stands_sends_nothing(server, scene):
    scene.move({"left_wheel_joint": 1.0}, (1.0, 0.0, 0.0))
    buffer = server._websock_server._broadcast_buffer
    before = buffer.message_counter
    scene.move({"left_wheel_joint": 1.0}, (1.0, 0.0, 0.0))
    scene.draw_trail()
    scene.tint(set())
    assert buffer.message_counter == before


def test_what_hangs_on_a_faulty_drive_is_red(server, scene):
    before = tuple(node(server, f"{WHEEL}/visual_0").color)
    scene.tint({"left_wheel_joint", "unknown"})
    assert tuple(node(server, f"{WHEEL}/visual_0").color) == (214, 40, 40)
    scene.tint(set())
    assert tuple(node(server, f"{WHEEL}/visual_0").color) == before


def test_what_cannot_be_drawn_is_told_and_the_rest_is_there(server):
    model = Model(
        "r", "base", visuals={"base": (Visual("mesh", (1, 1, 1), file="a.stl"), Visual("sphere", (0.2,)))}, notes=("x",)
    )
    scene = RobotScene(server, model, "/nowhere/r.urdf")
    assert [note.split(":")[0] for note in scene.notes] == ["x", "mesh a.stl"]
    assert node(server, f"{BASE}/base/visual_1") is not None


def test_a_mesh_is_drawn(server, tmp_path):
    import trimesh

    trimesh.creation.box().export(tmp_path / "box.stl")
    model = Model("r", "base", visuals={"base": (Visual("mesh", (2.0, 2.0, 2.0), file="box.stl"),)})
    assert RobotScene(server, model, str(tmp_path / "r.urdf")).notes == []
    drawn = node(server, f"{BASE}/base/visual_0")
    assert tuple(drawn.scale) == (2.0, 2.0, 2.0)
    assert len(drawn.faces) == 12


def test_a_mesh_with_colours_of_its_own_keeps_them(server, tmp_path):
    import trimesh

    box = trimesh.creation.box()
    box.visual.vertex_colors = (10, 200, 30, 255)
    box.export(tmp_path / "box.ply")
    model = Model("r", "base", visuals={"base": (Visual("mesh", (1.0, 1.0, 1.0), file="box.ply"),)})
    assert RobotScene(server, model, str(tmp_path / "r.urdf")).notes == []
    assert node(server, f"{BASE}/base/visual_0").glb_data.startswith(b"glTF")


def test_a_slide_slides(server):
    model = Model("r", "a", (Joint("s", "prismatic", "a", "b", axis=(0, 0, 1)),))
    RobotScene(server, model, "").move({"s": 0.3}, None)
    assert tuple(node(server, f"{BASE}/a/b").position) == pytest.approx((0, 0, 0.3))


def test_the_camera_knows_how_far_the_robot_reaches(robby):
    assert 0.1 < extent_of(robby) < 0.4
    assert extent_of(Model("r", "base")) == 0.1
