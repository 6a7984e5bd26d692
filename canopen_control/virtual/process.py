"""Virtual drives as an operating system process of their own, which knows nothing of any master.

It prints a line for each bus when its nodes are on it, then what happens to them, in words. SIGTERM and SIGINT end it
with exit code 0. When its parent dies (the lifeline breaks) it serves on until its drives stand still by their own
reaction to the missing master, five seconds at most. A channel that is only down is waited for; one that is gone is
opened again when it is back within three seconds, else BusClosed ends the process when it was the last one.
"""

from __future__ import annotations

import signal
from functools import partial
from typing import TYPE_CHECKING

from canopen_control.host.lifeline import lifeline_fd, report_ready
from canopen_control.virtual.served_bus import ServedBus
from canopen_control.virtual.shaft import ShaftWorld

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from canopen_control.errors import BusClosed
    from canopen_control.host.reactor import Reactor
    from canopen_control.virtual.plant import World
    from canopen_control.virtual.served_bus import BusNodes


__all__ = ["DriveProcess"]

_MS = 1_000_000
STANDSTILL_NS = 5_000 * _MS
_LOOK_NS = 20 * _MS


class DriveProcess:
    """The nodes of one process on the opened ports of their buses; `say` takes the lines of the log."""

    def __init__(self, reactor: Reactor, buses: Sequence[BusNodes], say: Callable[[str], None]) -> None:
        self._reactor, self._say = reactor, say
        self._buses: list[ServedBus] = []
        for bus in buses:
            log = partial(self._log, f"{bus.port.channel}: " if len(buses) > 1 else "")
            self._buses.append(ServedBus(reactor, bus, log, self._on_lost))
        self._early: list[str] | None = []  # what happened before the ready line
        self._started = reactor.now()
        self._lifeline = lifeline_fd()
        self._standstill_until: int | None = None
        self._ended = False  # also when that came before the loop that it ends
        self._lost: BusClosed | None = None

    def run(self) -> int:
        """Serve until a signal, or the parent's end; return the exit code. Raises BusClosed, or NodeIdTaken."""
        self._reactor.handle_signals({signal.SIGTERM: self._end, signal.SIGINT: self._end})
        try:
            for bus in self._buses:
                bus.open()
            self._serve()
        finally:
            for bus in self._buses:
                bus.close()
        if self._lost is not None:
            raise self._lost
        return 0

    def _serve(self) -> None:
        if self._lifeline is not None:
            self._reactor.add_reader(self._lifeline, self._on_orphaned)
        self._reactor.run_for(0)  # the boot-up messages are out before anybody reads the line
        for bus in self._buses:
            self._say(bus.ready_line)
        report_ready()
        for line in self._early or ():
            self._say(line)
        self._early = None
        for bus in self._buses:
            bus.play_timeline()
        self._plan_to_keep_up()
        if not self._ended:
            self._reactor.run()

    def _end(self) -> None:
        self._lost = None
        self._leave()

    def _leave(self) -> None:
        self._ended = True
        self._reactor.stop()

    @property
    def _worlds(self) -> list[World]:
        return [bus.world for bus in self._buses if bus.world is not None]

    def _plan_to_keep_up(self) -> None:
        periods = [world.period_ns for world in self._worlds if world.period_ns is not None]
        if periods:
            self._reactor.call_later(min(periods), self._keep_up)

    def _keep_up(self) -> None:
        """Bring all axes to the present, for a world that wants to know them."""
        self._advance()
        for world in self._worlds:
            if isinstance(world, ShaftWorld):
                world.publish()
        self._plan_to_keep_up()

    def _advance(self) -> None:
        now = self._reactor.now()
        for bus in self._buses:
            bus.advance(now)

    # -- what happens

    def _log(self, where: str, text: str) -> None:
        line = f"{(self._reactor.now() - self._started) * 1e-9:9.3f} {where}{text}"
        if self._early is None:
            self._say(line)
        else:
            self._early.append(line)

    def _on_lost(self) -> None:
        """End when the last bus is gone for good."""
        errors = [bus.error for bus in self._buses]
        if all(error is not None for error in errors):
            self._lost = errors[0]
            self._leave()

    def _on_orphaned(self) -> None:
        """Wait for the drives' own reaction to a missing master, then end."""
        if self._lifeline is not None:
            self._reactor.remove_reader(self._lifeline)
        self._log("", "the parent process is gone; ending when the drives stand still")
        self._standstill_until = self._reactor.now() + STANDSTILL_NS
        self._look_for_standstill()

    def _look_for_standstill(self) -> None:
        self._advance()
        if any(bus.moving for bus in self._buses) and self._reactor.now() < (self._standstill_until or 0):
            self._reactor.call_later(_LOOK_NS, self._look_for_standstill)
        else:
            self._leave()
