"""python-can adapters as ports: the virtual one as it is, and a scripted one that fails."""

from __future__ import annotations

import importlib.util
import re
import select
import struct
import threading
import time
import tracemalloc
import zlib

import can
import pytest
from can.io import blf
from hypothesis import given
from hypothesis import strategies as st
from support.localbus import TIMEOUT_S, receive
from support.scripted_can import ScriptedBus

from canopen_control.bus.channel import open_port
from canopen_control.bus.port import BusEventKind
from canopen_control.bus.port_abilities import Arrivals
from canopen_control.bus.pythoncan import (
    LARGEST_CONTAINER,
    AdapterClock,
    PythonCanPort,
    known_interfaces,
    message_of,
    record_of,
)
from canopen_control.bus.recordings import Recording, RecordingWriter
from canopen_control.errors import BusClosed, BusError, ConfigError, InterfaceNotFound
from canopen_control.frame import ERROR_FLAG, EXTENDED_FLAG, REMOTE_FLAG, CanFrame, pack_records

FRAMES = [
    CanFrame(0x181, b"\x01\x02"),
    CanFrame(0x1ABCDE | EXTENDED_FLAG, b"12345678"),
    CanFrame(0x703 | REMOTE_FLAG, b"\0"),
    CanFrame(0x80),
]


@pytest.fixture
def scripted():
    bus = ScriptedBus()
    port = PythonCanPort("test:scripted", bus, writer=True)
    yield bus, port
    port.close()
    assert bus.stopped.is_set()


@pytest.fixture
def pair():
    ports = [open_port("virtual:pair"), open_port("virtual:pair")]
    yield ports
    for port in ports:
        port.close()


def wait_for_event(port):
    assert select.select([port], [], [], TIMEOUT_S)[0]
    port.receive()
    (event,) = port.events()
    return event


def test_frames_of_every_kind_arrive_in_order_and_not_at_their_sender(pair):
    a, b = pair
    a.send(pack_records(FRAMES))
    assert receive(b, len(FRAMES)) == FRAMES
    assert a.receive() == b""
    assert (a.stats.tx, b.stats.rx) == (4, 4)


def test_two_names_are_two_buses(pair):
    other = open_port("virtual:other")
    other.send(pack_records(FRAMES))
    pair[0].send(pack_records(FRAMES[:1]))
    assert receive(pair[1], 1) == FRAMES[:1]
    assert other.receive() == b""
    other.close()


def test_a_closed_port_reports_this(pair):
    pair[0].close()
    pair[0].close()
    assert pair[0].fileno() == -1
    for verb in (pair[0].receive, lambda: pair[0].send(b"")):
        with pytest.raises(BusClosed, match="virtual:pair: closed on this side"):
            verb()


def test_the_writer_sends_in_order(scripted):
    bus, port = scripted
    frames = [CanFrame(0x200, bytes([n])) for n in range(50)]
    port.send(pack_records(frames))
    assert [bus.sent.get(timeout=TIMEOUT_S).data[0] for _ in frames] == list(range(50))
    port.flush()
    assert port.wants_write is False


def test_a_refused_frame_is_tried_again_and_the_trouble_reported_once(scripted):
    bus, port = scripted
    for _ in range(2):
        bus.send_errors.put(can.CanOperationError("transmit buffer full"))
    port.send(pack_records(FRAMES[:1]))
    assert bus.sent.get(timeout=TIMEOUT_S).arbitration_id == FRAMES[0].can_id
    events = []
    while not events or events[-1].kind is not BusEventKind.UP:
        assert select.select([port], [], [], TIMEOUT_S)[0]
        port.receive()
        events += port.events()
    assert [event.kind for event in events] == [BusEventKind.DOWN, BusEventKind.UP]
    assert events[0].text == "bus test:scripted: transmit buffer full; retrying"
    assert port.stats.lost == 0


def test_a_receive_error_is_reported_and_reception_continues(scripted):
    bus, port = scripted
    bus.incoming.put(can.CanOperationError("Network is down", 100))
    assert wait_for_event(port).kind is BusEventKind.DOWN
    bus.incoming.put(message_of(FRAMES[0], 0.0))
    assert receive(port, 1) == FRAMES[:1]
    assert [event.kind for event in port.events()] == [BusEventKind.UP]


