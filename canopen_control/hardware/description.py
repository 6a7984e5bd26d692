"""The robot's description: URDF or xacro, its links and joints, and the <ros2_control> tags in it.

The law of the file: xacro is the real one and imported only when a file asks for it; every mistake of the description
is told at once, each with file and line (of a xacro file, the line that seems to be meant: the tags of its result have
none); what ros2_control refuses is refused here too, so that a description that loads here loads there. Without a
<ros2_control> tag, ROS 1's <transmission> tags say which drive moves which joint.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Final

from canopen_control.errors import RobotConfigError
from canopen_control.hardware.interfaces import EFFORT, POSITION, VELOCITY
from canopen_control.hardware.scene import GazeboPlugin, gazebo_plugins, radii
from canopen_control.hardware.transmission import Transmission, read_transmission
from canopen_control.hardware.urdf import Document, Element, read_document
from canopen_control.hardware.xacro_files import run_xacro
from canopen_control.yamltree import nearest

if TYPE_CHECKING:
    import os
    from collections.abc import Iterator, Mapping, Sequence

__all__ = [
    "ControlJoint",
    "Description",
    "InterfaceInfo",
    "Limits",
    "Mimic",
    "Ros2ControlSystem",
    "UrdfJoint",
    "parse_description",
    "read_description",
]

Vector = tuple[float, float, float]

KINDS: Final = ("system", "actuator", "sensor")
_CHILDREN: Final = ("hardware", "properties", "joint", "sensor", "gpio", "transmission")
_JOINT_TYPES: Final = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar")
_NEEDS_LIMITS: Final = ("revolute", "prismatic")


@dataclass(frozen=True)
class Limits:
    """A joint's <limit>: rad or m, rad/s or m/s, Nm or N; infinite where there is none."""

    lower: float = -math.inf
    upper: float = math.inf
    velocity: float = math.inf
    effort: float = math.inf


@dataclass(frozen=True)
class Mimic:
    """Position is `multiplier` times that of `joint`, plus `offset`."""

    joint: str
    multiplier: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True)
class UrdfJoint:
    """A joint: m and rad, in the frame of the parent link."""

    name: str
    type: str
    parent: str
    child: str
    origin_xyz: Vector = (0.0, 0.0, 0.0)
    origin_rpy: Vector = (0.0, 0.0, 0.0)
    axis: Vector = (1.0, 0.0, 0.0)
    limits: Limits = Limits()
    mimic: Mimic | None = None
    line: int = 0


@dataclass(frozen=True)
class InterfaceInfo:
    """A <command_interface> or <state_interface>: bounds and initial value in SI units, infinite or nan if absent.

    `limited` is False where `<limits enable="false"/>` stands, at it or at its joint.
    """

    name: str
    minimum: float = -math.inf
    maximum: float = math.inf
    initial_value: float = math.nan
    parameters: dict[str, str] = field(default_factory=dict)
    limited: bool = True


@dataclass(frozen=True)
class ControlJoint:
    """A <joint>, <sensor> or <gpio> of a <ros2_control> tag; its interfaces by name."""

    name: str
    parameters: dict[str, str] = field(default_factory=dict)
    command_interfaces: dict[str, InterfaceInfo] = field(default_factory=dict)
    state_interfaces: dict[str, InterfaceInfo] = field(default_factory=dict)
    mimic: Mimic | None = None
    line: int = 0


@dataclass(frozen=True)
class Ros2ControlSystem:
    """A <ros2_control> tag: `kind` is system, actuator or sensor, `plugin` what drives it."""

    name: str
    kind: str
    plugin: str
    parameters: dict[str, str] = field(default_factory=dict)
    joints: tuple[ControlJoint, ...] = ()
    sensors: tuple[ControlJoint, ...] = ()
    gpios: tuple[ControlJoint, ...] = ()
    transmissions: tuple[Transmission, ...] = ()
    line: int = 0


