"""A robot as a model of MuJoCo: its root freed where wheels carry it, on a floor, with a motor on each driven joint.

Wheels become ellipsoids of their radius and width: these have one point of contact and turn as odometry expects, while
a cylinder scrubs by an amount that depends on the step. Everything touches the floor and nothing of the robot itself.
Each driven joint gets the motor's rotor and friction, and a lock for its brake and for a blocked shaft.

What the file does not say of a motor is estimated: of a wheel from the mass that it moves, of another joint from its
inertia and weight in some postures; `effort` of the description is the peak torque.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import mujoco
import numpy as np

from canopen_control.errors import nearest
from canopen_control.physics.ground_contact import Ground, Part, stand
from canopen_control.physics.mecanum_contact import RollerWheel
from canopen_control.physics.physics_file import PhysicsError
from canopen_control.physics.scenery import add_scenery
from canopen_control.physics.world_sensors import add_sensors
from canopen_control.urdf.geometry import from_yaw

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from canopen_control.physics.physics_file import AxisSettings, Floor
    from canopen_control.physics.urdf_repair import RepairedUrdf
    from canopen_control.physics.world_file import WorldDescription
    from canopen_control.physics.world_sensors import WorldSensor
    from canopen_control.urdf.description import Description

__all__ = ["BASE_JOINT", "Body", "JointPlace", "Motor", "build", "compiled", "estimated_motors", "give_locks", "placed",
           "read_spec"]  # fmt: skip

BASE_JOINT: Final = "floating_base_joint"
_FLOOR: Final = "floor"
_LOCK: Final = "lock of "
_SOLIMP: Final = (0.95, 0.99, 0.0005, 0.5, 2.0)
_ROBOT, _WORLD = 2, 1  # kinds of contact: the robot touches the world, and not itself
_TYRE: Final = " tyre"
_ROTOR: Final = 0.2  # of the inertia at the joint; a motor and gear for more torque than that needs have more,
_ROTOR_ACCELERATION: Final = 500.0  # rad/s2 by its rated torque, alone
_POSTURES: Final = 8
_GOLDEN: Final = 0.6180339887498949
_RATED: Final = 0.8  # of the weight on a wheel, as a force at its rim
_ARM_ACCELERATION: Final = 10.0  # rad/s2 beside its weight
_FRICTION, _DAMPING = 0.02, 0.001  # of the rated torque


@dataclass(frozen=True)
class Motor:
    """A motor with everything known, on the joint's side: N m, kg m2, N m s (N, kg, N s of a prismatic joint)."""

    rated_torque: float
    peak_torque: float
    inertia: float
    rotor: float
    friction: float
    damping: float
    brake: bool


@dataclass(frozen=True)
class JointPlace:
    """Where a joint is in the model: its numbers in qpos and qvel, of its lock, and whose motor moves it."""

    qpos: int
    dof: int
    lock: int
    motor: Motor


@dataclass(frozen=True)
class Body:
    """A compiled model and its driven joints by name; `base` is the number of the freed root body, None: it is fixed.

    `notes` tell what was guessed; `wheels` and `casters` are the numbers of the shapes on the floor.
    """

    model: Any
    joints: dict[str, JointPlace]
    base: int | None
    notes: tuple[str, ...]
    wheels: tuple[int, ...] = ()
    casters: tuple[int, ...] = ()
    rollers: tuple[RollerWheel, ...] = ()


def read_spec(urdf: RepairedUrdf, path: str) -> Any:  # noqa: ANN401 - MuJoCo has no types
    """Return what MuJoCo makes of a URDF; PhysicsError where it makes nothing of it."""
    try:
        return mujoco.MjSpec.from_string(urdf.text, assets=urdf.meshes)
    except ValueError as error:
        raise PhysicsError(f"{path}: MuJoCo cannot read it: {_first_line(error)}") from error


def _first_line(error: ValueError) -> str:
    return next((line for line in str(error).splitlines() if line.strip()), "it does not say why")


def compiled(spec: Any, path: str) -> Any:  # noqa: ANN401 - as above
    """Return the model of a specification; PhysicsError where it cannot be simulated."""
    try:
        return spec.compile()
    except ValueError as error:
        raise PhysicsError(f"{path}: MuJoCo cannot simulate it: {' '.join(str(error).split())}") from error


