"""Whether ROS 2 can be used from this Python, without importing it.

Importing rclpy with a middleware that it does not have ends the process (exit code 102) instead of raising, and an
rclpy of another Python fails deep inside a C extension; so both are looked at from outside first.
"""

from __future__ import annotations

import importlib.machinery
import importlib.metadata
import importlib.util
import os
from pathlib import Path
from typing import TYPE_CHECKING, Final

from canopen_control.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Mapping

__all__ = ["WHEEL_RMW", "from_wheels", "require_ros"]

WHEEL_RMW: Final = "rmw_fastrtps_cpp"
"""The one middleware that the wheels contain."""

_HOW: Final = 'pip install "canopen-control[ros]" (Linux x86_64), or source a ROS 2 installation'
_EXTENSION: Final = "_rclpy_pybind11"


def require_ros(environment: Mapping[str, str] | None = None) -> None:
    """Raise ConfigError with one sentence, what is wrong and how to get ROS, when rclpy cannot be used."""
    environment = os.environ if environment is None else environment
    folder = _rclpy_folder()
    if folder is None:
        raise ConfigError(f"ROS 2 is not installed: there is no rclpy in this Python; {_HOW}")
    suffixes = importlib.machinery.EXTENSION_SUFFIXES
    if not any((folder / f"{_EXTENSION}{suffix}").exists() for suffix in suffixes):
        raise ConfigError(f"the rclpy in {folder} is made for another Python than this one; {_HOW}")
    wanted = environment.get("RMW_IMPLEMENTATION", "")
    if wanted not in ("", WHEEL_RMW) and from_wheels():
        raise ConfigError(
            f"RMW_IMPLEMENTATION is {wanted}, but the ROS wheels of pip contain {WHEEL_RMW} alone; "
            f"unset it, or source a ROS 2 installation that has {wanted}"
        )


def from_wheels() -> bool:
    """Whether rclpy comes from pip's wheels, not from a sourced ROS installation."""
    folder = _rclpy_folder()
    try:
        wheel = importlib.metadata.distribution("ros-rclpy")
    except importlib.metadata.PackageNotFoundError:
        return False
    return folder is not None and Path(str(wheel.locate_file("rclpy"))).resolve() == folder.resolve()


def _rclpy_folder() -> Path | None:
    try:
        spec = importlib.util.find_spec("rclpy")
    except (ImportError, ValueError):
        return None
    locations = list(spec.submodule_search_locations or ()) if spec is not None else []
    return Path(locations[0]) if locations else None
