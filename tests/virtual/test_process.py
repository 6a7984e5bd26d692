from __future__ import annotations

import os
import signal
import struct
from dataclasses import replace
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.virtualbench import MS, S, ready_tmcm, servo, servo_od

from canopen_control.bus.memory import MemoryBus
from canopen_control.bus.port import BusEvent, BusEventKind
from canopen_control.cia301.lss import UNCONFIGURED
from canopen_control.errors import BusClosed
from canopen_control.frame import CanFrame, frames_of, pack_records
from canopen_control.host.reactor import Reactor
from canopen_control.host.sockets import drive_name, list_sockets, socket_path
from canopen_control.host.timer import ManualClock
from canopen_control.rpc.messages.drive import WorldState
from canopen_control.virtual import process
from canopen_control.virtual.device import make_device
from canopen_control.virtual.node_host import NodeIdTaken
from canopen_control.virtual.process import WINDOW_NS, BusNodes, DriveProcess, FoldedLog, ServedBus
from canopen_control.virtual.scenario import ScenarioEvent


@pytest.fixture
def log_reactor():
    created = Reactor(ManualClock(0))
    yield created
    created.close()


def test_the_first_lines_of_a_kind_then_their_number(log_reactor):
    written = []
    log = FoldedLog(log_reactor, written.append)
    for number in range(5):
        log.report("a", f"a {number}", 2)
    log.report("b", "b", 2)
    assert written == ["a 0", "a 1", "b"]
    log_reactor.run_for(WINDOW_NS + 1)
    assert written == ["a 0", "a 1", "b", "a 4 (3 more times in 10 s)"]
    log.report("a", "a 5", 2)
    assert written[-1] == "a 5"


@given(st.lists(st.tuples(st.sampled_from("abc"), st.integers(0, 4 * WINDOW_NS)), max_size=200))
def test_no_line_is_lost_from_the_sum(collected):
    log_reactor, written = Reactor(ManualClock(0)), []
    log = FoldedLog(log_reactor, written.append)
    for kind, at in collected:
        log_reactor.call_at(at, lambda kind=kind: log.report(kind, kind, 3))
    log_reactor.run_for(6 * WINDOW_NS)
    log_reactor.close()
    for kind in "abc":
        lines = [line for line in written if line[0] == kind]
        sums = sum(int(line.split("(")[1].split()[0]) for line in lines if "(" in line)
        assert sums + sum("(" not in line for line in lines) == sum(each == kind for each, _ in collected)


def unconfigured(serial):
    od = servo_od(UNCONFIGURED)
    od.device = replace(od.device, lss_supported=True)
    return make_device(od, UNCONFIGURED, serial=serial)


