"""Rules for common mistakes in and between a robot's three files, with place and correction.

A rule reads the files that could be parsed (others are None) and yields findings, without exceptions or side effects.
An error that prevents the start is an ERROR, a setting with surprising results a WARNING.
"""

from __future__ import annotations

import difflib
import math
import re
from pathlib import Path
from typing import TYPE_CHECKING, Final

from canopen_control.check.drive_rules import DRIVE_RULES
from canopen_control.check.finding import CheckedRobot, Finding
from canopen_control.check.parameter_rules import PARAMETER_RULES
from canopen_control.cia402 import objects
from canopen_control.controllers.controllers_file import is_within
from canopen_control.controllers.limiters import QUANTITIES
from canopen_control.controllers.types import make_controller
from canopen_control.errors import CanopenError, ConfigError, closest, nearest
from canopen_control.hardware.axis_parameters import PLUGINS
from canopen_control.hardware.device_parts import device_of
from canopen_control.hardware.plugins import KNOWN, PluginKind
from canopen_control.master.keys import SHORTEST_SYNC_US
from canopen_control.od.issues import Severity
from canopen_control.runtime.setup import started_controllers
from canopen_control.runtime.sync_choice import axis_number, node_of
from canopen_control.urdf.joint_element import EFFORT, POSITION

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from canopen_control.controllers.base import DriveGeometry
    from canopen_control.controllers.controllers_file import ControllerConfig, ControllersFile
    from canopen_control.master.config import BusConfig
    from canopen_control.master.keys import NodeConfig
    from canopen_control.runtime.robot_files import RobotFiles
    from canopen_control.urdf.description import UrdfDescription
    from canopen_control.urdf.joint_element import Joint
    from canopen_control.urdf.robot_model import WheelGeometry
    from canopen_control.urdf.ros2_control import ControlJoint, Ros2ControlSystem


# Common mistakes of wheeled robots: wrong sizes, sides, signs, frames, and limits that prevent any motion.
#
# REP 103: x is forward, y to the left, and a wheel that drives forward turns about +y. Sizes are compared without the
# multipliers, which are calibration.


_DIFF_DRIVE: Final = frozenset({"wheel_separation", "wheel_radius"})
"""Sizes that a diff drive controller takes from the URDF if missing; only this type has has_..._limits."""
_ALONG: Final = 0.9
"""Component of a unit vector from which it is considered parallel to the coordinate axis."""
SAME: Final = 0.01
"""Relative difference up to which two lengths are considered equal."""


def _bases(robot: CheckedRobot) -> Iterator[tuple[str, DriveGeometry, ControllerConfig]]:
    for name, controller in robot.configured.items():
        if (base := controller.wheel_base()) is not None:
            yield name, base, robot.config(name)


def _line(config: ControllerConfig, *names: str) -> int:
    return next((line for name in names if (line := config.params.line(name))), config.line)


def _jerk(robot: CheckedRobot) -> Iterator[Finding]:
    for name, base, config in _bases(robot):
        for axis in base.frozen:
            text = f"{name}: {axis}.max_jerk: 0 prevents any motion: the robot can neither start nor brake"
            fix = f"remove it, or give {axis}.has_jerk_limits: false" if base.radius_key in _DIFF_DRIVE else "remove it"
            yield Finding(config.path, _line(config, f"{axis}.max_jerk"), Severity.ERROR, text, fix)


