"""Nodes, joints and base of a new robot, chosen from EDS files and checked before a file is written.

Names of joints and controllers are valid in ROS: letters, digits and _. Each axis of a drive is a joint. A device other
than a drive has the signals of its profile: named inputs and outputs, or for an encoder a measured joint; a device with
an unknown profile is a proxy. A bus with only proxies has no description and no controllers.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Final

from canopen_control.cia402.modes import TARGET_OBJECTS
from canopen_control.cia402.objects import SUPPORTED_DRIVE_MODES, axis_index
from canopen_control.errors import RobotConfigError
from canopen_control.master.known_drives import known_drive
from canopen_control.master.plan_identity import SAVED
from canopen_control.od.model import BIT_RATES
from canopen_control.od.pdos import pdos_of
from canopen_control.profiles import Profile, profile_of, profile_signals
from canopen_control.scaffold.bases import BASES, BaseKind
from canopen_control.scaffold.drive_choice import POSITION, axes_of, choose_drive, supervision_of
from canopen_control.scaffold.pdo_choice import PdoRequirement, PdoUse, complete_pdos, not_carried

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from canopen_control.od.model import Address, ObjectDictionary
    from canopen_control.personality import Personality
    from canopen_control.profiles import Signal
    from canopen_control.scaffold.drive_choice import AxisChoice, DriveChoice, Supervision


_NAME: Final = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_LAST_SUBINDEX: Final = 254
_LONGEST: Final = 32  # characters of a robot's name, which is also in the name of a socket
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
"""Beginning of the name of a node that is not a drive, followed by the node-ID."""
FASTEST_MEASURED: Final = 30.0
"""Maximum speed in rad/s of a joint that an encoder measures; a guess that is written to the files."""
_MASTERS: Final = (1, *range(127, 1, -1))


@dataclass(frozen=True, slots=True)
class Device:
    """Planned device with node-ID and EDS; `remark` is the result of a scan, for a comment.

    `like` is the personality of the manufacturer, if named by the user.
    """

    node_id: int
    eds: Path
    od: ObjectDictionary
    remark: str = ""
    like: Personality | None = None

    def of_manufacturer(self, like: Personality) -> Device:
        """Return the device without objects and modes that the drives of `like` lack."""
        entries = {address: entry for address, entry in self.od.entries.items() if entry.index not in like.absent}
        objects = {index: info for index, info in self.od.objects.items() if index not in like.absent}
        modes = entries.get((SUPPORTED_DRIVE_MODES, 0))
        if modes is not None and isinstance(modes.default, int):
            listed = modes.default & sum(1 << mode - 1 for mode in like.modes)
            if listed:
                entries[modes.address] = replace(modes, default=listed)
        return replace(self, od=replace(self.od, entries=entries, objects=objects), like=like)


@dataclass(frozen=True, slots=True)
class NewJoint:
    """Joint moved by axis `axis` of `node`; `mirrored` is True for a motor that is mounted mirrored."""

    name: str
    node: str
    axis: AxisChoice
    mirrored: bool = False


@dataclass(frozen=True, slots=True)
class NewNode:
    """Node of the new bus.yml; a drive has `drive` and `joints`, another device may have `signals`.

    `unusable` is the reason why a drive cannot be moved; then `drive` is None, and the PDOs are unchanged.
    """

    name: str
    device: Device
    supervision: Supervision
    drive: DriveChoice | None = None
    joints: tuple[NewJoint, ...] = ()
    signals: tuple[Signal, ...] = ()
    profile: Profile = Profile.NONE
    unusable: str = ""
    rpdos: tuple[PdoUse, ...] = ()
    tpdos: tuple[PdoUse, ...] = ()
    left_out: tuple[Address, ...] = ()

    @property
    def measured(self) -> str:
        """Name of the joint measured by an encoder, or "" for other devices."""
        turns = any(signal.name == POSITION and signal.unit == "rad" for signal in self.signals)
        return f"{self.name}_joint" if self.profile is Profile.ENCODER and turns else ""

    @property
    def known(self) -> Personality | None:
        """Personality of the drive, named by the user or derived from the manufacturer, or None."""
        if self.device.like is not None:
            return self.device.like
        od, device = self.device.od, self.device.od.device

        def number(subindex: int, value: int | None) -> int:
            entry = od.get(0x1018, subindex)
            return entry.default if entry is not None and isinstance(entry.default, int) else value or 0

        vendor, product = number(1, device.vendor_number), number(2, device.product_number)
        return known_drive(vendor, product, f"{device.vendor_name} {device.product_name}")

    @property
    def outputs(self) -> tuple[Signal, ...]:
        """Signals that can be commanded."""
        return tuple(signal for signal in self.signals if signal.output)


@dataclass(frozen=True, slots=True)
class NewRobot:
    """Plan of a robot before the files are written; `sync_us` is the SYNC period in us, `baudrate` in kbit/s.

    `heartbeat_ms` is the period of all heartbeats, or of guarding. `eds_names` are the file names of the EDS copies,
    if set. `problems` are sentences about errors that prevent the robot from running.
    """

    name: str
    nodes: tuple[NewNode, ...]
    base: BaseKind
    master_id: int
    baudrate: int
    sync_us: int = 20_000
    heartbeat_ms: int = 100
    allow_unsupervised: bool = False
    eds_names: dict[Path, str] = field(default_factory=dict)
    problems: tuple[str, ...] = ()

    def eds_name(self, node: NewNode) -> str:
        """Return the file name of a node's EDS in the robot's folder."""
        return self.eds_names.get(node.device.eds, node.device.eds.name)

    @property
    def drives(self) -> tuple[NewNode, ...]:
        return tuple(node for node in self.nodes if node.drive is not None)

    @property
    def joints(self) -> tuple[NewJoint, ...]:
        """Driven joints, in the order of nodes and axes."""
        return tuple(joint for node in self.nodes for joint in node.joints)

    @property
    def is_bus_alone(self) -> bool:
        """Whether the robot has neither drives nor signals, and so no description and no controllers."""
        return not any(node.drive is not None or node.signals for node in self.nodes)


def plan_robot(
    name: str,
    devices: Sequence[Device],
    *,
    joints: Sequence[str] = (),
    base: str = "none",
    allow_unsupervised: bool = False,
    interfaces: Sequence[str] = (),
) -> NewRobot:
    """Choose the nodes, joints and PDOs of a robot; raise RobotConfigError with all errors, one per line.

    Problems of the devices are in the robot's `problems`. A drive that cannot be moved has no joint, and the robot then
    has no base. `interfaces` are the acceptable interfaces of every joint in order of preference, by default the
    interfaces for the base.
    """
    check_robot_name(name)
    axes = sum(len(axes_of(device.od)) for device in devices)
    problems = [*_wrong_ids(devices), *_wrong_joints(joints, axes, devices), *_wrong_base(base, axes)]
    if problems:
        raise RobotConfigError("\n".join(problems))
    names = [*joints, *BASES[base].joints(axes)[len(joints) :]]
    nodes, number, barring = list[NewNode](), 0, list[str]()
    for device in devices:
        count = len(axes_of(device.od))
        if not count:
            nodes.append(_device_node(device))
            continue
        needed = [interfaces or BASES[base].interfaces(axes, index) for index in range(number, number + count)]
        mirrored = [BASES[base].mirrored(axes, index) for index in range(number, number + count)]
        nodes.append(_drive_node(device, names[number : number + count], needed, mirrored))
        number += count
        if nodes[-1].unusable:
            barring.append(f"{device.eds}: {nodes[-1].unusable}")
        if not nodes[-1].supervision.stops_alone and not allow_unsupervised:
            barring.append(
                f"{device.eds}: nothing stops node {device.node_id} when this computer fails: no writable heartbeat "
                "consumer (0x1016), no node guarding; with an emergency stop within reach, add --allow-unsupervised"
            )
    base = "none" if any(node.unusable for node in nodes) else base
    ids = {device.node_id for device in devices}
    return NewRobot(
        name,
        tuple(nodes),
        BASES[base],
        next(master for master in _MASTERS if master not in ids),
        _baudrate(devices),
        allow_unsupervised=allow_unsupervised,
        problems=tuple(barring),
    )


def _device_node(device: Device) -> NewNode:
    """Return the new node of a device other than a drive."""
    profile = profile_of(device.od)
    signals = _present(device.od, tuple(profile_signals(device.od, profile).values()))
    name = f"{_KINDS[profile]}_{device.node_id}"
    sent = PdoRequirement(is_rpdo=True, needed=tuple(signal.address for signal in signals if signal.output))
    rpdos, tpdos = complete_pdos(device.od, sent), tuple[PdoUse, ...]()
    without = not_carried(device.od, sent, rpdos)
    signals = tuple(signal for signal in signals if not signal.output or signal.address not in without)
    if profile is Profile.IO:  # other inputs change slowly enough for SDO polling
        received = tuple(signal.address for signal in signals if not signal.output)
        tpdos = complete_pdos(device.od, PdoRequirement(is_rpdo=False, needed=received))
    supervision = supervision_of(device.od)
    return NewNode(
        name, device, supervision, signals=signals, profile=profile, rpdos=rpdos, tpdos=tpdos, left_out=without
    )


def _present(od: ObjectDictionary, signals: tuple[Signal, ...]) -> tuple[Signal, ...]:
    """Return the signals without those that a modular device probably lacks.

    The file of a bus coupler has all subindices 1 to 254 of an object, for any modules; its default PDOs have those
    that are present, and the boot would end with an error for others in a mapping.
    """
    indices = {signal.index for signal in signals}
    modular = {index for index in indices if od.subindices(index)[-1] == _LAST_SUBINDEX}
    mapped = {(item.index, item.subindex) for pdo in pdos_of(od) if pdo.enabled for item in pdo.mapped}
    kept = tuple(signal for signal in signals if signal.index not in modular or signal.address in mapped)
    return kept or signals


def _drive_node(
    device: Device, names: Sequence[str], interfaces: Sequence[Sequence[str]], mirrored: Sequence[bool]
) -> NewNode:
    """Return the new node of a drive with a joint for each axis, or without joints if the drive cannot be moved."""
    name = f"{names[0].removesuffix('_joint')}_drive" if len(names) == 1 else f"drive_{device.node_id}"
    try:
        drive = choose_drive(device.od, interfaces)
    except RobotConfigError as error:
        why = f"{error}; {_remedy(device.od)}, or leave node {device.node_id} out"
        return NewNode(name, device, supervision_of(device.od), profile=Profile.DRIVE, unusable=why)
    joints = tuple(
        NewJoint(joint, name, axis, mirror) for joint, axis, mirror in zip(names, drive.axes, mirrored, strict=True)
    )
    return NewNode(name, device, supervision_of(device.od), drive, joints, profile=Profile.DRIVE)


def _remedy(od: ObjectDictionary) -> str:
    """Return what to do with a drive without usable PDOs; some EDS files map no target (Faulhaber MCBL, MCDC)."""
    addresses = [(axis_index(index, axis), sub) for index, sub in TARGET_OBJECTS.values() for axis in axes_of(od)]
    if any((entry := od.get(*address)) is not None and entry.rpdo_mappable for address in addresses):
        return "map the objects in bus.yml by hand"
    return "the EDS allows no target in an RPDO: use the drive by SDO only"


def check_robot_name(name: str) -> None:
    """Raise RobotConfigError for a robot name that is not valid as a folder, a socket and a ROS name."""
    if not _NAME.fullmatch(name) or len(name) > _LONGEST:
        better = re.sub(r"\W+", "_", name.rstrip("/").rpartition("/")[2], flags=re.ASCII).strip("_")[:_LONGEST]
        better = better if _NAME.fullmatch(better) else "my_robot"
        raise RobotConfigError(
            f"{name!r} is not a valid robot name: use a letter followed by letters, digits or _, {_LONGEST} at most; "
            f"such as {better!r}"
        )


def _wrong_ids(devices: Sequence[Device]) -> list[str]:
    by_id, problems = dict[int, Device](), list[str]()
    for device in devices:
        if (first := by_id.setdefault(device.node_id, device)) is not device:
            problems.append(
                f"node-ID {device.node_id} is given twice ({first.eds.name}, {device.eds.name}); give each node-ID once"
            )
    if len(by_id) > _MASTERS[1] - 1:
        problems.append("all 127 node-IDs are used, but the master needs one; omit a node")
    return problems


def _wrong_joints(joints: Sequence[str], axes: int, devices: Sequence[Device]) -> list[str]:
    problems = [
        f"--joint {joint}: a joint name must be a letter followed by letters, digits and _"
        for joint in joints
        if not _NAME.fullmatch(joint)
    ]
    problems += [f"--joint {joint} is given twice" for joint in dict.fromkeys(joints) if joints.count(joint) > 1]
    if len(joints) > axes:
        drives = sum(bool(axes_of(device.od)) for device in devices)
        names = (
            f" ({len(devices) - drives} of the {len(devices)} nodes are not drives)" if len(devices) > drives else ""
        )
        drive_count = f"{drives} drive{'' if drives == 1 else 's'}" if axes == drives else f"{axes} axes"
        problems.append(f"{len(joints)} joints for {drive_count}{names}; give a node-ID for each, or fewer --joint")
    return problems


def _wrong_base(name: str, axes: int) -> list[str]:
    return [text] if (text := BASES[name].problem(axes)) else []


def _baudrate(devices: Sequence[Device]) -> int:
    """Return the bit rate in kbit/s of all DCFs, else the highest one common to all files that list any, else 1000."""
    saved = {(device.od.bitrate or 0) // 1000 for device in devices if device.eds.suffix.lower() in SAVED} - {0}
    if len(saved) == 1 and saved <= set(BIT_RATES):
        return saved.pop()
    bit_rates = [device.od.device.bit_rates for device in devices if device.od.device.bit_rates]
    common = frozenset.intersection(*bit_rates) if bit_rates else frozenset[int]()
    return max(common) // 1000 if common else 1000
