"""What stands in a simulated world beside the robot, as it is drawn: boxes, walls, the slabs of ramps, and where.

The law of the file: it is read from the model, so that whatever puts a box into a world need not tell it twice. A
robot's own shapes touch the world and are no part of it; the floor is everywhere and is drawn by who draws.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import mujoco
import numpy as np

from canopen_control.rpc.messages.drive import WorldShape

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = ["shapes_of"]

_WORLD: Final = 1  # the kind of contact that the world has, and the robot has not: see `body_model`
_DIGITS: Final = 4


def shapes_of(model: Any, data: Any) -> tuple[WorldShape, ...]:  # noqa: ANN401 - MuJoCo has no types
    """Return the boxes of a world, where they are in `data`; m, quaternions w, x, y, z."""
    return tuple(_shapes(model, data))


def _shapes(model: Any, data: Any) -> Iterator[WorldShape]:  # noqa: ANN401 - as above
    for number in range(model.ngeom):
        if model.geom_type[number] != mujoco.mjtGeom.mjGEOM_BOX or not model.geom_contype[number] & _WORLD:
            continue
        turn = np.zeros(4)
        mujoco.mju_mat2Quat(turn, data.geom_xmat[number])
        x, y, z = _rounded(data.geom_xpos[number])
        length, width, height = _rounded(2.0 * model.geom_size[number])
        qw, qx, qy, qz = _rounded(turn)
        yield WorldShape(
            name=model.geom(number).name or f"box {number}",
            kind="box",
            size=(length, width, height),
            position=(x, y, z),
            rotation=(qw, qx, qy, qz),
            moves=bool(model.geom_bodyid[number]),
        )


def _rounded(values: Any) -> list[float]:  # noqa: ANN401 - numpy's
    return [round(float(each), _DIGITS) + 0.0 for each in values]
