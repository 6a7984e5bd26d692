"""Which joints are commanded in a cyclic synchronous mode, CSP or CSV: their drives time their motion by SYNC.

By the files alone: the mode that `position_mode` or `velocity_mode` of bus.yml gives, else the one that is chosen of
those that the EDS lists, which is the cyclic one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from canopen_control.cia402 import objects
from canopen_control.cia402.modes import OperationMode, supported_modes
from canopen_control.urdf.joint_element import POSITION, VELOCITY

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from canopen_control.master.config import BusConfig
    from canopen_control.master.keys import NodeConfig
    from canopen_control.urdf.description import UrdfDescription
    from canopen_control.urdf.ros2_control import ControlJoint


_CYCLIC: Final = {
    POSITION: (OperationMode.CSP, objects.TARGET_POSITION),
    VELOCITY: (OperationMode.CSV, objects.TARGET_VELOCITY),
}
_NAMED: Final = 3  # joints in a sentence


@dataclass(frozen=True, slots=True)
class CyclicAxis:
    """A joint that is commanded in a cyclic synchronous mode, and the object of its set-points."""

    joint: str
    node: NodeConfig
    mode: OperationMode
    target: int


def cyclic_axes(config: BusConfig, description: UrdfDescription) -> list[CyclicAxis]:
    """Return those of one bus, one for each mode of a joint."""
    return [axis for tag in description.hardware for joint in tag.joints for axis in _axes(config, joint)]


def linear_axes(config: BusConfig, description: UrdfDescription) -> frozenset[tuple[str, int]]:
    """Return node and axis of each prismatic joint that a bus moves."""
    return frozenset(
        (node.name, axis_number(joint))
        for tag in description.hardware
        for joint in tag.joints
        if (node := node_of(config, joint)) is not None
        and (model := description.joints.get(joint.name)) is not None
        and model.type == "prismatic"
    )


def joint_words(axes: Sequence[CyclicAxis]) -> str:
    """Name the joints, the first ones of many."""
    joints = list(dict.fromkeys(axis.joint for axis in axes))
    return ", ".join(joints[:_NAMED]) + (f" and {len(joints) - _NAMED} more" if len(joints) > _NAMED else "")


def _axes(config: BusConfig, joint: ControlJoint) -> Iterator[CyclicAxis]:
    node = node_of(config, joint)
    if node is None or node.name not in config.plans:
        return
    number = axis_number(joint)
    entry = config.dictionaries[node.name].get(objects.axis_index(objects.SUPPORTED_DRIVE_MODES, number), 0)
    listed = supported_modes(entry.value) if entry is not None and isinstance(entry.value, int) else ()
    wanted = {POSITION: node.motion.position_mode, VELOCITY: node.motion.velocity_mode}
    for interface, (mode, target) in _CYCLIC.items():
        chosen = wanted[interface]
        if interface in joint.command_interfaces and (chosen == mode or (chosen is None and mode in listed)):
            yield CyclicAxis(joint.name, node, mode, objects.axis_index(target, number))


def axis_number(joint: ControlJoint) -> int:
    """Return which axis of its node a joint is."""
    text = joint.parameters.get("axis", joint.parameters.get("channel", "0")).strip()
    return int(text) if text.isdigit() and int(text) < objects.AXES else 0


def node_of(config: BusConfig, joint: ControlJoint) -> NodeConfig | None:
    """Return the node of a bus that moves a joint, None where it is on no drive of it."""
    name, node_id = joint.parameters.get("device_name"), joint.parameters.get("node_id", "").strip()
    if name is not None:
        return config.nodes.get(name)
    return next((node for node in config.nodes.values() if str(node.node_id) == node_id), None)
