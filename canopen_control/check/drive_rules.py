"""Rules about the drives of a robot: feedback, modes, targets, manufacturers' keys, and timing of set-points."""

from __future__ import annotations

import difflib
import math
from typing import TYPE_CHECKING, Final

from canopen_control.check.finding import CheckedRobot, Finding
from canopen_control.cia402 import objects
from canopen_control.cia402.modes import TARGET_OBJECTS, OperationMode, mode_words
from canopen_control.controllers.base import ALL_STATES
from canopen_control.hardware.feedback import MEASURED
from canopen_control.hardware.plugins import KNOWN, PluginKind
from canopen_control.master.known_drives import known_drive, proposals
from canopen_control.od.indices import TPDO
from canopen_control.od.issues import Severity
from canopen_control.runtime.sync_choice import CyclicAxis, axis_number, cyclic_axes, joint_words, node_of
from canopen_control.urdf.joint_element import EFFORT, POSITION, VELOCITY

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from canopen_control.controllers.controllers_file import ControllersFile
    from canopen_control.master.config import BusConfig
    from canopen_control.master.keys import NodeConfig
    from canopen_control.master.plan_builder import PlannedPdo
    from canopen_control.od.model import ObjectDictionary
    from canopen_control.urdf.description import UrdfDescription
    from canopen_control.urdf.ros2_control import ControlJoint
    from canopen_control.yamlfile.node import Node


def _without_feedback(robot: CheckedRobot) -> Iterator[Finding]:
    """Find drives that RPDOs can move, and whose actual position and actual velocity are in no TPDO."""
    bus = robot.bus
    if bus is None:
        return
    for name, node in bus.nodes.items():
        plan = bus.plans.get(name)
        if plan is None:
            continue
        for offset in plan.axes:
            carried = {mapped.index for layout in plan.tpdos for mapped in layout.objects}
            targets = {(index + offset, subindex) for index, subindex in TARGET_OBJECTS.values()}
            own = any(node.motion.own_target(kind) for kind in ("position", "velocity", "effort"))
            if not own and targets.isdisjoint(plan.carried(plan.rpdos)):
                continue  # it cannot be enabled, which is reported
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


def _commanded_joints(description: UrdfDescription) -> list[ControlJoint]:
    return [joint for tag in description.hardware for joint in tag.joints if joint.command_interfaces]


def _never_started(robot: CheckedRobot) -> Iterator[Finding]:
    """Find joints with a command interface whose node has `boot: false`, so that the master never starts it."""
    bus, description = robot.bus, robot.description
    if bus is None or description is None or robot.mock:
        return
    for name, node in bus.nodes.items():
        joints = [joint.name for joint in _commanded_joints(description) if node_of(bus, joint) is node]
        if joints and not node.boot.enabled:
            place = bus.place(name, "boot")
            text = f"{name} has boot: false, so it is never started, and {', '.join(joints)} cannot move"
            yield Finding(place.path, place.line, Severity.WARNING, text, "remove boot: false", column=place.column)


def _has_errors(place: Node) -> bool:
    """Whether an error was reported in a section of bus.yml, which explains what is missing in the plan."""
    return any(error.where.startswith(place.where) for error in place.problems.errors)


def _shown(od: ObjectDictionary, index: int) -> bool:
    """Whether an object exists and can be mapped to a TPDO."""
    entry = od.get(index, 0)
    return entry is not None and entry.tpdo_mappable


def _measured(robot: CheckedRobot) -> Iterator[Finding]:
    """Find state interfaces in the URDF whose object is in no TPDO, and broadcasters without anything to publish."""
    bus, description = robot.bus, robot.description
    if bus is None or description is None or robot.mock:
        return
    by_id = {str(node.node_id): name for name, node in bus.nodes.items()}
    # in ROS 1 every hardware interface has an effort, even if the robot does not measure it
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
            yield from _misspelt_states(description.path, joint)
            carried = {mapped.index for layout in plan.tpdos for mapped in layout.objects}
            no_feedback = no_feedback and carried.isdisjoint(
                objects.axis_index(index, int(axis)) for index in MEASURED.values()
            )
            missing = {
                interface: objects.axis_index(index, int(axis))
                for interface, index in measured.items()
                if interface in joint.state_interfaces and objects.axis_index(index, int(axis)) not in carried
            }
            for interface, index in {} if _has_errors(bus.place(name, "tpdo")) else missing.items():
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


_MISSPELT: Final = 0.8  # ratio of difflib; below it the name is another quantity, such as velocity_command


