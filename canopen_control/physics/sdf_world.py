"""Static shapes of an SDF world (`.sdf`, `.world`), in the same places as in Gazebo.

The collisions of all links are read: box, sphere, cylinder, capsule, ellipsoid, plane and mesh, with the poses of SDF
(including `relative_to` and `attached_to`), in models, nested models, and includes of local files. `model://` is
searched next to the file, in the folders of GZ_SIM_RESOURCE_PATH, IGN_GAZEBO_RESOURCE_PATH and GAZEBO_MODEL_PATH, and
as a ROS package. The sun and the ground plane need no file, since the floor always exists. Visuals, lights, plugins,
sensors and joints are ignored.

A shape that cannot be placed is an error with its line; all errors of a world are reported together.
"""

from __future__ import annotations

import math
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import unquote, urlsplit

import numpy as np

from canopen_control.data_files import read_utf8
from canopen_control.errors import ConfigError, RobotConfigError, nearest
from canopen_control.physics.physics_file import PhysicsError
from canopen_control.urdf.document import finite_number, read_document
from canopen_control.urdf.geometry import ORIGIN, Pose, about, from_rpy, rotate
from canopen_control.urdf.meshes import find_mesh, read_mesh
from canopen_control.urdf.package_search import package_folders

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from canopen_control.urdf.document import Element
    from canopen_control.urdf.geometry import Vector


# Meshes as convex parts, because contacts support only convex shapes: each connected piece of a mesh is one. A flat
# piece, such as a wall drawn as a plane, gets a thickness of 1 mm.


_HEAD: Final = 84  # bytes before the faces of binary STL
_FACE: Final = np.dtype([("normal", "<3f4"), ("corners", "<9f4"), ("rest", "<u2")])
_GRAIN_M: Final = 1e-5  # closer vertices are merged
_THIN_M: Final = 1e-4
_HALF_M: Final = 5e-4  # thickness added on each side of a flat piece
_MAX_PARTS: Final = 500
_MAX_FACES: Final = 200_000  # limit of MuJoCo


@dataclass(frozen=True, eq=False)
class MeshPart:
    """Convex part of a mesh: vertices in m as rows of x, y and z."""

    corners: Any


def read_stl(file: Path) -> bytes:
    """Return a mesh file as binary STL; raise ConfigError if the mesh cannot be simulated."""
    mesh = read_mesh(file)
    if mesh.format != "stl":
        raise ConfigError(f"mesh {file}: {file.suffix} is only displayed; use STL, OBJ or DAE")
    return mesh.content


def stl_corners(stl: bytes, scale: Sequence[float] = (1.0, 1.0, 1.0)) -> Any:  # noqa: ANN401 - numpy's
    """Return the scaled vertices of a binary STL mesh; raise ValueError for too many faces or a non-finite number."""
    count = int.from_bytes(stl[80:84], "little")
    if count > _MAX_FACES:
        raise ValueError(f"{count} faces are more than the possible {_MAX_FACES}; use a simpler mesh")
    corners = np.frombuffer(stl, _FACE, count, _HEAD)["corners"].reshape(-1, 3).astype(float) * np.array(scale)
    if not np.isfinite(corners).all():
        raise ValueError("a coordinate is not a finite number")
    return corners


def convex_parts(stl: bytes, scale: Sequence[float]) -> tuple[MeshPart, ...]:
    """Return the convex parts of a scaled binary STL mesh; raise ValueError for an invalid mesh or too many parts."""
    corners = stl_corners(stl, scale)
    keys, faces = np.unique(np.round(corners / _GRAIN_M).astype(np.int64), axis=0, return_inverse=True)
    parts = tuple(_solid(keys[list(piece)] * _GRAIN_M) for piece in _pieces(faces.reshape(-1, 3), len(keys)))
    if len(parts) > _MAX_PARTS:
        raise ValueError(f"{len(parts)} separate pieces are more than the possible {_MAX_PARTS}")
    return tuple(MeshPart(part) for part in parts)


