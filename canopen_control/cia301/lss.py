"""Layer setting services: the frames and tables that LSS master and LSS slave share (CiA 305).

Every LSS frame has 8 bytes: command specifier, then parameters, little-endian, the rest zero. The master sends on
0x7E5, all slaves answer on 0x7E4 without saying who they are: services either address one slave by its identity
(0x1018) or have answers that may collide because they are equal.
"""

from __future__ import annotations

import enum
from typing import NamedTuple

from canopen_control.frame import CanFrame

__all__ = [
    "BIT_TIMINGS",
    "UNCONFIGURED",
    "LssCommand",
    "LssIdentity",
    "LssMode",
    "bit_timing_index",
    "lss_frame",
]

MASTER_COB_ID = 0x7E5
SLAVE_COB_ID = 0x7E4
UNCONFIGURED = 0xFF  # the node id of a node that has none
FAST_SCAN_START = 0x80  # in place of the bit number

# Table 0 of bit timings: index to bit/s; index 5 is reserved.
BIT_TIMINGS: dict[int, int] = {
    0: 1_000_000,
    1: 800_000,
    2: 500_000,
    3: 250_000,
    4: 125_000,
    6: 50_000,
    7: 20_000,
    8: 10_000,
}
AUTOMATIC_BIT_TIMING = 9


class LssMode(enum.IntEnum):
    """The two states of a slave, as switch state global writes them."""

    WAITING = 0
    CONFIGURATION = 1


class LssCommand(enum.IntEnum):
    """Command specifiers; those of one group follow each other in the order of the identity's parts."""

    SWITCH_GLOBAL = 0x04
    CONFIGURE_NODE_ID = 0x11
    CONFIGURE_BIT_TIMING = 0x13
    ACTIVATE_BIT_TIMING = 0x15
    STORE = 0x17
    SWITCH_SELECTIVE = 0x40  # 0x40 vendor, 0x41 product, 0x42 revision, 0x43 serial number
    SWITCHED = 0x44
    IDENTIFY = 0x46  # 0x46 vendor, 0x47 product, 0x48/0x49 revision low/high, 0x4A/0x4B serial low/high
    IDENTIFY_NON_CONFIGURED = 0x4C
    IDENTIFIED = 0x4F
    IDENTIFIED_NON_CONFIGURED = 0x50
    FAST_SCAN = 0x51
    INQUIRE = 0x5A  # 0x5A vendor, 0x5B product, 0x5C revision, 0x5D serial number
    INQUIRE_NODE_ID = 0x5E


class LssIdentity(NamedTuple):
    """The LSS address: 0x1018:01 to 04."""

    vendor: int
    product: int
    revision: int
    serial: int


def lss_frame(command: int, value: int = 0, *, tail: bytes = b"", cob_id: int = MASTER_COB_ID) -> CanFrame:
    """Make a frame of a command, a 32-bit value and up to three more bytes."""
    head = bytes((command,)) + value.to_bytes(4, "little")
    return CanFrame(cob_id, (head + tail).ljust(8, b"\0"))


def bit_timing_index(bitrate: int) -> int | None:
    """Return the index in table 0 of `bitrate` in bit/s, or None."""
    return next((index for index, known in BIT_TIMINGS.items() if known == bitrate), None)
