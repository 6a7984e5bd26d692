"""CanopenSystem: hardware component of the CANopen drives and devices of one <ros2_control> tag.

A drive is enabled when a controller claims a command interface of its joint, or when a user requests it; nothing else
enables a drive, except `recovery: enable` in bus.yml after a lost node has returned. After an error of one joint (node
lost, feedback stale, drive in fault or no longer enabled) every joint of its stop group stops along its ramp and is
disabled, in the same cycle, and remains disabled until a request enables it again.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from canopen_control.cia402.drive_goal import DriveGoal
from canopen_control.cia402.events import ENABLE_ADVICE
from canopen_control.cia402.objects import AXES
from canopen_control.errors import ControlError, DriveError, RobotConfigError, UnknownInterface, nearest
from canopen_control.hardware.axis import QUICK_STOP_WORD
from canopen_control.hardware.axis_parameters import leading_interface
from canopen_control.hardware.axis_statechart import STOPPED, StopGroup
from canopen_control.hardware.device_parts import DeviceParts, is_measured
from canopen_control.hardware.interfaces import DIGITAL_OUTPUTS, OK, TARGET, ComponentLifecycle, ReturnType
from canopen_control.hardware.joint import JointDrive
from canopen_control.hardware.joint_events import JointEvent
from canopen_control.master.event_log import Event, Level

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Mapping, Sequence

    from canopen_control.hardware.interfaces import CommandInterface, StateInterface
    from canopen_control.master.cycle import ProcessImage
    from canopen_control.master.remote_node import RemoteNode
    from canopen_control.urdf.ros2_control import ControlJoint, Ros2ControlSystem


# Recovery of a group that stopped because a node was lost, after the node has returned, if bus.yml requests it.
#
# Only joints are enabled that were enabled before the stop, only after the loss of a node with `recovery: enable`, and
# only when every joint of the group is ready: node operational, parameters read, no fault, at standstill. A request of
# a user in between (stop, disable or quick stop) cancels the recovery.


def with_partners(joints: Iterable[JointDrive]) -> list[JointDrive]:
    """Return the joints, each followed by the joints that share its controlword."""
    return list(dict.fromkeys(member for joint in joints for member in (joint, *joint.partners)))


def enable_together(joints: Sequence[JointDrive], now: int, report: Callable[[Event], None]) -> None:
    """Enable joints; if a joint cannot be enabled, report this and stop the rest of its group."""
    refused: list[JointDrive] = []
    for joint in joints:
        joint.resume = False
        try:
            joint.enable()
        except DriveError as error:
            refused.append(joint)
            report(Event(now, "not_enabled", joint.node.name, str(error), Level.ERROR))
    for cause in refused:
        members = [joint for joint in joints if joint.group is cause.group and joint.enable_requested]
        for joint in members:
            joint.stop(now)
        if members:
            names = ", ".join(joint.joint for joint in members)
            text = f"{names} stay disabled because {cause.joint} ({cause.node.name}) cannot be enabled"
            report(Event(now, "not_enabled", cause.node.name, text, Level.ERROR))


class Recovery:
    """Automatic enabling of joints that a node loss has stopped, once the node has returned."""

    def __init__(self, joints: Sequence[JointDrive], report: Callable[[Event], None]) -> None:
        self._joints, self._report = joints, report

    def step(self, now: int) -> None:
        """Enable the waiting joints of each group once all of them are ready; call a few times a second."""
        waiting = [joint for joint in self._joints if joint.resume]
        for joint in waiting:
            if joint.resume and all(_can_go(member) for member in joint.group.joints if member.resume):
                self._resume([member for member in joint.group.joints if member.resume], now)

    def _resume(self, joints: Sequence[JointDrive], now: int) -> None:
        names = ", ".join(joint.joint for joint in joints)
        text = f"enabling {names} again (recovery: enable in bus.yml)"
        self._report(Event(now, "recovered", joints[0].node.name, text, Level.WARNING))
        enable_together(joints, now, self._report)


def _can_go(joint: JointDrive) -> bool:
    return (
        joint.statechart.state in STOPPED
        and joint.node.ready
        and joint.parameters.loaded
        and joint.state is not None
        and not joint.machine.fault
        and joint.machine.reached
        and joint.at_standstill
    )


_SUPERVISE_NS: Final = 100_000_000
FAULT_RESET: Final = "canopen-control axis fault-reset all"
_ENABLE: Final = "canopen-control axis enable all"
FAULT_RESET_IF_NEEDED: Final = f"{FAULT_RESET} if a drive is in fault"
"""Advice about a node that is absent: by 0x6007 of CiA 402-2, an enabled drive that leaves OPERATIONAL, or that lost
its master, may return in a fault."""
ENABLE_AFTER_LOSS: Final = f"{FAULT_RESET_IF_NEEDED}, then {_ENABLE}"
_MASTER_LATE_TEXT: Final = (
    "this program stood still for longer than the drive waits for the master ({:g} s), so that the drive has stopped "
    "by itself; is the computer busy, or was it suspended?"
)

#: plugin names that select this component, including those of other stacks
PLUGINS: Final[tuple[str, ...]] = (
    "canopen_control/CanopenSystem",
    "canopen_ros2_control/CanopenSystem",
    "canopen_ros2_control/Cia402System",
    "canopen_ros2_control/RobotSystem",
    "canopen_ros2_control/Cia402RobotSystem",
)


class CanopenSystem(ComponentLifecycle):
    """Component of the CANopen drives and devices of one <ros2_control> tag.

    `groups` are the robot's stop groups by name, to which the joints are added; components that share a group stop
    together.
    """

    def __init__(
        self,
        description: Ros2ControlSystem,
        nodes: Mapping[str, tuple[RemoteNode, ProcessImage]],
        report: Callable[[Event], None],
        groups: dict[str, StopGroup[JointDrive]] | None = None,
    ) -> None:
        super().__init__()
        self.name = description.name
        measured = [joint for joint in description.joints if is_measured(joint, nodes)]
        driven = [joint for joint in description.joints if joint not in measured]
        self.joints = [_bind(joint, nodes) for joint in driven]
        groups = {} if groups is None else groups
        _group(driven, self.joints, groups)
        everything = [joint for group in groups.values() for joint in group.joints]
        _refuse_doubles(everything)
        _join_motors(everything)
        self.groups: list[StopGroup[JointDrive]] = []
        self.refresh_groups()
        self.devices = DeviceParts((*measured, *description.sensors, *description.gpios), nodes)
        self._by_interface = {interface.name: joint for joint in self.joints for interface in joint.commands.values()}
        self.state_interfaces: Sequence[StateInterface] = [
            *(interface for joint in self.joints for interface in joint.states.values()),
            *self.devices.states,
        ]
        self.command_interfaces: Sequence[CommandInterface] = [
            *(interface for joint in self.joints for interface in joint.commands.values()),
            *self.devices.commands,
        ]
        self._report = report
        self._recovery = Recovery(self.joints, report)
        self._now = 0
        self._supervise_at = 0

    def _begin(self) -> None:
        pass  # the master boots the nodes; drives stay disabled until they are claimed or enabled

    def _rest(self) -> None:
        self.stop(self._now)
        self.devices.release(self.devices.command_names)

    def prepare_command_mode_switch(self, start: Sequence[str], stop: Sequence[str]) -> None:
        """Raise ControlError or DriveError for an impossible switch.

        A joint is commanded by one motion interface, or by a position with feed-forward, and needs a suitable mode.
        """
        for joint, interfaces in self._moved(start).items():
            if joint.claimed is not None and f"{joint.joint}/{joint.claimed}" not in stop:
                raise ControlError(
                    f"joint {joint.joint} is commanded by {joint.claimed}; deactivate that controller first"
                )
            primary = leading_interface(joint.axis, joint.parameters, interfaces)
            if primary != TARGET:
                joint.targets.check_mode(joint.targets.mode_for(primary))

    def perform_command_mode_switch(self, start: Sequence[str], stop: Sequence[str]) -> None:
        """Stop released joints; set the modes of claimed joints and enable these joints.

        This method does not wait. A joint that is claimed by its TARGET keeps the mode that a user requested, and is
        enabled only by a user.
        """
        starting = self._moved(start)
        self.devices.release(stop)
        for joint in self._moved(stop):
            joint.targets.claim(None)
            if joint not in starting:
                for stopped in (joint, *joint.partners):
                    stopped.stop(self._now)
        for joint, interfaces in starting.items():
            primary = leading_interface(joint.axis, joint.parameters, interfaces)
            joint.targets.claim(primary, [interface for interface in interfaces if interface != primary])
        rising = with_partners(joint for joint in starting if joint.claimed != TARGET)
        self._choose_modes(joint for joint in rising if joint not in starting)
        enable_together(rising, self._now, self._report)  # errors are only reported, the switch has been accepted

    def read(self, now: int, period: float) -> ReturnType:  # noqa: ARG002 - the signature of every component
        self._now = now
        for joint in self.joints:
            joint.read(now)
        devices = self.devices
        if devices.present:
            devices.read(now)
            if devices.has_news:
                self._report_devices(now)
        return OK

    def write(self, now: int, period: float) -> ReturnType:
        """Run the state machine of every drive, then set the targets; stop groups in which an error occurred."""
        for group in self.groups:
            if group.busy:
                group.coordinate(now)
        for joint in self.joints:
            if joint.step(now):
                for event in joint.events():
                    self._report_event(joint, event, now)
        for joint in self.joints:
            joint.write(now, period)
        if self.devices.present:
            self.devices.write()
        return OK

    def supervise(self, now: int) -> None:
        """Run the slow checks every 100 ms; call after the frames of a cycle were sent."""
        if now < self._supervise_at:
            return
        self._supervise_at = now + _SUPERVISE_NS
        self._recovery.step(now)
        for joint in self.joints:
            joint.supervise()
        self.devices.poll(now)

    def prepare_enable(self, joints: Sequence[JointDrive]) -> None:
        """Set the modes of drives before they are enabled.

        Raise ControlError or DriveError if one cannot be enabled.
        """
        for joint in joints:
            if not joint.node.ready:
                raise ControlError(joint.node.absence)
        self._choose_modes(joints)
        for joint in joints:
            joint.check_enable()

    def _choose_modes(self, joints: Iterable[JointDrive]) -> None:
        """Request a mode for joints without one, and repeat mode requests that failed."""
        for joint in joints:
            motion = [name for name in joint.commands if name != DIGITAL_OUTPUTS]
            if joint.targets.mode is None and motion:
                joint.targets.set_mode(joint.targets.mode_for(motion[0]))
            elif joint.targets.mode is not None and joint.machine.mode_request.failed:
                joint.targets.set_mode(joint.targets.mode)  # the enable request repeats a failed mode

    def enable(self, joints: Sequence[JointDrive]) -> None:
        """Enable drives for a user, all or none; raise ControlError or DriveError if impossible."""
        self.prepare_enable(joints)
        for joint in joints:
            joint.enable()

    def refresh_groups(self) -> None:
        """Update `groups` after a change of the joints' stop groups."""
        self.groups = list(dict.fromkeys(joint.group for joint in self.joints))

    def stop(self, now: int) -> None:
        for joint in self.joints:
            joint.stop(now)

    def stop_without_master(self, nodes: Collection[RemoteNode], now: int) -> None:
        """Stop the axes of nodes that have missed the master for their timeout, and so have stopped by themselves."""
        joints = [joint for joint in self.joints if joint.node in nodes and joint.machine.goal is DriveGoal.ENABLED]
        for joint in joints:
            joint.machine.disable()  # CiA 402-2, table 22, transition 16: 0x0F would lead out of QUICK STOP ACTIVE
        for joint in joints:
            if joint.enable_requested:
                text = _MASTER_LATE_TEXT.format(joint.node.plan.master_timeout_ns / 1e9)
                self._report_event(joint, JointEvent("master_late", text, Level.ERROR, stops=True), now)
            else:
                joint.stop(now)

    def quick_stop_outputs(self) -> None:
        """Set quick stop in the controlwords that the next transmission sends, for a component whose cycle fails."""
        for joint in self.joints:
            joint.axis.controlword.set(QUICK_STOP_WORD)

    @property
    def stopped(self) -> bool:
        """Whether all observable joints have stopped and all changed outputs have been sent."""
        return all(not joint.node.ready or joint.stopped for joint in self.joints) and not self.devices.sending

    def _moved(self, interfaces: Sequence[str]) -> dict[JointDrive, list[str]]:
        """Return the joints of the motion interfaces among `interfaces`, with the interface names."""
        by_joint: dict[JointDrive, list[str]] = {}
        for name in interfaces:
            if name in self.devices.command_names:
                continue
            joint, interface = self._find(name)
            if interface != DIGITAL_OUTPUTS:
                by_joint.setdefault(joint, []).append(interface)
        return by_joint

    def count_skipped_edges(self, edges: int) -> None:
        """Count missed cycles as skipped set-points of the joints that follow commands."""
        for joint in self.joints:
            if joint.statechart.following:
                joint.tracking.skip(edges)

    def _find(self, interface: str) -> tuple[JointDrive, str]:
        if (joint := self._by_interface.get(interface)) is None:
            raise UnknownInterface(interface, (*self._by_interface, *self.devices.command_names))
        return joint, interface.rpartition("/")[2]

    def _report_event(self, joint: JointDrive, event: JointEvent, now: int) -> None:
        """Report an event of a joint, and stop the group if the event requires a stop."""
        cause = f"; {joint.node.error}" if event.stops and joint.node.error and joint.node.ready else ""
        text = f"{joint.axis.label}: {event.text}{cause}"
        self._report(Event(now, event.kind, joint.node.name, text, event.level, event.fault))
        if event.stops:
            self._stop_group(joint, now, event)

    def _report_devices(self, now: int) -> None:
        """Report lost devices and input jumps as warnings."""
        for node, kind, text in self.devices.take_news():
            self._report(Event(now, kind, node.name, f"{node.label}: {text}", Level.WARNING))

    def _stop_group(self, cause: JointDrive, now: int, event: JointEvent) -> None:
        resumable = event.kind == "node_lost" and cause.node.config.motion.recovery == "enable"
        resumable = resumable and not cause.node.is_taken_out  # until a user starts the node, and enables it
        waiting = [joint for joint in cause.group.joints if joint.resume]
        moving = cause.group.stop(now)
        if not cause.node.ready or not cause.machine.enabled:
            cause.give_up()
        reason = f"{cause.axis.label}: {event.text.removesuffix(ENABLE_ADVICE)}"
        for joint in moving:
            joint.stopped_by = f"stopped by {reason}"
        for joint in moving + waiting:
            joint.resume = resumable
        if moving:
            names = ", ".join(joint.joint for joint in moving)
            text = f"stopping {names}: {reason}"
            self._report(Event(now, "stop", cause.node.name, text + _then(cause, resumable=resumable), Level.ERROR))


