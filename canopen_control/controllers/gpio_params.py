"""The parameters of gpio_controllers/GpioCommandController, of jazzy, and ours: where outputs go when commands end."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from canopen_control.controllers.command_life import MOVING
from canopen_control.controllers.params import CommonParams
from canopen_control.errors import RobotConfigError, nearest
from canopen_control.hardware.interfaces import POSITION
from canopen_control.yamlfile.convert import setting

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from canopen_control.controllers.params import Params

__all__ = ["GpioParams", "read_params"]

_LIST: Final = ".interfaces"


@dataclass(frozen=True)
class GpioParams(CommonParams):
    """Parameters of the controller; `command_timeout` in s, see `command_life` for what absent and 0 mean.

    Interfaces are by "<gpio>.interfaces", safe values by "<gpio>.<interface>", `kept_outputs` are "<gpio>/<interface>".
    """

    gpios: tuple[str, ...] = ()
    command_interfaces: dict[str, tuple[str, ...]] = setting(key="command_interfaces", section=True, factory=dict)  # noqa: RUF009 - a new one each
    state_interfaces: dict[str, tuple[str, ...]] = setting(key="state_interfaces", section=True, factory=dict)  # noqa: RUF009 - as above
    safe_values: dict[str, float] = setting(key="safe_values", section=True, factory=dict)  # noqa: RUF009 - as above
    kept_outputs: tuple[str, ...] = ()
    command_timeout: float | None = setting(None, low=0.0, high=1e9)

    @property
    def outputs(self) -> list[str]:
        """The command interfaces, as "gpio/interface", in the order of the parameters."""
        return [f"{gpio}/{each}" for gpio in self.gpios for each in self.command_interfaces.get(gpio + _LIST, ())]

    @property
    def inputs(self) -> list[str]:
        """The state interfaces that are named, in the same way."""
        return [f"{gpio}/{each}" for gpio in self.gpios for each in self.state_interfaces.get(gpio + _LIST, ())]

    @property
    def told_whole(self) -> list[str]:
        """The gpios of which every state interface is told, since none is named."""
        return [gpio for gpio in self.gpios if not self.state_interfaces.get(gpio + _LIST)]

    def safe_value(self, output: str, hardware: float | None) -> float:
        """Return where an output goes when commands end, nan for one that is kept; `hardware` is what that says."""
        default = 0.0 if hardware is None else hardware
        return math.nan if output in self.kept_outputs else self.safe_values.get(_dotted(output), default)


def read_params(params: Params, name: str, joints: Sequence[str]) -> GpioParams:
    """Return the parameters of controller `name`; raise RobotConfigError with everything that is wrong in them.

    `joints` are those of the description that move: no output moves one.
    """
    given = params.read(GpioParams)
    mistakes = [*_of_names(given), *_of_safe_values(given), *_of_joints(given, joints)]
    if mistakes:
        raise RobotConfigError(f"{name}: {'; '.join(mistakes)}")
    return given


def _of_names(given: GpioParams) -> Iterator[str]:
    if not given.gpios:
        yield "no 'gpios'; give it under ros__parameters: gpios: [io]"
    yield from _doubles("gpios", given.gpios)
    for key, lists in (
        ("command_interfaces", given.command_interfaces),
        ("state_interfaces", given.state_interfaces),
    ):
        for name, interfaces in lists.items():
            gpio = name.removesuffix(_LIST)
            if gpio not in given.gpios or gpio == name:
                yield f"{key}.{name} is no GPIO{_LIST} of one of gpios{nearest(gpio, given.gpios)}"
            yield from _doubles(f"{key}.{name}", interfaces)


def _of_safe_values(given: GpioParams) -> Iterator[str]:
    outputs = given.outputs
    dotted = [_dotted(each) for each in outputs]
    for name, value in given.safe_values.items():
        if name not in dotted:
            yield f"safe_values.{name} is none of command_interfaces{nearest(name, dotted)}"
        if not math.isfinite(value):
            yield f"safe_values.{name} is {value}; give a finite number"
    for name in given.kept_outputs:
        if name not in outputs:
            yield f"kept_outputs: {name!r} is none of command_interfaces{nearest(name, outputs)}"


def _of_joints(given: GpioParams, joints: Sequence[str]) -> Iterator[str]:
    for name in given.outputs:
        joint, _, interface = name.rpartition("/")
        if joint in joints and interface in (POSITION, *MOVING):
            yield f"{name} moves a joint and is no output; command it by a forward command controller"


def _doubles(key: str, names: Sequence[str]) -> Iterator[str]:
    if len(set(names)) != len(names):
        yield f"{key} names one twice: {', '.join(names)}; name each once"


def _dotted(output: str) -> str:
    return output.replace("/", ".")
