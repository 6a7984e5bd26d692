"""Text of a new robot's bus.yml, with a comment on each key.

If all nodes have the same EDS and modes, common keys are in `defaults`; otherwise each node has its own keys.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from canopen_control.cia402.modes import OperationMode
from canopen_control.cia402.objects import (
    ABORT_CONNECTION_OPTION,
    OPTION_CODES,
    PROFILE_ACCELERATION,
    PROFILE_DECELERATION,
    PROFILE_VELOCITY,
    QUICK_STOP_DECELERATION,
    QUICK_STOP_OPTION,
    object_name,
)
from canopen_control.master.known_drives import proposals
from canopen_control.od.codec import accepts
from canopen_control.profiles import Profile, has_error_mode
from canopen_control.scaffold.drive_choice import POSITION
from canopen_control.scaffold.new_robot import FASTEST_MEASURED

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator

    from canopen_control.scaffold.drive_choice import AxisChoice, DriveChoice
    from canopen_control.scaffold.new_robot import NewJoint, NewNode, NewRobot
    from canopen_control.scaffold.pdo_choice import PdoUse


_COLUMN: Final = 44
_QUICK_STOP: Final = 3  # 0x6007
_MODE_WORDS: Final = {
    OperationMode.PV: "profile velocity: the drive makes the ramp (0x6083, 0x6084)",
    OperationMode.CSV: "cyclic synchronous velocity: a velocity every SYNC; this computer computes the ramp",
    OperationMode.VL: "velocity mode of frequency converters, revolutions per minute",
    OperationMode.CSP: "cyclic synchronous position: a position every SYNC",
    OperationMode.PP: "profile position: the drive makes the ramp (0x6081, 0x6083, 0x6084)",
    OperationMode.IP: "interpolated position: a position every SYNC",
    OperationMode.TQ: "profile torque: the drive makes the ramp (0x6087)",
    OperationMode.CST: "cyclic synchronous torque: a torque every SYNC",
}
_RAMPED: Final = (OperationMode.PV, OperationMode.PP)
_EVERY: Final = tuple(_MODE_WORDS)
_RAMPS: Final = (
    (PROFILE_VELOCITY, 2.0, "profile velocity", (OperationMode.PP,)),
    (PROFILE_ACCELERATION, 20.0, "profile acceleration", _RAMPED),
    (PROFILE_DECELERATION, 20.0, "profile deceleration", _EVERY),
    (QUICK_STOP_DECELERATION, 40.0, "quick stop deceleration", _EVERY),
)
"""Object, value in rad/s or rad/s^2, words, modes that need it."""
_TRANSMISSION: Final = {1: "with every SYNC", 255: "acts on reception"}


def bus_text(robot: NewRobot) -> str:
    """Return the text of bus.yml for a new robot."""
    same = len({(node.device.eds, node.drive, node.unusable) for node in robot.nodes}) == 1
    lines = [*_head(robot), ""]
    if same:
        lines += ["defaults:  # keys of all nodes; a key of a node has priority"]
        lines += _indented(_node_keys(robot, robot.nodes[0]), 2)
        lines.append("")
    lines.append("nodes:")
    for node in robot.nodes:
        lines += [f"  {node.name}:", *_indented(list(_own_keys(node)), 4)]
        if not same:
            lines += _indented(_node_keys(robot, node), 4)
    return "\n".join(lines) + "\n"


def remark(text: str, words: str) -> str:
    """Return a YAML line with the comment `words` at the common column; "" means no comment."""
    return f"{text:<{_COLUMN}} # {words}" if words else text


def _head(robot: NewRobot) -> list[str]:
    return [
        f"# The CANopen bus of {robot.name}, in the format of ros2_canopen: nodes, and objects written at boot.",
        f"# Check it: canopen-control check {robot.name}. See each write: canopen-control plan {robot.name}.",
        *(f"# PROBLEM, which prevents a run: {text}" for text in robot.problems),
        "",
        *_options(robot),
        "master:  # this computer",
        remark(f"  node_id: {robot.master_id}", "node-ID of the master; must be unique"),
        remark(f"  baudrate: {robot.baudrate}", "kbit/s, as set in the devices and in a real CAN interface"),
        remark(f"  sync_period: {robot.sync_us}", "us: period of SYNC, and of feedback, controllers and commands"),
        remark(f"  heartbeat_producer: {robot.heartbeat_ms}", "ms: devices stop when this heartbeat stops"),
    ]


def _options(robot: NewRobot) -> list[str]:
    """Return the section `options`, or [] if all devices use node guarding."""
    if not any(node.supervision.consumer or not node.supervision.guarding for node in robot.nodes):
        return []
    return ["options:", remark("  heartbeat_multiplier: 5", "each side times out after five heartbeat periods"), ""]


def _own_keys(node: NewNode) -> Iterator[str]:
    yield remark(f"node_id: {node.device.node_id}", node.device.remark or "as set in the device")
    if _by_scale(node):
        yield from _scales(node)
    elif node.joints:
        mirrored = node.joints[0].mirrored
        yield remark(f"reversed: {'true' if mirrored else 'false'}", "true for a motor that is mounted mirrored")


def _node_keys(robot: NewRobot, node: NewNode) -> list[str]:
    device = node.device.od.device
    product = " ".join(part for part in (device.vendor_name, device.product_name) if part)
    lines = [
        remark(f"dcf: {_quoted(robot.eds_name(node))}", f"EDS in this folder{f': {product}' if product else ''}"),
        remark("revision_number: 0", "any firmware revision"),
        *_supervision(robot, node),
    ]
    if node.unusable:
        comment = "# its PDOs are unchanged, and it moves no joint of the description"
        return [*lines, f"# PROBLEM: {node.unusable}", comment]
    if node.drive is None:
        product = f"{node.profile.words}: " if node.signals else "unknown profile, a proxy: "
        return [*lines, *_watched(node), *_safe_outputs(robot, node), *_device_pdos(node, product)]
    return [
        *lines,
        *(motion := _motion(node, node.drive)),
        *_known(robot, node, {line.partition("#")[0].strip() for line in motion}),
        *_writes(robot, node, node.drive),
        *_pdos(node.drive),
    ]


def _device_pdos(node: NewNode, product: str) -> Iterator[str]:
    """Yield the PDO keys of a device other than a drive, with comments; only a comment for default PDOs."""
    if node.left_out:
        first, *_, last = (f"0x{index:04X}:{subindex:02X}" for index, subindex in (*node.left_out, node.left_out[-1]))
        yield f"# No RPDO can carry the outputs {first}{f' to {last}' if last != first else ''}: write them by SDO."
    listed = (("tpdo", "from the device", node.tpdos), ("rpdo", "to the device", node.rpdos))
    unchanged = [f"{key.upper()}s" for key, _, uses in listed if not uses]
    stay = f"its {'PDOs' if len(unchanged) == len(listed) else ''.join(unchanged)} are unchanged"
    yield f"# {product}{stay if unchanged else 'its PDOs carry its signals'}"
    for key, words, uses in listed:
        if uses:
            yield f"{key}:  # {words}; {key.upper()}s that are not listed are disabled"
            for use in uses:
                yield from _indented(_pdo(use), 2)


def _known(robot: NewRobot, node: NewNode, present: Collection[str]) -> list[str]:
    """Return the missing keys that a drive of a known manufacturer needs, with their sources.

    The keys are commented out; if the user named the manufacturer, only the modes are commented out.
    """
    drive = node.known
    if drive is None:
        return []
    commanded = {joint.axis.interface for joint in node.joints}
    lines = ["", f"# {drive.title}: `canopen-control drive --like {drive.name}` simulates such a drive."]
    for key, text in proposals(drive, robot.sync_us, (), (), commanded):
        named = node.device.like is not None
        if text in present or (named and key.key == "sdo"):  # it is in the list of `sdo`
            continue
        comment = "" if named and not key.key.endswith("_mode") else "# "
        lines += [f"# {drive.name.upper()}: {key.why} ({key.source}):", f"{comment}{text}"]
    return lines


def _named_writes(robot: NewRobot, node: NewNode) -> list[str]:
    """Return the `sdo` entries that drives of the selected manufacturer need."""
    like = node.device.like
    writes = () if like is None else proposals(like, robot.sync_us, (), (), ())
    entries = [(key, text.removeprefix("sdo: [").removesuffix("]")) for key, text in writes if key.key == "sdo"]
    return [remark(f"  - {entry}", f"{key.why} ({key.source})") for key, entry in entries]


def _watched(node: NewNode) -> list[str]:
    """Return the keys that limit the rate of an encoder's position, so that jumps are reported."""
    if not node.measured:
        return []
    limit = remark(
        f"  - {{name: position, max_rate: {FASTEST_MEASURED:g}}}", "rad/s: a faster change is reported as a jump;"
    )
    return ["signals:", limit, remark("", "then the position is nan until the next boot of the device")]