def _pieces(faces: Any, count: int) -> Iterator[list[int]]:  # noqa: ANN401 - numpy's
    """Yield the vertex indices of each connected part of a mesh."""
    owner = list(range(count))

    def first(corner: int) -> int:
        while owner[corner] != corner:
            owner[corner] = owner[owner[corner]]
            corner = owner[corner]
        return corner

    for one, two, three in faces.tolist():
        owner[first(two)] = owner[first(three)] = first(one)
    pieces = dict[int, list[int]]()
    for corner in range(count):
        pieces.setdefault(first(corner), []).append(corner)
    yield from pieces.values()


def _solid(corners: Any) -> Any:  # noqa: ANN401 - as above
    """Return the vertices of a part; a flat part becomes a thin solid."""
    middle = corners.mean(axis=0)
    axes = np.linalg.svd(corners - middle, full_matrices=True)[2]
    spread = np.ptp((corners - middle) @ axes.T, axis=0)
    for axis, length in zip(axes, spread, strict=True):
        if length < _THIN_M:
            corners = np.concatenate([corners - _HALF_M * axis, corners + _HALF_M * axis])
    return corners


_KNOWN: Final = ("sun", "ground_plane")  # in every Gazebo world: a light, and the floor
_PATHS: Final = ("GZ_SIM_RESOURCE_PATH", "IGN_GAZEBO_RESOURCE_PATH", "GAZEBO_MODEL_PATH")
_DEEPEST: Final = 16  # maximum depth of nested models and includes
_ON_FLOOR: Final = 1e-6  # m, and components of a unit vector
_YES: Final = ("true", "1")


@dataclass(frozen=True)
class Solid:
    """Fixed shape of a world; `size` is in m as in MuJoCo (half lengths, radius first), `parts` are those of a mesh.

    The upper side of a plane is in the direction of its z axis.
    """

    name: str
    kind: str
    pose: Pose
    size: tuple[float, ...] = ()
    parts: tuple[MeshPart, ...] = ()


@dataclass(frozen=True)
class SdfWorld:
    """Shapes of an SDF file, and `notes` on differences from Gazebo."""

    solids: tuple[Solid, ...]
    notes: tuple[str, ...] = ()


def read_sdf_world(path: Path) -> SdfWorld:
    """Return the shapes of an SDF world; raise PhysicsError with all errors, each with its file and line."""
    reader = _Reader()
    root = reader.root(path)
    if root is not None:
        worlds = [child for child in root.children if child.tag == "world"]
        if not worlds:
            reader.mistake(path, root, "no <world> in this file; give the file of a world, not of a model")
        for number, world in enumerate(worlds):
            if number:
                reader.mistake(
                    path, world, "a second <world>; only one world per file is supported, so remove this one"
                )
        reader.scope(_Scope(path, worlds[0] if worlds else root, ORIGIN, ""), 0)
    if reader.problems:
        raise PhysicsError("\n".join(reader.problems))
    return SdfWorld(tuple(reader.solids), tuple(reader.notes(path)))


@dataclass
class _Scope:
    """World, model or link being read, with its pose in the world and the frames of its named elements."""

    path: Path
    element: Element
    place: Pose
    name: str
    frames: dict[str, Element] = field(default_factory=dict)
    open: set[str] = field(default_factory=set)

    def __post_init__(self) -> None:
        named = [child for child in self.element.children if child.tag in ("link", "frame", "model")]
        self.frames = {element.attributes.get("name", ""): element for element in named}


