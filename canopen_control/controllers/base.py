"""Base class of controllers: lifecycle, interfaces, commands.

A controller only reads and writes `value` of the interfaces it received at activation; it reads no clock, sends nothing
and never blocks. A command that is not finite or has the wrong size is refused with a ControlError and counted: it is
not applied and does not refresh a timeout. On every deactivation the velocity, effort and acceleration targets become
0.0 (upstream leaves them; a wheel would keep turning), position targets stay. A command has a timeout
(`command_timeout`); it is cleared when a drive behind the controller is no longer enabled.

A new controller is a class in this or any other package: derive from `Controller`, and register it in the entry point
group `canopen_control.controllers` with its type as the name: `"my_robot/Dance" = "my_robot.dance:Dance"`.
"""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Final, Protocol

from mypy_extensions import mypyc_attr

from canopen_control.controllers.command_timeout import MOVING, CommandTimeout
from canopen_control.controllers.params import CommonParams
from canopen_control.errors import ControlError, NotEnabled
from canopen_control.hardware.interfaces import OK, ReturnType
from canopen_control.urdf.joint_element import POSITION

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from canopen_control.controllers.params import Params
    from canopen_control.hardware.interfaces import CommandInterface, StateInterface
    from canopen_control.rpc.messages.samples import ControllerSample, Sample, Values
    from canopen_control.urdf.joint_element import Joint

    Ends = tuple[CommandInterface, ...]


# A copy of selected states at one time: the content of a broadcaster's messages.


def finite(value: float) -> float | None:
    """Return a value, None for an unknown one."""
    return value if math.isfinite(value) else None


class StateCopy:
    """Values of states by joint and name, copied by the last `take`.

    `layout` gives the source of each value by joint and name, None for a constant 0.0.
    """

    def __init__(self, layout: Mapping[str, Mapping[str, StateInterface | None]]) -> None:
        places = [(joint, name, source) for joint, names in layout.items() for name, source in names.items()]
        self._places = [(joint, name) for joint, name, _ in places]
        self._values = [0.0] * len(places)
        self._sources = [(index, source) for index, (_, _, source) in enumerate(places) if source is not None]
        self._joints = list(layout)
        self.take()

    @property
    def joints(self) -> list[str]:
        """Joints of the layout, in order."""
        return list(self._joints)

    def take(self) -> None:
        """Copy the present states without allocations."""
        values = self._values
        for index, source in self._sources:
            values[index] = source.value

    def by_joint(self) -> dict[str, Values]:
        """Return the copy; None for unknown values."""
        values_by_joint: dict[str, Values] = {joint: {} for joint in self._joints}
        for (joint, name), value in zip(self._places, self._values, strict=True):
            values_by_joint[joint][name] = finite(value)
        return values_by_joint


# The timeout of a controller's command: its sender, its time, and how long it is valid.
#
# A velocity or effort command that is not renewed ends, after the time-out of the YAML
# or, where that names none, after `DEFAULT_LIFE_S`; a time-out of 0 that is written is for ever, as upstream's default.
# A position is a place to stay at and has no end.


"""The kind of the event that tells of commands without an end."""
"""The interfaces whose targets keep something moving."""


ALL_STATES: Final = "*"
"""As the only state interface name: every state interface of the robot."""


class WheelGeometrySource(Protocol):
    """Source of the wheel geometry in the robot's description, in m; None for unknown values."""

    def separation(self, left: Sequence[str], right: Sequence[str]) -> float | None:
        """Return the distance between the wheels of both sides, by their joints."""
        ...

    def radius(self, wheels: Sequence[str]) -> float | None:
        """Return the radius of these wheels, by their joints."""
        ...


@dataclass(frozen=True, slots=True)
class DriveGeometry:
    """Geometry that a base controller assumes, for `check`: wheels, sizes in m, frames.

    `frozen` are the axes of a twist whose limits keep their speed constant. The keys are those of its parameters; a
    separation of 0 is unknown.
    """

    left: tuple[str, ...]
    right: tuple[str, ...]
    separation: float
    radius: float
    odom_frame: str
    base_frame: str
    publishes_tf: bool = True
    frozen: tuple[str, ...] = ()
    radius_key: str = "wheel_radius"
    separation_key: str = "wheel_separation"


class ControllerState(enum.Enum):
    """States of a controller (managed nodes of ROS 2)."""

    UNCONFIGURED = "unconfigured"
    INACTIVE = "inactive"
    ACTIVE = "active"
    FINALIZED = "finalized"


def zero_targets(commands: Sequence[CommandInterface]) -> None:
    """Set targets that would cause motion to 0.0; position targets are unchanged."""
    for command in commands:
        if command.quantity in MOVING:
            command.value = 0.0


def is_moving(commands: Sequence[CommandInterface]) -> bool:
    """Return whether a target causes motion, or may be a position that is not reached."""
    return any(command.value != 0.0 and math.isfinite(command.value) for command in commands)


