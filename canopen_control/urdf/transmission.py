"""Transmissions of a description: what is between the shaft of a motor and a joint.

Both spellings are read: ROS 1's tag at the root (`<mechanicalReduction>`, `<hardwareInterface>`) and ros2_control's
inside its own tag (`<mechanical_reduction>`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from canopen_control.errors import nearest
from canopen_control.urdf.declared_interface import EFFORT, POSITION, VELOCITY
from canopen_control.urdf.document import NOWHERE, Place

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from canopen_control.urdf.document import Document, Element
    from canopen_control.urdf.joint_element import Joint

__all__ = ["HARDWARE_INTERFACES", "Transmission", "read_transmissions"]

SIMPLE: Final = "transmission_interface/SimpleTransmission"
HARDWARE_INTERFACES: Final = {
    "VelocityJointInterface": VELOCITY,
    "PositionJointInterface": POSITION,
    "EffortJointInterface": EFFORT,
    "PosVelJointInterface": VELOCITY,
    "JointStateInterface": "",
}
"""ROS 1's hardware interfaces (`hardware_interface/` may stand before them) and the command interface of each."""


@dataclass(frozen=True)
class Transmission:
    """A simple transmission: the actuator turns `reduction` times as far as the joint; `offset` in rad or m.

    `interfaces` are the command interfaces that a ROS 1 tag names; "" there is a joint that is only read.
    """

    name: str
    joint: str
    actuator: str
    reduction: float = 1.0
    offset: float = 0.0
    interfaces: tuple[str, ...] = ()
    place: Place = NOWHERE

    @property
    def trivial(self) -> bool:
        """Whether joint and actuator turn alike."""
        return self.reduction == 1.0 and self.offset == 0.0


def read_transmissions(
    document: Document, elements: Iterable[Element], joints: Mapping[str, Joint]
) -> tuple[Transmission, ...]:
    """Return the <transmission> tags, one for each joint; what is wrong in them is reported to the document."""
    found: dict[str, Transmission] = {}
    for element in elements:
        each = _transmission(document, element)
        if each.joint and each.joint not in joints:
            document.error(element, f"transmission {each.name}: no joint {each.joint!r}{nearest(each.joint, joints)}")
        if each.joint in found:
            document.error(element, f"joint {each.joint} has two transmissions: {found[each.joint].name}, {each.name}")
        found[each.joint] = each
    return tuple(found.values())


def _transmission(document: Document, element: Element) -> Transmission:
    name = document.name(element)
    kind = element.child("type") or element.child("plugin")
    if kind is None or kind.text.rpartition("/")[2] != "SimpleTransmission":
        said = f"is {kind.text!r}" if kind is not None else "is missing"
        document.error(element, f"transmission {name}: its type {said}; the one there is: {SIMPLE}")
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
        _interfaces(document, name, joint, actuator),
        element.place,
    )


def _reduction(
    document: Document, element: Element, joint: Element | None, actuator: Element | None
) -> tuple[float, float]:
    places = (actuator, joint, element)
    tags = [place.child(tag) for place in places if place is not None for tag in _REDUCTIONS]
    found = next((tag for tag in tags if tag is not None), None)
    offset = joint.child("offset") if joint is not None else None
    ratio = document.decimal(found, {"reduction": found.text}, "reduction", 1.0) if found is not None else 1.0
    if found is not None and ratio == 0.0:
        document.error(found, f"<{found.tag}> is 0; it is how often the motor turns per turn of the joint")
    moved = document.decimal(offset, {"offset": offset.text}, "offset", 0.0) if offset is not None else 0.0
    return ratio or 1.0, moved


_REDUCTIONS: Final = ("mechanicalReduction", "mechanical_reduction")


def _interfaces(document: Document, name: str, joint: Element | None, actuator: Element | None) -> tuple[str, ...]:
    """Return the command interfaces of the `<hardwareInterface>` tags, which older files have at the actuator."""
    found: list[str] = []
    for place in (joint, actuator):
        for each in place.children if place is not None else ():
            if each.tag != "hardwareInterface":
                continue
            short = each.text.removeprefix("hardware_interface/")
            if short not in HARDWARE_INTERFACES:
                hint = nearest(short, HARDWARE_INTERFACES)
                document.error(each, f"transmission {name}: no hardwareInterface {each.text!r}{hint}")
            else:
                found.append(HARDWARE_INTERFACES[short])
    return tuple(dict.fromkeys(found))
