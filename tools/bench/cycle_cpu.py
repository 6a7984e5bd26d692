"""What a cycle costs: CPU time of the whole cycle of the runtime, per drive, on `memory:` with recorded drives.

    python tools/bench/cycle_cpu.py [DRIVES ...]        default: 2 16 64

The robot boots against virtual drives in simulated time and turns its wheels; then the drives are taken away and what
they sent in one cycle comes again and again, so that nothing but the master's own work is measured: receiving,
reading, the controllers, writing, packing and sending. `idle` repeats the same values, `moving` counts positions up.
"""

from __future__ import annotations

import gc
import sys
import tempfile
import time
import tracemalloc
from pathlib import Path

from canopen_control.bus.channel import open_port
from canopen_control.bus.memory import MemoryBus
from canopen_control.data_files import data_path
from canopen_control.frame import CanFrame, pack_records
from canopen_control.host.reactor import Reactor
from canopen_control.host.timer import ManualClock
from canopen_control.runtime.core import RobotCore, RobotState
from canopen_control.runtime.files import find_robot
from canopen_control.runtime.setup import read_robot
from canopen_control.virtual.device import make_device
from canopen_control.virtual.nodehost import NodeHost

CYCLES = 2000
STEP_NS = 20_000_000


def write_robot(folder: Path, count: int) -> Path:
    """Write a robot of `count` drives like those of robby."""
    robot = folder / f"fleet{count}"
    robot.mkdir()
    bus = data_path("config", "robby").joinpath("bus.yml").read_text()
    head = bus.partition("nodes:")[0].replace("baudrate: 1000 ", "baudrate: 1000")
    scale = "scale_pos_from_dev: 0.003926990816987242\n    scale_pos_to_dev: 254.64790894703253\n"
    scale += "    scale_vel_from_dev: 0.003926990816987242\n    scale_vel_to_dev: 254.64790894703253\n"
    nodes = "".join(f"  drive_{n}:\n    node_id: {n + 1}\n    {scale}" for n in range(1, count + 1))
    (robot / "bus.yml").write_text(f"{head}nodes:\n{nodes}")
    names = [f"joint_{n}" for n in range(1, count + 1)]
    (robot / "ros2_controllers.yaml").write_text(
        "controller_manager:\n  ros__parameters:\n    update_rate: 50\n"
        "    joint_state_broadcaster: {type: joint_state_broadcaster/JointStateBroadcaster}\n"
        "    forward: {type: forward_command_controller/ForwardCommandController}\n"
        f"forward:\n  ros__parameters:\n    joints: [{', '.join(names)}]\n    interface_name: velocity\n"
    )
    links = "<link name='base'/>" + "".join(f"<link name='link_{n}'/>" for n in range(1, count + 1))
    joints = "".join(
        f"<joint name='joint_{n}' type='continuous'><parent link='base'/><child link='link_{n}'/><axis xyz='0 0 1'/>"
        "</joint>"
        for n in range(1, count + 1)
    )
    control = "".join(
        f"<joint name='joint_{n}'><param name='device_name'>drive_{n}</param><command_interface name='velocity'/>"
        "<state_interface name='position'/><state_interface name='velocity'/></joint>"
        for n in range(1, count + 1)
    )
    plugin = "<hardware><plugin>canopen_control/CanopenSystem</plugin></hardware>"
    (robot / "fleet.urdf").write_text(
        f"<robot name='fleet{count}'>{links}{joints}"
        f"<ros2_control name='fleet' type='system'>{plugin}{control}</ros2_control></robot>"
    )
    return robot


