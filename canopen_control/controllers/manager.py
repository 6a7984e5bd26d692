"""The controller manager: who is loaded, who is active, who owns what, and the controllers' part of the cycle.

The law of the file (ros2_control jazzy): a switch is checked as a whole before anything changes. STRICT refuses it if
any name is impossible, best effort drops the impossible ones; a claimed or unavailable interface refuses it in both.
Then the leaving controllers stop and release, the hardware changes its modes, the entering ones claim and start; if one
of those fails, all of that request are stopped again. A controller whose update fails is deactivated with those it is
chained to, and its fallbacks take over. `update` runs over lists made at the last switch. It never raises.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Final, Protocol

from canopen_control.controllers.base import ALL_STATES, Controller, ControllerEvent, ControllerState, zero_targets
from canopen_control.controllers.chain import in_order, users_of
from canopen_control.controllers.claims import Plan, make_plan
from canopen_control.controllers.params import Params
from canopen_control.controllers.types import make_controller
from canopen_control.errors import CanopenError, ControlError, UnknownName
from canopen_control.hardware.interfaces import OK
from canopen_control.yamltree import nearest

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.controllers.base import Geometry
    from canopen_control.hardware.interfaces import HardwareComponent, InterfaceRegistry, StateInterface

__all__ = ["ControllerEvent", "ControllerInfo", "ControllerManager", "Switched"]

NS: Final = 1_000_000_000


@dataclass(frozen=True, slots=True)
class ControllerInfo:
    """What `list` tells of a controller; `topic` is where its commands come, None if it takes none.

    `publishes` are its topics of joint states, with `frame_id` in their headers and what it `tells` in them: by joint
    and name, the state interface that a value is read from, None for a constant 0.0.
    """

    name: str
    type: str
    state: str
    joints: tuple[str, ...]
    interface: str | None
    claimed_interfaces: tuple[str, ...]
    required_command_interfaces: tuple[str, ...]
    required_state_interfaces: tuple[str, ...]
    topic: str | None
    publishes: tuple[str, ...]
    frame_id: str
    tells: dict[str, dict[str, str | None]]
    is_broadcaster: bool
    rejected: int

    def as_dict(self) -> dict[str, object]:
        """Return the fields for JSON."""
        values = {each.name: getattr(self, each.name) for each in fields(self)}
        return {name: list(value) if isinstance(value, tuple) else value for name, value in values.items()}


@dataclass(frozen=True, slots=True)
class Switched:
    """What a switch changed."""

    activated: tuple[str, ...] = ()
    deactivated: tuple[str, ...] = ()


# within the class `list` is the method of ros2_control's name
Events = tuple[ControllerEvent, ...]
Names = list[str]
States = list["StateInterface"]
Running = tuple[Controller, ...]


class Limiter(Protocol):
    """Keeps the commands within the limits of the description (enforce_command_limits)."""

    def enforce(self, period: float) -> str | None:
        """Change commands that exceed a limit; `period` in s. Return which, when that begins."""
        ...


class _Slot:
    """An active controller's place in the cycle."""

    __slots__ = ("controller", "last", "rate")

    def __init__(self, controller: Controller, rate: int, last: int) -> None:
        self.controller, self.rate, self.last = controller, rate, last


