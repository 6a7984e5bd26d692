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
    from pathlib import Path

    from canopen_control.physics.physics_world import PhysicsWorld

__all__ = ["make", "make_of"]


def make(path: Path) -> PhysicsWorld:
    """Return the world of a plant file; PhysicsError, RobotConfigError, or ConfigError without MuJoCo."""
    require_physics()
    return make_of(read_physics_file(path), path)


def make_of(file: PhysicsFile, path: Path) -> PhysicsWorld:
    """Return the world of a plant file that was read already, at `path`."""
    from canopen_control.physics.body_model import build, read_spec  # 150 ms
    from canopen_control.physics.disturbances import Disturbances
    from canopen_control.physics.physics_world import PhysicsWorld
    from canopen_control.physics.urdf_repair import repaired

    world = read_world_description(path.parent / file.world) if file.world else WorldDescription()
    floor = world.floor or file.floor
    description = read_description(path.parent / file.urdf, mappings=file.arguments)
    urdf = repaired(description)
    body = build(
        read_spec(urdf, description.path),
        description,
        {axis.joint: axis for axis in file.axes.values()},
        floor,
        step=file.step_ms * 1e-3,
        density=file.density,
        free=None if file.base is None else file.base == "free",
        path=str(path),
        world=world,
    )
    guessed = f"masses are guessed from shapes at {file.density:g} kg/m3: {', '.join(urdf.guessed)}"
    notes = (*urdf.notes, *([guessed] if urdf.guessed else []), *body.notes)
    disturbances = Disturbances(body, floor, world)
    try:
        disturbances.check()
    except ConfigError as error:
        raise PhysicsError(f"{path.parent / file.world}: {error}") from error
    return PhysicsWorld(body, {axis_address(name): axis for name, axis in file.axes.items()}, disturbances, notes)
