"""Choice of the SYNC producer of a bus: this program, the kernel, or a node (`sync_producer` in bus.yml).

A drive in a cyclic synchronous mode times its motion by SYNC, so that a SYNC that a busy process sends late causes a
jerk. `auto` lets the kernel (CAN_BCM) send SYNC under three conditions: a joint is commanded in CSP or CSV, the channel
is a SocketCAN interface, and every such drive is supervised by heartbeat or node guarding, since the kernel's SYNC
continues while the process hangs. With `sync_order: last`, SYNC follows the RPDOs of the cycle, so that the process
must send it. This module does no I/O: the availability of CAN_BCM is checked when the robot is assembled.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from canopen_control.bus.channel import ChannelKind, parse_channel
from canopen_control.cia402 import objects
from canopen_control.cia402.modes import OperationMode, supported_modes
from canopen_control.master.config import is_supervised
from canopen_control.urdf.joint_element import POSITION, VELOCITY

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from canopen_control.master.config import BusConfig
    from canopen_control.master.keys import NodeConfig
    from canopen_control.urdf.description import UrdfDescription
    from canopen_control.urdf.ros2_control import ControlJoint


# Joints that are commanded in a cyclic synchronous mode, CSP or CSV, whose drives time their motion by SYNC.
#
# The files alone determine these joints: `position_mode` or `velocity_mode` in bus.yml, else the modes that the EDS
# lists, of which a cyclic mode is preferred.


_CYCLIC: Final = {
    POSITION: (OperationMode.CSP, objects.TARGET_POSITION),
    VELOCITY: (OperationMode.CSV, objects.TARGET_VELOCITY),
}
_NAMED: Final = 3  # maximum number of joints named in a sentence


@dataclass(frozen=True, slots=True)
class CyclicAxis:
    """Joint in a cyclic synchronous mode; `target` is the index of the set-point object."""

    joint: str
    node: NodeConfig
    mode: OperationMode
    target: int


def cyclic_axes(config: BusConfig, description: UrdfDescription) -> list[CyclicAxis]:
    """Return the axes of a bus that are commanded in CSP or CSV, with one entry for each mode of a joint."""
    return [axis for tag in description.hardware for joint in tag.joints for axis in _axes(config, joint)]


def linear_axes(config: BusConfig, description: UrdfDescription) -> frozenset[tuple[str, int]]:
    """Return the node name and axis number of every prismatic joint moved by a drive on the bus."""
    return frozenset(
        (node.name, axis_number(joint))
        for tag in description.hardware
        for joint in tag.joints
        if (node := node_of(config, joint)) is not None
        and (model := description.joints.get(joint.name)) is not None
        and model.type == "prismatic"
    )


def joint_words(axes: Sequence[CyclicAxis]) -> str:
    """Return a text with up to three joint names and the number of further joints."""
    joints = list(dict.fromkeys(axis.joint for axis in axes))
    return ", ".join(joints[:_NAMED]) + (f" and {len(joints) - _NAMED} more" if len(joints) > _NAMED else "")


def _axes(config: BusConfig, joint: ControlJoint) -> Iterator[CyclicAxis]:
    node = node_of(config, joint)
    if node is None or node.name not in config.plans:
        return
    number = axis_number(joint)
    modes_object = objects.axis_index(objects.SUPPORTED_DRIVE_MODES, number)
    listed = supported_modes(config.dictionaries[node.name].number(modes_object) or 0)
    modes = {POSITION: node.motion.position_mode, VELOCITY: node.motion.velocity_mode}
    for interface, (mode, target) in _CYCLIC.items():
        chosen = modes[interface]
        if interface in joint.command_interfaces and (chosen == mode or (chosen is None and mode in listed)):
            yield CyclicAxis(joint.name, node, mode, objects.axis_index(target, number))


def axis_number(joint: ControlJoint) -> int:
    """Return the axis number of a joint in a multi-axis drive; 0 if not given or invalid."""
    text = joint.parameters.get("axis", joint.parameters.get("channel", "0")).strip()
    return int(text) if text.isdigit() and int(text) < objects.AXES else 0


def node_of(config: BusConfig, joint: ControlJoint) -> NodeConfig | None:
    """Return the node of this bus that moves a joint, by `device_name` or `node_id`; None if no node does."""
    name, node_id = joint.parameters.get("device_name"), joint.parameters.get("node_id", "").strip()
    if name is not None:
        return config.nodes.get(name)
    return next((node for node in config.nodes.values() if str(node.node_id) == node_id), None)


class SyncSender(enum.Enum):
    """Producer of SYNC on a bus."""

    NONE = "no device"
    PROGRAM = "this program"
    KERNEL = "the kernel"
    NODE = "a node of the bus"


@dataclass(frozen=True, slots=True)
class SyncChoice:
    """SYNC producer of a bus; `why` is the reason for the choice, `joints` are the joints timed by SYNC."""

    sender: SyncSender
    why: str = ""
    joints: str = ""

    @property
    def words(self) -> str:
        """Sentence with the SYNC producer and the reason."""
        if self.sender is SyncSender.NONE:
            return "no device sends SYNC"
        by = (
            "is sent by the kernel, and the cycle follows it"
            if self.sender is SyncSender.KERNEL
            else _SENDER_TEXTS[self.sender]
        )
        return f"SYNC {by}: {self.why}"

    @property
    def hint(self) -> str:
        """Sentence about jerks caused by a late SYNC of this process, with the remedy; "" if not applicable."""
        if self.sender is not SyncSender.PROGRAM or not self.joints:
            return ""
        return f"{self.words}; {self.joints} time their motion by it and jerk when it is late; {_REMEDY}"


_SENDER_TEXTS = {SyncSender.PROGRAM: "comes from this program", SyncSender.NODE: "comes from a node of the bus"}
_REMEDY = (
    "on a SocketCAN interface the kernel sends it evenly (sync_producer: auto or kernel), as does a node that produces "
    "it (sync_producer: other); otherwise use --realtime"
)


def choose_sync(
    config: BusConfig, channel: str, description: UrdfDescription, *, by_option: bool = False
) -> SyncChoice:
    """Choose the SYNC producer of a bus; `by_option` is True if the command line selects the kernel."""
    master = config.master
    if not master.sync_period:
        return SyncChoice(SyncSender.NONE)
    axes = cyclic_axes(config, description)
    joints, setting = joint_words(axes), f"sync_producer: {master.sync_producer}"
    if by_option:
        return SyncChoice(SyncSender.KERNEL, "--kernel-sync", joints)
    if master.sync_producer == "other":
        return SyncChoice(SyncSender.NODE, setting, joints)
    if master.sync_producer == "master":
        return SyncChoice(SyncSender.PROGRAM, setting, joints)
    why_not = _no_interface(channel)
    if master.sync_producer == "auto":
        why_not = _reason_against(config, axes) or why_not
        setting = f"{joints} time their motion by SYNC"
    return SyncChoice(SyncSender.PROGRAM if why_not else SyncSender.KERNEL, why_not or setting, joints)


def _no_interface(channel: str) -> str | None:
    if parse_channel(channel).kind is ChannelKind.SOCKETCAN:
        return None
    return f"the kernel can send it on SocketCAN interfaces alone, and {channel} is none"


def _reason_against(config: BusConfig, axes: Sequence[CyclicAxis]) -> str | None:
    """Return why `auto` does not let the kernel send SYNC, or None if it does."""
    if not axes:
        return "no joint is commanded in CSP or CSV"
    if config.master.sync_order == "last":
        return "sync_order: last"
    name = next((axis.node.name for axis in axes if not is_supervised(config, axis.node.name)), None)
    if name is not None:
        return f"the kernel would continue to send SYNC while this program hangs, and nothing would stop {name}"
    return None
