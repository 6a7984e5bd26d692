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
from canopen_control.urdf.transmission import Transmission

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.hardware.interfaces import HardwareComponent, LifecycleState

__all__ = ["TransmittedSystem"]


class _Ratio:
    """One interface on both sides: joint = actuator * factor + offset."""

    __slots__ = ("factor", "inner", "offset", "outer")

    def __init__(
        self,
        outer: StateInterface | CommandInterface,
        inner: StateInterface | CommandInterface,
        transmission: Transmission,
    ) -> None:
        self.outer, self.inner = outer, inner
        self.factor = transmission.reduction ** _POWERS.get(outer.interface, 0)
        self.offset = transmission.offset if outer.interface == POSITION else 0.0


_POWERS: Final = {POSITION: -1, VELOCITY: -1, ACCELERATION: -1, EFFORT: 1}
"""The power of the reduction that makes a joint's value of an actuator's."""


class TransmittedSystem:
    """A component seen through its transmissions: the same interfaces by name, with the joints' values."""

    def __init__(self, component: HardwareComponent, transmissions: Sequence[Transmission]) -> None:
        self.component = component
        self.name = component.name
        by_joint = {each.joint: each for each in transmissions}
        states = [(StateInterface(each.joint, each.interface), each) for each in component.state_interfaces]
        commands = [(_seen(each), each) for each in component.command_interfaces]
        self.state_interfaces: Sequence[StateInterface] = [outer for outer, _ in states]
        self.command_interfaces: Sequence[CommandInterface] = [outer for outer, _ in commands]
        direct = Transmission("", "", "")
        self._states = [_Ratio(outer, inner, by_joint.get(outer.joint, direct)) for outer, inner in states]
        self._commands = [_Ratio(outer, inner, by_joint.get(outer.joint, direct)) for outer, inner in commands]

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
        return result

    def write(self, now: int, period: float) -> ReturnType:
        """Turn the joints' commands into the actuators' and write the component."""
        for each in self._commands:
            each.inner.value = (each.outer.value - each.offset) / each.factor
        return self.component.write(now, period)


def _seen(inner: CommandInterface) -> CommandInterface:
    """Return the joint's side of an actuator's command interface; its limits are those of the joint already."""
    return CommandInterface(inner.joint, inner.interface, inner.value, minimum=inner.minimum, maximum=inner.maximum)
