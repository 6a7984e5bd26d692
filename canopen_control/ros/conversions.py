"""From the API's JSON to what ROS messages hold, as plain numbers: this file imports no ROS.

The law of the file (REP 103, REP 107, ros2_control): SI units on both sides; what the API does not know (null) is nan;
the arrays of a joint state have one length; a stamp is when the sample was taken, not when it is sent. A broadcaster's
joint states hold what it tells, by its parameters, not all that the sample knows.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

__all__ = [
    "ControllerView",
    "JointArrays",
    "controllers_of",
    "diagonal",
    "joint_arrays",
    "quaternion_of_yaw",
    "seconds_of",
    "stamp_of",
    "told_joints",
    "wrong",
]

Json = dict[str, Any]
_NO_INTERFACE: Final = "command"  # in the state stream, what a controller wants


class ControllerView(NamedTuple):
    """A controller as `controllers` of the API tells it; `width` is how many values a command has.

    `publishes` are its topics of joint states, relative to the namespace; `frame_id` is the frame of their headers;
    `tells` is what stands in them: by joint and name, the state interface of a value, None for a constant 0.0.
    """

    name: str
    type: str
    state: str
    joints: tuple[str, ...]
    topic: str | None
    is_broadcaster: bool
    width: int
    interface: str | None = None
    publishes: tuple[str, ...] = ()
    frame_id: str = ""
    tells: Mapping[str, Mapping[str, str | None]] | None = None

    @property
    def active(self) -> bool:
        """Whether it runs."""
        return self.state == "active"

    def published(self, kind: str) -> str | None:
        """Return its topic whose last word is `kind`, None if it has none."""
        return next((each for each in self.publishes if each.rsplit("/", 1)[-1] == kind), None)


class JointArrays(NamedTuple):
    """What a JointState message holds."""

    names: list[str]
    position: list[float]
    velocity: list[float]
    effort: list[float]


def controllers_of(answer: Iterable[Json]) -> dict[str, ControllerView]:
    """Return the controllers of the API's answer by name, in its order."""
    views = {}
    for each in answer:
        name = str(each["name"])
        views[name] = ControllerView(
            name,
            str(each.get("type", "")),
            str(each.get("state", "")),
            tuple(each.get("joints") or ()),
            each.get("topic"),
            bool(each.get("is_broadcaster", False)),
            len(each.get("required_command_interfaces") or each.get("claimed_interfaces") or ()),
            each.get("interface"),
            tuple(each.get("publishes") or ()),
            str(each.get("frame_id") or ""),
            each.get("tells"),
        )
    return views


def stamp_of(unix_s: float) -> tuple[int, int]:
    """Return seconds and nanoseconds of a time in Unix seconds."""
    seconds = math.floor(unix_s)
    return seconds, min(round((unix_s - seconds) * 1e9), 999_999_999)


def joint_arrays(joints: Mapping[str, Json], names: Sequence[str] = ()) -> JointArrays:
    """Return the joints' states in the order of `names`, alphabetically without; what is not known is nan."""
    ordered = [name for name in names if name in joints] if names else sorted(joints)
    columns = [[_number(joints[name].get(kind)) for name in ordered] for kind in ("position", "velocity", "effort")]
    return JointArrays(ordered, *columns)


def told_joints(joints: Mapping[str, Json], controller: ControllerView) -> dict[str, Json]:
    """Return what a broadcaster tells of a sample's joints; all of them if it does not say what (it never ran)."""
    if not controller.tells:
        names = [name for name in controller.joints if name in joints] or sorted(joints)
        return {name: {kind: joints[name][kind] for kind in joints[name] if kind != _NO_INTERFACE} for name in names}
    return {
        joint: {name: 0.0 if source is None else joints[joint].get(source) for name, source in names.items()}
        for joint, names in controller.tells.items()
        if joint in joints or None in names.values()
    }


def quaternion_of_yaw(yaw: float) -> tuple[float, float, float, float]:
    """Return (x, y, z, w) of a rotation by `yaw` rad about z."""
    return 0.0, 0.0, math.sin(yaw / 2.0), math.cos(yaw / 2.0)


def seconds_of(seconds: int, nanoseconds: int) -> float | None:
    """Return a stamp in Unix seconds; zero is no stamp, None."""
    return seconds + nanoseconds / 1e9 if seconds or nanoseconds else None


def diagonal(values: Sequence[float]) -> list[float]:
    """Return a covariance of six by six, row by row, with these on its diagonal; 0 where there are none."""
    covariance = [0.0] * 36
    for row, value in enumerate(values[:6]):
        covariance[7 * row] = float(value)
    return covariance


def wrong(values: Sequence[float], controller: ControllerView) -> str | None:
    """Return why the robot would refuse these values as a command, None when it takes them."""
    if not all(map(math.isfinite, values)):
        return f"{controller.name}: a value is not finite: {_shown(values)}; the command was dropped"
    if controller.width and len(values) != controller.width:
        return f"{controller.name} wants {controller.width} values, got {len(values)}; the command was dropped"
    if not controller.active:
        return f"{controller.name} is {controller.state}; activate it before commanding it"
    return None


def _shown(values: Sequence[float], most: int = 8) -> str:
    more = ", ..." if len(values) > most else ""
    return f"[{', '.join(f'{value:g}' for value in values[:most])}{more}]"


def _number(value: object) -> float:
    return float(value) if isinstance(value, int | float) else math.nan
