"""Switches and chains of controllers, and the update loop of the active controllers.

Rules (ros2_control jazzy): in a switch, the leaving controllers stop and release their interfaces, the hardware changes
its modes, the entering controllers claim theirs and start; if one of these fails, all controllers of the request are
stopped again. A request is checked as a whole before anything changes (`plan_switch`). A controller that fails is
stopped together with the controllers chained to it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Protocol

from canopen_control.controllers.base import (
    ALL_STATES,
    ControllerEvent,
    ControllerState,
    EnableStatus,
    is_moving,
    sample_type_of,
    zero_targets,
)
from canopen_control.errors import ControlError, InterfaceConflict, UnknownName, nearest
from canopen_control.hardware.interfaces import OK, LifecycleState

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping, Sequence

    from canopen_control.controllers.base import Controller
    from canopen_control.hardware.interfaces import (
        CommandInterface,
        HardwareComponent,
        InterfaceRegistry,
        StateInterface,
    )
    from canopen_control.rpc.messages.samples import ControllerSample


# An active controller in the cycle: its rate, and the interfaces that it commands.
#
# Rules (ros2_control jazzy): a controller slower than the cycle runs in the cycle nearest to its period. Safer than
# upstream: a command is cleared in the cycle in which one of its interfaces is no longer enabled.


NS: Final = 1_000_000_000
NOT_DUE: Final = -1.0
_NEVER: Final = -1

Interfaces = tuple["CommandInterface", ...]


class Rate:
    """Rate divider that selects the cycles in which a controller runs; `hz` 0 selects every cycle."""

    __slots__ = ("hz", "last")

    def __init__(self, hz: int) -> None:
        self.hz, self.last = hz, _NEVER

    def step(self, now: int, period: float) -> float:
        """Return the time since the last step in s, or NOT_DUE if the next cycle is closer to the due time.

        `now` is in ns, `period` is that of the cycle in s.
        """
        if not self.hz:
            return period
        if self.last == _NEVER:
            self.last = now - NS // self.hz
        elapsed = (now - self.last) / NS
        if abs(elapsed * self.hz - 1.0) > abs((elapsed + period) * self.hz - 1.0):
            return NOT_DUE
        self.last = now
        return elapsed


class InterfaceGroup:
    """Command interfaces that are enabled and stopped together; `enabled` is their state in the last cycle."""

    __slots__ = ("enabled", "interfaces")

    def __init__(self, interfaces: Interfaces) -> None:
        self.interfaces = interfaces
        self.enabled = self.follows()

    def follows(self) -> bool:
        """Whether the interfaces that no user has excluded are enabled; False if all are excluded."""
        following = not self.interfaces
        for interface in self.interfaces:
            if interface.enabled:
                following = True
            elif not interface.excluded:
                return False
        return following


class ActiveController:
    """Active controller, with its rate and the interface groups that it commands, directly or through a chain."""

    __slots__ = ("controller", "groups", "rate")

    def __init__(self, controller: Controller, hz: int, groups: Sequence[Interfaces]) -> None:
        self.controller, self.rate = controller, Rate(hz)
        self.groups = [InterfaceGroup(group) for group in groups]

    @property
    def is_broadcaster(self) -> bool:
        """Whether the controller is a broadcaster without commands, which runs after the cycle's RPDOs."""
        return self.controller.is_broadcaster and not self.controller.commands

    @property
    def follows(self) -> bool:
        """Whether at least one interface group follows commands, or no interface is claimed."""
        return not self.groups or any(group.follows() for group in self.groups)

    @property
    def disabled(self) -> list[CommandInterface]:
        """Command interfaces whose drive is not enabled."""
        return [interface for group in self.groups for interface in group.interfaces if not interface.enabled]

    def take_over(self, before: ActiveController, were_enabled: set[CommandInterface]) -> None:
        """Take over the timing and the enabled groups from `before`, the controller's entry before a switch."""
        self.rate.last = before.rate.last
        for group in self.groups:
            group.enabled = group.enabled or were_enabled.issuperset(group.interfaces)

    def forget(self, now: int, interfaces: Interfaces | None = None, why: str = "") -> None:
        """Clear the controller's commands, all of them or those of `interfaces`; `why` is a clause with the reason."""
        if interfaces is not None:
            self.controller.forget_some(interfaces, now)
            return
        self.controller.command_timeout.end(why)
        self.controller.forget(now)


# Chains of controllers, and the order in which they run.
#
# A controller that claims a reference interface of another controller runs before that controller, so that a command
# passes the whole chain within one cycle. A reader of exported states starts after their exporter. A chain stops as a
# whole.


def _followers(controller: Controller, among: Sequence[Controller]) -> list[Controller]:
    """Return the controllers whose reference interfaces a controller claims."""
    names = set(controller.command_interface_names())
    return [other for other in among if any(reference.name in names for reference in other.reference_interfaces())]


def _below(controller: Controller, among: Sequence[Controller]) -> list[Controller]:
    """Return the controllers whose reference interfaces or exported states a controller uses."""
    read = set(controller.state_interface_names())
    commanded = _followers(controller, among)
    return [other for other in among if other in commanded or any(one.name in read for one in other.exported_states())]


