import mujoco
import pytest
from support.physicsbench import ROBBY, world_of

from canopen_control.physics.physics_world import patches_of, shapes_of
from canopen_control.physics.world_file import Patch
from canopen_control.virtual.plant import FurnishedWorld

MODEL = """
<mujoco><worldbody>
  <geom name="floor" type="plane" size="0 0 1"/>
  <geom name="wall" type="box" size="1 0.025 0.25" pos="2 0 0.25" euler="0 0 90"/>
  <geom name="robot's" type="box" size="1 1 1" contype="2" conaffinity="1"/>
  <geom name="ball" type="sphere" size="1"/>
  <body name="parcel" pos="0 0 5">
    <freejoint/>
    <geom name="parcel" type="box" size="0.1 0.2 0.3" mass="1" contype="3"/>
  </body>
</worldbody></mujoco>
"""


def test_boxes_of_the_world_are_told_where_they_are_now():
    model = mujoco.MjModel.from_xml_string(MODEL)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    wall, parcel = shapes_of(model, data)
    assert (wall.name, wall.kind, wall.moves) == ("wall", "box", False)
    assert (wall.size, wall.position) == ((2.0, 0.05, 0.5), (2.0, 0.0, 0.25))
    assert wall.rotation == pytest.approx((0.7071, 0.0, 0.0, 0.7071), abs=1e-3)
    assert (parcel.name, parcel.moves, parcel.size) == ("parcel", True, (0.2, 0.4, 0.6))
    mujoco.mj_step(model, data, 300)
    assert shapes_of(model, data)[1].position[2] < parcel.position[2] == 5.0


def test_the_robots_own_shapes_are_no_part_of_its_world(tmp_path):
    world = world_of(tmp_path, ROBBY)
    assert isinstance(world, FurnishedWorld)
    assert world.shapes() == ()


def test_another_robot_is_drawn_by_its_shapes_and_a_mesh_of_it_by_its_bounds():
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><asset><mesh name="m" vertex="0 0 0  1 0 0  0 2 0  0 0 3"/></asset><worldbody>
        <geom name="mine/a" type="box" size="1 1 1" contype="2"/>
        <geom name="other/a" type="cylinder" size="0.5 1" contype="4"/>
        <geom name="other/b" type="sphere" size="0.5" contype="4"/>
        <geom name="other/c" type="ellipsoid" size="0.1 0.2 0.3" contype="4"/>
        <geom name="other/d" type="mesh" mesh="m" contype="4"/></worldbody></mujoco>"""
    )
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert shapes_of(model, data) == ()
    a, b, c, d = shapes_of(model, data, "mine/")
    assert (a.kind, a.size, a.robot) == ("cylinder", (1.0, 1.0, 2.0), "other")
    assert (b.kind, b.size) == ("ellipsoid", (1.0, 1.0, 1.0))
    assert (c.kind, c.size) == ("ellipsoid", (0.2, 0.4, 0.6))
    assert d.kind == "box"
    assert sorted(d.size) == pytest.approx([1.0, 2.0, 3.0], rel=0.3)  # along axes of the mesh's own
    x, y, z = d.position
    assert (0 < x < 1, 0 < y < 2, 0 < z < 3) == (True, True, True)


def test_a_patch_is_flat_and_tells_its_grip():
    (patch,) = patches_of([Patch((1.0, 2.0), (1.0, 3.0), 0.1, 180.0)])
    assert (patch.kind, patch.size[:2], patch.position, patch.grip) == ("patch", (1.0, 3.0), (1.0, 2.0, 0.0), 0.1)
    assert patch.rotation == pytest.approx((0.0, 0.0, 0.0, 1.0))
