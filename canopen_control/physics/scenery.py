"""Conversion of a world's objects to simulation shapes: ramps, boxes, walls and solids of an SDF world.

A ramp is a slab whose upper side begins at the floor. Fixed objects touch robots and movable boxes; a box with a mass
touches the floor and everything else. Ramps and solids have the friction of the shape that touches them, a wheel or a
caster.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final

import mujoco

from canopen_control.urdf.geometry import about, from_yaw, multiply

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.physics.scene_file import Box, Ramp, Wall, WorldDescription
    from canopen_control.physics.sdf_world import Solid


BOX: Final = "box "
"""Prefix of the name of a box, before its number in the file."""

SOLID: Final = "solid "
"""Prefix of the name of a shape of an SDF world, before its number."""

_SLAB_M: Final = 0.1  # thickness of a ramp below its upper side
_FIXED: Final = (1, 2)  # contype and conaffinity of the floor and of fixed objects, see `body_model`
_LOOSE: Final = (3, 3)
_GEOMS: Final = mujoco.mjtGeom
_SOLIDS: Final = {"box": _GEOMS.mjGEOM_BOX, "sphere": _GEOMS.mjGEOM_SPHERE, "cylinder": _GEOMS.mjGEOM_CYLINDER,
                  "capsule": _GEOMS.mjGEOM_CAPSULE, "ellipsoid": _GEOMS.mjGEOM_ELLIPSOID,
                  "plane": _GEOMS.mjGEOM_PLANE}  # fmt: skip


def add_scenery(spec: Any, world: WorldDescription, solref: Sequence[float]) -> None:  # noqa: ANN401 - of MuJoCo
    """Add the objects of a world to a MuJoCo specification; `solref` are their contact parameters (time, damping)."""
    for number, ramp in enumerate(world.ramps):
        _add_ramp(spec, f"ramp {number}", ramp, solref)
    for number, wall in enumerate(world.walls):
        _add_wall(spec, f"wall {number}", wall, solref)
    for number, box in enumerate(world.boxes):
        _add_box(spec, f"{BOX}{number}", box, solref)
    for number, solid in enumerate(world.solids):
        _add_solid(spec, f"{SOLID}{number} {solid.name}", solid, solref)


def _add_ramp(spec: Any, name: str, ramp: Ramp, solref: Sequence[float]) -> None:  # noqa: ANN401 - as above
    angle, half = math.radians(ramp.angle), 0.5 * ramp.length
    forward = half * math.cos(angle) + 0.5 * _SLAB_M * math.sin(angle)
    up = half * math.sin(angle) - 0.5 * _SLAB_M * math.cos(angle)
    turn = math.radians(ramp.heading)
    place = [ramp.at[0] + forward * math.cos(turn), ramp.at[1] + forward * math.sin(turn), up]
    yaw, pitch = from_yaw(turn), about((0.0, 1.0, 0.0), -angle)
    size = [half, 0.5 * ramp.width, 0.5 * _SLAB_M]
    _add_shape(spec.worldbody, name, size, place, multiply(yaw, pitch), 0.0, _FIXED, solref)


def _add_wall(spec: Any, name: str, wall: Wall, solref: Sequence[float]) -> None:  # noqa: ANN401 - as above
    (x, y), (to_x, to_y) = wall.begin, wall.end
    size = [0.5 * math.hypot(to_x - x, to_y - y), 0.5 * wall.thickness, 0.5 * wall.height]
    place = [0.5 * (x + to_x), 0.5 * (y + to_y), 0.5 * wall.height]
    turn = from_yaw(math.atan2(to_y - y, to_x - x))
    _add_shape(spec.worldbody, name, size, place, turn, 0.5, _FIXED, solref)


def _add_box(spec: Any, name: str, box: Box, solref: Sequence[float]) -> None:  # noqa: ANN401 - as above
    size = [0.5 * length for length in box.size]
    place, turn = [*box.at, box.above + size[2]], from_yaw(math.radians(box.heading))
    if not box.mass:
        _add_shape(spec.worldbody, name, size, place, turn, box.friction, _FIXED, solref)
        return
    body = spec.worldbody.add_body(name=name, pos=place, quat=list(turn))
    body.add_freejoint(name=f"{name} moves")
    shape = _add_shape(body, name, size, [0.0, 0.0, 0.0], from_yaw(0.0), box.friction, _LOOSE, solref)
    shape.mass = box.mass


def _add_solid(spec: Any, name: str, solid: Solid, solref: Sequence[float]) -> None:  # noqa: ANN401 - as above
    place, turn = solid.pose
    if solid.kind != "mesh":
        size = [*solid.size, 0.0, 0.0, 0.05][:3]  # size of a plane: infinite, and the spacing of its drawn grid
        _add_shape(spec.worldbody, name, size, place, turn, 0.0, _FIXED, solref, _SOLIDS[solid.kind])
    for number, part in enumerate(solid.parts):
        label = f"{name} {number}"
        # inertia of a shell, since the volume of a thin hull may not be computable
        spec.add_mesh(name=label, uservert=part.corners.flatten(), inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL)
        shape = _add_shape(spec.worldbody, label, [0.0, 0.0, 0.0], place, turn, 0.0, _FIXED, solref, _GEOMS.mjGEOM_MESH)
        shape.meshname = label


def _add_shape(
    body: Any,  # noqa: ANN401 - as above
    name: str,
    size: Sequence[float],
    place: Sequence[float],
    turn: Sequence[float],
    friction: float,
    kind: tuple[int, int],
    solref: Sequence[float],
    geom: Any = mujoco.mjtGeom.mjGEOM_BOX,  # noqa: ANN401 - as above
) -> Any:  # noqa: ANN401 - as above
    shape = body.add_geom(name=name, type=geom, size=list(size), pos=list(place), quat=list(turn), condim=3)
    shape.contype, shape.conaffinity = kind
    shape.friction, shape.solref = [friction, 0.005, 0.0001], list(solref)
    return shape
