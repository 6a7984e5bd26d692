from __future__ import annotations

import json

import pytest
from support.virtualbench import S, tmcm

from canopen_control.bus import local
from canopen_control.bus.memory import MemoryBus
from canopen_control.data_files import data_path
from canopen_control.errors import ConfigError, EdsError
from canopen_control.frame import CanFrame, pack_records
from canopen_control.host.reactor import Reactor
from canopen_control.host.sockets import close_listener, listen, socket_path
from canopen_control.host.timer import ManualClock
from canopen_control.virtual import launch
from canopen_control.virtual.device import FORMAT
from canopen_control.virtual.launch import PROBE_NS, DriveOptions, NodeIdCheck, reopen, run_drives
from canopen_control.virtual.node_host import NodeHost, NodeIdTaken
from canopen_control.virtual.process import DriveProcess


def test_what_cannot_be_started_is_reported_before_anything_runs(tmp_path):
    lines = []
    with pytest.raises(EdsError):
        run_drives([3], tmp_path / "none.eds", "memory:launch", DriveOptions(), lines.append)
    with pytest.raises(ConfigError):
        run_drives([3], tmp_path / "none.eds", "local:a/b", DriveOptions(), lines.append)
    assert lines == []


def test_a_node_id_that_lss_has_stored_is_checked_as_well(tmp_path, monkeypatch):
    checked = []

    class Check:
        def __init__(self, _reactor, _port, node_ids):
            checked.append([*node_ids])

        def finish(self):
            pass

    monkeypatch.setattr(launch, "NodeIdCheck", Check)
    monkeypatch.setattr(DriveProcess, "run", lambda _process: 0)
    record = {"device": [0x286, 0x4F6], "node_id": 9, "bitrate": None, "values": {}}
    (tmp_path / "store.json").write_text(json.dumps({"format": FORMAT, "nodes": {"3": record}}))
    options = DriveOptions(store=tmp_path / "store.json")
    assert run_drives([3, 4], data_path("eds", "TMCM-1270.eds"), "memory:launch", options, print) == 0
    assert checked == [[3, 4], [9]]


def test_a_bus_whose_hub_dies_at_this_moment_is_not_started_for_a_drive_that_looks_for_it(monkeypatch):
    started = []
    monkeypatch.setattr(local, "_start_hub", started.append)
    dying = listen(socket_path("bus", "dying"))  # connects, and never greets
    monkeypatch.setattr(local, "greet", lambda sock, *_: sock.close())  # as who is reset instead of greeted
    assert reopen("local:dying", "drive 3") is None
    close_listener(dying)
    assert reopen("local:dying", "drive 3") is None
    assert reopen("memory:gone", "drive 3") is None
    assert started == []


# -- node id check


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
