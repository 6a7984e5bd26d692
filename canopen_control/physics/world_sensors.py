"""Simulated sensors on links, with repeatable noise (IMU, range, force-torque, pose, magnetometer), and their tags.

An IMU measures the orientation of its link in the world, and angular velocities and accelerations, including gravity,
along the axes of the link. A pose is the pose of its link in the world. A range finder measures along the x axis of its
link and returns -1 if nothing is in range. A force-torque sensor measures the load from the parent link, in the axes of
its own link. Units are rad/s, m/s2, m, N, N m and tesla; `noise` is the standard deviation of every value except those
of an orientation.

The kind of a tag follows from the state interfaces, or from the parameter `mujoco_type`, as in mujoco_ros2_control.
Other parameters are `frame_id` (the link, default the root), `noise`, `seed` (of the noise) and `range_max` in m. A
sensor of another kind is ignored. Reading tags needs no MuJoCo.
"""

from __future__ import annotations

import math
import random
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import mujoco

from canopen_control.errors import nearest
from canopen_control.physics.physics_file import PhysicsError, SensorKind, SensorSettings
from canopen_control.urdf.geometry import about

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping, Sequence

    from canopen_control.urdf.ros2_control import ControlJoint


IMU: Final = "imu"
RANGE: Final = "range"
FORCE: Final = "force_torque"
POSE: Final = "pose"
MAGNET: Final = "magnetometer"
_XYZ: Final = ("x", "y", "z")
_ORIENTATION: Final = tuple(f"orientation.{axis}" for axis in ("w", *_XYZ))
#: kind -> the state interfaces of ros2_control, in the order of the values
INTERFACES: Final[Mapping[SensorKind, tuple[str, ...]]] = {
    IMU: (
        *_ORIENTATION,
        *(f"angular_velocity.{axis}" for axis in _XYZ),
        *(f"linear_acceleration.{axis}" for axis in _XYZ),
    ),
    RANGE: ("range",),
    FORCE: (*(f"force.{axis}" for axis in _XYZ), *(f"torque.{axis}" for axis in _XYZ)),
    POSE: (*(f"position.{axis}" for axis in _XYZ), *_ORIENTATION),
    MAGNET: tuple(f"magnetic_field.{axis}" for axis in _XYZ),
}
#: prefix of an interface -> kind, in the order of the tests: a pose has an orientation too
_BEGINNINGS: Final[tuple[tuple[str, SensorKind], ...]] = (
    ("position.", POSE),
    ("orientation.", IMU),
    ("angular_velocity.", IMU),
    ("linear_acceleration.", IMU),
    ("force.", FORCE),
    ("torque.", FORCE),
    ("magnetic_field.", MAGNET),
    ("range", RANGE),
)
#: `mujoco_type` -> kind
_TYPES: Final[Mapping[str, SensorKind]] = {"imu": IMU, "fts": FORCE, "pose": POSE, "magnetometer": MAGNET}
_OTHERS: Final = ("camera", "lidar")  # see `tag_lidars`
SENSOR_PREFIX: Final = "mujoco_sensor_name"
"""Name of the parameter with the prefix of the sensor names in a MuJoCo scene."""
_LARGEST_SEED: Final = 2**31 - 1


def urdf_sensors(
    parts: Iterable[ControlJoint], links: Collection[str], root: str, path: str
) -> dict[str, SensorSettings]:
    """Return the sensors of a <ros2_control> tag by name; PhysicsError lists all errors by line."""
    sensors, problems = {}, list[str]()
    for part in parts:
        wrong = list[str]()
        settings = _sensor(part, links, root, wrong)
        problems += [f"{path}:{part.place.line}:{part.place.column}: sensor {part.name}: {text}" for text in wrong]
        if settings is not None:
            sensors[part.name] = settings
    if problems:
        raise PhysicsError("\n".join(problems))
    return sensors


def _kind(part: ControlJoint) -> SensorKind | None:
    """Return the kind of a sensor tag, or None if a world cannot simulate it."""
    mujoco_type = part.parameters.get("mujoco_type")
    if mujoco_type is not None:
        return _TYPES.get(mujoco_type.strip())
    names = [*part.state_interfaces]
    return next((kind for word, kind in _BEGINNINGS if any(name.startswith(word) for name in names)), None)


def _sensor(part: ControlJoint, links: Collection[str], root: str, wrong: list[str]) -> SensorSettings | None:
    """Return the settings of a sensor tag, or None if a world cannot simulate it; append errors to `wrong`."""
    params = part.parameters
    mujoco_type = params.get("mujoco_type", "").strip()
    if mujoco_type and mujoco_type not in (*_TYPES, *_OTHERS):
        wrong.append(f"no mujoco_type {mujoco_type!r}{nearest(mujoco_type, _TYPES)}")
    kind = _kind(part)
    if kind is None:
        return None
    unknown = [name for name in part.state_interfaces if name not in INTERFACES[kind]]
    wrong += [f"{name!r} is not an interface of a {kind} sensor{nearest(name, INTERFACES[kind])}" for name in unknown]
    link = params.get("frame_id", root).strip()
    if link not in links and SENSOR_PREFIX not in params:
        wrong.append(f"no link {link!r} for its frame_id{nearest(link, links)}")
    noise, reach = (_number(params, key, default, wrong) for key, default in (("noise", 0.0), ("range_max", 10.0)))
    seed = _number(params, "seed", 0.0, wrong)
    if seed != round(seed) or seed > _LARGEST_SEED:
        wrong.append(f"seed is {params['seed']!r}; it must be an integer from 0 to {_LARGEST_SEED}")
    if reach == 0.0:
        wrong.append("range_max is 0; it must be above 0")
    scene = params.get(SENSOR_PREFIX, "").strip()
    return None if wrong else SensorSettings(kind, link, noise, reach, round(seed), scene)


