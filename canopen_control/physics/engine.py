"""Makes the world that a plant file of the engine `mujoco` describes: the door of this room for the virtual drives.

Mistakes are told before anything runs, each in a sentence; what was guessed of the robot is kept in the world's notes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.errors import ConfigError
from canopen_control.physics import require_physics
from canopen_control.physics.physics_file import PhysicsError, PhysicsFile, axis_address, read_physics_file
from canopen_control.physics.world_file import WorldDescription, read_world_description
from canopen_control.urdf.description import read_description

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from canopen_control.physics.body_model import Body
    from canopen_control.physics.physics_world import PhysicsWorld
    from canopen_control.physics.world_sensors import WorldSensor

__all__ = ["make", "make_of"]


def make(path: Path) -> PhysicsWorld:
    """Return the world of a plant file; PhysicsError, RobotConfigError, or ConfigError without MuJoCo."""
    require_physics()
    return make_of(read_physics_file(path), path)


def make_of(file: PhysicsFile, path: Path) -> PhysicsWorld:
    """Return the world of a plant file that was read already, at `path`."""
    from canopen_control.physics.disturbances import Disturbances  # 150 ms
    from canopen_control.physics.physics_world import PhysicsWorld
    from canopen_control.physics.world_sensors import WorldSensor

    world = read_world_description(path.parent / file.world) if file.world else WorldDescription()
    sensors = [
        WorldSensor(name, each.kind, each.link, each.noise, each.reach, each.seed)
        for name, each in file.sensors.items()
    ]
    body, notes = (_of_mjcf if file.mjcf else _of_urdf)(file, path, world, sensors)
    disturbances = Disturbances(body, world.floor or file.floor, world)
    try:
        disturbances.check()
    except ConfigError as error:
        raise PhysicsError(f"{path.parent / file.world}: {error}") from error
    axes = {axis_address(name): axis for name, axis in file.axes.items()}
    return PhysicsWorld(body, axes, disturbances, (*notes, *body.notes), sensors)


def _of_urdf(
    file: PhysicsFile, path: Path, world: WorldDescription, sensors: Sequence[WorldSensor]
) -> tuple[Body, tuple[str, ...]]:
    """Return the body of a description, and what of it was guessed."""
    from canopen_control.physics.body_model import build, read_spec
    from canopen_control.physics.urdf_repair import guessed_masses, repaired

    description = read_description(path.parent / file.urdf, mappings=file.arguments)
    urdf = repaired(description)
    body = build(
        read_spec(urdf, description.path),
        description,
        {axis.joint: axis for axis in file.axes.values()},
        world.floor or file.floor,
        step=file.step_ms * 1e-3,
        density=file.density,
        free=None if file.base is None else file.base == "free",
        path=str(path),
        world=world,
        sensors=sensors,
    )
    return body, (*urdf.notes, *guessed_masses(urdf, file.density))


def _of_mjcf(
    file: PhysicsFile, path: Path, world: WorldDescription, sensors: Sequence[WorldSensor]
) -> tuple[Body, tuple[str, ...]]:
    """Return the body of an MJCF file, which guesses nothing."""
    from canopen_control.physics.mjcf_model import build_mjcf

    axes = {axis.joint: axis for axis in file.axes.values()}
    scene = path.parent / file.mjcf
    return build_mjcf(scene, axes, step=file.step_ms * 1e-3, path=str(path), world=world, sensors=sensors), ()
