"""Base class of all controllers, and the types that controllers share.

A controller only reads and writes `value` of the interfaces it received at activation; it reads no clock, sends nothing
and never blocks. A command that is not finite or has the wrong size is refused with a ControlError and counted: it is
not applied and does not restart the timeout. On every deactivation the velocity, effort and acceleration targets become
0.0 (upstream leaves them unchanged, so that a wheel would keep turning); position targets stay. A command has a timeout
(`command_timeout`) and is cleared when a drive behind the controller is no longer enabled.

A new controller is a class in this or any other package: derive from `Controller`, and register the class in the entry
point group `canopen_control.controllers` with its type as the name: `"my_robot/Dance" = "my_robot.dance:Dance"`.
"""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Final, Protocol

from mypy_extensions import mypyc_attr

from canopen_control.controllers.command_timeout import MOVING, CommandTimeout
from canopen_control.controllers.params import CommonParams
from canopen_control.errors import ControlError, NotEnabled, WrongValueCount
from canopen_control.hardware.interfaces import OK, ReturnType
from canopen_control.urdf.joint_element import POSITION

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from canopen_control.controllers.params import Params
    from canopen_control.hardware.interfaces import CommandInterface, StateInterface
    from canopen_control.rpc.messages.samples import ControllerSample, Sample, Values
    from canopen_control.urdf.joint_element import Joint

    Interfaces = tuple[CommandInterface, ...]


def finite(value: float) -> float | None:
    """Return `value`, or None if it is nan or infinite."""
    return value if math.isfinite(value) else None


class StateCopy:
    """Snapshot of selected state interface values, from which a broadcaster builds its samples.

    `layout` maps each joint to its interface names, and each name to the source of its value; None means 0.0.
    """

    def __init__(self, layout: Mapping[str, Mapping[str, StateInterface | None]]) -> None:
        places = [(joint, name, source) for joint, names in layout.items() for name, source in names.items()]
        self._places = [(joint, name) for joint, name, _ in places]
        self._values = [0.0] * len(places)
        self._sources = [(index, source) for index, (_, _, source) in enumerate(places) if source is not None]
        self._joints = list(layout)
        self.refresh()

    @property
    def joints(self) -> list[str]:
        return list(self._joints)

    def refresh(self) -> None:
        """Copy the current state values, without allocating memory."""
        values = self._values
        for index, source in self._sources:
            values[index] = source.value

    def by_joint(self) -> dict[str, Values]:
        """Return the copied values by joint and interface name; None for values that are not finite."""
        values_by_joint: dict[str, Values] = {joint: {} for joint in self._joints}
        for (joint, name), value in zip(self._places, self._values, strict=True):
            values_by_joint[joint][name] = finite(value)
        return values_by_joint


ALL_STATES: Final = "*"
"""Name that, as the only state interface name, selects every state interface of the robot."""


class WheelGeometrySource(Protocol):
    """Source of wheel dimensions in m from the robot description; None means unknown."""

    def separation(self, left: Sequence[str], right: Sequence[str]) -> float | None:
        """Return the distance in m between the left and right wheel joints, or None if unknown."""
        ...

    def radius(self, wheels: Sequence[str]) -> float | None:
        """Return the common radius in m of the wheels at these joints, or None if unknown."""
        ...


