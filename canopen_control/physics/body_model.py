"""MuJoCo model of a robot on a floor, with a free root if it has wheels, and a motor on each driven joint.

Wheels become ellipsoids with the same radius and width: an ellipsoid has one contact point and turns as odometry
expects, while a cylinder scrubs by an amount that depends on the time step. All shapes touch the floor; parts of one
robot do not touch each other. Every driven joint gets the inertia of the motor's rotor, the friction and damping of its
<dynamics>, or else of the motor, and a lock for its brake and for a blocked shaft.
"""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import mujoco

from canopen_control.errors import ConfigError, nearest
from canopen_control.physics.ground_contact import ContactPart, Ground, RollerWheel, ground_at_rest
from canopen_control.physics.motor_estimate import Described, estimated_motors
from canopen_control.physics.physics_file import PhysicsError
from canopen_control.physics.scenery import BOX, SOLID, add_scenery
from canopen_control.physics.world_sensors import add_sensors
from canopen_control.urdf.geometry import from_yaw

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

    from canopen_control.physics.motor_estimate import EstimatedMotor
    from canopen_control.physics.physics_file import AxisSettings, FloorContact
    from canopen_control.physics.scene_file import RobotStart, Start, WorldDescription
    from canopen_control.physics.urdf_repair import RepairedUrdf
    from canopen_control.physics.world_sensors import WorldSensor
    from canopen_control.urdf.description import UrdfDescription
    from canopen_control.urdf.joint_element import Joint


BASE_JOINT: Final = "floating_base_joint"
_FLOOR: Final = "floor"
_LOCK: Final = "lock of "
_SOLIMP: Final = (0.95, 0.99, 0.0005, 0.5, 2.0)
_LOG: Final = logging.getLogger(__name__)
_SETTLE_STEPS: Final = 300
#: warnings of MuJoCo for a state that is not finite or grows without bound; it then resets by itself
_UNSTABLE: Final = (
    mujoco.mjtWarning.mjWARN_BADQPOS,
    mujoco.mjtWarning.mjWARN_BADQVEL,
    mujoco.mjtWarning.mjWARN_BADQACC,
)
_ROBOT, _WORLD = 2, 1  # contact bits: the robot touches the world, and not itself
_EVERY_ROBOT: Final = 0x7FFFFFFE  # contact bits of several robots, each with one bit
_TYRE: Final = " tyre"


@dataclass(frozen=True)
class JointPlace:
    """Driven joint in a model: its indices in qpos and qvel, the index of its lock constraint, and its motor."""

    qpos: int
    dof: int
    lock: int
    motor: EstimatedMotor

    def hold(self, model: Any, data: Any, on: bool) -> None:  # noqa: ANN401 - MuJoCo has no types
        """Lock the joint at its current position if `on`, otherwise release the lock."""
        if on:
            model.eq_data[self.lock, 0] = data.qpos[self.qpos] - model.qpos0[self.qpos]
        data.eq_active[self.lock] = on


@dataclass(frozen=True)
class Body:
    """Robot in a compiled model; `base` is the body index of a free root, None for a fixed root.

    `notes` list assumptions; `wheels` and `casters` are the indices of the shapes on the floor. In a model of several
    robots all names of this robot begin with `prefix`, such as "robby1/".
    """

    model: Any
    joints: dict[str, JointPlace]
    base: int | None
    notes: tuple[str, ...]
    wheels: tuple[int, ...] = ()
    casters: tuple[int, ...] = ()
    rollers: tuple[RollerWheel, ...] = ()
    prefix: str = ""

    @property
    def links(self) -> dict[str, int]:
        names = ((str(self.model.body(number).name), number) for number in range(1, self.model.nbody))
        return {name.removeprefix(self.prefix): number for name, number in names if name.startswith(self.prefix)}


@dataclass(frozen=True)
class PreparedRobot:
    """Robot before it is added to a world: MuJoCo specification, floor contacts, and motors by joint."""

    spec: Any
    root: str
    ground: Ground
    free: bool
    axes: Mapping[str, AxisSettings]
    motors: Mapping[str, EstimatedMotor]
    notes: tuple[str, ...]

    def body(self, model: Any, prefix: str = "") -> Body:  # noqa: ANN401 - as above
        """Return the robot as part of a compiled world model; `prefix` precedes its names in the model."""
        return Body(
            model,
            {name: placed(model, name, motor, prefix) for name, motor in self.motors.items()},
            int(model.body(f"{prefix}{self.root}").id) if self.free else None,
            self.notes,
            *_on_floor(model, self.ground, self.axes, prefix),
            prefix,
        )


