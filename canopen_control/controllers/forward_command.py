"""Forward command controllers: a list of numbers for a list of command interfaces.

Rules (ros2_controllers jazzy): `~/commands` carries one number per interface, in the order of the
parameters; before the first command nothing is written. Safer than upstream: a bad command is refused instead of
stopping the controller, and a velocity or effort target becomes 0.0 when the last valid command is older than
`command_timeout` (s; absent 2 s, 0 never, see `command_timeout`), reported once; a position target is held. The next
command takes over again.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, ClassVar

from canopen_control.controllers.base import Controller, zero_targets
from canopen_control.controllers.command_timeout import ENDLESS, MOVING, timeout_ns, unlimited_warning
from canopen_control.controllers.params import ForwardParams, GroupParams, MultiParams, SingleParams
from canopen_control.errors import RobotConfigError
from canopen_control.hardware.interfaces import OK, TARGET, ReturnType
from canopen_control.urdf.joint_element import EFFORT, POSITION, VELOCITY

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.controllers.params import CommonParams, Params
    from canopen_control.hardware.interfaces import CommandInterface, StateInterface


class ForwardCommandController(Controller):
    """Forwards numbers to one interface of several joints."""

    title: ClassVar[str] = "Forward command: all joints of one interface"
    independent: ClassVar[bool] = True
    topic: ClassVar[str | None] = "commands"
    settable: ClassVar[tuple[str, ...]] = ("command_timeout",)
    reads: ClassVar[type[GroupParams | SingleParams | MultiParams]] = ForwardParams
    renames: ClassVar[dict[str, str]] = {}

    def __init__(self, name: str, type_name: str = "") -> None:
        super().__init__(name, type_name)
        self._names: tuple[str, ...] = ()
        self._values: list[float] = []
        self._timed_out = False

    @property
    def timed_out(self) -> bool:
        """Whether the targets are zero because of a timeout."""
        return self._timed_out

    def on_configure(self, params: Params) -> None:
        """Read joints, interface_name and command_timeout; an empty list or a duplicate is an error."""
        settings = params.read(ForwardParams)
        if not settings.interface_name:
            raise RobotConfigError(_missing(self.name, "interface_name", "velocity"))
        self._set_up(settings, settings.joints, settings.interface_name, settings.command_timeout)

    def on_set(self, params: Params) -> None:
        """Apply another command_timeout, also to the present command."""
        interfaces = [name.rpartition("/")[2] for name in self._names]
        self._set_life(params.read(self.reads, self.renames).command_timeout, interfaces)

    def command_interface_names(self) -> list[str]:
        """Return one interface per value, in the order of the values."""
        return list(self._names)

    def on_activate(self, commands: list[CommandInterface], states: list[StateInterface], now: int) -> None:
        """Store the interfaces; earlier commands are discarded."""
        super().on_activate(commands, states, now)
        self._timed_out = False
        self.life.end()
        self._values = [math.nan] * len(commands)

    def set_command(self, values: Sequence[float], now: int, stamp: int | None = None) -> None:
        """Store one finite number per interface, or refuse all; `now` in ns restarts the timeout."""
        del stamp  # Float64MultiArray has none
        self.checked(values, self._names)
        for command, value in zip(self.commands, values, strict=True):
            self.refuse_out_of_range((command,), float(value), now)
        for index, command in enumerate(self.commands):  # what is off keeps nothing for when it is on
            self._values[index] = float(values[index]) if command.enabled else math.nan
        self._timed_out = False
        self.life.give(now)

    def forget_some(self, commands: Sequence[CommandInterface], now: int) -> None:
        """Stop some joints; the others continue."""
        del now
        zero_targets(commands)
        for index, command in enumerate(self.commands):
            if command in commands:
                self._values[index] = math.nan
                if command.quantity == POSITION:
                    command.value = math.nan

    def update(self, now: int, period: float) -> ReturnType:
        """Write the targets."""
        del period
        life = self.life
        if not life.live:
            return OK
        if life.limit_ns and now - life.given > life.limit_ns and self._runs_out(now):
            self._stop(now)
            return OK
        index, values = 0, self._values
        for command in self.commands:
            command.value = values[index]
            index += 1  # noqa: SIM113 - enumerate makes a tuple per joint in the cycle
        return OK

    def _runs_out(self, now: int) -> bool:
        """Whether the command expires now."""
        return self.life.runs_out(now)

    def _stop(self, now: int) -> None:
        self._timed_out = True
        zero_targets(self.commands)
        outcome = "position targets are held" if self.interface == POSITION else "targets are 0"
        self.report(
            "command_timeout", f"no command for {(now - self.life.given) / 1e9:.2f} s, {outcome} until the next one"
        )

    def _set_up(
        self,
        common: CommonParams,
        joints: tuple[str, ...],
        interface: str,
        timeout: float | None,
        parameter: str = "joints",
    ) -> None:
        if not joints:
            raise RobotConfigError(_missing(self.name, parameter, "[left_wheel_joint, right_wheel_joint]"))
        if len(set(joints)) != len(joints):
            raise RobotConfigError(f"{self.name}: {parameter} names one twice: {', '.join(joints)}; name each once")
        self.joints, self.interface, self.update_rate = joints, interface, common.update_rate
        self._names = tuple(f"{joint}/{interface}" for joint in joints)
        self._set_life(timeout, (interface,))

    def _set_life(self, timeout: float | None, interfaces: Sequence[str]) -> None:
        self.life.limit_ns = timeout_ns(timeout, interfaces)
        if (text := unlimited_warning("command_timeout", timeout, interfaces)) is not None:
            self.report(ENDLESS, text)


class MultiInterfaceForwardCommandController(ForwardCommandController):
    """Forwards numbers to several interfaces of one joint."""

    title: ClassVar[str] = "Several interfaces of one joint"
    reads: ClassVar[type[GroupParams | SingleParams | MultiParams]] = MultiParams

    def on_configure(self, params: Params) -> None:
        """Read joint, interface_names and command_timeout."""
        settings = params.read(MultiParams)
        if not settings.joint:
            raise RobotConfigError(_missing(self.name, "joint", "left_wheel_joint"))
        self._set_up(settings, settings.interface_names, "", settings.command_timeout, "interface_names")
        self._set_life(settings.command_timeout, settings.interface_names)
        self.joints, self.interface = (settings.joint,), ", ".join(settings.interface_names)
        self._names = tuple(f"{settings.joint}/{interface}" for interface in settings.interface_names)


class _JointGroupController(ForwardCommandController):
    """Forward command controller with the interface of its type."""

    title: ClassVar[str] = "Group controllers: the interface is the type's"
    fixed_interface = VELOCITY
    reads: ClassVar[type[GroupParams | SingleParams | MultiParams]] = GroupParams

    def on_configure(self, params: Params) -> None:
        """Read joints and command_timeout."""
        settings = params.read(GroupParams)
        self._set_up(settings, settings.joints, self.fixed_interface, settings.command_timeout)


class JointGroupVelocityController(_JointGroupController):
    """velocity_controllers/JointGroupVelocityController."""


class JointGroupPositionController(_JointGroupController):
    """position_controllers/JointGroupPositionController."""

    fixed_interface = POSITION


class JointGroupEffortController(_JointGroupController):
    """effort_controllers/JointGroupEffortController."""

    fixed_interface = EFFORT


_GAINS = ("p", "i", "d", "i_clamp", "i_clamp_min", "i_clamp_max", "antiwindup")


class _JointController(ForwardCommandController):
    """ROS 1 controller of one joint, with the interface of its type."""

    title: ClassVar[str] = "One joint, as in ROS 1"
    fixed_interface = VELOCITY
    reads: ClassVar[type[GroupParams | SingleParams | MultiParams]] = SingleParams
    renames: ClassVar[dict[str, str]] = {f"pid.{gain}": "" for gain in _GAINS}

    def on_configure(self, params: Params) -> None:
        """Read joint and command_timeout."""
        settings = params.read(SingleParams, self.renames)
        if not settings.joint:
            raise RobotConfigError(_missing(self.name, "joint", "left_wheel_joint"))
        self._set_up(settings, (settings.joint,), self.fixed_interface, settings.command_timeout)


class JointVelocityController(_JointController):
    """velocity_controllers/JointVelocityController."""


class JointPositionController(_JointController):
    """position_controllers/JointPositionController."""

    fixed_interface = POSITION


class JointEffortController(_JointController):
    """effort_controllers/JointEffortController."""

    fixed_interface = EFFORT


def _missing(name: str, key: str, example: str) -> str:
    return f"{name}: no {key!r}; give it under {name}: ros__parameters: {key}: {example}"


# TargetController: one number for one joint, in whatever mode of operation its drive is.
#
# Rules (ros2_canopen's `target` service, made safe): the quantity follows the mode, which a user selects by `axis mode`
# or the services of the node: a position, a velocity or an effort, in SI units. A position is a final position: it has
# no timeout, but ends with its client. A velocity or effort ends after `command_timeout` (s; absent 2 s, 0 never, see
# `command_timeout`). A target is cleared at every change of the mode, which changes its quantity, and whenever the
# drive is no longer enabled; activating the controller enables nothing.


TYPE = "canopen_control/TargetController"


class TargetController(ForwardCommandController):
    """Controller that forwards one number to interface `target` of a joint; `interface` is its present quantity."""

    title: ClassVar[str] = "One drive in whatever mode it is"
    reads: ClassVar[type[GroupParams | SingleParams | MultiParams]] = SingleParams
    topic: ClassVar[str | None] = TARGET

    def on_configure(self, params: Params) -> None:
        """Read joint and command_timeout."""
        settings = params.read(SingleParams)
        if not settings.joint:
            raise RobotConfigError(f"{self.name}: no 'joint'; give it under {self.name}: ros__parameters: joint: NAME")
        self._set_up(settings, (settings.joint,), TARGET, None)
        self._set_life(settings.command_timeout, tuple(MOVING))

    def set_command(self, values: Sequence[float], now: int, stamp: int | None = None) -> None:
        """Store one finite number if the drive's mode has a target; `now` in ns restarts the timeout."""
        if self.commands and self.commands[0].quantity == TARGET:
            joint = self.joints[0]
            how = f"canopen-control axis mode {joint} PV"
            raise self.refusal(f"has no target yet: {joint} is in no mode that takes one; ask for one: {how}")
        super().set_command(values, now, stamp)

    def update(self, now: int, period: float) -> ReturnType:
        """Write the target."""
        self.interface = self.commands[0].quantity
        return super().update(now, period)

    def _runs_out(self, now: int) -> bool:
        """Whether a velocity or effort expires now; positions do not expire."""
        return self.commands[0].quantity in MOVING and super()._runs_out(now)
