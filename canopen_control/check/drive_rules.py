"""Rules about the drives of a robot: feedback, modes and targets, and keys that manufacturers' drives need."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from canopen_control.check.timing_rules import CheckedRobot, Finding
from canopen_control.cia402 import objects
from canopen_control.cia402.modes import TARGET_OBJECTS, mode_words
from canopen_control.controllers.base import ALL_STATES
from canopen_control.hardware.feedback import MEASURED
from canopen_control.hardware.plugins import KNOWN, PluginKind
from canopen_control.master.known_drives import known_drive, proposals
from canopen_control.od.issues import Severity
from canopen_control.runtime.sync_choice import axis_number, node_of
from canopen_control.urdf.joint_element import EFFORT, POSITION, VELOCITY

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from canopen_control.od.model import ObjectDictionary


def _without_feedback(robot: CheckedRobot) -> Iterator[Finding]:
    """Find drives without actual position and actual velocity in any TPDO."""
    bus = robot.bus
    if bus is None:
        return
    for name, node in bus.nodes.items():
        plan = bus.plans.get(name)
        if plan is None:
            continue
        for offset in plan.axes:
            carried = {mapped.index for layout in plan.tpdos for mapped in layout.objects}
            if carried.isdisjoint({objects.POSITION_ACTUAL + offset, objects.VELOCITY_ACTUAL + offset}):
                text = (
                    f"{name}: no TPDO carries 0x{objects.POSITION_ACTUAL + offset:04X} or "
                    f"0x{objects.VELOCITY_ACTUAL + offset:04X}: it is moved without feedback"
                )
                place, od = bus.place(name, "tpdo"), bus.dictionaries[name]
                measured = [index + offset for index in (objects.POSITION_ACTUAL, objects.VELOCITY_ACTUAL)]
                fix = "map one of them"
                if not any(od.get(index) for index in measured):
                    fix = f"{node.identity.dcf} has neither object, so control loops are impossible"
                elif not any(_shown(od, index) for index in measured):
                    fix = f"{node.identity.dcf} allows mapping neither object, so control loops are impossible"
                yield Finding(place.path, place.line, Severity.WARNING, text, fix, column=place.column)


def _shown(od: ObjectDictionary, index: int) -> bool:
    """Whether an object exists and can be mapped to a TPDO."""
    entry = od.get(index, 0)
    return entry is not None and entry.tpdo_mappable


def _measured(robot: CheckedRobot) -> Iterator[Finding]:
    """Find state interfaces in the URDF whose object is not in a TPDO of the drive."""
    bus, description = robot.bus, robot.description
    if bus is None or description is None or robot.mock:
        return
    by_id = {str(node.node_id): name for name, node in bus.nodes.items()}
    # in ROS 1 every hardware interface has an effort, also if the robot does not measure it
    measured = {name: index for name, index in MEASURED.items() if not (description.ros1 and name == EFFORT)}
    no_feedback = any(tag.joints for tag in description.hardware)
    for tag in description.hardware:
        no_feedback = no_feedback and not tag.sensors and not tag.gpios
        if KNOWN.get(tag.plugin) is not PluginKind.CANOPEN and not robot.real:
            no_feedback = False
            continue
        for joint in tag.joints:
            name = joint.parameters.get("device_name") or by_id.get(joint.parameters.get("node_id", "").strip(), "")
            axis = joint.parameters.get("axis", joint.parameters.get("channel", "0")).strip()
            if (plan := bus.plans.get(name)) is None or not axis.isdigit() or int(axis) >= len(plan.axes):
                no_feedback = False
                continue
            carried = {mapped.index for layout in plan.tpdos for mapped in layout.objects}
            no_feedback = no_feedback and carried.isdisjoint(
                objects.axis_index(index, int(axis)) for index in MEASURED.values()
            )
            missing = {
                interface: objects.axis_index(index, int(axis))
                for interface, index in measured.items()
                if interface in joint.state_interfaces and objects.axis_index(index, int(axis)) not in carried
            }
            for interface, index in missing.items():
                text = f"joint {joint.name} has {interface} as state interface, but no TPDO of {name} has 0x{index:04X}"
                derived = interface == VELOCITY and objects.axis_index(MEASURED[POSITION], int(axis)) in carried
                end = "the velocity is derived from positions, later and coarser" if derived else "the value is unknown"
                counts = _shown(bus.dictionaries[name], index)
                file = bus.nodes[name].identity.dcf
                fix = f"map 0x{index:04X} in {bus.path}" if counts else f"{file} has no such object that can be mapped"
                severity = Severity.NOTE if derived else Severity.WARNING
                yield Finding(description.path, joint.place.line, severity, f"{text}: {end}", fix)
    for name, controller in robot.configured.items() if no_feedback else ():
        if ALL_STATES in controller.state_interface_names():
            config = robot.config(name)
            text = f"{name} has nothing to publish: no TPDO carries a position, a velocity or an effort"
            fix = "map 0x6064 or 0x606C, or remove the broadcaster"
            yield Finding(config.path, config.line, robot.severity(name), text, fix)


def _unjoined(robot: CheckedRobot) -> Iterator[Finding]:
    """Find motors that share a controlword but have no joint: these are enabled, but faults are not seen."""
    bus, description = robot.bus, robot.description
    if bus is None or description is None or robot.mock:
        return
    joints = [joint for tag in description.hardware for joint in tag.joints if joint.command_interfaces]
    for name, plan in bus.plans.items():
        axes = {axis_number(joint) for joint in joints if node_of(bus, joint) is bus.nodes[name]}
        if plan.motors is None or not axes:
            continue
        for axis in sorted({*range(len(plan.motors.subindices))} - axes):
            place = bus.place(name, "motor_subindices")
            text = f"axis {axis} of {name} has no joint: it is enabled with the others, but its faults are not detected"
            fix = f'give a joint <param name="axis">{axis}</param>'
            yield Finding(place.path, place.line, Severity.WARNING, text, fix, column=place.column)


def _known(robot: CheckedRobot) -> Iterator[Finding]:
    """Propose keys that drives of a known manufacturer need and that are missing in bus.yml."""
    bus = robot.bus
    for name, node in ({} if bus is None or robot.mock else bus.nodes).items():
        if bus is None or (plan := bus.plans.get(name)) is None or not plan.axes:
            continue
        identity, device = plan.identity, bus.dictionaries[name].device
        words = f"{device.vendor_name} {device.product_name}"
        if (drive := known_drive(identity.vendor_id, identity.product_code, words)) is None:
            continue
        section = bus.sections[name]
        keys = {str(key) for key in section.keys()}  # noqa: SIM118 - a Node is not a mapping
        written_indices = {entry.index for entry in node.boot.sdo}
        for key, text in proposals(drive, bus.master.sync_period, keys, written_indices, _commanded(robot, name)):
            yield Finding(
                section.path,
                section.line,
                Severity.NOTE,
                f"{name} is recognized as {drive.title}, and such drives need `{text}`: {key.why} ({key.source})",
                "add the key, unless this drive differs",
            )


def _modes_unlisted(robot: CheckedRobot) -> Iterator[Finding]:
    """Find drives with a mode neither in bus.yml nor in the EDS (0x6502, optional in CiA 402-2)."""
    bus = robot.bus
    for name, node in ({} if bus is None or robot.mock else bus.nodes).items():
        plan, motion = bus.plans.get(name) if bus is not None else None, node.motion
        if bus is None or plan is None or not plan.axes:
            continue
        has_mode = any(mode is not None for mode in (motion.position_mode, motion.velocity_mode, motion.effort_mode))
        if not has_mode and bus.dictionaries[name].get(objects.SUPPORTED_DRIVE_MODES, 0) is None:
            section, file = bus.sections[name], node.identity.dcf
            text = f"{name}: {file} does not list the drive's modes (0x6502): its profile modes are tried (PV, PP, TQ)"
            fix = "give velocity_mode, position_mode or effort_mode"
            yield Finding(section.path, section.line, Severity.NOTE, text, fix)


def _targets_unmapped(robot: CheckedRobot) -> Iterator[Finding]:
    """Find modes in bus.yml whose target object is not in an RPDO, so that the drive cannot be enabled."""
    bus = robot.bus
    for name, node in ({} if bus is None or robot.mock else bus.nodes).items():
        plan, motion = bus.plans.get(name) if bus is not None else None, node.motion
        if bus is None or plan is None or motion.motor_subindices:
            continue
        carried = {(mapped.index, mapped.subindex) for layout in plan.rpdos for mapped in layout.objects}
        commanded = _commanded(robot, name)
        for kind in (POSITION, VELOCITY, EFFORT):
            mode = getattr(motion, f"{kind}_mode")
            target = motion.own_target(kind) or TARGET_OBJECTS.get(mode)
            if kind not in commanded or mode is None or target is None or kind in motion.feed_forward:
                continue
            index, subindex = target
            if not any((index + offset, subindex) in carried for offset in plan.axes):
                place = bus.place(name, f"{kind}_mode")
                text = f"{name}: no RPDO carries 0x{index:04X}:{subindex:02X}, the target of {mode_words(mode)}"
                fix = f"map it, or use a {kind}_mode whose target is mapped"
                yield Finding(place.path, place.line, Severity.ERROR, text, fix, column=place.column)


def _commanded(robot: CheckedRobot, node: str) -> set[str]:
    """Return the command interfaces of the joints that a node moves."""
    bus, description = robot.bus, robot.description
    if bus is None or description is None:
        return set()
    joints = [joint for tag in description.hardware for joint in tag.joints]
    return {name for joint in joints if node_of(bus, joint) is bus.nodes[node] for name in joint.command_interfaces}


DRIVE_RULES: Final[tuple[Callable[[CheckedRobot], Iterator[Finding]], ...]] = (
    _without_feedback,
    _measured,
    _modes_unlisted,
    _unjoined,
    _targets_unmapped,
    _known,
)
