"""Default PDOs of an object dictionary (CiA 301, 7.5.2.35 to 7.5.2.38).

RPDO and TPDO are named from the view of the device: the device receives an RPDO. PDO k has its communication record at
0x1400 + k - 1 or 0x1800 + k - 1 and its mapping at 0x1600 + k - 1 or 0x1A00 + k - 1.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator

    from canopen_control.od.model import Entry, ObjectDictionary


MAX_BITS = 64
INVALID = 1 << 31  # bit of a COB-ID entry: the PDO is disabled
COUNT = 512
COMMUNICATION = {"rpdo": 0x1400, "tpdo": 0x1800}
MAPPING = {"rpdo": 0x1600, "tpdo": 0x1A00}
_MAPPINGS = tuple((kind == "rpdo", COMMUNICATION[kind], MAPPING[kind]) for kind in COMMUNICATION)
_MULTIPLEXED = (254, 255)  # number of mapped objects of SAM- and DAM-MPDOs (CiA 301, 7.5.2.36), which have no mapping


@dataclass(frozen=True, slots=True)
class Mapped:
    """Mapped object; `entry` is None if the dictionary lacks it, `source` is the mapping entry."""

    index: int
    subindex: int
    bits: int
    entry: Entry | None
    source: Entry

    @property
    def is_dummy(self) -> bool:
        """Whether the object is a dummy: a data type that fills a gap in an RPDO."""
        return 1 <= self.index <= 7 and self.subindex == 0


@dataclass(frozen=True, slots=True)
class Pdo:
    """Default configuration of one PDO; `count` is the number of mapped objects in subindex 0, None if absent."""

    number: int  # counted from 1
    is_rpdo: bool
    communication: int  # index of the communication parameter
    mapping: int  # index of the mapping parameter
    cob_id: int | None  # including the flag bits
    transmission_type: int | None
    count: int | None
    slots: int  # number of objects that can be mapped
    mapped: tuple[Mapped, ...]

    @property
    def name(self) -> str:
        """Name such as ``RPDO1``."""
        return f"{'R' if self.is_rpdo else 'T'}PDO{self.number}"

    @property
    def enabled(self) -> bool:
        """Whether the PDO is valid by default."""
        return self.cob_id is not None and not self.cob_id & INVALID

    @property
    def bits(self) -> int:
        """Number of mapped bits; more than 64 are an error."""
        return sum(mapped.bits for mapped in self.mapped)


def pdo_of(index: int) -> tuple[str, int] | None:
    """Return the kind ("rpdo" or "tpdo") and number of the PDO to which a communication or mapping record belongs.

    The result is None for other objects.
    """
    for kind in COMMUNICATION:
        for first in (COMMUNICATION[kind], MAPPING[kind]):
            if first <= index < first + COUNT:
                return kind, index - first + 1
    return None


def is_cob_id(index: int, subindex: int) -> bool:
    """Whether the object is the COB-ID of a PDO."""
    return subindex == 1 and any(first <= index < first + COUNT for first in COMMUNICATION.values())


def pdos_of(od: ObjectDictionary) -> list[Pdo]:
    """Return all PDOs with a communication or mapping record: first the RPDOs, then the TPDOs, by number."""
    return list(_pdos(od))


def _pdos(od: ObjectDictionary) -> Iterator[Pdo]:
    for is_rpdo, communication, mapping in _MAPPINGS:
        ranges = range(communication, communication + COUNT), range(mapping, mapping + COUNT)
        offsets = {index - records.start for index in od.objects for records in ranges if index in records}
        for offset in sorted(offsets):
            yield _pdo(od, offset, is_rpdo, communication + offset, mapping + offset)


def _pdo(od: ObjectDictionary, offset: int, is_rpdo: bool, communication: int, mapping: int) -> Pdo:
    count = od.number(mapping, 0)
    sources = [entry for sub in range(1, 65) if (entry := od.get(mapping, sub)) is not None]
    return Pdo(
        number=offset + 1,
        is_rpdo=is_rpdo,
        communication=communication,
        mapping=mapping,
        cob_id=od.number(communication, 1),
        transmission_type=od.number(communication, 2),
        count=count,
        slots=len(sources),
        mapped=tuple(_mapped(od, sources, count)),
    )


def _mapped(od: ObjectDictionary, sources: list[Entry], count: int | None) -> Iterator[Mapped]:
    if count in _MULTIPLEXED:
        return
    for source in sources:
        value = source.value
        if not isinstance(value, int) or value == 0 or (count is not None and source.subindex > count):
            continue
        index, subindex, bits = value >> 16 & 0xFFFF, value >> 8 & 0xFF, value & 0xFF
        yield Mapped(index, subindex, bits, od.get(index, subindex), source)