def _misspelt_states(path: str, joint: ControlJoint) -> Iterator[Finding]:
    """Find names similar to a measured quantity, which ros2_control would treat as another interface."""
    for interface in joint.state_interfaces:
        if interface not in MEASURED and (near := difflib.get_close_matches(interface, MEASURED, 1, _MISSPELT)):
            text = f"joint {joint.name} has no state interface {interface!r} (did you mean {near[0]!r}?)"
            yield Finding(path, joint.place.line, Severity.WARNING, text, "correct its name")


def _unjoined(robot: CheckedRobot) -> Iterator[Finding]:
    """Find motors that share a controlword but have no joint: they are enabled, but their faults are not seen."""
    bus, description = robot.bus, robot.description
    if bus is None or description is None or robot.mock:
        return
    for name, plan in bus.plans.items():
        axes = {
            axis_number(joint) for joint in _commanded_joints(description) if node_of(bus, joint) is bus.nodes[name]
        }
        if plan.motors is None or not axes:
            continue
        for axis in sorted({*range(len(plan.motors.subindices))} - axes):
            place = bus.place(name, "motor_subindices")
            text = f"axis {axis} of {name} has no joint: it is enabled with the others, but its faults are not detected"
            fix = f'give a joint <param name="axis">{axis}</param>'
            yield Finding(place.path, place.line, Severity.WARNING, text, fix, column=place.column)


def _known(robot: CheckedRobot) -> Iterator[Finding]:
    """Propose keys that a known manufacturer's drives need and that are missing in bus.yml."""
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
    """Find drives whose modes are given neither in bus.yml nor in the EDS (0x6502, optional in CiA 402-2)."""
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
        if bus is None or plan is None or motion.motor_subindices or not plan.axes:  # an EDS without controlword
            continue
        carried = {(mapped.index, mapped.subindex) for layout in plan.rpdos for mapped in layout.objects}
        commanded = _commanded(robot, name)
        for kind in (POSITION, VELOCITY, EFFORT):
            mode = getattr(motion, f"{kind}_mode")
            target = motion.own_target(kind) or TARGET_OBJECTS.get(mode)
            if kind not in commanded or mode is None or target is None or kind in motion.feed_forward:
                continue
            index, subindex = target
            targets = {(index + offset, subindex) for offset in plan.axes}
            if targets.isdisjoint(carried) and targets.isdisjoint(_mapped_in_file(node)):
                place = bus.place(name, f"{kind}_mode")
                text = f"{name}: no RPDO carries 0x{index:04X}:{subindex:02X}, the target of {mode_words(mode)}"
                fix = f"map it, or use a {kind}_mode whose target is mapped"
                if not any(bus.dictionaries[name].get(*target) for target in targets):
                    fix = f"{node.identity.dcf} has no such object, so use a {kind}_mode whose target it has"
                yield Finding(place.path, place.line, Severity.ERROR, text, fix, column=place.column)


def _mapped_in_file(node: NodeConfig) -> set[tuple[int, int]]:
    """Return the objects that bus.yml maps to RPDOs, including those that the plan refuses."""
    pdos = node.boot.pdos("rpdo").values()
    return {(mapped.index, mapped.sub_index) for pdo in pdos for mapped in pdo.mapping or ()}


def _commanded(robot: CheckedRobot, node: str) -> set[str]:
    """Return the command interfaces of the joints that a node moves."""
    bus, description = robot.bus, robot.description
    if bus is None or description is None:
        return set()
    joints = [joint for tag in description.hardware for joint in tag.joints]
    return {name for joint in joints if node_of(bus, joint) is bus.nodes[node] for name in joint.command_interfaces}


DRIVE_RULES: Final[tuple[Callable[[CheckedRobot], Iterator[Finding]], ...]] = (
    _without_feedback,
    _never_started,
    _measured,
    _modes_unlisted,
    _unjoined,
    _targets_unmapped,
    _known,
)


# Timing of cyclic set-points: causes of rough motion in CSP and CSV.
#
# A drive in a cyclic mode applies one set-point with each SYNC and interpolates over the SYNC period (CiA 402-2;
# CiA 301, 7.5.2.35). RPDOs that act on arrival pass the host's jitter to the motor; with set-points for every other
# SYNC the motor stops in between; feedback that an inhibit time delays is older than a period. 0x60C2 is checked and
# written by the plan (`master.plan`). An RPDO deadline (event timer) shorter than two cycles may expire when a cycle is
# late.