def read_spec(urdf: RepairedUrdf, path: str) -> Any:  # noqa: ANN401 - MuJoCo has no types
    """Return the MuJoCo specification of a URDF; raise PhysicsError if MuJoCo refuses it."""
    try:
        return mujoco.MjSpec.from_string(urdf.text, assets=urdf.meshes)
    except ValueError as error:
        raise PhysicsError(f"{path}: MuJoCo cannot read it: {_first_line(error)}") from error


def _first_line(error: ValueError) -> str:
    return next((line for line in str(error).splitlines() if line.strip()), "no reason was given")


def compiled(spec: Any, path: str) -> Any:  # noqa: ANN401 - as above
    """Compile a MuJoCo specification; raise PhysicsError if MuJoCo refuses the model."""
    try:
        return spec.compile()
    except ValueError as error:
        raise PhysicsError(f"{path}: MuJoCo cannot simulate it: {' '.join(str(error).split())}") from error


def alone(robot: PreparedRobot, world: WorldDescription, step: float, path: str) -> Body:
    """Return a robot in its own world; if its root is fixed, the floor is at the robot's lowest point."""
    add_floor(robot.spec, step, 0.0 if robot.free else min(0.0, -robot.ground.lift))
    add_scenery(robot.spec, world, solref(step))
    return robot.body(compiled(robot.spec, path))


def prepared(
    spec: Any,  # noqa: ANN401 - as above
    description: UrdfDescription,
    axes: Mapping[str, AxisSettings],
    floor: FloorContact,
    *,
    step: float,
    density: float,
    free: bool | None,
    path: str,
    start: Start,
    sensors: Sequence[WorldSensor] = (),
) -> PreparedRobot:
    """Return a robot with motors, locks and sensors, before it is added to a world.

    `axes` maps joints to settings. `free` is whether the robot's root is free; None lets the wheels decide. Lengths are
    in m, `step` in s. Raise PhysicsError, with a line in the file at `path`, for a missing joint.
    """
    _check_joints(axes, description, path)
    for number, geom in enumerate(spec.geoms):
        geom.name = geom.name or f"{geom.parent.name} shape {number}"
        geom.density = density
    ground = ground_at_rest(compiled(spec, description.path))
    is_free = ground.rolls if free is None else free
    set_options(spec, step)
    add_locks(spec, axes, step)
    add_sensors(spec, sensors, path)
    _touch_floor(spec, ground, floor, step)
    root = description.model.root
    if is_free:
        body = spec.body(root)
        body.add_freejoint(name=BASE_JOINT)
        body.pos = [*start.at, ground.lift]
        body.quat = list(from_yaw(math.radians(start.heading)))
    described = {name: _described(description.joints[name]) for name in axes}
    motors = estimated_motors(compiled(spec, description.path), axes, described, ground)
    for name, motor in motors.items():
        joint = spec.joint(name)
        joint.armature = motor.rotor
        joint.frictionloss = motor.friction
        joint.damping = [motor.damping, 0.0, 0.0]
    notes = tuple(_notes(axes, motors, ground, is_free))
    return PreparedRobot(spec, root, ground, is_free, axes, motors, notes)


def _described(joint: Joint) -> Described:
    limits, dynamics = joint.limits, joint.dynamics
    speed = {} if limits.speed == math.inf else {"speed": limits.speed}
    return Described(limits.max_effort, dynamics.friction, dynamics.damping, **speed)


def add_locks(spec: Any, axes: Mapping[str, AxisSettings], step: float) -> None:  # noqa: ANN401 - as above
    """Add an inactive lock constraint to every driven joint, for brakes and blocked shafts."""
    for joint in axes:
        lock = spec.add_equality(name=f"{_LOCK}{joint}", type=mujoco.mjtEq.mjEQ_JOINT, name1=joint, active=False)
        lock.objtype = mujoco.mjtObj.mjOBJ_JOINT
        lock.solref, lock.solimp = [2.0 * step, 1.0], [0.99, 0.999, 0.0001, 0.5, 2.0]


def _check_joints(axes: Mapping[str, AxisSettings], description: UrdfDescription, path: str) -> None:
    problems = []
    for name, axis in axes.items():
        joint = description.joints.get(name)
        if joint is None:
            problems.append(f"{path}:{axis.here.line}:{axis.here.column}: {description.path} has no joint {name!r}"
                            f"{nearest(name, description.movable_joints)}")  # fmt: skip
        elif joint.type not in ("continuous", "revolute", "prismatic"):
            problems.append(f"{path}:{axis.here.line}:{axis.here.column}: joint {name} is {joint.type}; "
                            "a drive can move a continuous, revolute or prismatic joint")  # fmt: skip
    if problems:
        raise PhysicsError("\n".join(problems))


