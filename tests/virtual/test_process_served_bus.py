import struct
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.virtualbench import S, servo, servo_od

from canopen_control.bus.memory import MemoryBus
from canopen_control.cia301.lss import UNCONFIGURED
from canopen_control.frame import CanFrame, pack_records
from canopen_control.host.reactor import Reactor
from canopen_control.host.sockets import drive_name, list_sockets
from canopen_control.host.timer import ManualClock
from canopen_control.virtual.device import make_device
from canopen_control.virtual.node_id_check import NodeIdTaken
from canopen_control.virtual.process import WINDOW_NS, BusNodes, FoldedLog, ServedBus


@pytest.fixture
def log_reactor():
    made = Reactor(ManualClock(0))
    yield made
    made.close()


def test_the_first_lines_of_a_kind_then_their_number(log_reactor):
    written = []
    log = FoldedLog(log_reactor, written.append)
    for number in range(5):
        log.tell("a", f"a {number}", 2)
    log.tell("b", "b", 2)
    assert written == ["a 0", "a 1", "b"]
    log_reactor.run_for(WINDOW_NS + 1)
    assert written == ["a 0", "a 1", "b", "a 4 (3 more times in 10 s)"]
    log.tell("a", "a 5", 2)
    assert written[-1] == "a 5"


@given(st.lists(st.tuples(st.sampled_from("abc"), st.integers(0, 4 * WINDOW_NS)), max_size=200))
def test_no_line_is_lost_from_the_sum(told):
    log_reactor, written = Reactor(ManualClock(0)), []
    log = FoldedLog(log_reactor, written.append)
    for kind, at in told:
        log_reactor.call_at(at, lambda kind=kind: log.tell(kind, kind, 3))
    log_reactor.run_for(6 * WINDOW_NS)
    log_reactor.close()
    for kind in "abc":
        lines = [line for line in written if line[0] == kind]
        sums = sum(int(line.split("(")[1].split()[0]) for line in lines if "(" in line)
        assert sums + sum("(" not in line for line in lines) == sum(each == kind for each, _ in told)


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
        for each in served:
            each.open()
        log_reactor.run_for(0)
        assert sum("has the control socket" in line for line in lines) == 2
        assert served[1].ready_line == "drive 255 (servo, serial number 2) ready on memory:unconfigured"
        for part in range(4):  # the second one into configuration, node id 9, and back to waiting
            number = nodes[1].store.number(0x1018, part + 1)
            master.send(pack_records([CanFrame(0x7E5, struct.pack("<BL3x", 0x40 + part, number))]))
        for request in (b"\x11\x09", b"\x04\x00"):
            master.send(pack_records([CanFrame(0x7E5, request.ljust(8, b"\0"))]))
        log_reactor.run_for(S // 10)
        assert [node.node_id for node in nodes] == [255, 9, 255]
        assert drive_name("memory:unconfigured", 9) in list_sockets("drive")
        assert drive_name("memory:unconfigured", 255) in list_sockets("drive")
    finally:
        for each in served:
            each.close()
        master.close()
        log_reactor.run_for(0)


def test_a_node_that_somebody_serves_is_told_and_what_is_given_up_is_known(log_reactor):
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
        for each in served:
            each.close()
