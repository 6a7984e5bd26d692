"""Abort codes of SDO transfers and their meanings (CiA 301, table 22).

The table holds the codes of CiA 301 and two codes of ETG.1000 that drives also send on CANopen. Codes outside the
table are legal, because manufacturers define their own; `abort_text` describes them as unknown.
"""

from __future__ import annotations

import enum


class AbortCode(enum.IntEnum):
    """SDO abort code; `text` is its meaning."""

    text: str

    def __new__(cls, code: int, text: str) -> AbortCode:
        """Create a member from its 32-bit code and its meaning."""
        member = int.__new__(cls, code)
        member._value_ = code
        member.text = text
        return member

    TOGGLE_NOT_ALTERNATED = 0x05030000, "toggle bit not alternated"
    TIMED_OUT = 0x05040000, "SDO protocol timed out"
    UNKNOWN_COMMAND = 0x05040001, "command specifier invalid or unknown"
    INVALID_BLOCK_SIZE = 0x05040002, "invalid block size"
    INVALID_SEQUENCE_NUMBER = 0x05040003, "invalid sequence number"
    CRC_ERROR = 0x05040004, "CRC error"
    OUT_OF_MEMORY = 0x05040005, "out of memory"
    UNSUPPORTED_ACCESS = 0x06010000, "unsupported access to an object"
    WRITE_ONLY = 0x06010001, "attempt to read a write-only object"
    READ_ONLY = 0x06010002, "attempt to write a read-only object"
    SUB0_NOT_ZERO = 0x06010003, "subindex cannot be written, subindex 0 must be 0 for write access"
    NO_COMPLETE_ACCESS = 0x06010004, "complete access not supported"
    NO_OBJECT = 0x06020000, "object does not exist in the object dictionary"
    NOT_MAPPABLE = 0x06040041, "object cannot be mapped to the PDO"
    MAPPING_TOO_LONG = 0x06040042, "the mapped objects would exceed the PDO length"
    PARAMETER_INCOMPATIBLE = 0x06040043, "general parameter incompatibility"
    INTERNAL_INCOMPATIBLE = 0x06040047, "general internal incompatibility in the device"
    HARDWARE_ERROR = 0x06060000, "access failed due to a hardware error"
    LENGTH_MISMATCH = 0x06070010, "data type does not match, length of service parameter does not match"
    LENGTH_TOO_HIGH = 0x06070012, "data type does not match, length of service parameter too high"
    LENGTH_TOO_LOW = 0x06070013, "data type does not match, length of service parameter too low"
    NO_SUBINDEX = 0x06090011, "subindex does not exist"
    INVALID_VALUE = 0x06090030, "invalid value for parameter"
    VALUE_TOO_HIGH = 0x06090031, "value of parameter written too high"
    VALUE_TOO_LOW = 0x06090032, "value of parameter written too low"
    MAXIMUM_BELOW_MINIMUM = 0x06090036, "maximum value is less than minimum value"
    NO_RESOURCE = 0x060A0023, "resource not available: SDO connection"
    GENERAL_ERROR = 0x08000000, "general error"
    CANNOT_STORE = 0x08000020, "data cannot be transferred or stored to the application"
    LOCAL_CONTROL = 0x08000021, "data cannot be transferred or stored to the application because of local control"
    DEVICE_STATE = (
        0x08000022,
        "data cannot be transferred or stored to the application because of the present device state",
    )
    NO_DICTIONARY = 0x08000023, "object dictionary not present or its dynamic generation failed"
    NO_DATA = 0x08000024, "no data available"


BUSY_CODES = frozenset(
    (AbortCode.OUT_OF_MEMORY, AbortCode.NO_RESOURCE, AbortCode.LOCAL_CONTROL, AbortCode.DEVICE_STATE),
)
"""Abort codes whose cause may disappear after a pause, so that a retry is worthwhile."""

_TEXTS = {int(code): code.text for code in AbortCode}


def abort_text(code: int) -> str:
    """Return the meaning of `code`, or a text that calls it unknown."""
    return _TEXTS.get(code, "unknown code")
