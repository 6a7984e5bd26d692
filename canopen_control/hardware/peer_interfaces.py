"""Command interfaces that ros2_canopen's hardware plugins export although the description does not list them.

The law of the file (canopen_ros2_control): Cia402System and RobotSystem make the interfaces of a joint by themselves,
so that their descriptions often list none. A joint of such a tag without any command interface has position, velocity
and effort here, as far as an RPDO of its node carries a target for them; one that lists some has those.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

from canopen_control.cia402.objects import axis_index
from canopen_control.hardware.interfaces import MOTION_INTERFACES
from canopen_control.hardware.mode_choice import serving_objects
from canopen_control.urdf.declared_interface import InterfaceInfo

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from canopen_control.master.plan import NodePlan
    from canopen_control.urdf.description import Description
    from canopen_control.urdf.ros2_control import ControlJoint, Ros2ControlSystem

__all__ = ["PLUGINS", "with_interfaces_of_plugins"]

PLUGINS: Final = (
    "canopen_ros2_control/Cia402System",
    "canopen_ros2_control/RobotSystem",
    "canopen_ros2_control/Cia402RobotSystem",
)


def with_interfaces_of_plugins(description: Description, plans: Iterable[NodePlan]) -> Description:
    """Return the description with the interfaces that its plugins would export, and a note for each joint that has."""
    by_name = {plan.name: plan for plan in plans}
    hardware = tuple(_completed(tag, by_name) for tag in description.hardware)
    before = {joint.name: joint for tag in description.hardware for joint in tag.joints}
    notes = [
        f"{description.path}:{joint.place.line}: {joint.name} lists no command interface and has those that "
        f"{tag.plugin} exports: {', '.join(joint.command_interfaces)}"
        for tag in hardware
        for joint in tag.joints
        if joint is not before[joint.name]
    ]
    return replace(description, hardware=hardware, notes=(*description.notes, *notes)) if notes else description


def _completed(tag: Ros2ControlSystem, plans: Mapping[str, NodePlan]) -> Ros2ControlSystem:
    if tag.plugin not in PLUGINS:
        return tag
    return replace(tag, joints=tuple(_joint(joint, plans) for joint in tag.joints))


def _joint(joint: ControlJoint, plans: Mapping[str, NodePlan]) -> ControlJoint:
    """Return a joint with what its node could be commanded; as it is where it has some, or nobody knows its node."""
    name, node_id = joint.parameters.get("device_name"), joint.parameters.get("node_id", "").strip()
    plan = plans.get(name or "") or next((each for each in plans.values() if str(each.node_id) == node_id), None)
    axis = joint.parameters.get("axis", joint.parameters.get("channel", "0")).strip()
    if joint.command_interfaces or joint.mimic is not None or plan is None or not axis.isdigit():
        return joint
    mapped = {(each.index, each.subindex) for pdo in plan.rpdos for each in pdo.objects}
    carried = [
        interface
        for interface in MOTION_INTERFACES
        if any((axis_index(index, int(axis)), subindex) in mapped for index, subindex in serving_objects(interface))
    ]
    return replace(joint, command_interfaces={each: InterfaceInfo(each) for each in carried}) if carried else joint