def test_any_number_of_nodes_without_an_id_wait_on_one_bus_and_each_gets_its_socket_with_its_id(log_reactor):
    bus, lines = MemoryBus("unconfigured"), []
    nodes = [unconfigured(serial) for serial in (1, 2, 3)]
    ports = [bus.open(str(serial)) for serial in (1, 2, 3)]
    served = [
        ServedBus(log_reactor, BusNodes(port, [node]), lines.append, list)
        for port, node in zip(ports, nodes, strict=True)
    ]
    master = bus.open("master")
    try:
        for item in served:
            item.open()
        log_reactor.run_for(0)
        assert sum("has the control socket" in line for line in lines) == 2
        assert served[1].ready_line == "drive 255 (servo, serial number 2) ready on memory:unconfigured"
        for part in range(4):  # the second one into configuration, node-ID 9, and back to waiting
            number = nodes[1].store.number(0x1018, part + 1)
            master.send(pack_records([CanFrame(0x7E5, struct.pack("<BL3x", 0x40 + part, number))]))
        for request in (b"\x11\x09", b"\x04\x00"):
            master.send(pack_records([CanFrame(0x7E5, request.ljust(8, b"\0"))]))
        log_reactor.run_for(S // 10)
        assert [node.node_id for node in nodes] == [255, 9, 255]
        assert drive_name("memory:unconfigured", 9) in list_sockets("drive")
        assert drive_name("memory:unconfigured", 255) in list_sockets("drive")
    finally:
        for item in served:
            item.close()
        master.close()
        log_reactor.run_for(0)


def test_a_node_served_by_another_client_is_reported_with_what_was_abandoned(log_reactor):
    bus, lost = MemoryBus("served"), []
    ports = [bus.open("a"), bus.open("b")]
    served = [ServedBus(log_reactor, BusNodes(port, [servo(5)]), str, lambda: lost.append(1)) for port in ports]
    try:
        served[0].open()
        assert served[0].ready_line == "drive 5 (servo) ready on memory:served"
        assert not served[0].moving
        with pytest.raises(NodeIdTaken, match="5"):
            served[1].open()
        bus.close()
        log_reactor.run_for(S)
        assert lost
        assert served[0].error is not None
    finally:
        for item in served:
            item.close()


PORTS = []


@pytest.fixture
def reactor():
    created = Reactor(ManualClock(S))
    yield created
    created.close()
    while PORTS:
        PORTS.pop().close()


def join(bus, label):
    PORTS.append(bus.open(label))
    return PORTS[-1]


def started(reactor, nodes, monkeypatch=None, lifeline=None):
    bus = MemoryBus("process")
    if lifeline is not None:
        monkeypatch.setattr(process, "lifeline_fd", lambda: lifeline)
    lines = []
    drives = DriveProcess(reactor, [BusNodes(join(bus, "drives"), nodes)], lines.append)
    return bus, drives, lines


def test_it_prints_one_line_when_ready_and_ends_with_0_on_a_signal(reactor):
    _, drives, lines = started(reactor, [servo(5)])
    reactor.call_later(S, lambda: os.kill(os.getpid(), signal.SIGTERM))
    reactor.call_later(2 * S, reactor.stop)
    assert drives.run() == 0
    assert "node 5 (servo) ready on memory:process" not in lines
    assert "drive 5 (servo) ready on memory:process" in lines
    assert any("node 5: NMT PRE_OPERATIONAL" in line for line in lines)


def test_several_nodes_report_this(reactor):
    _, drives, lines = started(reactor, [servo(5), servo(6)])
    reactor.call_later(MS, reactor.stop)
    drives.run()
    assert "drives 5, 6 (servo) ready on memory:process" in lines


def test_a_controller_between_two_states_does_not_flood_the_log_with_what_the_node_makes_of_it(reactor):
    node = servo(5)
    _, drives, lines = started(reactor, [node])

    def flood():
        for _ in range(500):
            for kind in (BusEventKind.ERROR_PASSIVE, BusEventKind.OVERRUN, BusEventKind.ERROR_ACTIVE):
                node.bus_event(kind, reactor.now())
                drives._buses[0]._host.wake(node)

    reactor.call_later(S, flood)
    reactor.call_later(12 * S, reactor.stop)
    drives.run()
    passive = [line for line in lines if "0x8120" in line]
    assert len(passive) == 11
    assert passive[-1].endswith("(490 more times in 10 s)")
    assert len(lines) < 50


def test_a_flood_of_error_frames_is_a_line_and_a_sum_for_each_kind(reactor):
    _, drives, lines = started(reactor, [servo(5)])

    def flood():
        for number in range(1000):
            for kind in (BusEventKind.ERROR_PASSIVE, BusEventKind.OVERRUN):
                drives._buses[0]._on_bus_event(BusEvent(kind, f"{kind.value} {number}"))

    reactor.call_later(S, flood)
    reactor.call_later(12 * S, reactor.stop)
    drives.run()
    reported = [line.split(" ", 1)[1].strip() for line in lines if "overrun" in line or "passive" in line]
    assert [item.partition(" ")[2] if item[0].isdigit() else item for item in reported] == [
        "error-passive 0",
        "overrun 0",
        "error-passive 999 (999 more times in 10 s)",
        "overrun 999 (999 more times in 10 s)",
    ]


def test_it_logs_state_changes_in_words(reactor):
    bus, drives, lines = started(reactor, [servo(5)])
    master = join(bus, "master")
    frames = [CanFrame(0, b"\x01\x05"), CanFrame(0x205, b"\x06\0\x03")]
    reactor.call_later(MS, lambda: master.send(pack_records(frames)))
    reactor.call_later(2 * MS, reactor.stop)
    drives.run()
    text = "\n".join(lines)
    assert "node 5: NMT OPERATIONAL" in text
    assert "node 5: SWITCH_ON_DISABLED -> READY_TO_SWITCH_ON" in text
    assert "node 5: mode PV" in text


def test_a_bus_that_is_gone_for_good_ends_it_with_its_error(reactor):
    bus, drives, _ = started(reactor, [servo(5)])
    reactor.call_later(MS, bus.close)
    with pytest.raises(BusClosed):
        drives.run()


def test_a_control_socket_that_is_served_already_means_that_the_id_is_taken(reactor):
    from canopen_control.host.sockets import listen

    _, drives, _ = started(reactor, [servo(5)])
    taken = listen(socket_path("drive", "process-5"))
    with pytest.raises(NodeIdTaken):
        drives.run()
    taken.close()


def test_without_its_parent_it_ends_at_once_when_nothing_turns(reactor, monkeypatch):
    read, write = os.pipe()
    _, drives, lines = started(reactor, [servo(5)], monkeypatch, read)
    reactor.call_later(S, lambda: os.close(write))
    assert drives.run() == 0
    assert reactor.now() < 2.1 * S
    assert "the parent process has ended" in lines[-1]
    os.close(read)


def test_a_parent_that_died_while_it_was_starting_is_noticed(reactor, monkeypatch):
    read, write = os.pipe()
    os.close(write)
    _, drives, lines = started(reactor, [servo(5)], monkeypatch, read)
    reactor.call_later(10 * S, reactor.stop)
    assert drives.run() == 0
    assert reactor.now() < 2 * S
    assert any("the parent process has ended" in line for line in lines)
    os.close(read)


def test_a_signal_while_it_is_starting_ends_it(reactor):
    _, drives, lines = started(reactor, [servo(5)])
    reactor.call_soon(lambda: os.kill(os.getpid(), signal.SIGTERM))
    reactor.call_later(10 * S, reactor.stop)
    assert drives.run() == 0
    assert reactor.now() < 2 * S
    assert lines


@pytest.mark.parametrize(("watched", "seconds"), [(True, 0.5 + 2546 / 16000), (False, 5.0)])
def test_without_its_parent_it_serves_until_its_own_reaction_has_stopped_the_motor(
    reactor, monkeypatch, watched, seconds
):
    read, write = os.pipe()
    bench = ready_tmcm()
    bench.write(0x60FF, 2546)
    if watched:
        bench.write(0x1029, 2, 1)
        bench.write(0x1016, 0x000101F4, 1)
    bench.on(1)
    reactor.clock.now_ns = bench.now
    bus, drives, _ = started(reactor, [bench.node], monkeypatch, read)
    master = join(bus, "master")
    died = bench.now + S

    def die():
        master.send(pack_records([CanFrame(0x701, b"\x05")]))
        os.close(write)

    reactor.call_at(died, die)
    assert drives.run() == 0
    assert (reactor.now() - died) / S == pytest.approx(seconds, abs=0.05)
    assert (bench.drive.mover.plant.velocity == 0) == watched
    os.close(read)


class Reopening:
    """A drive process whose bus goes away, and where it comes back."""

    def __init__(self, reactor, node, after_s):
        self.bus, self.tries = MemoryBus("process-again"), 0
        self.reactor, self.due, self.master = reactor, None, join(self.bus, "master")
        first, self.lines = MemoryBus("process"), []
        port = join(first, "drives")
        self.process = DriveProcess(reactor, [BusNodes(port, [node], self.reopen)], self.lines.append)
        reactor.call_later(MS, first.close)
        self.due = None if after_s is None else reactor.now() + round(after_s * S)

    def reopen(self):
        self.tries += 1
        back = self.due is not None and self.reactor.now() >= self.due
        return join(self.bus, "drives") if back else None


def test_a_bus_that_returns_within_three_seconds_is_joined_again(reactor):
    r = Reopening(reactor, servo(5), 2.0)
    ask = pack_records([CanFrame(0x605, bytes.fromhex("4000100000000000"))])
    reactor.call_later(3 * S, lambda: r.master.send(ask))
    reactor.call_later(4 * S, lambda: os.kill(os.getpid(), signal.SIGTERM))
    reactor.call_later(5 * S, reactor.stop)
    assert r.process.run() == 0
    assert any("memory:process-again is back" in line for line in r.lines)
    assert CanFrame(0x585, bytes.fromhex("4300100092010200")) in list(frames_of(r.master.receive()))


def test_a_bus_that_does_not_return_ends_it_after_three_seconds(reactor):
    r = Reopening(reactor, servo(5), None)
    with pytest.raises(BusClosed):
        r.process.run()
    assert reactor.now() == pytest.approx(S + MS + 3 * S, abs=0.2 * S)
    assert r.tries > 20


def test_a_signal_while_the_bus_is_away_is_a_clean_end(reactor):
    r = Reopening(reactor, servo(5), None)
    reactor.call_later(S, lambda: os.kill(os.getpid(), signal.SIGTERM))
    assert r.process.run() == 0


def test_a_node_id_given_by_lss_renames_its_control_socket(reactor):
    od = servo_od(5)
    od.device = replace(od.device, lss_supported=True)
    node = make_device(od, 5)
    bus, drives, lines = started(reactor, [node])
    master, observed = join(bus, "master"), []
    select = [b"\x04\x01", b"\x11\x09", b"\x04\x00"]
    frames = [CanFrame(0x7E5, data.ljust(8, b"\0")) for data in select] + [CanFrame(0, b"\x82\x05")]
    reactor.call_later(MS, lambda: master.send(pack_records(frames)))
    reactor.call_later(100 * MS, lambda: observed.extend(list_sockets("drive")))
    reactor.call_later(200 * MS, reactor.stop)
    drives.run()
    assert observed == ["process-9"]
    assert any("node 9: LSS: node-ID 9" in line for line in lines)


@pytest.mark.sources
def test_a_timeline_and_a_world_that_depends_on_its_axes_are_served(reactor):
    bus = MemoryBus("process")
    node, requested = servo(5), []
    world = SimpleNamespace(period_ns=20 * MS, describe=WorldState)
    node.advance_drives = lambda now, advance=node.advance_drives: (requested.append(now), advance(now))
    lines = []
    timeline = [ScenarioEvent(S // 2, "fault", "5", "warning")]
    drives = DriveProcess(
        reactor, [BusNodes(join(bus, "drives"), [node], timeline=timeline, world=world)], lines.append
    )
    reactor.call_later(S, reactor.stop)
    assert drives.run() == 0
    assert len(requested) >= 49
    assert any("fault warning on" in line for line in lines)


def test_two_buses_in_one_process_and_one_that_is_gone_leaves_the_other(reactor):
    first, second, lines = MemoryBus("one"), MemoryBus("two"), []
    buses = [BusNodes(join(bus, "drives"), [servo(5)]) for bus in (first, second)]
    drives, master = DriveProcess(reactor, buses, lines.append), join(second, "master")
    ask = pack_records([CanFrame(0x605, bytes.fromhex("4000100000000000"))])
    reactor.call_later(S, first.close)
    reactor.call_later(2 * S, lambda: master.send(ask))
    reactor.call_later(3 * S, second.close)
    reactor.call_later(9 * S, reactor.stop)
    with pytest.raises(BusClosed):
        drives.run()
    assert reactor.now() < 6 * S  # the last one ends it
    assert [line for line in lines if "ready" in line] == [
        "drive 5 (servo) ready on memory:one",
        "drive 5 (servo) ready on memory:two",
    ]
    assert any(line.split(maxsplit=1)[1].startswith("memory:two: node 5: ") for line in lines if "node 5:" in line)
    assert CanFrame(0x585, bytes.fromhex("4300100092010200")) in list(frames_of(master.receive()))