def build(
    spec: Any,  # noqa: ANN401 - as above
    description: Description,
    axes: Mapping[str, AxisSettings],
    floor: Floor,
    *,
    step: float,
    density: float,
    free: bool | None,
    path: str,
    world: WorldDescription,
    sensors: Sequence[WorldSensor] = (),
) -> Body:
    """Make the model of a description in a world; `axes` by their joints, `free`: its root is, None: if it rolls.

    Lengths in m, `step` in s. PhysicsError, with a line in the file at `path`, for a joint that is not there.
    """
    _check_joints(axes, description, path)
    for number, geom in enumerate(spec.geoms):
        geom.name = geom.name or f"{geom.parent.name} shape {number}"
        geom.density = density
    ground = stand(compiled(spec, description.path))
    is_free = ground.rolls if free is None else free
    _set_options(spec, step)
    give_locks(spec, axes, step)
    add_sensors(spec, sensors, path)
    _touch_floor(spec, ground, floor, step)
    root = description.model.root
    if is_free:
        body = spec.body(root)
        body.add_freejoint(name=BASE_JOINT)
        body.pos = [*world.start.at, ground.lift]
        body.quat = list(from_yaw(math.radians(world.start.heading)))
    _lay_floor(spec, step, 0.0 if is_free else min(0.0, -ground.lift))
    add_scenery(spec, world, _solref(step))
    efforts = {name: description.joints[name].limits.effort for name in axes}
    motors = estimated_motors(compiled(spec, description.path), axes, efforts, ground)
    for name, motor in motors.items():
        joint = spec.joint(name)
        joint.armature = motor.rotor
        joint.frictionloss = motor.friction
        joint.damping = [motor.damping, 0.0, 0.0]
    model = compiled(spec, description.path)
    return Body(
        model,
        {name: placed(model, name, motor) for name, motor in motors.items()},
        int(model.body(root).id) if is_free else None,
        tuple(_told(axes, motors, ground, is_free)),
        *_on_floor(model, ground, axes),
    )


def give_locks(spec: Any, axes: Mapping[str, AxisSettings], step: float) -> None:  # noqa: ANN401 - as above
    """Add what holds each driven joint, off until a brake or a blocked shaft needs it."""
    for joint in axes:
        lock = spec.add_equality(name=f"{_LOCK}{joint}", type=mujoco.mjtEq.mjEQ_JOINT, name1=joint, active=False)
        lock.objtype = mujoco.mjtObj.mjOBJ_JOINT
        lock.solref, lock.solimp = [2.0 * step, 1.0], [0.99, 0.999, 0.0001, 0.5, 2.0]


def _check_joints(axes: Mapping[str, AxisSettings], description: Description, path: str) -> None:
    problems = []
    for name, axis in axes.items():
        joint = description.joints.get(name)
        if joint is None:
            problems.append(f"{path}:{axis.here.line}:{axis.here.column}: {description.path} has no joint {name!r}"
                            f"{nearest(name, description.movable_joints)}")  # fmt: skip
        elif joint.type not in ("continuous", "revolute", "prismatic"):
            problems.append(f"{path}:{axis.here.line}:{axis.here.column}: joint {name} is {joint.type}; "
                            "a drive moves a continuous, revolute or prismatic one")  # fmt: skip
    if problems:
        raise PhysicsError("\n".join(problems))


def _set_options(spec: Any, step: float) -> None:  # noqa: ANN401 - as above
    spec.option.timestep = step
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST  # friction and damping are stable at any size
    spec.option.impratio = 10.0
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC


def _touch_floor(spec: Any, ground: Ground, floor: Floor, step: float) -> None:  # noqa: ANN401 - as above
    """Give each shape what it does on the floor."""
    touches = {touch.geom: touch for touch in ground.touches}
    rolling = {touch.geom for touch in ground.touches if touch.part is not Part.CASTER}
    turning = {geom.parent.name for geom in spec.geoms if geom.name in rolling}
    for geom in list(spec.geoms):
        touch = touches.get(geom.name)
        part = Part.CASTER if touch is None else touch.part
        _set_contact(geom, floor.caster_friction if part is Part.CASTER else floor.friction, step)
        if touch is None and geom.parent.name in turning:  # spokes and treads that are drawn turn with it
            geom.contype = geom.conaffinity = 0
        if touch is None or part is Part.CASTER:
            continue
        if part is Part.ROLLER:
            geom = _loosened(geom, step, floor.friction)
        if geom.type == mujoco.mjtGeom.mjGEOM_CYLINDER:
            radius, half = geom.size[0], geom.size[1]
            geom.type, geom.size = mujoco.mjtGeom.mjGEOM_ELLIPSOID, [radius, radius, half]


def _set_contact(geom: Any, friction: float, step: float) -> None:  # noqa: ANN401 - as above
    geom.solref, geom.solimp = _solref(step), list(_SOLIMP)
    geom.condim, geom.contype, geom.conaffinity = 3, _ROBOT, _WORLD
    geom.friction = [friction, 0.005, 0.0001]


def _solref(step: float) -> list[float]:
    """Return time constant and damping of a contact: of 4 ms, and no less than the solver needs."""
    return [max(0.004, 2.0 * step), 1.0]


def _loosened(geom: Any, step: float, friction: float) -> Any:  # noqa: ANN401 - as above
    """Put half of a cylinder on an axle of its own, on which it turns freely; the other half is the hub."""
    geom.contype = geom.conaffinity = 0
    geom.density = 0.5 * geom.density
    wheel = geom.parent.add_body(name=f"{geom.name} rolling", pos=geom.pos, quat=geom.quat)
    wheel.add_joint(name=f"{geom.name} axle", type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0.0, 0.0, 1.0])
    rolling = wheel.add_geom(name=f"{geom.name}{_TYRE}", type=geom.type, size=geom.size, density=geom.density)
    _set_contact(rolling, friction, step)
    return rolling


