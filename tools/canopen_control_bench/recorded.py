"""A robot on `memory:` whose drives are recordings: measures the work of a cycle itself, without a wire.

The robot boots against virtual drives in simulated time and turns its wheels; then the drives are taken away, and what
they sent in one cycle comes again and again. Left are receiving, reading, the controllers, writing and sending.
"""

from __future__ import annotations

import contextlib
import time
from typing import TYPE_CHECKING

from canopen_control.bus.channel import open_port
from canopen_control.bus.memory import MemoryBus
from canopen_control.errors import CanopenError, NotEnabled
from canopen_control.frame import CanFrame, pack_records
from canopen_control.host.reactor import Reactor
from canopen_control.host.timer import ManualClock
from canopen_control.runtime.core import RobotCore, RobotState
from canopen_control.runtime.robot_files import find_robot
from canopen_control.runtime.setup import read_robot
from canopen_control.virtual.device import make_device
from canopen_control.virtual.node_host import NodeHost
from canopen_control_bench.fleet import CONTROLLER, write_fleet
from canopen_control_bench.slaves import replays

if TYPE_CHECKING:
    from pathlib import Path


STEP_NS = 20_000_000
_START_NS = 1_000_000_000
_BEAT_CYCLES = 5  # heartbeats are sent every 100 ms
_FORGET_CYCLES = 64
_BOOT_STEPS, _WARM_STEPS = 300, 60


class RecordedFleet:
    """A running robot with `count` drives; `cycle()` runs one cycle of it."""

    def __init__(self, folder: Path, count: int, *, moving: bool = True) -> None:
        self.count, self.cycles = count, 0
        self._clock = ManualClock(_START_NS)
        self._reactor = Reactor(self._clock)
        name = f"recorded{count}"
        self._bus = MemoryBus.get(name)
        setup = read_robot(find_robot(str(write_fleet(folder, count, STEP_NS // 1000))), can=[f"memory:{name}"])
        self.core = RobotCore(setup, self._reactor)
        frames = self._record(name)
        self._feed = open_port(f"memory:{name}", label="recorded")
        self._records = replays(frames) if moving else [pack_records(frames)]
        self._beats = pack_records([CanFrame(0x700 + node.node_id, b"\x05") for node in self.core.nodes.values()])

    def _record(self, name: str) -> list[CanFrame]:
        """Boot, turn the wheels, and return the TPDOs of one cycle."""
        core, reactor, bus = self.core, self._reactor, self._bus
        devices = [
            make_device(core.setup.bus.eds_paths[node.name], node.node_id) for node in core.setup.bus.nodes.values()
        ]
        port = open_port(f"memory:{name}", label="drives")
        host = NodeHost(reactor, port, devices)
        core.start()
        for _ in range(_BOOT_STEPS):
            if core.state is RobotState.RUNNING:
                break
            reactor.run_for(STEP_NS // 2)
        else:
            raise CanopenError(f"not running: {[event.text for event in core.events.recent][-3:]}")
        for _ in range(_WARM_STEPS):
            self._command()
            reactor.run_for(STEP_NS)
        bus.clear_history()
        reactor.run_for(STEP_NS)
        pdos = {pdo.cob_id for node in core.nodes.values() for pdo in node.received}
        frames = [frame for _, frame in bus.history if frame.can_id in pdos]
        host.close()
        port.close()
        core.pacer.stop()
        for other in core.buses.values():
            other.watch()  # `cycle` reads the frames that it feeds
            other.receive()
        if len(frames) != len(pdos):
            raise CanopenError(f"{len(frames)} TPDOs were recorded of {len(pdos)}")
        return frames

    def cycle(self) -> int:
        """Run one cycle and return its duration in ns."""
        feed, clock = self._feed, self._clock
        if self.cycles % _BEAT_CYCLES == 0:
            self._command()
            feed.send(self._beats)
        feed.send(self._records[self.cycles % len(self._records)])
        clock.now_ns += STEP_NS
        begin = time.perf_counter_ns()
        for bus in self.core.buses.values():
            bus.receive()
        self.core.cycle.step_now(clock.now_ns)
        took = time.perf_counter_ns() - begin
        self.cycles += 1
        sent = feed.receive()
        if len(sent) < 16:
            raise CanopenError(f"cycle {self.cycles} sent {len(sent)} bytes")
        if self.cycles % _FORGET_CYCLES == 0:
            self._bus.clear_history()  # the test bus keeps all frames; this one does not
        return took

    def _command(self) -> None:
        with contextlib.suppress(NotEnabled):  # `check` reports a robot that has stopped
            self.core.command(CONTROLLER, [10.0] * self.count, "bench")

    def check(self) -> None:
        """Raise CanopenError if the robot or any joint has stopped running."""
        if self.core.state is not RobotState.RUNNING or not all(joint.enabled for joint in self.core.joints.values()):
            raise CanopenError(f"stopped running: {[event.text for event in self.core.events.recent][-3:]}")

    def close(self) -> None:
        """Close the robot and its bus."""
        self.core.close()
        self._feed.close()
        self._reactor.close()