def _then(cause: JointDrive, *, resumable: bool) -> str:
    """Return the advice after a stop: commands to enter, or that the joints are enabled automatically."""
    if cause.node.is_taken_out:
        return f"; to continue: canopen-control nmt start {cause.node.name}, then {ENABLE_AFTER_LOSS}"
    if resumable:
        return "; they are enabled again when the node has returned (recovery: enable)"
    if not cause.node.ready:
        return f"; to continue when {cause.node.config.name} has returned: {FAULT_RESET_IF_NEEDED}, then {_ENABLE}"
    first = f"{FAULT_RESET}, then " if cause.machine.fault else ""
    return f"; to continue: {first}{_ENABLE}"


def _group(
    parts: Sequence[ControlJoint], joints: Sequence[JointDrive], groups: dict[str, StopGroup[JointDrive]]
) -> None:
    """Assign each joint to its stop group; joints without `stop_group` are in one common group."""
    for joint, control in zip(joints, parts, strict=True):
        name = control.parameters.get("stop_group", "")
        group = groups.setdefault(name, StopGroup(name))
        group.joints.append(joint)
        joint.stop_group = joint.group = group


def _refuse_doubles(joints: Sequence[JointDrive]) -> None:
    """Raise RobotConfigError if two joints with commands use the same axis."""
    owners: dict[tuple[RemoteNode, int], JointDrive] = {}  # two buses may have the same node-ID
    for joint in joints:
        owner = owners.setdefault((joint.node, joint.axis.number), joint)
        if owner is not joint and owner.commands and joint.commands:
            raise RobotConfigError(
                f"joints {owner.joint} and {joint.joint} are both axis {joint.axis.number} of {joint.node.label}; give "
                'each its own axis by <param name="axis">'
            )


