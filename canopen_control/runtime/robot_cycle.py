"""Control cycle of a robot: SYNC where it precedes the PDOs, read, update, write, the PDOs, publish, supervise.

Controllers run on a fixed grid of cycle edges: their time is the time of the edge and their period is the period of
the grid, however late the thread was scheduled, so a late cycle sends the set-point of its edge. After skipped edges
they continue with the set-point of the newest edge, but for at most `CAUGHT_UP` skipped edges: further time is
dropped, since a drive that has stopped meanwhile must not be commanded the whole distance in one period. Written
targets always apply to one period: no target moves further than the drive's velocity allows in one period. Timeouts
of frames and of supervision use the actual time. A simulated robot without buses has no frames to wait for: its
components are read at the edges too, and its cycle does not run while its time is paused (`robot_clock`).

The cycle is a module of its own because nothing else runs in every period; `core` starts and stops the robot, and
accepts its commands.
"""

from __future__ import annotations

import contextlib
from abc import ABCMeta, abstractmethod
from typing import TYPE_CHECKING, Final

from canopen_control.hardware.interfaces import ERROR
from canopen_control.runtime.robot_clock import RobotClock

if TYPE_CHECKING:
    from canopen_control.controllers.manager import ControllerManager
    from canopen_control.hardware.interfaces import HardwareComponent
    from canopen_control.host.reactor import Reactor
    from canopen_control.runtime.assembly import Assembly
    from canopen_control.runtime.pacer import Pacer


_CHECK_NS: Final = 100_000_000  # interval at which each bus selects reception by the reactor or at the edges
CAUGHT_UP: Final = 2  # maximum number of skipped edges whose time counts
RAISED_CYCLES: Final = 3  # consecutive cycles with an exception, after which the robot stops
_RAISED_NS: Final = 1_000_000_000  # time for quick stops of a robot whose cycle cannot be completed


class CycledRobot(metaclass=ABCMeta):
    """Robot as its cycle sees it; `advances` is True while `advance` must be called in each cycle."""

    advances: bool

    @abstractmethod
    def advance(self, now: int) -> None:
        """Execute the next step of starting or stopping."""

    @abstractmethod
    def after_cycle(self, now: int) -> None:
        """Settle requests, report new events and call the observers, after the frames of a cycle are sent."""

    @abstractmethod
    def fail(self, text: str) -> None:
        """Report `text` as the failure of the run, and shut down."""

    @abstractmethod
    def end_without_cycle(self) -> None:
        """Close the buses of a robot whose cycle cannot confirm a stop; the drives miss the master's heartbeat."""