def _frames(robot: CheckedRobot) -> Iterator[Finding]:
    description = robot.description
    if description is None:
        return
    parents = {joint.child: joint for joint in description.joints.values()}
    for name, base, config in _bases(robot):
        odom, child = base.odom_frame, base.base_frame
        joint = parents.get(child)
        line = _line(config, "odom_frame_id", "base_frame_id")
        if child not in description.links:
            text = f"{name}: base_frame_id {child!r} is not a link of {description.path}"
            hint = nearest(child, description.links)
            yield Finding(
                config.path, _line(config, "base_frame_id"), Severity.WARNING, text + hint, "use a link's name"
            )
        elif joint is not None and base.publishes_tf:
            text = (
                f"{name}: {child} has two parents: {odom} by odometry, and {joint.parent} by the "
                f"{joint.type} joint {joint.name} ({description.path}:{joint.place.line})"
            )
            fix = f"remove that joint and its parent, or set base_frame_id: {_root(parents, child)}"
            yield Finding(config.path, line, Severity.WARNING, text, fix)
        elif odom in description.links:
            text = f"{name}: odom_frame_id {odom!r} is already a link of {description.path}"
            yield Finding(config.path, line, Severity.WARNING, text, "call it odom")


def _root(parents: dict[str, Joint], link: str) -> str:
    """Return the root of the tree that contains a link."""
    visited: set[str] = set()
    while link in parents and link not in visited:
        visited.add(link)
        link = parents[link].parent
    return link


def _sizes(robot: CheckedRobot) -> Iterator[Finding]:
    geometry = robot.geometry
    if geometry is None:
        return
    for name, base, config in _bases(robot):
        separation, radius = geometry.separation(base.left, base.right), geometry.radius((*base.left, *base.right))
        if base.separation > 0.0:
            yield from _size(name, config, base.separation_key, base.separation, separation)
        yield from _size(name, config, base.radius_key, base.radius, radius)


def _size(name: str, config: ControllerConfig, key: str, used: float, urdf: float | None) -> Iterator[Finding]:
    line, node = config.params.line(key), config.params.flat.get(key)
    absent = "missing" if node is None else "0" if node.value == 0 else ""
    if absent and not config.ros1 and key in _DIFF_DRIVE:
        text = f"{name}: {key} is {absent}, which ROS 2 refuses; here the description's {used:g} m is used"
        yield Finding(config.path, line or config.line, Severity.WARNING, text, f"write {key}: {used:g}")
    elif line and urdf is not None and abs(used - urdf) > SAME * urdf:
        text = f"{name}: {key} is {used:g} m, the description's wheels have {urdf:g} m"
        yield Finding(config.path, line, Severity.WARNING, text, "measure the robot and correct the one that is wrong")


def _sides(robot: CheckedRobot) -> Iterator[Finding]:
    """Find left wheels on the right side, and wheels whose axis points to the right."""
    geometry, description = robot.geometry, robot.description
    if geometry is None or description is None:
        return
    for name, base, config in _bases(robot):
        left, right = (_middle(geometry, side) for side in (base.left, base.right))
        if left is not None and right is not None and left < right:
            text = f"{name}: the left wheels are on the right side of the robot ({left:g} m and {right:g} m along y)"
            line = _line(config, "left_wheel_names", "left_wheel")
            yield Finding(config.path, line, Severity.WARNING, text, "swap left and right wheel names")
        for wheel in (*base.left, *base.right):
            axis = geometry.axis(wheel)
            if axis is not None and axis[1] < -0.5:
                text = f"joint {wheel}: its axis points to the right, so a positive velocity drives backwards"
                joint = description.joints[wheel]
                yield Finding(description.path, joint.place.line, Severity.WARNING, text, "reverse its <axis>")
            elif axis is not None and abs(axis[0]) > _ALONG:  # also the axis of a joint without <axis>
                text = f"joint {wheel}: its axis points forward, so that the wheel cannot roll forward"
                joint = description.joints[wheel]
                fix = 'write <axis xyz="0 1 0"/>'
                yield Finding(description.path, joint.place.line, Severity.WARNING, text, fix)


def _middle(geometry: WheelGeometry, joints: Sequence[str]) -> float | None:
    places = [geometry.place(name) for name in joints]
    positions = [place[1][1] for place in places if place is not None]
    return sum(positions) / len(positions) if positions and len(positions) == len(places) else None