@mypyc_attr(allow_interpreted_subclasses=True)
class EnableStatus:
    """Enable status of interfaces without drives: which follow commands together, and why some do not.

    `runtime.enable_status.DriveEnableStatus` is that of drives.
    """

    def error(self, waiting: Sequence[CommandInterface]) -> NotEnabled:
        """Return the error for a command to interfaces that do not follow it."""
        return NotEnabled(f"{joint_names(waiting)}: not enabled, so no command is taken")

    def reason(self, waiting: Sequence[CommandInterface]) -> str:
        """Return the joints that do not follow commands, with advice."""
        return f"{joint_names(waiting)}: not enabled; enable it"

    def stop_groups(self, ends: Ends) -> Sequence[Ends]:
        """Return the interfaces in groups that stop together."""
        return (ends,)


def joint_names(interfaces: Sequence[CommandInterface]) -> str:
    """Return the joints of interfaces, each once, separated by commas."""
    return ", ".join(dict.fromkeys(interface.joint for interface in interfaces))


@dataclass(frozen=True, slots=True)
class ControllerEvent:
    """Controller event: `kind` is activated, deactivated, error, fallback, limited, or specific to a controller."""

    kind: str
    controller: str
    text: str


def twist_axes_of(controller: Controller) -> tuple[str, ...]:
    """Return the twist axes that a base accepts, by its topic if undeclared; empty for other controllers."""
    return controller.twist_axes or (("linear.x", "angular.z") if controller.topic == "cmd_vel" else ())


