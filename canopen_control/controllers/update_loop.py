"""The active controllers: their updates in the cycle, their commands and samples.

`UpdateLoop.update` and `UpdateLoop.broadcast` iterate over lists made at the last switch and never raise; a controller
that fails is added to `failed`, for the manager to stop it. A controller runs after the controllers that command it.

Rules (ros2_control jazzy): a controller slower than the cycle runs in the cycle nearest to its period. Safer than
upstream: a command is cleared in the cycle in which one of its interfaces is no longer enabled.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from canopen_control.controllers.base import ControllerEvent, EnableStatus, is_moving, sample_type_of
from canopen_control.controllers.chains import hardware_interfaces_of, in_order
from canopen_control.hardware.interfaces import OK

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Sequence

    from canopen_control.controllers.base import Controller
    from canopen_control.hardware.interfaces import CommandInterface
    from canopen_control.rpc.messages.samples import ControllerSample


NS: Final = 1_000_000_000
NOT_DUE: Final = -1.0
_NEVER: Final = -1

Interfaces = tuple["CommandInterface", ...]
_EVERY_CYCLE: Final = 0.99  # from this fraction of the cycle rate on, the manager runs in every cycle

Failures = list[tuple["Controller", str]]
Samples = dict[str, "ControllerSample"]


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
