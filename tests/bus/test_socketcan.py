"""The SocketCAN port on a scripted socket: errno by errno, and error frames as real controllers send them."""

from __future__ import annotations

import errno
import os
import socket
import struct
import types

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.error_frames import DRIVER_FRAMES, NAMES

from canopen_control.bus.error_frames import overrun_frame
from canopen_control.bus.port import SEND_LIMIT, BusEventKind
from canopen_control.bus.socketcan import SocketCanPort, open_socketcan
from canopen_control.errors import BusClosed, BusError, InterfaceDown, InterfaceNotFound
from canopen_control.frame import CanFrame, frames_of, pack_records

S = 1_000_000_000
ONE, TWO, THREE = (CanFrame(0x180 + n, bytes([n])) for n in (1, 2, 3))


def failure(number):
    return OSError(number, os.strerror(number))


class FakeSocket:
    """Gives what `incoming` holds, takes what is sent unless `refusals` says otherwise."""

    def __init__(self):
        self.incoming = []
        self.refusals = []
        self.sent = []
        self.options = {}
        self.bound = []
        self.bind_errors = []
        self.closed = 0

    def fileno(self):
        return 42

    def put(self, *frames, overflows=None, stamp=None, interface="can0"):
        ancillary = [] if overflows is None else [(socket.SOL_SOCKET, 40, struct.pack("=I", overflows))]
        if stamp is not None:
            ancillary.append((socket.SOL_SOCKET, 35, struct.pack("@ll", *divmod(stamp, 1_000_000_000))))
        self.incoming += [(pack_records([frame]), ancillary, 0, (interface,)) for frame in frames]

    def recvmsg(self, size, ancillary_size=0, flags=0):
        if not self.incoming:
            raise BlockingIOError
        item = self.incoming.pop(0)
        if isinstance(item, OSError):
            raise item
        return item

    def send(self, data):
        if self.refusals and (error := self.refusals.pop(0)) is not None:
            raise error
        self.sent += frames_of(bytes(data))
        return len(data)

    def setsockopt(self, level, option, value):
        self.options[level, option] = value

    def bind(self, address):
        if address != ("",) and self.bind_errors:
            raise self.bind_errors.pop(0)
        self.bound.append(address)

    def close(self):
        self.closed += 1


class Bench:
    def __init__(self):
        self.socket = FakeSocket()
        self.now = 0
        self.port = SocketCanPort("can0", self.socket, lambda: self.now)

    def send(self, *frames):
        self.port.send(pack_records(frames))

    def received(self):
        return list(frames_of(self.port.receive()))

    def kinds(self):
        return [event.kind for event in self.port.events()]


@pytest.fixture
def bench():
    return Bench()


def test_a_batch_is_received_in_one_call_and_sent_frame_by_frame(bench):
    bench.socket.put(ONE, TWO, THREE)
    assert bench.received() == [ONE, TWO, THREE]
    bench.send(THREE, TWO)
    assert bench.socket.sent == [THREE, TWO]
    assert (bench.port.stats.rx, bench.port.stats.tx, bench.port.wants_write) == (3, 2, False)
    assert bench.received() == []
    assert bench.kinds() == []


def test_what_overflowed_the_receive_buffer_is_counted_and_reported_where_it_is_missing(bench):
    bench.socket.put(ONE)
    bench.socket.put(TWO, overflows=1722)
    bench.socket.put(THREE, overflows=1722)
    assert bench.received() == [ONE, overrun_frame(1722), TWO, THREE]
    assert bench.port.stats.lost == 1722
    assert bench.kinds() == [BusEventKind.OVERRUN]


def test_enobufs_makes_frames_wait_and_the_next_call_sends_them(bench):
    bench.socket.refusals = [None, failure(errno.ENOBUFS)]
    bench.send(ONE, TWO, THREE)
    assert bench.socket.sent == [ONE]
    assert bench.port.stats.queued == 2
    assert bench.port.wants_write is False, "the descriptor would be writable all the time"
    bench.socket.put(ONE)
    bench.received()
    assert bench.socket.sent == [ONE, TWO, THREE]
    assert (bench.port.stats.queued, bench.port.stats.lost) == (0, 0)


