"""Tags <ros2_control> and <transmission> of a robot description: hardware, joints and their interfaces."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from canopen_control.errors import nearest
from canopen_control.urdf.document import NOWHERE, ElementPlace
from canopen_control.urdf.joint_element import EFFORT, POSITION, VELOCITY, InterfaceInfo, read_interfaces

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from canopen_control.urdf.document import Element, UrdfDocument
    from canopen_control.urdf.joint_element import Joint, Mimic


# -- transmissions between the shaft of a motor and a joint, in both spellings: ROS 1's tag in the root element
# (`<mechanicalReduction>`, `<hardwareInterface>`), and the tag inside <ros2_control> (`<mechanical_reduction>`)


SIMPLE: Final = "transmission_interface/SimpleTransmission"
HARDWARE_INTERFACES: Final = {
    "VelocityJointInterface": VELOCITY,
    "PositionJointInterface": POSITION,
    "EffortJointInterface": EFFORT,
    "PosVelJointInterface": VELOCITY,
    "JointStateInterface": "",
}
"""Command interface of each ROS 1 hardware interface, whose names may have the prefix `hardware_interface/`."""


@dataclass(frozen=True)
class Transmission:
    """Simple transmission: the actuator turns `reduction` times as far as the joint; `offset` is in rad or m.

    `interfaces` are the command interfaces in a ROS 1 tag; "" stands for a joint that is only read.
    """

    name: str
    joint: str
    actuator: str
    reduction: float = 1.0
    offset: float = 0.0
    interfaces: tuple[str, ...] = ()
    place: ElementPlace = NOWHERE

    @property
    def trivial(self) -> bool:
        """Whether the joint always has the same position as the actuator."""
        return self.reduction == 1.0 and self.offset == 0.0


def read_transmissions(
    document: UrdfDocument, elements: Iterable[Element], joints: Mapping[str, Joint]
) -> tuple[Transmission, ...]:
    """Return the transmissions in <transmission> tags, one per joint; record errors in the document."""
    transmissions: dict[str, Transmission] = {}
    for element in elements:
        part = _transmission(document, element)
        if part.joint and part.joint not in joints:
            document.error(
                element,
                f"transmission {part.name}: no joint {part.joint!r}{nearest(part.joint, joints)}",
            )
        if part.joint in transmissions:
            document.error(
                element,
                f"joint {part.joint} has two transmissions: {transmissions[part.joint].name}, {part.name}",
            )
        transmissions[part.joint] = part
    return tuple(transmissions.values())


def _transmission(document: UrdfDocument, element: Element) -> Transmission:
    name = document.name(element)
    kind = element.child("type") or element.child("plugin")
    if kind is None or kind.text.rpartition("/")[2] != "SimpleTransmission":
        problem = f"is {kind.text!r}" if kind is not None else "is missing"
        document.error(element, f"transmission {name}: its type {problem}; only {SIMPLE} is supported")
    joint, actuator = element.child("joint"), element.child("actuator")
    if joint is None:
        document.error(element, f"transmission {name}: <joint name=...> is missing")
    reduction, offset = _reduction(document, element, joint, actuator)
    return Transmission(
        name,
        joint.attributes.get("name", "") if joint is not None else "",
        actuator.attributes.get("name", "") if actuator is not None else "",
        reduction,
        offset,
        _transmission_interfaces(document, name, joint, actuator),
        element.place,
    )


def _reduction(
    document: UrdfDocument, element: Element, joint: Element | None, actuator: Element | None
) -> tuple[float, float]:
    places = (actuator, joint, element)
    tags = [place.child(tag) for place in places if place is not None for tag in _REDUCTIONS]
    value = next((tag for tag in tags if tag is not None), None)
    offset = joint.child("offset") if joint is not None else None
    ratio = document.decimal(value, {"reduction": value.text}, "reduction", 1.0) if value is not None else 1.0
    if value is not None and ratio == 0.0:
        document.error(value, f"<{value.tag}> is 0; give the turns of the motor per turn of the joint")
    moved = document.decimal(offset, {"offset": offset.text}, "offset", 0.0) if offset is not None else 0.0
    return ratio or 1.0, moved


_REDUCTIONS: Final = ("mechanicalReduction", "mechanical_reduction")


def _transmission_interfaces(
    document: UrdfDocument, name: str, joint: Element | None, actuator: Element | None
) -> tuple[str, ...]:
    """Return the command interfaces in the <hardwareInterface> tags of the joint or, in older files, the actuator."""
    interfaces: list[str] = []
    for place in (joint, actuator):
        for child in place.children if place is not None else ():
            if child.tag != "hardwareInterface":
                continue
            short = child.text.removeprefix("hardware_interface/")
            if short not in HARDWARE_INTERFACES:
                hint = nearest(short, HARDWARE_INTERFACES)
                document.error(child, f"transmission {name}: unknown hardwareInterface {child.text!r}{hint}")
            else:
                interfaces.append(HARDWARE_INTERFACES[short])
    return tuple(dict.fromkeys(interfaces))


KINDS: Final = ("system", "actuator", "sensor")
_CHILDREN: Final = ("hardware", "properties", "joint", "sensor", "gpio", "transmission")
_NODE_ID: Final = re.compile(r"[0-9]{1,9}|0[xX][0-9A-Fa-f]{1,8}", re.ASCII)
_PART_CHILDREN: Final = ("command_interface", "state_interface", "param", "limits")


@dataclass(frozen=True)
class ControlJoint:
    """Tag <joint>, <sensor> or <gpio> of a <ros2_control> tag, with its interfaces by name."""

    name: str
    parameters: dict[str, str] = field(default_factory=dict)
    command_interfaces: dict[str, InterfaceInfo] = field(default_factory=dict)
    state_interfaces: dict[str, InterfaceInfo] = field(default_factory=dict)
    mimic: Mimic | None = None
    place: ElementPlace = NOWHERE


@dataclass(frozen=True)
class Ros2ControlSystem:
    """Tag <ros2_control>, which defines a hardware component: `kind` is system, actuator or sensor."""

    name: str
    kind: str
    plugin: str
    parameters: dict[str, str] = field(default_factory=dict)
    joints: tuple[ControlJoint, ...] = ()
    sensors: tuple[ControlJoint, ...] = ()
    gpios: tuple[ControlJoint, ...] = ()
    transmissions: tuple[Transmission, ...] = ()
    place: ElementPlace = NOWHERE


def read_system(document: UrdfDocument, element: Element, joints: Mapping[str, Joint]) -> Ros2ControlSystem:
    """Return the hardware component of a <ros2_control> tag; record errors in the document."""
    name, kind = document.name(element), element.attributes.get("type", "")
    if kind not in KINDS:
        document.error(element, f"<ros2_control name={name!r}>: type {kind!r}{nearest(kind, KINDS)}")
    for child in element.children:
        if child.tag not in _CHILDREN:
            document.error(child, f"<{child.tag}> is not allowed in <ros2_control>{nearest(child.tag, _CHILDREN)}")
    hardware = element.child("hardware")
    plugin = hardware.child("plugin") if hardware is not None else None
    if hardware is not None:
        _note_repeated(document, hardware, f"<ros2_control name={name!r}>")
    if plugin is None or not plugin.text:
        document.error(element, f"<ros2_control name={name!r}>: <hardware><plugin>...</plugin></hardware> is missing")
    parts = {
        tag: tuple(_part(document, child, joints) for child in element.children if child.tag == tag)
        for tag in ("joint", "sensor", "gpio")
    }
    text = plugin.text if plugin is not None else ""
    parameters = hardware.parameters() if hardware is not None else {}
    transmissions = read_transmissions(
        document, [child for child in element.children if child.tag == "transmission"], joints
    )
    return Ros2ControlSystem(
        name, kind, text, parameters, parts["joint"], parts["sensor"], parts["gpio"], transmissions, element.place
    )


def _part(document: UrdfDocument, element: Element, joints: Mapping[str, Joint]) -> ControlJoint:
    name = document.name(element)
    for child in element.children:  # others are ignored, as ros2_control does
        if child.tag not in _PART_CHILDREN and (hint := nearest(child.tag, _PART_CHILDREN, listed=False)):
            document.error(child, f"<{child.tag}> is not allowed in <{element.tag}>{hint}")
    _note_repeated(document, element, f"<{element.tag} name={name!r}>")
    commands = read_interfaces(document, element, "command_interface")
    states = read_interfaces(document, element, "state_interface")
    mimic = None
    if element.tag == "joint":
        urdf = joints.get(name)
        if urdf is None:
            document.error(element, f"<ros2_control> names joint {name!r}, which does not exist{nearest(name, joints)}")
        elif urdf.type == "fixed":
            document.error(element, f"joint {name} is fixed and cannot be driven; remove it from <ros2_control>")
        mimic = urdf.mimic if urdf is not None and element.attributes.get("mimic", "true") != "false" else None
        if mimic is not None and commands:
            # ros2_control's component parser has the same rule, and the same attribute
            document.error(
                element,
                f"joint {name} mimics {mimic.joint}, so it has no command interface of its own; remove its command "
                f'interfaces, or give it mimic="false" if it has its own drive',
            )
    return ControlJoint(name, _plain_node_id(element.parameters()), commands, states, mimic, element.place)


def _plain_node_id(parameters: dict[str, str]) -> dict[str, str]:
    """Return the parameters of a joint with its `node_id` as a plain number: `02` is 2, as for ros2_canopen."""
    text = parameters.get("node_id", "")
    if _NODE_ID.fullmatch(text):
        return parameters | {"node_id": str(int(text, 10 if text.isdigit() else 16))}
    return parameters


def _note_repeated(document: UrdfDocument, element: Element, owner: str) -> None:
    """Note plugins and parameters that are given twice: ros2_control uses the first plugin, and the last value."""
    seen: dict[str, Element] = {}
    for child in element.children:
        what = child.tag if child.tag == "plugin" else f"param {child.attributes.get('name', '')!r}"
        if child.tag not in ("plugin", "param"):
            continue
        first = seen.setdefault(what, child)
        if first is not child:
            used = first.text if child.tag == "plugin" else child.text
            document.note(child, f"{owner}: {what} is given twice, and {used!r} applies; remove the other")


def check_ranges(document: UrdfDocument, hardware: Sequence[Ros2ControlSystem], joints: Mapping[str, Joint]) -> None:
    """Report empty ranges: reversed bounds, or bounds of a position that do not overlap the joint's <limit>."""
    for part in (part for system in hardware for part in (*system.joints, *system.gpios)):
        joint = joints.get(part.name)
        low, high = (-math.inf, math.inf) if joint is None else joint.range_of(POSITION)
        if low > high and joint is not None:
            document.error(
                joint, f"joint {part.name}: lower {low:g} of <limit> is greater than upper {high:g}; exchange them"
            )
        for name, bounds in part.command_interfaces.items():
            least, most = bounds.minimum, bounds.maximum
            if not bounds.limited:
                continue
            if least > most:
                text = f"{part.name}: min {least:g} of the command interface {name!r} is greater than max {most:g}"
                document.error(part, f"{text}; exchange them")
            elif name == POSITION and low <= high and max(low, least) > min(high, most):
                text = f"{part.name}: min {least:g} to max {most:g} of the command interface {name!r} lies outside"
                document.error(part, f"{text} the joint's <limit>, {low:g} to {high:g}; correct one of the two")


