"""Ports that can choose what they hear, and those that cannot."""

from __future__ import annotations

from canopen_control.bus.hearing import Selective, hear_only
from canopen_control.bus.memory import MemoryBus
from canopen_control.bus.socketcan import SocketCanPort


class Chooser:
    def __init__(self):
        self.heard = None

    def hear(self, can_ids):
        self.heard = sorted(can_ids)


def test_a_port_that_can_choose_is_told():
    chooser = Chooser()
    hear_only(chooser, {0x183: "anything", 0x80: "else"})
    assert chooser.heard == [0x80, 0x183]


def test_a_port_that_cannot_choose_gives_everything():
    bus = MemoryBus("hearing")
    port = bus.open("anybody")
    assert not isinstance(port, Selective)
    hear_only(port, [0x80])
    port.close()


def test_the_port_of_the_kernels_can_chooses():
    assert issubclass(SocketCanPort, Selective)
