"""Simulated robot without drives, for ros2_control's simulation plugins of Gazebo and MuJoCo.

Every joint follows a position, a velocity or an effort with its own servo, like a drive; all joints advance
together once per cycle. A position is approached at constant velocity within the cycle. Sensors of the <ros2_control>
tag (`urdf_sensors`) measure in the world. Payloads, pushes, blocked joints and friction changes are the same as in the
world of drives, and end at the next reset.
"""

from __future__ import annotations

import math
import random
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, Protocol

import mujoco
import numpy as np

from canopen_control.errors import ControlError, nearest
from canopen_control.physics.body_model import alone, build_mjcf, prepared, read_spec, settle
from canopen_control.physics.disturbances import Disturbances
from canopen_control.physics.joint_servo import ServoLoop
from canopen_control.physics.physics_file import DENSITY, AxisSettings, FloorContact, PhysicsError
from canopen_control.physics.scene_file import Start, WorldDescription
from canopen_control.physics.urdf_repair import guessed_masses, repaired
from canopen_control.physics.urdf_sensors import INTERFACES, urdf_sensors
from canopen_control.physics.world_sensors import SensorReader, WorldSensor
from canopen_control.rpc.messages.simulation import LaserScanReading

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping
    from pathlib import Path

    from numpy.typing import NDArray

    from canopen_control.physics.body_model import Body, JointPlace
    from canopen_control.rpc.messages.drive import WorldAct
    from canopen_control.urdf.description import UrdfDescription
    from canopen_control.urdf.ros2_control import ControlJoint, Ros2ControlSystem


# Lidars and cameras among the <sensor> tags, with the parameters of mujoco_ros2_control. A sensor with `min_angle`,
# `max_angle` and `angle_increment` (rad, to the left) is a lidar along the x axis of its `frame_name`, turning about z.
# Further parameters are `range_min`, `range_max` (m), `laserscan_topic`, `noise` and `seed`; `lidar_publish_rate` (Hz)
# is that of the hardware. Cameras need OpenGL, which is not available: they are reported and omitted.


_NEEDED: Final = ("min_angle", "max_angle", "angle_increment")
_CAMERA: Final = ("image_topic", "depth_topic", "info_topic")
_DEFAULTS: Final[Mapping[str, float]] = {"range_min": 0.0, "range_max": 1000.0, "noise": 0.0, "seed": 0.0}
_MAX_RAYS: Final = 10_000
_COUNTLESS: Final = 1e9
_RATE: Final = "lidar_publish_rate"
_FASTEST: Final = 1000.0


@dataclass(frozen=True)
class LidarSettings:
    """Settings of a lidar in rad, m and Hz; `place` is the file and line of its tag."""

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
        """Number of rays in a scan, limited to 1e9."""
        return int(min(_COUNTLESS, (self.max_angle - self.min_angle) / self.increment + 1e-9)) + 1


def tag_lidars(tag: Ros2ControlSystem, root: str, path: str) -> list[LidarSettings]:
    """Return the lidars of a <ros2_control> tag; raise PhysicsError with all errors, each with its file and line."""
    lidars, problems = [], list[str]()
    for part in tag.sensors:
        if not any(key in part.parameters for key in _NEEDED):
            continue
        place, wrong = f"{path}:{part.place.line}:{part.place.column}", list[str]()
        lidar = _lidar(part, tag.parameters, root, place, wrong)
        problems += [f"{place}: sensor {part.name}: {text}" for text in wrong]
        if not wrong:
            lidars.append(lidar)
    if problems:
        raise PhysicsError("\n".join(problems))
    return lidars


