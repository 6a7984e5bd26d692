"""Motors of a robot's joints: settings from the plant file, and estimates of missing values.

The motor of a wheel is estimated from the mass that it moves, the motor of another joint from its inertia and weight in
several postures. The `effort` in the description is the peak torque.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import mujoco
import numpy as np

from canopen_control.physics.ground_contact import ContactPart, Ground

if TYPE_CHECKING:
    from collections.abc import Mapping

    from canopen_control.physics.physics_file import AxisSettings


_ROTOR: Final = 0.2  # minimum rotor inertia, as a fraction of the inertia at the joint
_ROTOR_ACCELERATION: Final = 500.0  # maximum rad/s2 of the rotor alone at the rated torque
_POSTURES: Final = 8
_GOLDEN: Final = 0.6180339887498949
_RATED: Final = 0.8  # fraction of the weight on a wheel, as a force at its rim
_ARM_ACCELERATION: Final = 10.0  # rad/s2 in addition to the weight
_FRICTION, _DAMPING = 0.02, 0.001  # fraction of the rated torque


@dataclass(frozen=True)
class EstimatedMotor:
    """Complete motor data of a joint, referred to the joint side of the gear, in Nm, kg m2 and Nm s (N, kg and N s)."""

    rated_torque: float
    peak_torque: float
    inertia: float
    rotor: float
    friction: float
    damping: float
    brake: bool


@dataclass(frozen=True)
class Described:
    """Values of a joint in the robot description, in Nm, Nm s and rad/s (N, N s, m/s if prismatic)."""

    effort: float = math.inf
    friction: float | None = None
    damping: float | None = None
    speed: float = 1.0


def estimated_motors(
    model: Any,  # noqa: ANN401 - as above
    axes: Mapping[str, AxisSettings],
    described: Mapping[str, Described],
    ground: Ground,
) -> dict[str, EstimatedMotor]:
    """Return the motors by joint; the plant file takes precedence over the description, and both over estimates."""
    wheels = {touch.joint: touch.radius for touch in ground.touches if touch.part is ContactPart.WHEEL}
    driven = [joint for joint in axes if joint in wheels] or [""]
    share = float(model.body_subtreemass[0]) / len(driven)
    inertias, weights = _in_postures(model, axes)
    gravity = float(np.linalg.norm(model.opt.gravity))
    motors = {}
    for name, axis in axes.items():
        radius, inertia, weight = wheels.get(name, 0.0), inertias[name], weights[name]
        inertia += share * radius * radius
        need = _RATED * share * gravity * radius + (0.0 if radius else 2.0 * (weight + inertia * _ARM_ACCELERATION))
        motors[name] = _motor(axis, described.get(name, Described()), inertia, max(need, 1e-6), wheel=radius > 0.0)
    return motors


def _motor(axis: AxisSettings, described: Described, inertia: float, need: float, *, wheel: bool) -> EstimatedMotor:
    friction = described.friction if axis.friction is None else axis.friction
    damping = described.damping if axis.damping is None else axis.damping
    need += (friction or 0.0) + (damping or 0.0) * described.speed
    effort = described.effort
    peak = axis.peak_torque or (effort if 0.0 < effort < math.inf else 2.0 * need)
    rated = axis.rated_torque or 0.5 * peak
    rotor = max(_ROTOR * inertia, rated / _ROTOR_ACCELERATION)
    if axis.rotor_inertia is not None:
        rotor = axis.rotor_inertia * axis.gear**2
    return EstimatedMotor(
        rated,
        axis.peak_torque or max(peak, rated),
        axis.inertia or inertia + rotor,
        rotor,
        _FRICTION * rated if friction is None else friction,
        _DAMPING * rated if damping is None else damping,
        (not wheel) if axis.brake is None else axis.brake,
    )


def _in_postures(model: Any, axes: Mapping[str, AxisSettings]) -> tuple[dict[str, float], dict[str, float]]:  # noqa: ANN401
    """Return, by joint, the geometric mean of the inertia and the largest gravity torque over several postures."""
    data = mujoco.MjData(model)
    matrix = np.zeros((model.nv, model.nv))
    logs, weights = dict.fromkeys(axes, 0.0), dict.fromkeys(axes, 0.0)
    for posture in range(_POSTURES):
        data.qpos[:] = model.qpos0
        for number, name in enumerate(axes):
            joint = model.joint(name)
            low, high = joint.range if joint.limited[0] else (-math.pi, math.pi)
            data.qpos[joint.qposadr[0]] = low + (high - low) * math.fmod((posture + 1) * (number + 1) * _GOLDEN, 1.0)
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, matrix)
        for name in axes:
            dof = int(model.joint(name).dofadr[0])
            logs[name] += math.log(max(1e-12, float(matrix[dof, dof]))) / _POSTURES
            weights[name] = max(weights[name], abs(float(data.qfrc_bias[dof])))
    return {name: math.exp(value) for name, value in logs.items()}, weights
