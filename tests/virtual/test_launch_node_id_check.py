from __future__ import annotations

import pytest
from support.virtualbench import S, tmcm

from canopen_control.bus.memory import MemoryBus
from canopen_control.frame import CanFrame, pack_records
from canopen_control.host.reactor import Reactor
from canopen_control.host.timer import ManualClock
from canopen_control.virtual.launch import PROBE_NS, NodeIdCheck
from canopen_control.virtual.node_host import NodeHost, NodeIdTaken


def test_an_unused_node_id_is_free_after_a_short_wait():
    bus, reactor = MemoryBus("launch"), Reactor(ManualClock(S))
    port = bus.open("new")
    NodeIdCheck(reactor, port, [3, 4]).finish()
    assert reactor.now() == S + PROBE_NS
    reactor.close()
    port.close()


def test_nodes_without_an_id_hold_none_and_nothing_is_asked():
    bus, reactor = MemoryBus("launch"), Reactor(ManualClock(S))
    port, other = bus.open("new"), bus.open("old")
    check = NodeIdCheck(reactor, port, [255])
    other.send(pack_records([CanFrame(0x7FF, b"\x05"), CanFrame(0x67F, bytes(8))]))
    check.finish()
    assert other.receive() == b""
    reactor.close()
    port.close()
    other.close()


def test_an_id_that_answers_is_refused_with_a_sentence():
    bus, reactor = MemoryBus("launch"), Reactor(ManualClock(S))
    port, other = bus.open("new"), bus.open("old")
    host = NodeHost(reactor, other, [tmcm(4)])
    reactor.run_for(0)
    port.receive()  # its boot-up was before the question
    with pytest.raises(NodeIdTaken, match="node-ID 4 already answers on memory:launch") as caught:
        NodeIdCheck(reactor, port, [3, 4]).finish()
    assert caught.value.node_id == 4
    host.close()
    reactor.close()
    port.close()
    other.close()


def test_a_heartbeat_of_the_id_refuses_it_too():
    bus, reactor = MemoryBus("launch"), Reactor(ManualClock(S))
    port, other = bus.open("new"), bus.open("old")
    check = NodeIdCheck(reactor, port, [3])
    other.send(pack_records([CanFrame(0x704, b"\x05"), CanFrame(0x703, b"\x05")]))
    with pytest.raises(NodeIdTaken):
        check.finish()
    reactor.close()
    port.close()
    other.close()
