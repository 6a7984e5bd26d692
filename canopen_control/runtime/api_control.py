"""The API's methods about controllers and hardware components: what ros2_control's services do."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from canopen_control.controllers.types import TYPES
from canopen_control.errors import ControlError
from canopen_control.hardware.interfaces import LifecycleState
from canopen_control.runtime.wanted import load_controller

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.hardware.interfaces import HardwareComponent
    from canopen_control.runtime.call import Call
    from canopen_control.runtime.core import RobotCore

__all__ = ["control_methods"]


def control_methods(robot: RobotCore) -> dict[str, Callable[[Call], None]]:
    """Return the methods by name."""
    manager = robot.manager

    def load(call: Call) -> None:
        load_controller(robot.setup, manager, _name(call))
        call.reply({})

    def configure(call: Call) -> None:
        manager.configure(_name(call))
        call.reply({})

    def unload(call: Call) -> None:
        manager.unload(_name(call))
        call.reply({})

    def switch(call: Call) -> None:
        robot.switch(
            [str(name) for name in call.params.get("activate", ())],
            [str(name) for name in call.params.get("deactivate", ())],
            strict=bool(call.params.get("strict", True)),
        )
        call.reply({})

    return {
        "controllers": lambda call: call.reply([asdict(info) for info in manager.list()]),
        "controller_types": lambda call: call.reply(sorted(TYPES)),
        "load": load,
        "configure": configure,
        "cleanup": unload,  # a controller keeps nothing between two loads
        "unload": unload,
        "switch": switch,
        "hardware": lambda call: call.reply([_component(robot, each) for each in robot.registry.components]),
        "set_hardware_state": lambda call: _set_hardware_state(robot, call),
    }


def _name(call: Call) -> str:
    return str(call.params["controller"])


def _component(robot: RobotCore, component: HardwareComponent) -> dict[str, Any]:
    """Describe a component as `list_hardware_components` does; its interfaces are available while it is active."""
    tags = {each.name: each for each in robot.setup.description.hardware}
    tag = tags.get(component.name)
    commands, states = component.state is LifecycleState.ACTIVE, component.state in _COMMUNICATING
    return {
        "name": component.name,
        "type": tag.kind if tag is not None else "system",
        "plugin": tag.plugin if tag is not None else "",
        "state": component.state.value,
        "rate": robot.setup.controllers.update_rate,
        "command_interfaces": [
            {"name": each.name, "available": commands, "claimed": each.owner is not None}
            for each in component.command_interfaces
        ],
        "state_interfaces": [{"name": each.name, "available": states} for each in component.state_interfaces],
    }


_COMMUNICATING = (LifecycleState.INACTIVE, LifecycleState.ACTIVE)


def _set_hardware_state(robot: RobotCore, call: Call) -> None:
    """Activate or deactivate a component; who commands it is deactivated first."""
    name, wanted = str(call.params["component"]), str(call.params["state"])
    component = next((each for each in robot.registry.components if each.name == name), None)
    if component is None:
        known = ", ".join(each.name for each in robot.registry.components)
        raise ControlError(f"no hardware component {name!r}; there are: {known}")
    if wanted == "active":
        component.configure()
        component.activate()
    elif wanted == "inactive":
        robot.manager.deactivate_using(component, f"{name} was set inactive")
        component.deactivate()
    else:
        raise ControlError(
            f"hardware component {name} cannot be set {wanted!r}: active or inactive, while the robot runs"
        )
    call.reply({"state": component.state.value})