_RATE_HZ = 100  # default cycle rate if neither SYNC nor a readable ros2_controllers.yaml defines it
_ON_ARRIVAL: Final = (254, 255)
_FEEDBACK: Final = (
    objects.STATUSWORD,
    objects.POSITION_ACTUAL,
    objects.VELOCITY_ACTUAL,
    objects.TORQUE_ACTUAL,
)


def check_timing(
    config: BusConfig, control: ControllersFile | None, description: UrdfDescription | None
) -> Iterator[Finding]:
    """Find timing problems of the cyclic set-points, the feedback and the RPDO deadlines on a bus."""
    yield from _never_in_time(config, cycle_ns(config, control))
    yield from _rare(config)
    yield from _untimed(config)
    if not config.master.sync_period or description is None:
        return
    axes = cyclic_axes(config, description)
    yield from _in_the_middle(config, axes)
    yield from _repeated(config, control, axes)
    yield from _on_arrival(config, axes)
    yield from _held_back(config, axes)


def cycle_ns(config: BusConfig, control: ControllersFile | None) -> int:
    """Return the cycle period in ns: the SYNC period, or without SYNC the controllers' period."""
    rate = control.update_rate if control is not None else _RATE_HZ
    return config.master.sync_period * 1000 or 1_000_000_000 // rate


def _never_in_time(config: BusConfig, period_ns: int) -> Iterator[Finding]:
    """Find RPDO deadlines (event timer, 0x1400:05) shorter than two cycles."""
    settings = _FindingsByPlace(config, "rpdo.{}.event_deadline"), _FindingsByPlace(config, "rpdo.{}.event_timer")
    for name, plan in config.plans.items():
        node = config.nodes[name]
        for layout in plan.rpdos:
            if not 0 < layout.event_ms * 1_000_000 < 2 * period_ns:
                continue
            pdo = node.boot.rpdo.get(layout.number)
            text = (
                f"RPDO {layout.number} of {name}{{more}} has a deadline of {layout.event_ms} ms "
                f"(0x{0x1400 + layout.number - 1:04X}:05), but is sent with a cycle of {period_ns / 1e6:g} ms: "
                "a late cycle causes EMCY 0x8250"
            )
            fix = f"set event_deadline: {math.ceil(3 * period_ns / 1e6)} or more, or 0 for none"
            settings[pdo is not None and pdo.event_timer is not None].add(node, layout, text, fix)
    for setting in settings:
        yield from setting.findings()


def _in_the_middle(config: BusConfig, axes: list[CyclicAxis]) -> Iterator[Finding]:
    """Find a cycle that runs half a period after an external SYNC, so that a late cycle loses set-points."""
    master = config.master
    if axes and not master.follows_closely and master.sync_producer in ("kernel", "other"):
        text = (
            f"sync_order: last with sync_producer: {master.sync_producer}: the cycle is half a period after SYNC, "
            f"and a cycle that is {master.sync_period / 2000:g} ms late repeats a set-point of {joint_words(axes)} and "
            "loses another"
        )
        yield Finding(config.path, config.period_line, Severity.WARNING, text, "remove sync_order")


def _repeated(config: BusConfig, control: ControllersFile | None, axes: list[CyclicAxis]) -> Iterator[Finding]:
    """Find controllers that are slower than SYNC, so that each CSP set-point is sent several times."""
    place = None if control is None else control.manager_keys.get("update_rate")
    joints = [axis.joint for axis in axes if axis.mode is OperationMode.CSP]
    if control is None or place is None or not joints:
        return
    cycle = 1_000_000 / config.master.sync_period
    syncs = max(1, round(cycle / control.update_rate))
    if syncs > 1:
        text = (
            f"controllers run at {control.update_rate} Hz, but the SYNC rate of {config.path} is {cycle:g} Hz: each "
            f"position of {', '.join(joints)} is sent {syncs} times, and in CSP the drive stops in between"
        )
        yield Finding(place.path, place.line, Severity.WARNING, text, f"set update_rate: {cycle:g}")


def _on_arrival(config: BusConfig, axes: list[CyclicAxis]) -> Iterator[Finding]:
    """Find set-points that take effect on reception instead of at SYNC."""
    setting = _FindingsByPlace(config, "rpdo.{}.transmission")
    for axis in axes:
        for layout in config.plans[axis.node.name].rpdos:
            carries = any(mapped.index == axis.target for mapped in layout.objects)
            if carries and layout.transmission_type in _ON_ARRIVAL:
                text = (
                    f"RPDO {layout.number} of {axis.node.name}{{more}} carries 0x{axis.target:04X}, the set-point of "
                    f"{axis.joint} in {axis.mode.name}, with transmission {layout.transmission_type}: it takes effect "
                    "on reception, not with SYNC"
                )
                fix = f"set rpdo: {layout.number}: transmission: 1, otherwise the motor follows the computer's jitter"
                setting.add(axis.node, layout, text, fix)
    yield from setting.findings()