class Fleet:
    """A robot of `count` drives that turns; afterwards its drives are gone and their frames recorded."""

    def __init__(self, folder: Path, count: int) -> None:
        self.count = count
        name = f"bench{count}"
        self.reactor = Reactor(ManualClock(1_000_000_000))
        self.bus = MemoryBus.get(name)
        setup = read_robot(find_robot(str(write_robot(folder, count))), can=[f"memory:{name}"])
        self.core = RobotCore(setup, self.reactor)
        devices = [make_device(setup.bus.eds_paths[n.name], n.node_id) for n in setup.bus.nodes.values()]
        port = open_port(f"memory:{name}", label="drives")
        host = NodeHost(self.reactor, port, devices)
        self.core.start()
        begin = time.process_time()
        self._until(lambda: self.core.state is RobotState.RUNNING)
        self.boot = time.process_time() - begin, (self.reactor.now() - 1_000_000_000) / 1e9
        self.core.command("forward", [10.0] * count, "bench")
        for _ in range(60):
            self.core.command("forward", [10.0] * count, "bench")
            self.reactor.run_for(STEP_NS)
        self.bus.clear_history()
        self.reactor.run_for(STEP_NS)
        pdos = {pdo.cob_id for node in self.core.nodes.values() for pdo in node.received}
        self.frames = [frame for _, frame in self.bus.history if frame.can_id in pdos]
        host.close()
        port.close()
        self.core.pacer.stop()
        self.feed = open_port(f"memory:{name}", label="recorded")
        assert len(self.frames) == 2 * count, len(self.frames)

    def _until(self, condition) -> None:  # noqa: ANN001
        for _ in range(3000):
            if condition():
                return
            self.reactor.run_for(10_000_000)
        raise SystemExit(f"not running: {[e.text for e in self.core.events.recent][-3:]}")

    def records(self, moving: bool) -> list[bytes]:
        """Return what comes in each cycle."""
        if not moving:
            return [pack_records(self.frames)]
        return [
            pack_records(
                [
                    CanFrame(
                        f.can_id, (int.from_bytes(f.data[:4], "little") + 50 * n).to_bytes(4, "little") + f.data[4:]
                    )
                    if len(f.data) == 8
                    else f
                    for f in self.frames
                ]
            )
            for n in range(64)
        ]

    def measure(self, moving: bool) -> tuple[float, int]:
        """Return the median microseconds of a cycle, and bytes that were still held after the cycles."""
        core, clock, feed = self.core, self.reactor.clock, self.feed
        records = self.records(moving)
        for n in range(50):
            self._cycle(core, clock, feed, records[n % len(records)])
        gc.collect()
        gc.disable()
        times = []
        for n in range(CYCLES):
            feed.send(records[n % len(records)])
            clock.now_ns += STEP_NS
            begin = time.perf_counter_ns()
            core._cycle(clock.now_ns)  # noqa: SLF001 - the cycle itself is what is measured
            times.append(time.perf_counter_ns() - begin)
            feed.receive()
            if n % 10 == 0:
                self.beat()
        gc.enable()
        return sorted(times)[CYCLES // 2] / 1000, self.growth(records)

    def growth(self, records: list[bytes]) -> int:
        """Return how many bytes of ours a hundred cycles leave behind."""
        self.bus.clear_history()
        tracemalloc.start()
        before = tracemalloc.take_snapshot()
        for n in range(100):
            self._cycle(self.core, self.reactor.clock, self.feed, records[n % len(records)])
        self.bus.clear_history()
        after = tracemalloc.take_snapshot()
        tracemalloc.stop()
        ours = [d for d in after.compare_to(before, "filename") if "canopen_control/" in d.traceback[0].filename]
        return sum(d.size_diff for d in ours if "memory.py" not in d.traceback[0].filename)

    def _cycle(self, core, clock, feed, record) -> None:  # noqa: ANN001
        feed.send(record)
        clock.now_ns += STEP_NS
        core._cycle(clock.now_ns)  # noqa: SLF001 - as above
        feed.receive()
        self.beat()

    def beat(self) -> None:
        """Keep the heartbeats coming, outside of what is measured."""
        self.feed.send(pack_records([CanFrame(0x700 + n.node_id, b"\x05") for n in self.core.nodes.values()]))
        self.core.buses["can"].receive()
        self.core.command("forward", [10.0] * self.count, "bench")


def main() -> None:
    """Print one line for each size."""
    sizes = [int(text) for text in sys.argv[1:]] or [2, 16, 64]
    print("drives  boot CPU s  simulated s   idle us/cycle (per drive)   moving us/cycle (per drive)  bytes left")
    for count in sizes:
        with tempfile.TemporaryDirectory() as folder:
            fleet = Fleet(Path(folder), count)
            idle, left = fleet.measure(moving=False)
            moving, _ = fleet.measure(moving=True)
            assert fleet.core.state is RobotState.RUNNING, [e.text for e in fleet.core.events.recent][-3:]
            print(
                f"{count:6d}  {fleet.boot[0]:10.3f}  {fleet.boot[1]:11.3f}   {idle:10.1f} ({idle / count:5.2f})       "
                f"      {moving:10.1f} ({moving / count:5.2f})        {left:8d}"
            )
            fleet.core.close()


if __name__ == "__main__":
    main()
