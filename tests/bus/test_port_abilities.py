"""Filters and time stamps, of ports that have them and of others."""

from __future__ import annotations

import pytest

from canopen_control.bus.memory import MemoryBus
from canopen_control.bus.port_abilities import Filtering, Stamping, receive_stamped, set_filter
from canopen_control.bus.socketcan import SocketCanPort
from canopen_control.errors import BusClosed
from canopen_control.frame import CanFrame, frames_of, pack_records

ONE, TWO = CanFrame(0x181, b"1"), CanFrame(0x182, b"2")


def test_a_port_without_stamps_gives_the_time_of_reading_to_every_record():
    bus = MemoryBus.get("stamps")
    sender, reader = bus.open("sender"), bus.open("reader")
    assert not isinstance(reader, Stamping)
    assert receive_stamped(reader, lambda: 5) == (b"", [])
    sender.send(pack_records([ONE, TWO]))
    records, stamps = receive_stamped(reader, lambda: 7)
    assert (list(frames_of(records)), stamps) == ([ONE, TWO], [7, 7])
    reader.close()
    with pytest.raises(BusClosed):
        receive_stamped(reader)
    sender.close()


def test_a_port_that_knows_better_is_asked():
    class Knowing:
        def receive_stamped(self):
            return pack_records([ONE]), [3]

    assert receive_stamped(Knowing(), lambda: 99) == (pack_records([ONE]), [3])


class Filters:
    def __init__(self):
        self.heard = None

    def set_filter(self, can_ids):
        self.heard = sorted(can_ids)


def test_a_port_that_can_filter_is_told():
    port = Filters()
    set_filter(port, {0x183: "anything", 0x80: "else"})
    assert port.heard == [0x80, 0x183]


def test_a_port_that_cannot_filter_gives_everything():
    bus = MemoryBus("hearing")
    port = bus.open("anybody")
    assert not isinstance(port, Filtering)
    set_filter(port, [0x80])
    port.close()


def test_the_port_of_the_kernels_can_filters():
    assert issubclass(SocketCanPort, Filtering)
