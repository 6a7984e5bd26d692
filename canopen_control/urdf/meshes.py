"""Reader of the mesh files of a description: STL, OBJ, COLLADA (DAE) and GLB.

Only local files are read, searched relative to the description. A file that cannot be found or read raises ConfigError,
so that the caller can report the error and draw or simulate the robot without the mesh.
"""

from __future__ import annotations

import math
import os
import struct
import xml.etree.ElementTree as ET  # only files of the user's own description are parsed
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final
from urllib.parse import unquote, urlsplit

from canopen_control.errors import ConfigError
from canopen_control.urdf.geometry import about, rotate
from canopen_control.urdf.package_search import package_folders

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence


# -- text formats (Wavefront OBJ, COLLADA and ASCII STL) as triangles


Triangle = tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...]]
Matrix = tuple[tuple[float, ...], ...]
"""Three rows of four numbers: rotation and scale, with the translation in the last column."""


def stl_triangles(content: bytes) -> list[Triangle]:
    """Return the faces of an ASCII STL file; raise ValueError or IndexError if the file is invalid."""
    words = (line.split() for line in content.decode("utf-8", "replace").splitlines())
    points = [
        (float(line_words[1]), float(line_words[2]), float(line_words[3]))
        for line_words in words
        if line_words and line_words[0] == "vertex"
    ]
    if len(points) % 3:
        raise ValueError(f"{len(points)} corners are not whole triangles; is the file truncated?")
    return [(points[n], points[n + 1], points[n + 2]) for n in range(0, len(points), 3)]


def obj_triangles(content: bytes) -> list[Triangle]:
    """Return the faces of a Wavefront OBJ file, without colours; raise ValueError or IndexError if it is invalid."""
    points: list[tuple[float, ...]] = []
    triangles: list[Triangle] = []
    for line in content.decode("utf-8", "replace").splitlines():
        word, *rest = line.split() or [""]
        if word == "v":
            points.append(tuple(float(corner) for corner in rest[:3]))
        elif word == "f":
            corners = [int(corner.split("/")[0]) for corner in rest]
            face = [points[corner - 1 if corner > 0 else corner] for corner in corners]
            triangles += [(face[0], face[n], face[n + 1]) for n in range(1, len(face) - 1)]
    return triangles


def dae_triangles(content: bytes) -> list[Triangle]:
    """Return the faces of a COLLADA file as placed by its scenes, in m, with z up and without colours.

    Raise ValueError, KeyError or IndexError if the file is invalid.
    """
    try:
        root = ET.fromstring(content)
    except ET.ParseError as error:
        raise ValueError(error) from None
    for element in root.iter():
        element.tag = element.tag.partition("}")[2] or element.tag
    geometries = {f"#{geometry.get('id')}": geometry for geometry in root.iter("geometry")}
    unit, up = root.find("asset/unit"), root.findtext("asset/up_axis", "Y_UP")
    scale = float(unit.get("meter", "1")) if unit is not None else 1.0
    start = _scaled(_Y_UP if up == "Y_UP" else _UNTURNED, scale)
    triangles: list[Triangle] = []
    for scene in root.iter("visual_scene"):
        for node in scene.findall("node"):
            triangles += _dae_node(node, start, geometries)
    return triangles


def _dae_node(node: ET.Element, matrix: Matrix, geometries: Mapping[str, ET.Element]) -> Iterator[Triangle]:
    for child in node:
        if child.tag in _DAE_MOVES:
            matrix = _product(matrix, _DAE_MOVES[child.tag]([float(number) for number in (child.text or "").split()]))
        elif child.tag == "instance_geometry":
            for a, b, c in _dae_triangles(geometries[child.get("url", "")]):
                yield _placed(matrix, a), _placed(matrix, b), _placed(matrix, c)
        elif child.tag == "node":
            yield from _dae_node(child, matrix, geometries)


def _dae_triangles(geometry: ET.Element) -> Iterator[Triangle]:
    sources = {f"#{element.get('id')}": element for element in geometry.iter("source")}
    vertices = {
        f"#{element.get('id')}": element.find("input[@semantic='POSITION']") for element in geometry.iter("vertices")
    }
    for part in (*geometry.iter("triangles"), *geometry.iter("polylist")):
        inputs = part.findall("input")
        vertex = next(element for element in inputs if element.get("semantic") == "VERTEX")
        position = vertices[vertex.get("source", "")]
        source = sources["" if position is None else position.get("source", "")]
        values = [float(word) for word in source.findtext("float_array", "").split()]
        step = 1 + max(int(element.get("offset", "0")) for element in inputs)
        indices = [int(word) for word in part.findtext("p", "").split()][int(vertex.get("offset", "0")) :: step]
        points = [(values[3 * n], values[3 * n + 1], values[3 * n + 2]) for n in indices]
        counts = [int(word) for word in part.findtext("vcount", "").split()] or [3] * (len(points) // 3)
        at = 0
        for count in counts:
            for n in range(1, count - 1):
                yield points[at], points[at + n], points[at + n + 1]
            at += count


def _dae_rotation(values: Sequence[float]) -> Matrix:
    wxyz = about((values[0], values[1], values[2]), math.radians(values[3]))
    columns = [rotate(wxyz, axis) for axis in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))]
    return tuple((columns[0][row], columns[1][row], columns[2][row], 0.0) for row in range(3))