def joints_of(controller: Controller, among: Sequence[Controller]) -> list[str]:
    """Return the joints that a controller commands, directly or through controllers in `among`."""
    chain = [controller]
    for member in chain:  # the list grows in the loop
        chain += [further for further in _followers(member, among) if further not in chain]
    references = {reference.name for member in chain for reference in member.reference_interfaces()}
    names = [name for member in chain for name in member.command_interface_names() if name not in references]
    return list(dict.fromkeys(name.rpartition("/")[0] for name in names))


def in_order(controllers: Sequence[Controller]) -> list[Controller]:
    """Sort controllers stably so that each precedes the controllers that it commands or reads."""
    done: list[Controller] = []

    def add(controller: Controller, pending: tuple[Controller, ...]) -> None:
        for upper in controllers:
            if upper not in pending and controller in _below(upper, controllers):
                add(upper, (*pending, controller))
        if controller not in done:
            done.append(controller)

    for controller in controllers:
        add(controller, (controller,))
    return done


def hardware_interfaces_of(controller: Controller, among: Iterable[Controller]) -> tuple[CommandInterface, ...]:
    """Return the hardware command interfaces that an active controller commands, directly or through a chain."""
    below = {reference.name: lower for lower in among for reference in lower.reference_interfaces()}
    interfaces: dict[str, CommandInterface] = {}
    visited: list[Controller] = []
    todo = [controller]
    while todo:
        visited.append(controller := todo.pop())
        for command in controller.commands:
            follower = below.get(command.name)
            if follower is None:
                interfaces[command.name] = command
            elif follower not in visited:
                todo.append(follower)
    return tuple(interfaces.values())


def users_of(failed: Sequence[Controller], active: Sequence[Controller]) -> list[Controller]:
    """Return the failed controllers that are active, and all active controllers chained to them, in update order."""
    group = [controller for controller in failed if controller in active]
    grew = True
    while grew:
        further = [
            controller
            for controller in active
            if controller not in group
            and any(controller in _below(one, active) or one in _below(controller, active) for one in group)
        ]
        group += further
        grew = bool(further)
    return in_order(group)


# The plan of a switch request, checked as a whole before anything changes.
#
# Rules (ros2_control jazzy, switch_controller): a strict request is refused for an unknown name, an activation of a
# controller that is active or not configured, or a deactivation of a controller that is not active; a best-effort
# request ignores these. Both are refused for a command interface that is missing, owned by a controller that stays
# active, claimed twice, or of a component that is not ACTIVE. A swap is one request: interfaces that leaving
# controllers release are free for the entering controllers. A controller that commands a leaving controller must leave
# too.


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


# The active controllers: their updates in the cycle, their commands and samples.
#
# `update` and `broadcast` iterate over lists made at the last switch and never raise; a controller that fails is added
# to `failed`, for the manager to stop it. A controller runs after the controllers that command it.


_EVERY_CYCLE: Final = 0.99  # from this fraction of the cycle rate on, the manager runs in every cycle

Failures = list[tuple["Controller", str]]
Samples = dict[str, "ControllerSample"]


