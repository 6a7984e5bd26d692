"""The API's methods about controllers and hardware components: what ros2_control's services do."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from canopen_control.controllers.types import TYPES
from canopen_control.errors import ControlError, UnknownName
from canopen_control.hardware.interfaces import LifecycleState
from canopen_control.rpc.messages import robot as messages
from canopen_control.rpc.messages.declare import Done
from canopen_control.rpc.messages.robot import ComponentState, HardwareReading, InterfaceReading
from canopen_control.rpc.messages.state import ControllerReading
from canopen_control.runtime.startup_controllers import UNLOADED, configure_controller, load_controller

if TYPE_CHECKING:
    from canopen_control.hardware.interfaces import HardwareComponent
    from canopen_control.rpc.messages.robot import RobotHello, RobotPush
    from canopen_control.rpc.server import Call, Server
    from canopen_control.runtime.core import RobotCore

__all__ = ["answer_control"]

_RESTING: Final = ("inactive", "unconfigured")
_COMMUNICATING: Final = (LifecycleState.INACTIVE, LifecycleState.ACTIVE)


def answer_control(robot: RobotCore, server: Server[RobotHello, RobotPush]) -> None:
    """Answer these methods on a server."""
    answers = server.answers
    answers(messages.ListControllers, lambda call: call.reply(_controllers(robot, unloaded=call.request.all)))
    answers(messages.ListControllerTypes, lambda call: call.reply(sorted(TYPES)))
    answers(messages.LoadController, lambda call: _load(robot, call))
    answers(messages.ConfigureController, lambda call: _configure(robot, call))
    answers(messages.CleanupController, lambda call: _unload(robot, call))  # it keeps nothing between two loads
    answers(messages.UnloadController, lambda call: _unload(robot, call))
    answers(messages.SwitchControllers, lambda call: _switch(robot, call))
    answers(messages.SetMeasuredStates, lambda call: _set_measured_states(robot, call))
    answers(
        messages.ListHardware,
        lambda call: call.reply([_component(robot, each) for each in robot.registry.components]),
    )
    answers(messages.SetHardwareState, lambda call: _set_hardware_state(robot, call))


def _controllers(robot: RobotCore, *, unloaded: bool) -> tuple[ControllerReading, ...]:
    found = robot.manager.list()
    if unloaded:
        loaded = robot.manager.states
        found += [
            ControllerReading(name=name, type=config.type, state=UNLOADED)
            for name, config in robot.setup.controllers.controllers.items()
            if name not in loaded
        ]
    return tuple(found)


def _load(robot: RobotCore, call: Call[messages.LoadController]) -> None:
    load_controller(robot.setup, robot.manager, call.request.controller, configure=call.request.configure)
    call.reply(Done())


def _configure(robot: RobotCore, call: Call[messages.ConfigureController]) -> None:
    configure_controller(robot.setup, robot.manager, call.request.controller)
    call.reply(Done())


def _unload(robot: RobotCore, call: Call[messages.UnloadController] | Call[messages.CleanupController]) -> None:
    robot.manager.unload(call.request.controller)
    call.reply(Done())


def _switch(robot: RobotCore, call: Call[messages.SwitchControllers]) -> None:
    wanted = call.request
    robot.switch(wanted.activate, wanted.deactivate, strict=wanted.strict)
    call.reply(Done())


def _set_measured_states(robot: RobotCore, call: Call[messages.SetMeasuredStates]) -> None:
    controller = robot.manager.get(call.request.controller)
    controller.set_measured_states(call.request.values, robot.cycle.clock.now())
    call.reply(Done())


def _component(robot: RobotCore, component: HardwareComponent) -> HardwareReading:
    """Describe a component as `list_hardware_components` does; its interfaces are available while it is active."""
    tags = {each.name: each for each in robot.setup.description.hardware}
    tag = tags.get(component.name)
    commands, states = component.state is LifecycleState.ACTIVE, component.state in _COMMUNICATING
    return HardwareReading(
        name=component.name,
        type=tag.kind if tag is not None else "system",
        plugin=tag.plugin if tag is not None else "",
        state=component.state.value,
        rate=robot.setup.controllers.update_rate,
        command_interfaces=[
            InterfaceReading(each.name, commands, each.owner is not None) for each in component.command_interfaces
        ],
        state_interfaces=[InterfaceReading(each.name, states) for each in component.state_interfaces],
    )


def _set_hardware_state(robot: RobotCore, call: Call[messages.SetHardwareState]) -> None:
    """Activate, deactivate or clean up a component; who commands it is deactivated first."""
    name, wanted = call.request.component, call.request.state
    component = next((each for each in robot.registry.components if each.name == name), None)
    if component is None:
        known = ", ".join(each.name for each in robot.registry.components)
        raise UnknownName(f"no hardware component {name!r}; there are: {known}")
    if wanted == "active":
        component.configure()
        component.activate()
    elif wanted in _RESTING:
        robot.manager.deactivate_using(component, f"{name} was set {wanted}")
        component.deactivate()
        (component.cleanup if wanted == "unconfigured" else component.configure)()
    else:
        there = f"active, {' or '.join(_RESTING)}"
        raise ControlError(f"hardware component {name} cannot be set {wanted!r}: {there}, while the robot runs")
    call.reply(ComponentState(component.state.value))
