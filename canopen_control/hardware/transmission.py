"""Transmissions: what is between the shaft of a motor and the joint of the description.

The law of the file (ROS 1 transmission_interface, ros2_control SimpleTransmission): joint position = actuator position
/ reduction + offset, joint velocity = actuator velocity / reduction, joint effort = actuator effort * reduction, and
commands the other way round. A negative reduction turns the direction. Both spellings are read: ROS 1's tag at the root
(`<mechanicalReduction>`, `<hardwareInterface>`) and ros2_control's inside its own tag (`<mechanical_reduction>`).
Transmissions apply to real and virtual drives; mock hardware and the simulation are joints already.
"""

from __future__ import annotations

from dataclasses import dataclass
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
from canopen_control.yamltree import nearest

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.hardware.interfaces import HardwareComponent, LifecycleState
    from canopen_control.hardware.urdf import Document, Element

__all__ = ["HARDWARE_INTERFACES", "Transmission", "TransmittedSystem", "read_transmission"]

SIMPLE: Final = "transmission_interface/SimpleTransmission"
HARDWARE_INTERFACES: Final = {
    "VelocityJointInterface": VELOCITY,
    "PositionJointInterface": POSITION,
    "EffortJointInterface": EFFORT,
    "PosVelJointInterface": VELOCITY,
    "JointStateInterface": "",
}
"""ROS 1's hardware interfaces (`hardware_interface/` may stand before them) and the command interface of each."""


@dataclass(frozen=True)
class Transmission:
    """A simple transmission: the actuator turns `reduction` times as far as the joint; `offset` in rad or m.

    `interfaces` are the command interfaces that a ROS 1 tag names; "" there is a joint that is only read.
    """

    name: str
    joint: str
    actuator: str
    reduction: float = 1.0
    offset: float = 0.0
    interfaces: tuple[str, ...] = ()
    line: int = 0

    @property
    def trivial(self) -> bool:
        """Whether joint and actuator turn alike."""
        return self.reduction == 1.0 and self.offset == 0.0


def read_transmission(document: Document, element: Element) -> Transmission:
    """Return a <transmission>; what is wrong in it is reported to the document."""
    name = document.name(element)
    kind = element.child("type") or element.child("plugin")
    if kind is None or kind.text.rpartition("/")[2] != "SimpleTransmission":
        said = f"is {kind.text!r}" if kind is not None else "is missing"
        document.error(element, f"transmission {name}: its type {said}; the one there is: {SIMPLE}")
    joint, actuator = element.child("joint"), element.child("actuator")
    if joint is None:
        document.error(element, f"transmission {name}: <joint name=...> is missing")
    reduction, offset = _reduction(document, element, joint, actuator)
    return Transmission(
        name,
        joint.attributes.get("name", "") if joint is not None else "",
        actuator.attributes.get("name", "") if actuator is not None else "",
        reduction,
        offset,
        _interfaces(document, name, joint, actuator),
        element.line,
    )


def _reduction(
    document: Document, element: Element, joint: Element | None, actuator: Element | None
) -> tuple[float, float]:
    places = (actuator, joint, element)
    tags = [place.child(tag) for place in places if place is not None for tag in _REDUCTIONS]
    found = next((tag for tag in tags if tag is not None), None)
    offset = joint.child("offset") if joint is not None else None
    ratio = document.decimal(found, {"reduction": found.text}, "reduction", 1.0) if found is not None else 1.0
    if found is not None and ratio == 0.0:
        document.error(found, f"<{found.tag}> is 0; it is how often the motor turns per turn of the joint")
    moved = document.decimal(offset, {"offset": offset.text}, "offset", 0.0) if offset is not None else 0.0
    return ratio or 1.0, moved


_REDUCTIONS: Final = ("mechanicalReduction", "mechanical_reduction")


def _interfaces(document: Document, name: str, joint: Element | None, actuator: Element | None) -> tuple[str, ...]:
    """Return the command interfaces of the `<hardwareInterface>` tags, which older files have at the actuator."""
    found: list[str] = []
    for place in (joint, actuator):
        for each in place.children if place is not None else ():
            if each.tag != "hardwareInterface":
                continue
            short = each.text.removeprefix("hardware_interface/")
            if short not in HARDWARE_INTERFACES:
                hint = nearest(short, HARDWARE_INTERFACES)
                document.error(each, f"transmission {name}: no hardwareInterface {each.text!r}{hint}")
            else:
                found.append(HARDWARE_INTERFACES[short])
    return tuple(dict.fromkeys(found))


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