@dataclass(frozen=True, slots=True)
class DriveGeometry:
    """Wheel geometry and frame names from a base controller's parameters, which `check` compares with the URDF.

    Lengths are in m, and a separation of 0 means unknown; `radius_key` and `separation_key` are the parameters that set
    them. `frozen` are the twist axes whose limits keep the speed constant.
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
    """Lifecycle states of a controller, named like those of a managed node in ROS 2."""

    UNCONFIGURED = "unconfigured"
    INACTIVE = "inactive"
    ACTIVE = "active"
    FINALIZED = "finalized"


def zero_targets(commands: Sequence[CommandInterface]) -> None:
    """Set velocity, effort and acceleration targets to 0.0; leave position targets unchanged."""
    for command in commands:
        if command.quantity in MOVING:
            command.value = 0.0


def is_moving(commands: Sequence[CommandInterface]) -> bool:
    """Whether any command is finite and not 0.0, so that it may cause motion."""
    return any(command.value != 0.0 and math.isfinite(command.value) for command in commands)


@mypyc_attr(allow_interpreted_subclasses=True)
class EnableStatus:
    """Enable status of command interfaces; this default is for interfaces without drives.

    It explains why interfaces do not follow commands, and groups the interfaces that stop together. For drives see
    `runtime.enable_status.DriveEnableStatus`.
    """

    def error(self, waiting: Sequence[CommandInterface]) -> NotEnabled:
        """Return the error for a command to interfaces that are not enabled."""
        return NotEnabled(f"{joint_names(waiting)}: not enabled, so commands are refused")

    def reason(self, waiting: Sequence[CommandInterface]) -> str:
        """Return a message that names the joints that are not enabled, and the remedy."""
        return f"{joint_names(waiting)}: not enabled; enable it"

    def idle(self, waiting: Sequence[CommandInterface]) -> dict[str, str]:
        """Return, for each joint, why it does not follow a command that other joints follow, and the remedy."""
        return {interface.joint: "not enabled; enable it" for interface in waiting}

    def stop_groups(self, interfaces: Interfaces) -> Sequence[Interfaces]:
        """Return the command interfaces as stop groups; by default, one group contains all of them."""
        return (interfaces,)


def joint_names(interfaces: Sequence[CommandInterface]) -> str:
    """Return the joint names of the interfaces, comma-separated and without duplicates."""
    return ", ".join(dict.fromkeys(interface.joint for interface in interfaces))


@dataclass(frozen=True, slots=True)
class ControllerEvent:
    """Event of a controller, with a text for the user.

    `kind` is a short name such as activated, error or command_timeout; some kinds are specific to a controller type.
    """

    kind: str
    controller: str
    text: str


def twist_axes_of(controller: Controller) -> tuple[str, ...]:
    """Return the twist axes that a controller accepts, such as "linear.x".

    A controller that declares none accepts linear.x and angular.z if its topic is cmd_vel, else nothing.
    """
    return controller.twist_axes or (("linear.x", "angular.z") if controller.topic == "cmd_vel" else ())


def sample_type_of(controller: Controller) -> type[Sample] | None:
    """Return the type of a controller's samples, or None if it publishes none."""
    return controller.sample_type or controller.tells