def _join_motors(joints: Sequence[JointDrive]) -> None:
    """Set the partners of joints that share a controlword; raise RobotConfigError for different stop groups."""
    for joint in (joint for joint in joints if joint.node.plan.motors is not None):
        joint.partners = tuple(other for other in joints if other is not joint and other.node is joint.node)
        if any(other.stop_group is not joint.stop_group for other in joint.partners):
            names = " and ".join((joint.joint, *(other.joint for other in joint.partners)))
            raise RobotConfigError(
                f"{names} share the controlword of {joint.node.label}, so that they stop together; give them one "
                "stop_group"
            )


def _bind(joint: ControlJoint, nodes: Mapping[str, tuple[RemoteNode, ProcessImage]]) -> JointDrive:
    """Bind a joint to its node (`device_name` or `node_id`); raise RobotConfigError for an unknown node."""
    name = joint.parameters.get("device_name")
    if (node_id := joint.parameters.get("node_id")) is not None:
        name = _named_by_id(joint.name, name, node_id.strip(), nodes)
    if name is None:
        names = ", ".join(nodes)
        raise RobotConfigError(f'joint {joint.name}: add <param name="device_name"> with a drive of bus.yml: {names}')
    if name not in nodes:
        raise RobotConfigError(
            f"joint {joint.name}: device_name {name!r} is not a node of bus.yml{nearest(name, nodes)}"
        )
    node, image = nodes[name]
    return JointDrive(joint, node, image, _axis_of(joint))


