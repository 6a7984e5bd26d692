"""Mesh files of a description: where they are, and what is in them.

The law of this file: only files of this computer are read, found from where the description itself is; what cannot be
found or read is a sentence, and the robot is drawn without it.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import unquote, urlsplit

from canopen_control.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Mapping

__all__ = ["find_mesh", "read_mesh"]

MAX_BYTES: Final = 50_000_000  # of a file; more stands still in a browser
_READABLE: Final = (".stl", ".obj", ".ply", ".glb", ".gltf", ".off")


def find_mesh(uri: str, description: str, environment: Mapping[str, str] | None = None) -> Path:
    """Return the file of `package://NAME/...`, `file://...` or a path relative to the description; ConfigError if none.

    A package is a folder NAME above the description, or in share/ of AMENT_PREFIX_PATH, or in ROS_PACKAGE_PATH.
    """
    parts = urlsplit(uri)
    if parts.scheme not in ("", "file", "package", "model"):
        raise ConfigError(f"mesh {uri}: only files of this computer are read, no {parts.scheme}://")
    path = unquote(parts.path)
    if parts.scheme in ("package", "model"):
        found = _in_package(parts.netloc, path.lstrip("/"), Path(description), environment or os.environ)
        if found is None:
            raise ConfigError(f"mesh {uri}: no package {parts.netloc} with this file; is AMENT_PREFIX_PATH set?")
        return found
    file = Path(description).parent / path
    if not file.is_file():
        raise ConfigError(f"mesh {uri}: there is no file {file}")
    return file


def _in_package(package: str, path: str, description: Path, environment: Mapping[str, str]) -> Path | None:
    above = [parent if parent.name == package else parent / package for parent in description.parents]
    ament = [Path(each) / "share" / package for each in _paths(environment, "AMENT_PREFIX_PATH")]
    old = [Path(each) / package for each in _paths(environment, "ROS_PACKAGE_PATH")]
    return next((folder / path for folder in (*above, *ament, *old) if (folder / path).is_file()), None)


def _paths(environment: Mapping[str, str], key: str) -> list[str]:
    return [each for each in environment.get(key, "").split(os.pathsep) if each]


def read_mesh(file: Path) -> Any:  # noqa: ANN401 - trimesh's types are wider than what is asked for
    """Return the trimesh of a file; its `visual.kind` is None where it has no colours. ConfigError if unreadable."""
    import trimesh

    if file.suffix.lower() not in _READABLE:
        raise ConfigError(f"mesh {file}: {file.suffix} is not read; {', '.join(_READABLE)} are")
    if file.stat().st_size > MAX_BYTES:
        raise ConfigError(f"mesh {file}: larger than {MAX_BYTES // 1_000_000} MB; make a lighter one for the view")
    try:
        mesh: Any = trimesh.load(file, force="mesh")
    except Exception as error:
        raise ConfigError(f"mesh {file}: cannot be read: {error}") from error
    if not len(mesh.faces):
        raise ConfigError(f"mesh {file}: there are no faces in it")
    return mesh
