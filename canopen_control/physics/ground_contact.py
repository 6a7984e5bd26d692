"""Detection of a robot's contacts with the floor: wheels, casters, and the height of its root.

With all joints at 0 the lowest round shapes carry the robot. A cylinder or sphere that a joint turns about its own axis
is a wheel; a horizontal cylinder that no joint turns, such as that of a steered wheel without an axle, is a roller that
turns freely; any other contact is a caster. A robot without wheels is fixed to the ground.
"""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import mujoco
import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray


# Mecanum wheels: a smooth wheel is simulated, and the force of its roller is added. It acts along the roller's axle
# against the sliding velocity of the contact point, up to the friction of the floor. Its gain is a fraction of the
# value that would stop the mass at this point within one step, so that it is stable for any step; a creep of some mm/s
# remains while the robot accelerates.


_SHARE: Final = 0.15  # fraction of the velocity that the force removes within one step
_LIFTED_M: Final = 0.002  # height above the floor without a force


@dataclass(frozen=True)
class RollerWheel:
    """Mecanum wheel: index of its shape, index of the body that carries it, and its radius in m.

    `angle` is the direction of the roller's axle on the ground, in degrees from ahead to the left.
    """

    geom: int
    frame: int
    angle: float
    radius: float


class MecanumContact:
    """Contact of one mecanum wheel with the ground; `load` is the weight on the wheel in N."""

    def __init__(self, model: Any, data: Any, wheel: RollerWheel, load: float) -> None:  # noqa: ANN401 - of MuJoCo
        self._model, self._data, self._wheel, self._load = model, data, wheel, load
        self._body = int(model.geom_bodyid[wheel.geom])
        turn = math.radians(wheel.angle)
        self._own = np.array([math.cos(turn), math.sin(turn), 0.0])  # direction of the axle in the frame of the robot
        self._velocity, self._down = np.zeros(6), np.array([0.0, 0.0, -wheel.radius])
        self._push, self._none = np.zeros(model.nv), np.zeros(3)
        self._gain = self._find_gain()

    def _find_gain(self) -> float:
        """Return the force per m/s of slip, from the effective mass at the contact point."""
        self._push[:] = 0.0
        axle = self._axle()
        point = self._data.geom_xpos[self._wheel.geom] + self._down
        mujoco.mj_applyFT(self._model, self._data, axle, self._none, point, self._body, self._push)
        answer = np.zeros((1, self._model.nv))
        mujoco.mj_solveM(self._model, self._data, answer, self._push.reshape(1, -1))
        mobility = float(self._push @ answer[0])
        return _SHARE / (mobility * float(self._model.opt.timestep))

    def _axle(self) -> NDArray[np.float64]:
        axle: NDArray[np.float64] = self._data.xmat[self._wheel.frame].reshape(3, 3) @ self._own
        axle[2] = 0.0
        return axle / (float(np.linalg.norm(axle)) or 1.0)

    def add_force(self, friction: float) -> None:
        """Add the roller's contact force, limited by friction, to the joint forces of the next step."""
        centre = self._data.geom_xpos[self._wheel.geom]
        if float(centre[2]) > self._wheel.radius + _LIFTED_M:
            return
        kind = mujoco.mjtObj.mjOBJ_XBODY  # velocity of the frame, not of the centre of mass
        mujoco.mj_objectVelocity(self._model, self._data, kind, self._body, self._velocity, 0)
        point, axle = centre + self._down, self._axle()
        arm = point - self._data.xpos[self._body]
        sliding = float(axle @ (self._velocity[3:] + np.cross(self._velocity[:3], arm)))
        most = friction * self._load
        force = max(-most, min(most, -self._gain * sliding))
        mujoco.mj_applyFT(self._model, self._data, force * axle, self._none, point, self._body, self._data.qfrc_applied)


_NEAR_M: Final = 0.006  # height above the lowest point: approximated round shapes touch the floor too
_PARALLEL: Final = 0.999  # cosine between two parallel axes
_LEVEL: Final = 0.1  # vertical component of a horizontal axis
_OFF_AXIS: Final = 0.05  # fraction of the radius
_ROUND: Final = (int(mujoco.mjtGeom.mjGEOM_CYLINDER), int(mujoco.mjtGeom.mjGEOM_SPHERE))


class ContactPart(enum.Enum):
    """Kind of a contact with the floor: driven wheel, free roller, or caster."""

    WHEEL = "wheel"
    ROLLER = "roller"
    CASTER = "caster"


@dataclass(frozen=True)
class Touch:
    """Contact of a shape with the floor; `joint` turns a wheel ("" for other contacts), `radius` is in m."""

    geom: str
    part: ContactPart
    joint: str
    radius: float


@dataclass(frozen=True)
class Ground:
    """Contacts of a robot with the floor; `lift` is the height of the root in m when the robot stands on the floor."""

    touches: tuple[Touch, ...]
    lift: float

    @property
    def rolls(self) -> bool:
        """Whether the robot has wheels or rollers on the floor."""
        return any(touch.part is not ContactPart.CASTER for touch in self.touches)


def ground_at_rest(model: Any) -> Ground:  # noqa: ANN401 - a model of MuJoCo, which has no types
    """Find the floor contacts of a compiled model with a fixed root and all joints at 0."""
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
    """Return the height in m of the lowest point of a shape."""
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
    return height - float(np.abs(rotation[2]) @ size)  # a box; for all other shapes an upper bound of the extent


def _touch(model: Any, data: Any, geom: int) -> Touch:  # noqa: ANN401 - as above
    radius = float(model.geom_size[geom][0])
    place, axis = data.geom_xpos[geom], data.geom_xmat[geom].reshape(3, 3)[:, 2]
    cylinder = int(model.geom_type[geom]) == mujoco.mjtGeom.mjGEOM_CYLINDER
    for joint in _turning(model, int(model.geom_bodyid[geom])):
        if _is_about(place, axis if cylinder else None, data.xanchor[joint], data.xaxis[joint], radius):
            return Touch(model.geom(geom).name, ContactPart.WHEEL, model.joint(joint).name, radius)
    rolls = cylinder and abs(float(axis[2])) < _LEVEL
    return Touch(model.geom(geom).name, ContactPart.ROLLER if rolls else ContactPart.CASTER, "", radius)


def _turning(model: Any, body: int) -> Iterator[int]:  # noqa: ANN401 - as above
    """Yield the hinges of a body or, if it has no joints, of its nearest ancestor with joints."""
    while body and not int(model.body_jntnum[body]):
        body = int(model.body_parentid[body])
    first = int(model.body_jntadr[body])
    for joint in range(first, first + int(model.body_jntnum[body])):
        if int(model.jnt_type[joint]) == mujoco.mjtJoint.mjJNT_HINGE:
            yield joint


def _is_about(
    place: NDArray[np.float64],
    axle: NDArray[np.float64] | None,
    anchor: NDArray[np.float64],
    axis: NDArray[np.float64],
    radius: float,
) -> bool:
    """Whether a joint axis is horizontal and runs through the centre of a shape, along the axis if it is a cylinder."""
    off = place - anchor
    distance = float(np.linalg.norm(off - (off @ axis) * axis))
    level = abs(float(axis[2])) < _LEVEL
    return level and distance < _OFF_AXIS * radius and (axle is None or abs(float(axle @ axis)) > _PARALLEL)
