"""A late process reports no drive for its own delay: frames waiting at the port count. Drives have their own clock."""

import itertools

import pytest
from support.faultbench import CYCLE_MS, LEFT, RIGHT, FaultBench
from support.robots import MS, copy_robby

from canopen_control.bus.channel import open_port
from canopen_control.host.reactor import Reactor
from canopen_control.host.timer import ManualClock
from canopen_control.runtime.core import RobotState
from canopen_control.virtual.device import make_device
from canopen_control.virtual.node_host import NodeHost

DEFAULT = {"  missed_syncs: 10": "  # missed_syncs: 10"}  # three SYNCs
#: drives that do not mind that their master is silent, and are watched by it
SHORT = {**DEFAULT, "  heartbeat_consumer: true ": "  heartbeat_consumer: false\n  allow_unsupervised: true "}


class LateBench(FaultBench):
    """The drives go on while the robot's process does not."""

    apart = None

    def power_on(self, node_id, faults=()):
        self.apart = self.apart or Reactor(ManualClock(self.reactor.now()))
        node = next(item for item in self.setup.bus.nodes.values() if item.node_id == node_id)
        port = open_port(self.channel, label=f"drive {node_id}")
        device = make_device(self.setup.bus.eds_paths[node.name], node_id, faults)
        self.drives[node_id], self.ports[node_id] = device, port
        self.hosts[node_id] = NodeHost(self.apart, port, [device])

    def run(self, ms):
        for _ in range(round(ms)):
            self.apart.run_for(MS)
            super().run(1)

    def block(self, ms):
        """Let the robot's process be stopped for a time, and the bus go on."""
        self.apart.run_for(ms * MS)
        self.reactor.clock.now_ns += ms * MS

    def close(self):
        super().close()
        self.apart.close()


@pytest.fixture
def late(request, tmp_path):
    created = []

    def make(bus=DEFAULT):
        created.append(LateBench(f"late{abs(hash(request.node.nodeid)) % 10**9}", config=copy_robby(tmp_path, bus=bus)))
        return created[-1].turning()

    yield make
    for bench in created:
        bench.close()


def troubles(bench):
    return [event.text for event in bench.events if event.level > 1]


@pytest.mark.parametrize("ms", [30, 70, 200, 300, 450, 700, 1700])
def test_a_process_that_is_stopped_and_continues_stops_nothing(late, ms):
    bench = late(SHORT)
    for _ in range(3):
        bench.block(ms)
        bench.hold(10.0, 10.0, ms=300)
    assert troubles(bench) == []
    assert bench.robot.state is RobotState.RUNNING
    assert not bench.standing()


@pytest.mark.sources  # the manager's method is replaced
def test_a_process_that_is_stopped_within_many_a_cycle_stops_nothing(late):
    """The answers come while a cycle is under way, after the port was read in it."""
    bench = late()
    slow, cycles = bench.robot.manager.update, itertools.count()

    def update(now, period):
        if next(cycles) % 4 == 0:
            bench.block(50)
        slow(now, period)

    bench.robot.manager.update = update
    for _ in range(20):
        bench.command(10.0, 10.0)
        bench.run(100)
    bench.robot.manager.update = slow
    assert troubles(bench) == []


@pytest.mark.parametrize("blocks", [(), (25,), (70,)])
def test_a_drive_that_is_silent_is_found_by_a_late_process_too(late, blocks):
    bench = late()
    bench.switch("tpdo_missing")
    for ms in blocks:
        bench.run(15)
        bench.block(ms)
    _, after = bench.collected("stop", ms=400)
    assert after <= 5 * CYCLE_MS + sum(blocks) + 20
    bench.stopped_after()


def test_a_drive_that_is_silent_for_all_that_time_is_lost_when_the_process_is_back(late):
    bench = late()
    bench.switch("heartbeat_lost")
    bench.block(700)
    bench.run(2 * CYCLE_MS)
    assert bench.texts("heartbeat_lost")
    bench.stopped_after()


@pytest.mark.rest
def test_a_second_device_is_found_after_a_stop_of_the_process_and_none_by_it(late):
    bench = late(SHORT)
    bench.block(1700)
    bench.hold(10.0, 10.0, ms=2000)
    assert bench.texts("duplicate_node") == []
    bench.switch("duplicate_node")
    bench.hold(10.0, 10.0, ms=2000)
    assert len(bench.texts("duplicate_node")) == 1


@pytest.mark.rest
@pytest.mark.parametrize("node", [LEFT, RIGHT])
def test_a_stop_for_stale_feedback_suggests_what_to_call(late, node):
    bench = late()
    bench.switch("tpdo_missing", node=node)
    event, _ = bench.collected("stop")
    assert "to continue: canopen-control axis enable all" in event.text
    bench.switch("tpdo_missing", on=False, node=node)
    bench.run(2500)
    bench.goes_on()
