"""Data types of the objects in the communication area, 0x1000 to 0x1BFF (CiA 301, 7.5.2).

They are used for an object whose DataType is missing in the file, or is the type of the whole record.
"""

from __future__ import annotations

from typing import Final

from canopen_control.od.model import DataType

_COMMUNICATION: Final = {
    2: DataType.UNSIGNED8,
    3: DataType.UNSIGNED16,
    4: DataType.UNSIGNED8,
    5: DataType.UNSIGNED16,
    6: DataType.UNSIGNED8,
}
_RECORDS: Final = (
    (range(0x1003, 0x1004), {}, DataType.UNSIGNED32),
    (range(0x1010, 0x1012), {}, DataType.UNSIGNED32),
    (range(0x1016, 0x1017), {}, DataType.UNSIGNED32),
    (range(0x1018, 0x1019), {}, DataType.UNSIGNED32),
    (range(0x1029, 0x102A), {}, DataType.UNSIGNED8),
    (range(0x1200, 0x1300), {3: DataType.UNSIGNED8}, DataType.UNSIGNED32),
    *(
        (
            range(first, first + 0x200),
            _COMMUNICATION,
            DataType.UNSIGNED32,
        )
        for first in (0x1400, 0x1800)
    ),
    *((range(first, first + 0x200), {}, DataType.UNSIGNED32) for first in (0x1600, 0x1A00)),
)
"""Ranges of indices, types by subindex, and the type of the other subindices above 0 (CiA 301, 7.5.2)."""
_VARIABLES: Final = {
    **dict.fromkeys((0x1000, 0x1002, 0x1005, 0x1006, 0x1007, 0x1012, 0x1013, 0x1014), DataType.UNSIGNED32),
    **dict.fromkeys((0x100C, 0x1015, 0x1017), DataType.UNSIGNED16),
    **dict.fromkeys((0x1001, 0x100D, 0x1019), DataType.UNSIGNED8),
}


def communication_type(index: int, subindex: int) -> DataType | None:
    """Return the data type that CiA 301 specifies for an object of the communication area, None if there is none."""
    if subindex == 0 and index in _VARIABLES:
        return _VARIABLES[index]
    found = ((types, other) for indices, types, other in _RECORDS if index in indices)
    types, other = next(found, ({}, None))
    return DataType.UNSIGNED8 if subindex == 0 and other is not None else types.get(subindex, other)
