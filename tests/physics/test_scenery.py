import math

import mujoco
import numpy as np
import pytest

from canopen_control.physics.physics_world import shapes_of
from canopen_control.physics.scene_file import Box, Ramp, Wall, WorldDescription
from canopen_control.physics.scenery import add_scenery
from canopen_control.physics.sdf_world import MeshPart, Solid
from canopen_control.urdf.geometry import Pose, about


def scene(**parts):
    spec = mujoco.MjSpec()
    add_scenery(spec, WorldDescription(**parts), [0.004, 1.0])
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def height(model, data, x, y):
    """Return how high the first thing below a point in the sky is."""
    sky, down, result = np.array([x, y, 10.0]), np.array([0.0, 0.0, -1.0]), np.zeros(1, dtype=np.int32)
    way = float(mujoco.mj_ray(model, data, sky, down, None, 1, -1, result))
    return None if way < 0 else 10.0 - way


@pytest.mark.parametrize("heading", [0.0, 90.0, 200.0])
def test_a_ramp_rises_from_its_lower_edge(heading):
    model, data = scene(ramps=[Ramp((1.0, 2.0), 10.0, 2.0, 1.0, heading)])
    turn = math.radians(heading)
    for way in (0.05, 1.0, 1.9):
        place = 1.0 + way * math.cos(turn), 2.0 + way * math.sin(turn)
        assert height(model, data, *place) == pytest.approx(way * math.tan(math.radians(10.0)), abs=1e-6)
    assert height(model, data, 1.0 - 0.1 * math.cos(turn), 2.0 - 0.1 * math.sin(turn)) is None


def test_a_wall_stands_between_its_points():
    model, data = scene(walls=[Wall((0.0, 0.0), (0.0, 2.0), 0.7, 0.1)])
    assert height(model, data, 0.0, 1.9) == pytest.approx(0.7)
    assert height(model, data, 0.1, 1.0) is None


def test_a_box_with_a_mass_moves_and_one_without_does_not():
    model, _ = scene(boxes=[Box((1.0, 0.0), (0.2, 0.4, 0.6), mass=3.0), Box((2.0, 0.0), (0.2, 0.2, 0.2))])
    assert float(model.body_mass[model.body("box 0").id]) == pytest.approx(3.0)
    assert model.njnt == 1
    assert model.geom("box 1").bodyid[0] == 0


CORNERS = np.array([(x, y, z) for x in (0.0, 1.0) for y in (0.0, 0.001) for z in (0.0, 2.0)])


@pytest.mark.parametrize(
    ("kind", "size", "parts", "top", "drawn"),
    [
        ("box", (0.1, 0.2, 0.3), (), 1.3, "box"),
        ("sphere", (0.5,), (), 1.5, "ellipsoid"),
        ("ellipsoid", (0.1, 0.2, 0.4), (), 1.4, "ellipsoid"),
        ("cylinder", (0.1, 0.6), (), 1.6, "cylinder"),
        ("capsule", (0.1, 0.6), (), 1.7, "cylinder"),
        ("mesh", (), (MeshPart(CORNERS - [0.5, 0.0, 0.0]),), 3.0, "box"),
    ],
)
def test_a_solid_stands_fast_where_its_pose_specifies_and_is_drawn(kind, size, parts, top, drawn):
    solid = Solid("m::l::c", kind, Pose((2.0, 1.0, 1.0)), size, parts)
    model, data = scene(solids=(solid,))
    assert height(model, data, 2.0, 1.0005) == pytest.approx(top, abs=2e-4)
    assert model.njnt == 0
    assert model.geom_contype.tolist() == [1]
    (shape,) = shapes_of(model, data)
    assert (shape.kind, shape.moves) == (drawn, False)


def test_a_plane_is_endless_and_tilted_as_its_pose_specifies():
    model, data = scene(solids=(Solid("m::l::c", "plane", Pose((0.0, 0.0, 1.0), about((0.0, 1.0, 0.0), -0.1))),))
    assert height(model, data, 5.0, 7.0) == pytest.approx(1.0 + 5.0 * math.tan(0.1), abs=1e-6)
