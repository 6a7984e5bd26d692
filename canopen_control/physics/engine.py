"""Entry point of the engine `mujoco` for the virtual drives: builds worlds from plant files.

Errors are reported before the simulation starts; assumptions about the robots are in the world's notes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from canopen_control.errors import nearest
from canopen_control.physics import require_physics
from canopen_control.physics.physics_file import (
    FloorContact,
    PhysicsError,
    PhysicsFile,
    axis_address,
    read_physics_file,
)
from canopen_control.physics.scene_file import RobotStart, Start, WorldDescription, read_world_description
from canopen_control.urdf.description import read_description

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from canopen_control.physics.body_model import Body, PreparedRobot
    from canopen_control.physics.physics_world import PhysicsWorld, WorldRobot
    from canopen_control.physics.world_sensors import WorldSensor


def make(path: Path) -> PhysicsWorld:
    """Return the world of a plant file; raise PhysicsError or RobotConfigError, or ConfigError if MuJoCo is missing."""
    require_physics()
    return make_world(read_physics_file(path), path)


def make_world(file: PhysicsFile, path: Path) -> PhysicsWorld:
    """Return the world that a plant file describes; `file` is its content, `path` its location."""
    from canopen_control.physics.body_model import alone

    world = read_world_description(path.parent / file.world) if file.world else WorldDescription()
    if world.robots:
        raise PhysicsError(
            f"{path.parent / file.world}: it is a world of several robots; start it with canopen-control run --world "
            "FILE"
        )
    sensors = _sensors(file)
    floor, scene_path = world.floor or file.floor, path.parent / file.world
    notes: tuple[str, ...] = ()
    if file.mjcf:
        body = _of_mjcf(file, path, world, sensors)
    else:
        robot, notes = _prepared(file, path, floor, world.start or Start(), sensors)
        body = alone(robot, world, file.step_ms * 1e-3, file.urdf)
    robots = {"": _in_world("", body, file, path, sensors)}
    return _world(robots, world, floor, scene_path, (*notes, *body.notes))


def make_shared(plants: Mapping[str, Path], where: Path) -> PhysicsWorld:
    """Return one world with several robots from their plant files; the file `where` contains the start poses."""
    from canopen_control.physics.body_model import joined

    require_physics()
    world = read_world_description(where)
    starts = {robot.name: robot for robot in world.robots}
    floor = world.floor or FloorContact()
    members, notes = {}, list[str]()
    for name, path in plants.items():
        if name not in starts:
            raise PhysicsError(f"{where}: no robot {name!r} in this file{nearest(name, starts)}")
        members[name] = _member(name, path, floor, starts[name])
        notes += [f"{name}: {note}" for note in members[name].notes]
    model = joined({name: (member.robot, starts[name]) for name, member in members.items()}, world, str(where))
    robots = {}
    for name, member in members.items():
        body = member.robot.body(model, f"{name}/")
        robots[name] = _in_world(name, body, member.file, member.path, member.sensors)
    return _world(robots, world, floor, where, tuple(notes))


def _of_mjcf(file: PhysicsFile, path: Path, world: WorldDescription, sensors: list[WorldSensor]) -> Body:
    """Return the robot of an MJCF file, with the shapes and masses of that file."""
    from canopen_control.physics.body_model import build_mjcf

    axes = {axis.joint: axis for axis in file.axes.values()}
    scene = path.parent / file.mjcf
    return build_mjcf(scene, axes, step=file.step_ms * 1e-3, path=str(path), world=world, sensors=sensors)


@dataclass(frozen=True)
class _Member:
    """Robot of a shared world, with its plant file."""

    file: PhysicsFile
    path: Path
    robot: PreparedRobot
    sensors: list[WorldSensor]
    notes: tuple[str, ...]


def _member(name: str, path: Path, floor: FloorContact, start: RobotStart) -> _Member:
    file = read_physics_file(path)
    for key in ("mjcf", "world"):
        if getattr(file, key):
            raise PhysicsError(f"{path}: {key}: is not possible for {name}, which shares its world with other robots")
    sensors = _sensors(file)
    robot, notes = _prepared(file, path, floor, start, sensors)
    return _Member(file, path, robot, sensors, (*notes, *robot.notes))


def _sensors(file: PhysicsFile) -> list[WorldSensor]:
    from canopen_control.physics.world_sensors import WorldSensor  # 150 ms

    return [WorldSensor(name, sensor) for name, sensor in file.sensors.items()]


def _in_world(name: str, body: Body, file: PhysicsFile, path: Path, sensors: list[WorldSensor]) -> WorldRobot:
    from canopen_control.physics.physics_world import WorldRobot

    joints = [str(body.model.joint(number).name) for number in range(body.model.njnt)]
    names = [joint.removeprefix(body.prefix) for joint in joints if joint.startswith(body.prefix)]
    problems = [
        f"{path}:{encoder.here.line}:{encoder.here.column}: an encoder names the unknown joint {encoder.joint!r}"
        f"{nearest(encoder.joint, names)}"
        for encoder in file.encoders.values()
        if encoder.joint not in names
    ]
    if problems:
        raise PhysicsError("\n".join(problems))
    axes = {axis_address(address): axis for address, axis in file.axes.items()}
    encoders = {axis_address(address)[:2]: encoder for address, encoder in file.encoders.items()}
    return WorldRobot(name, body, axes, sensors, encoders)


def _world(
    robots: Mapping[str, WorldRobot], world: WorldDescription, floor: FloorContact, path: Path, notes: tuple[str, ...]
) -> PhysicsWorld:
    """Build the world with these robots; raise PhysicsError for invalid disturbances in the world file."""
    from canopen_control.physics.disturbances import Disturbances
    from canopen_control.physics.physics_world import PhysicsWorld

    disturbances = Disturbances({name: robot.body for name, robot in robots.items()}, floor, world)
    if problems := [f"{path}:{problem}" for problem in disturbances.problems()]:
        raise PhysicsError("\n".join(problems))
    return PhysicsWorld(robots, disturbances, (*notes, *world.notes))


def _prepared(
    file: PhysicsFile, path: Path, floor: FloorContact, start: Start, sensors: list[WorldSensor]
) -> tuple[PreparedRobot, tuple[str, ...]]:
    """Return the robot of a description before it is added to a world, with notes on omissions and guessed masses."""
    from canopen_control.physics.body_model import prepared, read_spec
    from canopen_control.physics.urdf_repair import guessed_masses, repaired

    description = read_description(path.parent / file.urdf, mappings=file.arguments)
    if file.urdf_source:
        description = replace(description, path=file.urdf_source)
    urdf = repaired(description)
    robot = prepared(
        read_spec(urdf, description.path),
        description,
        {axis.joint: axis for axis in file.axes.values()},
        floor,
        step=file.step_ms * 1e-3,
        density=file.density,
        free=None if file.base is None else file.base == "free",
        path=str(path),
        start=start,
        sensors=sensors,
    )
    return robot, (*urdf.notes, *guessed_masses(urdf, file.density))
