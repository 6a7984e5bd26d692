"""In-process bus: receivers of frames, and each fault setting."""

from __future__ import annotations

import gc
import select

import pytest

from canopen_control.bus import memory
from canopen_control.bus.channel import open_port
from canopen_control.bus.error_frames import overrun_frame
from canopen_control.bus.memory import MemoryBus
from canopen_control.bus.port import BusEventKind
from canopen_control.errors import BusClosed, LocalProtocolError
from canopen_control.frame import CanFrame, frames_of, pack_records

ONE, TWO, THREE = (CanFrame(0x180 + n, bytes([n])) for n in (1, 2, 3))


def send(port, *frames):
    port.send(pack_records(frames))


def received(port):
    return list(frames_of(port.receive()))


@pytest.fixture
def bus():
    return MemoryBus("test")


@pytest.fixture
def ports(bus):
    return [bus.open(label) for label in "abc"]


def test_everybody_but_the_sender_receives_in_order(ports):
    a, b, c = ports
    send(a, ONE, TWO)
    send(c, THREE)
    assert received(b) == [ONE, TWO, THREE]
    assert received(a) == [THREE]
    assert received(c) == [ONE, TWO]
    assert b.receive() == b""
    assert (a.stats.tx, b.stats.rx) == (2, 3)


def test_a_bus_is_found_by_name_as_long_as_a_process_has_it_open():
    port = MemoryBus.get("shared").open("a")
    assert MemoryBus.get("shared") is port.bus
    port.close()
    del port
    gc.collect()
    assert MemoryBus.get("shared").ports == []


def test_a_cut_record_is_refused_and_nothing_is_sent(bus, ports):
    with pytest.raises(LocalProtocolError):
        ports[0].send(b"123")
    assert bus.history == []
    assert ports[0].stats.tx == 0


def test_the_descriptor_is_readable_exactly_while_something_waits(ports):
    a, b, _c = ports
    send(a, ONE)
    fd = b.fileno()
    assert select.select([fd], [], [], 0)[0] == [fd]
    b.receive()
    assert select.select([fd], [], [], 0)[0] == []
    send(a, TWO)
    assert select.select([fd], [], [], 0)[0] == [fd]
    b.close()


def test_the_history_records_the_sender_of_each_frame(bus, ports):
    send(ports[0], ONE)
    send(ports[1], TWO)
    assert bus.history == [("a", ONE), ("b", TWO)]
    bus.clear_history()
    assert bus.history == []


def test_dropped_frames_reach_no_port_and_are_counted(bus, ports):
    bus.drop(lambda label, frame: label == "a" and frame.can_id == TWO.can_id)
    send(ports[0], ONE, TWO)
    send(ports[1], TWO)
    assert received(ports[2]) == [ONE, TWO]
    assert bus.dropped == 1
    bus.drop(None)
    send(ports[0], TWO)
    assert received(ports[2]) == [TWO]


def test_a_duplicated_frame_arrives_twice(bus, ports):
    bus.duplicate(lambda _label, frame: frame == ONE)
    send(ports[0], ONE, TWO)
    assert received(ports[1]) == [ONE, ONE, TWO]


def test_held_frames_arrive_late_and_not_at_their_sender(bus, ports):
    bus.hold(lambda _label, frame: frame == ONE)
    send(ports[0], ONE, TWO)
    assert received(ports[1]) == [TWO]
    bus.hold(None)
    assert bus.release() == 1
    assert received(ports[1]) == [ONE]
    assert received(ports[0]) == []


def test_a_cut_port_neither_sends_nor_receives_until_repaired(bus, ports):
    a, b, c = ports
    bus.cut("b")
    send(b, ONE)
    send(a, TWO)
    assert received(a) == received(b) == []
    assert received(c) == [TWO]
    assert (b.stats.lost, bus.dropped) == (1, 1)
    bus.uncut("b")
    send(b, THREE)
    assert received(a) == [THREE]


def test_bus_off_silences_and_reports_the_port_and_restart_brings_it_back(bus, ports):
    a, b, _c = ports
    bus.bus_off("b")
    assert [frame.is_error for frame in received(b)] == [True]
    assert [event.kind for event in b.events()] == [BusEventKind.BUS_OFF]
    assert b.events() == []
    send(b, ONE)
    assert received(a) == []
    bus.restart("b")
    received(b)
    assert [event.kind for event in b.events()] == [BusEventKind.ERROR_ACTIVE]
    assert b.stats.errors == 2
    send(b, ONE)
    assert received(a) == [ONE]


def test_an_injected_frame_comes_from_nowhere(bus, ports):
    bus.inject(ONE)
    assert [received(port) for port in ports] == [[ONE]] * 3


def test_a_reader_that_stalls_loses_its_own_frames_and_is_reported(bus, ports, monkeypatch):
    monkeypatch.setattr(memory, "QUEUE_LIMIT", 32)
    a, b, c = ports
    for frame in (ONE, TWO, THREE, ONE):
        send(a, frame)
        assert received(c) == [frame]
    assert received(b) == [ONE, TWO, overrun_frame(2)]
    assert b.stats.lost == 2
    assert c.stats.lost == 0
    assert [event.kind for event in b.events()] == [BusEventKind.OVERRUN]
    send(a, THREE)
    assert received(b) == [THREE]


def test_a_closed_port_is_gone_for_itself_alone(bus, ports):
    a, b, c = ports
    b.close()
    b.close()
    send(a, ONE)
    assert received(c) == [ONE]
    for verb in (b.receive, lambda: b.send(pack_records([ONE]))):
        with pytest.raises(BusClosed, match="memory:test: closed on this side"):
            verb()


def test_when_the_bus_closes_what_waits_is_still_read_and_then_it_is_reported(bus, ports):
    a, b, _c = ports
    fd = a.fileno()
    send(a, ONE)
    bus.close()
    assert received(b) == [ONE]
    with pytest.raises(BusClosed, match="memory:test: the bus was closed"):
        b.receive()
    assert [event.kind for event in a.events()] == [BusEventKind.CLOSED]
    assert select.select([fd], [], [], 0)[0] == [fd]
    a.close()


def test_flush_has_nothing_to_do(ports):
    ports[0].flush()
    assert ports[0].wants_write is False


def test_a_bus_of_another_kind_is_joined_while_it_is_provided():
    class Other:
        def open(self, label):
            return f"port of {label}"

    with memory.provide("provided", Other()):
        assert open_port("memory:provided", label="master") == "port of master"
    port = open_port("memory:provided")
    assert isinstance(port, memory.MemoryPort)
    port.close()
