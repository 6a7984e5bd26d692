"""Choice of the mode of operation for a command interface (0x6502, CiA 402-2), and of its RPDO.

The key of bus.yml decides the mode where it says something, else the best mode that the drive lists (0x6502)
and whose target an RPDO carries, cyclic before profile; what cannot be is refused before anything is sent.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

from canopen_control.cia402 import objects
from canopen_control.cia402.modes import (
    INTERFACE_MODES,
    TARGET_OBJECTS,
    OperationMode,
    mode_for_interface,
    mode_name,
    mode_of,
    mode_words,
    supported_modes,
)
from canopen_control.cia402.motors import motors_of
from canopen_control.cia402.objects import axis_index
from canopen_control.errors import DriveError, RobotConfigError
from canopen_control.hardware.feed_forward import FEED_FORWARD
from canopen_control.hardware.interfaces import DIGITAL_OUTPUTS, MOTION_INTERFACES, TARGET
from canopen_control.urdf.joint_element import EFFORT, POSITION, VELOCITY, InterfaceInfo

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping

    from canopen_control.hardware.axis import AxisProcessData
    from canopen_control.hardware.axis_parameters import AxisParameters
    from canopen_control.master.plan import NodePlan
    from canopen_control.urdf.description import UrdfDescription
    from canopen_control.urdf.ros2_control import ControlJoint, Ros2ControlSystem


_ASSUMED: Final = (OperationMode.PP, OperationMode.IP, OperationMode.PV, OperationMode.VL, OperationMode.TQ)
"""Modes of a drive that lists none (0x6502 is optional, CiA 402-2): those that drives had before the cyclic ones."""

_SERVED: Final = {
    POSITION: (*INTERFACE_MODES[POSITION], OperationMode.IP),
    VELOCITY: (*INTERFACE_MODES[VELOCITY], OperationMode.VL),
    EFFORT: INTERFACE_MODES[EFFORT],
    TARGET: (
        OperationMode.PP,
        OperationMode.PV,
        OperationMode.VL,
        OperationMode.CSP,
        OperationMode.CSV,
        OperationMode.IP,
        OperationMode.TQ,
        OperationMode.CST,
    ),
}
"""Command interface to the modes that serve it; the last ones only where no better one is there.

