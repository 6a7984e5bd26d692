"""The SocketCAN port on a real kernel, for the assumptions of the tests with a scripted socket."""

import contextlib
import errno
import itertools
import select
import socket
import struct
import subprocess
import time

import pytest
from support.error_frames import DRIVER_FRAMES
from support.guest import ip, throttle
from support.host import eventually

from canopen_control.bus.channel import open_port
from canopen_control.bus.error_frames import lost_frames
from canopen_control.bus.port import SEND_LIMIT, BusEventKind
from canopen_control.bus.port_abilities import Arrivals
from canopen_control.errors import InterfaceDown, InterfaceNotFound
from canopen_control.frame import CanFrame, frames_of, pack_records

pytestmark = pytest.mark.socketcan
MS = 1_000_000
ONE, TWO, THREE = (CanFrame(0x180 + n, bytes([n])) for n in (1, 2, 3))


@pytest.fixture
def ports(vcan):
    opened = [open_port(vcan), open_port(vcan)]
    yield opened
    for port in opened:
        port.close()


def receive(port, count, seconds=5.0):
    frames, deadline = [], time.monotonic() + seconds
    while len(frames) < count and time.monotonic() < deadline:
        select.select([port.fileno()], [], [], 0.1)
        frames += frames_of(port.receive())
    return frames


def everything(port):
    """Receive until nothing waits any more."""
    frames = []
    while select.select([port.fileno()], [], [], 0.5)[0]:
        frames += frames_of(port.receive())
    return frames


def kinds(port):
    return [event.kind for event in port.events()]


def test_frames_cross_and_a_sender_does_not_receive_himself(ports):
    ours, theirs = ports
    ours.send(pack_records([ONE, TWO, CanFrame(0x40000703, bytes(1)), CanFrame(0x9ABCDEF0, b"12345678")]))
    assert receive(theirs, 4) == [ONE, TWO, CanFrame(0x40000703, bytes(1)), CanFrame(0x9ABCDEF0, b"12345678")]
    theirs.send(pack_records([THREE]))
    assert receive(ours, 1) == [THREE]
    assert receive(ours, 1, 0.2) == []
    assert (ours.stats.tx, ours.stats.rx, ours.stats.lost) == (4, 1, 0)


def test_the_kernel_hands_over_the_requested_identifiers_only(ports):
    ours, theirs = ports
    theirs.set_filter([0x183, 0x40000703])
    ours.send(pack_records([ONE, CanFrame(0x703, b"\5"), CanFrame(0x40000703, bytes(1)), CanFrame(0x80000183), THREE]))
    assert receive(theirs, 2) == [CanFrame(0x40000703, bytes(1)), THREE]
    theirs.set_filter(range(600))
    ours.send(pack_records([CanFrame(0x80000183), CanFrame(0x7FF), THREE]))
    assert receive(theirs, 2) == [CanFrame(0x7FF), THREE]
    theirs.set_filter([])
    ours.send(pack_records([THREE]))
    assert receive(theirs, 1, 0.2) == []
    assert theirs.stats.rx == 4


def test_the_receive_buffer_holds_thousands_and_what_does_not_fit_is_counted(ports):
    ours, theirs = ports
    ours.send(pack_records([ONE] * 4000))
    assert len(receive(theirs, 4000)) == 4000
    assert theirs.stats.lost == 0
    sent = 0
    for _ in range(10):
        ours.send(pack_records([TWO] * 4000))
        sent += 4000
    kept = everything(theirs)
    ours.send(pack_records([THREE]))  # the kernel reports dropped frames with the next frame
    report, last = receive(theirs, 2)
    assert last == THREE
    assert lost_frames(report) == theirs.stats.lost == sent - len(kept) > 0
    assert kinds(theirs) == [BusEventKind.OVERRUN]


def test_down_and_up_are_events_and_the_same_port_works_on(ports, vcan):
    ours, theirs = ports
    ip("link", "set", vcan, "down")
    assert select.select([ours.fileno()], [], [], 5)[0], "it is reported although no program sends"
    assert ours.receive() == b""
    assert kinds(ours) == [BusEventKind.DOWN]
    assert not select.select([ours.fileno()], [], [], 0.05)[0], "and does not keep its owner busy"
    ours.send(pack_records([ONE]))
    assert (ours.stats.lost, ours.stats.queued) == (1, 0)
    theirs.receive()
    theirs.events()
    ip("link", "set", vcan, "up")
    ours.send(pack_records([TWO]))
    assert receive(theirs, 1) == [TWO], "old commands do not arrive late"
    assert kinds(ours) == kinds(theirs) == [BusEventKind.UP]


def test_an_interface_made_again_is_another_one_and_is_bound_again_with_its_filters(ports, vcan):
    ours, theirs = ports
    theirs.set_filter([0x182])
    ip("link", "del", vcan)
    for port in ports:
        assert receive(port, 1, 0.1) == []
        assert "the interface was removed" in port.events()[-1].text
    ours.send(pack_records([ONE]))
    ip("link", "add", "dev", vcan, "type", "vcan")
    ip("link", "set", vcan, "up")

    def works():
        ours.send(pack_records([ONE, TWO]))
        return receive(theirs, 1, 0.1) == [TWO]

    assert eventually(works, 5)
    assert kinds(ours) == kinds(theirs) == [BusEventKind.UP]


