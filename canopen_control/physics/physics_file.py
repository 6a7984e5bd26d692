"""Plant file of the engine `mujoco`: joint and motor of each virtual drive.

    engine: mujoco
    urdf: robby.urdf.xacro           # relative to this file; or mjcf: scene.xml
    step_ms: 1                       # of the simulation
    floor: {friction: 0.8, caster_friction: 0.02}
    world: hall.yml                  # objects on the floor and disturbances, see `scene_file`
    sensors: {imu: {kind: imu, link: base_link, noise: 0.01}}
    axes:
      "3": {joint: left_wheel_joint, scale_pos_to_dev: -254.65, rated_torque: 0.5, peak_torque: 1.0}
      "3/1": {joint: lift_joint, scale_pos_to_dev: 1000}         # axis 1 of node 3
      "arm:4": {joint: arm_joint, scale_pos_to_dev: 1000}        # node 4 on the bus `arm`
    encoders:                        # CiA 406 nodes on the shafts of joints, with or without a drive
      "5": {joint: lift_joint, gear: 2, reversed: true}

Missing values of an axis are estimated from the masses of the robot, see `motor_estimate`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from canopen_control.errors import ConfigError
from canopen_control.frame import MAX_NODE_ID
from canopen_control.yamlfile.convert import position, setting
from canopen_control.yamlfile.node import Node  # noqa: TC001 - the type of a field is looked up at run time
from canopen_control.yamlfile.reader import load

if TYPE_CHECKING:
    from pathlib import Path

    from canopen_control.yamlfile.node import Problems


SensorKind = Literal["imu", "range", "force_torque", "pose", "magnetometer"]
"""Kind of a sensor in a world, see `urdf_sensors`."""
_AXES = 8  # per node
AxisAddress = tuple[str, int, int]
"""Bus ("" for the main bus), node-ID, and axis of the node."""
DENSITY = 1000.0


class PhysicsError(ConfigError):
    """Error in a plant file of the physics engine, in its world file, or in the robot description."""


@dataclass(frozen=True)
class AxisSettings:
    """Motor of one axis, referred to the joint side of the gear, in Nm, kg m2 and rad (N, kg and m if prismatic).

    `scale_pos_to_dev` is the number of counts of the drive per rad, as in bus.yml, negative if the motor is mounted
    mirrored. `encoder` is the number of counts per motor revolution (per m for a linear motor), `rotor_inertia` the
    inertia of the motor before the `gear`. `inertia` is the inertia for which the velocity loop was tuned, with
    `bandwidth` in rad/s. A `brake` holds the joint without power. The `roller` of a mecanum wheel is the angle, in
    degrees from ahead to the left, of the axle of the roller on the ground. None stands for an estimated value, or for
    an absent part.
    """

    joint: str
    scale_pos_to_dev: float
    gear: float = setting(1.0, low=1e-3)
    encoder: int | None = setting(None, low=16)
    rated_torque: float | None = setting(None, low=1e-9)
    peak_torque: float | None = setting(None, low=1e-9)
    rotor_inertia: float | None = setting(None, low=0.0)
    friction: float | None = setting(None, low=0.0)
    damping: float | None = setting(None, low=0.0)
    inertia: float | None = setting(None, low=1e-12)
    bandwidth: float = setting(80.0, low=1.0, high=1000.0)
    position_gain: float = setting(30.0, low=0.0, high=1000.0)
    brake: bool | None = None
    roller: float | None = setting(None, low=-90.0, high=90.0)
    here: Node = position()  # noqa: RUF009 - makes a field


@dataclass(frozen=True)
class FloorContact:
    """Friction coefficients on the floor: `friction` for wheels, `caster_friction` for all other parts of the robot."""

    friction: float = setting(0.8, low=0.0, high=10.0)
    caster_friction: float = setting(0.02, low=0.0, high=10.0)


@dataclass(frozen=True)
class SensorSettings:
    """Sensor on a link in a plant file; `world_sensors` describes the kinds.

    `reach` is the range of a range finder in m, `seed` the seed of the noise. `scene` is the prefix of the names of the
    parts if a MuJoCo scene already has the sensor.
    """

    kind: SensorKind
    link: str
    noise: float = setting(0.0, low=0.0)
    reach: float = setting(10.0, low=1e-3)
    seed: int = setting(0, low=0, high=2**31 - 1)
    scene: str = ""


@dataclass(frozen=True)
class EncoderSettings:
    """Encoder behind a `gear`, which is the number of turns (or m) of the joint per turn of the encoder."""

    joint: str
    gear: float = setting(1.0, low=1e-6)
    reversed: bool = False
    here: Node = position()  # noqa: RUF009 - makes a field

    @property
    def factor(self) -> float:
        """Encoder motion per rad (or m) of the joint, negative if `reversed`."""
        return (-1.0 if self.reversed else 1.0) / self.gear


@dataclass(frozen=True)
class PhysicsFile:
    """Contents of a plant file of the engine `mujoco`.

    `arguments` are the xacro arguments, `density` in kg/m3 is used for links without a mass.
    """

    axes: dict[str, AxisSettings]
    engine: str = "mujoco"
    urdf: str = ""
    urdf_source: str = ""  # file of which `urdf` is a copy; named in messages
    mjcf: str = ""
    arguments: dict[str, str] = setting(factory=dict)
    step_ms: float = setting(1.0, low=0.1, high=4.0)
    base: Literal["free", "fixed"] | None = None
    density: float = setting(DENSITY, low=1.0, high=30_000.0)
    floor: FloorContact = FloorContact()
    world: str = ""
    encoders: dict[str, EncoderSettings] = setting(factory=dict)
    sensors: dict[str, SensorSettings] = setting(factory=dict)
    here: Node = position()  # noqa: RUF009 - makes a field


def axis_address(name: str) -> AxisAddress:
    """Return the bus, node-ID and axis in ``3``, ``3/1`` or ``BUS:3/1``; raise ValueError for any other text."""
    bus, _, place = name.rpartition(":")
    node, _, axis = place.partition("/")
    address = bus, int(node), int(axis or "0")
    if not (1 <= address[1] <= MAX_NODE_ID and 0 <= address[2] < _AXES):
        raise ValueError(name)
    return address


def read_physics_file(path: Path) -> PhysicsFile:
    """Read a plant file; raise PhysicsError with all errors and their lines."""
    return load(path, PhysicsFile, error=PhysicsError, check=_check)


def _check(file: PhysicsFile, _problems: Problems) -> None:
    if bool(file.urdf) == bool(file.mjcf):
        file.here.error("name the robot by either urdf: FILE or mjcf: FILE")
    joints: dict[str, str] = {}
    for name, axis in file.axes.items():
        try:
            axis_address(name)
        except ValueError:
            axis.here.error(
                f'{name!r} is not an axis: write "3" for node 3, "3/1" for its axis 1, "BUS:3" of several buses'
            )
        if axis.scale_pos_to_dev == 0.0:
            axis.here.error("scale_pos_to_dev is 0: write the counts of the drive per rad of the joint")
        if joints.setdefault(axis.joint, name) != name:
            axis.here.error(f"axis {joints[axis.joint]} already moves joint {axis.joint}")
    for name, encoder in file.encoders.items():
        try:
            axis_address(name)
        except ValueError:
            encoder.here.error(f'{name!r} is not a node: write "5" for node 5, "BUS:5" of several buses')