def _named_by_id(
    joint: str, name: str | None, node_id: str, nodes: Mapping[str, tuple[RemoteNode, ProcessImage]]
) -> str:
    """Return the name of the node with a node-ID; raise RobotConfigError for none, several, or another than `name`."""
    having = [key for key, (node, _) in nodes.items() if str(node.node_id) == node_id]
    if name is not None:
        # RobotSystem of ros2_canopen uses device_name, its Cia402System node_id
        if name in nodes and name not in having:
            raise RobotConfigError(
                f"joint {joint}: device_name {name} is node {nodes[name][0].node_id}, but node_id is {node_id}; remove "
                "the wrong one"
            )
        return name
    if not having:
        raise RobotConfigError(f"joint {joint}: no node of bus.yml has node_id {node_id}")
    if len(having) > 1:
        raise RobotConfigError(
            f"joint {joint}: node_id {node_id} is {' and '.join(having)}, on two buses; write device_name instead"
        )
    return having[0]


def _axis_of(joint: ControlJoint) -> int:
    """Return the axis number in the device (`axis` or `channel`); raise RobotConfigError if invalid."""
    text = joint.parameters.get("axis", joint.parameters.get("channel", "0")).strip()
    # CiA 402-2, 5.1: a device has at most eight axes
    if not text.isdigit() or int(text) >= AXES:
        raise RobotConfigError(f"joint {joint.name}: axis {text!r}; a device has the axes 0 to {AXES - 1}")
    return int(text)