def _mirrored(robot: CheckedRobot) -> Iterator[Finding]:
    """Find left and right wheels whose drives have scales of the same sign."""
    if robot.bus is None:
        return
    for _, base, _ in _bases(robot):
        left = [drive for name in base.left if (drive := _drive(robot, name)) is not None]
        right = [drive for name in base.right if (drive := _drive(robot, name)) is not None]
        for (one, sign), (other, other_sign) in zip(left, right, strict=False):
            if sign == other_sign and one is not other:
                text = (
                    f"nodes {one.node_id} ({one.name}) and {other.node_id} ({other.name}) drive wheels of both sides "
                    "with scales of the same sign; motors that face each other then turn the robot on the spot"
                )
                fix = f"if they do, make the scales of {one.name} negative"
                yield Finding(robot.bus.path, one.line, Severity.WARNING, text, fix)


def _drive(robot: CheckedRobot, joint: str) -> tuple[NodeConfig, bool] | None:
    """Return the node that moves a joint, and whether the joint's scale is negative, or None if unknown."""
    if robot.bus is None or robot.description is None:
        return None
    for tag in robot.description.hardware:
        ratios = {transmission.joint: transmission.reduction for transmission in tag.transmissions}
        for part in tag.joints:
            node = node_of(robot.bus, part)
            if part.name == joint and node is not None:
                scale = node.units.of_axis(axis_number(part))["vel_to_dev"]
                return node, scale * ratios.get(joint, 1.0) < 0.0
    return None


WHEEL_RULES: Final[tuple[Callable[[CheckedRobot], Iterator[Finding]], ...]] = (
    _jerk,
    _frames,
    _sizes,
    _sides,
    _mirrored,
)


LEGAL_NAME: Final = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
"""Valid name of a ROS node, and therefore of a controller."""
_PLACED: Final = re.compile(r"(?P<path>[^\s:][^:]*):(?P<line>\d+)(?::(?P<column>\d+))?: (?P<text>.+)")
_TRANSLATED: Final = (" is read as ", " has no effect")
"""Phrases in warnings about keys of other ROS distributions, which become notes."""
_SYSTEM_PACKAGES: Final = ("canopen_ros2_control", "mock_components", "gz_ros2_control", "ign_ros2_control")
_ENDINGS: Final = (".yaml", ".yml", ".urdf", ".xacro")
_COUNT: Final = re.compile(r"\d+ errors")


def find(
    files: RobotFiles,
    bus: BusConfig | None = None,
    control: ControllersFile | None = None,
    description: UrdfDescription | None = None,
    *,
    controllers: Sequence[str] = (),
    launch: Path | None = None,
    mock: bool = False,
    real: bool = False,
) -> list[Finding]:
    """Return the findings of all rules; a file that could not be read is None, `launch` is a ROS launch file."""
    started = _started(files, control, description, controllers)
    chosen = bool(controllers or files.spawned)
    robot = CheckedRobot(files, bus, control, description, controllers, mock, real, started, chosen)
    findings = list(_configure(robot))
    if launch is not None:
        from canopen_control.check.launch_rules import check_launch  # most robots are run without

        findings += check_launch(launch, robot)
    if description is not None:
        findings += [
            finding for text in description.notes for finding in findings_of(text, description.path, 0, Severity.NOTE)
        ]
    for rule in (*RULES, *WHEEL_RULES):
        findings += rule(robot)
    return findings


def _started(
    files: RobotFiles, control: ControllersFile | None, description: UrdfDescription | None, names: Sequence[str]
) -> frozenset[str] | None:
    """Return the controllers that a run activates, or None if unknown."""
    if control is None or description is None:
        return None
    try:
        return frozenset(started_controllers(files, control, description, names))
    except ConfigError:  # reported by the rules and by the construction after them
        return None


