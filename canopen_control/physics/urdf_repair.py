"""Repair of URDFs for MuJoCo's reader, which would otherwise drop or refuse parts of the file.

The reader drops visuals, so that a link without collisions would have neither shape nor mass: its visuals become
collisions. The reader supports neither `package://` nor COLLADA nor text meshes: meshes are found by their package and
passed as binary STL. Parts that the reader or the contacts do not support are omitted and listed in the notes. A moving
link with neither mass nor shape is an error of the description.

A principal moment of inertia cannot exceed the sum of the other two. The reader would silently replace all three by
their mean, even for a rounding error. Here the largest moment is reduced to the sum, and the notes list the link if the
excess is more than a rounding error. Moments that are not above 0 are an error of the description.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

import numpy as np

from canopen_control.errors import ConfigError
from canopen_control.physics.physics_file import PhysicsError
from canopen_control.physics.sdf_world import read_stl, stl_corners
from canopen_control.urdf.meshes import find_mesh

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from canopen_control.urdf.description import UrdfDescription


_FOREIGN: Final = ("ros2_control", "gazebo", "transmission", "mujoco_inputs", "mujoco")
_FLAT_M: Final = 1e-9
_MOMENTS: Final = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
_MIN_MOMENT: Final = 1e-15  # kg m2: MuJoCo's mjMINVAL
_ROUNDED: Final = 1.001  # smaller excesses over the sum are rounding errors


@dataclass(frozen=True)
class RepairedUrdf:
    """URDF text for MuJoCo's reader, with meshes by name, links with guessed masses, and notes on omissions.

    `meshes` maps the names used in the text to the contents of the mesh files.
    """

    text: str
    guessed: tuple[str, ...]
    notes: tuple[str, ...]
    meshes: dict[str, bytes] = field(default_factory=dict)


def repaired(description: UrdfDescription) -> RepairedUrdf:
    """Convert a description to a URDF that MuJoCo accepts; raise PhysicsError if this is impossible."""
    root = ET.fromstring(description.urdf_xml)
    notes: list[str] = []
    meshes = _Meshes()
    for tag in _FOREIGN:
        for element in root.findall(tag):
            root.remove(element)
    for link in root.findall("link"):
        _add_collisions(link, description.path, notes, meshes)
    problems = _masses_missing(root, description)
    for link in root.findall("link"):
        _check_inertia(link, description, notes, problems)
    _check_dynamics(description, problems)
    if problems:
        raise PhysicsError("\n".join(problems))
    compiler = ET.SubElement(ET.SubElement(root, "mujoco"), "compiler")
    # the reader must not fuse or discard bodies, which could not be restored
    compiler.attrib.update(fusestatic="false", discardvisual="false", strippath="false", balanceinertia="true")
    text = ET.tostring(root, encoding="unicode")
    guessed = tuple(link.get("name", "") for link in root.findall("link") if _is_guessed(link))
    return RepairedUrdf(text, guessed, tuple(notes), meshes.contents)


def guessed_masses(urdf: RepairedUrdf, density: float) -> tuple[str, ...]:
    """Return a note that lists the links with masses guessed from a density in kg/m3, or () if there are none."""
    if not urdf.guessed:
        return ()
    return (f"masses are guessed from shapes at {density:g} kg/m3: {', '.join(urdf.guessed)}",)


def _is_guessed(link: ET.Element) -> bool:
    return link.find("inertial") is None and link.find("collision") is not None


def _add_collisions(link: ET.Element, path: str, notes: list[str], meshes: _Meshes) -> None:
    """Turn the visuals of a link into collisions if it has none, else remove them; omit unusable meshes."""
    visuals = link.findall("visual")
    no_collisions = link.find("collision") is None
    for visual in visuals:
        if no_collisions:
            for material in visual.findall("material"):  # the material would colour the simulated shape
                visual.remove(material)
            visual.tag = "collision"
        else:
            link.remove(visual)
    for shape in link.findall("collision"):
        mesh = shape.find("geometry/mesh")
        if mesh is None:
            continue
        try:
            mesh.set("filename", meshes.add(find_mesh(mesh.get("filename", ""), path)))
        except ConfigError as error:
            link.remove(shape)
            notes.append(f"link {link.get('name')}: {error}; this shape has no contacts")


class _Meshes:
    """Mesh files converted to binary STL; `contents` is keyed by the names used in the URDF text."""

    def __init__(self) -> None:
        self.contents: dict[str, bytes] = {}
        self._names: dict[Path, str] = {}

    def add(self, file: Path) -> str:
        """Convert a file once, and return its name in the URDF; raise ConfigError if the mesh is unusable."""
        if file not in self._names:
            stl = read_stl(file)
            try:
                corners = stl_corners(stl)
            except ValueError as error:
                raise ConfigError(f"mesh {file}: {error}") from error
            if np.ptp(corners, axis=0).min() <= _FLAT_M:
                raise ConfigError(f"mesh {file}: it is flat")
            name = f"{file.stem}_{len(self._names)}.stl"
            self._names[file], self.contents[name] = name, stl
        return self._names[file]


def _check_dynamics(description: UrdfDescription, problems: list[str]) -> None:
    """Report joints with negative friction or damping, which would accelerate them."""
    for joint in description.joints.values():
        for name, value in (("damping", joint.dynamics.damping), ("friction", joint.dynamics.friction)):
            if value is not None and value < 0.0:
                place = f"{description.path}:{joint.place.line}:{joint.place.column}: joint {joint.name}"
                problems.append(f"{place}: {name}={value:g} of <dynamics> is below 0; write 0 or more")


def _check_inertia(link: ET.Element, description: UrdfDescription, notes: list[str], problems: list[str]) -> None:
    """Reduce a principal moment that exceeds the sum of the other two; report an inertia that is invalid."""
    element, mass = link.find("inertial/inertia"), _mass_of(link)
    if element is None or mass <= 0.0:
        return
    name = link.get("name", "")
    known_link = description.links.get(name)
    place = f"{description.path}: link {name}"
    if known_link is not None:
        place = f"{description.path}:{known_link.place.line}:{known_link.place.column}: link {name}"
    try:
        xx, yy, zz, xy, xz, yz = (float(element.get(key, "0")) for key in _MOMENTS)
    except ValueError:
        problems.append(f"{place}: a value of its <inertia> is not a number; correct it")
        return
    matrix = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    if not np.isfinite(matrix).all():
        problems.append(f"{place}: a value of its <inertia> is not a number; correct it")
        return
    moments, axes = np.linalg.eigh(matrix)
    listed = ", ".join(f"{moment:.4g}" for moment in moments)
    if moments[0] < _MIN_MOMENT and (matrix.any() or _is_moved(description, name)):
        advice = "correct it, or omit <inertial>, so that the shapes define it"
        problems.append(f"{place}: no body of {mass:g} kg has the moments of inertia {listed} kg m²; {advice}")
        return
    most = moments[0] + moments[1]
    if moments[2] <= most:
        return
    if moments[2] > most * _ROUNDED:
        notes.append(
            f"{place}: its moments of inertia {listed} kg m² are impossible, the largest is more than the sum of the "
            f"others; simulated with {most:.4g} instead of {moments[2]:.4g}"
        )
    moments[2] = most * (1.0 - 1e-9)
    corrected = axes @ np.diag(moments) @ axes.T
    for key, row, column in zip(_MOMENTS, (0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2), strict=True):
        element.set(key, repr(float(corrected[row, column])))


def _is_moved(description: UrdfDescription, link: str) -> bool:
    return any(joint.child == link and not joint.fixed for joint in description.joints.values())


def _mass_of(link: ET.Element) -> float:
    mass = link.find("inertial/mass")
    try:
        return 0.0 if mass is None else float(mass.get("value", "0"))
    except ValueError:
        return 0.0


def _masses_missing(root: ET.Element, description: UrdfDescription) -> list[str]:
    """Return an error with its line for each moving link that has neither a mass nor a shape."""
    heavy = {link.get("name", "") for link in root.findall("link") if _has_mass(link)}
    return [
        f"{description.path}:{joint.place.line}:{joint.place.column}: joint {joint.name} moves link {joint.child}, "
        "which has neither a mass nor a shape; add <inertial> or <collision>"
        for joint in description.joints.values()
        if not joint.fixed and not heavy.intersection(_fixed_links(description, joint.child))
    ]


def _has_mass(link: ET.Element) -> bool:
    if link.find("inertial/mass") is None:
        return link.find("collision") is not None
    return _mass_of(link) > 0.0


def _fixed_links(description: UrdfDescription, link: str) -> Iterator[str]:
    """Yield a link and all links attached below it by fixed joints."""
    yield link
    for joint in description.joints.values():
        if joint.parent == link and joint.fixed:
            yield from _fixed_links(description, joint.child)