def _lidar(part: ControlJoint, hardware: Mapping[str, str], root: str, place: str, wrong: list[str]) -> LidarSettings:
    params = part.parameters
    wrong += [f"no {key}; a lidar has {', '.join(_NEEDED)} in rad" for key in _NEEDED if key not in params]
    number = {key: _number(params, key, 0.0, wrong) for key in _NEEDED}
    number |= {key: _number(params, key, default, wrong) for key, default in _DEFAULTS.items()}
    rate = _number(hardware, _RATE, 5.0, wrong)
    least, most, increment = (number[key] for key in _NEEDED)
    lidar = LidarSettings(
        part.name,
        params.get("frame_name", params.get("frame_id", root)).strip(),
        params.get("laserscan_topic", "/scan").strip(),
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
        (increment <= 0.0, f"angle_increment is {increment:g}; it must be above 0"),
        (most < least, f"max_angle {most:g} is below min_angle {least:g}"),
        (lidar.count > _MAX_RAYS, f"it has {lidar.count} rays; at most {_MAX_RAYS} are possible"),
        (not 0.0 <= lidar.range_min < lidar.range_max, "range_min must be 0 or more, and below range_max"),
        (lidar.noise < 0.0, f"noise is {lidar.noise:g}; it must be 0 or more"),
        (number["seed"] < 0.0 or number["seed"] != lidar.seed, "seed must be an integer of 0 or more"),
        (
            not 0.0 < rate <= _FASTEST,
            f"{_RATE} of its hardware is {rate:g}; it must be above 0 and at most {_FASTEST:g} Hz",
        ),
        (not lidar.topic, "laserscan_topic is empty"),
    ):
        wrong += [text] if bad else []
    return lidar


def _number(params: Mapping[str, str], key: str, default: float, wrong: list[str]) -> float:
    try:
        value = float(params.get(key, default))
    except ValueError:
        value = math.nan
    if math.isfinite(value):
        return value
    wrong.append(f"{key} is {params[key]!r}; it must be a finite number")
    return default


def camera_notes(parts: Iterable[ControlJoint], cameras: Iterable[str] = ()) -> list[str]:
    """Return a note for every camera of a tag or a scene, because cameras are not simulated."""
    names = [part.name for part in parts if any(key in part.parameters for key in _CAMERA)]
    names += [part.name for part in parts if part.parameters.get("mujoco_type", "").strip() == "camera"]
    return [
        f"camera {name} is not simulated: images need OpenGL, which mujoco-core does not include"
        for name in dict.fromkeys([*names, *cameras])
    ]


def frame_error(lidar: LidarSettings, frames: Iterable[str]) -> PhysicsError:
    """Return the error for a lidar with an unknown frame."""
    names = [frame for frame in frames if frame]
    return PhysicsError(
        f"{lidar.place}: sensor {lidar.name}: no link {lidar.frame!r} for its frame_name{nearest(lidar.frame, names)}"
    )


# Planar lidar: rays are cast from a link, or from a site of a scene, at each scan. They lie in the plane of the x and y
# axes of the link, from `min_angle` to `max_angle` about z, and ignore the shapes of the link itself. Distances below
# `range_min` or above `range_max` are -1, as in mujoco_ros2_control.


_NOTHING: Final = -1.0
_DIGITS: Final = 4  # decimal digits of a distance in m


class LidarScanner:
    """Lidar in a MuJoCo model; raise PhysicsError if the lidar's frame does not exist."""

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
        self._distances = np.zeros(settings.count)
        self.begin()

    def begin(self) -> None:
        """Restart the noise generator, so that a reset simulation repeats its noise."""
        self._random = random.Random(f"{self._settings.seed} {self._settings.name}")

    def scan(self, seconds: float) -> LaserScanReading:
        """Return a scan of the current state with the time stamp `seconds` (simulation time)."""
        settings = self._settings
        rays = (self._rays @ self._turn.reshape(3, 3).T).flatten()
        place, count, cutoff = self._place.copy(), settings.count, settings.range_max
        mujoco.mj_multiRay(
            self._model,
            self._data,
            place,
            rays,
            None,
            True,
            self._body,
            self._hit,
            self._distances,
            None,
            count,
            cutoff,
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
            ranges=[
                self._reading(float(distance), hit)
                for distance, hit in zip(self._distances, self._hit.tolist(), strict=True)
            ],
        )

    def _reading(self, distance: float, hit: int) -> float:
        settings = self._settings
        if hit < 0:
            return _NOTHING
        measured = distance + (self._random.gauss(0.0, settings.noise) if settings.noise else 0.0)
        return round(measured, _DIGITS) if settings.range_min <= measured <= settings.range_max else _NOTHING


