"""Physics: the robot of a description on a floor, with contacts, slip, payload, and a servo loop on each driven joint.

The engine is MuJoCo; this is the only room that imports it, and only when somebody asks for a world: `engine` makes one
for the virtual drives of a process. `physics_file` is the plant file, `urdf_repair` and `body_model` make a model of a
description, `ground_contact` finds its wheels, `joint_servo` is a drive's loops on one joint and `physics_world` moves
all of it together.
"""

from __future__ import annotations

import importlib.util

from canopen_control.errors import ConfigError

__all__ = ["require_physics"]


def require_physics() -> None:
    """Raise ConfigError with what to type when MuJoCo is not there; does not import it."""
    if importlib.util.find_spec("mujoco") is None:
        raise ConfigError("physics needs MuJoCo: pip install 'canopen-control[physics]'")