class UpdateLoop:
    """Updates of the active controllers, in the order of their chains.

    `update_rate` is the highest rate of a controller in Hz, `cycle` the period of the cycle in s. Events are added to
    `events`; `enable_status` determines the stop groups of an independent controller's interfaces.
    """

    def __init__(
        self, update_rate: int, cycle: float, events: list[ControllerEvent], enable_status: EnableStatus | None = None
    ) -> None:
        self.update_rate = update_rate
        self._enable_status = enable_status or EnableStatus()
        self.failed: Failures = []
        self.now = 0
        self._events = events
        every = 0 if update_rate * cycle >= _EVERY_CYCLE else update_rate
        self._period = max(cycle, 1.0 / update_rate)
        self._commanding_rate, self._broadcast_rate = Rate(every), Rate(every)
        self._order: list[ActiveController] = []
        self._commanding: list[ActiveController] = []
        self._broadcasting: list[ActiveController] = []

    def arrange(self, controllers: Collection[Controller], active: Sequence[Controller]) -> None:
        """Rebuild the update order after a switch; controllers that stay active keep their timing."""
        before = {entry.controller.name: entry for entry in self._order}
        were_enabled = {
            interface
            for entry in self._order
            for group in entry.groups
            if group.enabled
            for interface in group.interfaces
        }
        self._order = []
        for controller in in_order(active):
            rate = controller.update_rate if controller.update_rate < self.update_rate else 0
            interfaces = hardware_interfaces_of(controller, controllers)
            groups = self._enable_status.stop_groups(interfaces) if controller.independent else (interfaces,)
            entry = ActiveController(controller, rate, groups)
            if controller.name in before:
                entry.take_over(before[controller.name], were_enabled)
            self._order.append(entry)
        self._commanding = [entry for entry in self._order if not entry.is_broadcaster]
        self._broadcasting = [entry for entry in self._order if entry.is_broadcaster]

    @property
    def controllers(self) -> tuple[Controller, ...]:
        """Active controllers, in update order."""
        return tuple(entry.controller for entry in self._order)

    def samples(self, wall_offset_ns: int) -> Samples:
        """Return the last samples by controller name; a controller whose `sample` raises is added to `failed`."""
        samples: Samples = {}
        for controller in self.controllers:
            try:
                sample = controller.sample(wall_offset_ns)
            except Exception as error:  # noqa: BLE001 - an exception of a controller must not end the robot
                self._fail_once(controller, f"sample raised {type(error).__name__}: {error}")
                continue
            if sample is None:
                continue
            if type(sample) is sample_type_of(controller):
                samples[controller.name] = sample
            else:
                self._fail_once(controller, f"sample returned {type(sample).__name__}, not the class's `sample_type`")
        return samples

    # --------------------------------------------------------------------------------------------------- the cycle

    def update(self, now: int, period: float) -> float:
        """Update all active controllers except broadcasters, if the manager's period has passed.

        `now` is in ns, `period` is that of the cycle in s. Return the time since the previous update in s, negative if
        no update was due.
        """
        self.now = now
        for entry in self._commanding:
            for group in entry.groups:
                if group.follows() is not group.enabled:
                    self._power_changed(entry, group, now)
        rate = self._commanding_rate
        elapsed = rate.step(now, period) if rate.hz else period
        if elapsed >= 0.0:
            self._run(self._commanding, now, elapsed)
        return elapsed

    def broadcast(self, now: int, period: float) -> None:
        """Update the broadcasters, after the RPDOs of the cycle were sent."""
        rate = self._broadcast_rate
        elapsed = rate.step(now, period) if rate.hz else period
        if elapsed >= 0.0:
            self._run(self._broadcasting, now, elapsed)

    def _run(self, entries: Sequence[ActiveController], now: int, period: float) -> None:
        for entry in entries:
            elapsed = period if not entry.rate.hz else entry.rate.step(now, self._period)
            if elapsed < 0.0:
                continue
            try:
                result = entry.controller.update(now, elapsed)
            except Exception as error:  # noqa: BLE001 - an exception of a controller must not end the cycle
                self.failed.append((entry.controller, f"update raised {type(error).__name__}: {error}"))
                continue
            if result is not OK:
                self.failed.append((entry.controller, "update reported an error"))

    def _power_changed(self, entry: ActiveController, group: InterfaceGroup, now: int) -> None:
        """Update the state of an interface group; if a drive was disabled, clear the group's command."""
        if group.enabled:
            off = [interface for interface in group.interfaces if not interface.enabled]
            self._forget(
                entry, now, group.interfaces if len(entry.groups) > 1 else None, self._enable_status.reason(off)
            )
        group.enabled = not group.enabled

    # ----------------------------------------------------------------------------------------------------- commands

    @property
    def clients_with_commands(self) -> set[object]:
        """Connected clients whose commands are active and end at disconnection."""
        return {entry.controller.command_timeout.holder for entry in self._commanding} - {None}

    def entry_of(self, controller: Controller) -> ActiveController | None:
        """Return the entry of a controller, or None if it is not active."""
        return next((entry for entry in self._order if entry.controller is controller), None)

    def client_disconnected(self, holder: object, why: str = "is gone") -> None:
        """End the active commands of a disconnected client; `why` is a clause for the report."""
        for entry in self._commanding:
            controller = entry.controller
            if controller.command_timeout.holder is holder:
                source, moving = controller.command_timeout.source, is_moving(controller.commands)
                self._forget(entry, self.now, why=f"{source} {why}")
                if moving:
                    text = f"{controller.name}: {source} {why}, so its command has ended; {controller.describe_stop}"
                    self._events.append(ControllerEvent("commander_gone", controller.name, text))

    def exclude(self, joints: Iterable[str], now: int) -> None:
        """Clear the commands of joints that a user disabled or halted individually.

        The other joints of an independent controller continue; other controllers are not affected.
        """
        names = frozenset(joints)
        for entry in self._commanding:
            interfaces = tuple(
                interface for group in entry.groups for interface in group.interfaces if interface.joint in names
            )
            if interfaces and entry.controller.independent:
                for interface in interfaces:
                    interface.excluded = True
                self._forget(entry, now, interfaces)

    def forget(self, now: int, why: str) -> None:
        """Clear the commands of all controllers; `why` is a clause with the reason."""
        for entry in self._commanding:
            self._forget(entry, now, why=why)

    def _forget(self, entry: ActiveController, now: int, interfaces: Interfaces | None = None, why: str = "") -> None:
        try:
            entry.forget(now, interfaces, why)
        except Exception as error:  # noqa: BLE001 - an exception of a controller must not end the cycle
            self.failed.append((entry.controller, f"forget raised {type(error).__name__}: {error}"))

    def _fail_once(self, controller: Controller, reason: str) -> None:
        if all(other is not controller for other, _ in self.failed):
            self.failed.append((controller, reason))


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
