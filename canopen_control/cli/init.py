"""Create the folder of a robot from the EDS files of its devices, or from the devices found on a bus.

It writes bus.yml, a URDF with <ros2_control> and ros2_controllers.yaml, with comments, and copies the EDS. `check`
accepts it, and `demo NAME` moves it at once on virtual drives. Values missing from the EDS (counts per revolution, gear
ratio, dimensions) are filled with guesses and marked as such (`guesses` in bus.yml, which `check` lists). Problems that
prevent a run, such as a drive that would not stop when the master is lost, are marked in bus.yml as PROBLEM and
printed. Before you use real drives, run `preflight`.

Exit codes: 0 success, the files are written; 1 the disk is full, nothing is written; 2 wrong usage, not an EDS, or no
robot can be built from it.
"""

from __future__ import annotations

import contextlib
import shlex
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from canopen_control.bus.channel import may_host_virtual_drives
from canopen_control.cli.support.arguments import Names, timeout_seconds
from canopen_control.cli.support.output import print_result
from canopen_control.cli.support.target import LABEL, find_eds
from canopen_control.data_files import data_names
from canopen_control.errors import CanopenError, ConfigError
from canopen_control.od.eds import read_eds
from canopen_control.scaffold.bases import BASES

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterable, Sequence

    from canopen_control.cli.scan import FoundNode
    from canopen_control.scaffold.new_robot import Device, NewNode
    from canopen_control.scaffold.robot_folder import Written


EXAMPLE = """canopen-control init my_robot --eds generic_cia402.eds --node-id 2,3 --base diff
         canopen-control init turntable --eds TMCM-1270.eds --node-id 5 --joint table_joint
         canopen-control init found --can can0 --eds my_drive.eds"""

_NODE_IDS = range(1, 128)
# supported modes, scale factors and units, which a drive may know better than its EDS
_READ_OBJECTS = ((0x6502, 0), *((index, sub) for index in (0x608F, 0x6091, 0x6092) for sub in (1, 2)), (0x60A9, 0))


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("robot", metavar="NAME", help="name of the robot and of its folder, or the path of the folder")
    parser.add_argument(
        "--eds",
        metavar="FILE",
        action="append",
        default=[],
        help="EDS of the device, a path or the name of a bundled file (repeatable; each --eds applies to the --node-id "
        "that follows it)",
    )
    parser.add_argument(
        "--node-id", metavar="N[,N..]", action="append", default=[], help="node-IDs of the devices with that EDS"
    )
    parser.add_argument(
        "--can",
        metavar="CHANNEL",
        help="instead of --eds and --node-id: use the devices on this channel, each with the matching EDS",
    )
    parser.add_argument(
        "--like",
        metavar="NAME|FILE",
        help="manufacturer of the drives, whose keys are written to bus.yml (default: recognised by the EDS, and "
        "written as comments)",
    )
    parser.add_argument(
        "--joint",
        metavar="NAME[,NAME..]",
        action=Names,
        help="names of the joints, one for each axis in order (repeatable)",
    )
    parser.add_argument(
        "--base", choices=list(BASES), default="none", help="base that the drives move together (default: none)"
    )
    parser.add_argument(
        "--allow-unsupervised",
        action="store_true",
        help="accept drives that would not stop, and outputs that would stay on, when this computer fails",
    )
    parser.add_argument("--force", action="store_true", help="overwrite the files of an existing folder")
    parser.add_argument(
        "--timeout",
        type=timeout_seconds,
        default=0.2,
        metavar="S",
        help="with --can: timeout of each answer in s (default: 0.2)",
    )


def run(args: argparse.Namespace) -> int:
    """Run the verb."""
    from canopen_control.personality import read_personality
    from canopen_control.scaffold.drive_choice import is_drive
    from canopen_control.scaffold.new_robot import check_robot_name, plan_robot
    from canopen_control.scaffold.robot_folder import refuse_existing, write_robot

    folder = Path(args.robot).expanduser()
    if folder.name in ("", ".."):  # such as the current folder
        folder = folder.resolve()
    check_robot_name(folder.name)
    refuse_existing(folder, force=args.force)
    like = None if args.like is None else read_personality(args.like)
    devices = _from_files(args) if args.can is None else _from_bus(args)
    if like is not None:
        if not any(is_drive(device.od) for device in devices):
            raise ConfigError(f"--like {args.like} is for drives, and none of the devices is one; omit it")
        devices = [device.of_manufacturer(like) if is_drive(device.od) else device for device in devices]
    robot = plan_robot(
        folder.name, devices, joints=args.joint, base=args.base, allow_unsupervised=args.allow_unsupervised
    )
    written = write_robot(robot, folder.parent, force=args.force)
    print_result(args, _report(written), "\n".join(_lines(written, args.can or "can0")))
    return 0


