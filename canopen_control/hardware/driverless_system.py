"""Hardware components of simulated joints without drives, as in Gazebo, and of simulated sensors.

A joint has no drive and no bus here, only a motor that implements the `SimulatedMotor` protocol, so that another engine
can replace it; the built-in motor is a first-order lag in closed form, exact for any time step. (The plants of the
virtual drives are not used, because they follow the ramps of a drive in counts and per mille; joints with drives use
`CanopenSystem` and virtual drives.) A velocity is approached with `time_constant`, a position by a velocity that is
proportional to the remaining distance; an effort moves inertia against damping. The limits of the description apply.
After the release of a command interface a velocity or effort becomes zero, and a position is held.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, Protocol

from canopen_control.errors import ControlError, RobotConfigError, UnknownInterface
from canopen_control.hardware.interfaces import (
    ERROR,
    MOTION_INTERFACES,
    OK,
    CommandInterface,
    ComponentLifecycle,
    LifecycleState,
    ReturnType,
    StateInterface,
    refuse_two_interfaces,
)
from canopen_control.urdf.joint_element import EFFORT, POSITION, VELOCITY

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from canopen_control.rpc.messages.drive import WorldAct
    from canopen_control.rpc.messages.simulation import LaserScanReading
    from canopen_control.urdf.joint_element import Joint, UrdfLimits
    from canopen_control.urdf.ros2_control import ControlJoint, Ros2ControlSystem


# State interfaces of <sensor> tags that the physics simulation of the virtual drives measures, not a device.
#
# The process of the virtual drives simulates the robot's physics, and returns the measured values of the sensors on
# request. A value older than half a second, for example after the end of that process, is nan, like every unknown
# state.


_AGE_NS: Final = 500_000_000


class WorldSensors(ComponentLifecycle):
    """Sensors of one tag, with values from the physics simulation; they have no commands."""

    def __init__(self, name: str, parts: Iterable[ControlJoint]) -> None:
        super().__init__()
        self.name = name
        self._states = [
            StateInterface(part.name, state_interface) for part in parts for state_interface in part.state_interfaces
        ]
        self.state_interfaces: Sequence[StateInterface] = self._states
        self.command_interfaces: Sequence[CommandInterface] = []
        self._updated = False  # True if updated since the last cycle
        self._last = 0
        self._known = False

    def take(self, values: Mapping[str, float]) -> None:
        """Set the measured values by interface name, such as "imu/orientation.x"; missing values become nan."""
        for state in self._states:
            state.value = values.get(state.name, math.nan)
        self._updated = self._known = True

    def _begin(self) -> None:
        pass  # the simulation sends values without a request

    def _rest(self) -> None:
        pass  # there is nothing to stop

    def prepare_command_mode_switch(self, start: Sequence[str], stop: Sequence[str]) -> None:
        pass  # there are no command interfaces

    def perform_command_mode_switch(self, start: Sequence[str], stop: Sequence[str]) -> None:
        pass  # as above

    def read(self, now: int, period: float) -> ReturnType:  # noqa: ARG002 - the signature of every component
        """Set the states to nan if the latest values are older than half a second."""
        if self._updated:
            self._last, self._updated = now, False
        elif self._known and now - self._last > _AGE_NS:
            self._known = False
            for state in self._states:
                state.value = math.nan
        return OK

    def write(self, now: int, period: float) -> ReturnType:  # noqa: ARG002 - as above
        return OK


PHYSICS_PLUGIN: Final = "mujoco_ros2_control/MujocoSystemInterface"
"""Plugin that requires a physics engine."""

PLUGINS: Final[tuple[str, ...]] = (
    "canopen_control/SimulatedSystem",
    "gazebo_ros2_control/GazeboSystem",
    "gz_ros2_control/GazeboSimSystem",
    PHYSICS_PLUGIN,
    "ign_ros2_control/IgnitionSystem",
    "gazebo_ros_control/DefaultRobotHWSim",
)
"""Plugin names that select this component; the last one is for ROS 1 descriptions with the Gazebo plugin."""


class SimulatedMotor(Protocol):
    """Interface of the motor of one joint; units are rad, rad/s and Nm, or m, m/s and N."""

    position: float
    velocity: float
    effort: float

    def follow(self, interface: str, target: float, seconds: float) -> None:
        """Move for `seconds` towards the position, velocity or effort that `interface` names."""


class Engine(Protocol):
    """Interface of a simulation of coupled motors and sensors."""

    def motor(self, joint: str) -> SimulatedMotor | None:
        """Return the motor of a joint, or None; new targets apply from the next `step` on."""

    def sensed(self, interface: str) -> Callable[[], float] | None:
        """Return a function that reads a sensor interface, such as "imu/orientation.x", or None if it is unknown."""

    def step(self, seconds: float) -> None:
        """Advance all motors and sensors by `seconds`."""

    def scan(self, seconds: float) -> Sequence[LaserScanReading]:
        """Return a scan of each lidar; `seconds` is the simulated time."""

    def reset(self, keyframe: str) -> None:
        """Reset the simulation to its start or to a key frame; raise ControlError for an unknown key frame."""

    def act(self, world_act: WorldAct) -> None:
        """Apply a disturbance; raise ConfigError for a missing link or joint."""


class FirstOrderMotor:
    """Motor with a first-order position or velocity loop, or with effort on inertia and damping.

    The inertia is in kg m^2, the damping in Nm s. Position, velocity and effort stay within the limits.
    """

    def __init__(
        self, limits: UrdfLimits, time_constant: float = 0.02, inertia: float = 0.01, damping: float = 0.1
    ) -> None:
        self.position = self.velocity = self.effort = 0.0
        self._limits, self._time_constant = limits, time_constant
        self._inertia, self._damping = inertia, damping

    def follow(self, interface: str, target: float, seconds: float) -> None:
        if seconds <= 0.0:
            return
        before = self.velocity
        if interface == EFFORT:
            effort = _within(target, self._limits.max_effort)
            self._approach(effort / self._damping, self._inertia / self._damping, seconds)
        elif interface == POSITION:
            # a quarter of the velocity loop's bandwidth, so that there is no overshoot
            velocity = (target - self.position) / max(4.0 * self._time_constant, seconds)
            self._approach(_within(velocity, self._limits.speed), self._time_constant, seconds)
        else:
            self._approach(_within(target, self._limits.speed), self._time_constant, seconds)
        self._stop_at_the_ends()
        self.effort = self._inertia * (self.velocity - before) / seconds + self._damping * self.velocity

    def _approach(self, target: float, time_constant: float, seconds: float) -> None:
        decay = math.exp(-seconds / time_constant)
        self.position += target * seconds + time_constant * (self.velocity - target) * (1.0 - decay)
        self.velocity = target + (self.velocity - target) * decay

    def _stop_at_the_ends(self) -> None:
        bounded = min(max(self.position, self._limits.lower), self._limits.upper)
        if bounded != self.position:
            self.position, self.velocity = bounded, 0.0


def _within(value: float, limit: float) -> float:
    return min(max(value, -limit), limit)


class _Joint:
    """Joint with motor and interfaces; `mode` is the claimed command interface, or ""."""

    __slots__ = ("commands", "held", "mode", "motor", "name", "start", "states")

    def __init__(self, part: ControlJoint, motor: SimulatedMotor) -> None:
        self.name, self.motor, self.mode = part.name, motor, ""
        self.commands = {
            name: CommandInterface(part.name, name, minimum=interface.minimum, maximum=interface.maximum)
            for name, interface in part.command_interfaces.items()
        }
        self.states = {name: StateInterface(part.name, name) for name in part.state_interfaces}
        start = part.state_interfaces.get(POSITION)
        self.start = 0.0 if start is None or math.isnan(start.initial_value) else start.initial_value
        self.motor.position = self.held = self.start

    def step(self, seconds: float) -> None:
        """Follow the command; without a command, hold the position, or command zero velocity or effort."""
        target = self.commands[self.mode].value if self.mode else math.nan
        mode = self.mode or VELOCITY
        if math.isnan(target):
            target = self.held if mode == POSITION else 0.0
        self.motor.follow(mode, target, seconds)
        self.held = target if mode == POSITION else self.motor.position

    def show(self) -> None:
        for name, value in ((POSITION, self.motor.position), (VELOCITY, self.motor.velocity)):
            if name in self.states:
                self.states[name].value = value
        if EFFORT in self.states:
            self.states[EFFORT].value = self.motor.effort


class SimulatedSystem(ComponentLifecycle):
    """Simulated joints of one <ros2_control> tag; `joints` maps their names to the URDF joints with the limits.

    Parameters of the tag or of a joint are time_constant (s), inertia and damping. `make_motor` replaces the built-in
    motors. The motors of an `engine` are coupled, and its sensors are used.
    """

    def __init__(
        self,
        description: Ros2ControlSystem,
        joints: Mapping[str, Joint],
        make_motor: Callable[[UrdfLimits], SimulatedMotor] | None = None,
        engine: Engine | None = None,
    ) -> None:
        super().__init__()
        self.name = description.name
        self._elapsed_ns = 0
        self._last: int | None = None
        self._joints: list[_Joint] = []
        for part in description.joints:
            limits = joints[part.name].limits
            motor = None if engine is None else engine.motor(part.name)
            if motor is None:
                parameters = {**description.parameters, **part.parameters}
                motor = make_motor(limits) if make_motor else _motor(limits, parameters)
            self._joints.append(_Joint(part, motor))
        self._engine = engine
        by_name = {joint.name: joint for joint in self._joints}
        self._mimics = [
            (by_name[part.name], by_name[part.mimic.joint], part.mimic)
            for part in description.joints
            if part.mimic is not None and part.mimic.joint in by_name
        ]
        following = [follower for follower, _, _ in self._mimics]
        self._driven = [joint for joint in self._joints if joint not in following]
        fixed = [*description.sensors, *description.gpios]
        extra_states, extra_commands, self._mirrored = _extras(fixed)
        self.state_interfaces: Sequence[StateInterface] = [
            *(state for joint in self._joints for state in joint.states.values()),
            *extra_states,
        ]
        self.command_interfaces: Sequence[CommandInterface] = [
            *(command for joint in self._joints for command in joint.commands.values()),
            *extra_commands,
        ]
        self._sensed = [
            (state, source)
            for state in extra_states
            if engine is not None and (source := engine.sensed(state.name)) is not None
        ]
        self._owners: dict[str, _Joint | None] = {extra_command.name: None for extra_command in extra_commands}
        self._owners.update({command.name: joint for joint in self._joints for command in joint.commands.values()})

    @property
    def simulated_ns(self) -> int:
        return self._elapsed_ns

    def _begin(self) -> None:
        self._show()

    def scan(self) -> Sequence[LaserScanReading]:
        return () if self._engine is None else self._engine.scan(self._elapsed_ns / 1e9)

    @property
    def changeable(self) -> bool:
        return self._engine is not None

    def act(self, world_act: WorldAct) -> None:
        if self._engine is not None:
            self._engine.act(world_act)

    def reset(self, keyframe: str) -> None:
        if self._engine is not None:
            self._engine.reset(keyframe)
        elif keyframe:
            raise ControlError(f"no key frame {keyframe!r}: {self.name} has no MJCF model")
        for joint in self._joints:
            if self._engine is None or self._engine.motor(joint.name) is None:
                joint.motor.position, joint.motor.velocity, joint.motor.effort = joint.start, 0.0, 0.0
            joint.held = joint.motor.position
        self._show()

    def _rest(self) -> None:
        for joint in self._joints:
            joint.mode = ""

    def prepare_command_mode_switch(self, start: Sequence[str], stop: Sequence[str]) -> None:
        """Raise ControlError for two interfaces of one joint, or an unsupported interface."""
        for name in (*start, *stop):
            if name not in self._owners:
                raise UnknownInterface(name, tuple(self._owners))
        motors = [name for name in start if self._owners[name] is not None]
        for name in motors:
            if name.rpartition("/")[2] not in MOTION_INTERFACES:
                raise ControlError(f"{name}: a simulated motor supports only position, velocity and effort")
        refuse_two_interfaces(motors)

    def perform_command_mode_switch(self, start: Sequence[str], stop: Sequence[str]) -> None:
        for name in stop:
            joint = self._owners[name]
            if joint is not None and joint.mode == name.rpartition("/")[2]:
                joint.mode = ""
        for name in start:
            joint = self._owners[name]
            if joint is not None:
                joint.mode = name.rpartition("/")[2]

    def read(self, now: int, period: float) -> ReturnType:
        """Advance the simulation to `now` in ns, including missed cycles; return ERROR for an infinite command."""
        if self.state not in (LifecycleState.INACTIVE, LifecycleState.ACTIVE):
            return OK
        step = round(period * 1e9) if self._last is None else now - self._last
        self._last = now
        self._elapsed_ns += step
        for command in self.command_interfaces:
            if math.isinf(command.value):
                return ERROR
        for joint in self._driven:
            joint.step(step / 1e9)
        if self._engine is not None:
            self._engine.step(step / 1e9)
        self._show()
        return OK

    def write(self, now: int, period: float) -> ReturnType:
        del now, period
        return OK

    def _show(self) -> None:
        for follower, leader, mimic in self._mimics:
            follower.motor.position = mimic.multiplier * leader.motor.position + mimic.offset
            follower.motor.velocity = mimic.multiplier * leader.motor.velocity
        for joint in self._joints:
            joint.show()
        for state, source in self._sensed:
            state.value = source()
        for command, state in self._mirrored:
            if not math.isnan(command.value):
                state.value = command.value


_Extras = tuple[list[StateInterface], list[CommandInterface], list[tuple[CommandInterface, StateInterface]]]


def _extras(parts: Sequence[ControlJoint]) -> _Extras:
    """Return the states and commands of sensors and GPIOs, and the pairs in which a command sets a state."""
    states: list[StateInterface] = []
    commands: list[CommandInterface] = []
    mirrored: list[tuple[CommandInterface, StateInterface]] = []
    for part in parts:
        interfaces = {
            name: StateInterface(
                part.name, name, 0.0 if math.isnan(state_interface.initial_value) else state_interface.initial_value
            )
            for name, state_interface in part.state_interfaces.items()
        }
        states += interfaces.values()
        for name in part.command_interfaces:
            commands.append(CommandInterface(part.name, name))
            if name in interfaces:
                mirrored.append((commands[-1], interfaces[name]))
    return states, commands, mirrored


def _motor(limits: UrdfLimits, parameters: Mapping[str, str]) -> FirstOrderMotor:
    numbers: dict[str, float] = {}
    for name in ("time_constant", "inertia", "damping"):
        if name not in parameters:
            continue
        try:
            numbers[name] = float(parameters[name])
        except ValueError:
            numbers[name] = math.nan
        if not (math.isfinite(numbers[name]) and numbers[name] > 0.0):
            raise RobotConfigError(f"{name} is {parameters[name]!r}; it must be a number above 0")
    return FirstOrderMotor(limits, **numbers)