def findings_of(text: str, path: str, line: int, severity: Severity) -> Iterator[Finding]:
    """Yield a finding for each line of an error text; `path` and `line` apply to lines without a location."""
    for row in text.splitlines():
        placed = _PLACED.fullmatch(row)
        if placed is not None:
            column = int(placed["column"] or 0)
            yield Finding(placed["path"], int(placed["line"]), severity, placed["text"], column=column)
        elif row.strip() and not row.startswith("    ") and not _COUNT.fullmatch(row):
            file, colon, rest = row.partition(": ")
            if colon and Path(file).resolve() == Path(path).resolve():
                yield Finding(path, line, severity, rest)
            elif colon and file.endswith(_ENDINGS) and Path(file).is_file():
                yield Finding(file, 0, severity, rest)
            else:
                yield Finding(path, line, severity, row)


# ------------------------------------------------------------------------------------------------------- controllers


def _configure(robot: CheckedRobot) -> Iterator[Finding]:
    """Create and configure every controller of the file, as at a start; yield errors and warnings."""
    control = robot.control
    if control is None:
        return
    errors: list[Finding] = []
    for name, config in control.controllers.items():
        try:
            controller = make_controller(name, config.type)
        except CanopenError as error:
            idle = robot.started is not None and name not in robot.started
            severity = (Severity.NOTE if robot.chosen else Severity.WARNING) if idle else Severity.ERROR
            fix = "it is not activated at the start, and cannot be activated later" if idle else ""
            yield Finding(config.path, config.line, severity, str(error), fix)
            continue
        try:
            controller.geometry = robot.geometry
            controller.on_configure(config.params)
            robot.configured[name] = controller
        except ConfigError as error:
            errors += findings_of(str(error), config.path, config.line, robot.severity(name))
        except CanopenError as error:
            yield Finding(config.path, config.line, robot.severity(name), str(error))
    yield from errors
    misspelt = {(error.path, error.line) for error in errors if _UNKNOWN in error.text}
    warnings = [
        *control.warnings,
        *(text for controller in control.controllers.values() for text in controller.params.warnings),
    ]
    for text in dict.fromkeys(warnings):
        severity = Severity.NOTE if any(word in text for word in _TRANSLATED) else Severity.WARNING
        for finding in findings_of(text, control.path, 0, severity):
            if not (_UNKNOWN in finding.text and (finding.path, finding.line) in misspelt):  # its error is reported
                yield finding


_UNKNOWN: Final = "unknown key "


def _unknown_controllers(robot: CheckedRobot) -> Iterator[Finding]:
    control = robot.control
    if control is None:
        return
    for name in robot.requested_controllers:
        if name not in control.controllers:
            hint = nearest(name, control.controllers)
            text = f"--controller {name}: no controller of this name{hint}"
            yield Finding(control.path, control.line, Severity.ERROR, text, "use that name, or add the controller")


def _illegal_names(robot: CheckedRobot) -> Iterator[Finding]:
    control = robot.control
    if control is None:
        return
    for name, config in control.controllers.items():
        if not LEGAL_NAME.fullmatch(name):
            better = re.sub(r"\W+", "_", name, flags=re.ASCII).strip("_") or "controller"
            text = f"{name!r} is not a valid node name: letters, digits and _ only"
            yield Finding(config.path, config.line, Severity.ERROR, text, f"call it {better!r}")


def _namespaces(robot: CheckedRobot) -> Iterator[Finding]:
    control = robot.control
    if control is None:
        return
    for name, config in control.controllers.items():
        expected = robot.launch_namespaces.get(name, control.namespace)
        if not is_within(config.namespace, expected):
            here, other = config.namespace or "/", expected or "/"
            text = f"{name} is in the namespace {here!r}, but its controller_manager in {other!r}"
            block = f"{expected}/{name}" if expected else repr(name)
            fix = f"name the block {block}, otherwise ROS does not find its parameters"
            yield Finding(control.path, config.block_line, Severity.WARNING, text, fix)


# ------------------------------------------------------------------------------------------------------------ joints


