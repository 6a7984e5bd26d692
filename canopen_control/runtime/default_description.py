"""Default description and controllers for a bus without URDF and ros2_controllers.yaml.

As in ros2_canopen's device container, `driver` in bus.yml decides what a node is. A CiA 402 drive
(`ros2_canopen::Cia402Driver`, or no driver and an EDS with a controlword) becomes a joint with the name of the node;
each axis of a multi-axis drive becomes a joint with its name in `channel_names`. Every joint has its own controller,
which accepts targets in the drive's current mode and does not enable the drive. Every other node is a proxy: the
master boots and supervises the node and gives access by SDO, NMT and PDO, but no joint is moved. All drives of the bus
are one stop group, as in any robot. A drive whose PDOs contain no controlword or no statusword is a proxy too; a drive
whose RPDOs contain no target is supervised, and refuses commands that need a target. Both are reported once, as
warnings, so that the same bus.yml serves for observation.

A robot may combine both: a drive without a joint in the description, but with a CiA 402 `driver` in bus.yml, is handled
as on a bus without a robot, in the same stop group as the other drives; without such a `driver` the node is a proxy.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

from canopen_control.cia402.objects import (
    CONTROLWORD,
    STATUSWORD,
    TARGET_POSITION,
    TARGET_VELOCITY,
    axis_index,
    axis_of,
    object_name,
)
from canopen_control.controllers.controllers_file import ControllerConfig, ControllersFile
from canopen_control.controllers.forward_command import TYPE
from canopen_control.controllers.params import Params
from canopen_control.errors import RobotConfigError
from canopen_control.hardware.axis_parameters import serving_objects
from canopen_control.hardware.interfaces import TARGET
from canopen_control.hardware.system import PLUGINS
from canopen_control.master.keys import DRIVE_DRIVERS
from canopen_control.urdf.description import UrdfDescription
from canopen_control.urdf.joint_element import EFFORT, POSITION, VELOCITY, InterfaceInfo
from canopen_control.urdf.robot_model import RobotModel
from canopen_control.urdf.ros2_control import ControlJoint, Ros2ControlSystem

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from canopen_control.master.config import BusConfig
    from canopen_control.master.keys import NodeConfig
    from canopen_control.master.plan import NodePlan


_PLUGIN: Final = "canopen_control/CanopenSystem"
_URDF: Final = '<robot name="{name}"><link name="base_link"/></robot>'


def description_of(name: str, path: str, buses: Mapping[str, BusConfig]) -> UrdfDescription:
    """Return a default description with one joint per drive axis.

    Raise RobotConfigError if two axes have the same name.
    """
    joints = tuple(joint for bus in buses.values() for joint in _joints(bus))
    _refuse_doubles(path, joints)
    system = _system(name, joints)
    return UrdfDescription(path, _URDF.format(name=name), RobotModel(name), (system,) if joints else ())


def controllers_of(path: str, description: UrdfDescription) -> ControllersFile:
    """Return default controllers, one per joint and with its name, for a bus without a ros2_controllers.yaml."""
    names = [joint.name for system in description.hardware for joint in system.joints]
    return ControllersFile(controllers=_target_controllers(names, path), path=path)


def with_free_drives(
    description: UrdfDescription, control: ControllersFile, buses: Mapping[str, BusConfig]
) -> tuple[UrdfDescription, ControllersFile, tuple[str, ...]]:
    """Add joints and controllers for drives without a joint; return both files and the names of the new joints."""
    free = tuple(
        (joint, node, axis) for joint, node, axis, problem in _free(buses, description, control) if not problem
    )
    if not free:
        return description, control, ()
    names = tuple(joint for joint, _, _ in free)
    controllers = {**control.controllers, **_target_controllers(names, control.path)}
    hardware = (*description.hardware, _system(_EXTRA_DRIVES, free))
    return replace(description, hardware=hardware), replace(control, controllers=controllers), names


def default_warnings(buses: Mapping[str, BusConfig]) -> Iterator[str]:
    """Yield warnings about contradictions between `driver` and EDS, and about axis objects missing in the PDOs."""
    for bus in buses.values():
        for node in bus.nodes.values():
            place, driver, source = f"{bus.path}:{node.line}", node.ros.driver, bus.eds_paths[node.name].name
            if _drives(driver) and not bus.plans[node.name].axes:
                yield f"{place}: {node.name} has the driver {driver}, but {source} has no controlword: it is a proxy"
            elif driver and not _drives(driver) and bus.plans[node.name].axes:
                yield (
                    f"{place}: {node.name} is a CiA 402 drive by {source} and has the driver {driver}: it is a proxy, "
                    "and cannot be enabled; give it ros2_canopen::Cia402Driver to move it"
                )
        for joint, node, axis in _axes(bus):
            if lack := _uncontrolled(bus.plans[node.name], axis) or _untargeted(bus.plans[node.name], axis):
                yield f"{bus.path}:{node.line}: {joint}: {lack}"


def unmoved_drives(
    buses: Mapping[str, BusConfig], description: UrdfDescription, control: ControllersFile | None
) -> Iterator[str]:
    """Yield a note for each CiA 402 drive without a joint in the description, unless a joint names no node."""
    if _has_lost_joint(buses, description):  # it may be the joint of the drive
        return
    free = dict[str, str]()
    for joint, node, _, problem in _free(buses, description, control or ControllersFile()):
        free[node.name] = problem or (
            f"it has its own controller, as on a bus without controllers; use axis enable {node.name}, command {joint}"
        )
    for bus in buses.values():
        for node in bus.nodes.values():
            if bus.plans[node.name].axes and not _is_named(node, description):
                reason = free.get(node.name, "it is a proxy, and cannot be enabled")
                text = f"{node.name} is a CiA 402 drive and no joint of {description.path} names it"
                yield f"{bus.path}:{node.line}: {text}: {reason}"


def _has_lost_joint(buses: Mapping[str, BusConfig], description: UrdfDescription) -> bool:
    nodes = [node for bus in buses.values() for node in bus.nodes.values()]
    names, ids = {node.name for node in nodes}, {str(node.node_id) for node in nodes}
    joints = [joint.parameters for tag in description.hardware if tag.plugin in PLUGINS for joint in tag.joints]
    return any(
        joint["device_name"] not in names if "device_name" in joint else joint.get("node_id", "").strip() not in ids
        for joint in joints
    )


_EXTRA_DRIVES: Final = "drives_of_bus_yml"


def _free(
    buses: Mapping[str, BusConfig], description: UrdfDescription, control: ControllersFile
) -> Iterator[tuple[str, NodeConfig, int, str]]:
    """Yield the joint name, node, axis and problem (or "") of each axis with a `driver` but without a joint."""
    if any(tag.plugin in PLUGINS for tag in description.hardware):
        parts = [part.name for tag in description.hardware for part in (*tag.joints, *tag.sensors, *tag.gpios)]
        names = {*parts, *description.joints, *control.controllers}
        for bus in buses.values():
            for joint, node, axis in _axes(bus):
                if node.ros.driver and not _is_named(node, description):
                    lack = _uncontrolled(bus.plans[node.name], axis)
                    clash = f"it is a proxy, since a joint, part or controller is also named {joint!r}; rename the node"
                    yield joint, node, axis, lack or (clash if joint in names else "")


def _is_named(node: NodeConfig, description: UrdfDescription) -> bool:
    joints = [part.parameters for tag in description.hardware for part in (*tag.joints, *tag.sensors, *tag.gpios)]
    return any(
        joint.get("device_name") == node.name or joint.get("node_id", "").strip() == str(node.node_id)
        for joint in joints
    )


def _system(name: str, axes: Iterable[tuple[str, NodeConfig, int]]) -> Ros2ControlSystem:
    """Return a <ros2_control> tag in which every axis is a joint with the command interface `target`."""
    states = {interface: InterfaceInfo(interface) for interface in (POSITION, VELOCITY, EFFORT)}
    target = {TARGET: InterfaceInfo(TARGET)}
    joints = tuple(
        ControlJoint(joint, _parameters(node, axis, may_be_absent=name == _EXTRA_DRIVES), dict(target), dict(states))
        for joint, node, axis in axes
    )
    return Ros2ControlSystem(name, "system", _PLUGIN, joints=joints)


def _parameters(node: NodeConfig, axis: int, *, may_be_absent: bool) -> dict[str, str]:
    """Return the URDF parameters of a joint; with `may_be_absent`, an optional node gets its own stop group."""
    bound = {"device_name": node.name, "axis": str(axis)}
    return bound | {"stop_group": node.name} if may_be_absent and not node.required else bound


def _target_controllers(names: Iterable[str], path: str) -> dict[str, ControllerConfig]:
    return {name: ControllerConfig(name, TYPE, Params.of({"joint": name}, name), path=path) for name in names}


def _drives(driver: str) -> bool:
    """Whether `driver` is a ros2_canopen driver for CiA 402 drives, in any ros2_canopen version."""
    return any(name in driver for name in DRIVE_DRIVERS)


def _joints(bus: BusConfig) -> Iterator[tuple[str, NodeConfig, int]]:
    """Yield the axes whose controlword and statusword are in PDOs."""
    for joint, node, axis in _axes(bus):
        if not _uncontrolled(bus.plans[node.name], axis):
            yield joint, node, axis


def _axes(bus: BusConfig) -> Iterator[tuple[str, NodeConfig, int]]:
    """Yield joint name, node and axis number for every drive axis on a bus."""
    for node in bus.nodes.values():
        axes = bus.plans[node.name].axes
        if not axes or (node.ros.driver and not _drives(node.ros.driver)):
            continue
        names = node.ros.channel_names or []
        for offset in axes:
            _, axis = axis_of(CONTROLWORD + offset)
            joint_name = names[axis] if axis < len(names) else f"{node.name}_{axis}"
            yield joint_name if len(axes) > 1 else node.name, node, axis


def _uncontrolled(plan: NodePlan, axis: int) -> str:
    """Return the warning about an axis whose controlword or statusword is not in a PDO, or "" if both are mapped."""
    for base, pdos, kind in ((CONTROLWORD, plan.rpdos, "RPDO"), (STATUSWORD, plan.tpdos, "TPDO")):
        index = axis_index(base, axis)
        if (index, 0) not in plan.carried(pdos):
            return (
                f"no {kind} carries 0x{index:04X} {object_name(index)}: it is a proxy, and cannot be enabled; "
                "map it in bus.yml to move it"
            )
    return ""


def _untargeted(plan: NodePlan, axis: int) -> str:
    """Return the warning about an axis whose target is not in an RPDO, or "" if it is."""
    carried = plan.carried(plan.rpdos)
    if any((axis_index(index, axis), subindex) in carried for index, subindex in serving_objects(TARGET)):
        return ""
    place, speed = (axis_index(index, axis) for index in (TARGET_POSITION, TARGET_VELOCITY))
    return (
        f"no RPDO carries a target: it is supervised, with access by SDO and NMT, but cannot be enabled; "
        f"map 0x{place:04X} or 0x{speed:04X} in bus.yml to move it"
    )


def _refuse_doubles(path: str, joints: Iterable[tuple[str, NodeConfig, int]]) -> None:
    owners: dict[str, str] = {}
    doubled = [
        f"{path}:{node.line}: {node.name} has an axis {name!r}, and so has {owners[name]}; change channel_names"
        for name, node, _ in joints
        if name in owners or owners.setdefault(name, node.name) != node.name
    ]
    if doubled:
        raise RobotConfigError("\n".join(doubled))