A TARGET is served by all of them. The first is what a drive begins with: those in which the drive makes the ramp.
"""


def listed_modes(axis: AxisProcessData, parameters: AxisParameters) -> tuple[int, ...]:
    """Return the modes listed in 0x6502 and those of bus.yml; () without a list.

    Drives have modes that 0x6502 does not list (Technosoft iPOS: CSP; roboticslab-uc3m/yarp-devices, issue 222).
    """
    listed = _of_drive(axis, parameters)
    return (*listed, *(mode for mode in _of_file(axis) if mode not in listed)) if listed else ()


def unlisted_modes(axis: AxisProcessData, parameters: AxisParameters) -> list[str]:
    """Return a sentence for each mode that bus.yml gives and 0x6502 does not list, and for modes that nothing lists."""
    listed = _of_drive(axis, parameters)
    if not listed and not _of_file(axis):
        return [
            "neither the drive nor its EDS lists its modes (0x6502): its profile modes are tried (PV, PP, TQ); "
            "give velocity_mode, position_mode or effort_mode in bus.yml"
        ]
    named = ", ".join(mode.name for mode in listed)
    return [
        f"0x6502 lists {named}, and not {mode_name(mode)}, which bus.yml gives; that is tried"
        for mode in _of_file(axis)
        if listed and mode not in listed and mode >= 0
    ]


def _of_file(axis: AxisProcessData) -> list[int]:
    keys = axis.node.config.motion
    modes = (keys.position_mode, keys.velocity_mode, keys.effort_mode)
    return [mode_of(mode) for mode in modes if mode is not None]


def _of_drive(axis: AxisProcessData, parameters: AxisParameters) -> tuple[OperationMode, ...]:
    """Return the modes of 0x6502 in the drive, else in the EDS; () without either.

    0 says nothing: a drive has a mode, and a maker who gives no value writes it too.
    """
    identity, entry = axis.node.identity, axis.node.od.get(axis.index(objects.SUPPORTED_DRIVE_MODES), 0)
    at_boot = identity.supported_modes if identity is not None and len(axis.node.plan.axes) == 1 else None
    in_eds = entry.value if entry is not None and isinstance(entry.value, int) else None
    return supported_modes(parameters.get(objects.SUPPORTED_DRIVE_MODES) or at_boot or in_eds or 0)


def choose_mode(axis: AxisProcessData, parameters: AxisParameters, interface: str) -> int:
    """Return the mode for a command interface; DriveError (UnsupportedMode) if none serves it."""
    config = axis.node.config
    keys = config.motion
    modes = {POSITION: keys.position_mode, VELOCITY: keys.velocity_mode, EFFORT: keys.effort_mode}
    modes[TARGET] = next((mode for mode in modes.values() if mode is not None), None)
    wanted = modes[interface]
    listed = listed_modes(axis, parameters)
    if wanted is not None:
        require_mapped(axis, wanted)
        return mode_of(wanted)
    candidates = [mode for mode in _SERVED[interface] if mode in listed or (not listed and mode in _ASSUMED)]
    for mode in candidates:
        if _is_mapped(axis, mode):
            return mode
    for mode in candidates[:1]:
        require_mapped(axis, mode)
    return mode_for_interface(POSITION if interface == TARGET else interface, listed)


def serving_objects(interface: str) -> tuple[tuple[int, int], ...]:
    """Return index and subindex, on axis 0, of the targets of all modes that serve a command interface."""
    return tuple(TARGET_OBJECTS[mode] for mode in _SERVED[interface])


def require_targets(axis: AxisProcessData, interfaces: Collection[str]) -> None:
    """Raise RobotConfigError for a command interface without a target in any RPDO."""
    for name in interfaces:
        if name == DIGITAL_OUTPUTS:
            if axis.digital_outputs is None:
                raise _unmapped(axis, name, "0x60FE:01")
        elif name == TARGET or (name in FEED_FORWARD and POSITION in interfaces and _feeds(axis, name)):
            continue  # a drive on a bus alone may be there to be looked at: its enable says what is missing
        elif name not in _SERVED:
            known = ", ".join((*MOTION_INTERFACES, DIGITAL_OUTPUTS))
            raise RobotConfigError(f"joint {axis.joint}: no command interface {name!r}; there are: {known}")
        elif not any(_is_mapped(axis, mode) for mode in _served(axis, name)):
            index, _ = axis.target_objects[_served(axis, name)[0]]
            place = f"0x{axis.index(index):04X}"
            if name in FEED_FORWARD and POSITION in interfaces:
                place += f", or beside its position give feed_forward: [{name}],"
            raise _unmapped(axis, name, place)


def _feeds(axis: AxisProcessData, interface: str) -> bool:
    """Whether an RPDO contains the offset of a command interface without a target of its own."""
    return (axis.velocity_offset if interface == VELOCITY else axis.torque_offset) is not None


def _served(axis: AxisProcessData, interface: str) -> tuple[int, ...]:
    """Return the modes that serve a command interface, those with a target in bus.yml first."""
    own = [mode for mode, name in axis.own_modes.items() if name == interface]
    return (*own, *(mode for mode in _SERVED[interface] if mode not in own))


def _is_mapped(axis: AxisProcessData, mode: int) -> bool:
    address = axis.target_objects.get(mode)
    return address is not None and axis.output(*address) is not None


def require_mapped(axis: AxisProcessData, mode: int) -> None:
    """Raise DriveError if no RPDO contains the target of a mode."""
    if not _is_mapped(axis, mode):
        index, subindex = axis.target_objects.get(mode, (0, 0))
        raise DriveError(
            f"{axis.node.who}: no RPDO carries 0x{axis.index(index):04X}:{subindex:02X}, "
            f"the target of {mode_words(mode)}; map it in bus.yml"
        )


def _unmapped(axis: AxisProcessData, interface: str, title: str) -> RobotConfigError:
    advice = f"map {title} in bus.yml or drop the interface"
    if motors_of(axis.node.od) is not None:
        advice = "its targets have a subindex for each of two motors: give it `motor_subindices: [1, 2]` in bus.yml"
    return RobotConfigError(
        f"joint {axis.joint}: no RPDO of {axis.node.name} carries the target of its command interface {interface!r}; "
        f"{advice}"
    )


# Command interfaces that ros2_canopen's hardware plugins export although the description does not list them.
#
# Rules (canopen_ros2_control): Cia402System and RobotSystem make the interfaces of a joint by themselves,
# so that their descriptions often list none. A joint of such a tag without any command interface has position, velocity
# and effort here, as far as an RPDO of its node carries a target for them; one that lists some has those.


PLUGINS: Final = (
    "canopen_ros2_control/Cia402System",
    "canopen_ros2_control/RobotSystem",
    "canopen_ros2_control/Cia402RobotSystem",
)


def add_plugin_interfaces(description: UrdfDescription, plans: Iterable[NodePlan]) -> UrdfDescription:
    """Return the description with the interfaces that its plugins would export, and a note for each changed joint."""
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
    """Return the joint with the interfaces of its node; unchanged if it has some or the node is unknown."""
    name, node_id = joint.parameters.get("device_name"), joint.parameters.get("node_id", "").strip()
    plan = plans.get(name or "") or next((plan for plan in plans.values() if str(plan.node_id) == node_id), None)
    axis = joint.parameters.get("axis", joint.parameters.get("channel", "0")).strip()
    if joint.command_interfaces or joint.mimic is not None or plan is None or not axis.isdigit():
        return joint
    mapped = {(entry.index, entry.subindex) for pdo in plan.rpdos for entry in pdo.objects}
    carried = [
        interface
        for interface in MOTION_INTERFACES
        if any((axis_index(index, int(axis)), subindex) in mapped for index, subindex in serving_objects(interface))
    ]
    return replace(joint, command_interfaces={name: InterfaceInfo(name) for name in carried}) if carried else joint
