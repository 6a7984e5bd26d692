"""A robot with external SYNC: its cycle follows, and the absence of SYNC is reported and repaired."""

import itertools
import random

import pytest
from support.observers import Observer
from support.robots import LEFT, MS, RIGHT, Bench

from canopen_control.bus.channel import open_port
from canopen_control.errors import BusError
from canopen_control.frame import CanFrame, pack_records
from canopen_control.runtime.robot_bus import ExternalSync, NodeSync

PERIOD_NS = 20 * MS


class Kernel:
    """Sends SYNC on a memory bus as the broadcast manager would, by the simulated clock; `refuses` is its answer."""

    sender, correction = "the kernel", "it is set up again"

    def __init__(self, bench):
        self._reactor, self._port = bench.reactor, open_port(bench.channel, label="kernel")
        self.starts, self.sent, self.refuses = [], [], None
        self.task = 0

    def start(self, period_us):
        if self.refuses is not None:
            raise BusError(self.refuses)
        self.task += 1
        self.starts.append(period_us)
        self._send(self.task)

    def _send(self, task):
        if task == self.task:
            self.sent.append(self._reactor.now())
            self._port.send(pack_records([CanFrame(0x80)]))
            self._reactor.call_later(PERIOD_NS, lambda: self._send(task))

    def close(self):
        self.task += 1

    def end(self):
        self.close()
        self._port.close()


@pytest.fixture
def following(monkeypatch):
    """Return what makes a bench whose kernel sends SYNC."""
    benches = []

    def make(name):
        bench = Bench(name)
        bench.kernel = Kernel(bench)
        monkeypatch.setattr("canopen_control.runtime.robot_bus.KernelSync", lambda *_: bench.kernel)
        bench.robot.buses["can"].leave_sync_to_kernel(bench.robot.pacer.lead)
        benches.append(bench)
        return bench

    yield make
    for bench in benches:
        bench.kernel.end()
        bench.close()