def _product(a: Matrix, b: Matrix) -> Matrix:
    full = (*b, (0.0, 0.0, 0.0, 1.0))
    return tuple(tuple(sum(row[k] * full[k][n] for k in range(4)) for n in range(4)) for row in a)


def _placed(matrix: Matrix, point: tuple[float, ...]) -> tuple[float, ...]:
    return tuple(row[0] * point[0] + row[1] * point[1] + row[2] * point[2] + row[3] for row in matrix)


def _scaled(matrix: Matrix, factor: float) -> Matrix:
    return tuple(tuple(factor * value for value in row) for row in matrix)


_UNTURNED: Final = ((1.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0))
_Y_UP: Final = ((1.0, 0.0, 0.0, 0.0), (0.0, 0.0, -1.0, 0.0), (0.0, 1.0, 0.0, 0.0))
_DAE_MOVES: Final[dict[str, Callable[[list[float]], Matrix]]] = {
    "matrix": lambda v: (tuple(v[0:4]), tuple(v[4:8]), tuple(v[8:12])),
    "translate": lambda v: ((1.0, 0.0, 0.0, v[0]), (0.0, 1.0, 0.0, v[1]), (0.0, 0.0, 1.0, v[2])),
    "scale": lambda v: ((v[0], 0.0, 0.0, 0.0), (0.0, v[1], 0.0, 0.0), (0.0, 0.0, v[2], 0.0)),
    "rotate": _dae_rotation,
}


MAX_BYTES: Final = 50_000_000  # maximum file size; a larger file would stall a browser and a simulation


def find_mesh(uri: str, description: str, environment: Mapping[str, str] | None = None) -> Path:
    """Return the path of a mesh by its URI: `package://NAME/...`, `file://...`, or a path relative to the description.

    Raise ConfigError if the file does not exist. Packages are searched near the description, in ROS_PACKAGE_PATH, and
    in share/ of AMENT_PREFIX_PATH.
    """
    parts = urlsplit(uri)
    if parts.scheme not in ("", "file", "package", "model"):
        raise ConfigError(f"mesh {uri}: only local files are read, not {parts.scheme}://")
    path = unquote(parts.path)
    if parts.scheme in ("package", "model"):
        folders = package_folders(parts.netloc, Path(description), os.environ if environment is None else environment)
        candidates = (folder / path.lstrip("/") for folder in folders)
        if (file := next((candidate for candidate in candidates if candidate.is_file()), None)) is None:
            raise ConfigError(f"mesh {uri}: no package {parts.netloc} with this file; is AMENT_PREFIX_PATH set?")
        return file
    file = Path(description).parent / path
    if not file.is_file():
        raise ConfigError(f"mesh {uri}: file {file} does not exist")
    return file


@dataclass(frozen=True, slots=True)
class Mesh:
    """Mesh data in a format that the browser and the simulation read: "stl" (binary), or "glb" for the browser only."""

    content: bytes
    format: str


def read_mesh(file: Path) -> Mesh:
    """Read a mesh file, and convert it to binary STL unless it is GLB; raise ConfigError if it cannot be read."""
    suffix = file.suffix.lower()
    if suffix not in _READERS:
        raise ConfigError(f"mesh {file}: {suffix or 'no suffix'} is not supported; use {', '.join(_READERS)}")
    if file.stat().st_size > MAX_BYTES:
        raise ConfigError(f"mesh {file}: larger than {MAX_BYTES // 1_000_000} MB; reduce the mesh")
    try:
        return _READERS[suffix](file.read_bytes())
    except (OSError, ValueError, IndexError, KeyError) as error:
        raise ConfigError(f"mesh {file}: cannot be read: {error}") from error


def _read_stl(content: bytes) -> Mesh:
    if content[:5] == b"solid" and b"facet" in content[:1000]:
        return _as_stl(stl_triangles(content))
    if len(content) < 84:
        raise ValueError("it is not an STL file")
    faces = int.from_bytes(content[80:84], "little")
    if len(content) < 84 + 50 * faces:
        raise ValueError(f"{faces} faces are announced, but the file is shorter")
    if not faces:
        raise ValueError("the file has no faces")
    return Mesh(content, "stl")


def _read_glb(content: bytes) -> Mesh:
    if content[:4] != b"glTF":
        raise ValueError("it is not a binary glTF file")
    return Mesh(content, "glb")


def _as_stl(triangles: Sequence[Triangle]) -> Mesh:
    """Convert triangles to binary STL with computed normals; raise ValueError if there are no triangles."""
    if not triangles:
        raise ValueError("the file has no faces")
    rows = bytearray(80) + len(triangles).to_bytes(4, "little")
    for first, second, third in triangles:
        rows += struct.pack("<12fH", *_normal(first, second, third), *first, *second, *third, 0)
    return Mesh(bytes(rows), "stl")


def _normal(a: tuple[float, ...], b: tuple[float, ...], c: tuple[float, ...]) -> tuple[float, float, float]:
    u, v = [b[n] - a[n] for n in range(3)], [c[n] - a[n] for n in range(3)]
    x, y, z = u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]
    length = math.sqrt(x * x + y * y + z * z) or 1.0
    return x / length, y / length, z / length


_READERS: Final[dict[str, Callable[[bytes], Mesh]]] = {
    ".stl": _read_stl,
    ".obj": lambda content: _as_stl(obj_triangles(content)),
    ".dae": lambda content: _as_stl(dae_triangles(content)),
    ".glb": _read_glb,
}
