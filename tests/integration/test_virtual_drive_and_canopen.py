"""The `canopen` package as an independent master drives our virtual drive, on each kind of python-can bus."""

from __future__ import annotations

import contextlib
import threading

import canopen
import pytest
from support.channel import CHANNEL, python_can_of
from support.host import eventually

from canopen_control.bus.channel import open_port
from canopen_control.data_files import data_path
from canopen_control.host.reactor import Reactor
from canopen_control.virtual.device import make_device
from canopen_control.virtual.node_host import NodeHost

TMCM = data_path("eds", "TMCM-1270.eds")
GENERIC = data_path("eds", "generic_cia402.eds")
NODE = 3


@contextlib.contextmanager
def running(eds, channel):
    """Run a virtual device in a thread; yield a network of the other stack with its remote node."""
    ready, ended = threading.Event(), []
    reactor = Reactor()
    device = make_device(eds, NODE)

    def serve():
        with reactor, contextlib.closing(open_port(CHANNEL or f"virtual:{channel}")) as port:
            host = NodeHost(reactor, port, [device])
            reactor.call_soon(ready.set)
            reactor.run()
            host.close()
        ended.append(reactor.errors)

    thread = threading.Thread(target=serve)
    network = canopen.Network()
    network.connect(**(python_can_of(channel) if CHANNEL else {"interface": "virtual", "channel": channel}))
    thread.start()
    try:
        assert ready.wait(60)
        node = network.add_node(NODE, str(eds))
        node.sdo.RESPONSE_TIMEOUT = 5.0
        yield network, node, device
    finally:
        reactor.call_threadsafe(reactor.stop)
        thread.join(60)
        network.disconnect()
    assert ended == [0]


def state_of(node):
    return node.sdo[0x6041].raw & 0x6F


def enable(node, mode):
    node.sdo[0x6060].raw = mode
    assert node.sdo[0x6061].raw == mode
    for word, state in ((0x06, 0x21), (0x07, 0x23), (0x0F, 0x27)):
        node.sdo[0x6040].raw = word
        assert state_of(node) == state


def test_it_reads_identity_strings_and_abort_codes():
    with running(TMCM, "oracle1") as (_, node, _):
        assert node.sdo[0x1000].raw == 0xFFFF0192
        assert [node.sdo[0x1018][sub].raw for sub in (1, 2, 4)] == [0x286, 0x4F6, NODE]
        assert node.sdo[0x1008].raw == "TMCM-1270"
        for index, sub, data, code in (
            (0x1000, 0, bytes(4), 0x06010002),
            (0x5000, 0, bytes(4), 0x06020000),
            (0x6060, 0, b"\x09", 0x06090030),
        ):
            with pytest.raises(canopen.SdoAbortedError) as aborted:
                node.sdo.download(index, sub, data)
            assert aborted.value.code == code


def test_it_boots_starts_and_shows_its_heartbeat():
    with running(TMCM, "oracle2") as (_, node, _):
        node.sdo[0x1017].raw = 20
        node.nmt.wait_for_heartbeat(5)
        assert node.nmt.state == "PRE-OPERATIONAL"
        for state in ("OPERATIONAL", "STOPPED", "PRE-OPERATIONAL"):
            node.nmt.state = state
            assert eventually(lambda state=state: node.nmt.wait_for_heartbeat(5) == state)
        node.nmt.send_command(0x81)
        node.nmt.wait_for_bootup(5)
        assert node.sdo[0x1017].raw == 0


def test_its_process_data_can_be_mapped_again_and_carry_profile_velocity():
    with running(TMCM, "oracle3") as (network, node, device):
        for index in (0x6083, 0x6085):
            node.sdo[index].raw = 160_000
        node.pdo.read()
        for number, names in ((1, ("Statusword 1", "Modes of Operation Display 1")), (2, (0x6064, 0x606C))):
            tpdo = node.tpdo[number]
            tpdo.clear()
            for name in names:
                tpdo.add_variable(name)
            tpdo.trans_type, tpdo.enabled = 1, True
        node.rpdo[2].clear()
        node.rpdo[2].add_variable(0x6040)
        node.rpdo[2].add_variable(0x60FF)
        node.rpdo[2].enabled = True
        node.pdo.save()
        node.nmt.state = "OPERATIONAL"
        enable(node, 3)
        node.rpdo[2][0x6040].raw, node.rpdo[2][0x60FF].raw = 0x0F, 2546
        node.rpdo[2].transmit()
        assert eventually(lambda: node.sdo[0x606C].raw == 2546)
        network.sync.transmit()
        node.tpdo[2].wait_for_reception(5)
        assert node.tpdo[2][0x606C].raw == 2546
        assert node.tpdo[2][0x6064].raw > 0
        node.rpdo[2][0x6040].raw = 0x02  # quick stop
        node.rpdo[2].transmit()
        assert eventually(lambda: state_of(node) == 0x40)
        assert node.sdo[0x606C].raw == 0
        assert device.drives[0].mover.at_standstill


def test_profile_position_with_its_handshake():
    with running(TMCM, "oracle4") as (_, node, _):
        for index in (0x6083, 0x6084, 0x6085):
            node.sdo[index].raw = 1_000_000
        node.sdo[0x6081].raw = 20_000
        node.nmt.state = "OPERATIONAL"
        enable(node, 1)
        node.sdo[0x607A].raw = 2000
        node.sdo[0x6040].raw = 0x1F
        assert node.sdo[0x6041].raw & 0x1000
        node.sdo[0x6040].raw = 0x0F
        assert eventually(lambda: node.sdo[0x6041].raw & 0x1400 == 0x0400)
        assert node.sdo[0x6064].raw == 2000


def test_homing_on_the_spot():
    with running(TMCM, "oracle5") as (_, node, device):
        device.drives[0].mover.plant.position = 777.0
        node.nmt.state = "OPERATIONAL"
        node.sdo[0x6098].raw = 35
        enable(node, 6)
        node.sdo[0x6040].raw = 0x1F
        assert node.sdo[0x6041].raw & 0x3400 == 0x1400
        assert node.sdo[0x6064].raw == 0


def test_a_fault_is_an_emergency_and_its_reset_one_too():
    with running(GENERIC, "oracle6") as (_, node, device):
        received = []
        node.emcy.add_callback(lambda error: received.append((error.code, error.register)))
        node.nmt.state = "OPERATIONAL"
        modes = [mode for mode in (3, 1, 8, 9) if node.sdo[0x6502].raw >> (mode - 1) & 1]
        enable(node, modes[0])
        device.drives[0].power.causes.add(0x4310)
        device.drives[0].fault(0x4310, device.clock.now, register=8)
        assert eventually(lambda: state_of(node) & 0x4F == 0x08 and bool(received))
        node.sdo[0x6040].raw = 0x80
        assert state_of(node) & 0x4F == 0x08
        device.drives[0].power.causes.clear()
        node.sdo[0x6040].raw = 0
        node.sdo[0x6040].raw = 0x80
        assert state_of(node) == 0x40
        assert eventually(lambda: len(received) == 2)
        assert received == [(0x4310, 0x09), (0x0000, 0x00)]


def test_every_mode_of_a_generic_drive_is_reached():
    with running(GENERIC, "oracle7") as (_, node, _):
        node.nmt.state = "OPERATIONAL"
        supported = node.sdo[0x6502].raw
        for mode in (1, 2, 3, 4, 6, 7, 8, 9, 10):
            if supported >> (mode - 1) & 1:
                enable(node, mode)
                node.sdo[0x6040].raw = 0
                assert state_of(node) == 0x40
