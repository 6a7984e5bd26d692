"""Messages to the broadcast manager in the layout of linux/can/bcm.h, on a scripted socket."""

from __future__ import annotations

import errno
import os
import struct

import pytest

from canopen_control.bus.kernel_sync import KernelSync
from canopen_control.errors import BusError
from canopen_control.frame import CanFrame, frames_of

SYNC = CanFrame(0x80)
COUNTED = [CanFrame(0x80, bytes([count])) for count in range(1, 241)]


class FakeSocket:
    def __init__(self, connecting=None, sending=None):
        self.errors = {"connect": connecting, "send": sending}
        self.connected, self.sent, self.closed = [], [], 0

    def _fail(self, verb):
        if self.errors[verb] is not None:
            raise OSError(self.errors[verb], os.strerror(self.errors[verb]))

    def connect(self, address):
        self._fail("connect")
        self.connected.append(address)

    def send(self, data):
        self._fail("send")
        self.sent.append(data)
        return len(data)

    def close(self):
        self.closed += 1


def head(message):
    names = ("opcode", "flags", "count", "s1", "us1", "s2", "us2", "can_id", "frames")
    return dict(zip(names, struct.unpack_from("@IIIllllII0q", message), strict=True))


def test_one_message_gives_period_and_frame():
    sock = FakeSocket()
    sync = KernelSync("vcan3", [SYNC], lambda: sock)
    sync.start(20_000)
    assert sock.connected == [("vcan3",)]
    (message,) = sock.sent
    reported = head(message)
    assert (reported["opcode"], reported["s2"], reported["us2"], reported["can_id"], reported["frames"]) == (
        1,
        0,
        20_000,
        0x80,
        1,
    )
    assert reported["flags"] & 0x3 == 0x3, "the timer is set and started"
    assert (reported["count"], reported["s1"], reported["us1"]) == (0, 0, 0), "no other period first"
    assert list(frames_of(message[struct.calcsize("@IIIllllII0q") :])) == [SYNC]
    assert struct.calcsize("@IIIllllII0q") == 56, "as on a 64-bit kernel"


def test_a_period_is_adjusted_without_a_frame_or_a_count_begun_again():
    sock = FakeSocket()
    sync = KernelSync("vcan3", COUNTED, lambda: sock)
    sync.start(10_000)
    sync.adjust(9_993)
    reported = head(sock.sent[1])
    assert (reported["us2"], reported["frames"]) == (9_993, len(COUNTED))
    assert reported["flags"] == 0x1, "the timer is set, and goes on"


def test_another_period_is_reported_to_the_same_socket_which_ends_the_task_when_it_is_closed():
    sockets = []

    def make():
        sockets.append(FakeSocket())
        return sockets[-1]

    sync = KernelSync("vcan3", [SYNC], make)
    sync.start(20_000)
    sync.start(1_500_000)
    assert [(head(item)["s2"], head(item)["us2"]) for item in sockets[0].sent] == [(0, 20_000), (1, 500_000)]
    sync.close()
    sync.close()
    assert sockets[0].closed == 1
    sync.start(20_000)
    assert (len(sockets), sockets[1].connected) == (2, [("vcan3",)])


def test_a_counter_is_a_frame_for_each_count():
    sock = FakeSocket()
    KernelSync("vcan3", COUNTED, lambda: sock).start(10_000)
    assert head(sock.sent[0])["frames"] == 240
    assert list(frames_of(sock.sent[0][56:])) == COUNTED


@pytest.mark.parametrize(
    ("failing", "message"),
    [
        ({"connecting": errno.ENODEV}, "bus can5: the kernel does not send SYNC: No such device"),
        ({"sending": errno.ENETDOWN}, "bus can5: the kernel does not send SYNC: Network is down"),
    ],
)
def test_a_refusal_is_a_bus_error_and_leaves_nothing_open(failing, message):
    sock = FakeSocket(**failing)
    with pytest.raises(BusError, match=message):
        KernelSync("can5", [SYNC], lambda: sock).start(20_000)
    assert sock.closed == 1


def test_a_kernel_without_it_is_answered_with_what_to_type():
    def refuse():
        raise OSError(errno.EPROTONOSUPPORT, os.strerror(errno.EPROTONOSUPPORT))

    with pytest.raises(BusError, match="no broadcast manager for sending SYNC; run: sudo modprobe can-bcm, or"):
        KernelSync("can5", [SYNC], refuse).start(20_000)


def test_whether_the_kernel_can_is_asked_without_sending_anything():
    sock = FakeSocket()
    assert KernelSync("vcan3", (), lambda: sock).why_not() is None
    assert (sock.connected, sock.sent, sock.closed) == ([("vcan3",)], [], 1)
    fake_socket = FakeSocket(connecting=errno.EPROTONOSUPPORT)
    assert (
        "sudo modprobe can-bcm, or let this program send SYNC" in KernelSync("vcan3", (), lambda: fake_socket).why_not()
    )
    assert fake_socket.closed == 1


def test_a_started_task_goes_on_when_the_kernel_is_asked_whether_it_can():
    sock = FakeSocket()
    sync = KernelSync("vcan3", [SYNC], lambda: sock)
    sync.start(20_000)
    assert sync.why_not() is None
    assert (len(sock.sent), sock.closed) == (1, 0)
    sync.close()
