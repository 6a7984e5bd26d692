"""The six-axis arm that is measured: arm6's files at another rate, and trajectories like those of planners.

Its joint trajectory controller takes the place of the one that takes positions, unless that is the one to be measured.
"""

from __future__ import annotations

import shutil
from typing import TYPE_CHECKING

from canopen_control.controllers.trajectory.point import JointTrajectory, Point
from canopen_control.data_files import data_path
from canopen_control.errors import CanopenError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path


JOINTS = [f"joint_{index}" for index in range(1, 7)]
NODES = tuple(range(2, 8))
ENDS = [0.8, -0.6, 0.9, 1.2, -0.5, 1.5]
CONTROLLER, POSITIONS = "arm_controller", "arm_position_controller"
_BUS, _CONTROLLERS = "bus.yml", "ros2_controllers.yaml"
_TRAJECTORIES = f"""
    {CONTROLLER}:
      type: joint_trajectory_controller/JointTrajectoryController

{CONTROLLER}:
  ros__parameters:
    joints: [joint_1, joint_2, joint_3, joint_4, joint_5, joint_6]
    command_interfaces: [position]
    state_interfaces: [position, velocity]
    constraints:
      goal_time: 0.5
      decelerate_on_cancel: true
"""


def edit(path: Path, changes: Mapping[str, str]) -> None:
    """Replace text in a file; raises CanopenError if the file does not contain it."""
    text = path.read_text()
    for old, new in changes.items():
        if old not in text:
            raise CanopenError(f"{path}: there is no {old!r} to be replaced")
        text = text.replace(old, new)
    path.write_text(text)


def copy_arm(folder: Path, *, trajectories: bool = True) -> Path:
    """Copy arm6's files and return their folder; `trajectories`: with a trajectory controller."""
    target = folder / "arm6"
    shutil.copytree(data_path("config", "arm6"), target)
    if trajectories:
        path = target / _CONTROLLERS
        head = path.read_text().partition(f"    {POSITIONS}:\n")[0]
        joints = "".join(
            f"      {joint}: {{trajectory: 0.1, goal: 0.005, max_deceleration_on_cancel: 4.0}}\n" for joint in JOINTS
        )
        path.write_text(head.rstrip() + "\n" + _TRAJECTORIES + joints)
    return target


def arm_at(folder: Path, hertz: int, keys: str = "", *, trajectories: bool = True) -> Path:
    """Copy arm6's files with another SYNC period, in whole milliseconds; `keys` are additional keys of the master."""
    config = copy_arm(folder, trajectories=trajectories)
    edit(
        config / _BUS,
        {
            "sync_period: 20000 ": f"sync_period: {1_000_000 // hertz}{keys} ",
            "value: 20}       # interpolation": f"value: {1000 // hertz}}}  # interpolation",
        },
    )
    edit(config / _CONTROLLERS, {"update_rate: 50 ": f"update_rate: {hertz} "})
    return config


def planned(begin: Sequence[float], end: Sequence[float], seconds: float = 2.0, count: int = 50) -> JointTrajectory:
    """Return a minimum-jerk path with times, velocities and accelerations, at rest at both ends."""
    points = []
    for index in range(count):
        s = index / (count - 1)
        rest = 10 * s**3 - 15 * s**4 + 6 * s**5
        speed = (30 * s**2 - 60 * s**3 + 30 * s**4) / seconds
        gain = (60 * s - 180 * s**2 + 120 * s**3) / seconds**2
        ways = [b - a for a, b in zip(begin, end, strict=True)]
        points.append(
            Point(
                [a + rest * way for a, way in zip(begin, ways, strict=True)],
                [speed * way for way in ways],
                [gain * way for way in ways],
                time=round(s * seconds * 1e9),
            )
        )
    return JointTrajectory(JOINTS, points)
