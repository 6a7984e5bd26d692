"""Mesh files of a description, STL, OBJ, COLLADA (DAE) and GLB: where they are, and what is in them.

The law of this file: only files of this computer are read, found from where the description itself is; what cannot be
found or read is a sentence, and the robot is drawn and simulated without it.
"""

from __future__ import annotations

import math
import os
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final
from urllib.parse import unquote, urlsplit

from canopen_control.errors import ConfigError
from canopen_control.urdf.package_search import package_folders
from canopen_control.urdf.triangles import dae_triangles, obj_triangles, stl_triangles

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from canopen_control.urdf.triangles import Triangle

__all__ = ["Mesh", "find_mesh", "read_mesh"]

MAX_BYTES: Final = 50_000_000  # of a file; more stands still in a browser and in a simulation


def find_mesh(uri: str, description: str, environment: Mapping[str, str] | None = None) -> Path:
    """Return the file of `package://NAME/...`, `file://...` or a path relative to the description; ConfigError if none.

    A package is one above the description, in ROS_PACKAGE_PATH, or in share/ of AMENT_PREFIX_PATH.
    """
    parts = urlsplit(uri)
    if parts.scheme not in ("", "file", "package", "model"):
        raise ConfigError(f"mesh {uri}: only files of this computer are read, no {parts.scheme}://")
    path = unquote(parts.path)
    if parts.scheme in ("package", "model"):
        folders = package_folders(parts.netloc, Path(description), os.environ if environment is None else environment)
        found = (folder / path.lstrip("/") for folder in folders)
        if (file := next((each for each in found if each.is_file()), None)) is None:
            raise ConfigError(f"mesh {uri}: no package {parts.netloc} with this file; is AMENT_PREFIX_PATH set?")
        return file
    file = Path(description).parent / path
    if not file.is_file():
        raise ConfigError(f"mesh {uri}: there is no file {file}")
    return file


@dataclass(frozen=True, slots=True)
class Mesh:
    """A file that browser and simulation can read, and its format: "stl", which is binary, or "glb" (no simulation)."""

    content: bytes
    format: str


def read_mesh(file: Path) -> Mesh:
    """Return a mesh file as binary STL or GLB; ConfigError if it cannot be read."""
    suffix = file.suffix.lower()
    if suffix not in _READERS:
        raise ConfigError(f"mesh {file}: {suffix or 'no ending'} is not read; {', '.join(_READERS)} are")
    if file.stat().st_size > MAX_BYTES:
        raise ConfigError(f"mesh {file}: larger than {MAX_BYTES // 1_000_000} MB; make a lighter one")
    try:
        return _READERS[suffix](file.read_bytes())
    except (OSError, ValueError, IndexError, KeyError) as error:
        raise ConfigError(f"mesh {file}: cannot be read: {error}") from error


def _read_stl(content: bytes) -> Mesh:
    if content[:5] == b"solid" and b"facet" in content[:1000]:
        return _as_stl(stl_triangles(content))
    if len(content) < 84:
        raise ValueError("it is no STL file")
    faces = int.from_bytes(content[80:84], "little")
    if len(content) < 84 + 50 * faces:
        raise ValueError(f"{faces} faces are announced, and the file ends before")
    if not faces:
        raise ValueError("there are no faces in it")
    return Mesh(content, "stl")


def _read_glb(content: bytes) -> Mesh:
    if content[:4] != b"glTF":
        raise ValueError("it is no binary glTF file")
    return Mesh(content, "glb")


def _as_stl(triangles: Sequence[Triangle]) -> Mesh:
    """Return triangles as binary STL; normals are left to the reader, which makes them of the corners."""
    if not triangles:
        raise ValueError("there are no faces in it")
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
