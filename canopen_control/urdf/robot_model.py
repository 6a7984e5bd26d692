"""Tree of the links and joints of a robot description: `<link>` elements with their shapes, and wheel geometry.

A shape that cannot be drawn is not an error, because joints can move without it: it is omitted and listed in the
notes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Final

from canopen_control.errors import nearest
from canopen_control.urdf.document import NOWHERE, ElementPlace, read_document
from canopen_control.urdf.geometry import ORIGIN, Pose, Vector, from_rpy, rotate
from canopen_control.urdf.joint_element import read_joint

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from canopen_control.urdf.document import Element, UrdfDocument
    from canopen_control.urdf.joint_element import Joint


GREY: Final = (160, 165, 172)
_ROUND: Final = ("cylinder", "sphere")
_ZERO: Final = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Visual:
    """Visual shape of a link, with its pose in the frame of the link; lengths are in m.

    `size` is x, y, z of a box; radius and length of a cylinder along z; radius of a sphere; the scale of a mesh, whose
    `file` is the URI in the URDF. `color` is red, green and blue from 0 to 255, `opacity` is from 0 to 1.
    """

    shape: str
    size: tuple[float, ...]
    pose: Pose = ORIGIN
    color: tuple[int, int, int] = GREY
    opacity: float = 1.0
    file: str = ""


@dataclass(frozen=True, slots=True)
class UrdfLink:
    """Link of the robot with its visual shapes; `place` is the line and column of the tag.

    `radius` in m is that of the only cylinder or sphere in <collision>, or else in <visual>; None if neither has
    exactly one.
    """

    name: str
    visuals: tuple[Visual, ...] = ()
    radius: float | None = None
    place: ElementPlace = NOWHERE


def read_links(document: UrdfDocument, notes: list[str]) -> dict[str, UrdfLink]:
    """Return the links of a `<robot>` by name; append to `notes` a text for each shape that cannot be drawn."""
    children = document.root.children
    materials = {
        child.attributes.get("name", ""): color
        for child in children
        if child.tag == "material" and (color := _rgba(child)) is not None
    }
    links = (child for child in children if child.tag == "link")
    return document.by_name((child, _link(document, child, materials, notes)) for child in links)


def _link(document: UrdfDocument, element: Element, materials: Mapping[str, _Rgba], notes: list[str]) -> UrdfLink:
    name = document.name(element)
    visuals = tuple(_visuals(element, materials, notes))
    radii = (_radius([child for child in element.children if child.tag == tag]) for tag in ("collision", "visual"))
    return UrdfLink(name, visuals, next((radius for radius in radii if radius is not None), None), element.place)


def _radius(elements: Sequence[Element]) -> float | None:
    """Return the radius of the cylinder or sphere in <collision> or <visual> tags; None unless there is exactly one."""
    geometries = [geometry.children for element in elements if (geometry := element.child("geometry")) is not None]
    round_ones = [child for children in geometries for child in children if child.tag in _ROUND]
    size = _lengths(round_ones[0], "radius") if len(round_ones) == 1 else None
    return None if size is None else size[0]


def _visuals(link: Element, materials: Mapping[str, _Rgba], notes: list[str]) -> Iterator[Visual]:
    for element in link.children:
        if element.tag != "visual":
            continue
        geometry = element.child("geometry")
        shape = next(iter(geometry.children), None) if geometry is not None else None
        size = _SIZES[shape.tag](shape) if shape is not None and shape.tag in _SIZES else None
        if shape is None or size is None:
            content = "nothing" if shape is None else f"<{shape.tag}>"
            why = " without its size" if shape is not None and shape.tag in _SIZES else ""
            name = link.attributes.get("name")
            notes.append(f"link {name}: {content}{why} is not drawn; use a box, cylinder, sphere or mesh")
            continue
        red, green, blue, opacity = _color(element, materials)
        color = (round(255 * red), round(255 * green), round(255 * blue))
        yield Visual(shape.tag, size, _origin(element), color, opacity, shape.attributes.get("filename", ""))


_Rgba = tuple[float, float, float, float]


def _color(visual: Element, materials: Mapping[str, _Rgba]) -> _Rgba:
    material = visual.child("material")
    default = (GREY[0] / 255, GREY[1] / 255, GREY[2] / 255, 1.0)
    if material is None:
        return default
    return _rgba(material) or materials.get(material.attributes.get("name", ""), default)


def _rgba(material: Element) -> _Rgba | None:
    values = _numbers(material.child("color"), "rgba")
    if values is None or len(values) != 4:
        return None
    red, green, blue, opacity = (min(max(value, 0.0), 1.0) for value in values)
    return red, green, blue, opacity


def _origin(element: Element) -> Pose:
    origin = element.child("origin")
    return Pose(_vector(origin, "xyz") or _ZERO, from_rpy(_vector(origin, "rpy") or _ZERO))


def _vector(element: Element | None, key: str) -> Vector | None:
    values = _numbers(element, key)
    return (values[0], values[1], values[2]) if values is not None and len(values) == 3 else None


def _lengths(element: Element, *keys: str) -> tuple[float, ...] | None:
    values = [numbers[0] for key in keys if (numbers := _numbers(element, key)) is not None and len(numbers) == 1]
    return tuple(map(abs, values)) if len(values) == len(keys) else None


def _numbers(element: Element | None, key: str) -> list[float] | None:
    """Return the numbers in an attribute, or None if the attribute is missing or a number is invalid."""
    try:
        values = [float(word) for word in element.attributes[key].split()] if element is not None else None
    except (KeyError, ValueError):
        return None
    return values if values is not None and all(map(math.isfinite, values)) else None


_SIZES: Final[dict[str, Callable[[Element], tuple[float, ...] | None]]] = {
    "box": lambda element: _vector(element, "size"),
    "cylinder": lambda element: _lengths(element, "radius", "length"),
    "sphere": lambda element: _lengths(element, "radius"),
    "mesh": lambda element: _vector(element, "scale") or (1.0, 1.0, 1.0),
}


# Wheel geometry (ros_controllers noetic): the separation is the distance between the origins of two wheel joints in the
# xy plane; the radius is that of the only cylinder or sphere of the wheel's link. In addition, joints of different
# links are traced through fixed joints to a common link. A value that the description lacks is None, never a guess.


class WheelGeometry:
    """Wheel dimensions in m, derived from the joints and links of a description."""

    def __init__(self, model: RobotModel) -> None:
        self._joints, self._links = model.joints, model.links
        self._above = {joint.child: joint for joint in model.joints.values()}

    def separation(self, left: Sequence[str], right: Sequence[str]) -> float | None:
        """Return the distance in m between the left and right wheels, or None if it is unknown.

        It is the distance in the xy plane between the mean positions of the wheel joints on each side.
        """
        sides = [[self.place(name) for name in side] for side in (left, right)]
        if not all(sides) or any(place is None for side in sides for place in side):
            return None
        places = [[place for place in side if place is not None] for side in sides]
        if len({root for side in places for root, _ in side}) != 1:
            return None
        means = [tuple(sum(point[axis] for _, point in side) / len(side) for axis in range(2)) for side in places]
        return math.dist(means[0], means[1])

    def radius(self, wheels: Sequence[str]) -> float | None:
        """Return the common radius of the wheels of these joints, or None if it is unknown or they differ."""
        radii = {self._radius(name) for name in wheels}
        return radii.pop() if len(radii) == 1 else None

    def _radius(self, wheel: str) -> float | None:
        joint = self._joints.get(wheel)
        link = self._links.get(joint.child) if joint is not None else None
        return None if link is None else link.radius

    def place(self, joint: str) -> tuple[str, Vector] | None:
        """Return the topmost link rigidly connected to a joint's parent, with the joint's position in it; or None."""
        element = self._joints.get(joint)
        if element is None:
            return None
        point, link = element.origin.position, element.parent
        visited = {link}
        while (above := self._above.get(link)) is not None and above.fixed and above.parent not in visited:
            point, link = above.origin.of(point), above.parent
            visited.add(link)
        return link, point

    def axis(self, joint: str) -> Vector | None:
        """Return the axis of a joint in the frame of its parent link, or None for an unknown joint."""
        element = self._joints.get(joint)
        return None if element is None else rotate(element.origin.rotation, element.axis)


@dataclass(frozen=True)
class RobotModel:
    """Links and joints of a robot by name, in the order of the file; `notes` describe shapes that are not drawn."""

    name: str
    links: dict[str, UrdfLink] = field(default_factory=dict)
    joints: dict[str, Joint] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    @property
    def root(self) -> str:
        """First link without a parent joint, or the first link of the file if all links have a parent joint."""
        children = {joint.child for joint in self.joints.values()}
        free = (link for link in self.links if link not in children)
        return next(free, next(iter(self.links), "base"))

    @cached_property
    def from_root(self) -> tuple[Joint, ...]:
        """Joints connected to the root, each listed after the joint of its parent link."""
        return tuple(_parents_first(self.root, list(self.joints.values())))


def read_model(urdf: str, path: str = "<urdf>") -> RobotModel:
    """Return the links and joints of a URDF text; raise RobotConfigError with all errors in it."""
    document = read_document(urdf, path)
    model = model_of(document)
    document.raise_if_any()
    return model


def model_of(document: UrdfDocument) -> RobotModel:
    """Return the links and joints of a document; record errors in the document."""
    root, notes = document.root, list[str]()
    if root.tag != "robot":
        document.error(root, f"the root element is <{root.tag}>; a description starts with <robot name=...>")
    links = read_links(document, notes)
    joints = document.by_name((child, read_joint(document, child)) for child in root.children if child.tag == "joint")
    _check_tree(document, links, joints)
    return RobotModel(root.attributes.get("name", ""), links, joints, tuple(notes))


def _parents_first(root: str, remaining: list[Joint]) -> Iterator[Joint]:
    reached = {root}
    while now := [joint for joint in remaining if joint.parent in reached and joint.child not in reached]:
        for joint in now:
            if joint.child not in reached:
                reached.add(joint.child)
                yield joint
        remaining = [joint for joint in remaining if joint.child not in reached]


def _check_tree(document: UrdfDocument, links: Mapping[str, UrdfLink], joints: Mapping[str, Joint]) -> None:
    parents: dict[str, str] = {}
    for joint in joints.values():
        for link in (joint.parent, joint.child):
            if link and link not in links:
                document.error(joint, f"joint {joint.name}: link {link!r} does not exist{nearest(link, links)}")
        if joint.child in parents:
            both = f"{parents[joint.child]}, {joint.name}"
            document.error(joint, f"link {joint.child} is the child of two joints: {both}")
        parents[joint.child] = joint.name
        if joint.mimic is not None and joint.mimic.joint not in joints:
            mimicked = joint.mimic.joint
            document.error(
                joint, f"joint {joint.name} mimics {mimicked!r}, which does not exist{nearest(mimicked, joints)}"
            )
