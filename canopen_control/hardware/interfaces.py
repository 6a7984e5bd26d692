"""The interfaces between controllers and hardware, with ros2_control's names and meaning.

An interface is one mutable number in SI units (rad, rad/s, Nm); a command interface has at most
one owner, state interfaces are shared; nan means "no command was given" or "no value known". Nothing reads a clock,
blocks or allocates while the robot runs: the registry resolves names once, the cycle touches `value` only.
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
    from collections.abc import Mapping, Sequence

    from canopen_control.rpc.messages.drive import WorldAct
    from canopen_control.rpc.messages.simulation import LaserScanReading


MOTION_INTERFACES: Final = (POSITION, VELOCITY, EFFORT)
DIGITAL_OUTPUTS: Final = "digital_outputs"
TARGET: Final = "target"
"""A command interface of what the drive's present mode of operation takes: a position, a velocity or an effort."""


class ReturnType(enum.Enum):
    """Result of a read, update or write."""

    OK = "ok"
    ERROR = "error"


OK: Final = ReturnType.OK  # used a dozen times per cycle; before Python 3.12 the access to a member takes 65 ns
ERROR: Final = ReturnType.ERROR


class LifecycleState(enum.Enum):
    """States of a hardware component (managed nodes of ROS 2)."""

    UNCONFIGURED = "unconfigured"
    INACTIVE = "inactive"
    ACTIVE = "active"
    FINALIZED = "finalized"


class StateInterface:
    """Measured number: `value` in SI units, nan if unknown; `name` is "joint/interface"."""

    __slots__ = ("interface", "joint", "name", "value")

    def __init__(self, joint: str, interface: str, value: float = math.nan) -> None:
        self.joint, self.interface, self.value = joint, interface, value
        self.name = f"{joint}/{interface}"

    def __repr__(self) -> str:
        return f"StateInterface({self.name}={self.value})"


class ValueRange(Protocol):
    """Source of an object's value range."""

    def value_range(self) -> tuple[float, float]:
        """Return minimum and maximum."""
        ...


class CommandInterface:
    """Commanded number: `value` in SI units, nan without a command; `owner` is the controller that claimed it.

    - `minimum`, `maximum`: limits of the description, infinite without limits.
    - `enabled`: the hardware follows it now; hardware without drives always does.
    - `excluded`: a user disabled or halted this axis alone; the joints commanded with it go on until it follows again.
    - `lowest`, `highest`: range of the object behind it; for a position it depends on where the joint is (`range`).
    - `quantity`: the interface's name; of a TARGET the quantity of the present mode, TARGET without a mode.
    - `safe`: value of an output without a command: nan keeps its value, None if the hardware does not define one.
    - `release_value`: the same, set by the controller that releases the interface; None if it sets none.
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
        """The range of values where it changes; `lowest` and `highest` else."""
        self.safe: float | None = None
        self.release_value: float | None = None

    def range_error(self, value: float) -> str | None:
        """Return the valid range if a value does not fit the object, else None."""
        low, high = (self.lowest, self.highest) if self.range is None else self.range.value_range()
        return None if low <= value <= high else f"{self.name} holds {low:g} to {high:g}"

    def __repr__(self) -> str:
        return f"CommandInterface({self.name}={self.value}, owner={self.owner})"


class HardwareComponent(Protocol):
    """Hardware component: a system, an actuator or a sensor of the description.

    The lifecycle methods lead UNCONFIGURED -configure-> INACTIVE -activate-> ACTIVE and back; a method for a state
    already reached is a no-op. `read` is called in INACTIVE and ACTIVE, `write` in ACTIVE only.
    """

    @property
    def name(self) -> str:
        """Name of its tag in the description."""
        ...

    @property
    def state(self) -> LifecycleState:
        """State of its lifecycle."""
        ...

    @property
    def state_interfaces(self) -> Sequence[StateInterface]:
        """State interfaces, fixed after construction."""
        ...

    @property
    def command_interfaces(self) -> Sequence[CommandInterface]:
        """Command interfaces, fixed after construction."""
        ...

    @property
    def simulated_ns(self) -> int | None:
        """Simulated time in ns; None for a component in real time."""
        ...

    def configure(self) -> None:
        """Start communication; states become known, nothing moves."""
        ...

    def activate(self) -> None:
        """Permit commands; nothing moves before a controller claims an interface."""
        ...

    def deactivate(self) -> None:
        """Stop all motion."""
        ...

    def cleanup(self) -> None:
        """Undo `configure`."""
        ...

    def shutdown(self) -> None:
        """Shut down permanently."""
        ...

    def reset(self, keyframe: str) -> None:
        """Reset a simulation to its start, or to a key frame of its model; ControlError for an unknown one."""
        ...

    @property
    def changeable(self) -> bool:
        """Whether the component moves in a physics world that accepts disturbances."""
        ...

    def act(self, world_act: WorldAct) -> None:
        """Apply a disturbance to the world of a simulation; ConfigError for a missing link or joint."""
        ...

    def scan(self) -> Sequence[LaserScanReading]:
        """Return the scans of a simulation's lidars."""
        ...

    def prepare_command_mode_switch(self, start: Sequence[str], stop: Sequence[str]) -> None:
        """Raise ControlError or DriveError if these interfaces cannot be claimed or released; change nothing."""
        ...

    def perform_command_mode_switch(self, start: Sequence[str], stop: Sequence[str]) -> None:
        """Select the mode of the claimed interfaces and start to enable; stop the released ones. Never blocks."""
        ...

    def read(self, now: int, period: float) -> ReturnType:
        """Latch the measured values; `now` in ns, `period` in s."""
        ...

    def write(self, now: int, period: float) -> ReturnType:
        """Send the commands; `now` in ns, `period` in s."""
        ...


