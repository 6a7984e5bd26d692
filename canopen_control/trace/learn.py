"""The PDOs of a node as its SDO transfers tell them (CiA 301, 7.5.2.35 to 38): who listens to a boot knows the layout.

The law of this file: only what the node holds counts, that is what it answered or confirmed. A PDO is known when it is
valid, and the number of its objects and each of them was heard, or is known from the description. Bounded: `LIMIT`
values of one node.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from canopen_control.cia301.pdo import INVALID_BIT, MAX_BITS, mapping_entry, parse_mapping_entry
from canopen_control.cia402 import objects
from canopen_control.frame import EXTENDED_FLAG, can_id_of, is_restricted
from canopen_control.od.profile402 import TYPES
from canopen_control.trace.network_description import PdoDescription, PdoObject, address_text, type_of

if TYPE_CHECKING:
    from canopen_control.od.model import DataType
    from canopen_control.trace.network_description import NodeDescription
    from canopen_control.trace.values import NodeWords, SignalValue

__all__ = ["LIMIT", "LearnedPdos"]

LIMIT: Final = 4096
_COUNT: Final = 512  # PDOs of one direction
_FIRST: Final = {"rpdo": (0x1400, 0x1600), "tpdo": (0x1800, 0x1A00)}  # communication, mapping
_COB_ID, _TYPE, _EVENT_DRIVEN = 1, 2, 255
_MOST_OBJECTS: Final = 64


class LearnedPdos:
    """What is known of one node's PDO records."""

    def __init__(self, node: NodeDescription, words: NodeWords) -> None:
        self._node, self._words = node, words
        self._held: dict[tuple[int, int], int] = {}
        self._cob_ids: dict[tuple[str, int], int] = {}
        for pdo in node.pdos:
            self._take(pdo)

    def _take(self, pdo: PdoDescription) -> None:
        communication, mapping = _records(pdo.direction, pdo.number)
        self._cob_ids[pdo.direction, pdo.number] = pdo.cob_id
        self._held[communication, _TYPE] = pdo.transmission_type
        self._held[mapping, 0] = len(pdo.objects)
        for slot, each in enumerate(pdo.objects, 1):
            self._held[mapping, slot] = mapping_entry(each.mapped)

    def learn(self, held: SignalValue) -> tuple[PdoDescription, int | None] | None:
        """Take a value that the node holds; return a PDO that is known now with its former can_id, or None."""
        which = _pdo_of(held.index)
        if which is None or not isinstance(held.value, int):
            return None
        address = held.index, held.subindex
        if address not in self._held and len(self._held) >= LIMIT:
            return None
        self._held[address] = held.value
        pdo = self._known(*which)
        if pdo is None:
            return None
        before, self._cob_ids[which] = self._cob_ids.get(which), pdo.cob_id
        return pdo, before

    def _known(self, direction: str, number: int) -> PdoDescription | None:
        communication, mapping = _records(direction, number)
        entry = self._held.get((communication, _COB_ID))
        count = self._held.get((mapping, 0), 0)
        can_id = self._cob_ids.get((direction, number)) if entry is None else can_id_of(entry)
        if can_id is None or (entry is not None and entry & INVALID_BIT) or not 0 < count <= _MOST_OBJECTS:
            return None
        slots = [self._held.get((mapping, slot)) for slot in range(1, count + 1)]
        mapped = tuple(self._object(slot) for slot in slots if slot)
        forbidden = not can_id & EXTENDED_FLAG and is_restricted(can_id)
        if forbidden or len(mapped) != count or sum(each.bits for each in mapped) > MAX_BITS:
            return None
        transmission = self._held.get((communication, _TYPE), _EVENT_DRIVEN)
        return PdoDescription(can_id, direction, number, mapped, transmission)

    def _object(self, entry: int) -> PdoObject:
        index, subindex, bits = parse_mapping_entry(entry)
        name = self._words.name(index, subindex) or address_text(index, subindex)
        return PdoObject(index, subindex, bits, self._type(index, subindex, bits), name)

    def _type(self, index: int, subindex: int, bits: int) -> DataType:
        """Return the type by the EDS, else by the drive profile, else by the width."""
        in_eds = self._node.od is not None and (index, subindex) in self._node.od
        profile = TYPES.get((objects.axis_of(index)[0], subindex), ()) if self._node.is_drive else ()
        by_profile = next((each for each in profile if each.bits == bits), None)
        return by_profile if by_profile is not None and not in_eds else type_of(self._node.od, index, subindex, bits)


def _records(direction: str, number: int) -> tuple[int, int]:
    communication, mapping = _FIRST[direction]
    return communication + number - 1, mapping + number - 1


def _pdo_of(index: int) -> tuple[str, int] | None:
    for direction, firsts in _FIRST.items():
        for first in firsts:
            if first <= index < first + _COUNT:
                return direction, index - first + 1
    return None
