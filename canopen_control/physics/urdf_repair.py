"""A URDF put right for MuJoCo's reader, which would lose or refuse parts of it.

It drops visuals while it reads, so that a link which is only seen would have neither shape nor mass: its visuals become
collisions. A mesh is found by its package, since the reader knows no `package://`. What neither reader nor contacts can
use is left out and told in the notes. A link that moves and has neither mass nor shape is a mistake of the description.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from canopen_control.physics.physics_file import PhysicsError
from canopen_control.urdf.package_search import find_package

if TYPE_CHECKING:
    from collections.abc import Iterator

    from canopen_control.urdf.description import Description

__all__ = ["RepairedUrdf", "guessed_masses", "repaired"]

_FOREIGN: Final = ("ros2_control", "gazebo", "transmission", "mujoco_inputs", "mujoco")
_MESHES: Final = (".stl", ".obj")
_PACKAGE: Final = "package://"


@dataclass(frozen=True)
class RepairedUrdf:
    """The text that MuJoCo reads; `guessed` are the links whose mass their shapes give, `notes` what was left out."""

    text: str
    guessed: tuple[str, ...]
    notes: tuple[str, ...]


def repaired(description: Description) -> RepairedUrdf:
    """Return a description as MuJoCo can read it; PhysicsError for what it could not make up."""
    root = ET.fromstring(description.urdf_xml)
    notes: list[str] = []
    for tag in _FOREIGN:
        for each in root.findall(tag):
            root.remove(each)
    for link in root.findall("link"):
        _give_shapes(link, description.path, notes)
    _check_masses(root, description)
    compiler = ET.SubElement(ET.SubElement(root, "mujoco"), "compiler")
    # while it reads: what it fuses or discards here cannot be had back
    compiler.attrib.update(fusestatic="false", discardvisual="false", strippath="false", balanceinertia="true")
    text = ET.tostring(root, encoding="unicode")
    guessed = tuple(link.get("name", "") for link in root.findall("link") if _is_guessed(link))
    return RepairedUrdf(text, guessed, tuple(notes))


def guessed_masses(urdf: RepairedUrdf, density: float) -> tuple[str, ...]:
    """Return the sentence that tells whose masses were guessed, at a density in kg/m3; none where none was."""
    if not urdf.guessed:
        return ()
    return (f"masses are guessed from shapes at {density:g} kg/m3: {', '.join(urdf.guessed)}",)


def _is_guessed(link: ET.Element) -> bool:
    return link.find("inertial") is None and link.find("collision") is not None


def _give_shapes(link: ET.Element, path: str, notes: list[str]) -> None:
    """Let what is seen be what touches, where the link has no collision; leave out meshes that nobody can read."""
    visuals = link.findall("visual")
    seen_only = link.find("collision") is None
    for visual in visuals:
        if seen_only:
            for material in visual.findall("material"):  # it would colour what is simulated
                visual.remove(material)
            visual.tag = "collision"
        else:
            link.remove(visual)
    for shape in link.findall("collision"):
        mesh = shape.find("geometry/mesh")
        if mesh is not None and (why := _resolve(mesh, path)):
            link.remove(shape)
            notes.append(f"link {link.get('name')}: {why}; it touches nothing with that shape")


def _resolve(mesh: ET.Element, path: str) -> str:
    """Write the file of a mesh as MuJoCo opens it; return why it cannot be used, nothing where it can."""
    name = mesh.get("filename", "").removeprefix("file://")
    file = Path(name)
    if name.startswith(_PACKAGE):
        package, _, rest = name.removeprefix(_PACKAGE).partition("/")
        try:
            file = Path(find_package(package, path)) / rest
        except LookupError:
            return f"the package of its mesh {name} is not found"
    elif not file.is_absolute():
        file = Path(path).resolve().parent / name
    if file.suffix.lower() not in _MESHES:
        return f"its mesh {name} is none of {', '.join(_MESHES)}"
    if not file.is_file():
        return f"its mesh {name} is not there"
    mesh.set("filename", str(file))
    return ""


def _check_masses(root: ET.Element, description: Description) -> None:
    """Tell the moving links without a mass or a shape of which one could be made, with the lines of their joints."""
    heavy = {link.get("name", "") for link in root.findall("link") if _weighs(link)}
    problems = [
        f"{description.path}:{joint.place.line}:{joint.place.column}: joint {joint.name} moves link {joint.child}, "
        "which has neither a mass nor a shape; give it <inertial>, or a <collision>"
        for joint in description.joints.values()
        if not joint.fixed and not heavy.intersection(_rigid(description, joint.child))
    ]
    if problems:
        raise PhysicsError("\n".join(problems))


def _weighs(link: ET.Element) -> bool:
    mass = link.find("inertial/mass")
    if mass is None:
        return link.find("collision") is not None
    try:
        return float(mass.get("value", "0")) > 0.0
    except ValueError:
        return False


def _rigid(description: Description, link: str) -> Iterator[str]:
    """Yield a link and those that are fixed to it, further out."""
    yield link
    for joint in description.joints.values():
        if joint.parent == link and joint.fixed:
            yield from _rigid(description, joint.child)