def test_eagain_makes_frames_wait_until_the_descriptor_is_writable(bench):
    bench.socket.refusals = [BlockingIOError()]
    bench.send(ONE, TWO)
    assert bench.port.wants_write is True
    bench.port.flush()
    assert bench.socket.sent == [ONE, TWO]
    assert bench.port.wants_write is False


def test_a_queue_that_stays_full_drops_the_oldest_and_reports_this(bench):
    bench.socket.refusals = [failure(errno.ENOBUFS)] * 3
    bench.port.send(pack_records([ONE] * SEND_LIMIT))
    bench.send(TWO, THREE)
    assert bench.port.stats.lost == 2
    assert bench.port.stats.queued == SEND_LIMIT
    assert bench.kinds() == [BusEventKind.OVERRUN]
    bench.socket.refusals = []
    bench.port.flush()
    assert bench.socket.sent[-2:] == [TWO, THREE]


def test_a_frame_that_the_kernel_rejects_stops_no_client(bench):
    bench.socket.refusals = [failure(errno.EINVAL)]
    bench.send(ONE, TWO)
    assert bench.socket.sent == [TWO]
    assert bench.port.stats.lost == 1


def test_a_down_interface_is_reported_once_loses_what_is_sent_and_is_reported_up_again(bench):
    bench.socket.incoming = [failure(errno.ENETDOWN)]
    bench.socket.refusals = [failure(errno.ENETDOWN)] * 2
    assert bench.received() == []
    bench.send(ONE, TWO)
    bench.send(ONE)
    (event,) = bench.port.events()
    assert event.kind is BusEventKind.DOWN
    assert event.text == "bus can0: the interface is down; bring it up: canopen-control bus up"
    assert (bench.port.stats.lost, bench.port.stats.queued) == (3, 0)
    bench.send(THREE)
    assert bench.socket.sent == [THREE], "old commands do not arrive late"
    assert bench.kinds() == [BusEventKind.UP]


def test_a_listen_only_interface_is_reported_up_with_the_first_frame(bench):
    bench.socket.incoming = [failure(errno.ENETDOWN)]
    bench.received()
    bench.socket.put(ONE)
    assert bench.received() == [ONE]
    assert bench.kinds() == [BusEventKind.DOWN, BusEventKind.UP]


@pytest.mark.parametrize("number", [errno.ENODEV, errno.ENXIO])
def test_an_unplugged_adapter_is_bound_again_when_it_is_back(bench, number):
    bench.socket.refusals = [failure(number)]
    bench.socket.bind_errors = [failure(errno.ENODEV)]
    bench.send(ONE)
    (event,) = bench.port.events()
    assert (event.kind, event.text) == (
        BusEventKind.DOWN,
        "bus can0: the interface was removed; check that the adapter is plugged in",
    )
    for now in (1, 499_999_999, 500_000_000, 999_999_999):
        bench.now = now
        bench.send(TWO)
    assert (bench.socket.sent, bench.socket.bound) == ([], [("",)])
    bench.now = 1_000_000_000
    bench.send(THREE)
    assert bench.socket.bound == [("",), ("can0",)]
    assert filters(bench) == [(0, 0)], "the kernel forgot them with the interface"
    assert bench.socket.sent == [THREE]
    assert bench.kinds() == [BusEventKind.UP]
    assert bench.port.stats.lost == 5


def test_an_interface_that_is_removed_is_reported_as_gone_although_it_went_down_first(bench):
    bench.socket.incoming = [failure(errno.ENETDOWN), failure(errno.ENODEV), failure(errno.ENODEV)]
    for _ in range(3):
        bench.received()
    assert [event.text.partition(";")[0] for event in bench.port.events()] == [
        "bus can0: the interface is down",
        "bus can0: the interface was removed",
    ]


