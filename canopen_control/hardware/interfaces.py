"""Interfaces between controllers and hardware, with the names and meanings of ros2_control.

An interface is a mutable number in SI units (rad, rad/s, Nm). A command interface has at most one owner; state
interfaces are shared. nan means "no command" or "unknown value". While the robot runs no code here reads a clock,
blocks or allocates memory: the registry resolves names once, and the cycle accesses only `value`.
"""

from __future__ import annotations

import enum
import math
from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Final, Protocol, TypeVar

from mypy_extensions import mypyc_attr

from canopen_control.errors import ControlError, InterfaceConflict, UnknownInterface
from canopen_control.urdf.joint_element import EFFORT, POSITION, VELOCITY

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from canopen_control.rpc.messages.drive import WorldAct
    from canopen_control.rpc.messages.simulation import LaserScanReading


MOTION_INTERFACES: Final = (POSITION, VELOCITY, EFFORT)
DIGITAL_OUTPUTS: Final = "digital_outputs"
TARGET: Final = "target"
"""Command interface for the target of the drive's current mode: a position, a velocity or an effort."""


class ReturnType(enum.Enum):
    """Result of a read or write of a component, or of an update of a controller."""

    OK = "ok"
    ERROR = "error"


OK: Final = ReturnType.OK  # used a dozen times per cycle; before Python 3.12 accessing an enum member takes 65 ns
ERROR: Final = ReturnType.ERROR


class LifecycleState(enum.Enum):
    """Lifecycle state of a hardware component, as for a managed node in ROS 2."""

    UNCONFIGURED = "unconfigured"
    INACTIVE = "inactive"
    ACTIVE = "active"
    FINALIZED = "finalized"


class StateInterface:
    """Measured value in SI units (nan: unknown); `name` is "joint/interface"."""

    __slots__ = ("interface", "joint", "name", "value")

    def __init__(self, joint: str, interface: str, value: float = math.nan) -> None:
        self.joint, self.interface, self.value = joint, interface, value
        self.name = f"{joint}/{interface}"

    def __repr__(self) -> str:
        return f"StateInterface({self.name}={self.value})"


class ValueRange(Protocol):
    """Source of the current value range of a command interface."""

    def value_range(self) -> tuple[float, float]:
        """Return the minimum and maximum in SI units."""
        ...


class CommandInterface:
    """Commanded value in SI units (nan: no command); `owner` is the claiming controller, or None.

    - `minimum`, `maximum`: limits in the description, infinite without limits.
    - `enabled`: the hardware follows commands at present; always True without drives.
    - `excluded`: a user disabled or halted only this axis; the joints commanded together with it continue without it.
    - `lowest`, `highest`: range of the object; for a position the range depends on the present position (`range`).
    - `quantity`: name of the interface; for a TARGET the quantity of the current mode, or TARGET without a mode.
    - `safe`: value of an output after release: nan keeps the value, None if the hardware does not define a safe value.
    - `release_value`: value set by the controller that releases the interface, instead of `safe`; None without one.
    """

    __slots__ = (
        "enabled",
        "excluded",
        "highest",
        "interface",
        "joint",
        "lowest",
        "maximum",
        "minimum",
        "name",
        "owner",
        "quantity",
        "range",
        "release_value",
        "safe",
        "value",
    )

    def __init__(
        self,
        joint: str,
        interface: str,
        value: float = math.nan,
        *,
        minimum: float = -math.inf,
        maximum: float = math.inf,
    ) -> None:
        self.joint, self.interface, self.value = joint, interface, value
        self.name = f"{joint}/{interface}"
        self.quantity = interface
        self.owner: str | None = None
        self.enabled = True
        self.excluded = False
        self.minimum, self.maximum = minimum, maximum
        self.lowest, self.highest = -math.inf, math.inf
        self.range: ValueRange | None = None
        """Source of a changing range; None if `lowest` and `highest` are the range."""
        self.safe: float | None = None
        self.release_value: float | None = None

    def range_error(self, value: float) -> str | None:
        """Return a text with the valid range if a value does not fit the object, else None."""
        low, high = (self.lowest, self.highest) if self.range is None else self.range.value_range()
        return None if low <= value <= high else f"the range of {self.name} is {low:g} to {high:g}"

    def __repr__(self) -> str:
        return f"CommandInterface({self.name}={self.value}, owner={self.owner})"


