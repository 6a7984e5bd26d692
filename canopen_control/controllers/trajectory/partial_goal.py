"""Trajectories of some of the joints, and in another order: filled up, and put into the order of the controller."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.controllers.trajectory.point import JointTrajectory

__all__ = ["fill_up", "put_in_order"]


def fill_up(
    message: JointTrajectory, joints: Sequence[str], commands: Sequence[float], positions: Sequence[float]
) -> None:
    """Let the joints that are not named stay: at what is commanded to them, else where they are; nan is unknown."""
    if len(message.joint_names) == len(joints):
        return
    for index, name in enumerate(joints):
        if name in message.joint_names:
            continue
        message.joint_names.append(name)
        stay = positions[index] if math.isnan(commands[index]) else commands[index]
        for point in message.points:
            if point.positions and not math.isnan(stay):
                point.positions.append(stay)
            for each in (point.velocities, point.accelerations, point.effort):
                if each:
                    each.append(0.0)


def put_in_order(message: JointTrajectory, joints: Sequence[str]) -> None:
    """Put the values of every point into the order of `joints`; those that are not one for each name stay."""
    names = message.joint_names
    if names == list(joints):
        return
    order = [names.index(name) for name in joints if name in names]
    for point in message.points:
        for values in (point.positions, point.velocities, point.accelerations, point.effort):
            if len(values) == len(names):
                values[:] = [values[each] for each in order]
