"""The controllers of devices that are no drives in a new ros2_controllers.yaml: outputs by name, and what is measured.

A device with outputs gets a GPIO command controller, which tells its inputs too. A battery gets its broadcaster, any
other device one that tells all of its signals. The joint of an encoder is told by the joint state broadcaster.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from canopen_control.controllers.battery_params import QUANTITIES
from canopen_control.profiles.device_type import Profile
from canopen_control.scaffold.bus_text import remark

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.scaffold.new_robot import NewNode

__all__ = ["DeviceController", "device_controller"]


@dataclass(frozen=True, slots=True)
class DeviceController:
    """A type of controller for a device; its name is that of the node, "_" and `suffix`."""

    suffix: str
    type_name: str
    parameters: Callable[[NewNode], list[str]]


def device_controller(node: NewNode) -> tuple[DeviceController, list[str]]:
    """Return the controller of a device that has signals, and the lines of its parameters."""
    if node.outputs:
        chosen = _OUTPUTS
    elif node.profile is Profile.BATTERY and any(signal.name == QUANTITIES[0] for signal in node.signals):
        chosen = _BATTERY
    else:
        chosen = _INPUTS
    return chosen, chosen.parameters(node)


def _outputs(node: NewNode) -> list[str]:
    names = ", ".join(signal.name for signal in node.outputs)
    return [
        remark(f"gpios: [{node.name}]", "the <gpio> of the description"),
        "command_interfaces:",
        remark(f"  {node.name}: {{interfaces: [{names}]}}", "what a command may set; inputs are told as well"),
        remark("command_timeout: 0.0", "s without a command, then outputs go to their safe values; 0: they stay"),
    ]


def _battery(node: NewNode) -> list[str]:
    measured = [signal.name for signal in node.signals if signal.name in QUANTITIES[1:]]
    lines = [remark(f"batteries: [{node.name}]", "the <sensor> of the description")]
    if measured:
        lines += ["interfaces:", f"  {node.name}: {{{', '.join(f'{name}: true' for name in measured)}}}"]
    return lines


def _inputs(node: NewNode) -> list[str]:
    return [remark(f"joints: [{node.name}]", "everything that the device tells, with each update")]


_OUTPUTS: Final = DeviceController("outputs", "gpio_controllers/GpioCommandController", _outputs)
_BATTERY: Final = DeviceController("broadcaster", "battery_state_broadcaster/BatteryStateBroadcaster", _battery)
_INPUTS: Final = DeviceController("broadcaster", "canopen_control/GpioBroadcaster", _inputs)