def set_options(spec: Any, step: float) -> None:  # noqa: ANN401 - as above
    """Set MuJoCo's solver options for a time step of `step` s."""
    spec.option.timestep = step
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST  # friction and damping are stable for any values
    # tyre creep: with 1.5 strained wheels relax too late, with 1 odometry slips a fifth more
    spec.option.impratio = 1.25
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC


def _touch_floor(spec: Any, ground: Ground, floor: FloorContact, step: float) -> None:  # noqa: ANN401 - as above
    """Set the contact parameters of all shapes of a robot, and turn the wheels on the floor into ellipsoids."""
    touches = {touch.geom: touch for touch in ground.touches}
    rolling = {touch.geom for touch in ground.touches if touch.part is not ContactPart.CASTER}
    turning = {geom.parent.name for geom in spec.geoms if geom.name in rolling}
    for geom in list(spec.geoms):
        touch = touches.get(geom.name)
        part = ContactPart.CASTER if touch is None else touch.part
        _set_contact(geom, floor.caster_friction if part is ContactPart.CASTER else floor.friction, step)
        if touch is None and geom.parent.name in turning:  # visual spokes and treads turn with the wheel
            geom.contype = geom.conaffinity = 0
        if touch is None or part is ContactPart.CASTER:
            continue
        if part is ContactPart.ROLLER:
            geom = _add_rolling_part(geom, step, floor.friction)
        if geom.type == mujoco.mjtGeom.mjGEOM_CYLINDER:
            radius, half = geom.size[0], geom.size[1]
            geom.type, geom.size = mujoco.mjtGeom.mjGEOM_ELLIPSOID, [radius, radius, half]


def _set_contact(geom: Any, friction: float, step: float) -> None:  # noqa: ANN401 - as above
    geom.solref, geom.solimp = solref(step), list(_SOLIMP)
    geom.condim, geom.contype, geom.conaffinity = 3, _ROBOT, _WORLD
    geom.friction = [friction, 0.005, 0.0001]


def solref(step: float) -> list[float]:
    """Return MuJoCo's contact time constant (4 ms or two steps, whichever is longer) and damping ratio."""
    return [max(0.004, 2.0 * step), 1.0]


def _add_rolling_part(geom: Any, step: float, friction: float) -> Any:  # noqa: ANN401 - as above
    """Turn a wheel shape into a hub, and add a free-turning cylinder of half the density around the axle."""
    geom.contype = geom.conaffinity = 0
    geom.density = 0.5 * geom.density
    wheel = geom.parent.add_body(name=f"{geom.name} rolling", pos=geom.pos, quat=geom.quat)
    wheel.add_joint(name=f"{geom.name} axle", type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0.0, 0.0, 1.0])
    rolling = wheel.add_geom(name=f"{geom.name}{_TYRE}", type=geom.type, size=geom.size, density=geom.density)
    _set_contact(rolling, friction, step)
    return rolling


def add_floor(spec: Any, step: float, height: float) -> None:  # noqa: ANN401 - as above
    """Add the floor plane at a height in m, with contacts to every robot."""
    plane = mujoco.mjtGeom.mjGEOM_PLANE
    floor = spec.worldbody.add_geom(name=_FLOOR, type=plane, size=[0, 0, 0.05], pos=[0, 0, height])
    _set_contact(floor, 0.0, step)  # MuJoCo uses the larger friction of two shapes: that of the wheel, or of the caster
    floor.contype, floor.conaffinity = _WORLD, _EVERY_ROBOT


def _on_floor(
    model: Any,  # noqa: ANN401 - as above
    ground: Ground,
    axes: Mapping[str, AxisSettings],
    prefix: str,
) -> tuple[tuple[int, ...], tuple[int, ...], tuple[RollerWheel, ...]]:
    """Return the indices of the rolling and sliding shapes on the floor, and the mecanum wheels without friction."""
    places: dict[bool, list[int]] = {True: [], False: []}
    rollers = []
    for touch in ground.touches:
        angle = None if touch.joint not in axes else axes[touch.joint].roller
        if angle is not None:
            geom = int(model.geom(f"{prefix}{touch.geom}").id)
            model.geom_friction[geom, 0] = 0.0
            frame = int(model.body_parentid[int(model.joint(f"{prefix}{touch.joint}").bodyid[0])])
            rollers.append(RollerWheel(geom, frame, angle, touch.radius))
            continue
        name = f"{touch.geom}{_TYRE}" if touch.part is ContactPart.ROLLER else touch.geom
        places[touch.part is not ContactPart.CASTER].append(int(model.geom(f"{prefix}{name}").id))
    return tuple(places[True]), tuple(places[False]), tuple(rollers)


