"""Hardware plugins of <ros2_control> tags: CANopen drives, simulation, mock hardware, transmissions.

The plugin names of other stacks are accepted, so that their descriptions run unchanged, and so that users switch from
simulation to hardware by changing the same line as there. `--mock` and `--real` do the same without changing a file.
"""

from __future__ import annotations

import enum
import math
from dataclasses import replace
from typing import TYPE_CHECKING, Final

from canopen_control.errors import ControlError, RobotConfigError, UnknownInterface, nearest
from canopen_control.hardware import driverless_system, system
from canopen_control.hardware.interfaces import (
    ERROR,
    OK,
    CommandInterface,
    ComponentLifecycle,
    LifecycleState,
    ReturnType,
    StateInterface,
    refuse_two_interfaces,
)
from canopen_control.urdf.joint_element import ACCELERATION, EFFORT, POSITION, VELOCITY

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from canopen_control.hardware.driverless_system import Engine
    from canopen_control.hardware.interfaces import HardwareComponent
    from canopen_control.rpc.messages.drive import WorldAct
    from canopen_control.rpc.messages.simulation import LaserScanReading
    from canopen_control.urdf.description import UrdfDescription
    from canopen_control.urdf.joint_element import Mimic
    from canopen_control.urdf.ros2_control import ControlJoint, Ros2ControlSystem, Transmission


# GenericSystem: a hardware component without hardware, as ros2_control's mock_components/GenericSystem.
#
# `read` copies every command to the state of the same name; a nan command changes nothing, an infinite command is an
# ERROR. With `calculate_dynamics` the claimed interface of a joint is integrated instead (velocity to position,
# acceleration to velocity and position; a position is differentiated). States start at their initial_value, else 0.0;
# `position_state_following_offset` is added to positions. Difference from upstream, and safer: a joint whose velocity
# or acceleration interface is released stops.


PLUGINS: Final[tuple[str, ...]] = ("mock_components/GenericSystem", "fake_components/GenericSystem")
"""Plugin names that select GenericSystem; the second one is the old name."""

_MODES: Final = frozenset({POSITION, VELOCITY, ACCELERATION})


class _Joint:
    """Joint, sensor or GPIO of a mock component; `mode` is the integrated quantity."""

    __slots__ = ("commands", "follows", "initial", "mimic", "mirrored", "mode", "name", "states")

    def __init__(self, part: ControlJoint, *, commanded_states: bool = False) -> None:
        names = dict(part.command_interfaces)
        if commanded_states:
            names.update(part.state_interfaces)
        self.name, self.mimic, self.mode = part.name, part.mimic, POSITION
        self.commands = {
            name: CommandInterface(part.name, name, minimum=joint_name.minimum, maximum=joint_name.maximum)
            for name, joint_name in names.items()
        }
        self.states = {name: StateInterface(part.name, name) for name in part.state_interfaces}
        self.initial = {name: state_interface.initial_value for name, state_interface in part.state_interfaces.items()}
        for name, interface in part.command_interfaces.items():
            if name in self.initial and math.isnan(self.initial[name]):
                self.initial[name] = interface.initial_value
        self.mirrored = [
            (command, self.states[name], 0.0) for name, command in self.commands.items() if name in self.states
        ]
        self.follows: tuple[_Joint, Mimic] | None = None

    def reset(self, offset: float) -> None:
        """Set the states to their initial values or 0, with `offset` added to the position."""
        for name, state in self.states.items():
            initial = self.initial[name]
            state.value = (0.0 if math.isnan(initial) else initial) + (offset if name == POSITION else 0.0)

    def stop(self, interface: str) -> None:
        """Set the velocity and acceleration states to 0 when a velocity or acceleration interface is released."""
        if interface in (VELOCITY, ACCELERATION):
            self.set(VELOCITY, 0.0)
            self.set(ACCELERATION, 0.0)

    def get(self, name: str) -> float:
        """Return the value of a state; 0.0 if missing or unknown."""
        state = self.states.get(name)
        return 0.0 if state is None or math.isnan(state.value) else state.value

    def set(self, name: str, value: float) -> None:
        state = self.states.get(name)
        if state is not None:
            state.value = value


