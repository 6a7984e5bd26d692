"""The bus of a robot: what happens when the channel does something."""

import pytest
from support.robots import LEFT, Bench

from canopen_control.bus.error_frames import ERROR_FLAG
from canopen_control.errors import BusError
from canopen_control.frame import CanFrame
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
    monkeypatch.setattr("canopen_control.runtime.bus.open_port", refuse)
    with pytest.raises(BusError, match="memory:bus3"):
        bench.robot.start()
    assert bench.robot.state is RobotState.STOPPED
    bench.close()


def test_every_frame_that_was_sent_was_received_by_the_drives():
    bench = Bench("bus4")
    bench.start()
    bench.hold(10.0, 10.0, ms=2000)
    master = bench.robot.buses["can"].port.stats
    others = sum(port.stats.tx for port in bench.ports.values())
    assert bench.ports[LEFT].stats.rx > master.tx * 0.9
    assert master.rx == others
    assert master.lost == 0
    bench.close()


def test_what_is_lost_while_the_bus_carries_nothing_is_told_as_that_and_once_when_it_is_back():
    bench = Bench("bus5")
    bench.start()
    bench.bus.bus_off("master")
    bench.run(3000)
    master = bench.robot.buses["can"].port.stats
    assert master.lost > 20
    assert bench.texts("bus_frames_lost") == bench.texts("bus_queue_full") == []
    bench.bus.restart("master")
    bench.run(2000)
    assert bench.texts("bus_frames_lost") == [
        f"bus can (memory:bus5): {master.lost} frames lost, while it carried nothing"
    ]
    assert bench.texts("bus_queue_full") == []
    master.lost += 3
    bench.run(2000)
    assert bench.texts("bus_queue_full") == ["bus can (memory:bus5): 3 frames lost, its queue was full"]
    bench.close()
