"""Cyclic SYNC by the kernel's broadcast manager (BCM), independent of this process (linux/can/bcm.h).

One TX_SETUP sets the period and the frames, which the kernel sends in turn, the first at once; with a SYNC counter
(0x1019) there is one frame for each count. A second TX_SETUP changes the period. The task ends with its socket: on
`close` or when the process ends. The task survives if the interface is set down, but not if it is removed. Only SYNC is
sent this way: a heartbeat must end with its process.
"""

from __future__ import annotations

import contextlib
import errno
import socket
import struct
from typing import TYPE_CHECKING, Protocol

from canopen_control.errors import BusError
from canopen_control.frame import pack_records

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from canopen_control.frame import CanFrame


_CAN_BCM = 2
_TX_SETUP = 1
_SET_TIMER, _START_TIMER, _FROM_THE_FIRST = 0x0001, 0x0002, 0x0200
_HEAD = struct.Struct("@IIIllllII0q")  # opcode, flags, count, ival1, ival2 (s, us each), can_id, number of frames
_US = 1_000_000


class BcmSocket(Protocol):
    """Socket of the broadcast manager, with the methods used here."""

    def connect(self, address: tuple[str], /) -> None: ...

    def send(self, data: bytes, /) -> int: ...

    def close(self) -> None:
        """Close the socket and end the task."""


class KernelSync:
    """Cyclic SYNC task of the kernel on one interface; `frames` are sent in turn, one per period."""

    sender = "the kernel"
    correction = "it is set up again"

    def __init__(
        self, interface: str, frames: Sequence[CanFrame], make_socket: Callable[[], BcmSocket] | None = None
    ) -> None:
        self.interface, self.frames = interface, tuple(frames)
        self._make_socket = make_socket or _bcm_socket
        self._socket: BcmSocket | None = None

    def why_not(self) -> str | None:
        """Return why the kernel cannot send on this interface, or None; nothing is sent, and a started task goes on."""
        if self._socket is not None:
            return None
        try:
            self._connected()
        except OSError as error:
            return str(_explained(self.interface, error))
        self.close()
        return None

    def start(self, period_us: int) -> None:
        """Start cyclic transmission by the kernel every `period_us`, the first frame at once.

        Raise BusError if the kernel refuses.
        """
        self._set_up(period_us, _SET_TIMER | _START_TIMER | _FROM_THE_FIRST)

    def _set_up(self, period_us: int, flags: int) -> None:
        can_id, count = self.frames[0].can_id, len(self.frames)
        head = _HEAD.pack(_TX_SETUP, flags, 0, 0, 0, *divmod(period_us, _US), can_id, count)
        try:
            self._connected().send(head + pack_records(self.frames))
        except OSError as error:
            self.close()
            raise _explained(self.interface, error) from error

    def adjust(self, period_us: int) -> None:
        """Change the period after the next frame, without an additional frame; raise BusError if the kernel refuses."""
        self._set_up(period_us, _SET_TIMER)

    def close(self) -> None:
        """End the task; a second call does nothing."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _connected(self) -> BcmSocket:
        if self._socket is None:
            with contextlib.ExitStack() as undo:
                opened = self._make_socket()
                undo.callback(opened.close)
                opened.connect((self.interface,))
                undo.pop_all()
            self._socket = opened
        return self._socket


def _bcm_socket() -> BcmSocket:
    family = getattr(socket, "AF_CAN", None)
    if family is None:
        raise OSError(errno.EPROTONOSUPPORT, "Python has no AF_CAN here")
    return socket.socket(family, socket.SOCK_DGRAM, _CAN_BCM)


def _explained(interface: str, error: OSError) -> BusError:
    if error.errno in (errno.EPROTONOSUPPORT, errno.EAFNOSUPPORT):
        hint = "run: sudo modprobe can-bcm, or let this program send SYNC"
        return BusError(f"bus {interface}: this kernel has no broadcast manager for sending SYNC; {hint}")
    return BusError(f"bus {interface}: the kernel does not send SYNC: {error.strerror or error}")
