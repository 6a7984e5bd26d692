"""CanopenSystem: the hardware component that stands for the CANopen drives of one <ros2_control> tag.

The law of this file: a drive is enabled when a controller claims one of its joint's command interfaces, and by a
user's word; nothing else enables it. When one joint of the system gets into trouble (its node lost, its drive faulted
or left on its own) every joint of the system stops along its ramp and is disabled, and stays so until somebody
enables it again.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.cia402.events import (
    EnableLost,
    FaultCleared,
    FaultEntered,
    ModeConfirmed,
    StateChanged,
    TransitionTimedOut,
)
from canopen_control.errors import ControlError, DriveError, RobotConfigError, UnknownInterface, UnsupportedMode
from canopen_control.hardware.interfaces import LifecycleState, ReturnType
from canopen_control.hardware.joint import JointDrive, Wish
from canopen_control.master.events import Event, Level
from canopen_control.yamltree import nearest

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from canopen_control.cia402.events import DriveEvent
    from canopen_control.hardware.description import ControlJoint, Ros2ControlSystem
    from canopen_control.hardware.interfaces import CommandInterface, StateInterface
    from canopen_control.master.cycle import ProcessImage
    from canopen_control.master.node import RemoteNode

__all__ = ["PLUGINS", "CanopenSystem"]

#: the hardware plugins of other stacks that this component stands in for
PLUGINS = (
    "canopen_control/CanopenSystem",
    "canopen_ros2_control/CanopenSystem",
    "canopen_ros2_control/Cia402System",
    "canopen_ros2_control/RobotSystem",
)


class CanopenSystem:
    """The joints of one <ros2_control> tag and their drives; `trouble` is told of what must stop the robot."""

    def __init__(
        self,
        description: Ros2ControlSystem,
        nodes: Mapping[str, tuple[RemoteNode, ProcessImage]],
        report: Callable[[Event], None],
    ) -> None:
        self.name = description.name
        self.state = LifecycleState.UNCONFIGURED
        self.joints = [_bind(joint, nodes) for joint in description.joints]
        self._by_interface = {interface.name: joint for joint in self.joints for interface in joint.commands.values()}
        self.state_interfaces: Sequence[StateInterface] = [
            interface for joint in self.joints for interface in joint.states.values()
        ]
        self.command_interfaces: Sequence[CommandInterface] = [
            interface for joint in self.joints for interface in joint.commands.values()
        ]
        self._report = report
        self._now = 0
        self._ready = dict.fromkeys((joint.joint for joint in self.joints), False)

    def configure(self) -> None:
        """Nothing to do: the master boots the nodes."""
        self.state = LifecycleState.INACTIVE

    def activate(self) -> None:
        """Let commands through; the drives stay disabled until a controller claims them."""
        self.state = LifecycleState.ACTIVE

    def deactivate(self) -> None:
        """Keep reading, command nothing."""
        self.state = LifecycleState.INACTIVE

    def cleanup(self) -> None:
        """Forget the activation."""
        self.state = LifecycleState.UNCONFIGURED

    def shutdown(self) -> None:
        """End for good."""
        self.state = LifecycleState.FINALIZED

    def prepare_command_mode_switch(self, start: Sequence[str], stop: Sequence[str]) -> None:
        """Check the switch: one interface per joint, a mode that its drive has."""
        wanted: dict[str, str] = {}
        for name in start:
            joint = self._joint_of(name)
            if wanted.setdefault(joint.joint, name) != name:
                raise ControlError(
                    f"joint {joint.joint}: {wanted[joint.joint]} and {name} cannot be commanded together"
                )
            if joint.claimed is not None and f"{joint.joint}/{joint.claimed}" not in stop:
                raise ControlError(
                    f"joint {joint.joint} is commanded by {joint.claimed}; deactivate that controller first"
                )
            try:
                joint.mode_for(name.rpartition("/")[2])
            except UnsupportedMode as error:
                raise DriveError(f"{_who(joint)}: {error}") from error

    def perform_command_mode_switch(self, start: Sequence[str], stop: Sequence[str]) -> None:
        """Stop what is released, set the mode of what is claimed and enable it; nothing here waits."""
        starting = [(self._joint_of(name), name.rpartition("/")[2]) for name in start]
        staying = {joint.joint for joint, _ in starting}
        for name in stop:
            joint = self._joint_of(name)
            joint.claim(None)
            if joint.joint not in staying:
                joint.stop(self._now)
        for joint, interface in starting:
            joint.claim(interface)
            try:
                joint.enable()
            except DriveError as error:  # the switch is decided: the drive stays off and says why
                self._report(Event(self._now, "not_enabled", joint.node.name, str(error), Level.ERROR))

    def read(self, now: int, period: float) -> ReturnType:  # noqa: ARG002 - the verb of every component
        """Latch the newest process data."""
        self._now = now
        for joint in self.joints:
            joint.read()
        return ReturnType.OK

    def write(self, now: int, period: float) -> ReturnType:  # noqa: ARG002 - the verb of every component
        """Advance every drive's state machine and set its targets; trouble at one joint stops all."""
        for joint in self.joints:
            self._check_node(joint, now)
            joint.write(now)
            self._tell(joint, now)
        return ReturnType.OK

    def enable(self, joints: Sequence[JointDrive]) -> None:
        """Enable drives for a user; refused with the reason where it cannot be."""
        for joint in joints:
            if not joint.node.ready:
                raise ControlError(f"{_who(joint)} is not operational: {joint.node.error or 'it has not booted yet'}")
        for joint in joints:
            if joint.mode is None and joint.commands:
                joint.mode = joint.mode_for(next(iter(joint.commands)))
                joint.machine.set_mode(joint.mode)
            joint.enable()

    def stop(self, now: int) -> None:
        """Ramp every joint to zero and disable it."""
        for joint in self.joints:
            joint.stop(now)

    @property
    def stopped(self) -> bool:
        """Whether no joint moves under power any more."""
        return all(not joint.node.ready or (joint.wish is Wish.OFF and joint.machine.reached) for joint in self.joints)

    def _joint_of(self, interface: str) -> JointDrive:
        if (joint := self._by_interface.get(interface)) is None:
            raise UnknownInterface(interface, tuple(self._by_interface))
        return joint

    def _check_node(self, joint: JointDrive, now: int) -> None:
        """See a node come and go."""
        ready = joint.node.ready
        if ready == self._ready[joint.joint]:
            return
        self._ready[joint.joint] = ready
        if ready:
            joint.restarted()
        else:
            self._stop_all(joint, now, f"{_who(joint)} is not operational")

    def _tell(self, joint: JointDrive, now: int) -> None:
        """Turn what the state machine saw into events, and trouble into a stop."""
        for event in joint.machine.events():
            text = f"{_who(joint)}: {event.text}"
            if _stops(event):
                cause = f"; {joint.node.error}" if joint.node.error else ""
                self._stop_all(joint, now, text + cause)
            else:
                level = Level.INFO if isinstance(event, _HARMLESS) else Level.WARNING
                self._report(Event(now, _KINDS.get(type(event), "drive"), joint.node.name, text, level))

    def _stop_all(self, cause: JointDrive, now: int, text: str) -> None:
        moving = [joint.joint for joint in self.joints if joint.wish is Wish.ON and joint is not cause]
        cause.give_up()
        for joint in self.joints:
            joint.stop(now)
        also = f"; stopping {', '.join(moving)}" if moving else ""
        self._report(Event(now, "stop", cause.node.name, text + also, Level.ERROR))