_NS: Final = 1_000_000_000
_STEP_S: Final = 0.001
_SCALE: Final = 1e6  # counts per rad of an ideal encoder
_LONGEST_NS: Final = 200_000_000  # longest cycle; more time is skipped, as after a suspend
_LEAD: Final = 0.2  # maximum lead of a velocity target before a blocked joint, in rad or m
_STATE: Final = mujoco.mjtState.mjSTATE_INTEGRATION


def axes_of(tag: Ros2ControlSystem) -> dict[str, AxisSettings]:
    """Return the settings of the commanded joints of a <ros2_control> tag, without motor data."""
    return {
        part.name: AxisSettings(part.name, _SCALE, brake=False)
        for part in tag.joints
        if part.command_interfaces and part.mimic is None
    }


def sensors_of(description: UrdfDescription, tag: Ros2ControlSystem) -> list[WorldSensor]:
    """Return the sensors of a tag that a world can simulate; raise PhysicsError if one has errors."""
    model = description.model
    sensors = urdf_sensors(tag.sensors, model.links, model.root, description.path)
    return [WorldSensor(name, sensor) for name, sensor in sensors.items()]


@dataclass(slots=True)
class _Target:
    """Target of a joint at the end of a cycle, and the target before it."""

    interface: str = "velocity"
    before: float = 0.0
    value: float = 0.0


class EffortLoop(Protocol):
    """Interface of a controller that replaces a joint's servo: computes an effort from a position or velocity error."""

    def compute(self, error: float, dt: float) -> float:
        """Return the effort for an error, `dt` s after the last call."""
        ...

    def reset(self) -> None: ...


class JointMotor:
    """Motor of one simulated joint, in rad, rad/s and Nm (m, m/s and N if prismatic).

    A target takes effect with the next step. `loops`, by commanded interface, replace the servo; they are also limited
    to the motor's peak torque.
    """

    def __init__(
        self,
        robot: DriverlessRobot,
        place: JointPlace,
        settings: AxisSettings,
        period: float,
        loops: Mapping[str, EffortLoop],
    ) -> None:
        self._loops = loops
        self._robot, self._place, self._period = robot, place, period
        self._loop = ServoLoop(place.motor, settings, period)
        self._target = _Target()
        self._reference = 0.0
        self.effort = 0.0

    @property
    def position(self) -> float:
        return float(self._robot.data.qpos[self._place.qpos])

    @position.setter
    def position(self, value: float) -> None:
        """Set the position and the target of the joint before the start."""
        self._robot.data.qpos[self._place.qpos] = value
        self._reference = self._target.before = self._target.value = value

    @property
    def velocity(self) -> float:
        return float(self._robot.data.qvel[self._place.dof])

    @velocity.setter
    def velocity(self, value: float) -> None:
        self._robot.data.qvel[self._place.dof] = value

    def rest(self) -> None:
        """Reset the control loops, and make the current position the target."""
        self._target, self._reference, self.effort = _Target(), self.position, 0.0
        self._target.before = self._target.value = self._reference
        self._loop.begin()
        for loop in self._loops.values():
            loop.reset()

    def follow(self, interface: str, target: float, seconds: float) -> None:  # noqa: ARG002 # `step` has the duration
        """Set the target of a command interface (position, velocity or effort) for a cycle of `seconds`."""
        old = self._target
        if interface != old.interface:  # the previous target of another interface is not a position to start from
            self._reference = self.position
            if (loop := self._loops.get(interface)) is not None:
                loop.reset()
            old.value = target if interface == "position" else old.value
        self._target = _Target(interface, old.value, target)

    def push(self, part: float, length: float) -> None:
        """Apply the effort of one step; the target is interpolated at `part` (0 to 1) of a cycle of `length` s."""
        target, place, peak = self._target, self._place, self._place.motor.peak_torque
        angle = self.position
        if target.interface == "effort":
            self.effort = max(-peak, min(peak, target.value))
            self._loop.rest(self.effort)
        elif target.interface == "position":
            speed = (target.value - target.before) / length
            self._reference = target.before + part * (target.value - target.before)
            self.effort = self._effort(angle, self._reference, speed, self._reference - angle)
        else:
            ahead = self._reference + target.value * self._period
            self._reference = max(angle - _LEAD, min(angle + _LEAD, ahead))
            self.effort = self._effort(angle, self._reference, target.value, target.value - self.velocity)
        self._robot.data.qfrc_applied[place.dof] = self.effort

    def _effort(self, angle: float, place: float, speed: float, error: float) -> float:
        """Return the limited effort of the interface's loop in `loops`, or of the servo if it has none."""
        peak, loop = self._place.motor.peak_torque, self._loops.get(self._target.interface)
        if loop is None:
            return self._loop.torque(angle, place, speed, peak)
        return max(-peak, min(peak, loop.compute(error, self._period)))