class HardwareComponent(Protocol):
    """Interface of a hardware component: a system, an actuator or a sensor of the description.

    The lifecycle methods lead from UNCONFIGURED by configure to INACTIVE, by activate to ACTIVE, and back; a method
    whose state is already reached does nothing. `read` is called in INACTIVE and ACTIVE, `write` only in ACTIVE.
    """

    @property
    def name(self) -> str:
        """Name of the component's tag in the description."""
        ...

    @property
    def state(self) -> LifecycleState:
        """Current lifecycle state, as in ROS 2."""
        ...

    @property
    def state_interfaces(self) -> Sequence[StateInterface]:
        """State interfaces, constant after construction."""
        ...

    @property
    def command_interfaces(self) -> Sequence[CommandInterface]:
        """Command interfaces, constant after construction."""
        ...

    @property
    def simulated_ns(self) -> int | None:
        """Simulated time in ns, or None if the component runs in real time."""
        ...

    def configure(self) -> None:
        """Start communication, so that states become known, without any motion."""
        ...

    def activate(self) -> None:
        """Permit commands; nothing moves before a controller claims an interface."""
        ...

    def deactivate(self) -> None:
        """Stop all motion and enter INACTIVE."""
        ...

    def cleanup(self) -> None:
        """Undo `configure`; deactivate the component first if necessary."""
        ...

    def shutdown(self) -> None:
        """Stop all motion and enter FINALIZED, the last state."""
        ...

    def reset(self, keyframe: str) -> None:
        """Reset a simulation to its start or to a key frame; raise ControlError for an unknown key frame."""
        ...

    @property
    def changeable(self) -> bool:
        """Whether the component is part of a physics simulation that accepts disturbances."""
        ...

    def act(self, world_act: WorldAct) -> None:
        """Apply a disturbance to a physics simulation; raise ConfigError for a missing link or joint."""
        ...

    def scan(self) -> Sequence[LaserScanReading]:
        """Return a scan of each simulated lidar; () without lidars."""
        ...

    def prepare_command_mode_switch(self, start: Sequence[str], stop: Sequence[str]) -> None:
        """Raise ControlError or DriveError, before any change, for an impossible switch."""
        ...

    def perform_command_mode_switch(self, start: Sequence[str], stop: Sequence[str]) -> None:
        """Stop released joints; select the modes of claimed joints and start enabling them.

        This method never blocks.
        """
        ...

    def read(self, now: int, period: float) -> ReturnType:
        """Update the state interfaces from the hardware; `now` in ns, `period` in s."""
        ...

    def write(self, now: int, period: float) -> ReturnType:
        """Send the values of the command interfaces to the hardware; `now` in ns, `period` in s."""
        ...


Interface = TypeVar("Interface", StateInterface, CommandInterface)


class InterfaceRegistry:
    """Registry of a robot's components and interfaces, and of the owners of command interfaces."""

    def __init__(self) -> None:
        self._states: dict[str, StateInterface] = {}
        self._commands: dict[str, CommandInterface] = {}
        self._exported_states: dict[str, StateInterface] = {}
        self._components: dict[str, HardwareComponent] = {}
        self.components: tuple[HardwareComponent, ...] = ()
        """Registered components, in order of registration."""
        self._exporters: dict[str, str] = {}

    @property
    def state_interfaces(self) -> tuple[StateInterface, ...]:
        return tuple(self._states.values())

    @property
    def command_interfaces(self) -> tuple[CommandInterface, ...]:
        """Command interfaces of components and controllers, in order of registration."""
        return tuple(self._commands.values())

    def register(self, component: HardwareComponent) -> None:
        """Add a component with its interfaces; raise ControlError if a name already exists."""
        if component.name in self._components:
            raise ControlError(f"two hardware components are called {component.name!r}; rename one <ros2_control> tag")
        _refuse_doubles("state", component.name, component.state_interfaces, self._states)
        _refuse_doubles("command", component.name, component.command_interfaces, self._commands)
        self._components[component.name] = component
        self.components = tuple(self._components.values())
        self._states.update({state_interface.name: state_interface for state_interface in component.state_interfaces})
        self._commands.update({interface.name: interface for interface in component.command_interfaces})
        self._exporters.update({interface.name: component.name for interface in component.command_interfaces})
        self._exporters.update({state_interface.name: component.name for state_interface in component.state_interfaces})

    def export(
        self, references: Sequence[CommandInterface], exporter: str, states: Sequence[StateInterface] = ()
    ) -> None:
        """Add reference and state interfaces of a chainable controller; raise ControlError if a name already exists."""
        _refuse_doubles("command", exporter, references, self._commands)
        _refuse_doubles("state", exporter, states, {**self._states, **self._exported_states})
        self._commands.update({reference.name: reference for reference in references})
        self._exported_states.update({state.name: state for state in states})

    def withdraw(self, references: Sequence[CommandInterface], states: Sequence[StateInterface] = ()) -> None:
        for reference in references:
            self._commands.pop(reference.name, None)
        for state in states:
            self._exported_states.pop(state.name, None)

    def is_exported_state(self, name: str) -> bool:
        """Whether a state interface is exported by a controller, not by a component."""
        return name in self._exported_states

    def state(self, name: str) -> StateInterface:
        """Return a state interface by name; raise UnknownInterface with the valid names if it does not exist."""
        return _lookup(name, {**self._states, **self._exported_states})

    def command(self, name: str) -> CommandInterface:
        """Return a command interface by name; raise UnknownInterface with the valid names if it does not exist."""
        return _lookup(name, self._commands)

    def component_of(self, name: str) -> HardwareComponent | None:
        """Return the component of an interface, or None if a controller exports it; raise UnknownInterface."""
        if name not in self._states:
            _lookup(name, self._commands)
        exporter = self._exporters.get(name)
        return self._components[exporter] if exporter is not None else None

    def claim(self, names: Sequence[str], owner: str) -> list[CommandInterface]:
        """Claim command interfaces for a controller, all or none.

        Raise UnknownInterface for an unknown name, InterfaceConflict if another controller owns one. Interfaces that
        the controller already owns are accepted.
        """
        commands = [self.command(name) for name in names]
        for command in commands:
            if command.owner not in (None, owner):
                raise InterfaceConflict(command.name, str(command.owner))
        for command in commands:
            command.owner = owner
        return commands

    def release(self, owner: str) -> list[str]:
        """Release all command interfaces of a controller, and return their names."""
        released = [command for command in self._commands.values() if command.owner == owner]
        for interface in released:
            interface.owner = None
        return [interface.name for interface in released]


