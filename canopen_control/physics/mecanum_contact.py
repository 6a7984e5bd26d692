"""The contact of mecanum wheels with the floor: it holds along the axle of the roller on the ground, and no other way.

A wheel with rollers is simulated as a smooth one, and the force of its roller is added: against the velocity with which
the point on the ground slides along the roller's axle, up to the friction of the floor. The gain is a share of what the
mass at that point would need within one step, so that it is stable at any step; what is left is a creep of some
millimetres a second while the robot accelerates.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import mujoco
import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["MecanumContact", "RollerWheel"]

_SHARE: Final = 0.15  # of the velocity that a force takes away within a step
_LIFTED_M: Final = 0.002  # above the floor, no force any more


@dataclass(frozen=True)
class RollerWheel:
    """A wheel by the numbers of its shape and of the body it hangs on; the roller's `angle` from ahead, in degrees."""

    geom: int
    frame: int
    angle: float
    radius: float


class MecanumContact:
    """The roller of one wheel on the ground; `load` is the weight on it in N."""

    def __init__(self, model: Any, data: Any, wheel: RollerWheel, load: float) -> None:  # noqa: ANN401 - of MuJoCo
        self._model, self._data, self._wheel, self._load = model, data, wheel, load
        self._body = int(model.geom_bodyid[wheel.geom])
        turn = math.radians(wheel.angle)
        self._own = np.array([math.cos(turn), math.sin(turn), 0.0])  # the axle, as the robot sees it
        self._velocity, self._down = np.zeros(6), np.array([0.0, 0.0, -wheel.radius])
        self._push, self._none = np.zeros(model.nv), np.zeros(3)
        self._gain = self._find_gain()

    def _find_gain(self) -> float:
        """Return the force for each m/s: of the mass that a force at the roller sees."""
        self._push[:] = 0.0
        axle = self._axle()
        point = self._data.geom_xpos[self._wheel.geom] + self._down
        mujoco.mj_applyFT(self._model, self._data, axle, self._none, point, self._body, self._push)
        answer = np.zeros((1, self._model.nv))
        mujoco.mj_solveM(self._model, self._data, answer, self._push.reshape(1, -1))
        mobility = float(self._push @ answer[0])
        return _SHARE / (mobility * float(self._model.opt.timestep))

    def _axle(self) -> NDArray[np.float64]:
        """Return the direction of the axle in the world, level."""
        axle: NDArray[np.float64] = self._data.xmat[self._wheel.frame].reshape(3, 3) @ self._own
        axle[2] = 0.0
        return axle / (float(np.linalg.norm(axle)) or 1.0)

    def add_force(self, friction: float) -> None:
        """Add the force of the roller to what acts on the joints in the next step."""
        centre = self._data.geom_xpos[self._wheel.geom]
        if float(centre[2]) > self._wheel.radius + _LIFTED_M:
            return
        kind = mujoco.mjtObj.mjOBJ_XBODY  # of the frame, not of the centre of mass
        mujoco.mj_objectVelocity(self._model, self._data, kind, self._body, self._velocity, 0)
        point, axle = centre + self._down, self._axle()
        arm = point - self._data.xpos[self._body]
        sliding = float(axle @ (self._velocity[3:] + np.cross(self._velocity[:3], arm)))
        most = friction * self._load
        force = max(-most, min(most, -self._gain * sliding))
        mujoco.mj_applyFT(self._model, self._data, force * axle, self._none, point, self._body, self._data.qfrc_applied)
