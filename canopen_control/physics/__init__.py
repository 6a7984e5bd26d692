"""Physics: the robot of a description on a floor, with contacts, slip, payload, and a servo loop on each driven joint.

The engine is MuJoCo; only this subpackage imports it, and only when a world is requested: `engine` makes one for the
virtual drives of a process, `plugin_robot` one for a simulation plugin without drives.

- files: `physics_file` (the plant file), `scene_file` (what stands on the floor, and what happens), `sdf_world` (the
  static shapes of a world of Gazebo, with the parts of its meshes)
- a model: `urdf_repair` of a description, `body_model` of it or of a scene of MuJoCo's own, `shared_model` of
  several robots; `ground_contact` finds the wheels, `motor_estimate` the motors, `scenery` adds ramps, boxes and walls,
  `world_sensors` what measures
- motion: `joint_servo` (a drive's loops on one joint), `world_robot` (a robot, and where its base is), `physics_world`
  (all of them together), `disturbances` (payload, pushes, grip)
"""

from __future__ import annotations

import importlib.util

from canopen_control.errors import ConfigError

__all__ = ["SDF_SUFFIXES", "require_physics"]

SDF_SUFFIXES = (".sdf", ".world")
"""Endings of the files in which Gazebo keeps its worlds, see `sdf_world`."""


def require_physics() -> None:
    """Raise ConfigError with what to type when MuJoCo is not there; does not import it."""
    if importlib.util.find_spec("mujoco") is None:
        raise ConfigError("physics needs MuJoCo: pip install 'canopen-control[physics]'")