class GenericSystem(ComponentLifecycle):
    """Mock component without hardware, like ros2_control's mock_components/GenericSystem."""

    def __init__(self, description: Ros2ControlSystem) -> None:
        super().__init__()
        self.name = description.name
        parameters = description.parameters
        self._dynamics = _true(parameters, "calculate_dynamics")
        self._disabled = _true(parameters, "disable_commands")
        self._offset = _offset(parameters)
        sensors = _true(parameters, "mock_sensor_commands") or _true(parameters, "fake_sensor_commands")
        gpios = _true(parameters, "mock_gpio_commands") or _true(parameters, "fake_gpio_commands")
        self._joints = {joint.name: _Joint(joint) for joint in description.joints}
        extras = [_Joint(sensor, commanded_states=sensors) for sensor in description.sensors]
        extras += [_Joint(gpio, commanded_states=gpios) for gpio in description.gpios]
        self._parts: list[_Joint] = [*self._joints.values(), *extras]
        self._moving: list[_Joint] = [joint for joint in self._joints.values() if joint.commands]
        for joint in self._joints.values():
            if joint.mimic is not None and joint.mimic.joint in self._joints:
                joint.follows = (self._joints[joint.mimic.joint], joint.mimic)
        self._following = [(joint, *joint.follows) for joint in self._joints.values() if joint.follows is not None]
        self._plain = self._mirrors()
        self.state_interfaces: Sequence[StateInterface] = [
            state for part in self._parts for state in part.states.values()
        ]
        self.command_interfaces: Sequence[CommandInterface] = [
            command for part in self._parts for command in part.commands.values()
        ]
        self._owners = {command.name: part for part in self._parts for command in part.commands.values()}

    def _begin(self) -> None:
        for part in self._parts:
            part.reset(self._offset if part.name in self._joints else 0.0)

    def _rest(self) -> None:
        for joint in self._moving:
            joint.stop(joint.mode)

    def prepare_command_mode_switch(self, start: Sequence[str], stop: Sequence[str]) -> None:
        """Raise UnknownInterface for an unknown name; with dynamics, ControlError for two modes of a joint."""
        for name in (*start, *stop):
            self._owner(name)
        if self._dynamics:
            refuse_two_interfaces(name for name in start if name.rpartition("/")[2] in _MODES)

    def perform_command_mode_switch(self, start: Sequence[str], stop: Sequence[str]) -> None:
        for name in stop:
            self._owner(name).stop(name.rpartition("/")[2])
        for name in start:
            interface = name.rpartition("/")[2]
            if interface in _MODES:
                self._owner(name).mode = interface

    def read(self, now: int, period: float) -> ReturnType:
        """Copy commands to states, or integrate them; return ERROR for an infinite command."""
        del now
        if self.state not in (LifecycleState.INACTIVE, LifecycleState.ACTIVE) or self._disabled:
            return OK
        for interface in self.command_interfaces:
            if math.isinf(interface.value):
                return ERROR
        if self.state is LifecycleState.ACTIVE and self._dynamics:
            for joint in self._moving:
                _STEPS[joint.mode](joint, period, self._offset)
        for command, state, offset in self._plain:
            if not math.isnan(command.value):
                state.value = command.value + offset
        for joint, leader, mimic in self._following:
            joint.set(POSITION, mimic.multiplier * leader.get(POSITION) + mimic.offset)
            joint.set(VELOCITY, mimic.multiplier * leader.get(VELOCITY))
            joint.set(ACCELERATION, mimic.multiplier * leader.get(ACCELERATION))
        return OK

    def write(self, now: int, period: float) -> ReturnType:
        del now, period
        return OK

    def _mirrors(self) -> list[tuple[CommandInterface, StateInterface, float]]:
        """Return the pairs of command and state that are copied, not integrated."""
        pairs: list[tuple[CommandInterface, StateInterface, float]] = []
        for part in self._parts:
            integrated = _MODES if self._dynamics and part.name in self._joints else frozenset[str]()
            offset = self._offset if part.name in self._joints else 0.0
            pairs += [
                (command, state, offset if state.interface == POSITION else 0.0)
                for command, state, _ in part.mirrored
                if state.interface not in integrated
            ]
        return pairs

    def _owner(self, name: str) -> _Joint:
        joint = self._owners.get(name)
        if joint is None:
            raise UnknownInterface(name, tuple(self._owners))
        return joint


