"""MuJoCo model with several robots on one floor, which can touch each other; each has its own name prefix.

Each robot has a contact bit of its own, so that its parts pass through each other but not through another robot. A
robot without wheels is fixed to the ground at its start, at its lowest point.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final

import mujoco

from canopen_control.physics.body_model import compiled, lay_floor, set_options, solref
from canopen_control.physics.physics_file import PhysicsError
from canopen_control.physics.scenery import BOX, SOLID, add_scenery
from canopen_control.urdf.geometry import from_yaw

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from canopen_control.physics.body_model import PreparedRobot
    from canopen_control.physics.scene_file import RobotStart, WorldDescription


_WORLD: Final = 1  # contact bits, see `body_model`
_FIRST_ROBOT: Final = 1  # bit of the first robot
_SUNK_M: Final = 0.01  # a robot deeper in a solid than this starts inside it
_ALL: Final = 0x7FFFFFFF


def joined(robots: Mapping[str, tuple[PreparedRobot, RobotStart]], world: WorldDescription, path: str) -> Any:  # noqa: ANN401 - MuJoCo has no types
    """Return the model of robots by name, each at its start pose; PhysicsError if two overlap.

    `path` is the file of the world. The specifications of the robots become parts of this one and must not be reused.
    """
    spec = mujoco.MjSpec()
    step = min(float(robot.spec.option.timestep) for robot, _ in robots.values())
    set_options(spec, step)
    for number, (name, (robot, start)) in enumerate(robots.items()):
        _give_kind(robot.spec, 1 << (number + _FIRST_ROBOT))
        spec.attach(robot.spec, prefix=f"{name}/", frame=_frame(spec, robot, start))
    lay_floor(spec, step, 0.0)
    add_scenery(spec, world, solref(step))
    model = compiled(spec, path)
    problems = list(_crossing(model, {name: start for name, (_, start) in robots.items()}, path))
    if problems:
        raise PhysicsError("\n".join(problems))
    return model


def _give_kind(spec: Any, kind: int) -> None:  # noqa: ANN401 - as above
    """Set the contact bits of a robot's shapes, so that they also touch other robots."""
    for geom in spec.geoms:
        if geom.contype:
            geom.contype, geom.conaffinity = kind, _ALL & ~kind


def _frame(spec: Any, robot: PreparedRobot, start: RobotStart) -> Any:  # noqa: ANN401 - as above
    """Return the frame of a robot's start; the pose of a free root is set separately."""
    if robot.free:
        return spec.worldbody.add_frame()
    place = [*start.at, max(0.0, robot.ground.lift)]
    return spec.worldbody.add_frame(pos=place, quat=list(from_yaw(math.radians(start.heading))))


def _crossing(model: Any, starts: Mapping[str, RobotStart], path: str) -> Iterator[str]:  # noqa: ANN401 - as above
    """Yield a sentence for each robot that starts inside another robot, a wall or a box.

    A start on a ramp is allowed.
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
        yield (f"{path}:{here.line}:{here.column}: {second} begins inside {first}, at "
               f"x {contact.pos[0]:.2f} m, y {contact.pos[1]:.2f} m; give it another place")  # fmt: skip


def _owner(geom: str, starts: Mapping[str, RobotStart]) -> str:
    name, slash, _ = geom.partition("/")
    return name if slash and name in starts else geom


def _solid(name: str, starts: Mapping[str, RobotStart]) -> bool:
    return name in starts or name.startswith(("wall ", BOX, SOLID))