def _joints(robot: CheckedRobot) -> Iterator[Finding]:
    """Find command interfaces that controllers need and the description lacks."""
    description = robot.description
    if description is None or not description.hardware:
        return
    parts: dict[str, list[ControlJoint]] = {}
    for part in (part for tag in description.hardware for part in (*tag.joints, *tag.sensors, *tag.gpios)):
        parts.setdefault(part.name, []).append(part)
    # the interfaces of their plugin depend on a node that is missing or whose keys have errors, which are reported
    unknown = {
        joint.name
        for tag in description.hardware
        if tag.plugin in PLUGINS
        for joint in tag.joints
        if not joint.command_interfaces and (robot.bus is None or _is_unreadable(robot, joint))
    }
    misspelt = dict[Finding, None]()  # a name that is wrong for several joints is one mistake
    for name, controller in robot.configured.items():
        config = robot.config(name)
        for interface in controller.command_interface_names():
            joint, _, kind = interface.rpartition("/")
            if joint in unknown or joint.partition("/")[0] in robot.configured:  # a reference of another controller
                continue
            if (wrong := _misspelt_interface(robot, name, kind, parts.get(joint, []))) is not None:
                misspelt[wrong] = None
                continue
            text, fix = _why_not(joint, kind, parts, description)
            if text:
                place = _line_naming(config, joint)
                yield Finding(config.path, place, robot.severity(name), f"{name}: {text}", fix)
            elif kind == EFFORT and joint in description.joints and not description.joints[joint].limits.max_effort:
                # exporters of CAD programs write effort="0" velocity="0" for unknown limits
                text = f'{name}: effort="0" in the <limit> of {joint} reduces every commanded effort to 0'
                fix = f"give the maximum effort in Nm (N of a prismatic joint) there, in {description.path}"
                yield Finding(config.path, _line_naming(config, joint), Severity.WARNING, text, fix)
    yield from misspelt


def _misspelt_interface(robot: CheckedRobot, name: str, kind: str, parts: Sequence[ControlJoint]) -> Finding | None:
    """Return an error about the name of a command interface that is similar to one of a joint, or None.

    The error is in the description if only the controller's name is one of ros2_control.
    """
    interfaces = [interface for part in parts for interface in part.command_interfaces]
    if kind in interfaces or not (meant := closest(kind, interfaces)):
        return None
    if kind in QUANTITIES and meant not in QUANTITIES and robot.description is not None:
        text, path = f"a command interface is called {meant!r}", robot.description.path
        return Finding(path, parts[0].place.line, robot.severity(name), text, f"call it {kind!r}")
    config = robot.config(name)
    text = f"{name}: no command interface is called {kind!r} (did you mean {meant!r}?)"
    return Finding(config.path, _line_naming(config, kind), robot.severity(name), text, "use the description's name")


def _why_not(
    joint: str, kind: str, parts: dict[str, list[ControlJoint]], description: UrdfDescription
) -> tuple[str, str]:
    source = description.path
    if joint not in parts and joint not in description.joints:
        return f"joint {joint!r} is not in {source}{nearest(joint, parts)}", "use the description's name"
    if joint not in parts:
        tag = "<transmission>" if description.ros1 else "<ros2_control>"
        return f"joint {joint!r} is not in the {tag} of {source}", f"add it to {tag}, so that a drive moves it"
    # several tags may contain the joint
    interfaces = [interface for part in parts[joint] for interface in part.command_interfaces]
    if kind not in interfaces:
        has = ", ".join(interfaces) or "none"
        mimic, place = parts[joint][0].mimic, f"{source}:{parts[joint][0].place.line}"
        if mimic is not None:
            fix = f'remove it here, or write mimic="false" and its command interface at {place} if it has its own drive'
            return f"joint {joint!r} mimics {mimic.joint}, so it has no command interface", fix
        fix = f'add <command_interface name="{kind}"/> at {place}'
        return f"joint {joint!r} has no command interface {kind!r}; it has {has}", fix
    return "", ""


