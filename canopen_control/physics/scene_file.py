"""World file: objects on the floor, friction of the floor, and timed disturbances.

    floor: {friction: 0.8, caster_friction: 0.02}
    start: {at: [0, 0], heading: 0}                                   # of the robot; m and degrees
    patches: [{at: [1.5, 0], size: [1, 1], friction: 0.1}]            # with other friction; centres
    ramps: [{at: [3, 0], heading: 0, angle: 8, length: 2, width: 1}]  # from the lower edge
    boxes: [{at: [1, 1], size: [0.3, 0.3, 0.3], mass: 2}]             # mass 0: fixed
    walls: [{from: [0, 2], to: [4, 2], height: 0.5}]
    steps:
      - {at: 5s, payload: {mass: 12, on: base_link, position: [0, 0, 0.1]}}
      - {at: 8s, push: {force: [30, 0, 0], seconds: 0.3}}
      - {at: 10s, block: left_wheel_joint, for: 2s}
      - {at: 15s, friction: 0.2}

Several robots in one world (only with `run --world FILE`), each with its own name, buses and process:

    robots:
      - {name: robby1, robot: robby, at: [0, 0], heading: 0}          # a folder, or the name of a bundled robot
      - {name: robby2, robot: robby, at: [2, 0], heading: 180}
    steps: [{at: 5s, robot: robby2, push: {force: [30, 0, 0]}}]

`sdf: hall.sdf` adds the static shapes of a Gazebo world; such a file may also be given directly (`--world hall.sdf`),
see `sdf_world`.

Times count from the start of the drives. Lengths are in m, angles in degrees, masses in kg, forces in N.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

from canopen_control.duration import seconds_of
from canopen_control.errors import nearest
from canopen_control.physics import SDF_SUFFIXES
from canopen_control.physics.physics_file import FloorContact, PhysicsError
from canopen_control.physics.sdf_world import Solid, read_sdf_world
from canopen_control.rpc.messages.drive import BlockJoint, WorldAct
from canopen_control.virtual.scenario import WorldEvent
from canopen_control.yamlfile.convert import derived, position, setting
from canopen_control.yamlfile.node import Node  # noqa: TC001 - the type of a field is looked up at run time
from canopen_control.yamlfile.reader import load

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from canopen_control.yamlfile.node import Problems


MAX_ROBOTS: Final = 24
_NAME: Final = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,29}")
Timed = tuple[int, str, WorldAct]
# ruff: noqa: RUF009 - `setting` and `position` make fields


@dataclass(frozen=True)
class Start:
    """Start pose of a robot: position in m, heading in degrees."""

    at: tuple[float, float] = (0.0, 0.0)
    heading: float = 0.0


@dataclass(frozen=True, kw_only=True)
class RobotStart(Start):
    """Robot of a shared world: name, start pose, folder or bundled name, and xacro arguments."""

    name: str = setting()
    robot: str = setting()
    arguments: dict[str, str] = setting(factory=dict)
    controllers: list[str] = setting(factory=list)
    here: Node = position()


@dataclass(frozen=True)
class Patch:
    """Rectangle of the floor, centred at `at`, with its own friction."""

    at: tuple[float, float]
    size: tuple[float, float]
    friction: float = setting(low=0.0, high=10.0)
    heading: float = 0.0

    def covers(self, x: float, y: float) -> bool:
        turn = math.radians(self.heading)
        right, up = x - self.at[0], y - self.at[1]
        along = right * math.cos(turn) + up * math.sin(turn)
        across = up * math.cos(turn) - right * math.sin(turn)
        return abs(along) <= 0.5 * self.size[0] and abs(across) <= 0.5 * self.size[1]


@dataclass(frozen=True)
class Ramp:
    """Plane that rises by `angle` degrees towards `heading`, from a lower edge centred at `at`."""

    at: tuple[float, float]
    angle: float = setting(low=0.0, high=60.0)
    length: float = setting(low=0.01)
    width: float = setting(1.0, low=0.01)
    heading: float = 0.0


@dataclass(frozen=True)
class Box:
    """Box on the floor, or `above` m above it; only a box with a mass can move."""

    at: tuple[float, float]
    size: tuple[float, float, float]
    mass: float = setting(0.0, low=0.0)
    heading: float = 0.0
    above: float = setting(0.0, low=0.0)
    friction: float = setting(0.5, low=0.0, high=10.0)
    here: Node = position()


@dataclass(frozen=True)
class Wall:
    """Straight wall between two points of the floor."""

    begin: tuple[float, float] = setting(key="from")
    end: tuple[float, float] = setting(key="to")
    height: float = setting(0.5, low=0.01)
    thickness: float = setting(0.05, low=0.001)
    here: Node = position()


@dataclass(frozen=True)
class WorldStep(WorldEvent):
    """Step of a world file: disturbances at one time."""

    at: float | str
    length: float | str | None = setting(None, key="for")
    robot: str = ""
    here: Node = position()

    def timed(self) -> Iterator[Timed]:
        """Yield the disturbances of the step, each with its time in ns and the robot's name."""
        at_ns = round(seconds_of(self.at) * 1e9)
        for act in self.acts():
            yield at_ns, self.robot, act
        if self.length is not None:
            yield at_ns + round(seconds_of(self.length) * 1e9), self.robot, BlockJoint(joint=self.block, on=False)