@dataclass(frozen=True, slots=True)
class CreatedNode:
    """Node of a new robot, in the result of `init --json`."""

    node_id: int
    name: str


@dataclass(frozen=True, slots=True)
class InitReport:
    """Result of `init --json`; `guessed` names the nodes whose EDS does not contain the scale of their axes."""

    robot: str
    folder: str
    files: list[str]
    nodes: list[CreatedNode]
    joints: list[str]
    guessed: list[str]
    warnings: list[str]
    problems: list[str]


def _report(written: Written) -> InitReport:
    robot = written.robot
    return InitReport(
        robot=robot.name,
        folder=str(written.folder),
        files=list(written.files),
        nodes=[CreatedNode(node.device.node_id, node.name) for node in robot.nodes],
        joints=[joint.name for joint in robot.joints],
        guessed=list(dict.fromkeys(joint.node for joint in robot.joints if not joint.axis.is_known)),
        warnings=list(written.warnings),
        problems=list(written.problems),
    )


def _from_files(args: argparse.Namespace) -> list[Device]:
    """Return the devices described by --eds and --node-id; raise ConfigError if the options do not match."""
    if not args.eds or not args.node_id:
        missing = "--eds FILE" if not args.eds else "--node-id N"
        bundled = ", ".join(name for name in data_names("eds") if name.lower().endswith(".eds"))
        raise ConfigError(
            f"{missing} is missing; give both, or --can CHANNEL for the devices on it (bundled EDS: {bundled})"
        )
    if len(args.eds) not in (1, len(args.node_id)):
        raise ConfigError(
            f"{len(args.eds)} --eds and {len(args.node_id)} --node-id: give each EDS the node-IDs of its devices, "
            "as in --eds A.eds --node-id 2,3 --eds B.eds --node-id 4"
        )
    files = args.eds * len(args.node_id) if len(args.eds) == 1 else args.eds
    pairs = [(file, _ids(text)) for file, text in zip(files, args.node_id, strict=True)]
    return [_device(find_eds(file), node_id) for file, ids in pairs for node_id in ids]


def _ids(text: str) -> list[int]:
    """Return the node-IDs in a text such as `3` or `2,3`; raise ConfigError if one is not from 1 to 127."""
    ids = []
    for word in text.split(","):
        try:
            node_id = int(word, 0)
        except ValueError:
            node_id = 0
        if node_id not in _NODE_IDS:
            raise ConfigError(f"--node-id {text}: {word.strip()!r} is not a node-ID; they are 1 to 127, such as 2,3")
        ids.append(node_id)
    return ids


def _device(path: Path, node_id: int, remark: str = "") -> Device:
    from canopen_control.scaffold.new_robot import Device

    return Device(node_id, path.resolve(), read_eds(path, node_id).od, remark)


def _from_bus(args: argparse.Namespace) -> list[Device]:
    """Return the devices found on a bus for which an EDS is given or bundled; print the other devices."""
    from canopen_control.cli.scan import match_files, survey_channel

    if args.node_id:
        raise ConfigError("--can finds the node-IDs itself; omit --node-id")
    files = [find_eds(name) for name in args.eds]
    bundled = [find_eds(name) for name in data_names("eds") if name.lower().endswith(".eds")]
    survey = survey_channel(args.can, args.timeout)
    match_files(survey, [*bundled, *files])
    _assign_generic_file(survey.found.values(), files)
    nodes = [node for node_id, node in survey.found.items() if node_id != survey.master_id]
    if not nodes:
        raise CanopenError(f"no node answers on {survey.channel}; check power and bit rate")
    devices = []
    for node in nodes:
        if node.eds is None:
            print(f"canopen-control: left out: {_unknown(node, args.eds)}", file=sys.stderr)
        else:
            devices.append(_device(Path(node.eds), node.node_id, _device_name(node)))
    if not devices:
        raise ConfigError(
            f"no EDS matches any device on {survey.channel}; pass the manufacturers' files with --eds FILE"
        )
    if survey.expected is None:  # not for the drives of a running robot: no other program may access them
        ask_drives(survey.channel, devices, args.timeout)
    return devices


def _assign_generic_file(nodes: Iterable[FoundNode], files: Sequence[Path]) -> None:
    """If exactly one given EDS has no product code, assign it to the vendor's devices that have no EDS."""
    from canopen_control.commissioning.identity import vendor_and_product

    without = [(file, vendor) for file in files for vendor, product in [vendor_and_product(file)] if not product]
    for node in nodes if len(without) == 1 else ():
        (file, vendor), identity = without[0], node.identity
        if node.eds is None and identity is not None and vendor in (0, identity.vendor_id or 0):
            node.eds, node.remark = str(file), "the one given, which has no product code"