def check_owners(document: UrdfDocument, hardware: Sequence[Ros2ControlSystem]) -> None:
    """Report interfaces that are exported twice, and duplicate names of <ros2_control> tags or of their parts."""
    names: set[str] = set()
    owners: dict[str, str] = {}
    exported: dict[tuple[str, str], str] = {}
    for system in hardware:
        if system.name in names:
            document.error(system, f"two <ros2_control> tags have the name {system.name!r}; rename one")
        names.add(system.name)
        for part in (*system.joints, *system.sensors, *system.gpios):
            interfaces = [(kind, f"{part.name}/{interface}") for kind, interface in _interfaces(part)]
            twice = next((exported[interface] for interface in interfaces if interface in exported), None)
            if owners.get(part.name) == system.name or twice is not None:
                where = f"{twice} and {system.name}" if twice not in (None, system.name) else system.name
                document.error(part, f"{part.name!r} is defined twice in <ros2_control> ({where}); remove one")
            owners[part.name] = system.name
            exported.update((interface, system.name) for interface in interfaces)


def _interfaces(part: ControlJoint) -> Iterator[tuple[str, str]]:
    """Yield the interfaces of a part as pairs of kind and name.

    Both are compared, because a joint may be in two tags, one for an actuator and one for a sensor (ros2_control).
    """
    yield from (("command", name) for name in part.command_interfaces)
    yield from (("state", name) for name in part.state_interfaces)


_STATES: Final = (POSITION, VELOCITY, EFFORT)
ROS1_SIMULATION: Final = "gazebo_ros_control/DefaultRobotHWSim"
ROS1_HARDWARE: Final = "canopen_control/CanopenSystem"


def system_of_ros1(name: str, transmissions: tuple[Transmission, ...], *, simulated: bool) -> Ros2ControlSystem:
    """Return a <ros2_control> system that is equivalent to the ROS 1 transmissions."""
    parts = tuple(
        ControlJoint(
            transmission.joint,
            {"device_name": transmission.actuator},
            {command: InterfaceInfo(command) for command in transmission.interfaces if command},
            {state: InterfaceInfo(state) for state in _STATES},
            place=transmission.place,
        )
        for transmission in transmissions
    )
    plugin = ROS1_SIMULATION if simulated else ROS1_HARDWARE
    place = transmissions[0].place if transmissions else NOWHERE
    return Ros2ControlSystem(name, "system", plugin, {}, parts, transmissions=transmissions, place=place)
