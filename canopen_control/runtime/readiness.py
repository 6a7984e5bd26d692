"""Which drives follow commands, and what to do about those that do not: one sentence for every face.

The law of this file: a robot whose controllers claim drives that are off is not running, it is disabled; whoever shows
that says what to call next. What is named is the node as users know it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from canopen_control.cia402.state import POWERED_STATES
from canopen_control.controllers.base import not_enabled
from canopen_control.errors import NotEnabled, NotYetEnabled
from canopen_control.hardware.interfaces import TARGET

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping, Sequence

    from canopen_control.hardware.interfaces import CommandInterface
    from canopen_control.hardware.joint import JointDrive
    from canopen_control.master.remote_node import RemoteNode
    from canopen_control.runtime.robot_bus import RobotBus

    Ends = tuple[CommandInterface, ...]

__all__ = ["by_stop_group", "cause", "claimed_off", "ending", "hint", "in_fault", "is_rising", "refusal", "settled",
           "way_back", "why_not_started"]  # fmt: skip

_ENABLE: Final = "canopen-control axis enable all"
_RESET: Final = "canopen-control axis fault-reset all"


def is_off(joint: JointDrive) -> bool:
    """Whether a drive is off, halted, or still on its way up."""
    return not joint.machine.enabled or not joint.wanted or joint.machine.halted


def is_rising(joint: JointDrive) -> bool:
    """Whether nothing but time keeps it from following commands: it is being enabled, or homed."""
    return joint.wanted and joint.node.ready and not joint.machine.halted


def claimed_off(joints: Iterable[JointDrive]) -> list[JointDrive]:
    """Return the drives that a running controller claims and that are off."""
    return [joint for joint in _claimed(joints) if is_off(joint)]


def _claimed(joints: Iterable[JointDrive]) -> list[JointDrive]:
    """Return the drives that running controllers claim.

    One that takes targets by itself is enabled by a user's word alone: beside others nobody waits for it.
    """
    claimed = [joint for joint in joints if joint.claimed is not None]
    return [joint for joint in claimed if joint.claimed != TARGET] or claimed


def hint(joints: Sequence[JointDrive]) -> str | None:
    """Say which of these drives follow no command, and what to call; None where there are none."""
    if not joints:
        return None
    waiting = [joint for joint in joints if not is_rising(joint)]
    if not waiting:
        homing = [joint for joint in joints if joint.homing is not None]
        return f"{_names(homing)}: homing is under way" if homing else f"{_names(joints)}: being enabled"
    return f"{_names(waiting)} {_are(waiting)} {_what(waiting)} and will not move: {_remedy(waiting)}"


def by_stop_group(joints: Mapping[str, JointDrive], ends: Sequence[CommandInterface]) -> list[Ends]:
    """Return interfaces in parts that stop together; what has no drive is a part by its name."""
    groups: dict[int | str, list[CommandInterface]] = {}
    for each in ends:
        joint = joints.get(each.joint)
        groups.setdefault(each.joint if joint is None else id(joint.group), []).append(each)
    return [tuple(part) for part in groups.values()]


def refusal(joints: Mapping[str, JointDrive], waiting: Sequence[CommandInterface]) -> NotEnabled:
    """Return what is raised for a command to joints that do not follow it."""
    drives = [joints[name] for name in dict.fromkeys(each.joint for each in waiting) if name in joints]
    text = hint(drives) or ", ".join(each.name for each in waiting)
    kind = NotYetEnabled if all(map(is_rising, drives)) else NotEnabled
    return kind(f"{text}; a command that comes before is refused and not kept")


def in_fault(nodes: Iterable[RemoteNode], joints: Iterable[JointDrive]) -> bool:
    """Whether a node that is required is missing, or a drive is in fault."""
    for node in nodes:  # loops and no generators: each sample of the state asks
        if (not node.ready or node.stale) and node.config.required:
            return True
    for joint in joints:  # noqa: SIM110 - as above
        if joint.machine.fault:
            return True
    return False


def settled(nodes: Iterable[RemoteNode], joints: Iterable[JointDrive]) -> bool:
    """Whether no drive is on its way to be enabled any more: it is, or it has a reason not to be."""
    drives = tuple(joints)
    claimed = _claimed(drives)
    # one that is not there and need not be, and with it all that move together
    waits = any(not joint.node.ready and not joint.node.config.required for joint in claimed)
    return waits or in_fault(nodes, drives) or all(joint.enabled or not joint.wanted for joint in claimed)


def why_not_started(buses: Collection[RobotBus], missing: Iterable[tuple[RobotBus, RemoteNode]]) -> str:
    """Say why the robot could not start: nobody is there at all, or these nodes are missing on their buses."""
    silent = [bus for bus in buses if bus.port is not None and bus.port.stats.rx == 0]
    if silent and len(silent) == len(buses):
        return "; ".join(_why_silent(bus) for bus in silent)
    return "; ".join(_why_missing(bus, node) for bus, node in missing)


def _why_silent(bus: RobotBus) -> str:
    master = bus.config.master
    return (
        f"nobody answers on {bus.channel}: not one frame came from {', '.join(bus.config.nodes)} within "
        f"{master.boot_time / 1000:g} s; are the drives there, powered, and set to {master.baudrate} kbit/s?"
    )


def _why_missing(bus: RobotBus, node: RemoteNode) -> str:
    if node.error and node.error.startswith(f"node {node.node_id}"):
        return node.error
    seconds = bus.config.master.boot_time / 1000
    reason = node.error or f"not operational within {seconds:g} s; its boot got as far as {node.boot_step!r}"
    return f"{node.who}: {reason}"


def cause(joints: Mapping[str, JointDrive], waiting: Sequence[CommandInterface]) -> str:
    """Say which joints follow no command, and what to call: the lost alone, else the faulty, the halted, all."""
    drives = {each.joint: joints[each.joint] for each in waiting if each.joint in joints}
    found = {
        "lost": [name for name, each in drives.items() if each.state is None or each.axis.statusword.pdo.overdue],
        "in fault": [name for name, each in drives.items() if each.machine.fault],
        "halted": [name for name, each in drives.items() if each.machine.halted and each.wanted],
        "not enabled": list(drives),
    }
    for what, names in found.items():
        if names:
            who = ", ".join(f"{name} ({drives[name].node.name})" for name in names)
            return f"{who}: {what}; {_remedy(list(drives.values()))}"
    return not_enabled(waiting)


def ending(joints: Iterable[JointDrive]) -> str:
    """Say what the drives are at the end of a run: disabled, still with power, or seen by nobody; "" without any."""
    seen = [(joint.node.name, joint.state) for joint in joints]
    parts = [
        f"{name} has power still ({state.name.replace('_', ' ')}): cut its supply if it moves"
        for name, state in seen
        if state in POWERED_STATES and state is not None
    ]
    unseen = dict.fromkeys(name for name, state in seen if state is None)
    if unseen:
        parts.append(f"could not confirm that {', '.join(unseen)} {'is' if len(unseen) == 1 else 'are'} disabled")
    return "; ".join(parts) or ("its drives are disabled" if seen else "")


def _names(joints: Iterable[JointDrive]) -> str:
    return ", ".join(dict.fromkeys(joint.node.name for joint in joints))


def _are(joints: Sequence[JointDrive]) -> str:
    return "is" if len({joint.node.name for joint in joints}) == 1 else "are"


def _what(joints: Sequence[JointDrive]) -> str:
    return "halted" if all(joint.machine.halted and joint.wanted for joint in joints) else "not enabled"


def _remedy(joints: Sequence[JointDrive]) -> str:
    absent = [joint for joint in joints if not joint.node.ready]
    if absent:
        later = f"then {_ENABLE}" if any(not joint.wanted for joint in joints) else "they are enabled then"
        return f"{way_back([joint.node for joint in absent])}, {later}"
    faulty = any(joint.machine.fault for joint in joints)
    return f"{_RESET}, then {_ENABLE}" if faulty else _ENABLE


def way_back(absent: Iterable[RemoteNode]) -> str:
    """Say what brings nodes back that are not ready: who took one out starts it, the others come by themselves."""
    nodes = list(dict.fromkeys(absent))
    taken = [node.name for node in nodes if node.is_taken_out]
    if taken:
        return f"give back what was taken out: {', '.join(f'canopen-control nmt start {name}' for name in taken)}"
    return f"wait for {', '.join(node.name for node in nodes)}"


def cost_of_skipping(joints: Iterable[JointDrive]) -> str:
    """Say how many set-points axes have missed that moved, since they were enabled; "" where none did."""
    missed = [f"{joint.joint} {joint.tracking.skipped}" for joint in joints if joint.tracking.skipped]
    return f"; set-points that moving axes did not get since they were enabled: {', '.join(missed)}" if missed else ""
