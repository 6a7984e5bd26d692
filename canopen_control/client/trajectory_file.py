"""Trajectory files in the form of trajectory_msgs/JointTrajectory (YAML or JSON), and waypoints in a line of text."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from canopen_control.errors import ConfigError
from canopen_control.host.files import write_whole
from canopen_control.rpc.messages.samples import TrajectoryPoint
from canopen_control.rpc.messages.trajectory import MAX_POINTS
from canopen_control.yamlfile.convert import convert, setting
from canopen_control.yamlfile.reader import read, read_text

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence


_LIMIT: Final = 1e9  # larger numbers and nan are typing errors


@dataclass(frozen=True)
class _Duration:
    """Duration in the form of builtin_interfaces/Duration."""

    sec: int = 0
    nanosec: int = 0


@dataclass(frozen=True)
class _Point:
    """Point in the form of trajectory_msgs/JointTrajectoryPoint; `time_from_start` may also be a number of seconds."""

    positions: tuple[float, ...] = setting((), low=-_LIMIT, high=_LIMIT)
    velocities: tuple[float, ...] = setting((), low=-_LIMIT, high=_LIMIT)
    accelerations: tuple[float, ...] = setting((), low=-_LIMIT, high=_LIMIT)
    effort: tuple[float, ...] = setting((), low=-_LIMIT, high=_LIMIT)
    time_from_start: float | _Duration = setting(0.0, low=-_LIMIT, high=_LIMIT)

    @property
    def time(self) -> float:
        stamp = self.time_from_start
        return stamp.sec + stamp.nanosec / 1e9 if isinstance(stamp, _Duration) else stamp


@dataclass(frozen=True)
class _File:
    """File in the form of trajectory_msgs/JointTrajectory; the header is ignored: a trajectory starts when sent."""

    joint_names: tuple[str, ...]
    points: tuple[_Point, ...]
    header: Any = None


@dataclass(frozen=True)
class _Goal:
    """Section of a file with a trajectory, as in a goal message."""

    trajectory: _File


def read_trajectory(path: str) -> tuple[list[str], list[TrajectoryPoint]]:
    """Read the joints and points of a file; ConfigError lists every error by line."""
    text = read_text(path, ConfigError)
    if not text.strip():
        raise ConfigError(f"{path}: is empty")
    count = text.count("time_from_start")
    if count > MAX_POINTS:  # before it is parsed, which takes a while
        raise ConfigError(f"{path}: {count} points exceed the maximum of {MAX_POINTS} for a trajectory; reduce them")
    return parse_trajectory(text, path)


def parse_trajectory(text: str, path: str) -> tuple[list[str], list[TrajectoryPoint]]:
    """Parse the text of a file into joints and points; `path` names the file in errors."""
    node = read(text, path, error=ConfigError)
    goal = node.get("trajectory")
    content = convert(node, _Goal, None) if goal is not None else convert(node, _File, None)
    node.problems.raise_if_any(ConfigError)
    file: _File = content.trajectory if isinstance(content, _Goal) else content
    return list(file.joint_names), [
        TrajectoryPoint(
            positions=list(point.positions),
            velocities=list(point.velocities),
            accelerations=list(point.accelerations),
            effort=list(point.effort),
            time_from_start=point.time,
        )
        for point in file.points
    ]


def write_trajectory(path: str, joints: Sequence[str], points: Iterable[TrajectoryPoint]) -> None:
    """Write a file for `read_trajectory`, one point per line; raise ConfigError or DiskFull if it cannot be written."""
    lines = [f"joint_names: [{', '.join(joints)}]", "points:"]
    for point in points:
        values = {"positions": point.positions, "velocities": point.velocities, "accelerations": point.accelerations}
        lists = [f"{key}: [{', '.join(map(repr, numbers))}]" for key, numbers in values.items() if numbers]
        lines.append(f"  - {{{', '.join([*lists, f'time_from_start: {point.time_from_start!r}'])}}}")
    try:
        write_whole(path, ("\n".join(lines) + "\n").encode())
    except ConfigError as error:
        raise ConfigError(f"{error}; choose another name") from error


def read_waypoints(text: str, joints: int, step: float) -> list[TrajectoryPoint]:
    """Parse positions such as `0.4 -0.3; 0 0` into points with zero velocity, `step` seconds apart.

    Raise ConfigError if a waypoint is not one position for each joint; `joints` is the number of joints.
    """
    waypoints = []
    for index, part in enumerate(text.split(";"), 1):
        words = part.replace(",", " ").split()
        try:
            positions = [float(word) for word in words]
        except ValueError:
            positions = []
        if len(positions) != joints or not all(abs(position) <= _LIMIT for position in positions):
            place = f"waypoint {index}, {part.strip()!r}, is not one position for each of the {joints} joints"
            raise ConfigError(f"{place}; write it as in: --waypoints '{' '.join(['0.1'] * joints)}'")
        zeros = [0.0] * joints
        waypoints.append(
            TrajectoryPoint(positions=positions, velocities=zeros, accelerations=zeros, time_from_start=index * step)
        )
    return waypoints
