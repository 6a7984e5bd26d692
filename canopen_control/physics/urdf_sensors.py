"""Reader of the <sensor> tags that a physics world can simulate.

The kind follows from the state interfaces, or from the parameter `mujoco_type`, as in mujoco_ros2_control. Other
parameters are `frame_id` (the link, default the root), `noise` (standard deviation), `seed` (of the noise) and
`range_max` in m. A sensor of another kind is ignored. MuJoCo is not needed here.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from canopen_control.errors import nearest
from canopen_control.physics.physics_file import PhysicsError, SensorKind, SensorSettings

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping

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
    """Return the sensors of a <ros2_control> tag by name; raise PhysicsError with all errors and their lines."""
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