def _line_naming(config: ControllerConfig, joint: str) -> int:
    """Return the line of the parameter value that names a joint, else the line of the controller."""
    for key, value in config.params.flat.pairs():
        places = value.elements() if value.kind == "sequence" else [value]
        for place in places:
            if place.kind == "scalar" and place.text == joint:
                return place.line or key.line
    return config.line


def _devices(robot: CheckedRobot) -> Iterator[Finding]:
    """Find joints and devices of the description whose node is missing in bus.yml."""
    bus, description = robot.bus, robot.description
    if bus is None or description is None or robot.mock:
        return
    for tag in description.hardware:
        if KNOWN.get(tag.plugin) is not PluginKind.CANOPEN and not robot.real:
            continue
        for joint in tag.joints:
            yield from _device(robot, tag, joint)
        ids = {name: node.node_id for name, node in bus.nodes.items()} | bus.unreadable
        for part in (*tag.sensors, *tag.gpios):
            if device_of(part, ids) is None:
                text = f"{part.name} of {tag.name} names no device of {bus.path} and has no interfaces"
                fix = 'add <param name="device_name">NODE</param>'
                yield Finding(description.path, part.place.line, Severity.WARNING, text, fix)


def _is_unreadable(robot: CheckedRobot, joint: ControlJoint) -> bool:
    """Whether the node of a joint has, or may have, keys with errors in bus.yml."""
    unreadable = {} if robot.bus is None else robot.bus.unreadable
    name, node_id = joint.parameters.get("device_name"), joint.parameters.get("node_id")
    if robot.bus is not None and robot.bus.incomplete and name not in robot.bus.nodes:
        return True
    return name in unreadable or (name is None and any(str(unread) in (node_id, "0") for unread in unreadable.values()))


def _device(robot: CheckedRobot, tag: Ros2ControlSystem, joint: ControlJoint) -> Iterator[Finding]:
    assert robot.bus is not None  # checked by `_devices`
    assert robot.description is not None
    path, nodes = robot.description.path, robot.bus.nodes
    name, node_id = joint.parameters.get("device_name"), joint.parameters.get("node_id")
    if _is_unreadable(robot, joint):
        return  # the error in its keys is reported
    if name is not None and name not in nodes:
        title = f"actuator {name!r}" if robot.description.ros1 else f"device_name {name!r}"
        text = f"joint {joint.name}: {title} is not a node of {robot.bus.path}{nearest(name, nodes)}"
        yield Finding(path, joint.place.line, Severity.ERROR, text, "use a name under nodes:")
    elif name is None and node_id is None:
        text = f"joint {joint.name} of {tag.name}: no device_name; the nodes of {robot.bus.path} are {', '.join(nodes)}"
        fix = 'add <param name="device_name">NODE</param>'
        if key := closest("device_name", joint.parameters):
            text, fix = f"joint {joint.name}: unknown <param name={key!r}>", "call it 'device_name'"
        yield Finding(path, joint.place.line, Severity.ERROR, text, fix)
    elif name is None and node_id not in [str(node.node_id) for node in nodes.values()]:
        text = f"joint {joint.name}: no node of {robot.bus.path} has node_id {node_id}"
        fix = "call the parameter device_name" if node_id in nodes else "use the node_id of a node"
        yield Finding(path, joint.place.line, Severity.ERROR, text, fix)