def test_the_cycle_follows_half_a_period_after_the_kernels_sync_and_sends_none_itself(following):
    bench = following("kernel1")
    cycles = []
    bench.robot.observers.append(Observer(after_cycle=cycles.append))
    bench.start()
    bench.hold(10.0, -10.0, ms=1000)
    assert [bench.velocity(node) for node in (LEFT, RIGHT)] == pytest.approx([10.0, -10.0], rel=0.01)
    behind = {(cycle - bench.kernel.sent[0]) % PERIOD_NS for cycle in cycles[-20:]}
    assert all(abs(item - PERIOD_NS // 2) <= PERIOD_NS // 64 for item in behind), behind
    senders = {label for label, frame in bench.bus.history if frame.can_id == 0x80}
    assert senders == {"kernel"}
    assert bench.kernel.starts == [20_000]
    assert bench.texts("sync_lost") == []


def test_the_kernel_sends_until_the_robot_has_left_the_bus(following):
    bench = following("kernel2")
    bench.start()
    bench.hold(5.0, 5.0, ms=500)
    bench.robot.shutdown("the test ends it")
    bench.until(lambda: bench.texts("stopped"))
    last = bench.kernel.sent[-1]
    assert bench.reactor.now() - last <= 2 * PERIOD_NS, "the drives need it for their ramps"
    bench.run(200)
    assert bench.kernel.sent[-1] == last


def test_sync_that_is_not_received_is_reported_once_and_set_up_again_while_the_cycle_continues(following):
    bench = following("kernel3")
    bench.start()
    bench.hold(5.0, 5.0, ms=500)
    bench.kernel.close()
    bench.kernel.refuses = "bus can: the kernel does not send SYNC: No such device"
    count = bench.robot.pacer.count
    bench.run(2000)
    assert bench.robot.pacer.count - count == pytest.approx(100, abs=2)
    assert bench.texts("sync_lost") == [
        "no SYNC is received from the kernel; bus can: the kernel does not send SYNC: No such device"
    ]
    assert not any(node.ready and not node.stale for node in bench.robot.nodes.values()), (
        "its drives have fallen silent"
    )
    bench.kernel.refuses = None
    bench.run(1000)
    assert len(bench.kernel.starts) == 2
    bench.until(lambda: all(not node.stale for node in bench.robot.nodes.values()))
    assert len(bench.texts("sync_lost")) == 1


def test_a_start_that_the_kernel_refuses_is_a_bus_error_and_leaves_nothing_open(following):
    bench = following("kernel4")
    bench.kernel.refuses = "no broadcast manager"
    with pytest.raises(BusError, match="no broadcast manager"):
        bench.robot.start()
    assert bench.robot.buses["can"].port is None


def test_a_bus_that_leads_no_cycle_watches_its_sync_all_the_same():
    class Task:
        starts = closes = 0
        sender, correction = "the kernel", "it is set up again"

        def start(self, period_us):
            self.starts += 1

        def close(self):
            self.closes += 1

    task, reported = Task(), []
    sync = ExternalSync(task, 20_000, None, reported.append)
    sync.start(0)
    for now in range(0, 3000 * MS, 20 * MS):
        sync.receive_sync(now)
        sync.tick(now)
    assert (task.starts, reported) == (1, [])
    for now in range(3000 * MS, 4800 * MS, 20 * MS):
        sync.tick(now)
    assert (task.starts, task.closes, len(reported)) == (5, 4, 1), "each half a second, and reported once"


def test_the_first_sync_of_a_node_that_has_to_boot_is_waited_for_and_its_absence_suggests_what_to_do():
    reports = []
    sync = ExternalSync(NodeSync(), 10_000, None, reports.append, first_wait_ns=5000 * MS)
    sync.start(0)
    for now in range(0, 5000 * MS, 100 * MS):
        sync.tick(now)
    assert reports == []
    sync.tick(5300 * MS)
    assert [event.text for event in reports] == [
        "no SYNC is received from a node of the bus (sync_producer: other); the cycle continues by its own clock, and "
        "drives that wait for SYNC do not move; enable SYNC production in a node (0x1005)"
    ]
    sync.close()


class Slow:
    """A kernel that adds its latency to each period, and a process that hears SYNC up to 2 ms late."""

    sender, correction = "the kernel", "it is set up again"

    def __init__(self, latency_ns):
        self.latency_ns, self.collected = latency_ns, []

    def start(self, period_us):
        self.collected.append(period_us)

    adjust = start

    def close(self):
        pass


def heard_by_a_late_process(task, syncs, stalls=(), period_us=10_000):
    """Let so many SYNCs come, each stall of which delays all after it; return the periods between the last hundred."""
    sync, chance, sent = ExternalSync(task, period_us, None, print), random.Random(5), []
    sync.start(0)
    now = 0
    for number in range(syncs):
        now += task.collected[-1] * 1000 + task.latency_ns + (5 * MS if number in stalls else 0)
        sent.append(now)
        sync.receive_sync(now + round(chance.random() * 2 * MS))
    return [after - before for before, after in itertools.pairwise(sent[-100:])]


@pytest.mark.parametrize(("latency_us", "stalls"), [(70, ()), (4, ()), (9, (150, 700, 1200)), (0, (150,))])
def test_what_the_kernel_adds_to_each_period_is_taken_off_it(latency_us, stalls):
    task = Slow(latency_us * 1000)
    periods = heard_by_a_late_process(task, 1800, stalls)
    assert all(-2000 <= period - 10 * MS <= 3000 for period in periods)
    assert all(abs(item - 10_000) <= latency_us + 3 for item in task.collected)


@pytest.mark.parametrize(("period_us", "least"), [(10_000, 9_900), (1000, 950)])
def test_a_machine_that_is_at_standstill_again_and_again_is_not_a_latency_to_be_taken_off(period_us, least):
    task = Slow(3 * MS)
    heard_by_a_late_process(task, 1000, period_us=period_us)
    assert min(task.collected) == least


def test_one_that_is_set_up_again_begins_with_the_whole_period():
    task = Slow(70_000)
    sync = ExternalSync(task, 10_000, None, lambda _event: None)
    sync.start(0)
    for number in range(400):
        sync.receive_sync(number * 10_070_000)
    assert task.collected[-1] == 9_930
    sync.tick(10_000 * MS)
    assert task.collected[-1] == 10_000
