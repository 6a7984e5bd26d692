"""GenericSystem: a hardware component without hardware, as ros2_control's mock_components/GenericSystem.

The law of the file: `read` mirrors every command into the state of the same name; a nan command changes nothing, an
infinite one is an ERROR. With `calculate_dynamics` the claimed interface of a joint is integrated instead (velocity
into position, acceleration into velocity and position, a position differentiated). States start at their initial_value,
else 0.0, positions plus `position_state_following_offset`. Ours, and safer: a released velocity or acceleration stands
still.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from canopen_control.errors import ControlError, UnknownInterface
from canopen_control.hardware.interfaces import (
    ACCELERATION,
    ERROR,
    OK,
    POSITION,
    VELOCITY,
    CommandInterface,
    LifecycleState,
    ReturnType,
    StateInterface,
)
from canopen_control.hardware.lifecycle import Lifecycle

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from canopen_control.urdf.joint_element import Mimic
    from canopen_control.urdf.ros2_control import ControlJoint, Ros2ControlSystem

__all__ = ["PLUGINS", "GenericSystem"]

PLUGINS: Final[tuple[str, ...]] = ("mock_components/GenericSystem", "fake_components/GenericSystem")
"""The plugin names it stands in for; the second is the older one."""

_MODES: Final = frozenset({POSITION, VELOCITY, ACCELERATION})


class _Joint:
    """A joint, sensor or GPIO: its interfaces by name, the pairs to mirror, and what is claimed of it."""

    __slots__ = ("commands", "follows", "initial", "mimic", "mirrored", "mode", "name", "states")

    def __init__(self, part: ControlJoint, *, commanded_states: bool = False) -> None:
        names = dict(part.command_interfaces)
        if commanded_states:
            names.update(part.state_interfaces)
        self.name, self.mimic, self.mode = part.name, part.mimic, POSITION
        self.commands = {
            name: CommandInterface(part.name, name, minimum=each.minimum, maximum=each.maximum)
            for name, each in names.items()
        }
        self.states = {name: StateInterface(part.name, name) for name in part.state_interfaces}
        self.initial = {name: each.initial_value for name, each in part.state_interfaces.items()}
        for name, each in part.command_interfaces.items():
            if name in self.initial and math.isnan(self.initial[name]):
                self.initial[name] = each.initial_value
        self.mirrored = [(each, self.states[name], 0.0) for name, each in self.commands.items() if name in self.states]
        self.follows: tuple[_Joint, Mimic] | None = None

    def reset(self, offset: float) -> None:
        """Set the states to what they start with; `offset` is added to the position."""
        for name, state in self.states.items():
            initial = self.initial[name]
            state.value = (0.0 if math.isnan(initial) else initial) + (offset if name == POSITION else 0.0)

    def stop(self, interface: str) -> None:
        """Stand still: what was commanded there is no more."""
        if interface in (VELOCITY, ACCELERATION):
            self.set(VELOCITY, 0.0)
            self.set(ACCELERATION, 0.0)

    def get(self, name: str) -> float:
        """Return a state, 0.0 if the joint has none of the name or does not know it."""
        state = self.states.get(name)
        return 0.0 if state is None or math.isnan(state.value) else state.value

    def set(self, name: str, value: float) -> None:
        """Set a state, if the joint has it."""
        state = self.states.get(name)
        if state is not None:
            state.value = value


class GenericSystem(Lifecycle):
    """One <ros2_control> tag without hardware; see the module."""

    def __init__(self, description: Ros2ControlSystem) -> None:
        super().__init__()
        self.name = description.name
        parameters = description.parameters
        self._dynamics = _true(parameters, "calculate_dynamics")
        self._disabled = _true(parameters, "disable_commands")
        self._offset = _offset(parameters)
        sensors = _true(parameters, "mock_sensor_commands") or _true(parameters, "fake_sensor_commands")
        gpios = _true(parameters, "mock_gpio_commands") or _true(parameters, "fake_gpio_commands")
        self._joints = {each.name: _Joint(each) for each in description.joints}
        extras = [_Joint(each, commanded_states=sensors) for each in description.sensors]
        extras += [_Joint(each, commanded_states=gpios) for each in description.gpios]
        self._parts: list[_Joint] = [*self._joints.values(), *extras]
        self._moving: list[_Joint] = [each for each in self._joints.values() if each.commands]
        for joint in self._joints.values():
            if joint.mimic is not None and joint.mimic.joint in self._joints:
                joint.follows = (self._joints[joint.mimic.joint], joint.mimic)
        self._following = [(each, *each.follows) for each in self._joints.values() if each.follows is not None]
        self._plain = self._mirrors()
        self.state_interfaces: Sequence[StateInterface] = [one for each in self._parts for one in each.states.values()]
        self.command_interfaces: Sequence[CommandInterface] = [
            one for each in self._parts for one in each.commands.values()
        ]
        self._owners = {one.name: each for each in self._parts for one in each.commands.values()}

    def _begin(self) -> None:
        for each in self._parts:
            each.reset(self._offset if each.name in self._joints else 0.0)

    def _rest(self) -> None:
        for joint in self._moving:
            joint.stop(joint.mode)

    def prepare_command_mode_switch(self, start: Sequence[str], stop: Sequence[str]) -> None:
        """Refuse, with dynamics, two of position, velocity and acceleration at one joint."""
        for name in (*start, *stop):
            self._owner(name)
        if not self._dynamics:
            return
        wanted: dict[str, str] = {}
        for name in start:
            joint, _, interface = name.rpartition("/")
            if interface in _MODES and wanted.setdefault(joint, name) != name:
                raise ControlError(f"joint {joint}: {wanted[joint]} and {name} cannot be commanded together")

    def perform_command_mode_switch(self, start: Sequence[str], stop: Sequence[str]) -> None:
        """Stand still where something is released, integrate what is claimed."""
        for name in stop:
            self._owner(name).stop(name.rpartition("/")[2])
        for name in start:
            interface = name.rpartition("/")[2]
            if interface in _MODES:
                self._owner(name).mode = interface

    def read(self, now: int, period: float) -> ReturnType:
        """Make the states follow the commands; `period` in s."""
        del now
        if self.state not in (LifecycleState.INACTIVE, LifecycleState.ACTIVE) or self._disabled:
            return OK
        for each in self.command_interfaces:
            if math.isinf(each.value):
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
        """Do nothing: there is nobody to send to."""
        del now, period
        return OK

    def _mirrors(self) -> list[tuple[CommandInterface, StateInterface, float]]:
        """Return what is copied as it is: everything, or with dynamics all that is not integrated."""
        pairs: list[tuple[CommandInterface, StateInterface, float]] = []
        for each in self._parts:
            integrated = _MODES if self._dynamics and each.name in self._joints else frozenset[str]()
            offset = self._offset if each.name in self._joints else 0.0
            pairs += [
                (command, state, offset if state.interface == POSITION else 0.0)
                for command, state, _ in each.mirrored
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
        raise ControlError(f"position_state_following_offset is {text!r}; it is a number of rad or m") from error
