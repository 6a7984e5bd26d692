"""A user's own MJCF file as a world: joints by their names, with a motor and a lock where a drive moves one.

The scene is as its author made it: its floor, shapes, frictions and masses stay, but for what the plant file says. Its
actuators are left without a command, since drives move the joints. The base is the first body with a free joint.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import mujoco

from canopen_control.errors import nearest
from canopen_control.physics.body_model import Body, compiled, give_locks, placed
from canopen_control.physics.ground_contact import Ground
from canopen_control.physics.motor_estimate import Described, estimated_motors
from canopen_control.physics.physics_file import PhysicsError
from canopen_control.physics.scenery import add_scenery
from canopen_control.physics.world_sensors import add_sensors

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from canopen_control.physics.physics_file import AxisSettings
    from canopen_control.physics.scene_file import WorldDescription
    from canopen_control.physics.world_sensors import WorldSensor


def build_mjcf(
    file: Path,
    axes: Mapping[str, AxisSettings],
    *,
    step: float,
    path: str,
    world: WorldDescription,
    sensors: Sequence[WorldSensor] = (),
) -> Body:
    """Make the model of an MJCF file; PhysicsError where it does not compile or has no such joint. `step` in s."""
    try:
        spec = mujoco.MjSpec.from_file(str(file))
    except (ValueError, OSError) as error:
        raise PhysicsError(f"{file}: MuJoCo cannot read it: {' '.join(str(error).split())}") from error
    _check_joints(spec, axes, file, path)
    spec.option.timestep = step
    add_scenery(spec, world, [max(0.004, 2.0 * step), 1.0])
    give_locks(spec, axes, step)
    add_sensors(spec, sensors, path)
    described = {name: _described(spec.joint(name)) for name in axes}
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


def _described(joint: Any) -> Described:  # noqa: ANN401 - MuJoCo has no types
    """Return what the scene says of a joint; no friction is one that its author did not give."""
    return Described(friction=joint.frictionloss or None, damping=float(joint.damping[0]))


def _check_joints(spec: Any, axes: Mapping[str, AxisSettings], file: Path, path: str) -> None:  # noqa: ANN401
    kinds = {joint.name: joint.type for joint in spec.joints}
    moving = (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)
    problems = [
        f"{path}:{axis.here.line}:{axis.here.column}: {file} has no joint {name!r} that a drive can move"
        f"{nearest(name, [each for each, kind in kinds.items() if kind in moving])}"
        for name, axis in axes.items()
        if kinds.get(name) not in moving
    ]
    if problems:
        raise PhysicsError("\n".join(problems))