def _by_position(joint: _Joint, period: float, offset: float) -> None:
    target = joint.commands.get(POSITION)
    if target is None or math.isnan(target.value) or period <= 0.0:
        return
    position = target.value + offset
    velocity = (position - joint.get(POSITION)) / period
    joint.set(ACCELERATION, (velocity - joint.get(VELOCITY)) / period)
    joint.set(VELOCITY, velocity)
    joint.set(POSITION, position)


def _by_velocity(joint: _Joint, period: float, _offset: float) -> None:
    target = joint.commands.get(VELOCITY)
    if target is None or math.isnan(target.value) or period <= 0.0:
        return
    joint.set(ACCELERATION, (target.value - joint.get(VELOCITY)) / period)
    joint.set(VELOCITY, target.value)
    joint.set(POSITION, joint.get(POSITION) + target.value * period)


def _by_acceleration(joint: _Joint, period: float, _offset: float) -> None:
    target = joint.commands.get(ACCELERATION)
    if target is None or math.isnan(target.value):
        return
    velocity = joint.get(VELOCITY) + target.value * period
    joint.set(ACCELERATION, target.value)
    joint.set(VELOCITY, velocity)
    joint.set(POSITION, joint.get(POSITION) + velocity * period)


_STEPS: Final = {POSITION: _by_position, VELOCITY: _by_velocity, ACCELERATION: _by_acceleration}


def _true(parameters: Mapping[str, str], name: str) -> bool:
    return parameters.get(name, "").strip().lower() in ("true", "1")


def _offset(parameters: Mapping[str, str]) -> float:
    text = parameters.get("position_state_following_offset", parameters.get("state_following_offset", "")).strip()
    try:
        return float(text or 0.0)
    except ValueError as error:
        raise ControlError(f"position_state_following_offset is {text!r}; it must be a number in rad or m") from error


# Hardware component behind transmissions: values of joints instead of those of actuators (motor shafts).
#
# Rules (ROS 1 transmission_interface, ros2_control SimpleTransmission): joint position = actuator position / reduction
# + offset, joint velocity = actuator velocity / reduction, joint effort = actuator effort * reduction, and the inverse
# for commands. A negative reduction reverses the direction. Transmissions apply to real and virtual drives; mock
# hardware and the simulation have joint values already.


class _State:
    """State interface on both sides of a transmission: joint value = actuator value * factor + offset."""

    __slots__ = ("factor", "inner", "offset", "outer")

    def __init__(self, inner: StateInterface, transmission: Transmission) -> None:
        self.outer, self.inner = StateInterface(inner.joint, inner.interface), inner
        self.factor, self.offset = _ratio(inner.interface, transmission)


class _Command:
    """Command interface on both sides of a transmission; the joint's limits become limits of the actuator."""

    __slots__ = ("factor", "inner", "offset", "outer")

    def __init__(self, inner: CommandInterface, transmission: Transmission) -> None:
        self.outer, self.inner = _joint_side(inner), inner
        self.factor, self.offset = _ratio(inner.interface, transmission)
        self.outer.enabled = inner.enabled
        ends = [(limit - self.offset) / self.factor for limit in (inner.minimum, inner.maximum)]
        inner.minimum, inner.maximum = min(ends), max(ends)

    def follow(self) -> None:
        """Copy `enabled` from the actuator's side; clear `excluded` when the hardware follows commands again."""
        outer, enabled = self.outer, self.inner.enabled
        if outer.enabled is not enabled:
            outer.enabled = enabled
            if enabled:
                outer.excluded = False


def _ratio(interface: str, transmission: Transmission) -> tuple[float, float]:
    factor = float(transmission.reduction ** _POWERS.get(interface, 0))
    return factor, transmission.offset if interface == POSITION else 0.0


_POWERS: Final = {POSITION: -1, VELOCITY: -1, ACCELERATION: -1, EFFORT: 1}
"""Exponents of the reduction in the factors from actuator values to joint values."""


