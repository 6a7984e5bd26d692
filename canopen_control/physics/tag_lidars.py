"""Lidars and cameras among the <sensor> tags of a simulation plugin, with the parameters of mujoco_ros2_control.

A sensor with `min_angle`, `max_angle` and `angle_increment` (rad, to the left) is a lidar: it looks along the x axis of
its `frame_name` and turns about z. Others are `range_min`, `range_max` (m), `laserscan_topic`, `noise` and `seed`;
`lidar_publish_rate` (Hz) is the hardware's. A camera needs OpenGL, which is not there: it is told and left out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from canopen_control.errors import nearest
from canopen_control.physics.physics_file import PhysicsError

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from canopen_control.urdf.ros2_control import ControlJoint, Ros2ControlSystem

__all__ = ["LidarSettings", "camera_notes", "frame_error", "tag_lidars"]

_NEEDED: Final = ("min_angle", "max_angle", "angle_increment")
_CAMERA: Final = ("image_topic", "depth_topic", "info_topic")
_DEFAULTS: Final[Mapping[str, float]] = {"range_min": 0.0, "range_max": 1000.0, "noise": 0.0, "seed": 0.0}
_MOST_RAYS: Final = 10_000
_COUNTLESS: Final = 1e9
_RATE: Final = "lidar_publish_rate"
_FASTEST: Final = 1000.0


@dataclass(frozen=True)
class LidarSettings:
    """A lidar by its name: rad, m, Hz; `place` says where its tag stands."""

    name: str
    frame: str
    topic: str
    min_angle: float
    max_angle: float
    increment: float
    range_min: float
    range_max: float
    rate: float
    noise: float
    seed: int
    place: str

    @property
    def count(self) -> int:
        """How many rays a scan has."""
        return int(min(_COUNTLESS, (self.max_angle - self.min_angle) / self.increment + 1e-9)) + 1


def tag_lidars(tag: Ros2ControlSystem, root: str, path: str) -> list[LidarSettings]:
    """Return the lidars of a tag; PhysicsError with every mistake and its place in the file at `path`."""
    found, problems = [], list[str]()
    for part in tag.sensors:
        if not any(key in part.parameters for key in _NEEDED):
            continue
        place, wrong = f"{path}:{part.place.line}:{part.place.column}", list[str]()
        lidar = _lidar(part, tag.parameters, root, place, wrong)
        problems += [f"{place}: sensor {part.name}: {text}" for text in wrong]
        if not wrong:
            found.append(lidar)
    if problems:
        raise PhysicsError("\n".join(problems))
    return found


def _lidar(part: ControlJoint, hardware: Mapping[str, str], root: str, place: str, wrong: list[str]) -> LidarSettings:
    """Return a lidar; what is wrong of it is added to `wrong`."""
    given = part.parameters
    wrong += [f"no {key}; a lidar has {', '.join(_NEEDED)} in rad" for key in _NEEDED if key not in given]
    number = {key: _number(given, key, 0.0, wrong) for key in _NEEDED}
    number |= {key: _number(given, key, default, wrong) for key, default in _DEFAULTS.items()}
    rate = _number(hardware, _RATE, 5.0, wrong)
    least, most, increment = (number[key] for key in _NEEDED)
    lidar = LidarSettings(
        part.name,
        given.get("frame_name", given.get("frame_id", root)).strip(),
        given.get("laserscan_topic", "/scan").strip(),
        least,
        most,
        increment if increment > 0.0 else 1.0,
        number["range_min"],
        number["range_max"],
        rate,
        number["noise"],
        round(number["seed"]),
        place,
    )
    if wrong:
        return lidar
    for bad, text in (
        (increment <= 0.0, f"angle_increment is {increment:g}; it is above 0"),
        (most < least, f"max_angle {most:g} is below min_angle {least:g}"),
        (lidar.count > _MOST_RAYS, f"it has {lidar.count} rays; {_MOST_RAYS} are the most"),
        (not 0.0 <= lidar.range_min < lidar.range_max, "range_min is from 0 and below range_max"),
        (lidar.noise < 0.0, f"noise is {lidar.noise:g}; it is a number from 0"),
        (number["seed"] < 0.0 or number["seed"] != lidar.seed, "seed is a whole number from 0"),
        (
            not 0.0 < rate <= _FASTEST,
            f"{_RATE} of its hardware is {rate:g}; it is above 0, and {_FASTEST:g} Hz at most",
        ),
        (not lidar.topic, "laserscan_topic is empty"),
    ):
        wrong += [text] if bad else []
    return lidar


def _number(given: Mapping[str, str], key: str, default: float, wrong: list[str]) -> float:
    try:
        value = float(given.get(key, default))
    except ValueError:
        value = math.nan
    if math.isfinite(value):
        return value
    wrong.append(f"{key} is {given[key]!r}; it is a finite number")
    return default


def camera_notes(parts: Iterable[ControlJoint], cameras: Iterable[str] = ()) -> list[str]:
    """Return a sentence for each camera of a tag, or of a scene by its name, that is not shown."""
    names = [part.name for part in parts if any(key in part.parameters for key in _CAMERA)]
    names += [part.name for part in parts if part.parameters.get("mujoco_type", "").strip() == "camera"]
    return [
        f"camera {name} has no images: they need OpenGL, which mujoco-core does not bring"
        for name in dict.fromkeys([*names, *cameras])
    ]


def frame_error(lidar: LidarSettings, frames: Iterable[str]) -> PhysicsError:
    """Return the error of a lidar whose frame is not there."""
    names = [each for each in frames if each]
    return PhysicsError(
        f"{lidar.place}: sensor {lidar.name}: no link {lidar.frame!r} for its frame_name{nearest(lidar.frame, names)}"
    )
