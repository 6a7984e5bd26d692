"""The bus of a robot: reactions to events of the channel."""

import itertools
import random

import pytest
from support.observers import Observer
from support.robots import LEFT, MS, RIGHT, Bench, copy_robby

from canopen_control.bus.channel import open_port
from canopen_control.errors import BusError
from canopen_control.frame import ERROR_FLAG, CanFrame, pack_records
from canopen_control.runtime.core import RobotState
from canopen_control.runtime.robot_bus import ExternalSync, NodeSync


def test_a_channel_that_closes_ends_the_run_with_its_reason():
    bench = Bench("bus1")
    bench.start()
    bench.bus.close()
    bench.until(lambda: bench.robot.state is RobotState.STOPPED)
    assert "memory:bus1" in bench.robot.failure
    assert bench.texts("bus_lost")
    bench.close()


def test_error_frames_become_events_and_harm_nothing():
    bench = Bench("bus2")
    bench.start()
    bench.bus.report("master", CanFrame(ERROR_FLAG | 0x04, bytes((0, 0x10, 0, 0, 0, 0, 0, 0))))
    bench.run(100)
    assert bench.robot.state is RobotState.RUNNING
    assert [event.kind for event in bench.events if event.kind.startswith("bus_")] == ["bus_error_passive"]
    bench.close()


def test_a_start_on_a_channel_that_cannot_be_opened_leaves_nothing_open(monkeypatch):
    def refuse(channel, label=""):
        raise BusError(f"cannot open {channel}")

    bench = Bench("bus3", drives=())
    monkeypatch.setattr("canopen_control.runtime.robot_bus.open_port", refuse)
    with pytest.raises(BusError, match="memory:bus3"):
        bench.robot.start()
    assert bench.robot.state is RobotState.STOPPED
    bench.close()


def test_every_frame_that_was_sent_was_received_by_the_drives():
    bench = Bench("bus4")
    bench.start()
    bench.hold(10.0, 10.0, ms=2000)
    bench.robot.buses["can"].receive()  # what waits for the next edge
    master = bench.robot.buses["can"].port.stats
    others = sum(port.stats.tx for port in bench.ports.values())
    assert bench.ports[LEFT].stats.rx > master.tx * 0.9
    assert master.rx == others
    assert master.lost == 0
    bench.close()


def test_what_is_lost_while_the_bus_carries_nothing_is_reported_as_that_and_once_when_it_is_back():
    bench = Bench("bus5")
    bench.start()
    bench.bus.bus_off("master")
    bench.run(3000)
    master = bench.robot.buses["can"].port.stats
    assert master.lost > 20
    assert bench.texts("bus_frames_lost") == bench.texts("bus_queue_full") == []
    bench.bus.restart("master")
    bench.run(2000)
    (lost,) = [event for event in bench.events if event.kind == "bus_frames_lost"]
    assert lost.sentence == f"bus can (memory:bus5): a frame was lost, while the bus had failed ({master.lost} times)"
    assert bench.texts("bus_queue_full") == []
    master.lost += 3
    bench.run(2000)
    (full,) = [event for event in bench.events if event.kind == "bus_queue_full"]
    assert full.sentence == "bus can (memory:bus5): a frame was lost, the send queue was full (3 times)"
    bench.close()


def test_events_before_the_start_are_not_reported_but_boot_ups_are_recorded():
    bench = Bench("busjoined")
    bench.robot.join()
    bench.reactor.run_for(10_000_000)  # the drives are switched on
    assert bench.robot.has_heard(["left_drive", "right_drive"])
    assert all(node.nmt_state is None for node in bench.robot.nodes.values())
    bench.start()
    assert bench.texts("duplicate_node") == []
    bench.close()


def test_a_channel_that_closes_before_the_robot_began_ends_the_run_as_well():
    bench = Bench("busgone")
    bench.robot.join()
    bench.bus.close()
    bench.reactor.run_for(10_000_000)
    assert "memory:busgone" in bench.robot.failure
    bench.robot.start()
    assert bench.robot.state is RobotState.STOPPED
    bench.close()


def detected_after(bench, stop_ms):
    """Let the left drive fall silent `stop_ms` after an edge, and return at which edge that is reported."""
    edge = bench.robot.pacer.edge
    bench.until(lambda: bench.robot.pacer.edge != edge)
    bench.run(stop_ms)
    begin = bench.robot.pacer.edge
    bench.bus.cut(f"drive {LEFT}")
    bench.until(lambda: not bench.robot.nodes["left_drive"].ready)
    return (bench.robot.pacer.edge - begin) / MS


def test_a_bus_on_which_nothing_is_waited_for_is_read_at_the_edges_alone():
    bench = Bench("busrests")
    bench.start()
    bus = bench.robot.buses["can"]
    bench.run(300)
    assert not bus.watched
    before = bus.port.stats.rx
    edge = bench.robot.pacer.edge
    bench.until(lambda: bench.robot.pacer.edge != edge)
    read = bus.port.stats.rx
    assert read > before
    bench.run(15)
    assert bus.port.stats.rx == read
    bench.close()


def test_an_answer_is_read_as_it_comes():
    bench = Bench("buswakes")
    bench.start()
    bench.run(300)
    bus, node, answers = bench.robot.buses["can"], bench.robot.nodes["left_drive"], []
    edge = bench.robot.pacer.edge
    bench.until(lambda: bench.robot.pacer.edge != edge)
    node.read(0x1018, 1, answers.append)
    bus.send_waiting()
    assert bus.watched
    bench.until(lambda: answers, 5)
    assert bench.robot.pacer.edge == edge + 20 * MS
    bench.run(300)
    assert not bus.watched
    bench.close()


def test_a_node_that_is_not_there_is_waited_for():
    bench = Bench("busmisses")
    bench.start()
    bench.run(300)
    bench.power_off(LEFT)
    bench.until(lambda: not bench.robot.nodes["left_drive"].ready)
    bench.run(120)
    assert bench.robot.buses["can"].watched
    bench.power_on(LEFT)
    bench.until(lambda: bench.robot.nodes["left_drive"].ready)
    bench.run(300)
    assert not bench.robot.buses["can"].watched
    bench.close()


@pytest.mark.parametrize("ms", [0.3, 7.0, 19.0])
def test_a_heartbeat_is_missed_at_the_edge_at_which_it_was_when_frames_were_read_as_they_came(ms):
    results = []
    for watched in (False, True):
        bench = Bench(f"busbeats{watched}{round(10 * ms)}")
        bus = bench.robot.buses["can"]
        if watched:
            bench.robot.observers.append(Observer(after_cycle=lambda _now, bus=bus: bus.watch()))
        bench.start()
        bench.run(300)
        assert bus.watched is watched
        results.append(detected_after(bench, ms))
        bench.close()
    assert results[0] == results[1]


@pytest.mark.parametrize(
    "edits",
    [
        {"bus": {"sync_period: 20000": "sync_period: 30000"}, "controllers": {"update_rate: 50": "update_rate: 33"}},
        {"bus": {"heartbeat_producer: 100": "heartbeat_producer: 93"}},
    ],
)
def test_a_bus_is_watched_where_a_heartbeat_would_be_missed_later(tmp_path, edits):
    bench = Bench("busalways", config=copy_robby(tmp_path, **edits))
    bench.start()
    bench.run(500)
    assert bench.robot.buses["can"].watched
    bench.close()


# A robot with external SYNC: its cycle follows, and the absence of SYNC is reported and repaired.


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