class _Reader:
    def __init__(self) -> None:
        self.solids: list[Solid] = []
        self.problems: list[str] = []
        self._loose: list[str] = []  # models that are not static
        self._meshes: dict[tuple[Path, Vector], tuple[MeshPart, ...]] = {}

    def notes(self, path: Path) -> Iterator[str]:
        """Yield the differences from Gazebo as sentences."""
        if self._loose:
            yield f"{path}: these models are not static in the file, but fixed here: {', '.join(self._loose)}"
        if self._meshes:
            files = {file.name: len(parts) for (file, _), parts in self._meshes.items()}
            listed = ", ".join(f"{name} ({count} part{'s' if count > 1 else ''})" for name, count in files.items())
            yield f"{path}: each part of a mesh has the contacts of its convex hull: {listed}"

    def mistake(self, path: Path, element: Element, text: str) -> None:
        self.problems.append(f"{path}:{element.place.line}:{element.place.column}: {text}")

    def root(self, path: Path) -> Element | None:
        """Parse a file and return its root element; on failure add an error and return None."""
        try:
            root = read_document(read_utf8(path), str(path)).root
        except RobotConfigError as error:
            self.problems.append(str(error))
        except (OSError, ValueError) as error:
            reason = error.strerror if isinstance(error, OSError) else error
            self.problems.append(f"{path}: cannot be read: {reason}")
        else:
            if root.tag == "sdf":
                return root
            self.mistake(path, root, f"<{root.tag}> is not SDF; an SDF file begins with <sdf version=...>")
        return None

    def scope(self, scope: _Scope, depth: int) -> None:
        if depth > _DEEPEST:
            text = f"more than {_DEEPEST} nested models; does a model include itself?"
            self.mistake(scope.path, scope.element, text)
            return
        for child in scope.element.children:
            if child.tag == "model":
                inner = _Scope(scope.path, child, self._place(scope, child), self._name(scope, child))
                self._model(inner, depth, static=_flag(child, "static"))
            elif child.tag == "include":
                self._include(scope, child, depth)
            elif child.tag == "link":
                self._link(scope, child)

    def _model(self, scope: _Scope, depth: int, *, static: bool) -> None:
        before = len(self.solids)
        self.scope(scope, depth + 1)
        if not depth and not static and len(self.solids) > before:
            self._loose.append(scope.name)

    def _name(self, scope: _Scope, element: Element) -> str:
        name = element.attributes.get("name", "") or element.tag
        return f"{scope.name}::{name}" if scope.name else name

    def _include(self, scope: _Scope, element: Element, depth: int) -> None:
        """Read the model of an included file, and give it the pose and name of the include."""
        uri = _text(element, "uri")
        if not uri:
            self.mistake(scope.path, element, "<include> has no <uri>; add the file of the model")
            return
        if uri.rstrip("/").rpartition("/")[2].strip().lower().replace(" ", "_") in _KNOWN:
            return
        file = self._included(scope.path, element, uri)
        root = None if file is None else self.root(file)
        if file is None or root is None:
            return
        models = [child for child in root.children if child.tag == "model"]
        if len(models) != 1:
            self.mistake(file, root, f"{len(models)} models in an included file; there must be exactly one")
            return
        included = models[0]
        pose = element.child("pose")
        place = self._place(scope, included if pose is None else element)
        name = _text(element, "name") or included.attributes.get("name", "")
        inner = _Scope(file, included, place, f"{scope.name}::{name}" if scope.name else name)
        self._model(inner, depth, static=_flag(element, "static") or _flag(included, "static"))

    def _included(self, path: Path, element: Element, uri: str) -> Path | None:
        """Return the file of an include; add an error and return None if no model is found or the URI is not local."""
        parts = urlsplit(uri)
        if parts.scheme not in ("", "file", "model", "package"):
            text = f"{uri} is not on this computer; download the model, and give its folder as <uri>"
            self.mistake(path, element, text)
            return None
        rest = unquote(f"{parts.netloc}{parts.path}")
        if parts.scheme in ("model", "package"):
            places = [folder / rest for folder in _resources(path)]
            name, _, below = rest.partition("/")
            places += [folder / below for folder in package_folders(name, path)]
        else:
            places = [path.parent / unquote(parts.path)]
        file = next((candidate for candidate in places if candidate.exists()), None)
        if file is None:
            where = "next to this file, in GZ_SIM_RESOURCE_PATH or as a package" if parts.scheme else f"at {places[0]}"
            advice = "give the folder or the file of the model as <uri>"
            self.mistake(path, element, f"{uri}: no such model {where}; {advice}")
            return None
        return _model_file(file) if file.is_dir() else file

    # -- poses

    def _place(self, scope: _Scope, element: Element) -> Pose:
        return scope.place.then(self._inside(scope, element))

    def _inside(self, scope: _Scope, element: Element) -> Pose:
        pose = element.child("pose")
        base = element.attributes.get("attached_to", "") if element.tag == "frame" else ""
        base = base if pose is None else pose.attributes.get("relative_to", "") or base
        relative = ORIGIN if pose is None else self._pose(scope.path, pose)
        if base in ("", "__model__", "world"):
            return relative
        target = scope.frames.get(base)
        if target is None:
            self.mistake(scope.path, pose or element, f"no frame {base!r} in this scope{nearest(base, scope.frames)}")
            return relative
        if base in scope.open:
            self.mistake(
                scope.path,
                pose or element,
                f"the pose of {base!r} depends on itself; give the pose relative to the model",
            )
            return relative
        scope.open.add(base)
        placed = self._inside(scope, target).then(relative)
        scope.open.discard(base)
        return placed

    def _pose(self, path: Path, element: Element) -> Pose:
        words, quat = element.text.split(), element.attributes.get("rotation_format") == "quat_xyzw"
        numbers = [finite_number(word) for word in words]
        values = [number for number in numbers if number is not None]
        if not words:
            return ORIGIN
        if len(values) < len(numbers) or len(values) != (7 if quat else 6):
            expected = "seven numbers, x y z and a quaternion" if quat else "six numbers, x y z in m and roll pitch yaw"
            self.mistake(path, element, f"<pose> {element.text!r} is not {expected}")
            return ORIGIN
        x, y, z, first, second, third = values[:6]
        if quat:
            length = math.hypot(*values[3:])
            if not length:
                self.mistake(path, element, "the quaternion of <pose> is 0; 0 0 0 1 is not a rotation")
                return ORIGIN
            return Pose((x, y, z), (values[6] / length, first / length, second / length, third / length))
        turn = math.radians if _is_yes(element.attributes.get("degrees", "")) else float
        return Pose((x, y, z), from_rpy((turn(first), turn(second), turn(third))))

    # -- shapes

    def _link(self, scope: _Scope, link: Element) -> None:
        inner = _Scope(scope.path, link, self._place(scope, link), self._name(scope, link))
        for child in link.children:
            if child.tag == "collision":
                self._collision(scope, inner, child)

    def _collision(self, model: _Scope, link: _Scope, element: Element) -> None:
        pose = element.child("pose")
        base = "" if pose is None else pose.attributes.get("relative_to", "")
        place = self._place(model if base and base != link.element.attributes.get("name") else link, element)
        geometry = element.child("geometry")
        shape = next(iter(geometry.children), None) if geometry is not None else None
        if shape is None:
            self.mistake(link.path, element, "<collision> has no shape; write one into its <geometry>")
            return
        make = _SHAPES.get(shape.tag)
        if make is None:
            self.mistake(link.path, shape, f"<{shape.tag}> is not a supported shape; use one of {', '.join(_SHAPES)}")
            return
        solid = make(self, link.path, shape, self._name(link, element), place)
        if solid is not None:
            self.solids.append(solid)

    def lengths(self, path: Path, shape: Element, tag: str, count: int = 1) -> tuple[float, ...] | None:
        """Return the `count` positive numbers of a shape's element; on failure add an error and return None."""
        words = _text(shape, tag).split()
        numbers = tuple(number for number in map(finite_number, words) if number is not None and number > 0.0)
        if len(numbers) == len(words) == count:
            return numbers
        expected = "a number" if count == 1 else f"{count} numbers"
        self.mistake(path, shape.child(tag) or shape, f"<{tag}> of <{shape.tag}> must be {expected} above 0, in m")
        return None

    def mesh(self, path: Path, shape: Element, name: str, place: Pose) -> Solid | None:
        """Read a mesh as convex parts; on failure add an error and return None."""
        uri = _text(shape, "uri")
        scale = (1.0, 1.0, 1.0)
        if shape.child("scale") is not None:
            words = _text(shape, "scale").split()
            numbers = [number for number in map(finite_number, words) if number]  # 0 is invalid
            if len(numbers) != 3 or len(words) != 3:
                self.mistake(
                    path, shape.child("scale") or shape, "<scale> of <mesh> must be three numbers other than 0"
                )
                return None
            scale = (numbers[0], numbers[1], numbers[2])
        try:
            file = _mesh_file(path, uri)
            if (file, scale) not in self._meshes:
                self._meshes[file, scale] = convex_parts(read_stl(file), scale)
        except (ConfigError, ValueError) as error:
            self.mistake(path, shape, str(error) if isinstance(error, ConfigError) else f"mesh {uri}: {error}")
            return None
        return Solid(name, "mesh", place, parts=self._meshes[file, scale])