@dataclass(frozen=True)
class Description:
    """A robot: its URDF as text (xacro processed), its tree, and who drives what.

    `radii` are those of links whose collision (else visual) is one cylinder or sphere, in m. `ros1` says that the
    hardware was made of ROS 1's <transmission> tags, for want of a <ros2_control> tag.
    """

    path: str
    urdf_xml: str
    robot_name: str
    links: tuple[str, ...] = ()
    joints: dict[str, UrdfJoint] = field(default_factory=dict)
    hardware: tuple[Ros2ControlSystem, ...] = ()
    radii: dict[str, float] = field(default_factory=dict)
    gazebo: tuple[GazeboPlugin, ...] = ()
    ros1: bool = False
    notes: tuple[str, ...] = ()

    @property
    def movable_joints(self) -> tuple[str, ...]:
        """The joints that are not fixed, in the order of the file."""
        return tuple(joint.name for joint in self.joints.values() if joint.type != "fixed")


def read_description(path: str | os.PathLike[str], *, mappings: Mapping[str, str] | None = None) -> Description:
    """Read a .urdf or .xacro file; `mappings` are xacro's arguments. RobotConfigError names every mistake."""
    file = Path(path)
    try:
        source = file.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise RobotConfigError(f"{path}: cannot be read: {reason}") from error
    if file.suffix == ".xacro" or "xmlns:xacro" in source:
        return parse_description(run_xacro(file, mappings or {}), str(path), source=source)
    return parse_description(source, str(path))


def parse_description(urdf: str, path: str = "<urdf>", *, source: str | None = None) -> Description:
    """Return the description of a URDF text; `source` is the xacro text it was made of, to find lines in."""
    document = read_document(urdf, path, source)
    root = document.root
    if root.tag != "robot":
        document.error(root, f"the root element is <{root.tag}>; a description starts with <robot name=...>")
    links = tuple(document.name(each) for each in root.children if each.tag == "link")
    joints = {each.name: each for each in (_joint(document, one) for one in root.children if one.tag == "joint")}
    _check_tree(document, links, joints)
    name = root.attributes.get("name", "")
    tags = [each for each in root.children if each.tag == "ros2_control"]
    old = [each for each in root.children if each.tag == "transmission"]
    gazebo = gazebo_plugins(root)
    hardware = tuple(_system(document, each, joints) for each in tags)
    if not tags and old:
        transmissions = _transmissions(document, old, joints)
        hardware = (_ros1_system(name, transmissions, gazebo),)
    _check_owners(document, hardware)
    document.raise_if_any()
    notes = tuple(_notes(path, hardware, old if tags else ()))
    return Description(path, urdf, name, links, joints, hardware, radii(root), gazebo, bool(old and not tags), notes)


# ------------------------------------------------------------------------------------------------------- the tree


def _joint(document: Document, element: Element) -> UrdfJoint:
    name = document.name(element)
    kind = element.attributes.get("type", "")
    if kind not in _JOINT_TYPES:
        document.error(element, f"joint {name}: type {kind!r}{nearest(kind, _JOINT_TYPES)}")
    origin, axis, limit = element.child("origin"), element.child("axis"), element.child("limit")
    if limit is None and kind in _NEEDS_LIMITS:
        document.error(element, f"joint {name}: a {kind} joint needs <limit lower= upper= effort= velocity=>")
    return UrdfJoint(
        name,
        kind,
        _link_of(document, element, "parent"),
        _link_of(document, element, "child"),
        document.vector(origin, "xyz", (0.0, 0.0, 0.0)),
        document.vector(origin, "rpy", (0.0, 0.0, 0.0)),
        document.vector(axis, "xyz", (1.0, 0.0, 0.0)),
        _limits(document, limit, kind),
        _mimic(document, element),
        element.line,
    )


def _link_of(document: Document, element: Element, tag: str) -> str:
    child = element.child(tag)
    if child is None or "link" not in child.attributes:
        document.error(element, f"joint {element.attributes.get('name', '?')}: <{tag} link=...> is missing")
        return ""
    return child.attributes["link"]