def _safe_outputs(robot: NewRobot, node: NewNode) -> list[str]:
    """Return `safe: keep` keys for outputs that the device cannot switch off itself; [] unless `allow_unsupervised`."""
    outputs = [output.name for output in node.outputs if not has_error_mode(node.device.od, output)]
    if not outputs or not robot.allow_unsupervised:
        return []
    text = remark(
        "signals:", "NOTHING switches these outputs off when this computer fails: the device has no error modes"
    )
    return [text, *(f"  - {{name: {name}, safe: keep}}" for name in outputs)]


def _supervision(robot: NewRobot, node: NewNode) -> list[str]:
    watched, lines = node.supervision, list[str]()
    if watched.producer and not watched.guarding:
        text = "ms (0x1017): the master reports the device when this heartbeat stops"
        lines.append(remark(f"heartbeat_producer: {robot.heartbeat_ms}", text))
    if watched.consumer:
        lines.append(remark("heartbeat_consumer: true", "0x1016: the device monitors the master"))
    if watched.guarding:
        text = "ms (0x100C): node guarding, because it has no heartbeat consumer"
        lines.append(remark(f"guard_time: {robot.heartbeat_ms}", text))
        lines.append(remark("life_time_factor: 5", "0x100D: each side times out after five guard times"))
    if robot.allow_unsupervised and node.profile is Profile.DRIVE and not watched.stops_alone:
        lines.append(remark("allow_unsupervised: true", "NOTHING stops this drive when this computer fails"))
    lines.append(remark("missed_syncs: 10", "feedback is stale after ten SYNCs without it"))
    return lines