@mypyc_attr(allow_interpreted_subclasses=True)
class Controller:
    """Base of controllers: hooks without effect and no interfaces.

    `commands` and `states` are its interfaces while it is active, in the order it named them. `rejected` counts the
    commands it refused. `topic` is where ROS sends commands, None if it takes none. `publishes` are its topics of joint
    states for ROS, relative to the robot's namespace, and `frame_id` is the frame of their headers. `tells`
    is the kind of its `sample`, None if it has none, `stamp` the time of its last publication in ns, `publish_rate`
    how often it publishes, in Hz, 0 for at every update. `life` is the timeout of its command.
    """

    title: ClassVar[str] = ""
    """The heading of its parameters in the documentation; types with one heading are described together."""
    reads: ClassVar[type[CommonParams]] = CommonParams
    """The dataclass of its parameters, with their help texts."""
    sections: ClassVar[dict[str, type[object]]] = {}
    """The dataclasses of parameters below names that the file gives, by the heading that says which they are."""
    is_broadcaster: ClassVar[bool] = False
    is_base: ClassVar[bool] = False
    """Whether its joints move one base (a vehicle): they stop together, and no verb acts on one of them alone."""
    moves_joints: ClassVar[bool] = True
    """Whether it is one to move joints; one that is not, as a broadcaster, is started beside the one that is."""
    twist_axes: ClassVar[tuple[str, ...]] = ()
    """The axes of the twists that a base takes, such as "linear.x"; empty if it takes values of joints."""
    independent: ClassVar[bool] = False
    """Whether each of its interfaces has a value of its own: one stop group of them may go on without another."""
    settable: ClassVar[tuple[str, ...]] = ()
    """The parameters that `on_set` takes while it is configured: patterns of dotted names, `gains.*`."""
    topic: ClassVar[str | None] = None
    tells: ClassVar[type[Sample] | None] = None
    roller_wheels: ClassVar[tuple[str, ...]] = ()
    """The parameters that name the joints of its mecanum wheels, which physics gives rollers."""
    offers: ClassVar[tuple[str, ...]] = ()
    """What it takes beside commands, by the words of `rpc.messages.state`: goals of ROS, services, a calibration."""

    def __init__(self, name: str, type_name: str = "") -> None:
        self.name, self.type = name, type_name
        self.state = ControllerState.UNCONFIGURED
        self.update_rate = 0
        self.publish_rate = 0.0
        self.rejected = 0
        self.life = CommandTimeout()
        self.publishes: tuple[str, ...] = ()
        self.frame_id = ""
        self.joints: tuple[str, ...] = ()
        self.interface: str | None = None
        self.stamp = 0
        self.commands: list[CommandInterface] = []
        self.states: list[StateInterface] = []
        self.description_joints: tuple[str, ...] | None = None
        """The movable joints of the robot's description, set by the manager; None if there is no description."""
        self.geometry: WheelGeometrySource | None = None
        """The wheels of the robot's description, set by the manager; None if there is no description."""
        self.description: Mapping[str, Joint] = {}
        """The joints of the robot's description by name, set by the manager."""
        self.enable_status = EnableStatus()
        """Which interfaces follow commands and why others do not, set by the manager."""
        self.cycle_rate = 100
        """How often the cycle runs, in Hz, set by the manager."""
        self.notices: list[ControllerEvent] = []
        """What it has told; once it is loaded it is the manager's list, in which all tell."""

    # ----------------------------------------------------------------------------------------------------- hooks

    def on_configure(self, params: Params) -> None:
        """Read the parameters; ConfigError with all mistakes."""
        self.update_rate = params.read(self.reads).update_rate

    def on_set(self, params: Params) -> None:
        """Apply changed `settable` parameters, in any state; ConfigError without any change if they are invalid.

        An override reads all of them, as `on_configure` does, before it changes anything.
        """

    def command_interface_names(self) -> list[str]:
        """Return the command interfaces to claim on activation, as "joint/interface"."""
        return []

    def state_interface_names(self) -> list[str]:
        """Return the state interfaces to read, as "joint/interface"; `[ALL_STATES]` stands for all of them."""
        return []

    def reference_interfaces(self) -> Sequence[CommandInterface]:
        """Return the references that another controller may command instead of a topic (chaining).

        Always the same objects.
        """
        return ()

    def exported_states(self) -> Sequence[StateInterface]:
        """Return the states that other controllers may read, nan while inactive; always the same objects."""
        return ()

    def on_activate(self, commands: list[CommandInterface], states: list[StateInterface], now: int) -> None:
        """Store the interfaces; `now` in ns. An override calls this first."""
        del now
        self.commands, self.states = commands, states

    def on_deactivate(self, now: int) -> None:
        """Stop: every velocity, effort and acceleration target becomes 0.0."""
        del now
        zero_targets(self.commands)

    def forget(self, now: int) -> None:
        """Clear the command: moving targets become 0.0, positions are held at the present position."""
        self.on_deactivate(now)
        for command in self.commands:
            if command.quantity == POSITION:
                command.value = math.nan  # the hardware holds where it is, and does not go on to the old target
        self.on_activate(self.commands, self.states, now)

    def forget_some(self, commands: Sequence[CommandInterface], now: int) -> None:
        """Clear the commands of some interfaces; of all, unless the controller is `independent`."""
        del commands
        self.forget(now)

    def on_cleanup(self) -> None:
        """Clear the configuration."""

    def update(self, now: int, period: float) -> ReturnType:
        """Execute one step in the cycle; `now` in ns, `period` since its last step in s."""
        del now, period
        return OK

    def sample(self, wall_offset_ns: int) -> ControllerSample | None:
        """Return the last publication, of type `tells`; None before the first one.

        `wall_offset_ns` converts its stamps to Unix time. It is called between two cycles, any number of times, and
        changes nothing: it returns the results of `update`.
        """
        del wall_offset_ns
        return None

    def wheel_base(self) -> DriveGeometry | None:
        """Return the assumed wheel geometry, once configured; None for a controller without wheels."""
        return None

    def dead_reckoning(self, ahead: float) -> tuple[float, float, float] | None:  # noqa: ARG002 - of a base
        """Return the pose by odometry in `ahead` s, as x and y in m and heading in rad; None without odometry."""
        return None

    def is_standstill(self, values: Sequence[float]) -> bool:
        """Return whether a command with these values is standstill, which may outlive its client."""
        return not any(values) and all(command.quantity in MOVING for command in self.commands)

    # ------------------------------------------------------------------------------------------------ for overrides

    def published(self, wall_offset_ns: int) -> float:
        """Return the time of the last publication in Unix s: the `time` of its sample."""
        return (self.stamp + wall_offset_ns) / 1e9

    def refusal(self, reason: str) -> ControlError:
        """Count a refused command and return its error."""
        self.rejected += 1
        return ControlError(f"{self.name} {reason}")

    def checked(self, values: Sequence[object], names: Sequence[str]) -> None:
        """Raise ControlError unless there is a finite number for each name and the controller is active."""
        if self.state is not ControllerState.ACTIVE:
            raise self.refusal(f"is {self.state.value}; activate it before commanding it")
        if len(values) != len(names):
            raise self.refusal(
                f"takes {len(names)} values ({', '.join(names)}), got {len(values)}; nothing was applied"
            )
        for name, value in zip(names, values, strict=True):
            if not _finite(value):
                raise self.refusal(f"takes finite numbers, got {value!r} for {name}; nothing was applied")

    @property
    def describe_stop(self) -> str:
        """Return the state of its joints after the end of a command, as a clause."""
        stands = all(command.quantity in MOVING for command in self.commands)
        return "its targets are 0" if stands else "what moves is stopped, positions are held where they are"

    def refuse_out_of_range(self, commands: Sequence[CommandInterface], value: float, now: int) -> None:
        """Refuse a value that is out of range for an object behind these interfaces; the previous command ends."""
        for command in commands:
            fits = command.range_error(value)
            if fits is not None:
                self.forget(now)
                raise self.refusal(
                    f"cannot send {value:g}: {fits}; velocity and effort targets are 0, positions are held"
                )

    def report(self, kind: str, text: str) -> None:
        """Report an event; the manager's events() returns it."""
        self.notices.append(ControllerEvent(kind, self.name, f"{self.name}: {text}"))

    def tell(self, kind: str, text: str) -> None:
        """Report an event; the name of `report` up to version 0.2."""
        self.report(kind, text)


def _finite(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
