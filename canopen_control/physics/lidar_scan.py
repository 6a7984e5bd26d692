"""A planar lidar in a world: rays cast from a link, or a site of a scene, when somebody asks for a scan.

The rays lie in the plane of the link's x and y axes, from `min_angle` to `max_angle` about z. They see everything but
the link's own shapes. What is nearer than `range_min` or further than `range_max` is -1, as in mujoco_ros2_control.
"""

from __future__ import annotations

import random
from typing import TYPE_CHECKING, Any, Final

import mujoco
import numpy as np

from canopen_control.physics.tag_lidars import frame_error
from canopen_control.rpc.messages.simulation import LaserScanReading

if TYPE_CHECKING:
    from canopen_control.physics.tag_lidars import LidarSettings

__all__ = ["LidarScanner"]

_NOTHING: Final = -1.0
_DIGITS: Final = 4  # of a metre


class LidarScanner:
    """One lidar of a model in a state; PhysicsError where its frame is not there."""

    def __init__(self, model: Any, data: Any, settings: LidarSettings) -> None:  # noqa: ANN401 - MuJoCo has no types
        self._model, self._data, self._settings = model, data, settings
        sites = {model.site(number).name: number for number in range(model.nsite)}
        bodies = {model.body(number).name: number for number in range(model.nbody)}
        if settings.frame in bodies:
            self._body = bodies[settings.frame]
            self._place, self._turn = data.xpos[self._body], data.xmat[self._body]
        elif settings.frame in sites:
            site = sites[settings.frame]
            self._body = int(model.site_bodyid[site])
            self._place, self._turn = data.site_xpos[site], data.site_xmat[site]
        else:
            raise frame_error(settings, [*bodies, *sites])
        angles = settings.min_angle + settings.increment * np.arange(settings.count)
        self._rays = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(settings.count)])
        self._hit = np.zeros(settings.count, dtype=np.int32)
        self._found = np.zeros(settings.count)
        self.begin()

    def begin(self) -> None:
        """Let its noise begin anew."""
        self._random = random.Random(f"{self._settings.seed} {self._settings.name}")

    def scan(self, seconds: float) -> LaserScanReading:
        """Return what it sees now, `seconds` into the simulation."""
        settings = self._settings
        rays = (self._rays @ self._turn.reshape(3, 3).T).flatten()
        place, count, cutoff = self._place.copy(), settings.count, settings.range_max
        mujoco.mj_multiRay(
            self._model, self._data, place, rays, None, True, self._body, self._hit, self._found, None, count, cutoff
        )
        return LaserScanReading(
            name=settings.name,
            topic=settings.topic,
            frame_id=settings.frame,
            seconds=seconds,
            angle_min=settings.min_angle,
            angle_max=settings.max_angle,
            angle_increment=settings.increment,
            range_min=settings.range_min,
            range_max=settings.range_max,
            scan_time=1.0 / settings.rate,
            ranges=[self._told(float(each), hit) for each, hit in zip(self._found, self._hit.tolist(), strict=True)],
        )

    def _told(self, distance: float, hit: int) -> float:
        settings = self._settings
        if hit < 0:
            return _NOTHING
        seen = distance + (self._random.gauss(0.0, settings.noise) if settings.noise else 0.0)
        return round(seen, _DIGITS) if settings.range_min <= seen <= settings.range_max else _NOTHING