def test_a_listen_only_port_receives_from_a_recreated_interface_without_sending(vcan):
    with contextlib.closing(open_port(vcan)) as listener:
        listener.set_filter([0x182])
        ip("link", "del", vcan)
        assert receive(listener, 1, 0.1) == []
        assert "the interface was removed" in listener.events()[-1].text
        subprocess.run(["cansend", "vcan0", "182#00"], check=True)
        assert receive(listener, 1, 0.2) == [], "of another interface"
        ip("link", "add", "dev", vcan, "type", "vcan")
        ip("link", "set", vcan, "up")
        subprocess.run(["cansend", vcan, "181#01"], check=True)
        subprocess.run(["cansend", vcan, "182#02"], check=True)
        assert receive(listener, 1) == [CanFrame(0x182, b"\2")]
        subprocess.run(["cansend", "vcan0", "182#00"], check=True)
        subprocess.run(["cansend", vcan, "182#03"], check=True)
        assert receive(listener, 1) == [CanFrame(0x182, b"\3")], "bound to it alone again"
        assert kinds(listener) == [BusEventKind.UP]
        assert (listener.stats.rx, listener.stats.lost) == (2, 0)


def test_the_kernel_reports_when_it_took_each_frame(ports):
    ours, theirs = ports
    arrivals = Arrivals(theirs)
    before = time.monotonic_ns()
    ours.send(pack_records([ONE]))
    between = time.monotonic_ns()
    time.sleep(0.3)
    ours.send(pack_records([TWO] * 5))
    time.sleep(0.3)
    reading = time.monotonic_ns()
    records, stamps = arrivals.receive()
    assert list(frames_of(records)) == [ONE] + [TWO] * 5
    first, *rest = stamps
    assert before - MS <= first <= between + MS, "the clocks are read one after the other"
    assert between + 290 * MS < rest[0]
    assert rest[-1] <= reading - 200 * MS, "not the time of reading"
    assert all(later - earlier >= 1000 for earlier, later in itertools.pairwise(stamps))


def test_a_full_transmit_queue_makes_frames_wait_and_none_is_lost(ports, vcan):
    throttle(vcan, "64kbit")
    ours, theirs = ports
    frames = [CanFrame(0x180, bytes([n])) for n in range(60)]
    ours.send(pack_records(frames))
    assert 0 < ours.stats.queued < 60
    received = []
    for _ in range(200):
        received += receive(theirs, 1, 0.05)
        ours.flush()
        if len(received) == 60:
            break
    assert received == frames
    assert (ours.stats.queued, ours.stats.lost) == (0, 0)


def test_a_bus_that_takes_nothing_keeps_the_newest_and_counts_the_rest(ports, vcan):
    throttle(vcan, "64bit", limit=160)
    ours, _ = ports
    ours.send(pack_records([ONE] * 50))
    ours.send(pack_records([TWO] * (SEND_LIMIT + 50)))
    assert ours.stats.queued == SEND_LIMIT
    assert ours.stats.lost > 50
    assert kinds(ours) == [BusEventKind.OVERRUN]


def test_error_frames_come_through(ports, vcan):
    """A vcan has none of its own; those that are sent are carried like any other, and the port asked for them.

    The kernel hands them over by their classes, so that one without any reaches nobody.
    """
    reported = [row for row in DRIVER_FRAMES if row.frame.can_id & 0x1FFFFFFF]
    assert [row.driver for row in DRIVER_FRAMES if row not in reported] == ["mcp251x"]
    ports[1].set_filter([0x80])
    with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as sender:
        sender.bind((vcan,))
        for row in DRIVER_FRAMES:
            sender.send(pack_records([row.frame]))
    for port in ports:
        assert receive(port, len(reported)) == [row.frame for row in reported]
        assert kinds(port) == [kind for row in reported for kind in row.kinds]
        assert port.stats.errors == len(reported)


def test_opening_what_is_missing_or_down_suggests_what_to_type(vcan):
    with pytest.raises(InterfaceNotFound, match="canopen-control bus up vcan66"):
        open_port("vcan66")
    ip("link", "set", vcan, "down")
    with pytest.raises(InterfaceDown, match=f"canopen-control bus up {vcan}"):
        open_port(vcan)


def test_the_options_are_as_the_kernel_took_them(ports):
    port = ports[0]
    sock = socket.socket(fileno=socket.dup(port.fileno()))
    try:
        assert sock.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) >= 1 << 20
        assert sock.getsockopt(101, 2, 4) == struct.pack("=I", 0x1FFFFFFF)
        assert sock.getsockopt(socket.SOL_SOCKET, 40) == 1
        with pytest.raises(BlockingIOError) as error:
            sock.recv(16)
        assert error.value.errno == errno.EAGAIN
    finally:
        sock.close()