def _held_back(config: BusConfig, axes: list[CyclicAxis]) -> Iterator[Finding]:
    """Find event-driven feedback whose inhibit time exceeds the SYNC period."""
    setting, period_us = _FindingsByPlace(config, "tpdo.{}.inhibit_time"), config.master.sync_period
    for axis in axes:
        node = axis.node
        for layout in config.plans[node.name].tpdos:
            feedback = any(objects.axis_of(mapped.index)[0] in _FEEDBACK for mapped in layout.objects)
            if not feedback or layout.transmission_type not in _ON_ARRIVAL:
                continue
            override = node.boot.tpdo.get(layout.number)
            default = config.dictionaries[node.name].number(TPDO + layout.number - 1, 3) or 0
            inhibit = override.inhibit_time if override is not None and override.inhibit_time is not None else default
            if inhibit * 100 > period_us:
                text = (
                    f"TPDO {layout.number} of {node.name}{{more}} is sent every {inhibit / 10:g} ms at most (inhibit "
                    f"time), SYNC every {period_us / 1000:g} ms: feedback is older than a period"
                )
                setting.add(node, layout, text, f"set tpdo: {layout.number}: transmission: 1, or inhibit_time: 0")
    yield from setting.findings()


def _rare(config: BusConfig) -> Iterator[Finding]:
    """Find synchronous feedback that is sent so rarely that the motion checks and the stops are late."""
    setting, period_us = _FindingsByPlace(config, "tpdo.{}.transmission"), config.master.sync_period
    for name, node in config.nodes.items():
        plan = config.plans.get(name)
        for layout in plan.tpdos if plan is not None and plan.axes else ():
            every = layout.transmission_type * period_us
            # CiA 301, 7.5.2.37: transmission n is every n-th SYNC; 240 is often taken for "as often as possible"
            if 1 < layout.transmission_type <= 240 and every > _RARE_US:
                text = (
                    f"TPDO {layout.number} of {name}{{more}} is sent on one of {layout.transmission_type} SYNCs, every "
                    f"{every / 1e6:g} s: its values are old, and a lost drive is noticed late"
                )
                setting.add(node, layout, text, f"set tpdo: {layout.number}: transmission: 1")
    yield from setting.findings()


def _untimed(config: BusConfig) -> Iterator[Finding]:
    """Find event-driven feedback of drives without an event timer, whose loss cannot be noticed."""
    setting = _FindingsByPlace(config, "tpdo.{}.transmission")
    for name, node in config.nodes.items():
        plan = config.plans.get(name)
        for layout in plan.tpdos if plan is not None and plan.axes else ():
            feedback = [mapped for mapped in layout.objects if objects.axis_of(mapped.index)[0] in _FEEDBACK]
            # CiA 301, 7.5.2.37: without an event timer, nothing is sent while nothing changes
            if feedback and layout.transmission_type in _ON_ARRIVAL and not layout.event_ms:
                text = (
                    f"TPDO {layout.number} of {name}{{more}} is sent only when it changes: if it is lost, its last "
                    "values are taken for the present ones"
                )
                number = layout.number
                fix = f"set tpdo: {number}: event_timer: 100 (ms), or transmission: 1 with a sync_period"
                setting.add(node, layout, text, fix)
    yield from setting.findings()


_RARE_US: Final = 100_000
"""Period in us above which feedback is rare: that of the motion checks."""


class _FindingsByPlace:
    """Findings about one PDO key, merged by place: a key in `defaults` is reported once for all nodes."""

    def __init__(self, config: BusConfig, key: str) -> None:
        self._config, self._key = config, key
        self._by_place: dict[tuple[int, int], tuple[Node, str, str, set[str]]] = {}

    def add(self, node: NodeConfig, layout: PlannedPdo, text: str, fix: str) -> None:
        """Add a finding; `{more}` in the text is replaced by the number of other nodes."""
        place = self._config.place(node.name, self._key.format(layout.number))
        self._by_place.setdefault((place.line, place.column), (place, text, fix, set()))[3].add(node.name)

    def findings(self) -> Iterator[Finding]:
        for place, text, fix, names in self._by_place.values():
            more = f" and of {len(names) - 1} more" if len(names) > 1 else ""
            sentence = text.replace("{more}", more)
            yield Finding(place.path, place.line, Severity.WARNING, sentence, fix, column=place.column)
