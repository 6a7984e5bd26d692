"""Search for ROS packages by name: near a file, in ROS_PACKAGE_PATH, and in the install folders of ament.

The folder of a package has its name, or has the name in its package.xml. The folder nearest to the file takes
precedence, so that edited sources are preferred to an older installed copy. ROS_PACKAGE_PATH is searched recursively,
as by rospack, down to the first package.xml; AMENT_PREFIX_PATH has its packages in share/.
"""

from __future__ import annotations

import contextlib
import os
import re
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping


_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_.-]*")
_INSTALLS = re.compile(r"\binstall\s*\(\s*DIRECTORY\b([^()]*)\)", re.IGNORECASE)
_NEAR = 3  # number of folders above a file whose subfolders are searched
_DEPTH = 5  # depth below a path of ROS_PACKAGE_PATH
_MAX = 5_000  # maximum number of folders searched below a path of ROS_PACKAGE_PATH


def find_package(package: str, file: str, environment: Mapping[str, str] | None = None) -> str:
    """Return the folder of a package named in `file`; raise LookupError if it is not found."""
    for folder in package_folders(package, Path(file), environment):
        return str(folder)
    raise LookupError(
        f"package {package!r} of $(find {package}) is neither installed nor above {file}; add the folder of "
        "the package to ROS_PACKAGE_PATH, or source its workspace"
    )


def package_folders(package: str, file: Path, environment: Mapping[str, str] | None = None) -> Iterator[Path]:
    """Yield the folders of a package: first those near `file`, then installed ones."""
    if _NAME.fullmatch(package):
        yield from _around(package, Path(os.path.realpath(file)))
    yield from installed_packages(package, environment)


def installed_packages(package: str, environment: Mapping[str, str] | None = None) -> Iterator[Path]:
    """Yield the folders of a package in ROS_PACKAGE_PATH and in the install folders of ament."""
    if not _NAME.fullmatch(package):
        return
    variables = os.environ if environment is None else environment
    for text in _paths(variables, "ROS_PACKAGE_PATH"):
        yield from _below(package, Path(text), _DEPTH)
    for text in _paths(variables, "AMENT_PREFIX_PATH"):
        folder = Path(text) / "share" / package
        if folder.is_dir():
            yield folder
    if environment is None:
        with contextlib.suppress(Exception):  # ament_index_python is missing, or lacks the package
            from ament_index_python.packages import get_package_share_directory

            yield Path(get_package_share_directory(package))


def installed_file(package: Path, name: Path) -> Path:
    """Return the path in the source tree of an installed file; CMake's install(DIRECTORY ...) may have renamed folders.

    `name` is the path relative to the package. The result is `package / name` if it exists, or if no rule installs it.
    """
    plain = package / name
    if plain.exists():
        return plain
    sources = (source for source in _installed_from(package, name) if source.exists())
    return next(sources, plain)


def _installed_from(package: Path, name: Path) -> Iterator[Path]:
    """Yield the source paths that a package's CMakeLists.txt would install as share/PACKAGE/name."""
    try:
        text = (package / "CMakeLists.txt").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return
    text = re.sub(r"#[^\n]*", "", text)
    for match in _INSTALLS.finditer(text):
        words = match[1].replace('"', " ").split()
        if "DESTINATION" not in words[:-1]:
            continue
        at = words.index("DESTINATION")
        share, _, below = words[at + 1].partition("/")
        _package, _, folder = below.partition("/")
        if share not in ("share", "${CMAKE_INSTALL_DATADIR}"):
            continue
        for word in words[:at]:
            source = package / word.removeprefix("${CMAKE_CURRENT_SOURCE_DIR}/")
            target = Path(folder) if word.endswith("/") else Path(folder, source.name)
            if name.is_relative_to(target):
                yield source / name.relative_to(target)


def _around(package: str, file: Path) -> Iterator[Path]:
    """Yield the folders of a package among the folders above a file and their subfolders, nearest first."""
    for distance, folder in enumerate(file.parents):
        for candidate in (folder, folder / package):
            if _names(candidate, package) or (candidate.name == package and candidate.is_dir()):
                yield candidate
        if 0 < distance <= _NEAR:
            yield from (
                package_folder
                for package_folder in _folders(folder)
                if package_folder.name != package and _names(package_folder, package)
            )


def _below(package: str, folder: Path, depth: int) -> Iterator[Path]:
    """Yield `folder`, or the folders below it, that contain the package; do not search inside packages."""
    remaining, level = _MAX, [folder]
    for _ in range(depth):
        deeper = list[Path]()
        for candidate in level[:remaining]:
            if (candidate / "package.xml").is_file():
                if _names(candidate, package) or candidate.name == package:
                    yield candidate
            else:
                deeper += _folders(candidate)
        remaining -= len(level)
        level = deeper


def _folders(folder: Path) -> list[Path]:
    try:
        return sorted(entry for entry in folder.iterdir() if not entry.name.startswith(".") and entry.is_dir())
    except OSError:
        return []


def _names(folder: Path, package: str) -> bool:
    """Whether the package.xml in a folder contains the name of the package."""
    try:
        return f"<name>{package}</name>" in (folder / "package.xml").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return False


def _paths(environment: Mapping[str, str], key: str) -> list[str]:
    return [entry for entry in environment.get(key, "").split(os.pathsep) if entry]
