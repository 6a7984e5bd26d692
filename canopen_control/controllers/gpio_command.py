"""Controllers for devices other than joints: GpioCommandController, and the services of one CANopen node or drive.

Rules (gpio_controllers, Jazzy): a command sets some of the command interfaces, the others keep their values; the
commanded values are written again in every update, nothing before the first command; without command interfaces the
controller only publishes states. Safer than upstream: a command with an unknown name or a value that is not finite is
refused as a whole. When commands end (deactivation, stop, disconnected client, `command_timeout`), each commanded
output changes to its safe value at once, which is that of the hardware unless the parameters set another; outputs
listed in `kept_outputs` do not change. The next command starts from these values. The commands to outputs of a lost
node end without affecting other nodes.

Rules of the services (canopen_ros2_controllers): the parameter is `joint`; topics and services have the controller's
name. Upstream passes each request through interfaces that a hardware component polls in its cycle. Here the controllers
claim no interfaces: they offer the services that every node of the bus has, with the same answers and safety checks.
They are therefore activated together with the controller that moves the joint, and work even while they are inactive.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Final

from canopen_control.controllers.base import ALL_STATES, Controller, ControllerState, StateCopy
from canopen_control.controllers.command_timeout import MOVING, UNLIMITED, timeout_ns, timeout_warning
from canopen_control.controllers.params import CommonParams, refuse, repeated
from canopen_control.errors import ControlError, RobotConfigError, UnknownName, nearest
from canopen_control.hardware.interfaces import OK, ReturnType
from canopen_control.rpc.messages.samples import GpioSample
from canopen_control.rpc.messages.state import DRIVE_SERVICES, NODE_SERVICES
from canopen_control.urdf.joint_element import POSITION
from canopen_control.yamlfile.convert import section, setting

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from canopen_control.controllers.params import Params
    from canopen_control.hardware.interfaces import CommandInterface, StateInterface
    from canopen_control.rpc.messages.samples import Sample


# The parameters of gpio_controllers/GpioCommandController of jazzy, and additional ones for the values after a command.


_LIST: Final = ".interfaces"


@dataclass(frozen=True)
class GpioParams(CommonParams):
    """Parameters of gpio_controllers/GpioCommandController, including safe values of outputs.

    `command_timeout` is in s; for its default and 0 see the module `command_timeout`. The keys of the interface lists
    are "<gpio>.interfaces", those of the safe values "<gpio>.<interface>"; `kept_outputs` are "<gpio>/<interface>".
    """

    gpios: tuple[str, ...] = setting((), help="names of `<gpio>` parts of the description")
    command_interfaces: dict[str, tuple[str, ...]] = section(
        "command_interfaces",
        help="`.GPIO.interfaces`: command interfaces, which are the outputs; none: the controller only publishes "
        "states",
    )
    state_interfaces: dict[str, tuple[str, ...]] = section(
        "state_interfaces",
        help="`.GPIO.interfaces`: state interfaces to publish; none: all state interfaces of the GPIO",
    )
    safe_values: dict[str, float] = section(
        "safe_values",
        help="`.GPIO.INTERFACE`: value of the output after commands have expired; absent: 0.0",
    )
    kept_outputs: tuple[str, ...] = setting(
        (), help="`GPIO/INTERFACE`: outputs that keep their values after commands have expired"
    )
    command_timeout: float | None = setting(
        None,
        low=0.0,
        high=1e9,
        help="time in s after which a command expires; absent: 2 for interfaces named velocity, effort or "
        "acceleration, else never; 0: never",
    )

    @property
    def outputs(self) -> list[str]:
        """Command interfaces, as "gpio/interface", in the order of the parameters."""
        return [
            f"{gpio}/{interface}" for gpio in self.gpios for interface in self.command_interfaces.get(gpio + _LIST, ())
        ]

    @property
    def inputs(self) -> list[str]:
        """Selected state interfaces, as "gpio/interface", in the order of the parameters."""
        return [
            f"{gpio}/{interface}" for gpio in self.gpios for interface in self.state_interfaces.get(gpio + _LIST, ())
        ]

    @property
    def unnamed_gpios(self) -> list[str]:
        """GPIOs without selected state interfaces; all their state interfaces are published."""
        return [gpio for gpio in self.gpios if not self.state_interfaces.get(gpio + _LIST)]

    def safe_value(self, output: str, hardware: float | None) -> float:
        """Return the value of an output after its commands have ended, by default `hardware` or 0.0; nan keeps it."""
        default = 0.0 if hardware is None else hardware
        return math.nan if output in self.kept_outputs else self.safe_values.get(_dotted(output), default)


def read_params(params: Params, name: str, joints: Sequence[str]) -> GpioParams:
    """Return the parameters of GPIO controller `name`; raise RobotConfigError with all errors in them.

    `joints` are the movable joints of the description, whose motion interfaces are not allowed as outputs.
    """
    settings = params.read(GpioParams)
    refuse(params, [*_of_names(settings), *_of_safe_values(settings), *_of_joints(settings, joints)], name)
    return settings


def _of_names(params: GpioParams) -> Iterator[str]:
    if not params.gpios:
        yield "no 'gpios'; give it under ros__parameters: gpios: [io]"
    yield from repeated("gpios", params.gpios)
    for key, lists in (
        ("command_interfaces", params.command_interfaces),
        ("state_interfaces", params.state_interfaces),
    ):
        for name, interfaces in lists.items():
            gpio = name.removesuffix(_LIST)
            if gpio not in params.gpios or gpio == name:
                yield f"{key}.{name} is not NAME{_LIST} of a GPIO in gpios{nearest(gpio, params.gpios)}"
            yield from repeated(f"{key}.{name}", interfaces)


def _of_safe_values(params: GpioParams) -> Iterator[str]:
    outputs = params.outputs
    dotted = [_dotted(output) for output in outputs]
    for name, value in params.safe_values.items():
        if name not in dotted:
            yield f"safe_values.{name} is not in command_interfaces{nearest(name, dotted)}"
        if not math.isfinite(value):
            yield f"safe_values.{name} is {value}; give a finite number"
    for name in params.kept_outputs:
        if name not in outputs:
            yield f"kept_outputs: {name!r} is not in command_interfaces{nearest(name, outputs)}"


def _of_joints(params: GpioParams, joints: Sequence[str]) -> Iterator[str]:
    for name in params.outputs:
        joint, _, interface = name.rpartition("/")
        if joint in joints and interface in (POSITION, *MOVING):
            yield f"{name} moves a joint and is not an output; command it with a forward command controller"


def _dotted(output: str) -> str:
    return output.replace("/", ".")


class GpioCommandController(Controller):
    """Controller that writes commanded values to outputs, and publishes inputs and outputs."""

    title: ClassVar[str] = "Outputs and inputs of `<gpio>` parts"
    reads: ClassVar[type[GpioParams]] = GpioParams
    moves_joints: ClassVar[bool] = False
    independent: ClassVar[bool] = True
    topic: ClassVar[str | None] = "gpio_commands"
    sample_type: ClassVar[type[Sample] | None] = GpioSample

    def __init__(self, name: str, type_name: str = "") -> None:
        super().__init__(name, type_name)
        self.params = GpioParams()
        self._names: list[str] = []
        self._safe: list[float] = []
        self._values: list[float] = []
        self._copy = StateCopy({})

    def on_configure(self, params: Params) -> None:
        settings = read_params(params, self.name, self.description_joints or ())
        self.params, self.update_rate, self.joints = settings, settings.update_rate, settings.gpios
        self._names = settings.outputs
        kinds = [name.rpartition("/")[2] for name in self._names]
        self.command_timeout.limit_ns = timeout_ns(settings.command_timeout, kinds)
        if (text := timeout_warning("command_timeout", settings.command_timeout, kinds)) is not None:
            self.report(UNLIMITED, text)

    def command_interface_names(self) -> list[str]:
        return list(self._names)

    def state_interface_names(self) -> list[str]:
        return [ALL_STATES] if self.params.unnamed_gpios else self.params.inputs

    def on_activate(self, commands: list[CommandInterface], states: list[StateInterface], now: int) -> None:
        super().on_activate(commands, states, now)
        input_names, whole_gpios = self.params.inputs, self.params.unnamed_gpios
        inputs = {state.name: state for state in states if state.name in input_names or state.joint in whole_gpios}
        if missing := [name for name in input_names if name not in inputs]:
            raise ControlError(f"{self.name}: state interface {missing[0]} does not exist{nearest(missing[0], inputs)}")
        commanded = {command.joint for command in commands}
        input_gpios = {state.joint for state in inputs.values()}
        if unknown := [gpio for gpio in whole_gpios if gpio not in commanded and gpio not in input_gpios]:
            raise ControlError(f"{self.name}: <gpio> {unknown[0]!r} has no interfaces; remove it")
        layout: dict[str, dict[str, StateInterface | None]] = {gpio: {} for gpio in self.params.gpios}
        for state in inputs.values():
            layout[state.joint][state.interface] = state
        self._copy, self.stamp = StateCopy(layout), now
        self._values = [math.nan] * len(commands)
        self._safe = [self.params.safe_value(command.name, command.safe) for command in commands]
        self.command_timeout.end()

    def on_deactivate(self, now: int) -> None:
        """Set the commanded outputs to their safe values, which are also the values after the release."""
        for command, safe in zip(self.commands, self._safe, strict=True):
            command.release_value = safe
        self.forget(now)

    def forget(self, now: int) -> None:
        self.command_timeout.end(self.command_timeout.ended_by)
        self.forget_some(self.commands, now)

    def forget_some(self, commands: Sequence[CommandInterface], now: int) -> None:
        """Set these outputs to their safe values; outputs without a command are unchanged."""
        del now
        index = 0
        for command in self.commands:
            if command in commands and not math.isnan(self._values[index]):
                if not math.isnan(self._safe[index]):
                    command.value = self._safe[index]
                self._values[index] = math.nan
            index += 1  # noqa: SIM113 - enumerate makes a tuple per output in the cycle

    def set_command(self, values: Sequence[float], now: int, stamp: int | None = None) -> None:
        del stamp
        self._refuse_unless_active()
        self.checked(values, self._names)
        self.set_named(dict(zip(self._names, values, strict=True)), now)

    def set_named(self, values: Mapping[str, float], now: int) -> None:
        self._refuse_unless_active()
        for name in values:
            if name not in self._names:
                text = f"has no output {name!r}{nearest(name, self._names)}; nothing was applied"
                raise self.refusal(text, UnknownName)
        self.checked(list(values.values()), list(values))
        places = [self._names.index(name) for name in values]
        for index, value in zip(places, values.values(), strict=True):
            output = self.commands[index]
            if not output.enabled:
                raise self.refusal(f"cannot set {output.name}, because its node is not present; nothing was applied")
            if (problem := output.range_error(value)) is not None:
                raise self.refusal(f"cannot set {value:g}: {problem}; nothing was applied")
        for index, value in zip(places, values.values(), strict=True):
            self._values[index] = float(value)
        self.command_timeout.start(now)

    def is_standstill(self, values: Sequence[float]) -> bool:
        """Whether no output would change when the commands end."""
        del values
        pairs = zip(self._values, self._safe, strict=True)
        return all(math.isnan(value) or math.isnan(safe) or value == safe for value, safe in pairs)

    @property
    def describe_stop(self) -> str:
        return "its outputs are at their safe values" + (
            ", kept_outputs are unchanged" if self.params.kept_outputs else ""
        )

    def update(self, now: int, period: float) -> ReturnType:
        del period
        if self.command_timeout.expire(now):
            self.report(
                "command_timeout",
                f"no command for {(now - self.command_timeout.created) / 1e9:.2f} s, {self.describe_stop}",
            )
            self.forget(now)
        index = 0
        for command in self.commands:
            if not math.isnan(self._values[index]):
                command.value = self._values[index]
            index += 1  # noqa: SIM113 - as above
        self._copy.refresh()
        self.stamp = now
        return OK

    def sample(self, wall_offset_ns: int) -> GpioSample:
        return GpioSample(time=self.published(wall_offset_ns), parts=self._copy.by_joint())

    def _refuse_unless_active(self) -> None:
        if self.state is not ControllerState.ACTIVE:
            raise self.refusal(f"is {self.state.value}; activate it before commanding it")
        if not self._names:
            raise self.refusal("has no command_interfaces; it only publishes states")


@dataclass(frozen=True)
class DeviceParams(CommonParams):
    """Parameters of the CANopen device controllers; `joint` may also be the name of a node without joints."""

    joint: str = setting("", help="a joint driven by a node, or the name of a node without joints")


class CanopenProxyController(Controller):
    """Controller that offers the services of one node: NMT commands, SDO access and PDOs."""

    title: ClassVar[str] = "One node, with the interfaces of ros2_canopen"
    reads: ClassVar[type[DeviceParams]] = DeviceParams
    moves_joints: ClassVar[bool] = False
    offers: ClassVar[tuple[str, ...]] = (NODE_SERVICES,)

    def on_configure(self, params: Params) -> None:
        settings = params.read(DeviceParams)
        if not settings.joint:
            raise RobotConfigError(f"{self.name}: no 'joint'; give it under {self.name}: ros__parameters: joint: NAME")
        self.joints, self.update_rate = (settings.joint,), settings.update_rate


class Cia402DeviceController(CanopenProxyController):
    """Controller that offers the services of one drive: the services of a node, and CiA 402 states and modes."""

    offers: ClassVar[tuple[str, ...]] = (DRIVE_SERVICES,)
