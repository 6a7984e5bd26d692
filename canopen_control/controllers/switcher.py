"""Switches of controllers, checked as a whole before anything changes.

Rules (ros2_control jazzy, switch_controller): a strict request is refused for an unknown name, an activation of a
controller that is active or not configured, or a deactivation of a controller that is not active; a best-effort request
ignores these. Both are refused for a command interface that is missing, owned by a controller that stays active,
claimed twice, or of a component that is not ACTIVE. A swap is one request: interfaces that leaving controllers release
are free for the entering controllers. A controller that commands a leaving controller must leave too.

In a switch, the leaving controllers stop and release their interfaces, the hardware changes its modes, the entering
controllers claim theirs and start; if one of these fails, all controllers of the request are stopped again. A
controller that fails is stopped together with the controllers chained to it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from canopen_control.controllers.base import (
    ALL_STATES,
    ControllerEvent,
    ControllerState,
    zero_targets,
)
from canopen_control.controllers.chains import in_order, users_of
from canopen_control.errors import ControlError, InterfaceConflict, UnknownName, nearest
from canopen_control.hardware.interfaces import LifecycleState

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from canopen_control.controllers.base import Controller
    from canopen_control.controllers.update_loop import UpdateLoop
    from canopen_control.hardware.interfaces import (
        CommandInterface,
        HardwareComponent,
        InterfaceRegistry,
        StateInterface,
    )


@dataclass(frozen=True)
class SwitchPlan:
    """Plan of a switch request: controllers to activate and to deactivate, in order.

    `switches` are the mode switches of the hardware: component, interfaces to start, interfaces to stop.
    """

    activate: tuple[Controller, ...]
    deactivate: tuple[Controller, ...]
    switches: tuple[tuple[HardwareComponent, tuple[str, ...], tuple[str, ...]], ...]


def plan_switch(
    controllers: Mapping[str, Controller],
    registry: InterfaceRegistry,
    activate: Sequence[str],
    deactivate: Sequence[str],
    *,
    strict: bool,
) -> SwitchPlan:
    """Check a switch request and return its plan, without changing anything.

    Raise ControlError, InterfaceConflict or UnknownInterface if the request is refused.
    """
    leaving = _possible(controllers, deactivate, (ControllerState.ACTIVE,), "deactivate", strict=strict)
    allowed = (ControllerState.INACTIVE,)
    again = [name for name in activate if name in controllers and controllers[name] in leaving]
    entering = _possible(
        controllers, [name for name in activate if name not in again], allowed, "activate", strict=strict
    )
    entering += [controllers[name] for name in again]
    _check_chains(controllers, registry, entering, leaving)
    _check_claims(registry, entering, leaving)
    # a commanded controller starts first and stops last, so that its references never lack a reader
    start, stop = tuple(reversed(in_order(entering[::-1]))), tuple(in_order(leaving))
    return SwitchPlan(start, stop, _switches(registry, start, stop))


def _possible(
    controllers: Mapping[str, Controller],
    names: Sequence[str],
    states: tuple[ControllerState, ...],
    verb: str,
    *,
    strict: bool,
) -> list[Controller]:
    possible: list[Controller] = []
    for name in dict.fromkeys(names):
        controller = controllers.get(name)
        if controller is not None and controller.state in states:
            possible.append(controller)
        elif strict and controller is None:
            raise UnknownName(
                f"cannot {verb} {name!r}: no controller of this name is loaded{nearest(name, controllers)}"
            )
        elif strict and controller is not None:
            raise ControlError(f"cannot {verb} {name}: it is {controller.state.value}")
    return possible


def _check_chains(
    controllers: Mapping[str, Controller],
    registry: InterfaceRegistry,
    entering: list[Controller],
    leaving: list[Controller],
) -> None:
    stay = [
        running
        for running in controllers.values()
        if running.state is ControllerState.ACTIVE and running not in leaving
    ]
    remaining = [*stay, *entering]
    available = {reference.name for member in remaining for reference in member.reference_interfaces()}
    exported = {state.name for member in remaining for state in member.exported_states()}
    for controller in remaining:
        verb = "deactivate" if controller in stay else "activate"
        for name in controller.command_interface_names():
            if registry.component_of(name) is None and name not in available:
                raise _broken_chain(controller.name, "commands", name, verb)
        for name in controller.state_interface_names():
            if registry.is_exported_state(name) and name not in exported:
                raise _broken_chain(controller.name, "reads", name, verb)


def _broken_chain(controller: str, uses: str, name: str, verb: str) -> ControlError:
    with_it = f"{verb} {controller} and {name.partition('/')[0]} together"
    return ControlError(f"{controller} {uses} {name}, whose controller would not be active; {with_it}")


def _check_claims(registry: InterfaceRegistry, entering: list[Controller], leaving: list[Controller]) -> None:
    free = {member.name for member in leaving}
    claimed: dict[str, str] = {}
    for controller in entering:
        for name in controller.command_interface_names():
            interface = registry.command(name)
            _check_component(registry.component_of(name), interface, controller)
            if interface.owner is not None and interface.owner not in free:
                raise InterfaceConflict(name, interface.owner)
            if name in claimed:
                raise InterfaceConflict(name, claimed[name])
            claimed[name] = controller.name
        for name in controller.state_interface_names():
            if name != ALL_STATES:
                registry.state(name)


def _check_component(component: HardwareComponent | None, interface: CommandInterface, controller: Controller) -> None:
    if component is not None and component.state is not LifecycleState.ACTIVE:
        raise ControlError(
            f"cannot activate {controller.name}: {interface.name} belongs to hardware {component.name!r}, "
            f"which is {component.state.value}; it must be active"
        )


def _switches(
    registry: InterfaceRegistry, entering: Sequence[Controller], leaving: Sequence[Controller]
) -> tuple[tuple[HardwareComponent, tuple[str, ...], tuple[str, ...]], ...]:
    result = []
    for component in registry.components:
        names = {interface.name for interface in component.command_interfaces}
        start = tuple(name for controller in entering for name in controller.command_interface_names() if name in names)
        stop = tuple(name for controller in leaving for name in controller.command_interface_names() if name in names)
        if start or stop:
            result.append((component, start, stop))
    return tuple(result)


@dataclass(frozen=True, slots=True)
class Switched:
    """Result of a switch: names of the activated and deactivated controllers."""

    activated: tuple[str, ...] = ()
    deactivated: tuple[str, ...] = ()


class SwitchObserver(Protocol):
    """Observer of the set of active controllers."""

    def controllers_switched(self) -> None:
        """Handle a change of the set of active controllers."""


class Switcher:
    """Executor of controller switches; `observer` is called after each change of the active controllers."""

    def __init__(
        self,
        registry: InterfaceRegistry,
        controllers: Mapping[str, Controller],
        running: UpdateLoop,
        events: list[ControllerEvent],
    ) -> None:
        self.observer: SwitchObserver | None = None
        self._registry, self._controllers, self._running, self._events = registry, controllers, running, events

    def switch(self, activate: Sequence[str], deactivate: Sequence[str], now: int, *, strict: bool) -> Switched:
        """Deactivate and activate controllers in one step, see `ControllerManager.switch`."""
        plan = plan_switch(self._controllers, self._registry, activate, deactivate, strict=strict)
        for component, start, stop in plan.switches:
            component.prepare_command_mode_switch(start, stop)
        for controller in plan.deactivate:
            self._stop(controller, now, "deactivated")
        for component, start, stop in plan.switches:
            component.perform_command_mode_switch(start, stop)
        self._start_all(plan, now)
        self._arrange()
        return Switched(
            tuple(controller.name for controller in plan.activate),
            tuple(controller.name for controller in plan.deactivate),
        )

    def drop(self, controllers: Sequence[Controller], reason: str, now: int) -> list[str]:
        """Deactivate controllers and all controllers chained to them, without checks; return their names."""
        group = users_of(controllers, self._running.controllers)
        for controller in group:
            self._stop(controller, now, "error", reason)
        self._release_hardware(group)
        self._arrange()
        return [member.name for member in group]

    def _release_hardware(self, group: Sequence[Controller]) -> None:
        for component in self._registry.components:
            names = {interface.name for interface in component.command_interfaces}
            stop = [name for controller in group for name in controller.command_interface_names() if name in names]
            if stop:
                component.perform_command_mode_switch((), stop)

    def _start_all(self, plan: SwitchPlan, now: int) -> None:
        started: list[Controller] = []
        try:
            for controller in plan.activate:
                started.append(controller)
                self._start(controller, now)
        except Exception as error:
            for controller in started:
                self._stop(controller, now, "error", str(error))
            self._release_hardware(plan.activate)
            self._arrange()
            raise ControlError(f"{started[-1].name} could not be activated: {error}") from error

    def _start(self, controller: Controller, now: int) -> None:
        commands = self._registry.claim(controller.command_interface_names(), controller.name)
        for command in commands:
            command.value = math.nan
        controller.on_activate(commands, self._states_of(controller), now)
        controller.state = ControllerState.ACTIVE
        self._report("activated", controller.name, f"{controller.name} is active")

    def _stop(self, controller: Controller, now: int, kind: str, reason: str = "") -> None:
        """Deactivate a controller; motion targets become 0.0 even if the controller's own hook fails."""
        commands = list(controller.commands)
        try:
            controller.command_timeout.end()
            controller.on_deactivate(now)
        except Exception as error:  # noqa: BLE001 - stopping goes on
            reason = reason or f"on_deactivate raised {type(error).__name__}: {error}"
        zero_targets(commands)
        self._registry.release(controller.name)
        controller.state = ControllerState.INACTIVE
        controller.commands, controller.states = [], []
        text = f"{controller.name} was deactivated"
        self._report(kind, controller.name, f"{text}: {reason}" if reason else text)

    def _states_of(self, controller: Controller) -> list[StateInterface]:
        names = controller.state_interface_names()
        if names == [ALL_STATES]:
            return list(self._registry.state_interfaces)
        return [self._registry.state(name) for name in names]

    def _arrange(self) -> None:
        active = [controller for controller in self._controllers.values() if controller.state is ControllerState.ACTIVE]
        self._running.arrange(self._controllers.values(), active)
        if self.observer is not None:
            self.observer.controllers_switched()

    def _report(self, kind: str, controller: str, text: str) -> None:
        self._events.append(ControllerEvent(kind, controller, text))
