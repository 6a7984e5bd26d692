"""Check of the ROS 2 installation of this Python, and environment variables for rclpy.

Importing rclpy with a middleware that is not installed ends the process (exit code 102) instead of raising an
exception, and an rclpy for another Python fails deep inside a C extension; so both are checked first, without an
import.

Settings of the user always take precedence. Otherwise discovery is restricted to the local host, and Fast DDS gets the
profile `loopback.xml` of this folder, which binds its sockets to 127.0.0.1 and announces participants quickly; the
profile is used only with the local host, because it disables every other network interface.
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
    from collections.abc import Mapping, MutableMapping


WHEEL_RMW: Final = "rmw_fastrtps_cpp"
"""Only middleware that the wheels contain."""
_INSTALL_ADVICE: Final = 'pip install "canopen-control[ros]" (Linux x86_64), or source a ROS 2 installation'
_EXTENSION: Final = "_rclpy_pybind11"
PROFILE: Final = Path(__file__).with_name("loopback.xml")
_RANGE: Final = "ROS_AUTOMATIC_DISCOVERY_RANGE"
_LOCAL_ONLY: Final = "ROS_LOCALHOST_ONLY"  # deprecated, but still effective in Jazzy
_PROFILES: Final = "FASTRTPS_DEFAULT_PROFILES_FILE"
#: variables by which a user selects discovery or transport settings, which this package's profile would override
_USER_SETTINGS: Final = (_PROFILES, "FASTDDS_DEFAULT_PROFILES_FILE", "ROS_DISCOVERY_SERVER", "ROS_STATIC_PEERS")


def require_ros(environment: Mapping[str, str] | None = None) -> None:
    """Raise ConfigError with the reason and a remedy if rclpy cannot be used."""
    environment = os.environ if environment is None else environment
    folder = _rclpy_folder()
    if folder is None:
        raise ConfigError(f"ROS 2 is not installed: this Python has no rclpy; {_INSTALL_ADVICE}")
    suffixes = importlib.machinery.EXTENSION_SUFFIXES
    if not any((folder / f"{_EXTENSION}{suffix}").exists() for suffix in suffixes):
        raise ConfigError(f"the rclpy in {folder} was built for another Python; {_INSTALL_ADVICE}")
    middleware = environment.get("RMW_IMPLEMENTATION", "")
    if middleware not in ("", WHEEL_RMW) and from_wheels():
        raise ConfigError(
            f"RMW_IMPLEMENTATION is {middleware}, but the ROS wheels of pip contain only {WHEEL_RMW}; "
            f"unset it, or source a ROS 2 installation that has {middleware}"
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


def prepare(environment: MutableMapping[str, str], *, wheels: bool, prefix: str) -> None:
    """Set the environment variables that ROS needs, unless the user has set them.

    `wheels` is True if rclpy was installed from wheels below `prefix`.
    """
    if wheels:
        environment.setdefault("AMENT_PREFIX_PATH", prefix)
    if environment.get(_LOCAL_ONLY) != "1":
        environment.setdefault(_RANGE, "LOCALHOST")
    fast_dds = environment.get("RMW_IMPLEMENTATION", WHEEL_RMW) in ("", WHEEL_RMW)
    if fast_dds and _stays_local(environment) and not any(environment.get(name) for name in _USER_SETTINGS):
        environment[_PROFILES] = str(PROFILE)


def describe(environment: Mapping[str, str]) -> str:
    """Return a text with the ROS domain and the discovery range."""
    reach = "this host only" if _stays_local(environment) else f"discovery range {environment.get(_RANGE, 'SUBNET')}"
    return f"ROS domain {environment.get('ROS_DOMAIN_ID') or 0}, {reach}"


def _stays_local(environment: Mapping[str, str]) -> bool:
    return environment.get(_LOCAL_ONLY) == "1" or environment.get(_RANGE, "").upper() == "LOCALHOST"
