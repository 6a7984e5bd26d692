"""Tree of the links and joints of a robot description, and the wheel geometry derived from the tree."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

from canopen_control.errors import nearest
from canopen_control.urdf.document import read_document
from canopen_control.urdf.geometry import rotate
from canopen_control.urdf.joint_element import read_joint
from canopen_control.urdf.link_element import read_links

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from canopen_control.urdf.document import UrdfDocument
    from canopen_control.urdf.geometry import Vector
    from canopen_control.urdf.joint_element import Joint
    from canopen_control.urdf.link_element import UrdfLink


# Wheel geometry (ros_controllers noetic): the separation is the distance between the origins of two wheel joints in the
# xy plane; the radius is that of the only cylinder or sphere of the wheel's link. In addition, joints of different
# links are traced through fixed joints to a common link. A value that the description lacks is None, never a guess.


class WheelGeometry:
    """Wheel dimensions in m, derived from the joints and links of a description."""

    def __init__(self, model: RobotModel) -> None:
        self._joints, self._links = model.joints, model.links
        self._above = {joint.child: joint for joint in model.joints.values()}

    def separation(self, left: Sequence[str], right: Sequence[str]) -> float | None:
        """Return the distance in m between the left and right wheels, or None if unknown.

        The distance is that of the mean positions of the wheel joints of both sides, in the xy plane.
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
        """Return the common radius of the wheels, named by their joints, or None if unknown or not equal."""
        radii = {self._radius(name) for name in wheels}
        return radii.pop() if len(radii) == 1 else None

    def _radius(self, wheel: str) -> float | None:
        joint = self._joints.get(wheel)
        link = self._links.get(joint.child) if joint is not None else None
        return None if link is None else link.radius

    def place(self, joint: str) -> tuple[str, Vector] | None:
        """Return the topmost link rigidly connected to a joint's parent, and the joint's position in it."""
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
    """Links and joints of a robot by name, in the order of the file; `notes` are about shapes that are not drawn."""

    name: str
    links: dict[str, UrdfLink] = field(default_factory=dict)
    joints: dict[str, Joint] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    @property
    def root(self) -> str:
        """First link without a parent joint; the first link of the file if all links have one."""
        children = {joint.child for joint in self.joints.values()}
        free = (link for link in self.links if link not in children)
        return next(free, next(iter(self.links), "base"))

    @cached_property
    def from_root(self) -> tuple[Joint, ...]:
        """Joints connected to the root, each after the joint of its parent link."""
        return tuple(_parents_first(self.root, list(self.joints.values())))


def read_model(urdf: str, path: str = "<urdf>") -> RobotModel:
    """Return the links and joints of a URDF text; RobotConfigError lists all errors in it."""
    document = read_document(urdf, path)
    model = model_of(document)
    document.raise_if_any()
    return model


def model_of(document: UrdfDocument) -> RobotModel:
    """Return the links and joints of a document; errors are added to the document."""
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
