"""Data types of the drive profile's objects (CiA 402-2 and CiA 402-3), to compare with what a file says.

Only a table, and only for checking. Where editions or most devices differ, both types are right.
"""

from __future__ import annotations

from canopen_control.od.model import DataType

__all__ = ["AXIS_STEP", "DEVICE_PROFILE", "TYPES"]

DEVICE_PROFILE = 402  # the low word of 0x1000
AXIS_STEP = 0x800  # axis a has its objects at 0x6000 + a * 0x800

_I8, _I16, _I32 = DataType.INTEGER8, DataType.INTEGER16, DataType.INTEGER32
_U8, _U16, _U32 = DataType.UNSIGNED8, DataType.UNSIGNED16, DataType.UNSIGNED32

_BY_TYPE: dict[tuple[DataType, ...], tuple[int, ...]] = {
    (_I8,): (0x6060, 0x6061, 0x6098),
    (_U8,): (0x607E,),
    (_I16,): (
        *(0x6007, 0x6042, 0x6043, 0x6044, 0x605A, 0x605B, 0x605C, 0x605D, 0x605E, 0x606A),
        *(0x6071, 0x6074, 0x6077, 0x6078, 0x6086, 0x6088, 0x60B2, 0x60C0),
    ),
    (_U16,): (
        *(0x603F, 0x6040, 0x6041, 0x6066, 0x6068, 0x606D, 0x606E, 0x606F, 0x6070, 0x6072, 0x6073),
        *(0x60B8, 0x60B9, 0x60E0, 0x60E1, 0x60F2, 0x6402),
    ),
    (_I32,): (
        *(0x6062, 0x6063, 0x6064, 0x6069, 0x606B, 0x606C, 0x607A, 0x607C),
        *(0x60B0, 0x60B1, 0x60BA, 0x60BB, 0x60BC, 0x60BD, 0x60F4, 0x60FA, 0x60FC, 0x60FF),
    ),
    (_U32,): (
        *(0x6065, 0x6067, 0x6075, 0x6076, 0x6079, 0x607F, 0x6080, 0x6081, 0x6082, 0x6083, 0x6084, 0x6085),
        *(0x6087, 0x609A, 0x60A8, 0x60A9, 0x60C5, 0x60C6, 0x60FD, 0x6502, 0x67FF),
    ),
    (_I32, _U32): (0x60F8,),
}
_SUBS_BY_TYPE: dict[tuple[DataType, ...], tuple[tuple[int, int], ...]] = {
    (_I8,): ((0x60C2, 2),),
    (_U8,): ((0x60C2, 1),),
    (_U16,): ((0x6048, 2), (0x6049, 2), (0x604A, 2)),
    (_I32,): ((0x607B, 1), (0x607B, 2), (0x607D, 1), (0x607D, 2)),
    (_U32,): (
        *((0x6046, 1), (0x6046, 2), (0x6048, 1), (0x6049, 1), (0x604A, 1), (0x608F, 1), (0x608F, 2)),
        *((0x6090, 1), (0x6090, 2), (0x6091, 1), (0x6091, 2), (0x6092, 1), (0x6092, 2)),
        *((0x6096, 1), (0x6096, 2), (0x6097, 1), (0x6097, 2), (0x6099, 1), (0x6099, 2), (0x60FE, 1), (0x60FE, 2)),
    ),
}

TYPES: dict[tuple[int, int], tuple[DataType, ...]] = {
    (index, 0): types for types, indices in _BY_TYPE.items() for index in indices
} | {address: types for types, addresses in _SUBS_BY_TYPE.items() for address in addresses}
