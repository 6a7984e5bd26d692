"""What moves the joints of a simulation plugin: physics where that is installed, else simple motors of their own.

A description that names MuJoCo's plugin, or a user who gives a world, wants physics: what keeps it from that is an
error. One that names Gazebo's runs on simple motors then, which is told. The plugin's parameters `mujoco_model`, an
MJCF file, and `pids_config_file` are beside the description.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

from canopen_control.errors import ConfigError, RobotConfigError
from canopen_control.hardware.plugins import Kind
from canopen_control.hardware.simulation import PHYSICS_PLUGIN
from canopen_control.physics import require_physics
from canopen_control.runtime.pids_file import read_pids

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from canopen_control.hardware.simulation import Engine
    from canopen_control.physics.world_file import WorldDescription
    from canopen_control.runtime.setup import RobotSetup
    from canopen_control.urdf.ros2_control import Ros2ControlSystem

__all__ = ["simulation_engine"]

_MODEL: Final = "mujoco_model"
_PIDS: Final = "pids_config_file"


def simulation_engine(setup: RobotSetup, kinds: Sequence[Kind], report: Callable[[str, str], None]) -> Engine | None:
    """Return the physics of a robot's one simulated tag, None for simple motors; RobotConfigError, PhysicsError.

    `report` takes the kind and the text of what was guessed, or keeps it from physics.
    """
    tags = [tag for tag, kind in zip(setup.description.hardware, kinds, strict=True) if kind is Kind.SIMULATION]
    wanted = setup.world is not None or any(tag.plugin == PHYSICS_PLUGIN for tag in tags)
    if not setup.simulate:
        return None
    try:
        require_physics()
        if len(tags) > 1:
            raise RobotConfigError(
                f"{setup.description.path}: physics moves one <ros2_control> tag, and there are {len(tags)}"
            )
        return _engine(setup, tags[0], report)
    except ConfigError as error:
        if wanted:
            raise
        report("physics", f"simple motors move {setup.name}, since there is no physics: {error}")
        return None


def _engine(setup: RobotSetup, tag: Ros2ControlSystem, report: Callable[[str, str], None]) -> Engine:
    """Make the world of a tag."""
    from canopen_control.physics.plugin_robot import make_simulated

    folder = Path(setup.description.path).parent
    model, pids = (tag.parameters.get(key, "").strip() for key in (_MODEL, _PIDS))
    loops = read_pids(folder / pids, tag) if pids else {}
    world = None if setup.world is None else _world(setup.world)
    engine = make_simulated(setup.description, tag, folder / model if model else None, loops, world)
    if problems := [f"{setup.world}:{problem}" for problem in engine.problems()]:
        raise RobotConfigError("\n".join(problems))
    for note in engine.notes:
        report("physics", note)
    return engine


def _world(path: Path) -> WorldDescription:
    """Read the world of one robot."""
    from canopen_control.physics.world_file import read_world_description

    world = read_world_description(path)
    if world.robots:
        raise RobotConfigError(f"{path}: it has robots of its own: canopen-control run --world {path}")
    return world
