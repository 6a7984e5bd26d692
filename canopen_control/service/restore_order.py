"""In which order parameters are written, so that a device takes them (CiA 301, 7.5.2.35 to 38; CiA 402).

What others depend on comes first: communication, then each PDO as a whole, the resolution of units, the motor, limits,
ramps, gains, the rest by index, the mode of operation, and 0x1020 last of all. Of a pair of limits the side that widens
the range comes first. A PDO is made invalid before anything of it is changed, its count is 0 while its entries are
written, and it is valid last if it is to be; bit 30 of its COB-ID is the device's own.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from canopen_control.cia301.pdo import INVALID_BIT, NO_RTR_BIT
from canopen_control.cia402 import objects as o
from canopen_control.od.codec import encode
from canopen_control.od.pdos import COMMUNICATION, MAPPING, pdo_of
from canopen_control.service.parameter_set import same_value
from canopen_control.service.read_parameters import entry_label

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from canopen_control.od.model import Address, ObjectDictionary, Value

__all__ = ["RestoreGroup", "Write", "restore_groups"]

_PDOS: Final = 1
_OTHERS: Final = 7
_RANKS: Final[dict[int, tuple[int, ...]]] = {
    0: (*range(0x1000, 0x1400),),
    2: (0x2000, 0x2001, 0x208C, *range(0x608F, 0x6098), o.POLARITY, *range(0x60A8, 0x60AC)),
    3: (*range(0x2002, 0x208C), *range(0x208D, 0x6000), o.MAX_CURRENT, o.MOTOR_RATED_CURRENT, o.MOTOR_RATED_TORQUE),
    4: (
        *(o.MAX_MOTOR_SPEED, o.MAX_PROFILE_VELOCITY, o.MAX_ACCELERATION, o.MAX_DECELERATION, o.MAX_TORQUE),
        *(o.POSITIVE_TORQUE_LIMIT, o.NEGATIVE_TORQUE_LIMIT, o.POSITION_RANGE_LIMIT, o.SOFTWARE_POSITION_LIMIT),
    ),
    5: (0x6007, *range(0x605A, 0x6060), *range(0x6065, 0x6071), *range(0x6081, 0x6089), *range(0x6098, 0x609B)),
    6: (0x60F6, 0x60F9, 0x60FB),
    8: (o.MODES_OF_OPERATION,),
    9: (0x1020,),
}
_RANK_OF: Final = {index: rank for rank, indices in _RANKS.items() for index in indices}
_PAIRS: Final = frozenset((o.POSITION_RANGE_LIMIT, o.SOFTWARE_POSITION_LIMIT))  # subindex 1 the least, 2 the greatest
_COB_ID: Final = 1


@dataclass(frozen=True, slots=True)
class Write:
    """One download."""

    address: Address
    data: bytes


@dataclass(frozen=True, slots=True)
class RestoreGroup:
    """What is written together: one parameter, or the records of one PDO; `name` is for people."""

    name: str
    writes: tuple[Write, ...]


def restore_groups(
    od: ObjectDictionary, wanted: Mapping[Address, Value], held: Mapping[Address, Value]
) -> list[RestoreGroup]:
    """Return in order what has to be written into a device that holds `held`, so that it holds `wanted`.

    Both are parameters of `od`; what `held` lacks is not written. Nothing where nothing differs.
    """
    known = {address: value for address, value in wanted.items() if address in held}
    changed = {address: value for address, value in known.items() if not same_value(od[address], value, held[address])}
    found: list[tuple[tuple[int, int, int], RestoreGroup]] = []
    for kind, number in {pdo for index, _ in changed if (pdo := pdo_of(index)) is not None}:
        writes = tuple(_pdo_writes(od, kind, number, known, held))
        place = _PDOS, COMMUNICATION[kind] + number, 0
        found.append((place, RestoreGroup(f"{kind.upper()} {number}", writes)))
    for address, value in changed.items():
        if pdo_of(address[0]) is None:
            entry = od[address]
            write = Write(address, encode(value, entry.data_type))
            found.append((_place(address, known, held), RestoreGroup(entry_label(entry), (write,))))
    return [group for _, group in sorted(found, key=lambda each: each[0])]


def _place(address: Address, wanted: Mapping[Address, Value], held: Mapping[Address, Value]) -> tuple[int, int, int]:
    """Return the rank of a parameter, its index, and its place among those of the index."""
    index, subindex = address
    base, _ = o.axis_of(index)
    if base in _PAIRS:
        new, old = wanted.get((index, 2)), held.get((index, 2))
        widens = isinstance(new, int) and isinstance(old, int) and new > old
        subindex = -subindex if widens else subindex
    return _RANK_OF.get(base, _OTHERS), index, subindex


def _pdo_writes(
    od: ObjectDictionary, kind: str, number: int, wanted: Mapping[Address, Value], held: Mapping[Address, Value]
) -> Iterator[Write]:
    """Yield the writes of one PDO: invalid, settings, count 0, entries, count, and the COB-ID as it is to be."""
    communication, mapping = COMMUNICATION[kind] + number - 1, MAPPING[kind] + number - 1
    cob_id = communication, _COB_ID
    present = held.get(cob_id)
    can_switch = cob_id in wanted and isinstance(present, int)

    def put(address: Address, value: Value) -> Write:
        return Write(address, encode(value, od[address].data_type))

    def differs(address: Address) -> bool:
        return not same_value(od[address], wanted[address], held[address])

    if can_switch and isinstance(present, int) and not present & INVALID_BIT:
        yield put(cob_id, present | INVALID_BIT)
    for address in sorted(wanted):
        if address[0] == communication and address[1] > _COB_ID and differs(address):
            yield put(address, wanted[address])
    slots = [address for address in sorted(wanted) if address[0] == mapping and address[1]]
    if any(differs(address) for address in (*slots, (mapping, 0)) if address in wanted):
        yield from _mapping_writes(od, (mapping, 0), slots, wanted, held)
    if can_switch and isinstance(present, int):
        target = wanted[cob_id]
        if isinstance(target, int) and not (target & INVALID_BIT and target & ~NO_RTR_BIT == present & ~NO_RTR_BIT):
            yield put(cob_id, target & ~NO_RTR_BIT | present & NO_RTR_BIT)


def _mapping_writes(
    od: ObjectDictionary,
    count: Address,
    slots: list[Address],
    wanted: Mapping[Address, Value],
    held: Mapping[Address, Value],
) -> Iterator[Write]:
    """Yield a mapping as a whole; of one whose count is fixed what differs."""
    if count not in wanted:
        for address in slots:
            if not same_value(od[address], wanted[address], held[address]):
                yield Write(address, encode(wanted[address], od[address].data_type))
        return
    yield Write(count, encode(0, od[count].data_type))
    used = wanted[count]
    for address in slots:
        if isinstance(used, int) and address[1] <= used:
            yield Write(address, encode(wanted[address], od[address].data_type))
    yield Write(count, encode(used, od[count].data_type))
