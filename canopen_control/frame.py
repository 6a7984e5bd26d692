"""CAN frames and the COB-IDs of the predefined connection set (CiA 301, 7.3.3).

Ports transfer frames as concatenated records of 16 bytes (struct can_frame of Linux). The cycle uses records,
everything else uses `CanFrame`.
"""

from __future__ import annotations

import enum
import struct
from functools import partial
from typing import TYPE_CHECKING, Any, Final, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

__all__ = [
    "BROADCAST",
    "ERROR_FLAG",
    "EXTENDED_BIT",
    "EXTENDED_FLAG",
    "FRAME_BITS",
    "MAX_NODE_ID",
    "RECORD",
    "RECORD_SIZE",
    "REMOTE_FLAG",
    "CanFrame",
    "Service",
    "can_id_of",
    "cob_id",
    "frames_of",
    "is_restricted",
    "make_frame",
    "pack_records",
    "remote_frame",
    "rpdo_cob_id",
    "service_of",
    "tpdo_cob_id",
]

EXTENDED_BIT: Final = 1 << 29  # bit of a COB-ID entry: 29-bit identifier; frames have EXTENDED_FLAG instead
EXTENDED_FLAG: Final = 0x80000000  # linux/can.h CAN_EFF_FLAG: 29-bit identifier
REMOTE_FLAG: Final = 0x40000000  # CAN_RTR_FLAG
ERROR_FLAG: Final = 0x20000000  # CAN_ERR_FLAG: the identifier contains error classes
BROADCAST: Final = 0  # node-ID for all nodes
MAX_NODE_ID: Final = 127
FRAME_BITS: Final = 47
"""Length in bits of a frame with an 11-bit identifier and no data, including intermission, without stuff bits."""

RECORD: Final = struct.Struct("=IB3x8s")  # can_id with flags, length, padding, data
RECORD_SIZE: Final = RECORD.size


class CanFrame(NamedTuple):
    """CAN frame with 0 to 8 bytes of data; `can_id` is the identifier with the flags of linux/can.h.

    The data of a remote frame are zeros, whose number is the DLC of the frame.
    """

    can_id: int
    data: bytes = b""

    @property
    def is_remote(self) -> bool:
        """Whether this is a remote frame."""
        return bool(self.can_id & REMOTE_FLAG)

    @property
    def is_error(self) -> bool:
        """Whether this is an error report of the CAN controller, which is never sent on the bus."""
        return bool(self.can_id & ERROR_FLAG)

    def __str__(self) -> str:
        """Return the frame in the log format of candump, such as ``183#3706``."""
        identifier = self.can_id & 0x1FFFFFFF
        width = 8 if self.can_id & EXTENDED_FLAG or self.is_error else 3
        data = f"R{len(self.data)}" if self.is_remote else self.data.hex().upper()
        return f"{identifier:0{width}X}#{data}"


_new: Any = tuple.__new__
make_frame: Final[Callable[[tuple[int, bytes]], CanFrame]] = partial(_new, CanFrame)
"""Return the frame for a pair (identifier, data), faster than the constructor of the class."""


def remote_frame(cob_id: int, length: int = 0) -> CanFrame:
    """Return a remote frame for a COB-ID, which requests `length` bytes."""
    return CanFrame(cob_id | REMOTE_FLAG, bytes(length))


def pack_records(frames: Iterable[CanFrame]) -> bytes:
    """Return the concatenated records of `frames`, 16 bytes per frame."""
    return b"".join([RECORD.pack(can_id, len(data), data) for can_id, data in frames])


def frames_of(records: bytes | bytearray | memoryview) -> Iterator[CanFrame]:
    """Yield the frames of concatenated records; a length above 8 counts as 8."""
    for can_id, length, data in RECORD.iter_unpack(records):
        yield CanFrame(can_id, data[:length])


class Service(enum.Enum):
    """Services of the predefined connection set; RPDO and TPDO are from the device's view."""

    NMT = 0x000
    SYNC = 0x080  # the function code of EMCY, with node-ID 0
    EMCY = 0x081
    TIME = 0x100
    TPDO1 = 0x180
    RPDO1 = 0x200
    TPDO2 = 0x280
    RPDO2 = 0x300
    TPDO3 = 0x380
    RPDO3 = 0x400
    TPDO4 = 0x480
    RPDO4 = 0x500
    SDO_SERVER = 0x580  # server to client
    SDO_CLIENT = 0x600  # client to server
    HEARTBEAT = 0x700
    LSS_SLAVE = 0x7E4
    LSS_MASTER = 0x7E5


_PER_NODE = {
    service.value & ~1: service
    for service in Service
    if service not in (Service.NMT, Service.SYNC, Service.TIME, Service.LSS_SLAVE, Service.LSS_MASTER)
}
_SINGLE = {s.value: s for s in (Service.NMT, Service.SYNC, Service.TIME, Service.LSS_SLAVE, Service.LSS_MASTER)}


def cob_id(service: Service, node_id: int = BROADCAST) -> int:
    """Return the predefined COB-ID of `service` for a node; `node_id` is ignored for services without a node-ID."""
    if service in _SINGLE.values():
        return service.value
    return (service.value & ~1) + node_id


def service_of(identifier: int) -> tuple[Service, int] | None:
    """Return the service and node-ID of a COB-ID in the predefined connection set; None for other COB-IDs."""
    if (single := _SINGLE.get(identifier)) is not None:
        return single, BROADCAST
    service, node_id = _PER_NODE.get(identifier & 0x780), identifier & 0x7F
    return None if service is None or node_id == 0 else (service, node_id)


def rpdo_cob_id(number: int, node_id: int) -> int:
    """Return the predefined COB-ID of RPDO `number` (1 to 4) of a node."""
    return 0x100 + 0x100 * number + node_id


def tpdo_cob_id(number: int, node_id: int) -> int:
    """Return the predefined COB-ID of TPDO `number` (1 to 4) of a node."""
    return 0x80 + 0x100 * number + node_id


# Restricted CAN identifiers (CiA 301, 7.3.5, table 40); 0x080 and 0x100 belong to SYNC and TIME only.
_RESTRICTED: Final = ((0x000, 0x07F), (0x101, 0x180), (0x581, 0x5FF), (0x601, 0x67F), (0x6E0, 0x6FF), (0x701, 0x7FF))


def is_restricted(cob_id: int) -> bool:
    """Whether an 11-bit identifier is restricted (CiA 301, 7.3.5, table 40)."""
    return any(low <= cob_id <= high for low, high in _RESTRICTED)


def can_id_of(entry: int) -> int:
    """Return the CAN identifier in a COB-ID entry (such as 0x1800:01), with EXTENDED_FLAG if it has 29 bits."""
    return entry & 0x1FFFFFFF | EXTENDED_FLAG if entry & EXTENDED_BIT else entry & 0x7FF