@dataclass(frozen=True)
class WorldDescription:
    """Contents of a world file; if `floor` is None, the plant file determines the floor.

    `solids` are the shapes of the SDF file, named by `sdf` or given directly; `notes` are the differences of
    these shapes from Gazebo.
    """

    floor: FloorContact | None = None
    start: Start | None = None
    robots: list[RobotStart] = setting(factory=list)
    patches: list[Patch] = setting(factory=list)
    ramps: list[Ramp] = setting(factory=list)
    boxes: list[Box] = setting(factory=list)
    walls: list[Wall] = setting(factory=list)
    steps: list[WorldStep] = setting(factory=list)
    sdf: str = ""
    solids: tuple[Solid, ...] = derived(())
    notes: tuple[str, ...] = derived(())

    def timeline(self) -> list[Timed]:
        """Return all disturbances in order of time, in ns from the start."""
        return sorted((item for step in self.steps for item in step.timed()), key=lambda item: item[0])


def read_world_description(path: Path) -> WorldDescription:
    """Read a world file, YAML or SDF according to its suffix; raise PhysicsError with all errors and their lines."""
    if path.suffix.lower() in SDF_SUFFIXES:
        return _with_solids(WorldDescription(), path)
    description = load(path, WorldDescription, error=PhysicsError, check=_check)
    return _with_solids(description, path.parent / description.sdf) if description.sdf else description


def _with_solids(world: WorldDescription, sdf: Path) -> WorldDescription:
    read = read_sdf_world(sdf)
    return replace(world, solids=read.solids, notes=read.notes)


def _check(file: WorldDescription, _problems: Problems) -> None:
    for wall in file.walls:
        if wall.begin == wall.end:
            wall.here.error("a wall needs two different points")
    for box in file.boxes:
        if min(box.size) <= 0.0:
            box.here.error("size: the three lengths of a box must be above 0")
    _check_robots(file)
    for step in file.steps:
        if len(step.acts()) != 1:
            step.here.error("a step needs exactly one of payload, push, block and friction")
        if step.length is not None and not step.block:
            step.here.error("for: is possible only with block")
        for value in (step.at, step.length):
            try:
                seconds_of(0.0 if value is None else value)
            except ValueError as error:
                step.here.error(str(error))


def _check_robots(file: WorldDescription) -> None:
    """Report invalid or duplicate robot names, too many robots, and steps for unknown robots."""
    if file.robots and file.start is not None:
        file.robots[0].here.error("each robot has its own at and heading; omit `start`")
    names: set[str] = set()
    for robot in file.robots:
        if _NAME.fullmatch(robot.name) is None:  # the name is also that of a bus and of a ROS namespace
            robot.here.error(
                f"name: {robot.name!r} is not valid: use a letter, then letters, digits and _, at most 30 characters"
            )
        if robot.name in names:
            robot.here.error(f"a robot named {robot.name} exists already; choose another name")
        names.add(robot.name)
    if len(file.robots) > MAX_ROBOTS:
        file.robots[MAX_ROBOTS].here.error(f"{len(file.robots)} robots: a world can have at most {MAX_ROBOTS}")
    for step in file.steps:
        if step.robot and step.robot not in names:
            step.here.error(f"robot {step.robot!r} is not in this file{nearest(step.robot, names)}")
        if names and not step.robot and step.friction is None:
            step.here.error(f"robot: name the robot of this step: {', '.join(sorted(names))}")
