import select
from types import SimpleNamespace

import pytest
from support.host import TIMEOUT_S
from support.localbus import end_hubs

from canopen_control.bus.channel import open_port
from canopen_control.frame import CanFrame, pack_records
from canopen_control.host.sockets import list_sockets
from canopen_control.monitor.frame_tables import BusTap
from canopen_control.trace.network_description import NetworkDescription

SECOND = 1_000_000_000


@pytest.fixture
def channel(private_folders):
    yield "local:tap"
    end_hubs()


def receive_until(tap, found, count):
    while len(found) < count:
        assert select.select([tap._port.fileno()], [], [], TIMEOUT_S)[0]
        tap.receive()


@pytest.mark.process
def test_it_receives_what_others_send_and_sends_nothing_itself(channel):
    result, ports = [], []
    watcher = SimpleNamespace(port_changed=ports.append)
    with_others = open_port(channel, label="others")
    tap = BusTap(NetworkDescription(channel), result.append)
    tap.watch(watcher)
    assert tap.problem == "not opened yet"
    tap.tick(0)
    assert (tap.problem, len(ports)) == ("", 1)
    assert list_sockets("bus") == ["tap"]
    with_others.send(pack_records([CanFrame(0x703, b"\x05"), CanFrame(0x000, b"\x01\x00")]))
    receive_until(tap, result, 2)
    assert [item.service for item in result] == ["hb", "nmt"]
    assert tap._port.stats.tx == 0
    assert with_others.receive() == b""
    tap.close()
    tap.close()
    assert ports[-1] is None
    with_others.close()


def test_a_bus_that_cannot_be_opened_is_a_sentence_and_tried_again_once_a_second():
    tap = BusTap(NetworkDescription("memory:inside"), lambda _: None)
    tap.tick(0)
    assert "inside one process" in tap.problem
    tap.problem = "old"
    tap.tick(SECOND - 1)
    assert tap.problem == "old"
    tap.tick(SECOND)
    assert "inside one process" in tap.problem
