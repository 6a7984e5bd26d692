"""Reader of ROS launch files in YAML, which returns the elements of the equivalent XML file (launch_yaml of ROS 2).

An entity is a mapping with one key, the tag. Scalars are attributes; a list of mappings becomes one child for each
mapping, with the key as the tag. The entities of a `group` are in a list, or below `children`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.errors import RobotConfigError
from canopen_control.urdf.document import Element, ElementPlace
from canopen_control.yamlfile.reader import read

if TYPE_CHECKING:
    from canopen_control.yamlfile.node import Node


def read_yaml_launch(source: str, path: str) -> Element:
    """Parse a YAML launch file and return the root element `launch`; RobotConfigError lists all errors."""
    document = read(source, path, error=RobotConfigError, strict=False)
    document.problems.raise_if_any(RobotConfigError)
    launch = document.get("launch")
    if launch is None or launch.kind != "sequence":
        raise RobotConfigError(f"{path}: not a launch file, since the key `launch` has no list")
    return _with_entities(Element("launch", {}, _place(launch)), launch)


def _place(node: Node) -> ElementPlace:
    return ElementPlace(node.line, node.column)


def _with_entities(parent: Element, entities: Node) -> Element:
    for entity in entities.elements():
        parent.children += [_element(tag, content) for tag, content in entity.items()]
    return parent


def _element(tag: str, content: Node) -> Element:
    """Return the XML element for a launch entity or for a child such as `param`."""
    element = Element(tag, {}, _place(content))
    if content.kind == "sequence":  # a group
        return _with_entities(element, content)
    for key, value in content.items():
        if key == "children":
            _with_entities(element, value)
        elif value.kind == "sequence":
            element.children += [_element(key, child) for child in value.elements()]
        elif value.kind == "mapping":
            element.children.append(_element(key, value))
        else:
            element.attributes[key] = value.text
    return element
