"""Simulated sensors on links, with repeatable noise: IMU, range, force-torque, pose, magnetometer.

An IMU measures the orientation of its link in the world, and angular velocities and accelerations, including gravity,
along the axes of the link. A pose is the pose of its link in the world. A range finder measures along the x axis of its
link and returns -1 if nothing is in range. A force-torque sensor measures the load from the parent link, in the axes of
its own link. Units are rad/s, m/s2, m, N, Nm and tesla; `noise` is the standard deviation of every value except those
of an orientation.
"""

from __future__ import annotations

import random
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import mujoco

from canopen_control.errors import nearest
from canopen_control.physics.physics_file import PhysicsError
from canopen_control.physics.urdf_sensors import FORCE, IMU, MAGNET, POSE, RANGE
from canopen_control.urdf.geometry import about

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from canopen_control.physics.physics_file import SensorKind, SensorSettings


_KINDS = mujoco.mjtSensor
#: kind -> measured quantities, in the order of the values
_PARTS: Final[Mapping[SensorKind, tuple[Any, ...]]] = {
    IMU: (_KINDS.mjSENS_FRAMEQUAT, _KINDS.mjSENS_GYRO, _KINDS.mjSENS_ACCELEROMETER),
    RANGE: (_KINDS.mjSENS_RANGEFINDER,),
    FORCE: (_KINDS.mjSENS_FORCE, _KINDS.mjSENS_TORQUE),
    POSE: (_KINDS.mjSENS_FRAMEPOS, _KINDS.mjSENS_FRAMEQUAT),
    MAGNET: (_KINDS.mjSENS_MAGNETOMETER,),
}
#: kind -> suffixes of their names in a scene
_ENDINGS: Final[Mapping[SensorKind, tuple[str, ...]]] = {
    IMU: ("_quat", "_gyro", "_accel"),
    RANGE: ("",),
    FORCE: ("_force", "_torque"),
    POSE: ("_pos", "_quat"),
    MAGNET: ("",),
}
_SITE: Final = "sensor "
_Z_TO_X: Final = about((0.0, 1.0, 0.0), 1.5707963267948966)


@dataclass(frozen=True)
class WorldSensor:
    """Sensor of a world: its name, and its settings from a plant file or a tag."""

    name: str
    settings: SensorSettings

    def own(self) -> tuple[str, ...]:
        """Return the MuJoCo names of the sensor's parts."""
        return tuple(f"{self.name} {number}" for number in range(len(_PARTS[self.settings.kind])))

    def of_scene(self) -> tuple[str, ...]:
        """Return the names of the sensor's parts in an MJCF scene, with mujoco_ros2_control's suffixes, or ()."""
        scene = self.settings.scene
        return tuple(f"{scene}{ending}" for ending in _ENDINGS[self.settings.kind]) if scene else ()


def add_sensors(spec: Any, sensors: Iterable[WorldSensor], path: str) -> None:  # noqa: ANN401 - of MuJoCo
    """Add the sensors that the scene lacks to a specification; raise PhysicsError for a missing link."""
    existing = {sensor.name: sensor for sensor in spec.sensors if sensor.name}
    links = [body.name for body in spec.bodies if body.name != "world"]
    for placed in sensors:
        if _is_present(placed, existing, path):
            continue
        settings = placed.settings
        link, kind = settings.link, settings.kind
        body = spec.body(link) if link in links else None
        if body is None:
            raise PhysicsError(f"{path}: sensor {placed.name}: no link {link!r}{nearest(link, links)}")
        orientation = list(_Z_TO_X) if kind == RANGE else [1.0, 0.0, 0.0, 0.0]
        site = body.add_site(name=f"{_SITE}{placed.name}", quat=orientation)
        for number, part in enumerate(_PARTS[kind]):
            sensor = spec.add_sensor(name=f"{placed.name} {number}", type=part)
            sensor.objtype, sensor.objname = mujoco.mjtObj.mjOBJ_SITE, site.name
            if kind == RANGE:
                sensor.cutoff = settings.reach
                sensor.intprm[0] = 1 << int(mujoco.mjtRayDataField.mjRAYDATA_DIST)


def _is_present(sensor: WorldSensor, existing: Mapping[str, Any], path: str) -> bool:
    """Whether the scene already has the sensor; raise PhysicsError if its type differs."""
    names = sensor.of_scene()
    if not names or not all(name in existing for name in names):
        return False
    for name, kind in zip(names, _PARTS[sensor.settings.kind], strict=True):
        if existing[name].type != kind:
            type_name = kind.name.removeprefix("mjSENS_").lower()
            raise PhysicsError(f"{path}: sensor {sensor.name}: {name} of the scene is not of type {type_name}")
    return True


class SensorReader:
    """Reader of the sensors in a simulation state; `prefix` selects the names of one robot.

    The noise depends on the seed and on the number of reads.
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
        self._random = {
            sensor.name: random.Random(f"{seed} {sensor.settings.seed} {sensor.name}") for sensor in sensors
        }
        self._places: dict[str, list[tuple[int, int]]] = {}
        existing = {model.sensor(number).name for number in range(model.nsensor)}
        for sensor in sensors:
            names = [f"{prefix}{name}" for name in sensor.own()]
            parts = [model.sensor(name) for name in (names if names[0] in existing else sensor.of_scene())]
            self._places[sensor.name] = [(int(part.adr[0]), int(part.adr[0]) + int(part.dim[0])) for part in parts]

    def read(self) -> dict[str, tuple[float, ...]]:
        """Return the values of every sensor, by sensor name."""
        readings = {}
        for sensor in self._sensors:
            numbers: list[float] = []
            for start, end in self._places[sensor.name]:
                noise = 0.0 if end - start == 4 else sensor.settings.noise  # an orientation must keep a length of 1
                numbers += [
                    float(value) + _error(self._random[sensor.name], noise, float(value))
                    for value in self._data.sensordata[start:end]
                ]
            readings[sensor.name] = tuple(numbers)
        return readings


def _error(of: random.Random, noise: float, value: float) -> float:
    """Return random noise for a value; 0 for the value -1 of a range finder without a target."""
    return of.gauss(0.0, noise) if noise and value != -1.0 else 0.0
