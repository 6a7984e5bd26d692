"""Environment of child processes, without variables that are meant only for this process.

The ROS wheels restart every interpreter of their environment with their own libraries in LD_LIBRARY_PATH and a guard
variable. A child inherits both, and they break it if it uses another environment: rclpy then finds the wrong
libraries and, because of the guard, does not look for the right ones. A child that needs rclpy therefore gets neither
variable, and any other child gets only the guard, which saves the restart.
"""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Mapping


LIFELINE: Final = "CANOPEN_CONTROL_LIFELINE"
READY: Final = "CANOPEN_CONTROL_READY"
GATE: Final = "CANOPEN_CONTROL_GATE"
#: command that starts a module of the package; -P: files of the current folder must not shadow Python's modules
MODULE: Final = (sys.executable, "-P", "-m")
_GUARD: Final = "_ROS_WHEELS_BOOTSTRAP_COMPLETE"
_LIBRARIES: Final = "LD_LIBRARY_PATH"
_WHEEL_FOLDER: Final = re.compile(r"(?P<prefix>.+)/lib\d*/python[^/]+/site-packages/ros_[^/]+\.libs")


def lean_python(module: str) -> list[str]:
    """Return the command line that runs `main` of `module` in an interpreter with a minimal path, which starts fast.

    Only the package and msgspec can be imported. In isolated mode and without the module site, Python starts in half of
    the time.
    """
    from importlib.util import find_spec

    msgspec = find_spec("msgspec")
    paths = [Path(__file__).parents[2]] + ([Path(msgspec.origin).parents[1]] if msgspec and msgspec.origin else [])
    folders = [str(folder) for folder in paths]
    code = f"import sys; sys.path += {folders!r}; from {module} import main; sys.exit(main())"
    return [sys.executable, "-I", "-S", "-c", code]


def clean_environment(*, ros: bool, base: Mapping[str, str] | None = None, forked: bool = False) -> dict[str, str]:
    """Return the environment of a child process, derived from `base` (default: os.environ).

    `ros` means that the child imports rclpy, `forked` that the child is a fork. A library path set by the user or by
    a sourced ROS is kept. With `ros`, a fork keeps all library paths, because it cannot be restarted with others.
    """
    environment = dict(os.environ if base is None else base)
    for private in (LIFELINE, READY, GATE):
        environment.pop(private, None)
    if ros and forked:
        environment["PYTHONUNBUFFERED"] = "1"
        return environment
    environment.pop(_GUARD, None)
    libraries = _without_wheels(environment.pop(_LIBRARIES, ""))
    if libraries:
        environment[_LIBRARIES] = libraries
    if not ros:
        environment[_GUARD] = "1"
    environment["PYTHONUNBUFFERED"] = "1"
    return environment


def has_ros_libraries() -> bool:
    """Whether a fork of this process can load the libraries of rclpy with the current library path."""
    folders = os.environ.get(_LIBRARIES, "").split(":")
    prefixes = {match["prefix"] for folder in folders if (match := _WHEEL_FOLDER.fullmatch(folder.rstrip("/")))}
    return _GUARD not in os.environ or bool(prefixes & {sys.prefix, os.path.realpath(sys.prefix)})


def _without_wheels(libraries: str) -> str:
    folders = [folder for folder in libraries.split(":") if folder]
    wheels = [match for folder in folders if (match := _WHEEL_FOLDER.fullmatch(folder.rstrip("/")))]
    if not wheels:
        return libraries
    # The wheels' folders are followed by the lib folder of their environment, spelled as in sys.prefix; in the wheels'
    # folders symbolic links are resolved.
    prefixes = {match["prefix"] for match in wheels}
    if prefixes & {sys.prefix, os.path.realpath(sys.prefix)}:
        prefixes.add(sys.prefix)
    leaked = {PurePath(prefix, "lib") for prefix in prefixes}
    return ":".join(folder for folder in folders if not _leaked(folder, leaked))


def _leaked(folder: str, leaked: set[PurePath]) -> bool:
    return PurePath(folder) in leaked or _WHEEL_FOLDER.fullmatch(folder.rstrip("/")) is not None