def placed(model: Any, name: str, motor: EstimatedMotor, prefix: str = "") -> JointPlace:  # noqa: ANN401 - as above
    """Return the indices of a driven joint and its lock in a compiled model."""
    joint, lock = model.joint(f"{prefix}{name}"), model.equality(f"{prefix}{_LOCK}{name}")
    return JointPlace(int(joint.qposadr[0]), int(joint.dofadr[0]), int(lock.id), motor)


def _notes(
    axes: Mapping[str, AxisSettings], motors: Mapping[str, EstimatedMotor], ground: Ground, free: bool
) -> list[str]:
    """Return sentences about the detected wheels and the estimated torques."""
    wheels = [touch.joint for touch in ground.touches if touch.part is ContactPart.WHEEL]
    touched = [touch.geom.partition(" shape ")[0] for touch in ground.touches if touch.part is ContactPart.ROLLER]
    contact = f"on wheels: {', '.join(wheels)}" if wheels else "on no driven wheels"
    rolling = f", {', '.join(touched)} turning freely" if touched else ""
    lines = [
        f"the robot stands {contact}{rolling}"
        if free
        else "no wheel carries the robot, so its root is fixed to the ground"
    ]
    guessed = [name for name, axis in axes.items() if axis.rated_torque is None]
    if guessed:
        motors_text = ", ".join(f"{name} {motors[name].rated_torque:.3g} Nm" for name in guessed)
        lines.append(f"rated torques are estimated: {motors_text}")
    return lines