def filters(bench):
    return [*struct.iter_unpack("=II", bench.socket.options[101, 1])]


def test_the_kernel_is_reported_with_which_identifiers_are_requested_and_only_when_they_change(bench):
    bench.port.set_filter([0x703, 0x80, 0x40000703, 0x90000001])
    assert filters(bench) == [
        (0x80, 0xC00007FF),
        (0x703, 0xC00007FF),
        (0x40000703, 0xC00007FF),
        (0x90000001, 0xDFFFFFFF),
    ]
    del bench.socket.options[101, 1]
    bench.port.set_filter({0x80, 0x90000001, 0x40000703, 0x703})
    assert bench.socket.options == {}
    bench.port.set_filter([])
    assert filters(bench) == []


def test_the_requested_identifiers_are_requested_of_the_interface_made_again_too(bench):
    bench.port.set_filter([0x703])
    del bench.socket.options[101, 1]
    bench.socket.incoming = [failure(errno.ENODEV)]
    bench.received()
    assert filters(bench) == [(0x703, 0xC00007FF)], "also while all interfaces are heard"
    del bench.socket.options[101, 1]
    bench.now = 500_000_000
    bench.send(ONE)
    assert bench.socket.bound == [("",), ("can0",)]
    assert filters(bench) == [(0x703, 0xC00007FF)]


def test_a_listen_only_port_detects_a_recreated_interface_by_its_first_frame(bench):
    bench.socket.incoming = [failure(errno.ENETDOWN), failure(errno.ENODEV)]
    bench.received()
    bench.received()
    assert bench.socket.bound == [("",)], "nobody would wake him otherwise"
    bench.socket.put(ONE, interface="can7")
    assert bench.received() == []
    bench.socket.put(TWO, interface="can7")
    bench.socket.put(THREE, ONE)
    bench.socket.put(TWO, interface="can7")
    assert bench.received() == [THREE, ONE, TWO], "once bound, everything is of this interface"
    assert bench.socket.bound == [("",), ("can0",)]
    assert bench.kinds() == [BusEventKind.DOWN, BusEventKind.DOWN, BusEventKind.UP]
    assert bench.port.stats.rx == 3


def test_an_interface_that_is_received_and_gone_again_before_it_is_bound_is_waited_for_again(bench):
    bench.socket.incoming = [failure(errno.ENODEV)]
    bench.received()
    bench.socket.bind_errors = [failure(errno.ENODEV)]
    bench.socket.put(ONE)
    assert bench.received() == [ONE]
    bench.send(TWO)
    assert (bench.socket.sent, bench.port.stats.lost) == ([], 1)
    bench.socket.put(TWO)
    assert bench.received() == [TWO]
    assert bench.socket.bound == [("",), ("can0",)]


@pytest.fixture
def clocks(bench, monkeypatch):
    """Monotonic time is 900 s, Unix time what `clocks.unix` says."""
    clocks = types.SimpleNamespace(unix=1_700_000_000 * S)
    bench.now = 900 * S
    monkeypatch.setattr("canopen_control.bus.socketcan.time.time_ns", lambda: clocks.unix)
    return clocks


def test_stamps_are_asked_for_once_and_come_with_every_record_as_monotonic_time(bench, clocks):
    bench.port.ask_stamps()
    assert bench.socket.options.pop((socket.SOL_SOCKET, 35)) == 1
    bench.port.ask_stamps()
    assert bench.socket.options == {}
    bench.socket.put(ONE, stamp=clocks.unix - 876_543_211)
    bench.socket.put(TWO, stamp=clocks.unix - 876_500_000, overflows=3)
    records, stamps = bench.port.receive_stamped()
    assert list(frames_of(records)) == [ONE, overrun_frame(3), TWO]
    assert stamps == [900 * S - 876_543_211, 900 * S - 876_500_000, 900 * S - 876_500_000]
    assert bench.port.receive_stamped() == (b"", [])


