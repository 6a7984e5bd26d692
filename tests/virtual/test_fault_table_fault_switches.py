from __future__ import annotations

import pytest
from support.virtualbench import Bench, servo

from canopen_control.cia301.nmt import NmtStateChanged
from canopen_control.errors import ConfigError
from canopen_control.frame import CanFrame
from canopen_control.virtual.fault_table import FaultSwitches, second_node
from canopen_control.virtual.node_outbox import FaultSwitched


def test_with_nothing_on_there_is_nothing_in_the_way():
    bench = Bench(servo())
    board = FaultSwitches(bench.node)
    assert bench.node.filter is None
    board.set("heartbeat_lost", True, bench.now)
    assert bench.node.filter is board
    board.set("heartbeat_lost", False, bench.now)
    bench.on(1)
    board.set("warning", True, bench.now)
    board.set("warning", False, bench.now)
    assert bench.node.filter is None


def test_planned_faults_come_at_their_time_after_the_start():
    bench = Bench(servo(faults=("warning", "local_control@2s")))
    assert bench.node.fault_switches.active == ["warning"]
    bench.on(1.99)
    assert bench.node.fault_switches.active == ["warning"]
    bench.on(0.02)
    assert set(bench.node.fault_switches.active) == {"warning", "local_control"}
    switched = [(event.name, event.on) for event in bench.events if isinstance(event, FaultSwitched)]
    assert switched == [("warning", True), ("local_control", True)]


def test_no_boot_from_the_start_never_reports_a_word():
    bench = Bench(servo(faults=("no_boot",)))
    bench.on(60)
    assert bench.seen == []


def test_switching_twice_is_switching_once_and_unknown_names_are_refused():
    bench = Bench(servo())
    board = FaultSwitches(bench.node)
    for _ in range(2):
        board.set("drive_fault", True, bench.now)
    assert board.active == ["drive_fault"]
    board.set("silent", False, bench.now)
    with pytest.raises(ConfigError):
        board.set("nonsense", True, bench.now)
    with pytest.raises(ConfigError):
        board.schedule("nonsense@3")


def test_faults_on_frames_add_up():
    bench = Bench(servo())
    bench.write(0x1017, 100)
    board = FaultSwitches(bench.node)
    for name in ("duplicate_node", "heartbeat_wrong_state"):
        board.set(name, True, bench.now)
    bench.start()
    bench.on(0.01)
    bench.seen.clear()
    bench.on(0.1)
    assert [frame.data for _, frame in bench.seen] == [b"\x7f", b"\x7f"]


def test_a_second_node_is_the_same_device_with_another_serial_and_a_life_of_its_own():
    first = Bench(servo())
    second = second_node(first.node, first.now)
    assert [frame.data for frame in second.frames() if frame.can_id == 0x705] == [b"\0"]
    assert (second.node_id, second.get(0x1018, 4)) == (5, 1005)
    second.receive(CanFrame(0, b"\x01\x05"), first.now)
    assert second.operational
    assert not first.node.operational
    assert second.drives.keys() == first.node.drives.keys()


def test_events_of_a_second_node_are_not_reported():
    bench = Bench(servo())
    bench.node.fault_switches.set("second_node", True, bench.now)
    bench.collect()
    bench.events.clear()
    bench.start()
    assert len([event for event in bench.events if isinstance(event, NmtStateChanged)]) == 1
    assert bench.node.fault_switches._second.events() == []
