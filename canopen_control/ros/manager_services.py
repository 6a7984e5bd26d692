"""Services of `/controller_manager`, for `ros2 control` and the spawner, and services of lifecycle nodes.

Rules (controller_manager_msgs, Jazzy 4.46): names and answers are the same as upstream; strictness 2 is strict, any
other value is best effort; a refused request is answered with ok false, and its reason is logged, and also sent if the
response has a field for it. The runtime makes all decisions, this module none.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypeVar

from canopen_control.ros.endpoint import COMMANDER, Endpoint
from canopen_control.ros.interfaces import interface, new_message
from canopen_control.rpc.messages.robot import (
    ROBOT,
    AxisRequest,
    CleanupController,
    ConfigureController,
    ListControllers,
    ListControllerTypes,
    ListHardware,
    LoadController,
    SetHardwareState,
    Stop,
    SwitchControllers,
    UnloadController,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from canopen_control.ros.endpoint import NodeContext, Reply, RosMessage
    from canopen_control.rpc.messages.declare import Done, Request
    from canopen_control.rpc.messages.robot import ComponentState, HardwareReading, InterfaceReading
    from canopen_control.rpc.messages.state import ControllerReading, NodeReading, StateSample

    Ending = Callable[[str | None], object]  # called with the reason of a failure, or None after success


A = TypeVar("A")

_STRICT: Final = 2
_ALL_STATES: Final = "*"  # in the API: every state interface of the robot
_BASE_CLASS: Final = "controller_interface::ControllerInterface"
_UNKNOWN: Final = "unknown"  # state of a hardware component only, not of a lifecycle node
#: lifecycle_msgs/msg/State
STATES: Final = {_UNKNOWN: 0, "unconfigured": 1, "inactive": 2, "active": 3, "finalized": 4}


class ControllerManagerServices(Endpoint):
    """Services of one robot's controller manager, below `controller_manager` in the namespace."""

    def __init__(self, ros: NodeContext) -> None:
        super().__init__(ros)
        self._state_class = interface("lifecycle_msgs/msg/State")
        for name, kind, handler in self._table():
            self.serve(f"controller_manager_msgs/srv/{kind}", f"controller_manager/{name}", handler)

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
        states: list[str] = []  # all state interfaces of the robot, abbreviated as "*"

        def fill(answer: tuple[ControllerReading, ...]) -> None:
            commanded = {name for reading in answer for name in reading.claims}
            response.controller = [
                new_message(
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

        def on_hardware(hardware: list[HardwareReading] | None, _error: str | None) -> None:
            states.extend(
                state_interface.name for component in hardware or () for state_interface in component.state_interfaces
            )
            self._ask(ListControllers(), fill, response, reply)

        self._ros.ask(ListHardware(), on_hardware)

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
        """Refuse the request, since Python code is loaded once per process."""
        self._ros.warn("reload", "controllers are loaded once per process; restart the robot to load them again")
        reply(response)

    # --------------------------------------------------------------------------------------------------- hardware

    def _list_components(self, _request: RosMessage, response: RosMessage, reply: Reply) -> None:
        make = interface("controller_manager_msgs/msg/HardwareComponentState")

        def fill(answer: list[HardwareReading]) -> None:
            response.component = [
                new_message(
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
        label = target.label or by_id.get(target.id, _UNKNOWN)

        def fill(answer: ComponentState) -> None:
            response.ok = answer.state == label
            response.state = self._lifecycle(answer.state)

        self._ask(SetHardwareState(component=request.name, state=label), fill, response, reply)

    def _lifecycle(self, label: str) -> RosMessage:
        return self._state_class(id=STATES.get(label, 0), label=label)

    def _interfaces(self, readings: Iterable[InterfaceReading]) -> list[Any]:
        make = interface("controller_manager_msgs/msg/HardwareInterface")
        return [
            new_message(
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
        """Send a request, copy its result to the response with `fill`, and reply; a refusal is logged."""
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
    """Remove the controller's own name from its interface names, as ros2_control lists them."""
    return [name.removeprefix(f"{controller.name}/") for name in names]


# `/lifecycle_manager` and the lifecycle services of the master and the nodes, which start a ros2_canopen robot.
#
# Rules (lifecycle_msgs; ros2_canopen's lifecycle_manager): the runtime boots the nodes by itself, so that `configure`
# has no effect, `activate` checks whether the nodes are ready, and `deactivate` stops and disables them; a request for
# the current state is not an error. A transition that the robot refuses fails without effect. The transitions of the
# manager also apply to the master and the nodes with lifecycle drivers.


class LifecycleTransition(NamedTuple):
    """Transition from a state in `sources` to `target`; in a state in `reached`, requests succeed without effect."""

    number: int
    label: str
    sources: tuple[str, ...]
    target: str
    reached: tuple[str, ...] = ()


#: lifecycle_msgs/msg/Transition
TRANSITIONS: Final = (
    LifecycleTransition(1, "configure", ("unconfigured",), "inactive", ("inactive", "active")),
    LifecycleTransition(2, "cleanup", ("inactive",), "unconfigured", ("unconfigured",)),
    LifecycleTransition(3, "activate", ("inactive",), "active", ("active",)),
    LifecycleTransition(4, "deactivate", ("active",), "inactive", ("inactive",)),
    LifecycleTransition(5, "shutdown", ("unconfigured", "inactive", "active"), "finalized", ("finalized",)),
)
#: transition of the manager -> state of its members afterwards (ros2_canopen also configures and cleans them up)
_OF_MEMBERS: Final = {"activate": "active", "deactivate": "unconfigured", "shutdown": "finalized"}
_SHUTDOWN: Final = {6: 5, 7: 5}  # upstream has a separate number for the shutdown from each state


class LifecycleServices(Endpoint):
    """Lifecycle services below `path` for one node, or for all nodes if `node` is None.

    `members` are the services whose state follows the transitions of these services.
    """

    def __init__(
        self, ros: NodeContext, path: str, node: str | None = None, members: Sequence[LifecycleServices] = ()
    ) -> None:
        super().__init__(ros)
        self._path, self._node, self._members = path, node, members
        self._nodes: dict[str, NodeReading] = {}
        self.state = "unconfigured"
        self._state_class = interface("lifecycle_msgs/msg/State")
        table = (
            ("change_state", "ChangeState", self._change),
            ("get_state", "GetState", self._get),
            ("get_available_states", "GetAvailableStates", self._states),
            ("get_available_transitions", "GetAvailableTransitions", self._transitions),
        )
        for name, kind, handler in table:
            self.serve(f"lifecycle_msgs/srv/{kind}", f"{path}/{name}", handler)
        self._actions = {"activate": self._activate, "deactivate": self._deactivate, "shutdown": self._deactivate}

    def on_state(self, state: StateSample) -> None:
        self._nodes = state.nodes

    def _change(self, request: RosMessage, response: RosMessage, reply: Reply) -> None:
        requested = request.transition
        number = _SHUTDOWN.get(requested.id, requested.id)
        transitions = [
            transition
            for transition in TRANSITIONS
            if transition.number == number or (not number and transition.label == requested.label)
        ]

        def done(error: str | None) -> None:
            if error is None:
                self.state = transitions[0].target
                for member in self._members:
                    member.state = _OF_MEMBERS.get(transitions[0].label, member.state)
            self.report(self._path, error)
            response.success = error is None
            reply(response)

        if not transitions:
            done(f"unknown transition {requested.id} {requested.label!r}")
        elif self.state in transitions[0].reached:
            response.success = True
            reply(response)
        elif self.state not in transitions[0].sources:
            done(f"{transitions[0].label} is not possible in the state {self.state}")
        else:
            self._actions.get(transitions[0].label, lambda answer: answer(None))(done)

    def _activate(self, done: Ending) -> None:
        requested = list(self._nodes) if self._node is None else [self._node]
        nodes = {name: self._nodes.get(name) for name in requested}
        not_ready = [
            f"{name}: {(node and node.reason(name)) or 'not ready'}"
            for name, node in nodes.items()
            if node is None or not node.ready
        ]
        done("; ".join(not_ready) or None)

    @property
    def _moves(self) -> bool:
        """Whether the node has an axis that can be disabled."""
        node = self._nodes.get(self._node or "")
        return node is not None and bool(node.axes)

    def _deactivate(self, done: Ending) -> None:
        if self.state != "active" or (self._node is not None and not self._moves):
            done(None)
        elif self._node is None:
            self._ros.ask(Stop(), lambda _done, error: done(error))
        else:
            self._ros.ask(
                AxisRequest(action="disable", node=self._node, source=COMMANDER), lambda _done, error: done(error)
            )

    def _get(self, _request: RosMessage, response: RosMessage, reply: Reply) -> None:
        response.current_state = self._message(self.state)
        reply(response)

    def _states(self, _request: RosMessage, response: RosMessage, reply: Reply) -> None:
        response.available_states = [self._message(state) for state in STATES if state != _UNKNOWN]
        reply(response)

    def _transitions(self, _request: RosMessage, response: RosMessage, reply: Reply) -> None:
        make = interface("lifecycle_msgs/msg/TransitionDescription")
        transition = interface("lifecycle_msgs/msg/Transition")
        response.available_transitions = [
            make(
                transition=transition(id=entry.number, label=entry.label),
                start_state=self._message(self.state),
                goal_state=self._message(entry.target),
            )
            for entry in TRANSITIONS
            if self.state in entry.sources
        ]
        reply(response)

    def _message(self, label: str) -> RosMessage:
        return self._state_class(id=STATES[label], label=label)
