"""Filters and time stamps, of ports that have them and of others."""

from __future__ import annotations

import pytest

from canopen_control.bus.memory import MemoryBus
from canopen_control.bus.port_abilities import Arrivals, Filtering, Stamping, UnixOffset, set_filter
from canopen_control.errors import BusClosed
from canopen_control.frame import CanFrame, frames_of, pack_records

S = 1_000_000_000
ONE, TWO = CanFrame(0x181, b"1"), CanFrame(0x182, b"2")


def test_a_port_without_stamps_gives_the_time_of_reading_and_each_record_its_own():
    bus = MemoryBus.get("stamps")
    sender, reader = bus.open("sender"), bus.open("reader")
    assert not isinstance(reader, Stamping)
    now = 5 * S
    arrivals = Arrivals(reader, lambda: now)
    assert arrivals.receive() == (b"", [])
    sender.send(pack_records([ONE, TWO]))
    records, stamps = arrivals.receive()
    assert (list(frames_of(records)), stamps) == ([ONE, TWO], [now, now + 1000])
    sender.send(pack_records([ONE]))
    assert arrivals.receive()[1] == [now + 2000], "later than what came before, though the clock stands"
    reader.close()
    with pytest.raises(BusClosed):
        arrivals.receive()
    sender.close()


class Knowing:
    """A port that says what is in `collected`."""

    def __init__(self, collected):
        self.collected, self.asked = collected, 0

    def ask_stamps(self):
        self.asked += 1

    def receive_stamped(self):
        return pack_records([ONE] * len(self.collected)), [*self.collected]


def test_a_port_with_its_own_state_is_asked_at_once():
    port = Knowing([3000])
    arrivals = Arrivals(port, lambda: 99_000)
    assert port.asked == 1
    assert arrivals.receive() == (pack_records([ONE]), [3000])


@pytest.mark.parametrize(
    ("reported", "inputs"),
    [
        ([5000, 7000], [5000, 7000]),
        ([5000, 5000, 5000], [5000, 6000, 7000]),
        ([5000, 5999], [5000, 6000]),
        ([5000, 1000, 9000], [5000, 6000, 9000]),
        ([0, 0], [99_000, 100_000]),
        ([5000, 0, 7000], [5000, 99_000, 100_000]),
    ],
)
def test_times_are_strictly_increasing_by_what_a_recording_can_keep(reported, inputs):
    assert Arrivals(Knowing(reported), lambda: 99_000).receive()[1] == inputs


class Clocks:
    """Unix time is monotonic time and `offset`; between two readings `pauses` pass, 0 when there are none left."""

    def __init__(self, offset, pauses=()):
        self.now, self.offset, self.pauses = S, offset, [*pauses]

    def monotonic(self):
        self.now += self.pauses.pop(0) if self.pauses else 0
        return self.now

    def unix(self):
        self.now += self.pauses.pop(0) if self.pauses else 0
        return self.now + self.offset


def test_a_pause_between_two_clocks_does_no_harm():
    clocks = Clocks(1700 * S, [0, 0, 15_000_000, 0, 9_000_000, 0, 0, 0, 40])
    offset = UnixOffset(clocks.monotonic, clocks.unix)
    assert abs(offset.ns() - 1700 * S) <= 20
    clocks.pauses = [0, 0, 15_000_000]
    assert abs(offset.ns() - 1700 * S) <= 20
    clocks.pauses = [0, 15_000_000, 0]
    assert abs(offset.ns() - 1700 * S) <= 20


@pytest.mark.parametrize("step", [-2 * S, 3600 * S, 1_000_000])
def test_a_clock_that_is_set_is_followed(step):
    clocks = Clocks(1700 * S)
    offset = UnixOffset(clocks.monotonic, clocks.unix)
    clocks.offset += step
    assert offset.ns() == 1700 * S + step


class Filters:
    def __init__(self):
        self.heard = None

    def set_filter(self, can_ids):
        self.heard = sorted(can_ids)


def test_a_port_that_can_filter_is_reported():
    port = Filters()
    set_filter(port, {0x183: "anything", 0x80: "else"})
    assert port.heard == [0x80, 0x183]


def test_a_port_that_cannot_filter_gives_everything():
    bus = MemoryBus("hearing")
    port = bus.open("anybody")
    assert not isinstance(port, Filtering)
    set_filter(port, [0x80])
    port.close()