def _lay_floor(spec: Any, step: float, height: float) -> None:  # noqa: ANN401 - as above
    plane = mujoco.mjtGeom.mjGEOM_PLANE
    floor = spec.worldbody.add_geom(name=_FLOOR, type=plane, size=[0, 0, 0.05], pos=[0, 0, height])
    _set_contact(floor, 0.0, step)  # the larger friction of two counts: that of the wheel, or of the caster
    floor.contype, floor.conaffinity = _WORLD, _ROBOT


def _on_floor(
    model: Any,  # noqa: ANN401 - as above
    ground: Ground,
    axes: Mapping[str, AxisSettings],
) -> tuple[tuple[int, ...], tuple[int, ...], tuple[RollerWheel, ...]]:
    """Return the numbers of the shapes that roll on the floor, of those that slide on it, and the mecanum wheels."""
    places: dict[bool, list[int]] = {True: [], False: []}
    rollers = []
    for touch in ground.touches:
        angle = None if touch.joint not in axes else axes[touch.joint].roller
        if angle is not None:
            geom = int(model.geom(touch.geom).id)
            model.geom_friction[geom, 0] = 0.0
            frame = int(model.body_parentid[int(model.joint(touch.joint).bodyid[0])])
            rollers.append(RollerWheel(geom, frame, angle, touch.radius))
            continue
        name = f"{touch.geom}{_TYRE}" if touch.part is Part.ROLLER else touch.geom
        places[touch.part is not Part.CASTER].append(int(model.geom(name).id))
    return tuple(places[True]), tuple(places[False]), tuple(rollers)


# -- motors


def estimated_motors(
    model: Any,  # noqa: ANN401 - as above
    axes: Mapping[str, AxisSettings],
    efforts: Mapping[str, float],
    ground: Ground,
) -> dict[str, Motor]:
    """Return the motors by joint, with what the file does not say estimated; `efforts` are those of a description."""
    wheels = {touch.joint: touch.radius for touch in ground.touches if touch.part is Part.WHEEL}
    driven = [joint for joint in axes if joint in wheels] or [""]
    share = float(model.body_subtreemass[0]) / len(driven)
    inertias, weights = _in_postures(model, axes)
    gravity = float(np.linalg.norm(model.opt.gravity))
    found = {}
    for name, axis in axes.items():
        radius, inertia, weight = wheels.get(name, 0.0), inertias[name], weights[name]
        inertia += share * radius * radius
        need = _RATED * share * gravity * radius + (0.0 if radius else 2.0 * (weight + inertia * _ARM_ACCELERATION))
        found[name] = _motor(axis, efforts.get(name, math.inf), inertia, max(need, 1e-6), wheel=radius > 0.0)
    return found


def _motor(axis: AxisSettings, effort: float, inertia: float, need: float, *, wheel: bool) -> Motor:
    peak = axis.peak_torque or (effort if 0.0 < effort < math.inf else 2.0 * need)
    rated = axis.rated_torque or 0.5 * peak
    rotor = max(_ROTOR * inertia, rated / _ROTOR_ACCELERATION)
    if axis.rotor_inertia is not None:
        rotor = axis.rotor_inertia * axis.gear**2
    return Motor(
        rated,
        axis.peak_torque or max(peak, rated),
        axis.inertia or inertia + rotor,
        rotor,
        _FRICTION * rated if axis.friction is None else axis.friction,
        _DAMPING * rated if axis.damping is None else axis.damping,
        (not wheel) if axis.brake is None else axis.brake,
    )


def _in_postures(model: Any, axes: Mapping[str, AxisSettings]) -> tuple[dict[str, float], dict[str, float]]:  # noqa: ANN401
    """Return the inertia of each joint, a geometric mean over postures, and the greatest torque of its weight."""
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


def placed(model: Any, name: str, motor: Motor) -> JointPlace:  # noqa: ANN401 - as above
    """Return where a driven joint is in a model."""
    joint = model.joint(name)
    return JointPlace(int(joint.qposadr[0]), int(joint.dofadr[0]), int(model.equality(f"{_LOCK}{name}").id), motor)


def _told(axes: Mapping[str, AxisSettings], motors: Mapping[str, Motor], ground: Ground, free: bool) -> list[str]:
    """Return in words what was found and guessed."""
    wheels = [touch.joint for touch in ground.touches if touch.part is Part.WHEEL]
    others = [touch.geom.partition(" shape ")[0] for touch in ground.touches if touch.part is Part.ROLLER]
    what = f"on wheels: {', '.join(wheels)}" if wheels else "on no driven wheels"
    rolling = f", {', '.join(others)} turning freely" if others else ""
    lines = [f"the robot stands {what}{rolling}" if free else "no wheel carries the robot: it is bolted to the ground"]
    guessed = [name for name, axis in axes.items() if axis.rated_torque is None]
    if guessed:
        told = ", ".join(f"{name} {motors[name].rated_torque:.3g} Nm" for name in guessed)
        lines.append(f"rated torques are estimated: {told}")
    return lines