Interface = TypeVar("Interface", StateInterface, CommandInterface)


class InterfaceRegistry:
    """Interfaces of a robot by name, and owners of the command interfaces."""

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
        """State interfaces of components, in order of registration."""
        return tuple(self._states.values())

    @property
    def command_interfaces(self) -> tuple[CommandInterface, ...]:
        """Command interfaces, in order of registration."""
        return tuple(self._commands.values())

    def register(self, component: HardwareComponent) -> None:
        """Add a component; ControlError for a duplicate name of a component or an interface."""
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
        """Add the reference and state interfaces of a chainable controller; they have no component."""
        _refuse_doubles("command", exporter, references, self._commands)
        _refuse_doubles("state", exporter, states, {**self._states, **self._exported_states})
        self._commands.update({reference.name: reference for reference in references})
        self._exported_states.update({state.name: state for state in states})

    def withdraw(self, references: Sequence[CommandInterface], states: Sequence[StateInterface] = ()) -> None:
        """Remove the interfaces of a chainable controller."""
        for reference in references:
            self._commands.pop(reference.name, None)
        for state in states:
            self._exported_states.pop(state.name, None)

    def is_exported_state(self, name: str) -> bool:
        """Whether a state interface belongs to a controller."""
        return name in self._exported_states

    def state(self, name: str) -> StateInterface:
        """Return a state interface; UnknownInterface with the valid names otherwise."""
        return _lookup(name, {**self._states, **self._exported_states})

    def command(self, name: str) -> CommandInterface:
        """Return a command interface; UnknownInterface with the valid names otherwise."""
        return _lookup(name, self._commands)

    def component_of(self, name: str) -> HardwareComponent | None:
        """Return the component of an interface, None for a controller's reference; UnknownInterface otherwise."""
        if name not in self._states:
            _lookup(name, self._commands)
        exporter = self._exporters.get(name)
        return self._components[exporter] if exporter is not None else None

    def claim(self, names: Sequence[str], owner: str) -> list[CommandInterface]:
        """Claim all these command interfaces for `owner`, or raise without claiming any.

        UnknownInterface or InterfaceConflict. Interfaces that the owner already has remain.
        """
        commands = [self.command(name) for name in names]
        for command in commands:
            if command.owner not in (None, owner):
                raise InterfaceConflict(command.name, str(command.owner))
        for command in commands:
            command.owner = owner
        return commands

    def release(self, owner: str) -> list[str]:
        """Release all interfaces of an owner; return their names."""
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


# The lifecycle verbs of a component: a verb that does not fit the state does nothing.


@mypyc_attr(allow_interpreted_subclasses=True)
class ComponentLifecycle(ABC):
    """Lifecycle `state` and its transitions; a component implements `_begin` and `_rest`."""

    def __init__(self) -> None:
        self.state = LifecycleState.UNCONFIGURED

    @property
    def simulated_ns(self) -> int | None:
        """None: the component runs in real time."""
        return None

    @property
    def changeable(self) -> bool:
        """False: no physics moves the component."""
        return False

    def configure(self) -> None:
        """Start to read states."""
        if self.state is LifecycleState.UNCONFIGURED:
            self._begin()
            self.state = LifecycleState.INACTIVE

    def activate(self) -> None:
        """Permit commands."""
        if self.state is LifecycleState.INACTIVE:
            self.state = LifecycleState.ACTIVE

    def deactivate(self) -> None:
        """Stop all motion."""
        if self.state is LifecycleState.ACTIVE:
            self._rest()
            self.state = LifecycleState.INACTIVE

    def cleanup(self) -> None:
        """Return to the initial state."""
        self.deactivate()
        if self.state is LifecycleState.INACTIVE:
            self.state = LifecycleState.UNCONFIGURED

    def shutdown(self) -> None:
        """Shut down permanently."""
        self.deactivate()
        self.state = LifecycleState.FINALIZED

    def reset(self, keyframe: str) -> None:  # noqa: B027 - most have nothing to do
        """Do nothing: the component is not simulated."""

    def act(self, world_act: WorldAct) -> None:  # noqa: B027 - as above
        """Do nothing: the component has no world."""

    def scan(self) -> Sequence[LaserScanReading]:
        """Return an empty list, because drives have no lidars."""
        return ()

    @abstractmethod
    def _begin(self) -> None:
        """Start to read states."""

    @abstractmethod
    def _rest(self) -> None:
        """Stop all motion."""
