"""A trajectory that a page has loaded: its points by number, where the joints are to be in each, and words for it.

What is shown are the points of the file itself: what the robot makes of the time between two of them is up to its
controller. No browser, no toolkit.
"""

from __future__ import annotations

from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING, Final

from canopen_control.client.trajectory_file import parse_trajectory
from canopen_control.errors import ConfigError
from canopen_control.rpc.messages.samples import TrajectorySample, kind_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from canopen_control.rpc.messages.samples import TrajectoryPoint
    from canopen_control.rpc.messages.state import ControllerReading

__all__ = [
    "MOST_BYTES",
    "LoadedTrajectory",
    "follows_trajectories",
    "load",
    "place_text",
    "preview_table",
    "progress_of",
    "trajectory_takers",
]

MOST_BYTES: Final = 1_000_000  # what is read here is read beside STOP; the shell reads longer ones


@dataclass(frozen=True, slots=True)
class LoadedTrajectory:
    """A file's joints and points; `name` is what the user called it. Times are s from its start."""

    name: str
    joints: list[str]
    points: list[TrajectoryPoint]

    @property
    def duration(self) -> float:
        """When its last point is due."""
        return self.points[-1].time_from_start

    def positions(self, number: int) -> dict[str, float]:
        """Return where the joints are to be in a point, in rad or m; nothing of one that gives none."""
        positions = self.points[number].positions
        return dict(zip(self.joints, positions, strict=True)) if len(positions) == len(self.joints) else {}


def load(data: bytes, name: str) -> LoadedTrajectory:
    """Read a file that came from a browser; ConfigError with every mistake and its line."""
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise ConfigError(f"{name}:{line}: no UTF-8; save the file as UTF-8") from None
    joints, points = parse_trajectory(text, name)
    if not points:
        raise ConfigError(f"{name}: it has no points; give it one at least")
    return LoadedTrajectory(name, joints, points)


def trajectory_takers(controllers: Iterable[ControllerReading]) -> list[str]:
    """Return the active controllers that follow trajectories."""
    return [each.name for each in controllers if follows_trajectories(each) and each.state == "active"]


def follows_trajectories(controller: ControllerReading) -> bool:
    """Whether a controller is a joint trajectory controller, active or not."""
    return controller.tells == kind_of(TrajectorySample)


def progress_of(sample: TrajectorySample | None, duration: float) -> tuple[float, str]:
    """Return how much of a trajectory is done, from 0 to 1, and in words, by what its controller tells."""
    if sample is None or not sample.executing:
        return 0.0, "Playing."
    at = min(max(sample.reference.time_from_start, 0.0), duration)
    slow = sample.speed_scaling_factor
    scaled = "" if slow == 1.0 else f", at {100 * slow:.3g} % of its speed"
    return at / duration if duration > 0 else 1.0, f"Playing: {at:.1f} of {duration:.1f} s{scaled}."


def place_text(loaded: LoadedTrajectory, number: int) -> str:
    """Say which point is previewed, and that nothing moves."""
    at = loaded.points[number].time_from_start
    return f"Preview, the robot does not move: point {number + 1} of {len(loaded.points)}, at {at:.2f} s"


def preview_table(
    loaded: LoadedTrajectory, number: int, now: Mapping[str, float | None], linear: frozenset[str]
) -> str:
    """Return where each joint is to be in a point, and where it is, as HTML."""
    wanted = loaded.positions(number)
    if not wanted:
        return "<p class='cc-note'>This point has no positions.</p>"
    lines = [
        f"<tr><td><b>{escape(joint)}</b></td><td>{_number(position)}<small>{'m' if joint in linear else 'rad'}</small>"
        f"</td><td>{_now(joint, now)}</td></tr>"
        for joint, position in wanted.items()
    ]
    titles = "<tr><th>joint</th><th>preview</th><th>now</th></tr>"
    return f"<table class='cc-table cc-joints cc-preview'>{titles}{''.join(lines)}</table>"


def _now(joint: str, now: Mapping[str, float | None]) -> str:
    if joint not in now:
        return "no joint of this robot"
    position = now[joint]
    return "-" if position is None else _number(position)


def _number(position: float) -> str:
    return f"{round(position, 3) + 0.0:.3f}"