def _joint_limits(robot: CheckedRobot) -> Iterator[Finding]:
    """Find commanded joints whose <limit> permits no position, or is probably in degrees."""
    description = robot.description
    commanded = [name for each in robot.configured.values() for name in each.command_interface_names()]
    names = {name.removesuffix(f"/{POSITION}") for name in commanded if name.endswith(f"/{POSITION}")}
    for joint in () if description is None else description.joints.values():
        low, high = joint.limits.lower, joint.limits.upper
        if joint.name not in names or description is None:
            continue
        if low == high == 0.0:
            text = f"joint {joint.name}: lower and upper of <limit> are 0 or absent, so it accepts no position but 0"
            fix = 'write both, in rad or m, or type="continuous" for a joint without ends'
            yield Finding(description.path, joint.place.line, Severity.WARNING, text, fix)
        elif joint.type == "revolute" and max(-low, high) >= _TURNS and math.isfinite(max(-low, high)):
            text = f"joint {joint.name}: its <limit> from {low:g} to {high:g} rad is more than four turns"
            fix = f"if these are degrees, write {math.radians(low):.4g} and {math.radians(high):.4g}"
            yield Finding(description.path, joint.place.line, Severity.WARNING, text, fix)


_TURNS: Final = 8 * math.pi
"""Position limit in rad from which degrees are probably meant."""


def _guesses(robot: CheckedRobot) -> Iterator[Finding]:
    """Find values guessed by `init`, and counts_per_revolution of 1 or less."""
    bus = robot.bus
    if bus is None:
        return
    for node in bus.nodes.values():
        od = bus.dictionaries.get(node.name)
        values = [None if od is None else od.get(objects.POSITION_ENCODER_RESOLUTION, sub) for sub in (1, 2)]
        unset = all(entry is not None and entry.value == 1 for entry in values)
        for key in node.units.guesses:
            place = bus.place(node.name, key)
            severity = Severity.WARNING if unset else Severity.NOTE
            why = (
                "0x608F and 0x6092 of the EDS are 1/1, as in a device without a configuration"
                if unset
                else "neither the EDS nor the drive has the value"
            )
            text = f"{node.name}: {key} is a guess: {why}"
            yield Finding(place.path, place.line, severity, text, _MEASURE, column=place.column)
        counts = node.units.counts_per_revolution
        if counts is not None and counts <= 1.0:
            place = bus.place(node.name, "counts_per_revolution")
            text = f"{node.name}: counts_per_revolution {counts:g}: a whole turn is one count, probably a default value"
            yield Finding(place.path, place.line, Severity.WARNING, text, _MEASURE, column=place.column)


_MEASURE: Final = (
    "measure it: jog the axis by --position 1000counts, measure how far it turns, write the counts of one turn, and "
    "remove the key from guesses"
)


def _not_launched(robot: CheckedRobot) -> Iterator[Finding]:
    """Find files of the folder that are used although the launch file names other ones."""
    for option, (used, named) in robot.files.not_launched.items():
        text = f"this file of the folder is used; the launch file names {named}"
        yield Finding(str(used), 0, Severity.WARNING, text, f"give {option} {named} to use that one")


def _no_hardware(robot: CheckedRobot) -> Iterator[Finding]:
    description = robot.description
    if description is not None and not description.hardware:
        text = "no <ros2_control> tag and no <transmission> assigns drives to joints"
        yield Finding(description.path, 1, Severity.ERROR, text, "add a <ros2_control> tag with the joints and drives")


def _plugins(robot: CheckedRobot) -> Iterator[Finding]:
    description = robot.description
    if description is None:
        return
    for tag in description.hardware:
        if tag.plugin not in KNOWN and not (robot.mock or robot.real):
            text = f"no hardware plugin {tag.plugin!r}{nearest(tag.plugin, KNOWN)}"
            yield Finding(description.path, tag.place.line, Severity.ERROR, text, "use that, or --mock or --real")
    for plugin in description.gazebo:
        name = plugin.filename.rpartition("/")[2]
        hint = nearest(name, GAZEBO_PLUGINS)
        if name not in GAZEBO_PLUGINS and difflib.get_close_matches(name, GAZEBO_PLUGINS, 1, _MISSPELT):
            text = f"no Gazebo plugin {plugin.filename!r}{hint}"
            yield Finding(description.path, plugin.line, Severity.ERROR, text, "Gazebo runs without controllers")