def ask_drives(channel: str, devices: Sequence[Device], timeout: float) -> None:
    """Read modes and units from the drives and use them instead of the defaults of the EDS."""
    from canopen_control.master.direct import DirectBus
    from canopen_control.od.codec import decode

    requests = [
        (device.node_id, *address)
        for device in devices
        for address in _READ_OBJECTS
        if device.od.get(*address) is not None
    ]
    dictionaries = {device.node_id: device.od for device in devices}
    with DirectBus.open(channel, label=LABEL, timeout_s=timeout, retries=1) as bus:
        answers = bus.read_many(requests)
    for (node_id, index, subindex), answer in answers.items():
        entry = dictionaries[node_id][index, subindex]
        with contextlib.suppress(ValueError):  # the answer has another size than in the EDS: keep the default
            if isinstance(answer, bytes):
                value = decode(answer, entry.data_type)
                dictionaries[node_id].entries[index, subindex] = replace(entry, default=value, parameter_value=None)


def _device_name(node: FoundNode) -> str:
    identity = node.identity
    parts = [(identity.device_name if identity else "") or "", node.remark and f"its EDS is {node.remark}"]
    if identity is not None and identity.serial_number:
        parts.insert(1, f"serial number {identity.serial_number}")
    return ", ".join(part for part in parts if part)


def _unknown(node: FoundNode, files: Sequence[str]) -> str:
    identity = node.identity
    if identity is None:
        return f"node {node.node_id} does not answer SDO requests"
    vendor, product = identity.vendor_id or 0, identity.product_code or 0
    title = f"node {node.node_id}, vendor 0x{vendor:08X}, product 0x{product:08X}"
    if files:
        return f"{title}: not the device of {', '.join(files)}; add its EDS with --eds"
    return f"{title}: no matching EDS; add it with --eds"


def _lines(written: Written, channel: str) -> list[str]:
    robot = written.robot
    lines = [f"created {written.folder}/: {', '.join(written.files)}"]
    lines += [_node_line(node) for node in robot.nodes]
    lines += [f"check warns: {text}" for text in written.warnings if "is a guess" not in text]
    guessed = list(dict.fromkeys(joint.node for joint in robot.joints if not joint.axis.is_known))
    if guessed:
        lines.append(f"counts per revolution are guessed for {_some(guessed)} (guesses in bus.yml); measure them")
    name = shlex.quote(str(written.folder))
    if written.problems:
        lines += [f"PROBLEM, marked in bus.yml too: {text}" for text in written.problems]
        unable = [node.name for node in robot.nodes if node.unusable]
        subject = f"{_some(unable)} cannot move" if unable else "the robot cannot run"
        return [*lines, f"{subject} yet: correct {written.folder}/bus.yml, then: canopen-control check {name}"]
    if robot.is_bus_alone:
        lines.append("no device has a known drive or signal profile, so the robot has a bus but no controllers")
        return [*lines, f"boot it on virtual devices: canopen-control run {name}"]
    lines.append(f"{'turn' if robot.drives else 'see'} it on virtual devices: canopen-control demo {name}")
    kind = "drives" if robot.drives else "devices"
    owned = f"the {kind} of {channel}" if may_host_virtual_drives(channel) else f"real {kind}"
    command = f"preflight {name} --can {channel}" if robot.drives else f"run {name} --can {channel} --real"
    return [*lines, f"on {owned}, after checking bus.yml: canopen-control {command}"]


def _node_line(node: NewNode) -> str:
    title = f"  node {node.device.node_id} {node.name}:"
    if node.drive is not None:
        moved = [f"{joint.name}, {joint.axis.interface} in {joint.axis.mode.name}" for joint in node.joints]
        personality = node.known
        like = (
            ""
            if personality is None or not personality.bus_keys
            else f"; known as {personality.title}, see its bus.yml"
        )
        return f"{title} moves {'; '.join(moved)}{like}"
    if node.unusable:
        return f"{title} {node.device.eds.name}, a drive that cannot be moved yet"
    if node.measured:
        return f"{title} measures {node.measured}"
    if not node.signals:
        return f"{title} {node.device.eds.name}, unknown profile, run as a proxy"
    outputs = f"{len(node.outputs)} of them outputs" if node.outputs else "all inputs"
    return f"{title} {node.profile.words}, {len(node.signals)} signals, {outputs}"


def _some(names: Sequence[str]) -> str:
    return ", ".join(names) if len(names) < 4 else f"{names[0]} and {len(names) - 1} more"
