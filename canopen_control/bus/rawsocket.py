"""Raw AF_CAN sockets: opened with all options of a port, or an error with the command to type.

See linux/can.h and linux/can/raw.h. The receive buffer is at least 1 MiB (the default holds 278 frames), error frames
are enabled, and the kernel reports overflows (SO_RXQ_OVFL) and on request time stamps (SO_TIMESTAMPNS) as ancillary
data. Python defines these constants only if it was built with the headers.
"""

from __future__ import annotations

import errno
import socket
import struct
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from canopen_control.errors import BusError, InterfaceDown, InterfaceNotFound
from canopen_control.frame import EXTENDED_FLAG, REMOTE_FLAG

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from canopen_control.bus.port import Records

    Ancillary = Sequence[tuple[int, int, bytes]]
    """Ancillary data of a frame: level, type, data."""


CAN_RAW = 1
SOL_CAN_RAW = 101
CAN_RAW_FILTER = 1
_CAN_RAW_ERR_FILTER = 2
_ALL_ERRORS = struct.pack("=I", 0x1FFFFFFF)
_SO_RCVBUFFORCE = 33
_SO_TIMESTAMPNS = 35  # also the type of the ancillary data
_SO_RXQ_OVFL = 40

_RECEIVE_BUFFER = 4 << 20
_FRAME_MEMORY = 768  # memory of a queued frame in SO_SNDBUF
_SHORT_QUEUE = 100
_U32 = struct.Struct("=I")
_TIMESPEC = struct.Struct("@ll")
_FILTER = struct.Struct("=II")  # identifier, mask
FILTER_SIZE = _FILTER.size
_MAX_FILTERS = 512  # CAN_RAW_FILTER_MAX
_STANDARD_MASK = EXTENDED_FLAG | REMOTE_FLAG | 0x7FF  # the kernel has a fast path for this mask
_EXTENDED_MASK = EXTENDED_FLAG | REMOTE_FLAG | 0x1FFFFFFF
EVERYTHING = _FILTER.pack(0, 0)
_ALL_STANDARD = _FILTER.pack(0, EXTENDED_FLAG)

NETWORK_CLASS = Path("/sys/class/net")
ALL_INTERFACES = ""


class CanSocket(Protocol):
    """Socket methods used by the port."""

    def fileno(self) -> int: ...

    def recvmsg(
        self, bufsize: int, ancbufsize: int = ..., flags: int = ..., /
    ) -> tuple[bytes, list[tuple[int, int, bytes]], int, object]: ...

    def send(self, data: Records, /) -> int: ...

    def bind(self, address: tuple[str], /) -> None: ...

    def setsockopt(self, level: int, option: int, value: int | bytes, /) -> None: ...

    def close(self) -> None: ...


# -- options and ancillary data


def filters_of(can_ids: Iterable[int]) -> bytes:
    """Return the kernel's filters for these identifiers; if there are too many, for all 11-bit identifiers."""
    filters = [
        _FILTER.pack(can_id, _EXTENDED_MASK if can_id & EXTENDED_FLAG else _STANDARD_MASK) for can_id in sorted(can_ids)
    ]
    return b"".join(filters) if len(filters) <= _MAX_FILTERS else _ALL_STANDARD


def set_filters(sock: CanSocket, filters: bytes) -> None:
    """Set the filters of the socket, replacing earlier ones."""
    sock.setsockopt(SOL_CAN_RAW, CAN_RAW_FILTER, filters)


def bind_to(sock: CanSocket, name: str, filters: bytes) -> None:
    """Bind to the interface `name`, which may have been created again, or to `ALL_INTERFACES`; OSErrors are passed on.

    When an interface is removed the kernel drops the filters too, so that they must be set again.
    """
    set_filters(sock, filters)
    sock.bind((name,))


def ask_stamps(sock: CanSocket) -> None:
    """Request a time stamp with each frame."""
    sock.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)


def interface_of(address: object) -> str:
    """Return the name of an interface from the source address of a frame, or ""."""
    return str(address[0]) if isinstance(address, tuple) and address else ""


def overflow_of(ancillary: Ancillary) -> int | None:
    """Return the kernel's wrapping count of frames lost in the receive buffer, or None."""
    data = _find(ancillary, _SO_RXQ_OVFL, _U32.size)
    return None if data is None else int(_U32.unpack_from(data)[0])


def stamp_of(ancillary: Ancillary) -> int | None:
    """Return the time stamp of a frame in Unix ns, or None."""
    data = _find(ancillary, _SO_TIMESTAMPNS, _TIMESPEC.size)
    if data is None:
        return None
    seconds, nanoseconds = _TIMESPEC.unpack_from(data)
    return int(seconds * 1_000_000_000 + nanoseconds)


def _find(ancillary: Ancillary, index: int, size: int) -> bytes | None:
    for level, kind, data in ancillary:
        if level == socket.SOL_SOCKET and kind == index and len(data) >= size:
            return data
    return None


# -- opening


def open_raw(
    name: str, make_socket: Callable[[], CanSocket] | None = None, network_class: Path = NETWORK_CLASS
) -> CanSocket:
    """Open a socket on the interface `name`; raise `InterfaceNotFound`, `InterfaceDown` or `BusError`."""
    try:
        sock = (make_socket or _raw_socket)()
    except OSError as error:
        hint = f"this system has no SocketCAN ({error.strerror}); to use a bus without kernel CAN, write local:{name}"
        raise InterfaceNotFound(name, hint) from error
    try:
        _set_options(sock, network_class / name)
        sock.bind((name,))
        _refuse_down(name, network_class / name)
    except BaseException as error:
        sock.close()
        if isinstance(error, OSError):
            raise _explained(name, error) from error
        raise
    return sock


def _raw_socket() -> CanSocket:
    family = getattr(socket, "AF_CAN", None)
    if family is None:
        raise OSError(errno.EAFNOSUPPORT, "Python has no AF_CAN here")
    sock = socket.socket(family, socket.SOCK_RAW, CAN_RAW)
    sock.setblocking(False)
    return sock


def _set_options(sock: CanSocket, interface: Path) -> None:
    sock.setsockopt(SOL_CAN_RAW, _CAN_RAW_ERR_FILTER, _ALL_ERRORS)
    sock.setsockopt(socket.SOL_SOCKET, _SO_RXQ_OVFL, 1)
    try:
        sock.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, _RECEIVE_BUFFER)
    except PermissionError:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER)  # limited by rmem_max
    length = _number(interface / "tx_queue_len", 10)
    if 0 < length <= _SHORT_QUEUE:
        # The send buffer is smaller than the transmit queue, so that the kernel returns EAGAIN and signals when to
        # continue. With ENOBUFS it would not. The kernel doubles the value and has a minimum.
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, max(1, length - 2) * _FRAME_MEMORY // 2)


def _refuse_down(name: str, interface: Path) -> None:
    if not _number(interface / "flags", 16) & 1:  # IFF_UP
        raise InterfaceDown(name, f"bring it up: canopen-control bus up {name}")


def _number(path: Path, base: int) -> int:
    """Return the number in a file of sysfs; -1 if it cannot be read."""
    try:
        return int(path.read_text(), base)
    except (OSError, ValueError):
        return -1


def _explained(name: str, error: OSError) -> BusError:
    if error.errno != errno.ENODEV:
        return BusError(f"bus {name}: {error.strerror or error}")
    if name.startswith("vcan"):
        return InterfaceNotFound(name, f"create it: canopen-control bus up {name}")
    return InterfaceNotFound(
        name, "check that the adapter is plugged in; list the interfaces with: canopen-control bus list"
    )