def _box(reader: _Reader, path: Path, shape: Element, name: str, place: Pose) -> Solid | None:
    size = reader.lengths(path, shape, "size", 3)
    return None if size is None else Solid(name, "box", place, tuple(0.5 * length for length in size))


def _sphere(reader: _Reader, path: Path, shape: Element, name: str, place: Pose) -> Solid | None:
    size = reader.lengths(path, shape, "radius")
    return None if size is None else Solid(name, "sphere", place, size)


def _ellipsoid(reader: _Reader, path: Path, shape: Element, name: str, place: Pose) -> Solid | None:
    size = reader.lengths(path, shape, "radii", 3)
    return None if size is None else Solid(name, "ellipsoid", place, size)


def _round(reader: _Reader, path: Path, shape: Element, name: str, place: Pose) -> Solid | None:
    radius, length = reader.lengths(path, shape, "radius"), reader.lengths(path, shape, "length")
    return None if radius is None or length is None else Solid(name, shape.tag, place, (*radius, 0.5 * length[0]))


def _plane(reader: _Reader, path: Path, shape: Element, name: str, place: Pose) -> Solid | None:
    """Return an infinite plane; None if it is the floor of the world, or if its normal is invalid (an error)."""
    words = _text(shape, "normal").split() or ["0", "0", "1"]
    numbers = [number for number in map(finite_number, words) if number is not None]
    if len(numbers) != 3 or len(words) != 3 or not any(numbers):
        reader.mistake(path, shape.child("normal") or shape, "<normal> of <plane> must be three numbers, not all 0")
        return None
    turned = place.then(Pose(rotation=_turn_up((numbers[0], numbers[1], numbers[2]))))
    up = rotate(turned.rotation, (0.0, 0.0, 1.0))
    if up[2] > 1.0 - _ON_FLOOR and abs(turned.position[2]) < _ON_FLOOR:
        return None
    return Solid(name, "plane", turned)


