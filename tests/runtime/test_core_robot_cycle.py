"""The cycle of a robot: controllers live on the grid, SYNC goes first or last, and what was skipped is told."""

import itertools

import pytest
from support.robots import LEFT, MS, RIGHT, Bench, copy_robby
from support.watching import Witness, watch

from canopen_control.bus.channel import open_port
from canopen_control.frame import CanFrame, pack_records
from canopen_control.runtime.core import CAUGHT_UP

PERIOD = 20 * MS
RPDOS = (0x202, 0x203, 0x302, 0x303)


@pytest.fixture
def benches():
    made = []

    def make(name, **how):
        made.append(Bench(name, **how))
        return made[-1]

    yield make
    for bench in made:
        bench.close()


def delay(bench, *delays_ms):
    """Let the next cycles come late, each by its delay: the process is busy just before the edge."""
    delays = iter(delays_ms)

    def busy():
        bench.reactor.clock.now_ns += round(next(delays, 0.0) * MS)

    def after(now):
        bench.reactor.call_at(bench.robot.pacer.edge + PERIOD - 1000, busy)

    bench.robot.after_cycle.append(after)


def test_a_late_cycle_gets_the_time_of_its_edge_and_the_period_of_the_grid(benches):
    bench = benches("cycle1")
    bench.start()
    seen = watch(bench)
    delay(bench, *[0.0, 5.0, 0.0, 12.0, 19.0] * 10)
    bench.run(1200)
    assert {later[0] - sooner[0] for sooner, later in itertools.pairwise(seen)} == {PERIOD}
    assert {period for _, period, _ in seen} == {0.02}
    lateness = [now - edge for edge, _, now in seen]
    assert max(lateness) == pytest.approx(19 * MS, abs=1000)
    assert bench.robot.pacer.missed == 0


@pytest.mark.parametrize("edges", [1, 2, 3, 7])
def test_skipped_edges_are_caught_up_in_time_up_to_a_bound_and_told_with_what_they_cost(benches, edges):
    bench = benches(f"cycle2{edges}")
    bench.start()
    bench.hold(5.0, 5.0, ms=500)
    seen = watch(bench)
    written = []
    bench.robot.registry.register(Witness(on_write=lambda _now, period: written.append(period)))
    delay(bench, 0.0, 20.0 * edges + 1.0)
    bench.publish(5.0, 5.0)
    bench.run(1500)
    assert set(written) == {0.02}, "no target moves by more than the drive can go in a period"
    longest = max(period for _, period, _ in seen)
    assert longest == pytest.approx(0.02 * (1 + min(edges, CAUGHT_UP)))
    assert max(later[0] - sooner[0] for sooner, later in itertools.pairwise(seen)) == (1 + edges) * PERIOD
    (event,) = [each for each in bench.events if each.kind == "cycle_missed"]
    assert event.count == edges
    cost = f"set-points that moving axes did not get since they were enabled: left_wheel_joint {edges}"
    assert cost in event.text
    assert bench.joint(LEFT).tracking.skipped == edges


def test_what_stands_misses_nothing_when_edges_are_skipped(benches):
    bench = benches("cycle3")
    bench.start()
    delay(bench, 0.0, 50.0)
    bench.run(300)
    (event,) = [each for each in bench.events if each.kind == "cycle_missed"]
    assert "moving axes" not in event.text


def frames_of(bench):
    """Return what the master sent, as "S" for SYNC and "R" for an RPDO, in order."""
    kinds = {0x80: "S", **dict.fromkeys(RPDOS, "R")}
    return "".join(kinds.get(frame.can_id, "") for label, frame in bench.bus.history if label == "master")


def syncs_of(bench):
    return [frame for label, frame in bench.bus.history if label == "master" and frame.can_id == 0x80]


def test_sync_last_is_the_default_and_goes_behind_the_rpdos_of_its_cycle(benches):
    bench = benches("order1")
    bench.start()
    bench.hold(5.0, 5.0, ms=500)
    assert "RRS" in frames_of(bench)
    assert bench.robot.buses["can"].sync_words == "SYNC every 20 ms, after the RPDOs of its cycle (sync_order: last)"


def test_sync_first_begins_the_cycle_and_its_rpdos_follow_at_once(benches, tmp_path):
    config = copy_robby(tmp_path, bus={"sync_period: 20000": "sync_period: 20000\n  sync_order: first"})
    bench = benches("order2", config=config)
    bench.start()
    order = []
    count = bench.robot.pacer

    def on_read(_now, _period):
        order.append(len(syncs_of(bench)) - count.count)

    bench.robot.registry.register(Witness(on_read=on_read))
    bench.hold(10.0, -10.0, ms=1000)
    assert set(order) == {0}, "as many as cycles have begun, before anything is read"
    assert [bench.velocity(node) for node in (LEFT, RIGHT)] == pytest.approx([10.0, -10.0], rel=0.01)
    assert len(syncs_of(bench)) == bench.robot.pacer.count
    assert bench.texts("feedback_stale") == []
    assert bench.robot.buses["can"].sync_words.endswith("before the RPDOs of its cycle (sync_order: first)")


def test_a_tpdo_that_stays_away_is_noticed_with_sync_first_as_well(benches, tmp_path):
    config = copy_robby(tmp_path, bus={"sync_period: 20000": "sync_period: 20000\n  sync_order: first"})
    bench = benches("order3", config=config)
    bench.start()
    bench.hold(5.0, 5.0, ms=300)
    bench.power_off(LEFT)
    bench.until(lambda: bench.texts("stop"), 1500)
    bench.run(1500)
    assert bench.speed(RIGHT) == 0


@pytest.mark.parametrize(("order", "behind"), [("last", PERIOD // 2), ("first", PERIOD // 8)])
def test_the_cycle_follows_the_sync_of_a_node(benches, tmp_path, order, behind):
    keys = f"sync_period: 20000\n  sync_producer: other\n  sync_order: {order}"
    bench = benches(f"other{order}", config=copy_robby(tmp_path, bus={"sync_period: 20000": keys}))
    port, period = open_port(bench.channel, label="producer"), PERIOD + 4000  # 200 ppm slower

    def produce():
        port.send(pack_records([CanFrame(0x80)]))
        bench.reactor.call_later(period, produce)

    produce()
    sent = bench.reactor.now()
    cycles = []
    bench.robot.after_cycle.append(cycles.append)
    bench.start()
    bench.hold(10.0, -10.0, ms=2000)
    assert [bench.velocity(node) for node in (LEFT, RIGHT)] == pytest.approx([10.0, -10.0], rel=0.01)
    assert {label for label, frame in bench.bus.history if frame.can_id == 0x80} == {"producer"}
    phases = [(cycle - sent) % period for cycle in cycles[-50:]]
    assert all(abs(each - behind) <= PERIOD // 64 for each in phases)
    assert bench.texts("sync_lost") == []
    assert "by another node" in bench.robot.buses["can"].sync_words
    port.close()
