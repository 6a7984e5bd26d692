"""The `pids_config_file` of mujoco_ros2_control: gains of loops that make an effort of a position or a velocity.

    /**:
      ros__parameters:
        pid_gains:
          position:
            joint_1: {p: 400.0, i: 20.0, d: 15.0, u_clamp_max: 80.0, u_clamp_min: -80.0}
          velocity:
            wheel: {p: 2.0, i: 5.0, i_clamp_max: 3.0, i_clamp_min: -3.0}

The gains have control_toolbox's names. A joint without any keeps the servo of its own.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from canopen_control.controllers.pid import Pid
from canopen_control.controllers.standard_params import LoopGains
from canopen_control.errors import RobotConfigError, nearest
from canopen_control.yamlfile.convert import convert
from canopen_control.yamlfile.reader import tree

if TYPE_CHECKING:
    from pathlib import Path

    from canopen_control.urdf.ros2_control import Ros2ControlSystem
    from canopen_control.yamlfile.node import Node

__all__ = ["Loops", "read_pids"]

Loops = dict[str, dict[str, Pid]]
"""The loops of each joint, by the interface that is commanded."""
_PARAMETERS: Final = "ros__parameters"
_GAINS: Final = "pid_gains"
_INTERFACES: Final = ("position", "velocity")


def read_pids(path: Path, tag: Ros2ControlSystem) -> Loops:
    """Return the loops of a tag's joints; RobotConfigError with every mistake of the file and its place."""
    root, found = tree(path, error=RobotConfigError), Loops()
    blocks = [gains for node in _parameters(root) if (gains := node.get(_GAINS)) is not None]
    if not blocks:
        root.error(f"no {_GAINS}; write it below /**: {_PARAMETERS}:")
    commands = {part.name: tuple(part.command_interfaces) for part in tag.joints}
    for block in blocks:
        for interface, joints in _mapping(block, "position: and velocity:"):
            if interface not in _INTERFACES:
                block.keys()[interface].error(f"no gains of {interface!r} are known{nearest(interface, _INTERFACES)}")
                continue
            for joint, node in _mapping(joints, "gains by joints, as in joint_1: {p: 2.0}"):
                _check(joints.keys()[joint], joint, interface, commands)
                gains = convert(node, LoopGains, None)
                if gains is not None:
                    found.setdefault(joint, {})[interface] = Pid(gains.pid())
    root.problems.raise_if_any(RobotConfigError)
    return found


def _mapping(node: Node, wanted: str) -> list[tuple[str, Node]]:
    """Return what is below a node, nothing after reporting that there is something else than what is wanted."""
    if node.kind != "mapping":
        node.error(f"write {wanted}")
    return node.items()


def _parameters(root: Node) -> list[Node]:
    """Return the parameters of each node that the file names, whatever its name."""
    nodes = [value for _, value in root.items()]
    return [found for node in nodes if node.kind == "mapping" and (found := node.get(_PARAMETERS)) is not None]


def _check(place: Node, joint: str, interface: str, commands: dict[str, tuple[str, ...]]) -> None:
    """Report a joint that is not there, or does not take such commands."""
    if joint not in commands:
        place.error(f"no joint {joint!r} in the description's <ros2_control>{nearest(joint, commands)}")
    elif interface not in commands[joint]:
        has = ", ".join(commands[joint]) or "none"
        place.error(f"joint {joint} has no command interface {interface!r}; it has {has}")
