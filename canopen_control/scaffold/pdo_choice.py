"""Choice of the PDOs in a new bus.yml for the objects that a drive needs.

A writable mapping is filled in the order of the required objects, up to the slots and the 64 bits of the PDO. If the
mapping is fixed (entries are const or ro, or the EDS has Granularity=0), the fewest PDOs with all required objects are
used unchanged. An RPDO that repeats an object is not added for useful objects, because two controlwords would compete
(CiA 301, 7.5.2.35 to 7.5.2.38; CiA 306-1).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from canopen_control.od.codec import outside_limits
from canopen_control.od.pdos import MAX_BITS, pdos_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from canopen_control.od.model import Address, ObjectDictionary
    from canopen_control.od.pdos import Pdo


_PREDEFINED = 4  # PDOs of each direction with a COB-ID in the predefined connection set


@dataclass(frozen=True, slots=True)
class PdoRequirement:
    """Required and useful objects of the PDOs in one direction; `transmission` is the preferred type."""

    is_rpdo: bool
    needed: tuple[Address, ...]
    useful: tuple[Address, ...] = ()
    transmission: int = 1


@dataclass(frozen=True, slots=True)
class PdoUse:
    """PDO in the new bus.yml; `remaps`: the mapping is written; `auto`: the COB-ID is set to the default.

    `transmission` None keeps the device's type. `fixed` means that nothing can be changed; bus.yml then omits the PDO.
    """

    number: int
    objects: tuple[Address, ...]
    remaps: bool
    auto: bool
    transmission: int | None
    fixed: bool = False


def choose_pdos(od: ObjectDictionary, required: PdoRequirement) -> tuple[tuple[PdoUse, ...], tuple[Address, ...]]:
    """Return the PDOs to use, in order of number, and the required objects that do not fit."""
    pdos = [pdo for pdo in pdos_of(od) if pdo.is_rpdo == required.is_rpdo and (pdo.communication, 1) in od]
    needed = [address for address in required.needed if _mappable(od, address, required)]
    useful = [address for address in required.useful if _mappable(od, address, required)]
    fixed = [pdo for pdo in pdos if _usable(od, pdo, required)]
    uses = _choose(od, pdos, fixed, required, (needed, useful))
    if any(not od[pdo.communication, 1].writable for pdo, _, _ in uses):
        live = [(pdo, _ordered(pdo), False) for pdo in fixed if pdo.enabled]
        own = tuple(PdoUse(pdo.number, objects, False, False, None, fixed=True) for pdo, objects, _ in live)
        return own, _missing(live, required.needed)
    return _result(od, uses, required), _missing(uses, required.needed)


def complete_pdos(od: ObjectDictionary, required: PdoRequirement) -> tuple[PdoUse, ...]:
    """Return PDOs that contain the required objects; () if the default PDOs need, or permit, no addition.

    PDOs that are enabled by default stay unchanged. Disabled PDOs that have the objects in the default mapping are
    enabled, as CiA 401 requires for PDOs 2 to 4; objects that are still missing are mapped into unused PDOs.
    """
    pdos = [pdo for pdo in pdos_of(od) if pdo.is_rpdo == required.is_rpdo and (pdo.communication, 1) in od]
    uses = [(pdo, _ordered(pdo), False) for pdo in pdos if pdo.enabled and _usable(od, pdo, required)]
    live = {pdo.number for pdo, _, _ in uses}
    rest = [address for address in _missing(uses, dict.fromkeys(required.needed)) if _mappable(od, address, required)]
    disabled = [pdo for pdo in pdos if pdo.number not in live and _usable(od, pdo, required)]
    added = _covering([pdo for pdo in disabled if not _objects(pdo) & _carried(uses)], rest, ())
    used = live | {pdo.number for pdo, _, _ in added}
    free = [pdo for pdo in pdos if pdo.number not in used and _slots(od, pdo)]
    added += _packed(od, free, _missing(added, rest))
    if not added:
        return ()
    kept = tuple(PdoUse(pdo.number, objects, False, False, None) for pdo, objects, _ in uses)
    new = (PdoUse(pdo.number, objects, remaps, _auto(od, pdo), None) for pdo, objects, remaps in added)
    return tuple(sorted((*kept, *new), key=lambda use: use.number))


def not_carried(od: ObjectDictionary, required: PdoRequirement, uses: Sequence[PdoUse]) -> tuple[Address, ...]:
    """Return the required objects that are neither in `uses` nor, if `uses` is empty, in the default PDOs."""
    live = (
        pdo for pdo in pdos_of(od) if pdo.is_rpdo == required.is_rpdo and (pdo.communication, 1) in od and pdo.enabled
    )
    mapped = [use.objects for use in uses] or [_ordered(pdo) for pdo in live if _usable(od, pdo, required)]
    carried = {address for objects in mapped for address in objects}
    return tuple(address for address in dict.fromkeys(required.needed) if address not in carried)


_Use = tuple["Pdo", "tuple[Address, ...]", bool]


def _choose(
    od: ObjectDictionary,
    pdos: Sequence[Pdo],
    fixed: Sequence[Pdo],
    required: PdoRequirement,
    requirements: tuple[list[Address], list[Address]],
) -> list[_Use]:
    """Use fixed PDOs if they suffice; otherwise fill writable PDOs, and use fixed PDOs for the remaining objects."""
    needed, useful = requirements
    uses = _covering(fixed, needed, useful, doubling=not required.is_rpdo)
    if not od.device.granularity and not _missing(uses, needed):
        return uses
    packed = _packed(od, [pdo for pdo in pdos if _slots(od, pdo)], [*needed, *useful])
    if not packed:
        return uses
    rest = [address for address in needed if address not in _carried(packed)]
    numbers = {pdo.number for pdo, _, _ in packed}
    return [*packed, *_covering([pdo for pdo in fixed if pdo.number not in numbers], rest, ())]


def _packed(od: ObjectDictionary, pdos: Iterable[Pdo], addresses: Sequence[Address]) -> list[_Use]:
    """Map objects into writable PDOs, one PDO after the other."""
    rest, uses = list(addresses), list[_Use]()
    for pdo in pdos:
        used, bits = list[tuple[int, int]](), 0
        for address in list(rest):
            width = od[address].data_type.bits or MAX_BITS
            if len(used) < _slots(od, pdo) and bits + width <= MAX_BITS:
                used.append(address)
                rest.remove(address)
                bits += width
        if used:
            uses.append((pdo, tuple(used), True))
    return uses


def _covering(
    pdos: Sequence[Pdo], needed: Iterable[Address], useful: Iterable[Address], *, doubling: bool = False
) -> list[_Use]:
    """Choose the PDOs with the most required objects in their default mapping, then PDOs with useful objects.

    PDOs for useful objects must not repeat an object unless `doubling` is True, which would do harm in RPDOs.
    """
    uses, rest = list[_Use](), set(needed)
    remaining = list(pdos)
    while rest and remaining:
        best = max(remaining, key=lambda pdo: (len(rest & _objects(pdo)), -pdo.number))
        if not rest & _objects(best):
            break
        remaining.remove(best)
        rest -= _objects(best)
        uses.append((best, _ordered(best), False))
    for pdo in remaining:
        carried = _carried(uses)
        if _objects(pdo) & (set(useful) - carried) and (doubling or not _objects(pdo) & carried):
            uses.append((pdo, _ordered(pdo), False))
    return uses


def _result(od: ObjectDictionary, uses: Sequence[_Use], required: PdoRequirement) -> tuple[PdoUse, ...]:
    return tuple(
        PdoUse(pdo.number, objects, remaps, _auto(od, pdo), _transmission(od, pdo, required))
        for pdo, objects, remaps in sorted(uses, key=lambda use: use[0].number)
    )


def _missing(uses: Sequence[_Use], needed: Iterable[Address]) -> tuple[Address, ...]:
    return tuple(address for address in needed if address not in _carried(uses))


def _carried(uses: Sequence[_Use]) -> set[Address]:
    return {address for _, objects, _ in uses for address in objects}


def _ordered(pdo: Pdo) -> tuple[Address, ...]:
    return tuple((mapped.index, mapped.subindex) for mapped in pdo.mapped)


def _objects(pdo: Pdo) -> set[Address]:
    return set(_ordered(pdo))


def _mappable(od: ObjectDictionary, address: Address, required: PdoRequirement) -> bool:
    entry = od.get(*address)
    if entry is None or entry.data_type.bits is None or entry.data_type.bits % 8:
        return False
    return entry.rpdo_mappable if required.is_rpdo else entry.tpdo_mappable


def _usable(od: ObjectDictionary, pdo: Pdo, required: PdoRequirement) -> bool:
    """Whether the default mapping of a PDO can be used: all objects exist, are mappable, and fit."""
    return (
        bool(pdo.mapped)
        and (pdo.enabled or od[pdo.communication, 1].writable)
        and pdo.bits <= MAX_BITS
        and (pdo.count is None or pdo.count == len(pdo.mapped))
        and all(
            mapped.index in od.dummy_usage
            if mapped.is_dummy
            else _mappable(od, (mapped.index, mapped.subindex), required)
            for mapped in pdo.mapped
        )
    )


def _slots(od: ObjectDictionary, pdo: Pdo) -> int:
    """Return the number of objects that can be mapped by SDO; 0 for a fixed mapping."""
    count = od.get(pdo.mapping, 0)
    if count is None or not count.writable or not od[pdo.communication, 1].writable:
        return 0
    slots = 0
    while (entry := od.get(pdo.mapping, slots + 1)) is not None and entry.writable:
        slots += 1
    return min(slots, int(count.high)) if count.high is not None and 0 < count.high <= MAX_BITS else slots


def _auto(od: ObjectDictionary, pdo: Pdo) -> bool:
    """Whether bus.yml must set the COB-ID to `auto`: writable without limits (PDOs 1 to 4), or 0 in the EDS."""
    entry = od[pdo.communication, 1]
    if pdo.number > _PREDEFINED:
        return not (pdo.cob_id or 0) & 0x7FF
    return (entry.writable and entry.low is None and entry.high is None) or not (pdo.cob_id or 0) & 0x7FF


def _transmission(od: ObjectDictionary, pdo: Pdo, required: PdoRequirement) -> int | None:
    entry = od.get(pdo.communication, 2)
    if entry is None or not entry.writable or outside_limits(entry, required.transmission):
        return None
    return required.transmission