def test_a_clock_that_is_set_leaves_no_gap_and_no_frame_in_the_future(bench, clocks):
    bench.port.ask_stamps()
    bench.socket.put(ONE, stamp=clocks.unix)
    clocks.unix -= 2 * S
    assert bench.port.receive_stamped()[1] == [900 * S], "stamped before the clock was set back"
    bench.now += S
    clocks.unix += S
    bench.socket.put(TWO, stamp=clocks.unix - 1000)
    assert bench.port.receive_stamped()[1] == [901 * S - 1000]
    bench.now += S
    clocks.unix += 3601 * S
    bench.socket.put(TWO, stamp=clocks.unix - 1000)
    assert bench.port.receive_stamped()[1] == [902 * S - 1000]


def test_more_identifiers_than_the_kernel_can_choose_are_all_of_eleven_bits(bench):
    bench.port.set_filter(range(513))
    assert filters(bench) == [(0, 0x80000000)]
    bench.port.set_filter(range(512))
    assert len(filters(bench)) == 512


# Error frames, as drivers make them


@pytest.mark.parametrize("row", DRIVER_FRAMES, ids=NAMES)
def test_what_a_driver_reports_is_an_event_of_the_port_and_stays_among_the_records(bench, row):
    bench.socket.put(ONE, row.frame, TWO)
    assert bench.received() == [ONE, row.frame, TWO]
    assert tuple(bench.kinds()) == row.kinds
    assert (bench.port.stats.errors, bench.port.stats.rx, bench.port.stats.lost) == (1, 3, 0)


BUS_OFF = CanFrame(0x20000040, bytes(8))
RESTARTED = CanFrame(0x20000100, bytes(8))


def test_nothing_is_kept_for_a_controller_that_is_off_the_bus(bench):
    bench.socket.refusals = [failure(errno.ENOBUFS)]
    bench.send(ONE)
    bench.socket.put(BUS_OFF)
    bench.received()
    bench.send(TWO)
    assert bench.socket.sent == []
    assert bench.port.stats.lost == 2
    bench.socket.put(RESTARTED)
    bench.received()
    bench.send(THREE)
    assert bench.socket.sent == [THREE]
    assert bench.kinds() == [BusEventKind.BUS_OFF, BusEventKind.ERROR_ACTIVE]


def test_a_controller_that_restarts_without_a_word_is_back_with_the_first_frame(bench):
    bench.socket.put(ONE, BUS_OFF)
    bench.received()
    bench.send(TWO)
    assert bench.socket.sent == []
    bench.socket.put(ONE)
    bench.received()
    bench.send(THREE)
    assert bench.socket.sent == [THREE]
    assert bench.kinds() == [BusEventKind.BUS_OFF, BusEventKind.ERROR_ACTIVE]
    bench.socket.put(ONE)
    bench.received()
    assert bench.kinds() == [], "reported once"


def test_a_controllers_own_overflow_report_has_no_number_in_it(bench):
    bench.socket.put(CanFrame(0x20000004, bytes.fromhex("0001000000007f60")))
    bench.received()
    assert bench.kinds() == [BusEventKind.OVERRUN]
    assert bench.port.stats.lost == 0


@given(st.lists(st.tuples(st.integers(0, 0xFFFFFFFF), st.binary(max_size=8), st.integers(0, 0xFFFFFFFF)), max_size=20))
def test_whatever_is_on_the_bus_comes_through(frames):
    bench = Bench()
    for can_id, data, overflows in frames:
        bench.socket.put(CanFrame(can_id, data), overflows=overflows)
    received = [frame for frame in bench.received() if frame.data[:2] != b"\xff\x01" or frame.can_id != 0x20000004]
    expected = [CanFrame(can_id, data) for can_id, data, _ in frames]
    assert received == [frame for frame in expected if frame.data[:2] != b"\xff\x01" or frame.can_id != 0x20000004]


