import pytest

from canopen_control.bus.arbitration import duration_ns, frame_bits
from canopen_control.bus.frame_router import DropRule
from canopen_control.bus.port import BusEventKind
from canopen_control.errors import BusClosed
from canopen_control.frame import CanFrame, frames_of, pack_records
from canopen_control.simulation.simulated_wire import RESTART_NS, SimulatedWire
from canopen_control.simulation.virtual_time import START_NS, Actor, Timing, VirtualTime

MS = 1_000_000
LOW, HIGH = CanFrame(0x181, b"\x01\x02"), CanFrame(0x701, b"\x05")


class Bench:
    """Three ends on a wire of 1 Mbit/s; `passed` are time, sender and frame of all that passed on it."""

    def __init__(self):
        self.time = VirtualTime()
        self.wire = SimulatedWire(self.time, "test", 1_000_000)
        self.passed = []
        self.wire.listeners.append(lambda now, label, record: self.passed.append((now, label, *frames_of(record))))
        for label in ("a", "b", "c"):
            self.wire.members[label] = Actor(self.time, label, Timing(), "1")
        self.a, self.b, self.c = (self.wire.open(label) for label in ("a", "b", "c"))

    def close(self):
        for actor in self.wire.members.values():
            actor.end()

    def run(self, ns=MS):
        self.time.run_until(self.time.now_ns + ns)

    def heard(self, port):
        return list(frames_of(port.receive()))


@pytest.fixture
def bench():
    created = Bench()
    yield created
    created.close()


def test_a_frame_is_there_when_its_last_bit_has_passed(bench):
    bench.a.send(pack_records([LOW]))
    takes = duration_ns(frame_bits(LOW.can_id, LOW.data), 1_000_000)
    bench.run(takes - 1)
    assert bench.heard(bench.b) == []
    bench.run(1)
    assert bench.heard(bench.b) == [LOW] == bench.heard(bench.c)
    assert bench.heard(bench.a) == []
    assert bench.passed == [(START_NS + takes, "a", LOW)]
    assert bench.wire.frames == 1
    assert bench.wire.bits == frame_bits(LOW.can_id, LOW.data)


def test_the_lower_identifier_wins_the_bus(bench):
    bench.a.send(pack_records([HIGH, HIGH]))
    bench.b.send(pack_records([LOW]))
    bench.run()
    assert [frame for _, _, frame in bench.passed] == [HIGH, LOW, HIGH]


def test_a_port_with_filters_is_not_woken_for_other_frames(bench):
    bench.b.set_filter([HIGH.can_id])
    bench.a.send(pack_records([LOW, HIGH]))
    bench.run()
    assert bench.heard(bench.b) == [HIGH]
    assert bench.heard(bench.c) == [LOW, HIGH]


def test_frames_are_lost_and_doubled_as_rules_report(bench):
    bench.wire.lost.append(DropRule("a", every=2))
    bench.a.send(pack_records([LOW, HIGH]))
    bench.run()
    assert bench.heard(bench.c) == [LOW]
    bench.wire.lost.clear()
    bench.wire.doubled.append(DropRule())
    bench.a.send(pack_records([LOW]))
    bench.run()
    assert bench.heard(bench.c) == [LOW, LOW]


def test_a_disturbed_frame_is_sent_again(bench):
    bench.wire.disturbed.append(DropRule("a", count=1))
    bench.a.send(pack_records([LOW, HIGH]))
    bench.run()
    assert [frame for _, _, frame in bench.passed] == [LOW, HIGH]
    assert bench.wire.bits == 2 * frame_bits(*LOW) + frame_bits(*HIGH)


def test_a_sender_that_is_disturbed_all_the_time_goes_error_passive_then_off_the_bus_and_returns(bench):
    bench.wire.disturbed.append(DropRule("a"))
    bench.a.send(pack_records([LOW]))
    bench.run(20 * MS)
    bench.a.receive()
    assert [event.kind for event in bench.a.events()] == [BusEventKind.ERROR_PASSIVE, BusEventKind.BUS_OFF]
    bench.a.send(pack_records([HIGH]))
    assert bench.a.stats.lost == 1
    bench.wire.disturbed.clear()
    bench.run(RESTART_NS)
    bench.a.receive()
    assert [event.kind for event in bench.a.events()] == [BusEventKind.ERROR_ACTIVE]
    bench.a.send(pack_records([HIGH]))
    bench.run()
    assert bench.heard(bench.b)[-1] == HIGH


def test_a_cut_cable_carries_nothing_either_way(bench):
    bench.wire.cut.add("a")
    bench.a.send(pack_records([LOW]))
    bench.b.send(pack_records([HIGH]))
    bench.run()
    assert bench.heard(bench.a) == []
    assert bench.heard(bench.c) == [HIGH]
    assert bench.a.stats.lost == 1


def test_a_frame_of_a_stranger_reaches_all(bench):
    bench.wire.inject(HIGH)
    assert bench.heard(bench.a) == [HIGH] == bench.heard(bench.b)


def test_a_closed_port_is_gone_with_what_it_had_to_report(bench):
    bench.a.send(pack_records([LOW, HIGH]))
    bench.a.close()
    bench.a.close()
    bench.run()
    assert bench.heard(bench.b) == []
    with pytest.raises(BusClosed):
        bench.a.send(pack_records([LOW]))
    with pytest.raises(BusClosed):
        bench.a.receive()
