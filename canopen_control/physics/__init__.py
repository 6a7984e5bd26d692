"""Physics simulation of robots: contacts with the floor, slip, payloads, and a servo loop on each driven joint.

The engine is MuJoCo; only this subpackage imports it, and only when a world is requested: `engine` creates one for
the virtual drives of a process, `plugin_robot` one for a simulation plugin without drives.

- files: `physics_file` (plant file), `scene_file` (objects on the floor and disturbances), `sdf_world` (static shapes
  of a Gazebo world, with its meshes)
- model: `urdf_repair` of a description, `body_model` of a description, a MuJoCo scene or several robots;
  `ground_contact` finds the wheels, `motor_estimate` the motors, `scenery` adds ramps, boxes and walls,
  `world_sensors` adds sensors
- motion: `joint_servo` (control loops of a drive on one joint), `physics_world` (all robots and their poses),
  `disturbances` (payload, pushes, friction)
"""

from __future__ import annotations

import importlib.util

from canopen_control.errors import ConfigError

__all__ = ["SDF_SUFFIXES", "require_physics"]

SDF_SUFFIXES = (".sdf", ".world")
"""Suffixes of the world files of Gazebo, see `sdf_world`."""


def require_physics() -> None:
    """Raise ConfigError with the installation command if MuJoCo is missing; MuJoCo is not imported."""
    if importlib.util.find_spec("mujoco") is None:
        raise ConfigError("physics needs MuJoCo: pip install 'canopen-control[physics]'")