class ControllerManager:
    """Owns the controllers of one robot; `update_rate` in Hz.

    `joints` are the movable ones of the description and `geometry` its wheels; `limiter` may be set at any time.
    """

    def __init__(
        self,
        registry: InterfaceRegistry,
        update_rate: int = 100,
        *,
        joints: Sequence[str] | None = None,
        geometry: Geometry | None = None,
    ) -> None:
        if update_rate <= 0:
            raise ControlError(f"controller_manager: update_rate is {update_rate}; it is a number of Hz above 0")
        self.registry, self.update_rate = registry, update_rate
        self._joints = None if joints is None else tuple(joints)
        self._geometry = geometry
        self.limiter: Limiter | None = None
        self._period = 1.0 / update_rate
        self._controllers: dict[str, Controller] = {}
        self._params: dict[str, Params] = {}
        self._fallbacks: dict[str, tuple[str, ...]] = {}
        self._order: list[_Slot] = []
        self._commanding: list[_Slot] = []
        self._telling: list[_Slot] = []
        self._failed: list[tuple[Controller, str]] = []
        self._events: list[ControllerEvent] = []
        self._now = 0

    # ------------------------------------------------------------------------------------------------- lifecycle

    def load(
        self, name: str, type_name: str, params: Params | None = None, fallbacks: Sequence[str] = ()
    ) -> Controller:
        """Make a controller of a known type, UNCONFIGURED; `params` are kept for `configure`. Raises ControlError.

        `fallbacks` are activated when its update fails; they must be configured by then.
        """
        if name in self._controllers:
            raise ControlError(f"controller {name} is loaded already; unload it first")
        controller = make_controller(name, type_name)
        controller.description_joints, controller.geometry = self._joints, self._geometry
        self._events += controller.notices
        controller.notices = self._events
        self._fallbacks[name] = tuple(fallbacks)
        self._controllers[name] = controller
        self._params[name] = params or Params.of({}, name)
        return controller

    def configure(self, name: str, params: Params | None = None) -> None:
        """Give a controller its parameters: UNCONFIGURED or INACTIVE to INACTIVE. Raises ConfigError, ControlError.

        If it refuses them it is UNCONFIGURED.
        """
        controller = self.get(name)
        if controller.state is ControllerState.ACTIVE:
            raise ControlError(f"controller {name} is active; deactivate it before configuring it")
        self._withdraw(controller)
        controller.state = ControllerState.UNCONFIGURED
        self._params[name] = given = params or self._params[name]
        known = set(given.warnings)
        controller.on_configure(given)
        for text in given.warnings:
            if text not in known:
                self._tell("parameter", name, text)
        if controller.update_rate > self.update_rate:
            rates = f"{controller.update_rate} Hz is above the controller_manager's {self.update_rate} Hz"
            self._tell("update_rate", name, f"{name}: its update_rate of {rates}; it runs at that")
        self.registry.export(controller.reference_interfaces(), name)
        controller.state = ControllerState.INACTIVE

    def unload(self, name: str) -> None:
        """Remove a controller that is not active."""
        controller = self.get(name)
        if controller.state is ControllerState.ACTIVE:
            raise ControlError(f"controller {name} is active; deactivate it before unloading it")
        self._withdraw(controller)
        controller.state = ControllerState.FINALIZED
        del self._controllers[name], self._params[name]
        self._fallbacks.pop(name, None)

    def get(self, name: str) -> Controller:
        """Return a loaded controller, or raise UnknownName with the names there are."""
        controller = self._controllers.get(name)
        if controller is None:
            raise UnknownName(f"no controller {name!r} is loaded{nearest(name, self._controllers)}")
        return controller

    def list(self) -> list[ControllerInfo]:
        """Return all controllers in the order they were loaded."""
        return [self._info(each) for each in self._controllers.values()]

    @property
    def states(self) -> dict[str, str]:
        """The states of all controllers by name, in the order they were loaded."""
        return {name: each.state.value for name, each in self._controllers.items()}

    @property
    def active(self) -> tuple[str, ...]:
        """The names of the active controllers in the order they run."""
        return tuple(slot.controller.name for slot in self._order)

    @property
    def running(self) -> Running:
        """The active controllers in the order they run."""
        return tuple(slot.controller for slot in self._order)

    def events(self) -> Events:
        """Return what happened since the last call, in order."""
        if not self._events:
            return ()
        events = tuple(self._events)
        self._events.clear()
        return events

    # --------------------------------------------------------------------------------------------------- switching

    def switch(
        self,
        activate: Sequence[str] = (),
        deactivate: Sequence[str] = (),
        strict: bool = True,
        now: int | None = None,
    ) -> Switched:
        """Deactivate and activate in one step, between two cycles; `now` in ns, by default that of the last cycle.

        Raises ControlError (InterfaceConflict, UnknownInterface) or DriveError and changes nothing if the request is
        refused; if a controller fails to start, all of this request are deactivated and the ControlError says why.
        """
        now = self._now if now is None else now
        plan = make_plan(self._controllers, self.registry, activate, deactivate, strict=strict)
        for component, start, stop in plan.switches:
            component.prepare_command_mode_switch(start, stop)
        for controller in plan.deactivate:
            self._stop(controller, now, "deactivated")
        for component, start, stop in plan.switches:
            component.perform_command_mode_switch(start, stop)
        self._start_all(plan, now)
        self._rebuild(now)
        return Switched(tuple(each.name for each in plan.activate), tuple(each.name for each in plan.deactivate))

    def deactivate_using(self, component: HardwareComponent, reason: str, now: int | None = None) -> Names:
        """Deactivate whoever commands a component that failed, with those chained to them; return their names.

        Broadcasters keep telling what is known of the others.
        """
        owned = {each.owner for each in component.command_interfaces if each.owner is not None}
        return self._drop([self._controllers[name] for name in owned if name in self._controllers], reason, now)

    # --------------------------------------------------------------------------------------------------- the cycle

    def command(self, name: str, values: Sequence[float], now: int, stamp: int | None = None) -> None:
        """Hand a command to a controller; raises ControlError if it is refused. Times in ns."""
        self.get(name).set_command(values, now, stamp)

    def update(self, now: int, period: float) -> None:
        """Run the controllers that are due, in the order of their chains; `now` in ns, `period` of the cycle in s.

        Those that only tell are run by `broadcast`.
        """
        self._now = now
        self._run_due(self._commanding, now, period)
        if self.limiter is not None and (limited := self.limiter.enforce(period)) is not None:
            self._tell("limited", "", f"enforce_command_limits: {limited}")

    def broadcast(self, now: int, period: float) -> None:
        """Run the broadcasters that are due, once the commands of the cycle are on their way."""
        self._run_due(self._telling, now, period)

    def _run_due(self, slots: Sequence[_Slot], now: int, period: float) -> None:
        for slot in slots:
            elapsed = period
            if slot.rate:
                if not self._due(slot, now):
                    continue
                elapsed = (now - slot.last) / NS
                slot.last = now
            try:
                result = slot.controller.update(now, elapsed)
            except Exception as error:  # noqa: BLE001 - no controller ends the cycle, whatever it raises
                self._failed.append((slot.controller, f"update raised {type(error).__name__}: {error}"))
                continue
            if result is not OK:
                self._failed.append((slot.controller, "update reported an error"))
        if self._failed:
            self._drop_failed(now)

    def _due(self, slot: _Slot, now: int) -> bool:
        """Whether this cycle is nearer to the controller's period than the next one would be."""
        elapsed = (now - slot.last) / NS
        return abs(elapsed * slot.rate - 1.0) <= abs((elapsed + self._period) * slot.rate - 1.0)

    # ------------------------------------------------------------------------------------------------------ inside

    def _drop_failed(self, now: int) -> None:
        failed, self._failed = self._failed, []
        for controller, reason in failed:
            dropped = self._drop([controller], reason, now)
            fallbacks = dict.fromkeys(name for each in dropped for name in self._fallbacks.get(each, ()))
            if fallbacks:
                self._fall_back(list(fallbacks), controller.name, now)

    def _fall_back(self, names: Sequence[str], failed: str, now: int) -> None:
        """Activate what takes over from a controller that failed; those that are active already go on."""
        wanted = [name for name in names if name not in self.active]
        try:
            self.switch(wanted, now=now)
        except CanopenError as error:
            self._tell("error", failed, f"{failed}: its fallbacks cannot take over: {error}")
        else:
            self._tell("fallback", failed, f"{', '.join(names)} took over from {failed}")

    def _drop(self, controllers: Sequence[Controller], reason: str, now: int | None) -> Names:
        """Deactivate these and whoever is chained to them, without asking anyone."""
        now = self._now if now is None else now
        active = [slot.controller for slot in self._order]
        group = users_of(controllers, active)
        for controller in group:
            self._stop(controller, now, "error", reason)
        self._release_hardware(group)
        self._rebuild(now)
        return [each.name for each in group]

    def _release_hardware(self, group: Sequence[Controller]) -> None:
        for component in self.registry.components:
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
            self._rebuild(now)
            raise ControlError(f"{started[-1].name} could not be activated: {error}") from error

    def _start(self, controller: Controller, now: int) -> None:
        commands = self.registry.claim(controller.command_interface_names(), controller.name)
        for each in commands:
            each.value = math.nan
        controller.on_activate(commands, self._states_of(controller), now)
        controller.state = ControllerState.ACTIVE
        self._tell("activated", controller.name, f"{controller.name} is active")

    def _stop(self, controller: Controller, now: int, kind: str, reason: str = "") -> None:
        """Make a controller inactive; its targets are zero even if its own hook fails."""
        commands = list(controller.commands)
        try:
            controller.on_deactivate(now)
        except Exception as error:  # noqa: BLE001 - stopping goes on
            reason = reason or f"on_deactivate raised {type(error).__name__}: {error}"
        zero_targets(commands)
        self.registry.release(controller.name)
        controller.state = ControllerState.INACTIVE
        controller.commands, controller.states = [], []
        text = f"{controller.name} was deactivated"
        self._tell(kind, controller.name, f"{text}: {reason}" if reason else text)

    def _states_of(self, controller: Controller) -> States:
        names = controller.state_interface_names()
        if names == [ALL_STATES]:
            return list(self.registry.state_interfaces)
        return [self.registry.state(name) for name in names]

    def _rebuild(self, now: int) -> None:
        kept = {slot.controller.name: slot.last for slot in self._order}
        active = [each for each in self._controllers.values() if each.state is ControllerState.ACTIVE]
        self._order = []
        for controller in in_order(active):
            rate = (
                0 if controller.update_rate in (0, self.update_rate) else min(controller.update_rate, self.update_rate)
            )
            first = now - NS // rate if rate else now
            self._order.append(_Slot(controller, rate, kept.get(controller.name, first)))
        self._commanding = [slot for slot in self._order if not _only_tells(slot.controller)]
        self._telling = [slot for slot in self._order if _only_tells(slot.controller)]

    def _withdraw(self, controller: Controller) -> None:
        self.registry.withdraw(controller.reference_interfaces())

    def _info(self, controller: Controller) -> ControllerInfo:
        configured = controller.state is not ControllerState.UNCONFIGURED
        return ControllerInfo(
            controller.name,
            controller.type,
            controller.state.value,
            controller.joints,
            controller.interface,
            tuple(each.name for each in controller.commands),
            tuple(controller.command_interface_names()) if configured else (),
            tuple(controller.state_interface_names()) if configured else (),
            controller.topic,
            controller.publishes,
            controller.frame_id,
            controller.tells,
            controller.is_broadcaster,
            controller.rejected,
        )

    def _tell(self, kind: str, controller: str, text: str) -> None:
        self._events.append(ControllerEvent(kind, controller, text))


def _only_tells(controller: Controller) -> bool:
    return controller.is_broadcaster and not controller.commands
