"""The environment of a child process: ours, without what was meant for this process alone.

The ROS wheels start every interpreter of their environment anew, with their own libraries put into LD_LIBRARY_PATH and
a guard variable set. Both are inherited, and break a child that uses another environment: its rclpy finds the wrong
libraries and, the guard being set, does not look for the right ones. So a child that needs rclpy gets neither, and any
other child gets the guard alone, which saves it the second start.
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
#: what starts a module of the package; -P: a file of the folder we were started in is none of Python's modules
MODULE: Final = (sys.executable, "-P", "-m")
_GUARD: Final = "_ROS_WHEELS_BOOTSTRAP_COMPLETE"
_LIBRARIES: Final = "LD_LIBRARY_PATH"
_WHEEL_FOLDER: Final = re.compile(r"(?P<prefix>.+)/lib\d*/python[^/]+/site-packages/ros_[^/]+\.libs")


def lean_python(module: str) -> list[str]:
    """Return the command that runs `main` of a module of the package with nothing else but msgspec to be found.

    Isolated and without site, Python starts in half the time.
    """
    from importlib.util import find_spec

    msgspec = find_spec("msgspec")
    found = [Path(__file__).parents[2]] + ([Path(msgspec.origin).parents[1]] if msgspec and msgspec.origin else [])
    folders = [str(folder) for folder in found]
    code = f"import sys; sys.path += {folders!r}; from {module} import main; sys.exit(main())"
    return [sys.executable, "-I", "-S", "-c", code]


def clean_environment(*, ros: bool, base: Mapping[str, str] | None = None) -> dict[str, str]:
    """Return the environment for a child, made from `base` (default: ours); `ros` says that it imports rclpy.

    A library path that the user or a sourced ROS has set stays.
    """
    environment = dict(os.environ if base is None else base)
    for private in (LIFELINE, READY, _GUARD):
        environment.pop(private, None)
    libraries = _without_wheels(environment.pop(_LIBRARIES, ""))
    if libraries:
        environment[_LIBRARIES] = libraries
    if not ros:
        environment[_GUARD] = "1"
    environment["PYTHONUNBUFFERED"] = "1"
    return environment


def _without_wheels(libraries: str) -> str:
    folders = [folder for folder in libraries.split(":") if folder]
    wheels = [match for folder in folders if (match := _WHEEL_FOLDER.fullmatch(folder.rstrip("/")))]
    if not wheels:
        return libraries
    # With the wheels' folders comes the lib folder of their environment; ours is named there as it was called, theirs
    # are named without symbolic links.
    prefixes = {match["prefix"] for match in wheels}
    if prefixes & {sys.prefix, os.path.realpath(sys.prefix)}:
        prefixes.add(sys.prefix)
    leaked = {PurePath(prefix, "lib") for prefix in prefixes}
    return ":".join(folder for folder in folders if not _leaked(folder, leaked))


def _leaked(folder: str, leaked: set[PurePath]) -> bool:
    return PurePath(folder) in leaked or _WHEEL_FOLDER.fullmatch(folder.rstrip("/")) is not None