GAZEBO_PLUGINS: Final = (
    "libgazebo_ros_control.so",
    "libgazebo_ros2_control.so",
    "libgz_ros2_control-system.so",
    "libign_ros2_control-system.so",
    "gz_ros2_control-system",
    "ign_ros2_control-system",
)
"""Gazebo plugins that run ros2_control or ros_control in Gazebo."""
_MISSPELT: Final = 0.9
"""Similarity of a misspelt name to one of them; other plugins have 0.8 (libgazebo_ros_ft_sensor.so, in prbt's URDF)."""


# ------------------------------------------------------------------------------------------------------------- rates


def _component_types(robot: CheckedRobot) -> Iterator[Finding]:
    """Find <ros2_control> tags of a type other than that of the plugin: ROS 2 then does not load the plugin."""
    description = robot.description
    for tag in () if description is None else description.hardware:
        if tag.kind != "system" and tag.plugin.partition("/")[0] in _SYSTEM_PACKAGES and description is not None:
            text = (
                f"<ros2_control name={tag.name!r}>: {tag.plugin} is a system, so ROS 2 does not load it as {tag.kind}"
            )
            yield Finding(description.path, tag.place.line, Severity.WARNING, text, 'give it type="system"')


def _update_rate(robot: CheckedRobot) -> Iterator[Finding]:
    bus, control = robot.bus, robot.control
    if bus is None or control is None:
        return
    sync, rate = bus.master.sync_period, control.update_rate
    place = control.manager_keys.get("update_rate")
    if place is None or 0 < sync < SHORTEST_SYNC_US:
        return
    if sync and rate * sync > 1_000_000:  # without SYNC the bus load rule reports it
        cycle = 1_000_000 / sync
        text = f"update_rate {rate} Hz is higher than the SYNC rate of {bus.path}, {cycle:g} Hz"
        fix = f"set update_rate: {cycle:g}, or sync_period: {1_000_000 // rate}"
        yield Finding(place.path, place.line, Severity.WARNING, text, fix)
    elif sync and abs(1_000_000 / (rate * sync) - _whole(1_000_000 / (rate * sync))) > UNEVEN:
        cycle, syncs = 1_000_000 / sync, _whole(1_000_000 / (rate * sync))
        text = (
            f"update_rate {rate} Hz is not an integer fraction of the SYNC rate of {bus.path} ({cycle:g} Hz): "
            f"controllers run {'on each SYNC' if syncs == 1 else f'on one of {syncs} SYNCs'}, at {cycle / syncs:g} Hz"
        )
        fix = f"set update_rate: {cycle / syncs:g}, or sync_period: {1_000_000 / rate / syncs:g}"
        yield Finding(place.path, place.line, Severity.WARNING, text, fix)
    elif 0 < rate * sync * 1.5 < 1_000_000:  # a rate closer to the cycle rate is rounded to it
        cycle = 1_000_000 / sync
        text = f"controllers run at {rate} Hz, though the SYNC rate of {bus.path} is {cycle:g} Hz"
        fix = f"set update_rate: {cycle:g} to run them in each cycle"
        yield Finding(place.path, place.line, Severity.NOTE, text, fix)


UNEVEN: Final = 0.01
"""Deviation from a whole number up to which the SYNCs per controller update are considered whole."""


def _whole(syncs: float) -> int:
    """Round the number of SYNCs per controller update, down if halfway, to at least 1."""
    return max(1, math.ceil(syncs - 0.5))


RULES: Final[tuple[Callable[[CheckedRobot], Iterator[Finding]], ...]] = (
    _guesses,
    *DRIVE_RULES,
    _unknown_controllers,
    _illegal_names,
    _namespaces,
    _not_launched,
    _no_hardware,
    _plugins,
    _joints,
    _devices,
    _joint_limits,
    _update_rate,
    _component_types,
    *PARAMETER_RULES,
)
