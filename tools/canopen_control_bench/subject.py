"""The complete runtime as a measured program: like `canopen-control run`, with lateness and work of each cycle.

Paced turns leave the runtime as it is; a hook at the end of each cycle keeps three numbers. Free-running turns stop the
pacer and begin each cycle when the last TPDO of the one before has come, through the same reactor and the same ports.
Drives are there already; the flight recorder, a process of its own, is off.

    python -m canopen_control_bench.subject FOLDER NAME CHANNEL[,BUS=CHANNEL...] [PROCESSOR]

With a processor it runs there and with `--realtime`.
"""

from __future__ import annotations

import json
import os
import sys
import time
from typing import TYPE_CHECKING

from canopen_control.errors import CanopenError
from canopen_control.runtime.observer import RobotObserver
from canopen_control.runtime.realtime import DEFAULT_PRIORITY
from canopen_control.runtime.robot_files import find_robot
from canopen_control.runtime.run_session import RunOptions, RunSession
from canopen_control.runtime.setup import read_robot
from canopen_control_bench.turns import Turn, say

if TYPE_CHECKING:
    from canopen_control.master.cycle import ReceivedPdo


class _SubjectObserver(RobotObserver):
    def __init__(self, subject: Subject) -> None:
        self._subject = subject

    def running(self) -> None:
        self._subject.running()

    def after_cycle(self, now: int) -> None:
        self._subject.take_cycle(now)


class Subject:
    """A session that runs turns ordered over standard input."""

    def __init__(self, session: RunSession) -> None:
        self.session, self.robot, self.reactor = session, session.robot, session.reactor
        self._buses, self._now, self._step = [*self.robot.buses.values()], self.reactor.now, self.robot.cycle.step_now
        self._turn: Turn | None = None
        self._left = 0
        self._free = False
        self._missed = self._tpdos = 0
        self._began = self._cpu = 0
        self._edge = 0
        self._last: list[ReceivedPdo] = []
        self._buffer = b""
        self._observer = _SubjectObserver(self)
        self.robot.observers.insert(0, self._observer)

    def run(self) -> str | None:
        """Serve until the robot has stopped; return the reason for a failure, or None."""
        return self.session.run()

    def running(self) -> None:
        """Serve orders from now on."""
        self._last = [
            node.received[-1] for bus in self.robot.buses.values() for node in [*bus.network.nodes.values()][-1:]
        ]
        self.reactor.add_reader(0, self._on_order)
        say({"ready": True})

    def _on_order(self) -> None:
        data = os.read(0, 65536)
        self._buffer += data or b'"end"\n'
        *lines, self._buffer = self._buffer.split(b"\n")
        for line in lines:
            order = json.loads(line)
            if order == "end":
                self.reactor.remove_reader(0)
                self.robot.shutdown("measured")
            else:
                self._begin(order["cycles"], free=not order["period_ns"])

    def _begin(self, cycles: int, *, free: bool) -> None:
        self._left, self._free = cycles, free
        if free:
            self.robot.pacer.stop()
            self.robot.observers.remove(self._observer)
            for bus in self.robot.buses.values():
                assert bus.port is not None
                bus.watch()
                self.reactor.add_reader(bus.port.fileno(), self._on_answer)
        self._missed, self._tpdos = self.robot.pacer.missed, self._count_tpdos()
        self.robot.pacer.late_max = 0
        self._turn, self._cpu, self._began = Turn(cycles=cycles), time.process_time_ns(), time.monotonic_ns()
        if free:
            self._cycle()

    def take_cycle(self, now: int) -> None:
        """Record the cycle; `late_max` is reset each time, so that it covers this cycle only."""
        turn = self._turn
        if turn is None:
            return
        turn.work_ns.append(self.robot.cycle.sent_at - now)
        turn.whole_ns.append(time.monotonic_ns() - now)
        late, self.robot.pacer.late_max = self.robot.pacer.late_max, 0
        turn.late_ns.append(late)
        if late >= self.robot.pacer.period_ns:
            turn.stalls.append((now - late, now))
        self._left -= 1
        if self._left == 0:
            self._end(turn)

    def _on_answer(self) -> None:
        for bus in self._buses:
            bus.receive()
        for pdo in self._last:
            if pdo.stamp < self._edge:
                return
        if self._turn is not None:
            self._left -= 1
            if self._left:
                self._cycle()
            else:
                self._end(self._turn)

    def _cycle(self) -> None:
        self._edge = edge = self._now()
        self._step(edge)
        if self._last and self._last[-1].stamp >= edge:  # a late cycle reads waiting frames without a wake-up
            self.reactor.call_soon(self._on_answer)

    def _count_tpdos(self) -> int:
        return sum(pdo.count for node in self.robot.nodes.values() for pdo in node.received)

    def _end(self, turn: Turn) -> None:
        turn.cpu_ns, turn.wall_ns = time.process_time_ns() - self._cpu, time.monotonic_ns() - self._began
        turn.missed, turn.tpdos = self.robot.pacer.missed - self._missed, self._count_tpdos() - self._tpdos
        self._turn = None
        if self._free:
            for bus in self.robot.buses.values():
                bus.watch()
            self.robot.observers.insert(0, self._observer)
            self.robot.pacer.start()
        turn.say()


def options(cpu: int | None = None) -> RunOptions:
    """Return the run options: existing drives; a reserved CPU with real-time priority."""
    return RunOptions(drives=False, realtime=None if cpu is None else DEFAULT_PRIORITY, cpu=cpu)


def main(arguments: list[str]) -> int:
    """Run the robot and its turns."""
    folder, name, channels, *cpu = arguments
    setup = read_robot(find_robot(folder), name=name, can=channels.split(","))
    session = RunSession(setup, options(*map(int, cpu)))
    try:
        failure = Subject(session).run()
    finally:
        session.close()
    if failure is not None:
        raise CanopenError(failure)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
