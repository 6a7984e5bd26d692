"""`/controller_manager/*`: the services used by `ros2 control` and the spawner of a ROS installation.

Rules (controller_manager_msgs, Jazzy 4.46): names and answers are upstream's; strictness 2 is strict, any
other best effort; a refused request is answered with ok false, and the reason is logged, and sent if the answer has
a field for it. The runtime decides; this module makes no decision of its own.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, TypeVar

from canopen_control.ros.endpoint import Endpoint
from canopen_control.ros.interfaces import interface, made
from canopen_control.rpc.messages.robot import (
    ROBOT,
    CleanupController,
    ConfigureController,
    ListControllers,
    ListControllerTypes,
    ListHardware,
    LoadController,
    SetHardwareState,
    SwitchControllers,
    UnloadController,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from canopen_control.ros.endpoint import Reply, Ros, RosMessage
    from canopen_control.rpc.messages.declare import Done, Request
    from canopen_control.rpc.messages.robot import ComponentState, HardwareReading, InterfaceReading
    from canopen_control.rpc.messages.state import ControllerReading


A = TypeVar("A")

_STRICT: Final = 2
_ALL_STATES: Final = "*"  # the API's word for every state interface of the robot
_BASE_CLASS: Final = "controller_interface::ControllerInterface"
#: lifecycle_msgs/msg/State
STATES: Final = {"unknown": 0, "unconfigured": 1, "inactive": 2, "active": 3, "finalized": 4}


class ControllerManagerServices(Endpoint):
    """Services of one robot below `controller_manager`, relative to the namespace."""

    def __init__(self, ros: Ros) -> None:
        self._ros = ros
        self._state_class = interface("lifecycle_msgs/msg/State")
        self._services = [
            ros.serve(f"controller_manager_msgs/srv/{kind}", f"controller_manager/{name}", handler)
            for name, kind, handler in self._table()
        ]

    def close(self) -> None:
        """Destroy the services."""
        for service in self._services:
            self._ros.unserve(service)

    def _table(self) -> list[tuple[str, str, Callable[[Any, Any, Reply], object]]]:
        return [
            ("list_controllers", "ListControllers", self._list_controllers),
            ("list_controller_types", "ListControllerTypes", self._list_types),
            (
                "load_controller",
                "LoadController",
                self._by_name(lambda name: LoadController(controller=name, configure=False)),
            ),
            (
                "configure_controller",
                "ConfigureController",
                self._by_name(lambda name: ConfigureController(controller=name)),
            ),
            ("switch_controller", "SwitchController", self._switch),
            ("unload_controller", "UnloadController", self._by_name(lambda name: UnloadController(controller=name))),
            ("cleanup_controller", "CleanupController", self._by_name(lambda name: CleanupController(controller=name))),
            ("reload_controller_libraries", "ReloadControllerLibraries", self._reload),
            ("list_hardware_components", "ListHardwareComponents", self._list_components),
            ("list_hardware_interfaces", "ListHardwareInterfaces", self._list_interfaces),
            ("set_hardware_component_state", "SetHardwareComponentState", self._set_component_state),
        ]

    # ------------------------------------------------------------------------------------------------ controllers

    def _list_controllers(self, _request: RosMessage, response: RosMessage, reply: Reply) -> None:
        make = interface("controller_manager_msgs/msg/ControllerState")
        connection = interface("controller_manager_msgs/msg/ChainConnection")
        states: list[str] = []  # of the robot, which are what "*" stands for

        def fill(answer: tuple[ControllerReading, ...]) -> None:
            commanded = {name for reading in answer for name in reading.claims}
            response.controller = [
                made(
                    make,
                    name=reading.name,
                    state=reading.state,
                    type=reading.type,
                    update_rate=reading.update_rate,
                    claimed_interfaces=list(reading.claims),
                    required_command_interfaces=list(reading.required_command_interfaces),
                    required_state_interfaces=sorted(states)
                    if reading.required_state_interfaces == (_ALL_STATES,)
                    else list(reading.required_state_interfaces),
                    is_chainable=bool(reading.reference_interfaces),
                    is_chained=not commanded.isdisjoint(reading.reference_interfaces),
                    reference_interfaces=_without_owner(reading, reading.reference_interfaces),
                    exported_state_interfaces=_without_owner(reading, reading.exported_state_interfaces),
                    chain_connections=[
                        connection(name=below.name, reference_interfaces=_without_owner(below, names))
                        for below in answer
                        if (names := [name for name in reading.claims if name in below.reference_interfaces])
                    ],
                )
                for reading in answer
            ]

        def known(hardware: list[HardwareReading] | None, _error: str | None) -> None:
            states.extend(
                state_interface.name for component in hardware or () for state_interface in component.state_interfaces
            )
            self._ask(ListControllers(), fill, response, reply)

        self._ros.ask(ListHardware(), known)

    def _list_types(self, _request: RosMessage, response: RosMessage, reply: Reply) -> None:
        def fill(answer: list[str]) -> None:
            response.types = list(answer)
            response.base_classes = [_BASE_CLASS] * len(answer)

        self._ask(ListControllerTypes(), fill, response, reply)

    def _by_name(self, make: Callable[[str], Request[Done]]) -> Callable[[Any, Any, Reply], None]:
        def handler(request: RosMessage, response: RosMessage, reply: Reply) -> None:
            self._ask(make(request.name), lambda _: _succeed(response), response, reply)

        return handler

    def _switch(self, request: RosMessage, response: RosMessage, reply: Reply) -> None:
        command = SwitchControllers(
            activate=tuple(request.activate_controllers),
            deactivate=tuple(request.deactivate_controllers),
            strict=request.strictness == _STRICT,
        )
        self._ask(command, lambda _: _succeed(response), response, reply)

    def _reload(self, _request: RosMessage, response: RosMessage, reply: Reply) -> None:
        """Refuse the reload: Python code is loaded once per process."""
        self._ros.warn("reload", "controller libraries cannot be loaded again while the robot runs; restart it")
        reply(response)

    # --------------------------------------------------------------------------------------------------- hardware

    def _list_components(self, _request: RosMessage, response: RosMessage, reply: Reply) -> None:
        make = interface("controller_manager_msgs/msg/HardwareComponentState")

        def fill(answer: list[HardwareReading]) -> None:
            response.component = [
                made(
                    make,
                    name=reading.name,
                    type=reading.type,
                    plugin_name=reading.plugin,
                    class_type=reading.plugin,
                    rw_rate=reading.rate,
                    state=self._lifecycle(reading.state),
                    command_interfaces=self._interfaces(reading.command_interfaces),
                    state_interfaces=self._interfaces(reading.state_interfaces),
                )
                for reading in answer
            ]

        self._ask(ListHardware(), fill, response, reply)

    def _list_interfaces(self, _request: RosMessage, response: RosMessage, reply: Reply) -> None:
        def fill(answer: list[HardwareReading]) -> None:
            commands = [one for reading in answer for one in reading.command_interfaces]
            states = [state_interface for reading in answer for state_interface in reading.state_interfaces]
            response.command_interfaces = self._interfaces(sorted(commands, key=lambda command: command.name))
            response.state_interfaces = self._interfaces(sorted(states, key=lambda state: state.name))

        self._ask(ListHardware(), fill, response, reply)

    def _set_component_state(self, request: RosMessage, response: RosMessage, reply: Reply) -> None:
        target = request.target_state
        by_id = {number: label for label, number in STATES.items()}
        label = target.label or by_id.get(target.id, "unknown")

        def fill(answer: ComponentState) -> None:
            response.ok = answer.state == label
            response.state = self._lifecycle(answer.state)

        self._ask(SetHardwareState(component=request.name, state=label), fill, response, reply)

    def _lifecycle(self, label: str) -> RosMessage:
        return self._state_class(id=STATES.get(label, 0), label=label)

    def _interfaces(self, readings: Iterable[InterfaceReading]) -> list[Any]:
        make = interface("controller_manager_msgs/msg/HardwareInterface")
        return [
            made(
                make,
                name=reading.name,
                data_type="double",
                is_available=reading.available,
                is_claimed=reading.claimed,
            )
            for reading in readings
        ]

    def _ask(
        self,
        query: Request[A],
        fill: Callable[[A], object],
        response: RosMessage,
        reply: Reply,
    ) -> None:
        """Send a request; `fill` copies its answer into the response; a refusal is logged."""
        method = ROBOT.of(type(query)).name

        def answer(result: A | None, error: str | None) -> None:
            if result is not None:
                fill(result)
            if error is not None:
                self._ros.warn(f"controller_manager/{method}", f"{method}: {error}")
                if hasattr(response, "message"):
                    response.message = error
            reply(response)

        self._ros.ask(query, answer)


def _succeed(response: RosMessage) -> None:
    response.ok = True


def _without_owner(controller: ControllerReading, names: Iterable[str]) -> list[str]:
    """Return the names of a controller's interfaces without its own name as prefix, as ros2_control lists them."""
    return [name.removeprefix(f"{controller.name}/") for name in names]
