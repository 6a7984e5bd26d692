"""Forward command controllers, which write a list of numbers to a list of command interfaces.

Rules (ros2_controllers jazzy): `~/commands` has one number per interface, in the order of the parameters; nothing is
written before the first command. Safer than upstream: a bad command is refused instead of stopping the controller, and
a velocity or effort target becomes 0.0 when the last valid command is older than `command_timeout` (in s; 2 s if
absent, unlimited if 0, see `command_timeout`), which is reported once; a position target is held. The next command is
accepted as usual.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, ClassVar

from canopen_control.controllers.base import Controller, zero_targets
from canopen_control.controllers.command_timeout import MOVING, UNLIMITED, timeout_ns, timeout_warning
from canopen_control.controllers.params import ForwardParams, GroupParams, MultiParams, SingleParams, refuse, repeated
from canopen_control.errors import RobotConfigError
from canopen_control.hardware.interfaces import OK, TARGET, ReturnType
from canopen_control.urdf.joint_element import EFFORT, POSITION, VELOCITY

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.controllers.params import CommonParams, Params
    from canopen_control.hardware.interfaces import CommandInterface, StateInterface


class ForwardCommandController(Controller):
    """Controller that forwards a list of numbers to the same interface of several joints."""

    title: ClassVar[str] = "Forward command: one interface of several joints"
    independent: ClassVar[bool] = True
    topic: ClassVar[str | None] = "commands"
    settable: ClassVar[tuple[str, ...]] = ("command_timeout",)
    reads: ClassVar[type[GroupParams | SingleParams | MultiParams]] = ForwardParams
    renames: ClassVar[dict[str, str]] = {}

    def __init__(self, name: str, type_name: str = "") -> None:
        super().__init__(name, type_name)
        self._names: tuple[str, ...] = ()
        self._values: list[float] = []

    def on_configure(self, params: Params) -> None:
        settings = params.read(ForwardParams)
        if not settings.interface_name:
            refuse(params, [_missing(self.name, "interface_name", "velocity")], self.name)
        self._set_up(params, settings, settings.joints, settings.interface_name, settings.command_timeout)

    def on_set(self, params: Params) -> None:
        interfaces = [name.rpartition("/")[2] for name in self._names]
        self._set_timeout(params.read(self.reads, self.renames).command_timeout, interfaces)

    def command_interface_names(self) -> list[str]:
        return list(self._names)

    def on_activate(self, commands: list[CommandInterface], states: list[StateInterface], now: int) -> None:
        super().on_activate(commands, states, now)
        self.command_timeout.end()
        self._values = [math.nan] * len(commands)

    def set_command(self, values: Sequence[float], now: int, stamp: int | None = None) -> None:
        del stamp  # Float64MultiArray has no stamp
        self.checked(values, self._names)
        for command, value in zip(self.commands, values, strict=True):
            self.refuse_out_of_range((command,), float(value), now)
        for index, command in enumerate(self.commands):  # a disabled drive keeps no command for later
            self._values[index] = float(values[index]) if command.enabled else math.nan
        self.command_timeout.start(now)

    def forget_some(self, commands: Sequence[CommandInterface], now: int) -> None:
        del now
        zero_targets(commands)
        for index, command in enumerate(self.commands):
            if command in commands:
                self._values[index] = math.nan
                if command.quantity == POSITION:
                    command.value = math.nan

    def update(self, now: int, period: float) -> ReturnType:
        del period
        timeout = self.command_timeout
        if not timeout.live:
            return OK
        if timeout.limit_ns and now - timeout.created > timeout.limit_ns and self._expire(now):
            self._stop(now)
            return OK
        index, values = 0, self._values
        for command in self.commands:
            command.value = values[index]
            index += 1  # noqa: SIM113 - enumerate makes a tuple per joint in the cycle
        return OK

    def _expire(self, now: int) -> bool:
        return self.command_timeout.expire(now)

    def _stop(self, now: int) -> None:
        zero_targets(self.commands)
        outcome = "position targets are held" if self.interface == POSITION else "targets are 0"
        self.report(
            "command_timeout",
            f"no command for {(now - self.command_timeout.created) / 1e9:.2f} s, {outcome} until the next command",
        )

    def _set_up(
        self,
        params: Params,
        common: CommonParams,
        joints: tuple[str, ...],
        interface: str,
        timeout: float | None,
        parameter: str = "joints",
    ) -> None:
        if not joints:
            refuse(params, [_missing(self.name, parameter, "[left_wheel_joint, right_wheel_joint]")], self.name)
        refuse(params, repeated(parameter, joints), self.name)
        self.joints, self.interface, self.update_rate = joints, interface, common.update_rate
        self._names = tuple(f"{joint}/{interface}" for joint in joints)
        self._set_timeout(timeout, (interface,))

    def _set_timeout(self, timeout: float | None, interfaces: Sequence[str]) -> None:
        self.command_timeout.limit_ns = timeout_ns(timeout, interfaces)
        if (text := timeout_warning("command_timeout", timeout, interfaces)) is not None:
            self.report(UNLIMITED, text)


class MultiInterfaceForwardCommandController(ForwardCommandController):
    """Controller that forwards a list of numbers to several interfaces of one joint."""

    title: ClassVar[str] = "Several interfaces of one joint"
    reads: ClassVar[type[GroupParams | SingleParams | MultiParams]] = MultiParams

    def on_configure(self, params: Params) -> None:
        settings = params.read(MultiParams)
        if not settings.joint:
            refuse(params, [_missing(self.name, "joint", "left_wheel_joint")], self.name)
        self._set_up(params, settings, settings.interface_names, "", settings.command_timeout, "interface_names")
        self._set_timeout(settings.command_timeout, settings.interface_names)
        self.joints, self.interface = (settings.joint,), ", ".join(settings.interface_names)
        self._names = tuple(f"{settings.joint}/{interface}" for interface in settings.interface_names)


class _JointGroupController(ForwardCommandController):
    """Base class of forward command controllers whose type determines the interface."""

    title: ClassVar[str] = "Group controllers: the name of the type contains the interface"
    fixed_interface = VELOCITY
    reads: ClassVar[type[GroupParams | SingleParams | MultiParams]] = GroupParams

    def on_configure(self, params: Params) -> None:
        settings = params.read(GroupParams)
        self._set_up(params, settings, settings.joints, self.fixed_interface, settings.command_timeout)


class JointGroupVelocityController(_JointGroupController):
    """Controller that forwards velocities to several joints (velocity_controllers)."""


class JointGroupPositionController(_JointGroupController):
    """Controller that forwards positions to several joints (position_controllers)."""

    fixed_interface = POSITION


class JointGroupEffortController(_JointGroupController):
    """Controller that forwards efforts to several joints (effort_controllers)."""

    fixed_interface = EFFORT


_GAINS = ("p", "i", "d", "i_clamp", "i_clamp_min", "i_clamp_max", "antiwindup")


class _JointController(ForwardCommandController):
    """Base class of the ROS 1 controllers of one joint; the type determines the interface."""

    title: ClassVar[str] = "One joint, as in ROS 1"
    fixed_interface = VELOCITY
    reads: ClassVar[type[GroupParams | SingleParams | MultiParams]] = SingleParams
    renames: ClassVar[dict[str, str]] = {f"pid.{gain}": "" for gain in _GAINS}

    def on_configure(self, params: Params) -> None:
        settings = params.read(SingleParams, self.renames)
        if not settings.joint:
            refuse(params, [_missing(self.name, "joint", "left_wheel_joint")], self.name)
        self._set_up(params, settings, (settings.joint,), self.fixed_interface, settings.command_timeout)


class JointVelocityController(_JointController):
    """Controller that forwards a velocity to one joint (velocity_controllers of ROS 1)."""


class JointPositionController(_JointController):
    """Controller that forwards a position to one joint (position_controllers of ROS 1)."""

    fixed_interface = POSITION


class JointEffortController(_JointController):
    """Controller that forwards an effort to one joint (effort_controllers of ROS 1)."""

    fixed_interface = EFFORT


def _missing(name: str, key: str, example: str) -> str:
    return f"no {key!r}; give it under {name}: ros__parameters: {key}: {example}"


# TargetController: one number for one joint, as the quantity of the current mode of operation of the drive.
#
# Rules (ros2_canopen's `target` service, made safe): the mode, which a user selects by `axis mode` or the services of
# the node, determines the quantity of the target: a position, a velocity or an effort, in SI units. A position is a
# final position: it has no timeout, but ends with its client. A velocity or effort ends after `command_timeout` (in s;
# 2 s if absent, unlimited if 0, see `command_timeout`). A target is cleared at every change of the mode, because the
# quantity changes, and when the drive is disabled; activating the controller does not enable the drive.


TYPE = "canopen_control/TargetController"


class TargetController(ForwardCommandController):
    """Controller that forwards one number to the command interface `target` of a joint.

    `interface` is the quantity of the drive's current mode of operation.
    """

    title: ClassVar[str] = "One drive in any mode"
    reads: ClassVar[type[GroupParams | SingleParams | MultiParams]] = SingleParams
    topic: ClassVar[str | None] = TARGET

    def on_configure(self, params: Params) -> None:
        settings = params.read(SingleParams)
        if not settings.joint:
            raise RobotConfigError(f"{self.name}: no 'joint'; give it under {self.name}: ros__parameters: joint: NAME")
        self._set_up(params, settings, (settings.joint,), TARGET, None)
        self._set_timeout(settings.command_timeout, tuple(MOVING))

    def set_command(self, values: Sequence[float], now: int, stamp: int | None = None) -> None:
        if self.commands and self.commands[0].quantity == TARGET:
            joint = self.joints[0]
            how = f"canopen-control axis mode {joint} PV"
            raise self.refusal(f"has no target, because {joint} is not in a mode with a target; select one: {how}")
        super().set_command(values, now, stamp)

    def update(self, now: int, period: float) -> ReturnType:
        self.interface = self.commands[0].quantity
        return super().update(now, period)

    def _expire(self, now: int) -> bool:
        return self.commands[0].quantity in MOVING and super()._expire(now)
