"""Sensors of a world: IMU, range finder and force-torque sensor on links, with noise that a seed repeats.

An IMU measures the orientation of its link in the world, angular velocities and accelerations along the link's own
axes, gravity included. A range finder looks along the x axis of its link and tells -1 where there is nothing in reach.
A force-torque sensor measures what a link gets from the one that carries it, in its own axes. Units are rad/s, m/s2, m,
N and Nm; `noise` is the standard deviation of each number but those of an orientation.
"""

from __future__ import annotations

import random
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import mujoco

from canopen_control.errors import nearest
from canopen_control.physics.physics_file import PhysicsError
from canopen_control.urdf.geometry import about

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

__all__ = ["FORCE", "IMU", "INTERFACES", "RANGE", "SensorReader", "WorldSensor", "add_sensors"]

IMU, RANGE, FORCE = "imu", "range", "force_torque"
_KINDS = mujoco.mjtSensor
#: kind -> what is measured, in the order of the numbers
_PARTS: Final[Mapping[str, tuple[Any, ...]]] = {
    IMU: (_KINDS.mjSENS_FRAMEQUAT, _KINDS.mjSENS_GYRO, _KINDS.mjSENS_ACCELEROMETER),
    RANGE: (_KINDS.mjSENS_RANGEFINDER,),
    FORCE: (_KINDS.mjSENS_FORCE, _KINDS.mjSENS_TORQUE),
}
_XYZ: Final = ("x", "y", "z")
#: kind -> the state interfaces of ros2_control, in the order of the numbers
INTERFACES: Final[Mapping[str, tuple[str, ...]]] = {
    IMU: (
        *(f"orientation.{axis}" for axis in ("w", *_XYZ)),
        *(f"angular_velocity.{axis}" for axis in _XYZ),
        *(f"linear_acceleration.{axis}" for axis in _XYZ),
    ),
    RANGE: ("range",),
    FORCE: (*(f"force.{axis}" for axis in _XYZ), *(f"torque.{axis}" for axis in _XYZ)),
}
_SITE: Final = "sensor "
_Z_TO_X: Final = about((0.0, 1.0, 0.0), 1.5707963267948966)


@dataclass(frozen=True)
class WorldSensor:
    """A sensor by its name: what kind, on which link, its noise, and of a range finder how far it reaches in m."""

    name: str
    kind: str
    link: str
    noise: float = 0.0
    reach: float = 10.0


def add_sensors(spec: Any, sensors: Iterable[WorldSensor], path: str) -> None:  # noqa: ANN401 - of MuJoCo
    """Add sensors to a specification; PhysicsError for a link that is not there."""
    links = [body.name for body in spec.bodies if body.name != "world"]
    for each in sensors:
        body = spec.body(each.link) if each.link in links else None
        if body is None:
            raise PhysicsError(f"{path}: sensor {each.name}: no link {each.link!r}{nearest(each.link, links)}")
        looks = list(_Z_TO_X) if each.kind == RANGE else [1.0, 0.0, 0.0, 0.0]
        site = body.add_site(name=f"{_SITE}{each.name}", quat=looks)
        for number, kind in enumerate(_PARTS[each.kind]):
            sensor = spec.add_sensor(name=f"{each.name} {number}", type=kind)
            sensor.objtype, sensor.objname = mujoco.mjtObj.mjOBJ_SITE, site.name
            if each.kind == RANGE:
                sensor.cutoff = each.reach
                sensor.intprm[0] = 1 << int(mujoco.mjtRayDataField.mjRAYDATA_DIST)


class SensorReader:
    """Reads the sensors of a state, those of one robot by its `prefix` in the model.

    What noise adds depends on the seed and on how often they were read.
    """

    def __init__(
        self,
        model: Any,  # noqa: ANN401 - of MuJoCo
        data: Any,  # noqa: ANN401 - as above
        sensors: Sequence[WorldSensor],
        seed: int = 0,
        prefix: str = "",
    ) -> None:
        self._data, self._sensors = data, sensors
        self._random = random.Random(seed)
        self._places: dict[str, list[tuple[int, int]]] = {}
        for each in sensors:
            parts = [model.sensor(f"{prefix}{each.name} {number}") for number in range(len(_PARTS[each.kind]))]
            self._places[each.name] = [(int(part.adr[0]), int(part.adr[0]) + int(part.dim[0])) for part in parts]

    def read(self) -> dict[str, tuple[float, ...]]:
        """Return the numbers of each sensor by its name."""
        found = {}
        for each in self._sensors:
            numbers: list[float] = []
            for start, end in self._places[each.name]:
                noise = 0.0 if end - start == 4 else each.noise  # an orientation has a length of 1
                numbers += [
                    float(value) + self._error(noise, float(value)) for value in self._data.sensordata[start:end]
                ]
            found[each.name] = tuple(numbers)
        return found

    def _error(self, noise: float, value: float) -> float:
        return self._random.gauss(0.0, noise) if noise and value != -1.0 else 0.0
