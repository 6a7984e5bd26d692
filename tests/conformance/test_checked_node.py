"""Frames between a check and its node, in virtual time."""

import pytest

from canopen_control.cia301.nmt import NmtCommand, NmtState
from canopen_control.conformance.checked_node import NotApplicable
from canopen_control.errors import BusClosed


def test_transfers_and_silence_take_virtual_time_only(bench):
    node = bench()
    begin = node.reactor.now()
    assert node.ask(bytes(7)) is None
    assert node.reactor.now() - begin == 500_000_000
    assert len(node.read(0x1000)) == 4


def test_a_boot_up_shows_after_a_reset(bench):
    node = bench()
    node.nmt(NmtCommand.RESET_NODE)
    assert node.heartbeat(5.0) is NmtState.INITIALISING


def test_an_absent_object_is_not_applicable(bench):
    with pytest.raises(NotApplicable, match="0x1004:00 cannot be read: 0x06020000"):
        bench().optional(0x1004)


def test_a_lost_bus_raises(bench):
    node = bench()
    node.port.lose("unplugged")
    with pytest.raises(BusClosed):
        node.read(0x1000)
