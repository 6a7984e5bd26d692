"""What a new robot is made of: its nodes, joints and base, chosen from EDS files and checked before a file is written.

Names of joints and controllers are names of ROS: letters, digits and _. A node that is no drive gets no joint; a bus
without any drive has no description and no controllers.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from canopen_control.errors import RobotConfigError
from canopen_control.profiles.device_type import Profile, profile_of
from canopen_control.scaffold.bases import BASES, Base
from canopen_control.scaffold.drive_choice import DriveChoice, choose_drive, is_drive, supervision_of

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from canopen_control.od.model import ObjectDictionary
    from canopen_control.scaffold.drive_choice import Supervision

__all__ = ["Device", "NewNode", "NewRobot", "check_robot_name", "plan_robot"]

_NAME: Final = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_LONGEST: Final = 32  # of a robot's name, which a socket has too
_KINDS: Final = {
    Profile.NONE: "device",
    Profile.IO: "io",
    Profile.MEASURING: "sensor",
    Profile.ENCODER: "encoder",
    Profile.INCLINOMETER: "inclinometer",
    Profile.BATTERY: "battery",
    Profile.CHARGER: "charger",
    Profile.ENERGY: "energy",
}
"""What a node is called that is no drive, before its node id."""
_MASTERS: Final = (1, *range(127, 1, -1))


@dataclass(frozen=True, slots=True)
class Device:
    """A node that is to be on the bus: its id, its EDS and what the file says; `remark` is what a scan told of it."""

    node_id: int
    eds: Path
    od: ObjectDictionary
    remark: str = ""


@dataclass(frozen=True, slots=True)
class NewNode:
    """A node of the new bus.yml; `drive` None for a device that is none, which has no `joint`.

    `mirrored`: its motor faces that of the other side, and turns the other way round.
    """

    name: str
    device: Device
    supervision: Supervision
    drive: DriveChoice | None = None
    joint: str = ""
    mirrored: bool = False


@dataclass(frozen=True, slots=True)
class NewRobot:
    """A robot that has no files yet; `sync_us` is the period of SYNC in us, `baudrate` in kbit/s.

    `eds_names` says what the copies of EDS files are called, where that is decided.
    """

    name: str
    nodes: tuple[NewNode, ...]
    base: Base
    master_id: int
    baudrate: int
    sync_us: int = 20_000
    allow_unsupervised: bool = False
    eds_names: dict[Path, str] = field(default_factory=dict)

    def eds_name(self, node: NewNode) -> str:
        """Return what the copy of a node's EDS is called."""
        return self.eds_names.get(node.device.eds, node.device.eds.name)

    @property
    def drives(self) -> tuple[NewNode, ...]:
        """The nodes that move a joint."""
        return tuple(node for node in self.nodes if node.drive is not None)


def plan_robot(
    name: str,
    devices: Sequence[Device],
    *,
    joints: Sequence[str] = (),
    base: str = "none",
    allow_unsupervised: bool = False,
) -> NewRobot:
    """Choose everything; RobotConfigError says all that is wrong, one sentence a line."""
    check_robot_name(name)
    drives = [device for device in devices if is_drive(device.od)]
    problems = [*_wrong_ids(devices), *_wrong_joints(joints, len(drives), len(devices)), *_wrong_base(base, drives)]
    if problems:
        raise RobotConfigError("\n".join(problems))
    names = [*joints, *BASES[base].joints(len(drives))[len(joints) :]]
    nodes, taken = list[NewNode](), list(names)
    for device in devices:
        supervision = supervision_of(device.od)
        if not is_drive(device.od):
            nodes.append(NewNode(f"{_KINDS[profile_of(device.od)]}_{device.node_id}", device, supervision))
            continue
        wanted = BASES[base].interfaces(len(drives), len(names) - len(taken))
        try:
            drive = choose_drive(device.od, wanted)
        except RobotConfigError as error:
            problems.append(f"{device.eds}: {error}; write its bus.yml by hand, or leave node {device.node_id} out")
            continue
        mirrored = BASES[base].mirrored(len(drives), len(names) - len(taken))
        joint = taken.pop(0)
        nodes.append(NewNode(f"{joint.removesuffix('_joint')}_drive", device, supervision, drive, joint, mirrored))
        if not supervision.stops_alone and not allow_unsupervised:
            problems.append(
                f"{device.eds}: nothing stops node {device.node_id} when this computer dies: no heartbeat consumer "
                "(0x1016) that can be set, no node guarding; with an emergency stop in reach, add --allow-unsupervised"
            )
    if problems:
        raise RobotConfigError("\n".join(problems))
    ids = {device.node_id for device in devices}
    return NewRobot(
        name,
        tuple(nodes),
        BASES[base],
        next(each for each in _MASTERS if each not in ids),
        _baudrate(devices),
        allow_unsupervised=allow_unsupervised,
    )


def check_robot_name(name: str) -> None:
    """Refuse a name that no folder, socket and ROS name could have alike; RobotConfigError."""
    if not _NAME.fullmatch(name) or len(name) > _LONGEST:
        better = re.sub(r"\W+", "_", name.rstrip("/").rpartition("/")[2], flags=re.ASCII).strip("_")[:_LONGEST]
        better = better if _NAME.fullmatch(better) else "my_robot"
        raise RobotConfigError(
            f"{name!r} is no name for a robot: a letter, then letters, digits and _, {_LONGEST} at most, no path; "
            f"call it {better!r} (its folder is made where you are)"
        )


def _wrong_ids(devices: Sequence[Device]) -> list[str]:
    seen, problems = dict[int, Device](), list[str]()
    for device in devices:
        if (first := seen.setdefault(device.node_id, device)) is not device:
            problems.append(f"node id {device.node_id} is given twice ({first.eds.name}, {device.eds.name}); each once")
    if len(seen) > _MASTERS[1] - 1:
        problems.append("all 127 node ids are taken, and the master needs one")
    return problems


def _wrong_joints(joints: Sequence[str], drives: int, devices: int) -> list[str]:
    problems = [
        f"--joint {joint}: a joint's name is a letter, then letters, digits and _"
        for joint in joints
        if not _NAME.fullmatch(joint)
    ]
    problems += [f"--joint {joint} is given twice" for joint in dict.fromkeys(joints) if joints.count(joint) > 1]
    if len(joints) > drives:
        others = f" ({devices - drives} of the {devices} nodes are no drives)" if devices > drives else ""
        few = f"{drives} drive{'' if drives == 1 else 's'}"
        problems.append(f"{len(joints)} joints for {few}{others}; give a node id for each, or fewer --joint")
    return problems


def _wrong_base(name: str, drives: Sequence[Device]) -> list[str]:
    return [text] if (text := BASES[name].problem(len(drives))) else []


def _baudrate(devices: Sequence[Device]) -> int:
    """Return the highest bit rate that all devices have, in kbit/s; 1000 where the files tell none."""
    told = [device.od.device.bit_rates for device in devices if device.od.device.bit_rates]
    common = frozenset.intersection(*told) if told else frozenset[int]()
    return max(common) // 1000 if common else 1000
