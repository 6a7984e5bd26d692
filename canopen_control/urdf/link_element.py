"""`<link>` elements of a robot description: visual shapes, and the radius of round links.

A shape that cannot be drawn is not an error, because joints can move without shapes: it is omitted and listed in the
notes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from canopen_control.urdf.document import NOWHERE, ElementPlace
from canopen_control.urdf.geometry import ORIGIN, Pose, Vector, from_rpy

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from canopen_control.urdf.document import Element, UrdfDocument


GREY: Final = (160, 165, 172)
_ROUND: Final = ("cylinder", "sphere")
_ZERO: Final = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Visual:
    """Visual shape of a link, with its pose in the frame of the link; lengths are in m.

    `size` is x, y, z of a box; radius and length of a cylinder along z; radius of a sphere; the scale of a mesh, whose
    `file` is the URI in the URDF. `color` is red, green and blue from 0 to 255, `opacity` is 0 to 1.
    """

    shape: str
    size: tuple[float, ...]
    pose: Pose = ORIGIN
    color: tuple[int, int, int] = GREY
    opacity: float = 1.0
    file: str = ""


@dataclass(frozen=True, slots=True)
class UrdfLink:
    """Link of the robot, with its visual shapes; `place` is the position of the tag.

    `radius` in m is that of the only cylinder or sphere in <collision>, else in <visual>; None if there is not exactly
    one.
    """

    name: str
    visuals: tuple[Visual, ...] = ()
    radius: float | None = None
    place: ElementPlace = NOWHERE


def read_links(document: UrdfDocument, notes: list[str]) -> dict[str, UrdfLink]:
    """Return the links of a `<robot>` by name, and add texts about shapes that cannot be drawn to `notes`."""
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
    """Return the numbers in an attribute, or None if it is missing or a number is invalid."""
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