def _motion(node: NewNode, drive: DriveChoice) -> list[str]:
    lines = [""]
    if drive.motors is not None:
        text = "of axis 0, axis 1: motors with a common controlword are enabled and stopped together"
        lines.append(remark(f"motor_subindices: {list(drive.motors.subindices)}", text))
    for interface, mode in drive.modes.items():
        lines.append(remark(f"{interface}_mode: {int(mode)}", _MODE_WORDS[mode]))
    if _by_scale(node):
        return [*lines, *_guesses(drive, "channels" if len(node.joints) > 1 else "scale_pos_to_dev")]
    return [
        *lines,
        remark(f"counts_per_revolution: {drive.axes[0].counts:g}", _counts_comment(drive.axes[0])),
        *_guesses(drive, "counts_per_revolution"),
        remark("gear_ratio: 1.0", "motor revolutions per joint revolution"),
        "# A drive whose velocity unit is not counts/s, but for example rpm, needs four scales instead:",
        "# scale_pos_to_dev and scale_pos_from_dev (counts per rad and back), scale_vel_to_dev, scale_vel_from_dev",
    ]


def _scales(node: NewNode) -> Iterator[str]:
    """Yield the scale keys of a drive whose velocities are not in counts/s, or whose axes differ."""
    yield "# Multiply both ..._to_dev by the gear ratio, divide both ..._from_dev by it; all four are negative for a"
    yield "# motor that is mounted mirrored."
    several = len(node.joints) > 1
    if several:
        yield "channels:  # the units of the axes, in their order"
    for joint in node.joints:
        lines = list(_axis_scales(joint))
        yield from (f"  {'- ' if not place else '  '}{line}" if several else line for place, line in enumerate(lines))


def _axis_scales(joint: NewJoint) -> Iterator[str]:
    axis, sign = joint.axis, -1.0 if joint.mirrored else 1.0
    position = sign * axis.counts / math.tau
    rpm = axis.rpm if _in_rpm(axis) else 0.0
    velocity = sign * 60.0 / math.tau / rpm if rpm else position
    unit = f"velocities are in {rpm:g} rpm (0x60A9)" if rpm else f"of {joint.name}"
    yield remark(f"scale_pos_to_dev: {position!r}", f"for each rad: {_counts_comment(axis)} ({axis.counts:g})")
    yield f"scale_pos_from_dev: {1 / position!r}"
    yield remark(f"scale_vel_to_dev: {velocity!r}", f"for each rad/s: {unit}")
    yield f"scale_vel_from_dev: {1 / velocity!r}"


def _guesses(drive: DriveChoice, *keys: str) -> list[str]:
    """Return the `guesses` key for unmeasured values, which `check` reports."""
    guessed = not all(axis.is_known for axis in drive.axes)
    return [remark(f"guesses: [{', '.join(keys)}]", "measure it, then remove this line")] if guessed else []