class DriverError(Exception):
    """What a driver's library raises: no CanError, no OSError."""


def next_event(port):
    while not (events := port.events()):
        assert select.select([port], [], [], TIMEOUT_S)[0]
        port.receive()
    return events[0].kind


@pytest.mark.parametrize("error", [DriverError("closed by its peer"), ValueError(""), MemoryError()])
def test_whatever_an_adapter_raises_it_is_down_opened_again_and_up(error, monkeypatch):
    monkeypatch.setattr("canopen_control.bus.pythoncan._BROKEN_S", {"receive": 0.05, "send": 0.05})
    monkeypatch.setattr("canopen_control.bus.pythoncan._REOPEN_S", (0.01,))
    broken, whole = ScriptedBus(), ScriptedBus()
    answers = [DriverError("no such device"), OSError("no route"), whole]

    def reopen():
        answer = answers.pop(0)
        if isinstance(answer, Exception):
            raise answer
        return answer

    port = PythonCanPort("test:scripted", broken, writer=True, reopen=reopen)
    for _ in range(10):
        broken.incoming.put(error)
    assert next_event(port) is BusEventKind.DOWN
    assert broken.stopped.wait(TIMEOUT_S)
    assert next_event(port) is BusEventKind.UP
    whole.incoming.put(message_of(FRAMES[0], 0.0))
    assert receive(port, 1) == FRAMES[:1]
    port.send(pack_records(FRAMES[:1]))
    assert whole.sent.get(timeout=TIMEOUT_S).arbitration_id == FRAMES[0].can_id
    port.close()
    assert whole.stopped.is_set()


def test_what_was_to_be_sent_while_it_was_down_is_lost_and_counted():
    bus = ScriptedBus()
    port = PythonCanPort("test:scripted", bus, writer=True)
    bus.incoming.put(DriverError("gone"))
    assert next_event(port) is BusEventKind.DOWN
    port.send(pack_records(FRAMES))
    bus.incoming.put(message_of(FRAMES[0], 0.0))
    assert next_event(port) is BusEventKind.UP
    port.send(pack_records(FRAMES[1:2]))
    assert bus.sent.get(timeout=TIMEOUT_S).arbitration_id == FRAMES[1].can_id & 0x1FFFFFFF
    assert port.stats.lost == len(FRAMES)
    port.close()


def test_a_driver_that_hangs_blocks_no_client(monkeypatch):
    monkeypatch.setattr("canopen_control.bus.pythoncan._SHUTDOWN_S", 0.1)
    forever = threading.Event()

    class Hanging(ScriptedBus):
        def _recv_internal(self, timeout):
            forever.wait()
            return None, False

        def send(self, msg, timeout=None):
            forever.wait()

        def shutdown(self):
            forever.wait()

    port = PythonCanPort("test:hanging", Hanging(), writer=True)
    port.send(pack_records(FRAMES))
    port.close()
    assert port.fileno() == -1
    forever.set()


def test_a_can_fd_frame_is_counted_as_lost(scripted):
    bus, port = scripted
    bus.incoming.put(can.Message(arbitration_id=1, is_fd=True))
    bus.incoming.put(message_of(FRAMES[0], 0.0))
    assert receive(port, 1) == FRAMES[:1]
    assert port.stats.lost == 1


def test_an_unknown_interface_is_answered_with_the_known_ones():
    with pytest.raises(InterfaceNotFound, match=r"python-can has no interface 'nosuchthing'; choose one of: .*virtual"):
        open_port("nosuchthing:0")


@pytest.mark.process
def test_a_driver_that_is_not_there_is_one_sentence():
    with pytest.raises(BusError, match=r"bus pcan:PCAN_USBBUS1@125000: .*check its driver"):
        open_port("pcan:PCAN_USBBUS1@125000")


