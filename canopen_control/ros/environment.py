"""The variables that ROS reads when it starts, set so that a robot stays on this host unless somebody says otherwise.

The law of the file: what the user has set wins, always. Otherwise discovery stays on the local host, and Fast DDS gets
the profile `loopback.xml` of this folder, which binds its sockets to 127.0.0.1 and announces quickly; the profile goes
with the local host only, since it cuts every other interface.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

from canopen_control.ros.available import WHEEL_RMW

if TYPE_CHECKING:
    from collections.abc import Mapping, MutableMapping

__all__ = ["PROFILE", "describe", "prepare"]

PROFILE: Final = Path(__file__).with_name("loopback.xml")
_RANGE: Final = "ROS_AUTOMATIC_DISCOVERY_RANGE"
_LOCAL_ONLY: Final = "ROS_LOCALHOST_ONLY"  # deprecated, still obeyed by Jazzy
_PROFILES: Final = "FASTRTPS_DEFAULT_PROFILES_FILE"
#: set by a user who steers discovery or transports himself; our profile would work against him
_OWN_WAYS: Final = (_PROFILES, "FASTDDS_DEFAULT_PROFILES_FILE", "ROS_DISCOVERY_SERVER", "ROS_STATIC_PEERS")


def prepare(environment: MutableMapping[str, str], *, wheels: bool, prefix: str) -> None:
    """Set what is not set. `wheels` says that rclpy comes from pip's wheels, `prefix` where those are installed."""
    if wheels:
        environment.setdefault("AMENT_PREFIX_PATH", prefix)
    if environment.get(_LOCAL_ONLY) != "1":
        environment.setdefault(_RANGE, "LOCALHOST")
    fast_dds = environment.get("RMW_IMPLEMENTATION", WHEEL_RMW) in ("", WHEEL_RMW)
    if fast_dds and _stays_local(environment) and not any(environment.get(name) for name in _OWN_WAYS):
        environment[_PROFILES] = str(PROFILE)


def describe(environment: Mapping[str, str]) -> str:
    """Return in words who can see the robot."""
    reach = "this host only" if _stays_local(environment) else f"discovery range {environment.get(_RANGE, 'SUBNET')}"
    return f"ROS domain {environment.get('ROS_DOMAIN_ID') or 0}, {reach}"


def _stays_local(environment: Mapping[str, str]) -> bool:
    return environment.get(_LOCAL_ONLY) == "1" or environment.get(_RANGE, "").upper() == "LOCALHOST"