def settle(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Simulate until the robots rest on the floor, before the simulation starts.

    Raise ConfigError if the simulation is unstable: a robot starts inside a solid, or a link has almost no mass.
    """
    mujoco.set_mju_user_warning(_Warnings())
    mujoco.mj_step(model, data, _SETTLE_STEPS)
    if any(data.warning[kind].number for kind in _UNSTABLE):
        raise ConfigError(
            "the simulation is unstable from the start: a robot starts inside something solid, or a link has almost "
            "no mass or inertia; move the start of the robot (x, y, heading) or the solid, and check the masses"
        )


class _Warnings:
    """Handler for MuJoCo's warnings that logs only the first one.

    MuJoCo itself would repeat a warning at each step and write MUJOCO_LOG.TXT into the current folder.
    """

    def __init__(self) -> None:
        self._logged = False

    def __call__(self, text: str) -> None:
        if not self._logged:
            self._logged = True
            _LOG.warning("MuJoCo: %s", text)


# World from a user's MJCF file: joints by their names, with a motor and a lock for each axis. Floor, shapes, frictions
# and masses remain as in the file, except for values of the plant file. Its actuators get no command, since drives move
# the joints. The base is the first body with a free joint.


def build_mjcf(
    file: Path,
    axes: Mapping[str, AxisSettings],
    *,
    step: float,
    path: str,
    world: WorldDescription,
    sensors: Sequence[WorldSensor] = (),
) -> Body:
    """Load the robot of an MJCF file; `step` is in s.

    Raise PhysicsError if the file does not compile or lacks a joint.
    """
    try:
        spec = mujoco.MjSpec.from_file(str(file))
    except (ValueError, OSError) as error:
        raise PhysicsError(f"{file}: MuJoCo cannot read it: {' '.join(str(error).split())}") from error
    _check_mjcf_joints(spec, axes, file, path)
    spec.option.timestep = step
    add_scenery(spec, world, solref(step))
    add_locks(spec, axes, step)
    add_sensors(spec, sensors, path)
    described = {name: _described_in_mjcf(spec.joint(name)) for name in axes}
    motors = estimated_motors(compiled(spec, str(file)), axes, described, Ground((), 0.0))
    for name, motor in motors.items():
        joint = spec.joint(name)
        if axes[name].rotor_inertia is not None or not joint.armature:
            joint.armature = motor.rotor
        joint.frictionloss = motor.friction
        joint.damping = [motor.damping, *joint.damping[1:]]
    model = compiled(spec, str(file))
    free = [number for number in range(model.njnt) if int(model.jnt_type[number]) == mujoco.mjtJoint.mjJNT_FREE]
    base = int(model.jnt_bodyid[free[0]]) if free and int(model.jnt_qposadr[free[0]]) == 0 else None
    return Body(model, {name: placed(model, name, motor) for name, motor in motors.items()}, base, ())


def _described_in_mjcf(joint: Any) -> Described:  # noqa: ANN401 - MuJoCo has no types
    return Described(friction=joint.frictionloss or None, damping=float(joint.damping[0]))


def _check_mjcf_joints(spec: Any, axes: Mapping[str, AxisSettings], file: Path, path: str) -> None:  # noqa: ANN401
    kinds = {joint.name: joint.type for joint in spec.joints}
    moving = (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)
    problems = [
        f"{path}:{axis.here.line}:{axis.here.column}: {file} has no joint {name!r} that a drive can move"
        f"{nearest(name, [candidate for candidate, kind in kinds.items() if kind in moving])}"
        for name, axis in axes.items()
        if kinds.get(name) not in moving
    ]
    if problems:
        raise PhysicsError("\n".join(problems))


# Several robots on one floor, which can touch each other; each has its own name prefix, and a contact bit of its own,
# so that its parts pass through each other but not through another robot. A robot without wheels is fixed to the
# ground at its start, at its lowest point.


_FIRST_ROBOT: Final = 1  # bit of the first robot
_SUNK_M: Final = 0.01  # a robot deeper in a solid than this starts inside it
_ALL: Final = 0x7FFFFFFF


def joined(robots: Mapping[str, tuple[PreparedRobot, RobotStart]], world: WorldDescription, path: str) -> Any:  # noqa: ANN401 - MuJoCo has no types
    """Return one model with several robots at their start poses; raise PhysicsError if one starts inside another.

    `path` is the world file. The specifications of the robots become parts of this model and must not be reused.
    """
    spec = mujoco.MjSpec()
    step = min(float(robot.spec.option.timestep) for robot, _ in robots.values())
    set_options(spec, step)
    for number, (name, (robot, start)) in enumerate(robots.items()):
        _set_contact_bits(robot.spec, 1 << (number + _FIRST_ROBOT))
        spec.attach(robot.spec, prefix=f"{name}/", frame=_frame(spec, robot, start))
    add_floor(spec, step, 0.0)
    add_scenery(spec, world, solref(step))
    model = compiled(spec, path)
    problems = list(_crossing(model, {name: start for name, (_, start) in robots.items()}, path))
    if problems:
        raise PhysicsError("\n".join(problems))
    return model


def _set_contact_bits(spec: Any, kind: int) -> None:  # noqa: ANN401 - as above
    """Set the contact bits of a robot's shapes, so that shapes of one robot do not touch each other."""
    for geom in spec.geoms:
        if geom.contype:
            geom.contype, geom.conaffinity = kind, _ALL & ~kind


def _frame(spec: Any, robot: PreparedRobot, start: RobotStart) -> Any:  # noqa: ANN401 - as above
    """Return the frame of a robot: at its start pose, or at the origin for a free root, whose pose is in qpos."""
    if robot.free:
        return spec.worldbody.add_frame()
    place = [*start.at, max(0.0, robot.ground.lift)]
    return spec.worldbody.add_frame(pos=place, quat=list(from_yaw(math.radians(start.heading))))


def _crossing(model: Any, starts: Mapping[str, RobotStart], path: str) -> Iterator[str]:  # noqa: ANN401 - as above
    """Yield a sentence for each robot that starts inside another robot, a wall, a box or a solid.

    A start on a ramp or on a solid is allowed.
    """
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    reported = set[tuple[str, str]]()
    for contact in data.contact:
        names = [str(model.geom(int(geom)).name) for geom in contact.geom]
        first, second = (_owner(name, starts) for name in names)
        if first in starts and second in starts:
            first, second = sorted((first, second), key=list(starts).index)
        elif second not in starts:
            first, second = second, first
        if second not in starts or first == second or not _solid(first, starts) or (first, second) in reported:
            continue
        if first.startswith(SOLID) and contact.dist > -_SUNK_M:  # the robot starts on it
            continue
        reported.add((first, second))
        here = starts[second].here
        yield (f"{path}:{here.line}:{here.column}: {second} starts inside {first}, at "
               f"x {contact.pos[0]:.2f} m, y {contact.pos[1]:.2f} m; choose another start pose")  # fmt: skip


def _owner(geom: str, starts: Mapping[str, RobotStart]) -> str:
    name, slash, _ = geom.partition("/")
    return name if slash and name in starts else geom


def _solid(name: str, starts: Mapping[str, RobotStart]) -> bool:
    return name in starts or name.startswith(("wall ", BOX, SOLID))
