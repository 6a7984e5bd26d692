"""Finds what of a robot touches the floor: wheels, casters, and the height at which it stands.

Standing as the description draws it, with all joints at 0, the lowest round shapes carry the robot. A cylinder or
sphere that a joint turns about its own axis is a wheel; a cylinder that lies on its side and is not turned by a joint,
as that of a steered wheel drawn without its axle, rolls freely; everything else that touches is a caster. A robot that
no wheel carries is bolted to the ground.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import mujoco
import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

__all__ = ["Ground", "Part", "Touch", "stand"]

_NEAR_M: Final = 0.006  # above the lowest point: drawn roundly, it touches all the same
_PARALLEL: Final = 0.999  # of two axes, the cosine
_LEVEL: Final = 0.1  # of an axis, its part upwards
_OFF_AXIS: Final = 0.05  # of the radius
_ROUND: Final = (int(mujoco.mjtGeom.mjGEOM_CYLINDER), int(mujoco.mjtGeom.mjGEOM_SPHERE))


class Part(enum.Enum):
    """How a shape meets the floor."""

    WHEEL = "wheel"
    ROLLER = "roller"
    CASTER = "caster"


@dataclass(frozen=True)
class Touch:
    """A shape on the floor by its name: the joint that turns it, if it is a wheel, and its radius in m."""

    geom: str
    part: Part
    joint: str
    radius: float


@dataclass(frozen=True)
class Ground:
    """What touches the floor; `lift` is how much higher in m the root has to be so that the lowest point is on it."""

    touches: tuple[Touch, ...]
    lift: float

    @property
    def rolls(self) -> bool:
        """Whether wheels carry it."""
        return any(touch.part is not Part.CASTER for touch in self.touches)


def stand(model: Any) -> Ground:  # noqa: ANN401 - a model of MuJoCo, which has no types
    """Return what of a compiled model, whose root is fixed, touches the floor."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    lowest = {geom: _lowest(model, data, geom) for geom in range(model.ngeom)}
    if not lowest:
        return Ground((), 0.0)
    floor = min(lowest.values())
    near = [geom for geom, height in lowest.items() if height < floor + _NEAR_M]
    touches = tuple(_touch(model, data, geom) for geom in near if int(model.geom_type[geom]) in _ROUND)
    return Ground(touches, -floor)


def _lowest(model: Any, data: Any, geom: int) -> float:  # noqa: ANN401 - as above
    """Return the height of the lowest point of a shape."""
    kind, size = int(model.geom_type[geom]), model.geom_size[geom]
    height, rotation = float(data.geom_xpos[geom][2]), data.geom_xmat[geom].reshape(3, 3)
    shapes = mujoco.mjtGeom
    if kind == shapes.mjGEOM_SPHERE:
        return height - float(size[0])
    if kind == shapes.mjGEOM_CYLINDER:
        along = abs(float(rotation[2, 2]))
        return height - float(size[0]) * float(np.sqrt(max(0.0, 1.0 - along * along))) - float(size[1]) * along
    if kind == shapes.mjGEOM_MESH:
        mesh = int(model.geom_dataid[geom])
        first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
        return height + float((model.mesh_vert[first : first + count] @ rotation[2]).min())
    return height - float(np.abs(rotation[2]) @ size)  # a box; of all others, no lower than theirs


def _touch(model: Any, data: Any, geom: int) -> Touch:  # noqa: ANN401 - as above
    radius = float(model.geom_size[geom][0])
    place, axis = data.geom_xpos[geom], data.geom_xmat[geom].reshape(3, 3)[:, 2]
    cylinder = int(model.geom_type[geom]) == mujoco.mjtGeom.mjGEOM_CYLINDER
    for joint in _turning(model, int(model.geom_bodyid[geom])):
        if _is_about(place, axis if cylinder else None, data.xanchor[joint], data.xaxis[joint], radius):
            return Touch(model.geom(geom).name, Part.WHEEL, model.joint(joint).name, radius)
    rolls = cylinder and abs(float(axis[2])) < _LEVEL
    return Touch(model.geom(geom).name, Part.ROLLER if rolls else Part.CASTER, "", radius)


def _turning(model: Any, body: int) -> Iterator[int]:  # noqa: ANN401 - as above
    """Yield the hinges of a body, or else of that to which it is fixed, and so on up."""
    while body and not int(model.body_jntnum[body]):
        body = int(model.body_parentid[body])
    first = int(model.body_jntadr[body])
    for joint in range(first, first + int(model.body_jntnum[body])):
        if int(model.jnt_type[joint]) == mujoco.mjtJoint.mjJNT_HINGE:
            yield joint


def _is_about(
    place: NDArray[np.float64],
    own: NDArray[np.float64] | None,
    anchor: NDArray[np.float64],
    axis: NDArray[np.float64],
    radius: float,
) -> bool:
    """Whether a shape at `place`, round about its `own` axis or about any, turns about a level axis through it."""
    off = place - anchor
    distance = float(np.linalg.norm(off - (off @ axis) * axis))
    level = abs(float(axis[2])) < _LEVEL
    return level and distance < _OFF_AXIS * radius and (own is None or abs(float(own @ axis)) > _PARALLEL)