def _number(params: Mapping[str, str], key: str, default: float, wrong: list[str]) -> float:
    try:
        value = float(params.get(key, default))
    except ValueError:
        value = math.nan
    if math.isfinite(value) and value >= 0.0:
        return value
    wrong.append(f"{key} is {params[key]!r}; it must be 0 or more")
    return default


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
    """Sensor on a link of a world: name, kind, link, noise, and range in m of a range finder."""

    name: str
    kind: SensorKind
    link: str
    noise: float = 0.0
    reach: float = 10.0
    seed: int = 0  # of the noise
    scene: str = ""  # prefix of its parts in a scene

    @classmethod
    def of(cls, name: str, settings: SensorSettings) -> WorldSensor:
        """Create the sensor described by the settings of a plant file or a tag."""
        return cls(name, settings.kind, settings.link, settings.noise, settings.reach, settings.seed, settings.scene)

    def own(self) -> tuple[str, ...]:
        """Return the MuJoCo names of the sensor's parts."""
        return tuple(f"{self.name} {number}" for number in range(len(_PARTS[self.kind])))

    def of_scene(self) -> tuple[str, ...]:
        """Return the names of the sensor's parts in an MJCF scene, with mujoco_ros2_control's suffixes if any."""
        return tuple(f"{self.scene}{ending}" for ending in _ENDINGS[self.kind]) if self.scene else ()


def add_sensors(spec: Any, sensors: Iterable[WorldSensor], path: str) -> None:  # noqa: ANN401 - of MuJoCo
    """Add sensors that the scene lacks to a specification; raise PhysicsError for a missing link."""
    existing = {sensor.name: sensor for sensor in spec.sensors if sensor.name}
    links = [body.name for body in spec.bodies if body.name != "world"]
    for placed in sensors:
        if _is_present(placed, existing, path):
            continue
        body = spec.body(placed.link) if placed.link in links else None
        if body is None:
            raise PhysicsError(f"{path}: sensor {placed.name}: no link {placed.link!r}{nearest(placed.link, links)}")
        looks = list(_Z_TO_X) if placed.kind == RANGE else [1.0, 0.0, 0.0, 0.0]
        site = body.add_site(name=f"{_SITE}{placed.name}", quat=looks)
        for number, kind in enumerate(_PARTS[placed.kind]):
            sensor = spec.add_sensor(name=f"{placed.name} {number}", type=kind)
            sensor.objtype, sensor.objname = mujoco.mjtObj.mjOBJ_SITE, site.name
            if placed.kind == RANGE:
                sensor.cutoff = placed.reach
                sensor.intprm[0] = 1 << int(mujoco.mjtRayDataField.mjRAYDATA_DIST)


def _is_present(sensor: WorldSensor, existing: Mapping[str, Any], path: str) -> bool:
    """Whether the scene already has the sensor; raise PhysicsError if its type differs."""
    names = sensor.of_scene()
    if not names or not all(name in existing for name in names):
        return False
    for name, kind in zip(names, _PARTS[sensor.kind], strict=True):
        if existing[name].type != kind:
            type_name = kind.name.removeprefix("mjSENS_").lower()
            raise PhysicsError(f"{path}: sensor {sensor.name}: {name} of the scene is not of type {type_name}")
    return True


class SensorReader:
    """Reader of a simulation state's sensors; `prefix` selects the names of one robot.

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
        self._random = {sensor.name: random.Random(f"{seed} {sensor.seed} {sensor.name}") for sensor in sensors}
        self._places: dict[str, list[tuple[int, int]]] = {}
        existing = {model.sensor(number).name for number in range(model.nsensor)}
        for sensor in sensors:
            own = [f"{prefix}{name}" for name in sensor.own()]
            parts = [model.sensor(name) for name in (own if own[0] in existing else sensor.of_scene())]
            self._places[sensor.name] = [(int(part.adr[0]), int(part.adr[0]) + int(part.dim[0])) for part in parts]

    def read(self) -> dict[str, tuple[float, ...]]:
        """Return the values of every sensor by name."""
        readings = {}
        for sensor in self._sensors:
            numbers: list[float] = []
            for start, end in self._places[sensor.name]:
                noise = 0.0 if end - start == 4 else sensor.noise  # an orientation must keep a length of 1
                numbers += [
                    float(value) + _error(self._random[sensor.name], noise, float(value))
                    for value in self._data.sensordata[start:end]
                ]
            readings[sensor.name] = tuple(numbers)
        return readings


def _error(of: random.Random, noise: float, value: float) -> float:
    """Return random noise for a value; 0 for the value -1 of a range finder without a target."""
    return of.gauss(0.0, noise) if noise and value != -1.0 else 0.0