def _turn_up(normal: Vector) -> tuple[float, float, float, float]:
    """Return the quaternion that rotates the z axis to `normal`."""
    x, y, z = (component / math.hypot(*normal) for component in normal)
    if math.hypot(x, y) < _ON_FLOOR:
        return about((1.0, 0.0, 0.0), 0.0 if z > 0.0 else math.pi)
    return about((-y, x, 0.0), math.acos(max(-1.0, min(1.0, z))))


_SHAPES: Final[dict[str, Callable[[_Reader, Path, Element, str, Pose], Solid | None]]] = {
    "box": _box,
    "sphere": _sphere,
    "cylinder": _round,
    "capsule": _round,
    "ellipsoid": _ellipsoid,
    "plane": _plane,
    "mesh": _Reader.mesh,
    "empty": lambda *_: None,
}
"""Functions that create the solids, by the SDF element of the shape."""


def _text(element: Element, tag: str) -> str:
    child = element.child(tag)
    return "" if child is None else child.text


def _flag(element: Element, tag: str) -> bool:
    return _is_yes(_text(element, tag))


def _is_yes(text: str) -> bool:
    return text.strip().lower() in _YES


def _resources(path: Path) -> Iterator[Path]:
    """Yield the folders to search for models: folders around the file, then those in Gazebo's environment variables."""
    yield from (path.parent, path.parent.parent, path.parent.parent / "models")
    for key in _PATHS:
        yield from (Path(entry) for entry in os.environ.get(key, "").split(os.pathsep) if entry)


def _model_file(folder: Path) -> Path:
    """Return a model folder's SDF file: the last one listed in model.config, else model.sdf."""
    config = folder / "model.config"
    try:
        root = read_document(config.read_text(encoding="utf-8"), str(config)).root
    except (OSError, UnicodeDecodeError, RobotConfigError):
        return folder / "model.sdf"
    named = [child.text for child in root.children if child.tag == "sdf" and child.text]
    return folder / (named[-1] if named else "model.sdf")


def _mesh_file(path: Path, uri: str) -> Path:
    """Return the file of a mesh URI; raise ConfigError if the URI or the file is missing."""
    if not uri:
        raise ConfigError("<mesh> has no <uri>; add its file")
    parts = urlsplit(uri)
    if parts.scheme in ("model", "package"):
        rest = unquote(f"{parts.netloc}{parts.path}")
        file = next((folder / rest for folder in _resources(path) if (folder / rest).is_file()), None)
        if file is not None:
            return file
    return find_mesh(uri, str(path))