def _limits(document: Document, limit: Element | None, kind: str) -> Limits:
    if limit is None:
        return Limits()
    bounded = kind in _NEEDS_LIMITS
    return Limits(
        document.number(limit, "lower", 0.0) if bounded else -math.inf,
        document.number(limit, "upper", 0.0) if bounded else math.inf,
        document.number(limit, "velocity", math.inf),
        document.number(limit, "effort", math.inf),
    )


def _mimic(document: Document, element: Element) -> Mimic | None:
    mimic = element.child("mimic")
    if mimic is None:
        return None
    multiplier, offset = document.number(mimic, "multiplier", 1.0), document.number(mimic, "offset", 0.0)
    return Mimic(mimic.attributes.get("joint", ""), multiplier, offset)


def _check_tree(document: Document, links: tuple[str, ...], joints: dict[str, UrdfJoint]) -> None:
    parents: dict[str, str] = {}
    for joint in joints.values():
        for link in (joint.parent, joint.child):
            if link and link not in links:
                document.problem(joint.line, f"joint {joint.name}: no link {link!r}{nearest(link, links)}")
        if joint.child in parents:
            both = f"{parents[joint.child]}, {joint.name}"
            document.problem(joint.line, f"link {joint.child} hangs on two joints: {both}")
        parents[joint.child] = joint.name
        if joint.mimic is not None and joint.mimic.joint not in joints:
            wanted = joint.mimic.joint
            document.problem(
                joint.line, f"joint {joint.name} mimics {wanted!r}, no such joint{nearest(wanted, joints)}"
            )


# --------------------------------------------------------------------------------------------------- ros2_control


def _system(document: Document, element: Element, joints: dict[str, UrdfJoint]) -> Ros2ControlSystem:
    name, kind = document.name(element), element.attributes.get("type", "")
    if kind not in KINDS:
        document.error(element, f"<ros2_control name={name!r}>: type {kind!r}{nearest(kind, KINDS)}")
    for child in element.children:
        if child.tag not in _CHILDREN:
            document.error(child, f"<{child.tag}> has no place in <ros2_control>{nearest(child.tag, _CHILDREN)}")
    hardware = element.child("hardware")
    plugin = hardware.child("plugin") if hardware is not None else None
    if plugin is None or not plugin.text:
        document.error(element, f"<ros2_control name={name!r}>: <hardware><plugin>...</plugin></hardware> is missing")
    parts = {
        tag: tuple(_part(document, each, joints) for each in element.children if each.tag == tag)
        for tag in ("joint", "sensor", "gpio")
    }
    text = plugin.text if plugin is not None else ""
    parameters = hardware.parameters() if hardware is not None else {}
    own = _transmissions(document, [each for each in element.children if each.tag == "transmission"], joints)
    return Ros2ControlSystem(
        name, kind, text, parameters, parts["joint"], parts["sensor"], parts["gpio"], own, element.line
    )


def _part(document: Document, element: Element, joints: dict[str, UrdfJoint]) -> ControlJoint:
    name = document.name(element)
    commands = _interfaces(document, element, "command_interface")
    states = _interfaces(document, element, "state_interface")
    mimic = None
    if element.tag == "joint":
        urdf = joints.get(name)
        if urdf is None:
            document.error(element, f"<ros2_control> names joint {name!r}, no such joint{nearest(name, joints)}")
        elif urdf.type == "fixed":
            document.error(element, f"joint {name} is fixed; nothing can drive it: remove it from <ros2_control>")
        mimic = urdf.mimic if urdf is not None and element.attributes.get("mimic", "true") != "false" else None
        if mimic is not None and commands:
            document.error(element, f"joint {name} mimics {mimic.joint}; it has no command interface of its own")
    return ControlJoint(name, element.parameters(), commands, states, mimic, element.line)