def _lookup(name: str, among: Mapping[str, Interface]) -> Interface:
    interface = among.get(name)
    if interface is None:
        raise UnknownInterface(name, tuple(among))
    return interface


def _refuse_doubles(kind: str, exporter: str, new: Sequence[Interface], present: Mapping[str, Interface]) -> None:
    names = set(present)
    for interface in new:
        if interface.name in names:
            raise ControlError(f"{exporter}: {kind} interface {interface.name} exists already; name each joint once")
        names.add(interface.name)


def refuse_two_interfaces(names: Iterable[str]) -> None:
    """Raise ControlError if two of the claimed command interfaces command the same joint."""
    claimed: dict[str, str] = {}
    for name in names:
        joint = name.rpartition("/")[0]
        if claimed.setdefault(joint, name) != name:
            raise ControlError(f"joint {joint}: {claimed[joint]} and {name} cannot be commanded together")


# Lifecycle methods of a component; a method that is not allowed in the current state does nothing.


@mypyc_attr(allow_interpreted_subclasses=True)
class ComponentLifecycle(ABC):
    """Base class with the component lifecycle of ros2_control; subclasses implement `_begin` and `_rest`."""

    def __init__(self) -> None:
        self.state = LifecycleState.UNCONFIGURED

    @property
    def simulated_ns(self) -> int | None:
        """Always None (real time)."""
        return None

    @property
    def changeable(self) -> bool:
        """Always False (no physics simulation)."""
        return False

    def configure(self) -> None:
        """Start reading states and enter INACTIVE; from UNCONFIGURED only."""
        if self.state is LifecycleState.UNCONFIGURED:
            self._begin()
            self.state = LifecycleState.INACTIVE

    def activate(self) -> None:
        """Enter ACTIVE, which permits commands; from INACTIVE only."""
        if self.state is LifecycleState.INACTIVE:
            self.state = LifecycleState.ACTIVE

    def deactivate(self) -> None:
        """Stop all motion and enter INACTIVE; from ACTIVE only."""
        if self.state is LifecycleState.ACTIVE:
            self._rest()
            self.state = LifecycleState.INACTIVE

    def cleanup(self) -> None:
        self.deactivate()
        if self.state is LifecycleState.INACTIVE:
            self.state = LifecycleState.UNCONFIGURED

    def shutdown(self) -> None:
        self.deactivate()
        self.state = LifecycleState.FINALIZED

    def reset(self, keyframe: str) -> None:  # noqa: B027 - most components are not simulated
        pass

    def act(self, world_act: WorldAct) -> None:  # noqa: B027 - as above
        pass

    def scan(self) -> Sequence[LaserScanReading]:
        return ()

    @abstractmethod
    def _begin(self) -> None:
        """Start reading states; called by `configure`."""

    @abstractmethod
    def _rest(self) -> None:
        """Stop all motion; called by `deactivate`."""
