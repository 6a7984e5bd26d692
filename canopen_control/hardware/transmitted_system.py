"""A hardware component seen through its transmissions: the values of joints instead of those of motor shafts.

The law of the file (ROS 1 transmission_interface, ros2_control SimpleTransmission): joint position = actuator position
/ reduction + offset, joint velocity = actuator velocity / reduction, joint effort = actuator effort * reduction, and
commands the other way round. A negative reduction turns the direction. Transmissions apply to real and virtual drives;
mock hardware and the simulation are joints already.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from canopen_control.hardware.interfaces import (
    ACCELERATION,
    EFFORT,
    POSITION,
    VELOCITY,
    CommandInterface,
    ReturnType,
    StateInterface,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.hardware.interfaces import HardwareComponent, LifecycleState
    from canopen_control.rpc.messages.drive import WorldAct
    from canopen_control.rpc.messages.simulation import LaserScanReading
    from canopen_control.urdf.transmission import Transmission

__all__ = ["TransmittedSystem"]


class _State:
    """A state on both sides: joint = actuator * factor + offset."""

    __slots__ = ("factor", "inner", "offset", "outer")

    def __init__(self, inner: StateInterface, transmission: Transmission) -> None:
        self.outer, self.inner = StateInterface(inner.joint, inner.interface), inner
        self.factor, self.offset = _ratio(inner.interface, transmission)


class _Command:
    """A command on both sides, in the same way; its bounds, given for the joint, are turned for the actuator too."""

    __slots__ = ("factor", "inner", "offset", "outer")

    def __init__(self, inner: CommandInterface, transmission: Transmission) -> None:
        self.outer, self.inner = _seen(inner), inner
        self.factor, self.offset = _ratio(inner.interface, transmission)
        self.outer.enabled = inner.enabled
        ends = [(each - self.offset) / self.factor for each in (inner.minimum, inner.maximum)]
        inner.minimum, inner.maximum = min(ends), max(ends)

    def follow(self) -> None:
        """Say whether the hardware follows commands: who commands it forgets what counts no more."""
        outer, enabled = self.outer, self.inner.enabled
        if outer.enabled is not enabled:
            outer.enabled = enabled
            if enabled:
                outer.set_aside = False


def _ratio(interface: str, transmission: Transmission) -> tuple[float, float]:
    factor = float(transmission.reduction ** _POWERS.get(interface, 0))
    return factor, transmission.offset if interface == POSITION else 0.0


_POWERS: Final = {POSITION: -1, VELOCITY: -1, ACCELERATION: -1, EFFORT: 1}
"""The power of the reduction that makes a joint's value of an actuator's."""


class TransmittedSystem:
    """A component seen through its transmissions: the same interfaces by name, with the joints' values.

    What no transmission turns is the component's own.
    """

    def __init__(self, component: HardwareComponent, transmissions: Sequence[Transmission]) -> None:
        self.component = component
        self.name = component.name
        by_joint = {each.joint: each for each in transmissions if not each.trivial}
        self._states = [
            _State(each, by_joint[each.joint]) for each in component.state_interfaces if each.joint in by_joint
        ]
        self._commands = [
            _Command(each, by_joint[each.joint]) for each in component.command_interfaces if each.joint in by_joint
        ]
        states = {each.inner.name: each.outer for each in self._states}
        commands = {each.inner.name: each.outer for each in self._commands}
        self.state_interfaces: Sequence[StateInterface] = [
            states.get(each.name, each) for each in component.state_interfaces
        ]
        self.command_interfaces: Sequence[CommandInterface] = [
            commands.get(each.name, each) for each in component.command_interfaces
        ]

    @property
    def state(self) -> LifecycleState:
        """The component's."""
        return self.component.state

    @property
    def simulated_ns(self) -> int | None:
        """The component's."""
        return self.component.simulated_ns

    def configure(self) -> None:
        """Configure the component."""
        self.component.configure()

    def activate(self) -> None:
        """Activate the component."""
        self.component.activate()

    def deactivate(self) -> None:
        """Deactivate the component."""
        self.component.deactivate()

    def cleanup(self) -> None:
        """Clean the component up."""
        self.component.cleanup()

    def shutdown(self) -> None:
        """Shut the component down."""
        self.component.shutdown()

    def reset(self, keyframe: str) -> None:
        """Reset the component."""
        self.component.reset(keyframe)

    @property
    def changeable(self) -> bool:
        """See the component."""
        return self.component.changeable

    def act(self, what: WorldAct) -> None:
        """Let it happen in the component's world."""
        self.component.act(what)

    def scan(self) -> Sequence[LaserScanReading]:
        """Return the component's."""
        return self.component.scan()

    def prepare_command_mode_switch(self, start: Sequence[str], stop: Sequence[str]) -> None:
        """Ask the component."""
        self.component.prepare_command_mode_switch(start, stop)

    def perform_command_mode_switch(self, start: Sequence[str], stop: Sequence[str]) -> None:
        """Switch the component."""
        self.component.perform_command_mode_switch(start, stop)

    def read(self, now: int, period: float) -> ReturnType:
        """Read the component and turn its actuators' states into the joints'."""
        result = self.component.read(now, period)
        for each in self._states:
            each.outer.value = each.inner.value * each.factor + each.offset
        self._follow()
        return result

    def write(self, now: int, period: float) -> ReturnType:
        """Turn the joints' commands into the actuators' and write the component."""
        for each in self._commands:
            each.inner.value = (each.outer.value - each.offset) / each.factor
        result = self.component.write(now, period)
        self._follow()
        return result

    def _follow(self) -> None:
        for each in self._commands:
            each.follow()


def _seen(inner: CommandInterface) -> CommandInterface:
    """Return the joint's side of an actuator's command interface, with the bounds that were given for the joint."""
    return CommandInterface(inner.joint, inner.interface, inner.value, minimum=inner.minimum, maximum=inner.maximum)