class RobotCycle:
    """Control cycle of a robot, run at the edges of `pacer`; `sent_at` is the time of the last transmission in ns.

    Each cycle also advances the start or the stop of `robot`. `clock` is the time of the controllers.
    """

    def __init__(
        self,
        pacer: Pacer,
        assembly: Assembly,
        manager: ControllerManager,
        reactor: Reactor,
        robot: CycledRobot,
    ) -> None:
        self.sent_at = 0
        self._pacer, self._manager, self._reactor, self._robot = pacer, manager, reactor, robot
        self._registry = assembly.registry
        self._buses, self._systems = list(assembly.buses.values()), assembly.systems
        self._sync_first = [bus for bus in self._buses if bus.sends_sync_first]
        self._following = [bus for bus in self._buses if bus.follows_sync]
        self._period = pacer.period_ns / 1e9
        self._next_supervision = 0
        self._raised: tuple[str, Exception] | None = None  # first exception of this cycle, and where it was raised
        self._raised_cycles = self._raised_since = 0
        self._abandoned: list[HardwareComponent] = []  # components that are no longer written
        times = [component.simulated_ns for component in self._registry.components]
        simulated = not self._buses and any(time_ns is not None for time_ns in times)
        self.clock = RobotClock(reactor, pacer.period_ns, simulated=simulated)

    def step(self, now: int) -> None:
        """Execute one cycle, after the frames from ports that the reactor watches have been processed.

        The first exception of a cycle is raised at its end. After `RAISED_CYCLES` such cycles in a row the robot stops.
        """
        complete = False
        try:
            if self.clock.simulated:
                self._simulate(now)
            else:
                self._exchange(now)
            complete = True
        except Exception as error:  # noqa: BLE001 - it is raised again after the robot was stopped
            self._raised = self._raised or ("the cycle", error)
        if self._raised is not None:
            self._end_raised_cycle(now, complete=complete)
        elif self._raised_cycles:
            self._raised_cycles = 0

    def _exchange(self, now: int) -> None:
        """Execute one cycle of a robot that is not simulated."""
        pacer = self._pacer
        for bus in self._buses:
            if not bus.watched:
                bus.receive(pacer.edge)
        for bus in self._sync_first:
            bus.send_sync(now)
        period = self._period_after_skipping(skipped, now) if (skipped := pacer.skipped) else self._period
        components, manager, edge = self._registry.components, self._manager, pacer.edge
        for component in components:
            self._read(component, now, period)
        if self._robot.advances:
            self._robot.advance(now)
        try:
            manager.update(edge, period)
        except Exception as error:  # noqa: BLE001 - the components write what is commanded
            self._note("the update of the controllers", error)
        for component in components:
            self._write(component, now)
        for bus in self._buses:
            bus.send_cycle(now)
        self.sent_at = self._reactor.now()
        manager.broadcast(edge, period)
        self._supervise(now)
        self._robot.after_cycle(now)

    def _read(self, component: HardwareComponent, now: int, period: float) -> None:
        try:
            if component.read(now, period) is ERROR:
                self._failed(component, "read", now)
        except Exception as error:  # noqa: BLE001 - the other components continue
            self._note(f"read of {component.name}", error)

    def _write(self, component: HardwareComponent, now: int) -> None:
        """Write the commands of a component, unless its `write` has raised exceptions too often."""
        if component in self._abandoned:
            return
        try:
            if component.write(now, self._period) is ERROR:
                self._failed(component, "write", now)
        except Exception as error:  # noqa: BLE001 - the other components continue
            self._note(f"write of {component.name}", error)
            if self._raised_cycles + 1 >= RAISED_CYCLES:
                self._abandon(component)

    def _note(self, where: str, error: Exception) -> None:
        self._raised = self._raised or (where, error)

    def _abandon(self, component: HardwareComponent) -> None:
        """Do not write a component again; its drives get a quick stop, which needs no cycle."""
        if component not in self._abandoned:
            self._abandoned.append(component)
        for system in self._systems:
            if system is component:
                system.quick_stop_outputs()

    def _end_raised_cycle(self, now: int, *, complete: bool) -> None:
        """Count cycles in a row with an exception, stop the robot if there are too many, and raise the exception.

        If the cycle itself cannot be completed, all drives get a quick stop, and the buses are closed after a second.
        """
        assert self._raised is not None
        (where, error), self._raised = self._raised, None
        self._raised_cycles += 1
        if self._raised_cycles == RAISED_CYCLES:
            self._raised_since = now
            text = f"{where} raised {type(error).__name__} in {RAISED_CYCLES} cycles in a row: {error}"
            self._robot.fail(f"{text}; the drives are stopped, correct the program before you start it again")
        if self._raised_cycles >= RAISED_CYCLES and not complete:
            for system in self._systems:
                self._abandon(system)
            for bus in self._buses:
                with contextlib.suppress(Exception):
                    bus.send_cycle(now)
            if now - self._raised_since > _RAISED_NS:
                self._robot.end_without_cycle()
        raise error

    def _simulate(self, now: int) -> None:
        """Execute one cycle of a simulated robot without buses; while paused, execute requested steps only."""
        clock, edge, skipped = self.clock, self._pacer.edge, self._pacer.skipped
        if self._robot.advances:
            self._robot.advance(now)
        if clock.take(edge):
            self._run_edge(
                clock.edge, self._period_after_skipping(skipped, now) if skipped and not clock.paused else self._period
            )
            until = now + self._pacer.period_ns // 2
            while clock.paused and self._reactor.now() < until and clock.take_step(edge):
                self._run_edge(clock.edge, self._period)
        self.sent_at = self._reactor.now()
        self._robot.after_cycle(now)
        if clock.paused:
            clock.report_steps()

    def _run_edge(self, edge: int, period: float) -> None:
        """Read the components, update the controllers and write the commands at an edge, then publish the states."""
        for component in self._registry.components:
            self._read(component, edge, period)
        self._manager.update(edge, period)
        for component in self._registry.components:
            self._write(component, edge)
        self._manager.broadcast(edge, period)

    def _period_after_skipping(self, skipped: int, now: int) -> float:
        """Return the period in s of a cycle after skipped edges, and report the edges to the hardware components."""
        if not self._following:
            self._report_skipped_edges(skipped)
        without_master = [node for bus in self._buses for node in bus.network.without_master(now, self.sent_at)]
        for system in self._systems if without_master else ():
            system.stop_without_master(without_master, now)
        return self._period * (1 + min(skipped, CAUGHT_UP))

    def step_now(self, now: int) -> None:
        """Execute a cycle at `now`, for callers that do not run the pacer and have received all frames."""
        self._pacer.edge, self._pacer.skipped = now, 0
        self.step(now)

    def _supervise(self, now: int) -> None:
        """Check heartbeats, timeouts and periodic tasks after the frames of a cycle are sent."""
        for bus in self._buses:
            bus.tick(now)
        if now >= self._next_supervision and self._pacer.running:
            self._next_supervision = now + _CHECK_NS
            for bus in self._buses:
                bus.select_reception()
        for system in self._systems:
            system.supervise(now)
        for bus in self._following:
            if (edges := bus.unserved_syncs()) > 0:
                self._report_skipped_edges(edges)

    def _report_skipped_edges(self, edges: int) -> None:
        for system in self._systems:
            system.count_skipped_edges(edges)

    def _failed(self, component: HardwareComponent, verb: str, now: int) -> None:
        self._manager.deactivate_using(component, f"{component.name} reported an error on {verb}", now)