@pytest.mark.parametrize(("interface", "package"), [("slcan", "pyserial"), ("gs_usb", "gs-usb")])
def test_a_package_that_an_adapter_needs_is_named(monkeypatch, interface, package):
    result = importlib.util.find_spec
    absent = ("serial", "gs_usb")
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name, *more: None if name in absent else result(name, *more)
    )
    with pytest.raises(ConfigError, match=f"{interface} needs {package}, which .*: pip install {package}"):
        open_port(f"{interface}:/dev/nonexistent@125000")


def test_the_known_interfaces_leave_out_what_has_a_better_way_in():
    known = known_interfaces()
    assert {"virtual", "pcan", "slcan"} <= set(known)
    assert not {"socketcan", "canopen_control"} & set(known)


frames = st.one_of(
    st.builds(CanFrame, st.integers(0, 0x7FF), st.binary(max_size=8)),
    st.builds(
        lambda can_id, data: CanFrame(can_id | EXTENDED_FLAG, data), st.integers(0, 2**29 - 1), st.binary(max_size=8)
    ),
    st.builds(
        lambda can_id, length: CanFrame(can_id | REMOTE_FLAG, bytes(length)), st.integers(0, 0x7FF), st.integers(0, 8)
    ),
    st.builds(
        lambda classes, data: CanFrame(classes | ERROR_FLAG, data),
        st.integers(0, 2**29 - 1),
        st.binary(min_size=8, max_size=8),
    ),
)


@given(frames)
def test_a_frame_becomes_a_message_and_the_same_frame_again(frame):
    message = message_of(frame, 12.5, "local:x")
    assert record_of(message) == pack_records([frame])
    assert (message.timestamp, message.channel) == (12.5, "local:x")


# Time stamps

S = 1_000_000_000
UNIX = 1_800_000_000


class Clocks:
    """Our clocks at 900 s of monotonic time, and one of an adapter's that says `zero` then and goes `drift` fast."""

    def __init__(self, zero=0.0, drift=0.0):
        self.now, self.unix, self.zero, self.drift = 900 * S, UNIX * S, zero, drift
        self.clock = AdapterClock(lambda: self.now, lambda: self.unix)

    def stamp(self, later_ns=0):
        """Return by how much a frame is wrong that comes now and is read `later_ns` later."""
        came, reported = self.now, self.zero + (self.now - 900 * S) / S * (1 + self.drift)
        self.later(later_ns)
        return self.clock.stamp(reported) - came

    def later(self, ns):
        self.now += ns
        self.unix += ns


def test_an_adapter_without_a_clock_stamps_when_a_frame_is_handed_over():
    assert Clocks().clock.stamp(0.0) == 900 * S


@pytest.mark.parametrize("later_ns", [0, 50_000, 900_000_000])
def test_unix_time_of_an_adapter_is_taken_as_it_is(later_ns):
    clocks = Clocks(zero=float(UNIX))
    for _ in range(5):
        assert abs(clocks.stamp(later_ns)) <= 500, "as exact as a float of it"
        clocks.later(S)


def test_unix_time_that_is_set_does_not_show():
    clocks = Clocks(zero=float(UNIX))
    clocks.stamp(1000)
    clocks.later(S)
    clocks.unix -= 100 * S
    clocks.zero -= 100
    assert abs(clocks.stamp(1000)) <= 500


@pytest.mark.parametrize("zero", [1e-6, 12345.0, UNIX + 77.0, UNIX - 77.0])
@pytest.mark.parametrize("drift", [0.0, 5e-5, -5e-5])
def test_a_clock_of_its_own_is_laid_by_what_was_read_soonest(zero, drift):
    clocks = Clocks(zero, drift)
    delays = [3_000_000, 200_000, 5_000_000, 200_000, 900_000, 40_000_000, 200_000]
    for number in range(70):
        wrong = clocks.stamp(delays[number % len(delays)])
        if number > len(delays):
            assert 0 <= wrong <= 260_000, (number, wrong)
        clocks.later(20_000_000)


