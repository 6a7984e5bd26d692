"""Object dictionary of a node as plain data.

Objects are addressed by (index, subindex); names are only for display, since in one of four devices they are not
unique. Types, access and mappability are those of the file, not of a profile (CiA 301, 7.4; CiA 306-1). The dictionary
contains the data of the file, even if they are inconsistent; `check_dictionary` reports inconsistent data.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping


Value = int | float | str | bytes
Address = tuple[int, int]  # (index, subindex)


class ObjectCode(enum.IntEnum):
    """Object codes (CiA 301, table 42)."""

    NULL = 0
    DOMAIN = 2
    DEFTYPE = 5
    DEFSTRUCT = 6
    VAR = 7
    ARRAY = 8
    RECORD = 9


SCALAR_CODES = (ObjectCode.VAR, ObjectCode.DOMAIN, ObjectCode.DEFTYPE)  # codes of objects with one value, at subindex 0


class DataType(enum.IntEnum):
    """Basic data types (CiA 301, table 44)."""

    BOOLEAN = 0x01
    INTEGER8 = 0x02
    INTEGER16 = 0x03
    INTEGER32 = 0x04
    UNSIGNED8 = 0x05
    UNSIGNED16 = 0x06
    UNSIGNED32 = 0x07
    REAL32 = 0x08
    VISIBLE_STRING = 0x09
    OCTET_STRING = 0x0A
    UNICODE_STRING = 0x0B
    TIME_OF_DAY = 0x0C
    TIME_DIFFERENCE = 0x0D
    DOMAIN = 0x0F
    INTEGER24 = 0x10
    REAL64 = 0x11
    INTEGER40 = 0x12
    INTEGER48 = 0x13
    INTEGER56 = 0x14
    INTEGER64 = 0x15
    UNSIGNED24 = 0x16
    UNSIGNED40 = 0x18
    UNSIGNED48 = 0x19
    UNSIGNED56 = 0x1A
    UNSIGNED64 = 0x1B

    @property
    def bits(self) -> int | None:
        """Width in a PDO in bits, or None for types of variable length."""
        return _BITS.get(self)

    @property
    def signed(self) -> bool:
        """Whether the type is an INTEGERn type."""
        return self in _SIGNED

    @property
    def is_integer(self) -> bool:  # type: ignore[override, unused-ignore]  # int has a method of this name since 3.12
        """Whether the values are integers: BOOLEAN, INTEGERn, UNSIGNEDn and the two time types."""
        return self in _BITS and self not in _REALS

    @property
    def is_real(self) -> bool:
        return self in _REALS

    @property
    def minimum(self) -> int:
        """Lowest value of an integer type; 0 for other types."""
        return _RANGES.get(self, (0, 0))[0]

    @property
    def maximum(self) -> int:
        """Highest value of an integer type; 0 for other types."""
        return _RANGES.get(self, (0, 0))[1]


_WIDTHS = (8, 16, 24, 32, 40, 48, 56, 64)
_BITS: dict[int, int] = {
    DataType.BOOLEAN: 1,
    **{DataType[f"INTEGER{n}"]: n for n in _WIDTHS},
    **{DataType[f"UNSIGNED{n}"]: n for n in _WIDTHS},
    DataType.REAL32: 32,
    DataType.REAL64: 64,
    DataType.TIME_OF_DAY: 48,
    DataType.TIME_DIFFERENCE: 48,
}
_SIGNED: frozenset[int] = frozenset(DataType[f"INTEGER{n}"] for n in _WIDTHS)
SIGNED_TYPES = {DataType[f"UNSIGNED{bits}"]: DataType[f"INTEGER{bits}"] for bits in (8, 16, 32)}
"""Signed types for objects of CiA 402 that an EDS has as unsigned; longer types do not occur there."""
_REALS: frozenset[int] = frozenset((DataType.REAL32, DataType.REAL64))
_RANGES: dict[int, tuple[int, int]] = {
    number: (-(1 << (bits - 1)), (1 << (bits - 1)) - 1) if number in _SIGNED else (0, (1 << bits) - 1)
    for number, bits in _BITS.items()
    if number not in _REALS
}

BIT_RATES = (10, 20, 50, 125, 250, 500, 800, 1000)  # kbit/s (CiA 301, table 1)
ACCESS_TYPES = ("ro", "wo", "rw", "rwr", "rww", "const")
_READABLE = frozenset(("ro", "rw", "rwr", "rww", "const"))
_WRITABLE = frozenset(("wo", "rw", "rwr", "rww"))
_RPDO = frozenset(("wo", "rw", "rww"))  # CiA 306-1: rwr can be mapped into TPDOs only, rww into RPDOs only
_TPDO = frozenset(("ro", "rw", "rwr", "const"))


@dataclass(frozen=True, slots=True)
class Entry:
    """One subindex of an object.

    `default` is the DefaultValue and `parameter_value` the ParameterValue of a DCF, None if absent. A `relative` value
    is written with $NODEID in the file; the node-ID is added to it if the dictionary has one.
    """

    index: int
    subindex: int
    name: str
    data_type: DataType
    access: str = "rw"  # one of ACCESS_TYPES
    pdo_mappable: bool = False
    default: Value | None = None
    low: int | float | None = None
    high: int | float | None = None
    relative: bool = False  # the default contains $NODEID
    low_relative: bool = False
    high_relative: bool = False
    parameter_value: Value | None = None
    parameter_relative: bool = False
    obj_flags: int = 0  # bit 0: not written by a DCF download; bit 1: not read by a scan
    line: int = field(default=0, compare=False)  # line of its section in the file; 0 without a file
    texts: Mapping[str, str] = field(default_factory=dict, compare=False)  # keys without a field, as in the file

    @property
    def address(self) -> Address:
        return self.index, self.subindex

    @property
    def value(self) -> Value | None:
        """Value after configuration: ParameterValue, else DefaultValue, else None."""
        return self.default if self.parameter_value is None else self.parameter_value

    @property
    def readable(self) -> bool:
        """Whether the access type permits an SDO upload."""
        return self.access in _READABLE

    @property
    def writable(self) -> bool:
        """Whether the access type permits an SDO download."""
        return self.access in _WRITABLE

    @property
    def rpdo_mappable(self) -> bool:
        return self.pdo_mappable and self.access in _RPDO

    @property
    def tpdo_mappable(self) -> bool:
        return self.pdo_mappable and self.access in _TPDO


@dataclass(frozen=True, slots=True)
class ObjectInfo:
    """Name and object code of one index; the values are in the entries."""

    index: int
    name: str
    code: ObjectCode
    line: int = field(default=0, compare=False)
    texts: Mapping[str, str] = field(default_factory=dict, compare=False)  # keys without a field, as in the file


@dataclass(frozen=True, slots=True)
class DeviceInfo:
    """Content of the section [DeviceInfo]; missing identity numbers are None."""

    vendor_name: str = ""
    vendor_number: int | None = None
    product_name: str = ""
    product_number: int | None = None
    revision_number: int | None = None
    order_code: str = ""
    bit_rates: frozenset[int] = frozenset()  # bit/s
    simple_boot_up_master: bool = False
    simple_boot_up_slave: bool = False
    granularity: int = 8  # bits; 0: the mapping is fixed
    dynamic_channels: int = 0
    group_messaging: bool = False
    rpdo_count: int = 0
    tpdo_count: int = 0
    lss_supported: bool = False
    compact_pdo: int = 0


@dataclass(frozen=True, slots=True)
class Commissioning:
    """Content of the section [DeviceComissioning] of a DCF, without node-ID and bit rate."""

    node_name: str = ""
    network_number: int | None = None
    network_name: str = ""
    canopen_manager: bool = False
    lss_serial_number: int | None = None


@dataclass(slots=True)
class ObjectDictionary:
    """Entries of a node, addressed by (index, subindex).

    `bitrate` is in bit/s. `sections` contains the texts of the file's sections other than those of objects.
    """

    node_id: int | None = None
    bitrate: int | None = None
    device: DeviceInfo = field(default_factory=DeviceInfo)
    objects: dict[int, ObjectInfo] = field(default_factory=dict)
    entries: dict[Address, Entry] = field(default_factory=dict)
    dummy_usage: frozenset[int] = frozenset()  # type indices 0x0001 to 0x0007 that can fill gaps of an RPDO
    commissioning: Commissioning = field(default_factory=Commissioning)
    comments: tuple[str, ...] = ()
    sections: dict[str, dict[str, str]] = field(default_factory=dict)

    def __contains__(self, address: object) -> bool:
        return address in self.entries

    def __getitem__(self, address: Address) -> Entry:
        return self.entries[address]

    def __iter__(self) -> Iterator[Entry]:
        return iter(self.entries.values())

    def __len__(self) -> int:
        return len(self.entries)

    def get(self, index: int, subindex: int = 0) -> Entry | None:
        """Return the entry at an address, or None if absent."""
        return self.entries.get((index, subindex))

    def number(self, index: int, subindex: int = 0) -> int | None:
        """Return the integer that the file gives an entry, or None if the entry is absent or has none."""
        entry = self.entries.get((index, subindex))
        return entry.value if entry is not None and isinstance(entry.value, int) else None

    def add(self, entry: Entry) -> None:
        """Add or replace an entry; an object is created for a new index."""
        self.entries[entry.address] = entry
        if entry.index not in self.objects:
            scalar = ObjectCode.DOMAIN if entry.data_type is DataType.DOMAIN else ObjectCode.VAR
            code = scalar if entry.subindex == 0 else ObjectCode.RECORD
            self.objects[entry.index] = ObjectInfo(entry.index, entry.name, code)

    def subindices(self, index: int) -> list[int]:
        """Return the subindices of an object in ascending order; empty if it does not exist."""
        return sorted(sub for i, sub in self.entries if i == index)

    def find(self, name: str) -> Entry | None:
        """Return the entry with this name; None if no or several entries have it.

        A sub-object may be named together with its object, ``Object.Sub``. Letter case matters only if names differ
        in nothing else.
        """
        exact = self._named(lambda candidate: candidate == name)
        if len(exact) != 1:
            folded = name.casefold()
            exact = exact or self._named(lambda candidate: candidate.casefold() == folded)
        return exact[0] if len(exact) == 1 else None

    def _named(self, matches: Callable[[str], bool]) -> list[Entry]:
        return [entry for entry in self if any(matches(name) for name in self._names_of(entry))]

    def _names_of(self, entry: Entry) -> tuple[str, ...]:
        info = self.objects.get(entry.index)
        if info is None or info.code in (ObjectCode.VAR, ObjectCode.DOMAIN):
            return (entry.name,)
        return entry.name, f"{info.name}.{entry.name}"

    def for_node(self, node_id: int) -> ObjectDictionary:
        """Return a copy for `node_id`, which replaces $NODEID, so that one parsed file serves many nodes."""
        shift = node_id - (self.node_id or 0)
        entries = self.entries.copy()
        for address, entry in self.entries.items() if shift else ():
            if entry.relative or entry.parameter_relative or entry.low_relative or entry.high_relative:
                entries[address] = _shifted(entry, shift)
        return replace(self, node_id=node_id, entries=entries, objects=dict(self.objects), sections=dict(self.sections))


_RELATIVE = {  # flag of an entry: the field to which the flag belongs
    "relative": "default",
    "parameter_relative": "parameter_value",
    "low_relative": "low",
    "high_relative": "high",
}


def _shifted(entry: Entry, shift: int) -> Entry:
    changes: dict[str, Any] = {
        name: getattr(entry, name) + shift
        for flag, name in _RELATIVE.items()
        if getattr(entry, flag) and getattr(entry, name) is not None
    }
    return replace(entry, **changes) if changes else entry


# Data types of the objects in the communication area, 0x1000 to 0x1BFF (CiA 301, 7.5.2), for objects whose DataType is
# missing in the file or is the type of the whole record.


_PDO_COMMUNICATION: Final = {
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
    *((range(first, first + 0x200), _PDO_COMMUNICATION, DataType.UNSIGNED32) for first in (0x1400, 0x1800)),
    *((range(first, first + 0x200), {}, DataType.UNSIGNED32) for first in (0x1600, 0x1A00)),
)
"""Ranges of indices, types by subindex, and the type of the other subindices above 0."""
_VARIABLES: Final = {
    **dict.fromkeys((0x1000, 0x1002, 0x1005, 0x1006, 0x1007, 0x1012, 0x1013, 0x1014), DataType.UNSIGNED32),
    **dict.fromkeys((0x100C, 0x1015, 0x1017), DataType.UNSIGNED16),
    **dict.fromkeys((0x1001, 0x100D, 0x1019), DataType.UNSIGNED8),
}


def communication_type(index: int, subindex: int) -> DataType | None:
    """Return the data type that CiA 301 specifies for an object of the communication area, or None."""
    if subindex == 0 and index in _VARIABLES:
        return _VARIABLES[index]
    records = ((types, other) for indices, types, other in _RECORDS if index in indices)
    types, other = next(records, ({}, None))
    return DataType.UNSIGNED8 if subindex == 0 and other is not None else types.get(subindex, other)


# Data types of the objects of the drive profile (CiA 402-2 and CiA 402-3), for comparison with the file, and for
# objects whose DataType is missing. Where editions or most devices differ, both types are accepted.


DEVICE_PROFILE = 402  # low word of 0x1000
PROFILE_START = 0x6000  # first object of the device profiles
AXIS_STEP = 0x800  # axis a has its objects at 0x6000 + a * 0x800 (CiA 402-1)

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


def profile_type(index: int, subindex: int) -> tuple[DataType, ...]:
    """Return the data types that CiA 402 accepts for an object of any axis of a drive; () if unknown."""
    if index < PROFILE_START:
        return ()
    return TYPES.get((PROFILE_START + (index - PROFILE_START) % AXIS_STEP, subindex), ())
