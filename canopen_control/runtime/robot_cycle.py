"""One cycle of the robot: SYNC where it goes first, read, update, write, send, and what can wait until after that.

The law of this file: controllers live on the grid. The time that they get is that of the edge, and the period is that
of the grid, however late the process woke: a late cycle sends the set-point of its edge. After edges that were skipped
they go on with the set-point of the newest one, but for `CAUGHT_UP` skipped edges at most: for the others their time
stands, since a drive that has stopped meanwhile must not be told to make up for all of it in one period. What is
written is for one period all the same: no target moves by more than the drive's velocity makes of that. What waits for
frames or watches others goes by the clock. A simulated robot without buses has no frames to wait for: its components
read at the edges too, and where its time stands (`robot_clock`) there is no cycle.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from canopen_control.hardware.interfaces import ERROR
from canopen_control.runtime.robot_clock import RobotClock

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.controllers.manager import ControllerManager
    from canopen_control.hardware.interfaces import HardwareComponent
    from canopen_control.host.reactor import Reactor
    from canopen_control.runtime.assembly import Assembly
    from canopen_control.runtime.pacer import Pacer

__all__ = ["CAUGHT_UP", "RobotCycle"]

_LOOK_NS: Final = 100_000_000  # from one look at what buses wait for to the next
CAUGHT_UP: Final = 2  # skipped edges whose set-points are passed over


class RobotCycle:
    """The cycle of a robot at the edges of `pacer`; `sent_at` is when the newest cycle's frames had left.

    `advance` takes the steps of starting and stopping, None while the robot runs; `after` comes last. `clock` is the
    time that the controllers have.
    """

    def __init__(
        self,
        pacer: Pacer,
        made: Assembly,
        manager: ControllerManager,
        reactor: Reactor,
        advance: Callable[[int], None],
        after: Callable[[int], None],
    ) -> None:
        self.sent_at = 0
        self.advance: Callable[[int], None] | None = advance
        self._pacer, self._manager, self._reactor, self._after = pacer, manager, reactor, after
        self._registry = made.registry
        self._buses, self._systems = list(made.buses.values()), made.systems
        self._sync_first = [bus for bus in self._buses if bus.sends_sync_first]
        self._following = [bus for bus in self._buses if bus.follows_sync]
        self._period = pacer.period_ns / 1e9
        self._look_at = 0
        times = [each.simulated_ns for each in self._registry.components]
        simulated = not self._buses and any(each is not None for each in times)
        self.clock = RobotClock(reactor, pacer.period_ns, simulated=simulated)

    def step(self, now: int) -> None:
        """Do a cycle with all that has come: ports that are watched were served before, as in every turn."""
        if self.clock.simulated:
            self._simulate(now)
        else:
            self._exchange(now)

    def _exchange(self, now: int) -> None:
        """Do the cycle of a robot on its buses, or of one without that lives in this computer's time."""
        pacer = self._pacer
        for bus in self._buses:
            if not bus.watched:
                bus.receive(pacer.edge)
        for bus in self._sync_first:
            bus.send_sync(now)
        period = self._skip(skipped) if (skipped := pacer.skipped) else self._period
        components, manager, edge = self._registry.components, self._manager, pacer.edge
        for component in components:
            if component.read(now, period) is ERROR:
                self._failed(component, "read", now)
        if self.advance is not None:
            self.advance(now)
        manager.update(edge, period)
        for component in components:
            if component.write(now, self._period) is ERROR:
                self._failed(component, "write", now)
        for bus in self._buses:
            bus.send_cycle(now)
        self.sent_at = self._reactor.now()
        manager.broadcast(edge, period)
        self._supervise(now)
        self._after(now)

    def _simulate(self, now: int) -> None:
        """Do the cycle of a robot without buses, none while its time stands, or those that it is to step."""
        clock, edge, skipped = self.clock, self._pacer.edge, self._pacer.skipped
        if self.advance is not None:
            self.advance(now)
        if clock.take(edge):
            self._turn(clock.edge, self._skip(skipped) if skipped and not clock.paused else self._period)
            until = now + self._pacer.period_ns // 2
            while clock.paused and self._reactor.now() < until and clock.take_step(edge):
                self._turn(clock.edge, self._period)
        self.sent_at = self._reactor.now()
        self._after(now)
        if clock.paused:
            clock.tell_steps()

    def _turn(self, edge: int, period: float) -> None:
        """Read, update and write at an edge, and tell what became of it."""
        for component in self._registry.components:
            if component.read(edge, period) is ERROR:
                self._failed(component, "read", edge)
        self._manager.update(edge, period)
        for component in self._registry.components:
            if component.write(edge, self._period) is ERROR:
                self._failed(component, "write", edge)
        self._manager.broadcast(edge, period)

    def _skip(self, skipped: int) -> float:
        """Take that edges were skipped; return the time on the grid since the last cycle in s."""
        if not self._following:
            self._skipped(skipped)
        return self._period * (1 + min(skipped, CAUGHT_UP))

    def step_now(self, now: int) -> None:
        """Do a cycle that is of no edge, for whoever does not leave them to the pacer and has read what has come."""
        self._pacer.edge, self._pacer.skipped = now, 0
        self.step(now)

    def _supervise(self, now: int) -> None:
        """Let time pass for what acts in the next cycle: heartbeats, time-outs, what is looked at now and then."""
        for bus in self._buses:
            bus.tick(now)
        if now >= self._look_at and self._pacer.running:
            self._look_at = now + _LOOK_NS
            for bus in self._buses:
                bus.rest_or_watch()
        for system in self._systems:
            system.supervise(now)
        for bus in self._following:
            if (edges := bus.unserved_syncs()) > 0:
                self._skipped(edges)

    def _skipped(self, edges: int) -> None:
        for system in self._systems:
            system.skipped(edges)

    def _failed(self, component: HardwareComponent, verb: str, now: int) -> None:
        self._manager.deactivate_using(component, f"{component.name} reported an error on {verb}", now)
