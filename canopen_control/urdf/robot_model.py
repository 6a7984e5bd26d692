"""The links and joints of a description as a tree."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

from canopen_control.errors import nearest
from canopen_control.urdf.document import read_document
from canopen_control.urdf.joint_element import read_joint
from canopen_control.urdf.link_element import read_links

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from canopen_control.urdf.document import Document
    from canopen_control.urdf.joint_element import Joint
    from canopen_control.urdf.link_element import Link

__all__ = ["RobotModel", "model_of", "read_model"]


@dataclass(frozen=True)
class RobotModel:
    """A robot's links and joints by name, in the order of the file; `notes` say what of it cannot be drawn."""

    name: str
    links: dict[str, Link] = field(default_factory=dict)
    joints: dict[str, Joint] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    @property
    def root(self) -> str:
        """The link that hangs on no joint, the first of several; of a circle, the first link of the file."""
        children = {joint.child for joint in self.joints.values()}
        free = (link for link in self.links if link not in children)
        return next(free, next(iter(self.links), "base"))

    @cached_property
    def from_root(self) -> tuple[Joint, ...]:
        """The joints that hang on the root, each once and after the one that it hangs on."""
        return tuple(_parents_first(self.root, list(self.joints.values())))


def read_model(urdf: str, path: str = "<urdf>") -> RobotModel:
    """Return the links and joints of a URDF text; RobotConfigError names every mistake in them."""
    document = read_document(urdf, path)
    model = model_of(document)
    document.raise_if_any()
    return model


def model_of(document: Document) -> RobotModel:
    """Return the links and joints of a description; what is wrong in them is reported to the document."""
    root, notes = document.root, list[str]()
    if root.tag != "robot":
        document.error(root, f"the root element is <{root.tag}>; a description starts with <robot name=...>")
    links = read_links(document, notes)
    joints = document.by_name((each, read_joint(document, each)) for each in root.children if each.tag == "joint")
    _check_tree(document, links, joints)
    return RobotModel(root.attributes.get("name", ""), links, joints, tuple(notes))


def _parents_first(root: str, left: list[Joint]) -> Iterator[Joint]:
    reached = {root}
    while now := [joint for joint in left if joint.parent in reached and joint.child not in reached]:
        for joint in now:
            if joint.child not in reached:
                reached.add(joint.child)
                yield joint
        left = [joint for joint in left if joint.child not in reached]


def _check_tree(document: Document, links: Mapping[str, Link], joints: Mapping[str, Joint]) -> None:
    parents: dict[str, str] = {}
    for joint in joints.values():
        for link in (joint.parent, joint.child):
            if link and link not in links:
                document.error(joint, f"joint {joint.name}: no link {link!r}{nearest(link, links)}")
        if joint.child in parents:
            both = f"{parents[joint.child]}, {joint.name}"
            document.error(joint, f"link {joint.child} hangs on two joints: {both}")
        parents[joint.child] = joint.name
        if joint.mimic is not None and joint.mimic.joint not in joints:
            wanted = joint.mimic.joint
            document.error(joint, f"joint {joint.name} mimics {wanted!r}, no such joint{nearest(wanted, joints)}")
