"""The API's methods about controllers and hardware components: what ros2_control's services do."""

from __future__ import annotations

from dataclasses import asdict
from functools import partial
from typing import TYPE_CHECKING, Any, Final

from canopen_control.controllers.types import TYPES
from canopen_control.errors import ControlError, UnknownName
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
    return {name: partial(method, robot) for name, method in _METHODS.items()}


def _list(robot: RobotCore, call: Call) -> None:
    call.reply([asdict(info) for info in robot.manager.list()])


def _list_types(_robot: RobotCore, call: Call) -> None:
    call.reply(sorted(TYPES))


def _load(robot: RobotCore, call: Call) -> None:
    load_controller(robot.setup, robot.manager, _name(call))
    call.reply({})


def _configure(robot: RobotCore, call: Call) -> None:
    robot.manager.configure(_name(call))
    call.reply({})


def _unload(robot: RobotCore, call: Call) -> None:
    robot.manager.unload(_name(call))
    call.reply({})


def _switch(robot: RobotCore, call: Call) -> None:
    robot.switch(
        [str(name) for name in call.params.get("activate", ())],
        [str(name) for name in call.params.get("deactivate", ())],
        strict=bool(call.params.get("strict", True)),
    )
    call.reply({})


def _name(call: Call) -> str:
    return str(call.params["controller"])


def _list_hardware(robot: RobotCore, call: Call) -> None:
    call.reply([_component(robot, each) for each in robot.registry.components])


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
        raise UnknownName(f"no hardware component {name!r}; there are: {known}")
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


_METHODS: Final[dict[str, Callable[[RobotCore, Call], None]]] = {
    "controllers": _list,
    "controller_types": _list_types,
    "load": _load,
    "configure": _configure,
    "cleanup": _unload,  # a controller keeps nothing between two loads
    "unload": _unload,
    "switch": _switch,
    "hardware": _list_hardware,
    "set_hardware_state": _set_hardware_state,
}
