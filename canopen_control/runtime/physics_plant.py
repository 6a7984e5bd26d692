"""The plant file for a robot whose virtual drives are to move it in physics: which axis turns which joint, and how far.

It is made of what the robot has anyway, its description and the scales of bus.yml, and written beside its logs, so that
it can be read, changed and given to `drive --plant`.
"""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from canopen_control.bus.channel import parse_channel
from canopen_control.errors import RobotConfigError
from canopen_control.host.files import state_dir, write_whole

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path

    from canopen_control.hardware.joint import JointDrive
    from canopen_control.runtime.setup import RobotSetup

__all__ = ["PLANT_FILE", "check_physics", "write_plant"]

PLANT_FILE = "physics.yml"
_URDF = "physics.urdf"


def check_physics(setup: RobotSetup) -> None:
    """Raise RobotConfigError where no virtual drives can move the robot in physics."""
    if setup.real or setup.mock:
        given = "--real" if setup.real else "--mock"
        raise RobotConfigError(f"--physics is for virtual drives; leave {given} away")
    if setup.files.bus_alone:
        raise RobotConfigError(f"--physics: {setup.files.bus} has no description, so that there is nothing to move")
    if len(setup.channels) > 1:
        raise RobotConfigError(
            f"--physics: the drives of one world are one process on one bus, and {setup.name} has the buses "
            f"{', '.join(setup.channels)}"
        )
    for channel in setup.channels.values():
        if parse_channel(channel).kind.in_process:
            raise RobotConfigError(
                f"--physics: the drives on {channel} are no process of their own; use --can local:NAME"
            )


def write_plant(setup: RobotSetup, joints: Mapping[str, JointDrive]) -> Path:
    """Write the plant file and the description for the joints of a robot; return its path. ConfigError if it cannot."""
    if not joints:
        raise RobotConfigError(f"--physics: no joint of {setup.description.path} is moved by a drive of bus.yml")
    folder = state_dir(setup.name)
    folder.mkdir(parents=True, exist_ok=True)
    write_whole(folder / _URDF, setup.description.urdf_xml.encode())
    path = folder / PLANT_FILE
    write_whole(path, plant_text(setup, joints.values()).encode())
    return path


def plant_text(setup: RobotSetup, joints: Iterable[JointDrive]) -> str:
    """Return the plant file as text."""
    ratios = {each.joint: each.reduction for tag in setup.description.hardware for each in tag.transmissions}
    lines = [f"# of {setup.description.path} and bus.yml", "engine: mujoco", f"urdf: {_URDF}", "axes:"]
    for joint in joints:
        axis = joint.axis.number
        address = f"{joint.node.node_id}/{axis}" if axis else f"{joint.node.node_id}"
        scale = joint.scale.pos_to_dev * ratios.get(joint.joint, 1.0)
        lines.append(f'  "{address}": {{joint: {json.dumps(joint.joint)}, scale_pos_to_dev: {scale!r}}}')
    return "\n".join(lines) + "\n"
