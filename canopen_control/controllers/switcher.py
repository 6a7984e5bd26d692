"""Switches of controllers: who stops, who starts, what the hardware is asked, and what becomes of a switch that fails.

The law of the file (ros2_control jazzy): the leaving controllers stop and release, the hardware changes its modes, the
entering ones claim and start; if one of those fails, all of that request are stopped again. What is asked is checked as
a whole before (`claims`). Whoever fails takes along those it is chained to.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from canopen_control.controllers.base import ALL_STATES, ControllerEvent, ControllerState, zero_targets
from canopen_control.controllers.chain import users_of
from canopen_control.controllers.claims import Plan, make_plan
from canopen_control.errors import ControlError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from canopen_control.controllers.base import Controller
    from canopen_control.controllers.running import RunningControllers
    from canopen_control.hardware.interfaces import InterfaceRegistry, StateInterface

__all__ = ["Switched", "Switcher"]


@dataclass(frozen=True, slots=True)
class Switched:
    """The result of a switch of controllers: what was activated and deactivated."""

    activated: tuple[str, ...] = ()
    deactivated: tuple[str, ...] = ()


class Switcher:
    """Starts and stops the `controllers` of one manager; `on_switched` is called when others are active than before."""

    def __init__(
        self,
        registry: InterfaceRegistry,
        controllers: Mapping[str, Controller],
        running: RunningControllers,
        events: list[ControllerEvent],
    ) -> None:
        self.on_switched: Callable[[], None] = lambda: None
        self._registry, self._controllers, self._running, self._events = registry, controllers, running, events

    def switch(self, activate: Sequence[str], deactivate: Sequence[str], now: int, *, strict: bool) -> Switched:
        """Deactivate and activate in one step, see `ControllerManager.switch`."""
        plan = make_plan(self._controllers, self._registry, activate, deactivate, strict=strict)
        for component, start, stop in plan.switches:
            component.prepare_command_mode_switch(start, stop)
        for controller in plan.deactivate:
            self._stop(controller, now, "deactivated")
        for component, start, stop in plan.switches:
            component.perform_command_mode_switch(start, stop)
        self._start_all(plan, now)
        self._arrange()
        return Switched(tuple(each.name for each in plan.activate), tuple(each.name for each in plan.deactivate))

    def drop(self, controllers: Sequence[Controller], reason: str, now: int) -> list[str]:
        """Deactivate these and whoever is chained to them, without asking anyone; return their names."""
        group = users_of(controllers, self._running.controllers)
        for controller in group:
            self._stop(controller, now, "error", reason)
        self._release_hardware(group)
        self._arrange()
        return [each.name for each in group]

    def _release_hardware(self, group: Sequence[Controller]) -> None:
        for component in self._registry.components:
            names = {each.name for each in component.command_interfaces}
            stop = [name for each in group for name in each.command_interface_names() if name in names]
            if stop:
                component.perform_command_mode_switch((), stop)

    def _start_all(self, plan: Plan, now: int) -> None:
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
        for each in commands:
            each.value = math.nan
        controller.on_activate(commands, self._states_of(controller), now)
        controller.state = ControllerState.ACTIVE
        self._tell("activated", controller.name, f"{controller.name} is active")

    def _stop(self, controller: Controller, now: int, kind: str, reason: str = "") -> None:
        """Make a controller inactive; its targets are zero even if its own hook fails."""
        commands = list(controller.commands)
        try:
            controller.life.end()
            controller.on_deactivate(now)
        except Exception as error:  # noqa: BLE001 - stopping goes on
            reason = reason or f"on_deactivate raised {type(error).__name__}: {error}"
        zero_targets(commands)
        self._registry.release(controller.name)
        controller.state = ControllerState.INACTIVE
        controller.commands, controller.states = [], []
        text = f"{controller.name} was deactivated"
        self._tell(kind, controller.name, f"{text}: {reason}" if reason else text)

    def _states_of(self, controller: Controller) -> list[StateInterface]:
        names = controller.state_interface_names()
        if names == [ALL_STATES]:
            return list(self._registry.state_interfaces)
        return [self._registry.state(name) for name in names]

    def _arrange(self) -> None:
        active = [each for each in self._controllers.values() if each.state is ControllerState.ACTIVE]
        self._running.arrange(self._controllers.values(), active)
        self.on_switched()

    def _tell(self, kind: str, controller: str, text: str) -> None:
        self._events.append(ControllerEvent(kind, controller, text))