# Opening and closing


@pytest.fixture
def sysfs(tmp_path):
    def make(name, flags="0x40041", queue="1000"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "flags").write_text(f"{flags}\n")
        (tmp_path / name / "tx_queue_len").write_text(f"{queue}\n")
        return tmp_path

    make("vcan7")
    make.root = tmp_path
    return make


def test_opening_asks_for_error_frames_overflow_counts_and_a_large_buffer(sysfs):
    sock = FakeSocket()
    port = open_socketcan("vcan7", make_socket=lambda: sock, network_class=sysfs.root)
    assert sock.bound == [("vcan7",)]
    assert sock.options[101, 2] == struct.pack("=I", 0x1FFFFFFF)
    assert sock.options[socket.SOL_SOCKET, 40] == 1
    assert sock.options[socket.SOL_SOCKET, 33] >= 1 << 20
    assert (socket.SOL_SOCKET, socket.SO_SNDBUF) not in sock.options
    assert (port.channel, port.fileno()) == ("vcan7", 42)


def test_a_short_transmit_queue_gets_a_send_buffer_that_fills_first(sysfs):
    sysfs("can3", queue="10")
    sock = FakeSocket()
    open_socketcan("can3", make_socket=lambda: sock, network_class=sysfs.root)
    assert sock.options[socket.SOL_SOCKET, socket.SO_SNDBUF] * 2 < 10 * 768


def test_without_the_right_to_force_it_the_buffer_is_asked_for(sysfs):
    class Unprivileged(FakeSocket):
        def setsockopt(self, level, option, value):
            if option == 33:
                raise PermissionError
            super().setsockopt(level, option, value)

    sock = Unprivileged()
    open_socketcan("vcan7", make_socket=lambda: sock, network_class=sysfs.root)
    assert sock.options[socket.SOL_SOCKET, socket.SO_RCVBUF] >= 1 << 20


@pytest.mark.parametrize(
    ("name", "hint"), [("vcan9", "canopen-control bus up vcan9"), ("can9", "check that the adapter is plugged in")]
)
def test_a_missing_interface_is_answered_with_what_to_type(sysfs, name, hint):
    sock = FakeSocket()
    sock.bind_errors = [failure(errno.ENODEV)]
    with pytest.raises(InterfaceNotFound, match=hint):
        open_socketcan(name, make_socket=lambda: sock, network_class=sysfs.root)
    assert sock.closed == 1


def test_a_down_interface_is_answered_with_what_to_type(sysfs):
    sysfs("can4", flags="0x40040")
    sock = FakeSocket()
    with pytest.raises(InterfaceDown, match="can4 is down; bring it up: canopen-control bus up can4"):
        open_socketcan("can4", make_socket=lambda: sock, network_class=sysfs.root)
    assert sock.closed == 1


def test_a_kernel_without_can_is_answered_with_the_bus_that_needs_none(sysfs):
    def refuse():
        raise failure(errno.EAFNOSUPPORT)

    with pytest.raises(InterfaceNotFound, match=r"no SocketCAN .*local:can0"):
        open_socketcan("can0", make_socket=refuse, network_class=sysfs.root)


def test_any_other_failure_is_a_bus_error(sysfs):
    sock = FakeSocket()
    sock.bind_errors = [failure(errno.EPERM)]
    with pytest.raises(BusError, match="bus can0: Operation not permitted"):
        open_socketcan("can0", make_socket=lambda: sock, network_class=sysfs.root)


def test_a_closed_port_is_closed_once_and_reports_this(bench):
    bench.port.close()
    bench.port.close()
    assert bench.socket.closed == 1
    assert bench.port.fileno() == -1
    for verb in (bench.port.receive, lambda: bench.send(ONE)):
        with pytest.raises(BusClosed, match="can0: closed on this side"):
            verb()