class DriverlessRobot:
    """Robot without drives, advanced once per cycle; an `Engine` of `driverless_system`."""

    def __init__(
        self,
        body: Body,
        axes: dict[str, AxisSettings],
        sensors: Iterable[WorldSensor] = (),
        notes: tuple[str, ...] = (),
        loops: Mapping[str, Mapping[str, EffortLoop]] | None = None,
        world: WorldDescription | None = None,
    ) -> None:
        self.body, self.model, self.notes = body, body.model, notes
        self.data = mujoco.MjData(body.model)
        self._period = float(body.model.opt.timestep)
        self._period_ns = round(self._period * _NS)
        self._left_ns = 0
        loops_by_joint = loops or {}
        self._motors = {
            name: JointMotor(self, place, axes[name], self._period, loops_by_joint.get(name, {}))
            for name, place in body.joints.items()
        }
        self._sensors = list(sensors)
        self._reader = SensorReader(self.model, self.data, self._sensors)
        self._measured: dict[str, float] = {}
        self.lidars: list[LidarScanner] = []
        settle(self.model, self.data)
        self.data.qvel[:] = 0.0
        for place in body.joints.values():
            self.data.qpos[place.qpos] = self.model.qpos0[place.qpos]
        mujoco.mj_forward(self.model, self.data)
        self._start: NDArray[np.float64] | None = None  # state before the first step
        self._steps = 0  # number of steps since the start
        around = WorldDescription() if world is None else world
        self._disturbances = Disturbances({"": body}, around.floor or FloorContact(), around)
        self._disturbances.blocker = self
        self._disturbances.begin(self.data)
        self._read_states()

    def problems(self) -> Iterator[str]:
        """Yield an error with a line number for every step of the world file with an invalid disturbance."""
        return self._disturbances.problems()

    def motor(self, joint: str) -> JointMotor | None:
        return self._motors.get(joint)

    def sensed(self, interface: str) -> Callable[[], float] | None:
        """Return a reader of a sensor's state interface, such as "imu/orientation.x", or None if unknown."""
        return (lambda: self._measured[interface]) if interface in self._measured else None

    def step(self, seconds: float) -> None:
        """Advance by the whole time steps in `seconds`; the remainder is carried over to the next call."""
        self._left_ns = min(_LONGEST_NS, self._left_ns + round(seconds * _NS))
        count = self._left_ns // self._period_ns
        self._left_ns -= count * self._period_ns
        if self._start is None:
            self._start = np.zeros(mujoco.mj_stateSize(self.model, _STATE))
            mujoco.mj_getState(self.model, self.data, self._start, _STATE)
        motors = self._motors.values()
        for number in range(1, count + 1):
            for motor in motors:
                motor.push(number / count, count * self._period)
            self._disturbances.advance(self._steps * self._period_ns)
            if self._disturbances.patches:
                self._disturbances.update_friction()
            mujoco.mj_step(self.model, self.data)
            self._steps += 1
        if self._sensors:
            self._read_states()

    def scan(self, seconds: float) -> list[LaserScanReading]:
        return [lidar.scan(seconds) for lidar in self.lidars]

    def act(self, world_act: WorldAct) -> None:
        self._disturbances.act(world_act, self._steps * self._period_ns)

    def block(self, robot: str, joint: str, on: bool) -> None:
        del robot
        self.body.joints[joint].hold(self.model, self.data, on)

    def reset(self, keyframe: str) -> None:
        """Reset to the initial state or to a MuJoCo key frame; raise ControlError for an unknown key frame."""
        names = [self.model.key(number).name for number in range(self.model.nkey)]
        if keyframe:
            if keyframe not in names:
                hint = nearest(keyframe, names) if names else ", since its model has none"
                raise ControlError(f"no key frame {keyframe!r}{hint}")
            mujoco.mj_resetDataKeyframe(self.model, self.data, names.index(keyframe))
        elif self._start is not None:
            mujoco.mj_setState(self.model, self.data, self._start, _STATE)
        for motor in self._motors.values():
            motor.rest()
        self._left_ns = self._steps = 0
        self._disturbances.reset()
        for lidar in self.lidars:
            lidar.begin()
        self._reader = SensorReader(self.model, self.data, self._sensors)  # resets its noise
        mujoco.mj_forward(self.model, self.data)
        self._read_states()

    def _read_states(self) -> None:
        for name, numbers in self._reader.read().items():
            kind = next(sensor.settings.kind for sensor in self._sensors if sensor.name == name)
            self._measured.update(
                {f"{name}/{part}": value for part, value in zip(INTERFACES[kind], numbers, strict=True)}
            )


