"""Who sends SYNC on a bus of a robot, and why: this program, the kernel, or a node of the bus (`sync_producer`).

A drive in a cyclic synchronous mode times its motion by SYNC, so that a SYNC which a busy process sends late is a jerk.
`auto` leaves it to the kernel (CAN_BCM) where all of this holds: a joint is commanded in CSP or CSV, the channel is a
SocketCAN interface, and every such drive is watched by heartbeat or guarding, since SYNC goes on while a process hangs.
Who wrote `sync_order: last` wants SYNC behind the RPDOs of the process's own cycle, and gets that. Sans-IO: whether the
kernel has a broadcast manager is looked at when the robot is built.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import TYPE_CHECKING

from canopen_control.bus.channel import ChannelKind, parse_channel
from canopen_control.master.config import is_supervised
from canopen_control.runtime.cyclic_axes import cyclic_axes, joint_words

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.master.config import BusConfig
    from canopen_control.runtime.cyclic_axes import CyclicAxis
    from canopen_control.urdf.description import UrdfDescription


class SyncSender(enum.Enum):
    """Who sends SYNC."""

    NOBODY = "nobody"
    PROGRAM = "this program"
    KERNEL = "the kernel"
    NODE = "a node of the bus"


@dataclass(frozen=True, slots=True)
class SyncChoice:
    """Who sends SYNC on one bus; `why` is the reason, `joints` those that time their motion by it, in words."""

    sender: SyncSender
    why: str = ""
    joints: str = ""

    @property
    def words(self) -> str:
        """Who sends it and why, in one sentence."""
        if self.sender is SyncSender.NOBODY:
            return "nobody sends SYNC"
        by = (
            "is sent by the kernel, and the cycle follows it"
            if self.sender is SyncSender.KERNEL
            else _COMES[self.sender]
        )
        return f"SYNC {by}: {self.why}"

    @property
    def hint(self) -> str:
        """What a late process does to the motion, and what helps; "" where it does nothing."""
        if self.sender is not SyncSender.PROGRAM or not self.joints:
            return ""
        return f"{self.words}; {self.joints} time their motion by it, and what is late is heard: {_REMEDY}"


_COMES = {SyncSender.PROGRAM: "comes from this program", SyncSender.NODE: "comes from a node of the bus"}
_REMEDY = (
    "the kernel sends it evenly on a SocketCAN interface (sync_producer: auto or kernel), a node that produces it does "
    "too (sync_producer: other); else run it with --realtime"
)


def choose_sync(
    config: BusConfig, channel: str, description: UrdfDescription, *, by_option: bool = False
) -> SyncChoice:
    """Choose who sends SYNC on a bus; `by_option`: the kernel was asked for on the command line."""
    master = config.master
    if not master.sync_period:
        return SyncChoice(SyncSender.NOBODY)
    axes = cyclic_axes(config, description)
    joints, given = joint_words(axes), f"sync_producer: {master.sync_producer}"
    if by_option:
        return SyncChoice(SyncSender.KERNEL, "--kernel-sync", joints)
    if master.sync_producer == "other":
        return SyncChoice(SyncSender.NODE, given, joints)
    if master.sync_producer == "master":
        return SyncChoice(SyncSender.PROGRAM, given, joints)
    why_not = _no_interface(channel)
    if master.sync_producer == "auto":
        why_not = _not_wanted(config, axes) or why_not
        given = f"{joints} time their motion by it"
    return SyncChoice(SyncSender.PROGRAM if why_not else SyncSender.KERNEL, why_not or given, joints)


def _no_interface(channel: str) -> str | None:
    if parse_channel(channel).kind is ChannelKind.SOCKETCAN:
        return None
    return f"the kernel can send it on SocketCAN interfaces alone, and {channel} is none"


def _not_wanted(config: BusConfig, axes: Sequence[CyclicAxis]) -> str | None:
    """Say why `auto` does not leave SYNC to the kernel, None where it would."""
    if not axes:
        return "no joint is commanded in CSP or CSV"
    if config.master.sync_order == "last":
        return "sync_order: last"
    name = next((axis.node.name for axis in axes if not is_supervised(config, axis.node.name)), None)
    if name is not None:
        return f"the kernel would send it on while this program hangs, and {name} is watched by no heartbeat"
    return None