class TransmittedSystem:
    """Component behind its transmissions: same interface names, but joint values.

    Interfaces of joints without an effective transmission are those of the component.
    """

    def __init__(self, component: HardwareComponent, transmissions: Sequence[Transmission]) -> None:
        self.component = component
        self.name = component.name
        by_joint = {transmission.joint: transmission for transmission in transmissions if not transmission.trivial}
        self._states = [
            _State(state_interface, by_joint[state_interface.joint])
            for state_interface in component.state_interfaces
            if state_interface.joint in by_joint
        ]
        self._commands = [
            _Command(interface, by_joint[interface.joint])
            for interface in component.command_interfaces
            if interface.joint in by_joint
        ]
        states = {state.inner.name: state.outer for state in self._states}
        commands = {command.inner.name: command.outer for command in self._commands}
        self.state_interfaces: Sequence[StateInterface] = [
            states.get(state_interface.name, state_interface) for state_interface in component.state_interfaces
        ]
        self.command_interfaces: Sequence[CommandInterface] = [
            commands.get(interface.name, interface) for interface in component.command_interfaces
        ]

    @property
    def state(self) -> LifecycleState:
        return self.component.state

    @property
    def simulated_ns(self) -> int | None:
        return self.component.simulated_ns

    def configure(self) -> None:
        self.component.configure()

    def activate(self) -> None:
        self.component.activate()

    def deactivate(self) -> None:
        self.component.deactivate()

    def cleanup(self) -> None:
        self.component.cleanup()

    def shutdown(self) -> None:
        self.component.shutdown()

    def reset(self, keyframe: str) -> None:
        self.component.reset(keyframe)

    @property
    def changeable(self) -> bool:
        return self.component.changeable

    def act(self, world_act: WorldAct) -> None:
        self.component.act(world_act)

    def scan(self) -> Sequence[LaserScanReading]:
        return self.component.scan()

    def prepare_command_mode_switch(self, start: Sequence[str], stop: Sequence[str]) -> None:
        self.component.prepare_command_mode_switch(start, stop)

    def perform_command_mode_switch(self, start: Sequence[str], stop: Sequence[str]) -> None:
        self.component.perform_command_mode_switch(start, stop)

    def read(self, now: int, period: float) -> ReturnType:
        result = self.component.read(now, period)
        for state in self._states:
            state.outer.value = state.inner.value * state.factor + state.offset
        self._follow()
        return result

    def write(self, now: int, period: float) -> ReturnType:
        for command in self._commands:
            command.inner.value = (command.outer.value - command.offset) / command.factor
        result = self.component.write(now, period)
        self._follow()
        return result

    def _follow(self) -> None:
        for command in self._commands:
            command.follow()


def _joint_side(inner: CommandInterface) -> CommandInterface:
    """Return a command interface for joint values with the limits of the joint."""
    return CommandInterface(inner.joint, inner.interface, inner.value, minimum=inner.minimum, maximum=inner.maximum)


class PluginKind(enum.Enum):
    """Kind of the hardware component of a <ros2_control> tag."""

    CANOPEN = "canopen"
    MOCK = "mock"
    SIMULATION = "simulation"


KNOWN: Final = {
    **dict.fromkeys(system.PLUGINS, PluginKind.CANOPEN),
    **dict.fromkeys(PLUGINS, PluginKind.MOCK),
    **dict.fromkeys(driverless_system.PLUGINS, PluginKind.SIMULATION),
}
"""Known plugin names and their kinds."""


def kind_of(
    description: UrdfDescription, tag: Ros2ControlSystem, *, mock: bool = False, real: bool = False
) -> PluginKind:
    """Return the kind of a tag's component; raise RobotConfigError with the closest name for an unknown plugin."""
    if mock or real:
        return PluginKind.MOCK if mock else PluginKind.CANOPEN
    kind = KNOWN.get(tag.plugin)
    if kind is None:
        raise RobotConfigError(
            f"{description.path}:{tag.place.line}: no hardware plugin {tag.plugin!r}{nearest(tag.plugin, KNOWN)}"
        )
    return kind


def busless_component(
    description: UrdfDescription, tag: Ros2ControlSystem, kind: PluginKind, engine: Engine | None = None
) -> HardwareComponent:
    """Return the component of a tag without a bus: a simulation or mock hardware.

    Mock hardware that replaces another plugin calculates dynamics, unless the tag says otherwise.
    """
    if kind is PluginKind.SIMULATION:
        return driverless_system.SimulatedSystem(tag, description.joints, engine=engine)
    if tag.plugin not in PLUGINS:
        tag = replace(tag, parameters={"calculate_dynamics": "true", **tag.parameters})
    return GenericSystem(tag)


def transmitted(component: HardwareComponent, tag: Ros2ControlSystem) -> HardwareComponent:
    """Wrap a component in the transmissions of its tag; unchanged if no transmission has an effect."""
    if all(transmission.trivial for transmission in tag.transmissions):
        return component
    return TransmittedSystem(component, tag.transmissions)
