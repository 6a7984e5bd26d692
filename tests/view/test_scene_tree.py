import math

import pytest

from canopen_control.data_files import data_path
from canopen_control.urdf.description import read_description
from canopen_control.urdf.geometry import Pose
from canopen_control.urdf.joint_element import Joint
from canopen_control.urdf.robot_model import RobotModel, UrdfLink, Visual, read_model
from canopen_control.view.scene_tree import SceneTree, Trail, angles_of, extent_of


@pytest.fixture
def robby():
    return read_model(read_description(data_path("config", "robby") / "robby.urdf.xacro").urdf_xml)


def made(model, path="/nowhere/r.urdf"):
    published = []
    tree = SceneTree(model, path, lambda content, kind: published.append(content) or f"/mesh/{len(published)}.{kind}")
    return tree, published


def test_the_tree_is_that_of_the_urdf(robby):
    tree, _ = made(robby)
    wheel = next(joint for joint in tree.tree["joints"] if joint["name"] == "left_wheel_joint")
    assert wheel["position"] == pytest.approx((-0.05, 0.12, 0.021))
    assert wheel["visuals"][0]["size"][0] == 0.035
    assert tree.notes == []


def test_angles_are_in_joint_order_and_unknown_ones_are_none(robby):
    result = angles_of(robby, {"left_wheel_joint": 1.0, "right_wheel_joint": math.nan})
    reported = dict(zip([joint.name for joint in robby.from_root], result, strict=True))
    assert (reported["left_wheel_joint"], reported["right_wheel_joint"]) == (1.0, None)


def test_what_cannot_be_drawn_is_reported_and_the_rest_is_there():
    visuals = (Visual("mesh", (1, 1, 1), file="a.stl"), Visual("sphere", (0.2,)))
    tree, _ = made(RobotModel("r", {"base": UrdfLink("base", visuals)}, notes=("x",)))
    assert [note.split(":")[0] for note in tree.notes] == ["x", "mesh a.stl"]
    assert [item["shape"] for item in tree.tree["visuals"]] == ["sphere"]


def test_a_mesh_is_served_once_however_often_it_is_used(tmp_path):
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    visual = Visual("mesh", (2.0, 2.0, 2.0), file="a.obj")
    tree, published = made(RobotModel("r", {"base": UrdfLink("base", (visual, visual))}), str(tmp_path / "r.urdf"))
    assert [item["url"] for item in tree.tree["visuals"]] == ["/mesh/1.stl"] * 2
    assert len(published) == 1


def test_the_trail_grows_with_the_way_and_restarts_after_a_jump():
    trail = Trail()
    for step in range(21):
        trail.add((step / 200, 0.0, 0.0))
    assert len(trail.points) == 11
    trail.add((50.0, 0.0, 0.0))
    assert list(trail.points) == [(50.0, 0.0)]


def test_the_camera_fits_the_reach_of_the_robot(robby):
    assert 0.1 < extent_of(robby) < 0.4
    assert extent_of(RobotModel("r")) == 0.1
    ball = UrdfLink("b", (Visual("sphere", (1,)),))
    far = RobotModel("r", {"a": UrdfLink("a"), "b": ball}, {"s": Joint("s", "fixed", "a", "b", Pose((3, 0, 0)))})
    assert extent_of(far) == 3.5