@mypyc_attr(allow_interpreted_subclasses=True)
class Controller:
    """Base class of all controllers; without overrides it claims no interfaces and computes nothing.

    - `commands`, `states`: the interfaces while the controller is active, in the order of `command_interface_names` and
      `state_interface_names`.
    - `rejected`: number of refused commands.
    - `command_timeout`: timeout of the command.
    - `topic`: name of the ROS topic for commands, or None.
    - `publishes`: topics of joint states for ROS, relative to the robot's namespace; `frame_id` is their frame.
    - `sample_type`: type of the published samples, or None.
    - `publish_rate`: publication rate in Hz; 0 publishes at every update. `stamp` is the time of the last publication
      in ns.
    """

    title: ClassVar[str] = ""
    """Heading of the parameters in the documentation; types with the same heading are described together."""
    reads: ClassVar[type[CommonParams]] = CommonParams
    """Dataclass of the parameters, with their help texts."""
    sections: ClassVar[dict[str, type[object]]] = {}
    """Dataclasses of nested parameters, by their heading in the documentation."""
    is_broadcaster: ClassVar[bool] = False
    is_base: ClassVar[bool] = False
    """Whether the joints move one vehicle base: they stop together, and no CLI command moves one of them alone."""
    moves_joints: ClassVar[bool] = True
    """Whether the controller moves joints; others, such as broadcasters, run in parallel."""
    twist_axes: ClassVar[tuple[str, ...]] = ()
    """Twist axes that a base accepts, such as "linear.x"; empty if the controller accepts joint values."""
    independent: ClassVar[bool] = False
    """Whether every interface has its own command, so that one stop group can stop while the others continue."""
    settable: ClassVar[tuple[str, ...]] = ()
    """Patterns of the parameters that `on_set` accepts after configuration, as dotted names (`gains.*`)."""
    topic: ClassVar[str | None] = None
    sample_type: ClassVar[type[Sample] | None] = None
    tells: ClassVar[type[Sample] | None] = None
    """Deprecated name of `sample_type`, used up to version 0.2."""
    roller_wheels: ClassVar[tuple[str, ...]] = ()
    """Parameters that name the joints of mecanum wheels, whose rollers the physics simulation models."""
    offers: ClassVar[tuple[str, ...]] = ()
    """Features besides commands, by the constants of `rpc.messages.state`: action goals, services, calibration."""

    def __init__(self, name: str, type_name: str = "") -> None:
        self.name, self.type = name, type_name
        self.state = ControllerState.UNCONFIGURED
        self.update_rate = 0
        self.publish_rate = 0.0
        self.rejected = 0
        self.command_timeout = CommandTimeout()
        self.publishes: tuple[str, ...] = ()
        self.frame_id = ""
        self.joints: tuple[str, ...] = ()
        self.interface: str | None = None
        self.stamp = 0
        self.commands: list[CommandInterface] = []
        self.states: list[StateInterface] = []
        self.description_joints: tuple[str, ...] | None = None
        """Movable joints of the robot description, set by the manager; None without a description."""
        self.geometry: WheelGeometrySource | None = None
        """Wheel dimensions of the robot description, set by the manager; None without a description."""
        self.description: Mapping[str, Joint] = {}
        """Joints of the robot description by name, set by the manager."""
        self.enable_status = EnableStatus()
        """Enable status of the command interfaces, set by the manager."""
        self.cycle_rate = 100
        """Rate of the control cycle in Hz, set by the manager."""
        self.notices: list[ControllerEvent] = []
        """Reported events; after loading, the list of the manager, which all controllers share."""

    # ----------------------------------------------------------------------------------------------------- hooks

    def on_configure(self, params: Params) -> None:
        """Read the parameters; raise ConfigError with all errors in them."""
        self.update_rate = params.read(self.reads).update_rate

    def on_set(self, params: Params) -> None:
        """Apply changed `settable` parameters in any state; raise ConfigError, with no change, for invalid values.

        An override reads all parameters, as `on_configure` does, before it changes anything.
        """

    def command_interface_names(self) -> list[str]:
        """Return the command interfaces to claim on activation, as "joint/interface"."""
        return []

    def state_interface_names(self) -> list[str]:
        """Return the state interfaces to read, as "joint/interface"; `[ALL_STATES]` selects every interface."""
        return []

    def reference_interfaces(self) -> Sequence[CommandInterface]:
        """Return the reference interfaces that another controller may command instead of a topic (chaining).

        Every call returns the same objects.
        """
        return ()

    def exported_states(self) -> Sequence[StateInterface]:
        """Return the state interfaces that other controllers may read; their values are nan while inactive.

        Every call returns the same objects.
        """
        return ()

    def on_activate(self, commands: list[CommandInterface], states: list[StateInterface], now: int) -> None:
        """Store the claimed interfaces; `now` is in ns. An override must call this method first."""
        del now
        self.commands, self.states = commands, states

    def on_deactivate(self, now: int) -> None:
        """Stop the joints: set every velocity, effort and acceleration target to 0.0."""
        del now
        zero_targets(self.commands)

    def forget(self, now: int) -> None:
        """Clear the command: zero velocity, effort and acceleration targets, and hold the actual position."""
        self.on_deactivate(now)
        for command in self.commands:
            if command.quantity == POSITION:
                command.value = math.nan  # the hardware holds the actual position instead of the old target
        self.on_activate(self.commands, self.states, now)

    def forget_some(self, commands: Sequence[CommandInterface], now: int) -> None:
        """Clear the commands of these interfaces, or of all if the controller is not `independent`."""
        del commands
        self.forget(now)

    def update(self, now: int, period: float) -> ReturnType:
        """Execute one control step; `now` is in ns, `period` is the time since the previous step in s."""
        del now, period
        return OK

    def sample(self, wall_offset_ns: int) -> ControllerSample | None:
        """Return the last published sample, of type `sample_type`; None before the first publication.

        `wall_offset_ns` converts the time stamps to Unix time. The method is called between two cycles, any number of
        times, and changes nothing: it returns the results of `update`.
        """
        del wall_offset_ns
        return None

    def wheel_base(self) -> DriveGeometry | None:
        """Return the wheel geometry that a configured controller assumes, or None if it moves no wheels."""
        return None

    def dead_reckoning(self, ahead: float) -> tuple[float, float, float] | None:  # noqa: ARG002 - of a base
        """Return the pose that the odometry predicts for `ahead` s from now, in m and rad; None without odometry."""
        return None

    def is_standstill(self, values: Sequence[float]) -> bool:
        """Whether a command with these values stops all motion; such a command may outlive its client."""
        return not any(values) and all(command.quantity in MOVING for command in self.commands)

    @property
    def brake_s(self) -> float:
        """Time in s to brake from the velocity limit by the controller's own deceleration; 0 if it does not ramp."""
        return 0.0

    def why_immobile(self, values: Sequence[float]) -> str | None:
        """Return why the limits of the controller permit none of the motions of a command, or None."""
        pairs = zip(self.commands, values, strict=False)
        moving = [command for command, value in pairs if value and command.quantity in MOVING]
        if not moving or any(command.minimum != 0.0 or command.maximum != 0.0 for command in moving):
            return None
        return f"min and max of the command interface {moving[0].name} are 0 in the description"

    # ------------------------------------------------------------------------------------------------ for overrides

    def published(self, wall_offset_ns: int) -> float:
        """Return the Unix time of the last publication in s, for the field `time` of a sample."""
        return (self.stamp + wall_offset_ns) / 1e9

    def refusal(self, reason: str, kind: type[ControlError] = ControlError) -> ControlError:
        """Count a refused command, and return the ControlError to raise, by default of the base class."""
        self.rejected += 1
        return kind(f"{self.name} {reason}")

    def checked(self, values: Sequence[object], names: Sequence[str]) -> None:
        """Raise ControlError unless the controller is active and `values` has one finite number for each name."""
        if self.state is not ControllerState.ACTIVE:
            raise self.refusal(f"is {self.state.value}; activate it before commanding it")
        if len(values) != len(names):
            raise self.refusal(
                f"expects {len(names)} values ({', '.join(names)}), got {len(values)}; nothing was applied",
                WrongValueCount,
            )
        for name, value in zip(names, values, strict=True):
            if not _finite(value):
                raise self.refusal(f"expects finite numbers, got {value!r} for {name}; nothing was applied")

    @property
    def describe_stop(self) -> str:
        """Clause for messages about the joints after the end of a command, such as "its targets are 0"."""
        are_zeroed = all(command.quantity in MOVING for command in self.commands)
        return "its targets are 0" if are_zeroed else "moving joints are stopped, positions are held"

    def refuse_out_of_range(self, commands: Sequence[CommandInterface], value: float, now: int) -> None:
        """Raise ControlError if a value is outside the range of the CANopen object behind any of these interfaces.

        A refused value also ends the previous command.
        """
        for command in commands:
            problem = command.range_error(value)
            if problem is not None:
                self.forget(now)
                raise self.refusal(
                    f"cannot send {value:g}: {problem}; velocity and effort targets are 0, positions are held"
                )

    def report(self, kind: str, text: str) -> None:
        """Report an event, which the manager returns from `events()`."""
        self.notices.append(ControllerEvent(kind, self.name, f"{self.name}: {text}"))

    def tell(self, kind: str, text: str) -> None:
        """Report an event; deprecated name of `report`, used up to version 0.2."""
        self.report(kind, text)


def _finite(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
