"""What of a URDF can be seen: links with their shapes, and the joints between them.

The law of this file: the runtime has accepted the description already, so that nothing here refuses it. What cannot be
drawn is left out and told in `notes`; a tree with no root or a circle draws what hangs on the first link.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET  # the text comes from the user's own runtime
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from canopen_control.view.pose import IDENTITY, Quaternion, Vector, about, from_rpy, multiply, rotate

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

__all__ = ["Joint", "Model", "Visual", "joint_pose", "read_model"]

GREY: Final = (160, 165, 172)
_TURNING: Final = ("revolute", "continuous")
_ZERO: Final = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Visual:
    """One shape in the frame of its link, in m.

    `size` is x, y, z of a box; radius and length of a cylinder, which stands along z; radius of a sphere; the scale of
    a mesh, whose `file` is as the URDF writes it. `color` is red, green, blue to 255, `opacity` 0 to 1.
    """

    shape: str
    size: tuple[float, ...]
    position: Vector = _ZERO
    wxyz: Quaternion = IDENTITY
    color: tuple[int, int, int] = GREY
    opacity: float = 1.0
    file: str = ""


@dataclass(frozen=True, slots=True)
class Joint:
    """A joint at `position` and `wxyz` in the frame of its parent; limits in rad or m, rad/s or m/s, Nm or N."""

    name: str
    kind: str
    parent: str
    child: str
    position: Vector = _ZERO
    wxyz: Quaternion = IDENTITY
    axis: Vector = (1.0, 0.0, 0.0)
    mimic: tuple[str, float, float] | None = None
    lower: float | None = None
    upper: float | None = None
    velocity: float | None = None
    effort: float | None = None


@dataclass(frozen=True, slots=True)
class Model:
    """A robot to draw; `joints` come parents first, `visuals` by link."""

    name: str
    root: str
    joints: tuple[Joint, ...] = ()
    visuals: dict[str, tuple[Visual, ...]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def angle(self, joint: Joint, positions: Mapping[str, float | None]) -> float | None:
        """Return where a joint stands, a mimicking one by whom it mimics; None if nobody knows."""
        if joint.mimic is None:
            return positions.get(joint.name)
        leader, multiplier, offset = joint.mimic
        position = positions.get(leader)
        return None if position is None else multiplier * position + offset


def joint_pose(joint: Joint, angle: float) -> tuple[Vector, Quaternion]:
    """Return position and rotation of a joint's child in its parent's frame."""
    if joint.kind in _TURNING:
        return joint.position, multiply(joint.wxyz, about(joint.axis, angle))
    if joint.kind != "prismatic":
        return joint.position, joint.wxyz
    length = math.hypot(*joint.axis) or 1.0
    way = rotate(
        joint.wxyz, (joint.axis[0] * angle / length, joint.axis[1] * angle / length, joint.axis[2] * angle / length)
    )
    return (joint.position[0] + way[0], joint.position[1] + way[1], joint.position[2] + way[2]), joint.wxyz


def read_model(urdf: str) -> Model:
    """Return what can be drawn of a URDF text; of one that is no XML, nothing but a note."""
    notes: list[str] = []
    try:
        root = ET.fromstring(urdf)
    except ET.ParseError as error:
        return Model("robot", "base", notes=(f"the description cannot be drawn: {error}",))
    links = [element.get("name", "") for element in root.findall("link")]
    joints = [_joint(element) for element in root.findall("joint")]
    children = {joint.child for joint in joints}
    base = next((link for link in links if link not in children), links[0] if links else "base")
    materials = {
        element.get("name", ""): color for element in root.findall("material") if (color := _rgba(element)) is not None
    }
    visuals = {element.get("name", ""): tuple(_visuals(element, materials, notes)) for element in root.findall("link")}
    return Model(root.get("name", "robot"), base, tuple(_sorted(base, joints)), visuals, tuple(notes))


def _sorted(base: str, joints: list[Joint]) -> Iterator[Joint]:
    """Yield the joints that hang on `base`, parents first, each once."""
    reached, left = {base}, list(joints)
    while now := [joint for joint in left if joint.parent in reached and joint.child not in reached]:
        for joint in now:
            if joint.child not in reached:
                reached.add(joint.child)
                yield joint
        left = [joint for joint in left if joint.child not in reached]


def _joint(element: ET.Element) -> Joint:
    limit, mimic = element.find("limit"), element.find("mimic")
    parent, child = element.find("parent"), element.find("child")
    kind = element.get("type", "fixed")
    bounded = limit is not None and kind in ("revolute", "prismatic")
    position, wxyz = _origin(element)
    return Joint(
        element.get("name", ""),
        kind,
        "" if parent is None else parent.get("link", ""),
        "" if child is None else child.get("link", ""),
        position,
        wxyz,
        _vector(element.find("axis"), "xyz", (1.0, 0.0, 0.0)),
        None if mimic is None else _mimic(mimic),
        _number(limit, "lower", 0.0) if bounded else None,
        _number(limit, "upper", 0.0) if bounded else None,
        _number(limit, "velocity"),
        _number(limit, "effort"),
    )


def _mimic(element: ET.Element) -> tuple[str, float, float]:
    multiplier, offset = _number(element, "multiplier", 1.0), _number(element, "offset", 0.0)
    return element.get("joint", ""), 1.0 if multiplier is None else multiplier, offset or 0.0


def _visuals(link: ET.Element, materials: Mapping[str, tuple[float, ...]], notes: list[str]) -> Iterator[Visual]:
    for element in link.findall("visual"):
        geometry = element.find("geometry")
        shape = next(iter(geometry), None) if geometry is not None else None
        if shape is None or shape.tag not in _SIZES:
            what = "nothing" if shape is None else f"<{shape.tag}>"
            notes.append(f"link {link.get('name')}: {what} is not drawn; box, cylinder, sphere and mesh are")
            continue
        rgba = _color(element, materials)
        position, wxyz = _origin(element)
        color = (round(255 * rgba[0]), round(255 * rgba[1]), round(255 * rgba[2]))
        yield Visual(shape.tag, _SIZES[shape.tag](shape), position, wxyz, color, rgba[3], shape.get("filename", ""))


def _color(visual: ET.Element, materials: Mapping[str, tuple[float, ...]]) -> tuple[float, ...]:
    material = visual.find("material")
    default = (GREY[0] / 255, GREY[1] / 255, GREY[2] / 255, 1.0)
    if material is None:
        return default
    return _rgba(material) or materials.get(material.get("name", ""), default)


def _rgba(material: ET.Element) -> tuple[float, ...] | None:
    element = material.find("color")
    values = _numbers("" if element is None else element.get("rgba", ""))
    return tuple(min(max(value, 0.0), 1.0) for value in values) if values is not None and len(values) == 4 else None


def _origin(element: ET.Element) -> tuple[Vector, Quaternion]:
    origin = element.find("origin")
    return _vector(origin, "xyz", _ZERO), from_rpy(_vector(origin, "rpy", _ZERO))


def _vector(element: ET.Element | None, key: str, default: Vector) -> Vector:
    values = None if element is None else _numbers(element.get(key, ""))
    return (values[0], values[1], values[2]) if values is not None and len(values) == 3 else default


def _number(element: ET.Element | None, key: str, default: float | None = None) -> float | None:
    values = None if element is None else _numbers(element.get(key, ""))
    return values[0] if values else default


def _numbers(text: str) -> list[float] | None:
    try:
        values = [float(word) for word in text.split()]
    except ValueError:
        return None
    return values if all(map(math.isfinite, values)) else None


def _lengths(element: ET.Element, *keys: str) -> tuple[float, ...]:
    return tuple(abs(_number(element, key) or 0.1) for key in keys)


_SIZES: Final[dict[str, Callable[[ET.Element], tuple[float, ...]]]] = {
    "box": lambda element: _vector(element, "size", (0.1, 0.1, 0.1)),
    "cylinder": lambda element: _lengths(element, "radius", "length"),
    "sphere": lambda element: _lengths(element, "radius"),
    "mesh": lambda element: _vector(element, "scale", (1.0, 1.0, 1.0)),
}