def make_simulated(
    description: UrdfDescription,
    tag: Ros2ControlSystem,
    scene: Path | None = None,
    loops: Mapping[str, Mapping[str, EffortLoop]] | None = None,
    world: WorldDescription | None = None,
) -> DriverlessRobot:
    """Build the robot of a <ros2_control> tag on a floor, or in an MJCF `scene`; raise PhysicsError on failure.

    `loops` replace the servos, by joint and commanded interface; the objects of `world` are added.
    """
    lidars = tag_lidars(tag, description.model.root, description.path)
    robot = _build(description, tag, scene, loops or {}, WorldDescription() if world is None else world)
    model = robot.model
    robot.notes += tuple(camera_notes(tag.sensors, [model.cam(number).name for number in range(model.ncam)]))
    robot.lidars = [LidarScanner(model, robot.data, lidar) for lidar in lidars]
    return robot


def _build(
    description: UrdfDescription,
    tag: Ros2ControlSystem,
    scene: Path | None,
    loops: Mapping[str, Mapping[str, EffortLoop]],
    world: WorldDescription,
) -> DriverlessRobot:
    axes, sensors = axes_of(tag), sensors_of(description, tag)
    if scene is not None:
        body = build_mjcf(scene, axes, step=_STEP_S, path=description.path, world=world, sensors=sensors)
        return DriverlessRobot(body, axes, sensors, (*body.notes, *world.notes), loops, world)
    urdf = repaired(description)
    robot = prepared(
        read_spec(urdf, description.path),
        description,
        axes,
        world.floor or FloorContact(),
        step=_STEP_S,
        density=DENSITY,
        free=None,
        path=description.path,
        start=world.start or Start(),
        sensors=sensors,
    )
    body = alone(robot, world, _STEP_S, description.path)
    notes = (*urdf.notes, *guessed_masses(urdf, DENSITY), *body.notes, *world.notes)
    return DriverlessRobot(body, axes, sensors, notes, loops, world)