def _interfaces(document: Document, element: Element, tag: str) -> dict[str, InterfaceInfo]:
    found: dict[str, InterfaceInfo] = {}
    for each in element.children:
        if each.tag != tag:
            continue
        name, parameters = document.name(each), each.parameters()
        if name in found:
            document.error(each, f"{element.attributes.get('name')}: {tag} {name!r} is given twice")
        low = document.decimal(each, parameters, "min", -math.inf)
        high = document.decimal(each, parameters, "max", math.inf)
        initial = document.decimal(each, parameters, "initial_value", math.nan)
        limited = _limited(element) and _limited(each)
        found[name] = InterfaceInfo(name, low, high, initial, parameters, limited)
    return found


def _limited(element: Element) -> bool:
    limits = element.child("limits")
    return limits is None or limits.attributes.get("enable", "true").strip().lower() != "false"


def _check_owners(document: Document, hardware: tuple[Ros2ControlSystem, ...]) -> None:
    """See to it that no interface is exported twice, and no tag name is used twice."""
    names: set[str] = set()
    owners: dict[str, str] = {}
    for system in hardware:
        if system.name in names:
            document.problem(system.line, f"two <ros2_control> tags are called {system.name!r}; rename one")
        names.add(system.name)
        for part in (*system.joints, *system.sensors, *system.gpios):
            if part.name in owners:
                where = f"{owners[part.name]} and {system.name}" if owners[part.name] != system.name else system.name
                document.problem(part.line, f"{part.name!r} stands twice in <ros2_control> ({where}); name it once")
            owners[part.name] = system.name


# ---------------------------------------------------------------------------------------------- transmissions, ROS 1


def _transmissions(
    document: Document, elements: Sequence[Element], joints: dict[str, UrdfJoint]
) -> tuple[Transmission, ...]:
    found: dict[str, Transmission] = {}
    for element in elements:
        each = read_transmission(document, element)
        if each.joint and each.joint not in joints:
            document.error(element, f"transmission {each.name}: no joint {each.joint!r}{nearest(each.joint, joints)}")
        if each.joint in found:
            document.error(element, f"joint {each.joint} has two transmissions: {found[each.joint].name}, {each.name}")
        found[each.joint] = each
    return tuple(found.values())


_STATES: Final = (POSITION, VELOCITY, EFFORT)
ROS1_SIMULATION: Final = "gazebo_ros_control/DefaultRobotHWSim"
ROS1_HARDWARE: Final = "canopen_control/CanopenSystem"


def _ros1_system(
    name: str, transmissions: tuple[Transmission, ...], gazebo: tuple[GazeboPlugin, ...]
) -> Ros2ControlSystem:
    """Return what a <ros2_control> tag would say: ROS 1 names the drives by the actuators of the transmissions."""
    simulated = any(each.filename.endswith("gazebo_ros_control.so") for each in gazebo)
    parts = tuple(
        ControlJoint(
            each.joint,
            {"device_name": each.actuator},
            {command: InterfaceInfo(command) for command in each.interfaces if command},
            {state: InterfaceInfo(state) for state in _STATES},
            line=each.line,
        )
        for each in transmissions
    )
    plugin = ROS1_SIMULATION if simulated else ROS1_HARDWARE
    line = transmissions[0].line if transmissions else 0
    return Ros2ControlSystem(name, "system", plugin, {}, parts, transmissions=transmissions, line=line)


def _notes(path: str, hardware: Sequence[Ros2ControlSystem], ignored: Sequence[Element]) -> Iterator[str]:
    for element in ignored:
        name = element.attributes.get("name", "")
        yield f"{path}:{element.line}: <transmission> {name} is ROS 1's and has no effect beside a <ros2_control> tag"
    for each in (one for system in hardware for one in system.transmissions if not one.trivial):
        drive, offset = each.actuator or "its drive", f", offset {each.offset:g}" if each.offset else ""
        yield (
            f"{path}:{each.line}: {each.joint} turns once for {each.reduction:g} turns of {drive}{offset}; "
            "the scales of bus.yml are those of the motor shaft"
        )
