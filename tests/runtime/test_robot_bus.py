"""The bus of a robot: reactions to events of the channel."""

import pytest
from support.observers import Observer
from support.robots import LEFT, MS, Bench, copy_robby

from canopen_control.errors import BusError
from canopen_control.frame import ERROR_FLAG, CanFrame
from canopen_control.runtime.core import RobotState


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