_HARMLESS = (StateChanged, ModeConfirmed, FaultCleared)
_KINDS: dict[type, str] = {StateChanged: "state", ModeConfirmed: "mode", FaultCleared: "fault_cleared"}


def _stops(event: DriveEvent) -> bool:
    """Whether the robot must stop: a drive that does not do, or no longer does, what it was told."""
    if isinstance(event, TransitionTimedOut):
        return event.gave_up
    return isinstance(event, FaultEntered | EnableLost)


def _who(joint: JointDrive) -> str:
    return f"node {joint.node.node_id} ({joint.node.name})"


def _bind(joint: ControlJoint, nodes: Mapping[str, tuple[RemoteNode, ProcessImage]]) -> JointDrive:
    """Find the node of a joint by `device_name`, or by `node_id`."""
    name = joint.parameters.get("device_name")
    if name is None and (node_id := joint.parameters.get("node_id")) is not None:
        by_id = {str(node.node_id): key for key, (node, _) in nodes.items()}
        name = by_id.get(node_id.strip())
        if name is None:
            raise RobotConfigError(f"joint {joint.name}: no node of bus.yml has node_id {node_id}")
    if name is None:
        known = ", ".join(nodes)
        raise RobotConfigError(f'joint {joint.name}: it needs <param name="device_name">, a drive of bus.yml: {known}')
    if name not in nodes:
        raise RobotConfigError(f"joint {joint.name}: device_name {name!r} is no node of bus.yml{nearest(name, nodes)}")
    node, image = nodes[name]
    return JointDrive(joint.name, node, image, tuple(joint.command_interfaces))
