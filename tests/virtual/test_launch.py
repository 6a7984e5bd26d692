from __future__ import annotations

import pytest
from support.virtualbench import S, tmcm

from canopen_control.bus.memory import MemoryBus
from canopen_control.errors import ConfigError, EdsError
from canopen_control.frame import CanFrame, pack_records
from canopen_control.host.reactor import ManualClock, Reactor
from canopen_control.virtual.launch import PROBE_NS, NodeIdTaken, Options, Probe, run_drives
from canopen_control.virtual.nodehost import NodeHost


def test_an_id_that_nobody_has_is_free_after_a_short_wait():
    bus, reactor = MemoryBus("launch"), Reactor(ManualClock(S))
    port = bus.open("new")
    Probe(reactor, port, [3, 4]).finish()
    assert reactor.now() == S + PROBE_NS
    reactor.close()
    port.close()


def test_an_id_that_answers_is_refused_with_a_sentence():
    bus, reactor = MemoryBus("launch"), Reactor(ManualClock(S))
    port, other = bus.open("new"), bus.open("old")
    host = NodeHost(reactor, other, [tmcm(4)])
    reactor.run_for(0)
    port.receive()  # its boot-up was before the question
    with pytest.raises(NodeIdTaken, match="node id 4 already answers on memory:launch") as caught:
        Probe(reactor, port, [3, 4]).finish()
    assert caught.value.node_id == 4
    host.close()
    reactor.close()
    port.close()
    other.close()


def test_a_heartbeat_of_the_id_refuses_it_too():
    bus, reactor = MemoryBus("launch"), Reactor(ManualClock(S))
    port, other = bus.open("new"), bus.open("old")
    probe = Probe(reactor, port, [3])
    other.send(pack_records([CanFrame(0x704, b"\x05"), CanFrame(0x703, b"\x05")]))
    with pytest.raises(NodeIdTaken):
        probe.finish()
    reactor.close()
    port.close()
    other.close()


def test_what_cannot_be_started_is_said_before_anything_runs(tmp_path):
    lines = []
    with pytest.raises(EdsError):
        run_drives([3], tmp_path / "none.eds", "memory:launch", Options(), lines.append)
    with pytest.raises(ConfigError):
        run_drives([3], tmp_path / "none.eds", "local:a/b", Options(), lines.append)
    assert lines == []