def _counts_comment(axis: AxisChoice) -> str:
    if axis.is_known:
        return "position counts per revolution (0x608F); verify"
    return "A GUESS: position counts per motor revolution; neither the EDS nor the drive has this value"


def _writes(robot: NewRobot, node: NewNode, drive: DriveChoice) -> list[str]:
    """Return the `sdo` entries: for the manufacturer's drives, for a lost master, and for ramps missing in the EDS."""
    lines, od = list[str](), node.device.od
    if accepts(od.get(ABORT_CONNECTION_OPTION, 0), _QUICK_STOP) and _stops_quickly(node):
        lines.append(remark("  - {index: 0x6007, sub_index: 0, value: 3}", "when the master is lost: quick stop"))
    for axis in drive.axes:
        unit = 60.0 / math.tau / axis.rpm if axis.rpm else axis.counts / math.tau
        for base, value, words, modes in _RAMPS:
            address, raw = (axis.index(base), 0), round(value * unit)
            address = address if drive.motors is None else drive.motors.address(*address)
            if axis.mode in modes and not _eds_value(node, *address) and accepts(od.get(*address), raw):
                text = f"{words}: {value:g} {'rad/s' if base == PROFILE_VELOCITY else 'rad/s^2'}"
                line = f"  - {{index: 0x{address[0]:04X}, sub_index: {address[1]}, value: {raw}}}"
                lines.append(remark(line, text))
    lines = list(dict.fromkeys(lines))  # an object that axes share is written once
    if len(lines) > 1:
        lines.append("  # the EDS has no ramp defaults, and some drives do not move without a ramp; if omitted,")
        lines.append("  # the values that the drive has stored apply")
    lines = [*_named_writes(robot, node), *lines]
    return ["sdo:", *lines] if lines else []


def _stops_quickly(node: NewNode) -> bool:
    """Whether a quick stop stops the drive, as 0x605A in the EDS states; if not, a fault (0x6007 = 1) must stop it."""
    entry = node.device.od.get(QUICK_STOP_OPTION, 0)
    return entry is None or entry.value is None or entry.value in OPTION_CODES[QUICK_STOP_OPTION]


def _eds_value(node: NewNode, index: int, subindex: int) -> bool:
    entry = node.device.od.get(index, subindex)
    return entry is not None and bool(entry.value)


def _pdos(drive: DriveChoice) -> list[str]:
    lines = ["", "# Process data, sent every cycle. PDOs that are not listed are disabled."]
    if not all(axis.feedback for axis in drive.axes):
        lines.append("# NO FEEDBACK: neither 0x6064 (position) nor 0x606C (velocity) can be mapped.")
    for key, words, uses in (("tpdo", "from the drive", drive.tpdos), ("rpdo", "to the drive", drive.rpdos)):
        if any(use.fixed for use in uses):
            numbers = ", ".join(str(use.number) for use in uses)
            lines.append(f"# {key} {numbers}, {words}: they cannot be changed, and are used unchanged")
            continue
        lines.append(f"{key}:  # {words}")
        for use in uses:
            lines += _indented(_pdo(use), 2)
    return lines


def _pdo(use: PdoUse) -> list[str]:
    lines = [f"{use.number}:", "  enabled: true"]
    if use.auto:
        lines.append(remark("  cob_id: auto", "default COB-ID, from the node-ID"))
    if use.transmission is not None:
        lines.append(remark(f"  transmission: {use.transmission}", _TRANSMISSION[use.transmission]))
    named = [(f"{{index: 0x{index:04X}, sub_index: {sub}}}", object_name(index) or "") for index, sub in use.objects]
    if use.remaps:
        return [*lines, "  mapping:", *(remark(f"    - {text}", words) for text, words in named)]
    return [*lines, "  # fixed mapping of the device:", *(remark(f"  #   {text}", words) for text, words in named)]


def _by_scale(node: NewNode) -> bool:
    """Whether bus.yml needs separate scale factors for positions and velocities, or for each axis."""
    units = {(joint.mirrored, joint.axis.counts, joint.axis.rpm) for joint in node.joints}
    return len(units) > 1 or any(_in_rpm(joint.axis) for joint in node.joints)


def _in_rpm(axis: AxisChoice) -> bool:
    return axis.rpm > 0 and axis.mode is not OperationMode.VL and axis.interface != POSITION


def _quoted(text: str) -> str:
    return f'"{text}"' if any(letter in text for letter in " :#'{}[],&*!|>%@`") else text


def _indented(lines: list[str], by: int) -> list[str]:
    return [" " * by + line if line else "" for line in lines]
