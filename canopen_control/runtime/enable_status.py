"""Enable status of a robot's drives, in texts: which are enabled, which are not, and the command that is necessary.

A robot whose controllers claim disabled drives is not running but disabled; the status then names the necessary
command. Nodes have their names from bus.yml. At the end of a run, axes of nodes that were not booted are disabled.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Final

from canopen_control.cia402.objects import TARGET_POSITION, TARGET_VELOCITY
from canopen_control.cia402.state import POWERED_STATES
from canopen_control.controllers.base import EnableStatus
from canopen_control.errors import NotEnabled, NotYetEnabled
from canopen_control.hardware.interfaces import TARGET
from canopen_control.hardware.system import ENABLE_AFTER_LOSS, FAULT_RESET_IF_NEEDED

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping, Sequence

    from canopen_control.hardware.interfaces import CommandInterface
    from canopen_control.hardware.joint import JointDrive
    from canopen_control.master.remote_node import RemoteNode
    from canopen_control.runtime.robot_bus import RobotBus

    Interfaces = tuple[CommandInterface, ...]


_ALL: Final = "all"


def is_off(joint: JointDrive) -> bool:
    """Whether a drive does not follow commands: disabled, halted, being enabled or being stopped."""
    return not joint.machine.enabled or not joint.enable_requested or joint.machine.halted


def is_rising(joint: JointDrive) -> bool:
    """Whether a drive follows commands or soon will: enable is requested, its node is ready, and it is not halted."""
    return joint.enable_requested and joint.node.ready and not joint.machine.halted


def claimed_off(joints: Iterable[JointDrive]) -> list[JointDrive]:
    """Return the drives that an active controller claims but that do not follow commands.

    A drive without a target in an RPDO is only observed, and left out.
    """
    return [joint for joint in _claimed(joints) if is_off(joint) and not joint.lacks_target]


def _claimed(joints: Iterable[JointDrive]) -> list[JointDrive]:
    """Return the drives that active controllers claim.

    A drive claimed through its `target` interface is enabled only by users, and is left out if there are others.
    """
    claimed = [joint for joint in joints if joint.claimed is not None]
    return [joint for joint in claimed if joint.claimed != TARGET] or claimed


def enable_hint(joints: Sequence[JointDrive]) -> str | None:
    """Return why drives do not follow commands, with the remedy if there is one; None if `joints` is empty."""
    if not joints:
        return None
    if any(joint.lacks_target for joint in joints):
        return no_target([joint for joint in joints if joint.lacks_target])
    waiting = [joint for joint in joints if not is_rising(joint)]
    if not waiting:
        homing = [joint for joint in joints if joint.homing is not None]
        return f"{_names(homing)}: homing is under way" if homing else f"{_names(joints)}: being enabled"
    return f"{_names(waiting)} {_are(waiting)} {_condition(waiting)} and will not move: {_remedy(waiting)}"


def no_target(joints: Sequence[JointDrive]) -> str:
    """Return a sentence about drives that cannot be enabled because no RPDO has a target, with the remedy."""
    axis = joints[0].axis
    position, velocity = (axis.index(index) for index in (TARGET_POSITION, TARGET_VELOCITY))
    return (
        f"{_names(joints)} {_are(joints)} only observed and will not move, since no RPDO contains a target: "
        f"map 0x{position:04X} or 0x{velocity:04X} in bus.yml, then start the robot again"
    )


class DriveEnableStatus(EnableStatus):
    """Enable status of drives for controllers; `joints` maps joint names to drives."""

    def __init__(self, joints: Mapping[str, JointDrive]) -> None:
        self._joints = joints

    def error(self, waiting: Sequence[CommandInterface]) -> NotEnabled:
        joints = self._joints
        drives = [joints[name] for name in dict.fromkeys(interface.joint for interface in waiting) if name in joints]
        text = enable_hint(drives) or ", ".join(interface.name for interface in waiting)
        kind = NotYetEnabled if all(map(is_rising, drives)) else NotEnabled
        return kind(f"{text}; an earlier command is refused and not kept")

    def reason(self, waiting: Sequence[CommandInterface]) -> str:
        drives = {
            interface.joint: self._joints[interface.joint] for interface in waiting if interface.joint in self._joints
        }
        causes = {
            "lost": [
                name for name, drive in drives.items() if drive.state is None or drive.axis.statusword.pdo.overdue
            ],
            "in fault": [name for name, drive in drives.items() if drive.machine.fault],
            "halted": [name for name, drive in drives.items() if drive.machine.halted and drive.enable_requested],
            "not enabled": list(drives),
        }
        for cause, names in causes.items():
            if names:
                text = ", ".join(f"{name} ({drives[name].node.name})" for name in names)
                return f"{text}: {cause}; {_remedy(list(drives.values()))}"
        return super().reason(waiting)

    def idle(self, waiting: Sequence[CommandInterface]) -> dict[str, str]:
        names = [name for name in dict.fromkeys(interface.joint for interface in waiting) if name in self._joints]
        return {name: _why_idle(self._joints[name]) for name in names}

    def stop_groups(self, interfaces: Interfaces) -> list[Interfaces]:
        groups: dict[int | str, list[CommandInterface]] = {}
        for interface in interfaces:
            joint = self._joints.get(interface.joint)
            groups.setdefault(interface.joint if joint is None else id(joint.group), []).append(interface)
        return [tuple(part) for part in groups.values()]


def in_fault(nodes: Iterable[RemoteNode], joints: Iterable[JointDrive]) -> bool:
    """Whether a required node is not ready or has an overdue TPDO, or a drive is in fault."""
    for node in nodes:  # no generator expressions, for speed: called for each state sample
        if (not node.ready or node.stale) and node.config.required:
            return True
    for joint in joints:  # noqa: SIM110 - as above
        if joint.machine.fault:
            return True
    return False


def startup_complete(nodes: Iterable[RemoteNode], joints: Iterable[JointDrive]) -> bool:
    """Whether all claimed drives that are to be enabled are enabled, or a fault or an absent node prevents that."""
    drives = tuple(joints)
    claimed = _claimed(drives)
    # an absent optional node keeps its whole stop group disabled
    waits = any(not joint.node.ready and not joint.node.config.required for joint in claimed)
    return waits or in_fault(nodes, drives) or all(joint.enabled or not joint.enable_requested for joint in claimed)


def why_not_started(buses: Collection[RobotBus], missing: Iterable[tuple[RobotBus, RemoteNode]]) -> str:
    """Return why the robot could not start: no bus received a frame, or the errors of the `missing` nodes."""
    silent = [bus for bus in buses if bus.port is not None and bus.port.stats.rx == 0]
    if silent and len(silent) == len(buses):
        return "; ".join(_why_silent(bus) for bus in silent)
    return "; ".join(_why_missing(bus, node) for bus, node in missing)


def _why_silent(bus: RobotBus) -> str:
    master = bus.config.master
    return (
        f"no node answers on {bus.channel}: no frame was received from {', '.join(bus.config.nodes)} within "
        f"{master.boot_time / 1000:g} s; are the drives connected, powered and set to {master.baudrate} kbit/s?"
    )


def _why_missing(bus: RobotBus, node: RemoteNode) -> str:
    seconds = bus.config.master.boot_time / 1000
    reason = node.reason or f"not operational within {seconds:g} s; its boot stopped at step {node.boot_step!r}"
    return f"{node.label}: {reason}"


def disable_unready(nodes: Iterable[RemoteNode], now: int) -> tuple[set[RemoteNode], bool]:
    """Disable, at the end of a run, the axes of nodes that are not ready, and that an earlier master may have enabled.

    Return the nodes to which this call has sent something, and whether a node has not confirmed yet.
    """
    asked = {node for node in nodes if node.can_be_disabled and node.disabled is None}
    for node in asked:
        node.disable(now)
    return asked, any(node.is_disabling for node in nodes)


def stop_summary(joints: Iterable[JointDrive], nodes: Iterable[RemoteNode]) -> tuple[str, set[RemoteNode]]:
    """Return the power states of the drives at the end of a run as text, and the nodes that have or may have power.

    Nodes without a joint are included. A node that never booted and never answered has no power from this run. The text
    is "" without drives.
    """
    joints = list(joints)
    asked = [node for node in nodes if node.disabled is not None]
    states = [(joint.node, joint.state) for joint in joints if joint.node not in asked]
    unbooted = dict.fromkeys(node.name for node, _ in states if node.identity is None)
    states = [(node, state) for node, state in states if node.identity is not None]
    parts = [
        f"{node.name} still has power ({state.name.replace('_', ' ')}): cut its supply if it moves"
        for node, state in states
        if state in POWERED_STATES and state is not None
    ]
    uncertain = [node for node in asked if not node.disabled]
    uncertain += [node for node, state in states if state is None]
    parts += [
        f"{node.name} obeyed no stop command and may have power: cut its supply if it moves"
        for node in dict.fromkeys(uncertain)
        if node.disobeys
    ]
    unseen = dict.fromkeys(node.name for node in uncertain if not node.disobeys)
    if unseen:
        parts.append(f"could not confirm that {', '.join(unseen)} {'is' if len(unseen) == 1 else 'are'} disabled")
    doubtful = {*uncertain, *(node for node, state in states if state in POWERED_STATES)}
    if unbooted:
        parts.append(f"{', '.join(unbooted)} {'was' if len(unbooted) == 1 else 'were'} not booted")
    return "; ".join(parts) or ("its drives are disabled" if states or asked else ""), doubtful


def _names(joints: Iterable[JointDrive]) -> str:
    return ", ".join(dict.fromkeys(joint.node.name for joint in joints))


def _are(joints: Sequence[JointDrive]) -> str:
    return "is" if len({joint.node.name for joint in joints}) == 1 else "are"


def _condition(joints: Sequence[JointDrive]) -> str:
    return "halted" if all(joint.machine.halted and joint.enable_requested for joint in joints) else "not enabled"


def _why_idle(joint: JointDrive) -> str:
    """Return why one drive does not follow a command that others follow, with the remedy for this drive alone."""
    if is_rising(joint):
        return f"{_names([joint])}: being enabled"
    condition = "in fault" if joint.machine.fault else _condition([joint])
    return f"{_names([joint])} is {condition}: {_remedy([joint], joint.node.name)}"


def _remedy(joints: Sequence[JointDrive], of: str = _ALL) -> str:
    """Return what a user must do so that drives follow commands; `of` is the node to enable, or "all"."""
    enable, reset = (f"canopen-control axis {action} {of}" for action in ("enable", "fault-reset"))
    absent = list(dict.fromkeys(joint.node for joint in joints if not joint.node.ready))
    if any(node.is_taken_out for node in absent):
        return f"{return_hint(absent)}, then {ENABLE_AFTER_LOSS}"
    if absent:
        if all(joint.enable_requested for joint in joints):
            later = "they are enabled then"
        elif _ended(absent):  # a drive that starts again has no fault
            later = f"then {enable}"
        else:
            later = f"then {FAULT_RESET_IF_NEEDED}, then {enable}"
        return f"{return_hint(absent)}{'; ' if _ended(absent) else ', '}{later}"
    return f"{reset}, then {enable}" if any(joint.machine.fault for joint in joints) else enable


def return_hint(absent: Sequence[RemoteNode]) -> str:
    """Return the advice for absent nodes: restart them, remove the cause of the boot error, or wait."""
    if names := [node.name for node in absent if node.is_taken_out]:
        return f"start the stopped nodes: {', '.join(f'canopen-control nmt start {name}' for name in names)}"
    if ended := _ended(absent):
        commands = " and ".join(dict.fromkeys(node.restart_command for node in ended))
        return f"start {', '.join(node.name for node in ended)} again in another terminal: {commands}"
    if failed := [(node.name, letter[1]) for node in absent if (letter := _BOOT_ERROR.match(node.reason))]:
        letters = "".join(dict.fromkeys(letter for _, letter in failed))
        unbootable = ", ".join(name for name, _ in failed)
        return f"remove the cause of boot error {letters} of {unbootable}, which `canopen-control status` shows"
    return f"wait for {', '.join(node.name for node in absent)}"


# CiA 302-2, error status: another device type (C) or identity (D, M, N, O), or a refused configuration (J)
_BOOT_ERROR: Final = re.compile("boot error ([CDJMNO]):")


def _ended(absent: Sequence[RemoteNode]) -> list[RemoteNode]:
    return [node for node in absent if node.restart_command]


def cost_of_skipping(joints: Iterable[JointDrive]) -> str:
    """Return a text with the number of set-points that each moving axis has missed since it was enabled, or ""."""
    missed = [f"{joint.joint} {joint.tracking.skipped}" for joint in joints if joint.tracking.skipped]
    return f"; set-points that moving axes missed since they were enabled: {', '.join(missed)}" if missed else ""