@pytest.mark.parametrize("zero", [0.000_1, 5000.0])
def test_a_clock_that_restarts_is_laid_again(zero):
    clocks = Clocks(4294.0)
    clocks.stamp(100_000)
    clocks.later(S)
    clocks.zero = zero - 1.0001
    assert abs(clocks.stamp(100_000)) <= 100_500


def test_a_port_hands_over_the_adapters_times(scripted):
    bus, port = scripted
    arrivals = Arrivals(port)
    reported = [time.time() - 0.5 + number / 1000 for number in range(3)]
    for number, each in enumerate(reported):
        bus.incoming.put(can.Message(timestamp=each, arbitration_id=0x180 + number, is_extended_id=False))
    stamps = []
    while len(stamps) < 3:
        assert select.select([port], [], [], TIMEOUT_S)[0]
        stamps += arrivals.receive()[1]
    unix = [(stamp + arrivals.unix_offset_ns) / S for stamp in stamps]
    assert unix == pytest.approx(reported, abs=0.01, rel=0)
    assert [round((later - stamps[0]) / 1e6) for later in stamps] == [0, 1, 2]


def test_what_came_before_stamps_were_asked_for_has_none(scripted):
    bus, port = scripted
    bus.incoming.put(message_of(FRAMES[0], time.time()))
    assert select.select([port], [], [], TIMEOUT_S)[0]
    port.ask_stamps()
    assert port.receive_stamped() == (pack_records(FRAMES[:1]), [0])
    assert port.receive_stamped() == (b"", [])


# BLF files with lengths that lie: each is read as far as it is true, and takes no more memory than it should.


OBJECT = struct.Struct("<4sHHLL")
FIRST = 144  # where the first object begins


@pytest.fixture
def path(tmp_path):
    path = tmp_path / "x.blf"
    with RecordingWriter(path, "can0") as writer:
        for number in range(50):
            writer.write(1_700_000_000_000_000_000 + number * 1_000_000, CanFrame(0x181, bytes([number])))
    return path


def read(path):
    """Return how many frames there are, what is said, and the most memory that it took, in bytes."""
    recording = Recording(path)
    tracemalloc.start()
    count = len(list(recording))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return count, recording.problem, peak


def container(data):
    packed = struct.pack("<H6xL4x", blf.ZLIB_DEFLATE, len(data)) + zlib.compress(data)
    return OBJECT.pack(b"LOBJ", 16, 1, OBJECT.size + len(packed), blf.LOG_CONTAINER) + packed


def test_it_reads_what_was_written(path):
    assert read(path)[:2] == (50, "")


@pytest.mark.parametrize(
    ("at", "value", "words"),
    [
        (4, 0xFFFFFFF0, "contains no frames|middle of a frame"),  # the header of the file claims four gigabytes
        (FIRST + 8, 0xFFFFFFF0, "the file ends in the middle of a frame"),  # an object does
        (FIRST + 8, 3, "an object has no valid signature or length"),  # an object is shorter than its header
        (FIRST, 0, "an object has no valid signature or length"),
    ],
)
def test_a_length_that_lies_is_a_sentence_and_no_memory(path, at, value, words):
    data = bytearray(path.read_bytes())
    data[at : at + 4] = value.to_bytes(4, "little")
    path.write_bytes(data)
    count, problem, peak = read(path)
    assert count == 0
    assert peak < 4 << 20
    assert re.search(words, problem), problem


@pytest.mark.rest
def test_a_container_that_unpacks_to_gigabytes_is_refused(path):
    path.write_bytes(path.read_bytes()[:FIRST] + container(bytes(LARGEST_CONTAINER + 1)))
    count, problem, peak = read(path)
    assert (count, problem.split(": ")[-1]) == (0, "a container unpacks to more than 64 MiB")
    assert peak < 3 * LARGEST_CONTAINER


def test_an_object_of_no_length_does_not_hold_the_reader_for_ever(path):
    endless = OBJECT.pack(b"LOBJ", 32, 1, 0, 1) + bytes(64)
    path.write_bytes(path.read_bytes()[:FIRST] + container(endless))
    count, problem, _ = read(path)
    assert (count, problem.split(": ")[-1]) == (0, "an object is shorter than its header")
