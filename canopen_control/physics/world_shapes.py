"""What is in a simulated world beside a robot, as it is drawn: boxes, walls, ramps, patches, other robots, and where.

The law of the file: it is read from the model, so that whatever puts a box into a world need not tell it twice. A
robot's own shapes touch the world and are no part of it, those of another one are; the floor is everywhere and is drawn
by who draws, except for the patches on it, which are no shapes of the model.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final

import mujoco
import numpy as np

from canopen_control.physics.scenery import SOLID
from canopen_control.rpc.messages.world_shape import WorldShape
from canopen_control.urdf.geometry import from_yaw

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from canopen_control.physics.world_file import Patch

__all__ = ["patches_of", "shapes_of"]

_WORLD: Final = 1  # the kind of contact that the world has, and the robot has not: see `body_model`
_DIGITS: Final = 4
_PATCH_M: Final = 0.002  # that a patch is drawn thick
_GEOMS = mujoco.mjtGeom
_KINDS: Final = {_GEOMS.mjGEOM_BOX: "box", _GEOMS.mjGEOM_CYLINDER: "cylinder", _GEOMS.mjGEOM_ELLIPSOID: "ellipsoid",
                 _GEOMS.mjGEOM_SPHERE: "ellipsoid", _GEOMS.mjGEOM_CAPSULE: "cylinder"}  # fmt: skip


def patches_of(patches: Iterable[Patch]) -> tuple[WorldShape, ...]:
    """Return the patches of a floor as flat shapes that tell their grip."""
    return tuple(
        WorldShape(
            name=f"patch {number}",
            kind="patch",
            size=(*patch.size, _PATCH_M),
            position=(*patch.at, 0.0),
            rotation=from_yaw(math.radians(patch.heading)),
            grip=patch.friction,
        )
        for number, patch in enumerate(patches)
    )


def shapes_of(model: Any, data: Any, own: str = "") -> tuple[WorldShape, ...]:  # noqa: ANN401 - MuJoCo has no types
    """Return the boxes of a world and, beside the robot whose names begin with `own`, the other robots.

    Where they are in `data`; m, quaternions w, x, y, z.
    """
    return tuple(_shapes(model, data, own))


def _shapes(model: Any, data: Any, own: str) -> Iterator[WorldShape]:  # noqa: ANN401 - as above
    for number in range(model.ngeom):
        kind, name = int(model.geom_type[number]), str(model.geom(number).name)
        is_world = bool(model.geom_contype[number] & _WORLD)
        other = bool(own) and not is_world and not name.startswith(own)
        stands = is_world and (kind == _GEOMS.mjGEOM_BOX or name.startswith(SOLID))
        if kind == _GEOMS.mjGEOM_MESH and (other or stands):
            kind = int(_GEOMS.mjGEOM_BOX)  # its bounds say enough of another robot, and of a convex part
        if kind not in _KINDS or not (other or stands):
            continue
        turn = np.zeros(4)
        mujoco.mju_mat2Quat(turn, data.geom_xmat[number])
        x, y, z = _rounded(data.geom_xpos[number] + _middle(model, data, number))
        length, width, height = _rounded(_lengths(model, number))
        qw, qx, qy, qz = _rounded(turn)
        yield WorldShape(
            name=name or f"box {number}",
            kind=_KINDS[mujoco.mjtGeom(kind)],
            size=(length, width, height),
            position=(x, y, z),
            rotation=(qw, qx, qy, qz),
            moves=bool(model.geom_bodyid[number]),
            robot=name.partition("/")[0] if other else "",
        )


def _lengths(model: Any, number: int) -> Any:  # noqa: ANN401 - numpy's
    """Return how long a shape is along its own axes."""
    kind, size = int(model.geom_type[number]), model.geom_size[number]
    if kind == _GEOMS.mjGEOM_SPHERE:
        return np.full(3, 2.0 * size[0])
    if kind in (_GEOMS.mjGEOM_CYLINDER, _GEOMS.mjGEOM_CAPSULE):
        ends = size[0] if kind == _GEOMS.mjGEOM_CAPSULE else 0.0
        return np.array([2.0 * size[0], 2.0 * size[0], 2.0 * (size[1] + ends)])
    if kind == _GEOMS.mjGEOM_MESH:
        return 2.0 * model.geom_aabb[number, 3:]
    return 2.0 * size


def _middle(model: Any, data: Any, number: int) -> Any:  # noqa: ANN401 - as above
    """Return where the middle of a shape is from its place, in the world: elsewhere for a mesh alone."""
    return data.geom_xmat[number].reshape(3, 3) @ model.geom_aabb[number, :3]


def _rounded(values: Any) -> list[float]:  # noqa: ANN401 - numpy's
    return [round(float(each), _DIGITS) + 0.0 for each in values]
