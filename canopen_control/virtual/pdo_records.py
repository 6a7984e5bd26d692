"""The PDO records of a node, 0x1400 to 0x1BFF: the rules of writing them, and what they say.

What the rules forbid is an abort code (CiA 301, 7.5.2.35 to 7.5.2.38); a record that names what does not exist, or
cannot be, maps nothing. A CAN identifier has one user in the node: the services come first, then the RPDOs and the
TPDOs by their number; a record with an identifier that another one has, or with none that a PDO may have, is off.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from canopen_control.cia301.abort import AbortCode
from canopen_control.cia301.pdo import (
    DUMMY_TYPES,
    INVALID_BIT,
    MappedObject,
    PdoCodec,
    PdoParameters,
    dummy,
    parse_mapping_entry,
)
from canopen_control.cia301.remap import MappingTarget, PdoRules
from canopen_control.errors import LocalProtocolError
from canopen_control.virtual.object_store import refuse

if TYPE_CHECKING:
    from canopen_control.od.model import Entry, Value
    from canopen_control.virtual.object_store import Guard, ObjectStore

__all__ = ["RPDO", "TPDO", "PdoRecords", "mapping_of"]

RPDO, TPDO = 0x1400, 0x1800
_SYNC, _EMCY = 0x1005, 0x1014


def mapping_of(communication: int) -> int:
    """Return the index of the mapping record that belongs to a communication record."""
    return communication + 0x200


class PdoRecords:
    """The records in `store`; `rtr_supported` false: the COB-IDs of TPDOs must keep bit 30."""

    def __init__(self, store: ObjectStore, *, rtr_supported: bool) -> None:
        self._store, self._rtr_supported = store, rtr_supported
        self._communication = [base + number for base in (RPDO, TPDO) for number in self.numbers(base)]

    def numbers(self, base: int) -> list[int]:
        """Return the numbers, from 0, of the RPDOs (`base` 0x1400) or TPDOs (0x1800) that the dictionary has."""
        return sorted({entry.index - base for entry in self._store.od if base <= entry.index < base + 512})

    def guard(self, base: int, communication: int) -> None:
        """Guard a communication record and its mapping record."""
        mapping = mapping_of(communication)
        rules = self._rules(base, mapping)
        self._store.guard([communication], self._communication_guard(rules))
        self._store.guard([mapping], self._mapping_guard(rules, communication))

    def _rules(self, base: int, mapping: int) -> PdoRules:
        od, communication = self._store.od, mapping - 0x200
        return PdoRules(
            is_tpdo=base == TPDO,
            lookup=self._lookup,
            max_entries=max([sub for sub in od.subindices(mapping) if sub], default=0),
            rtr_supported=self._rtr_supported,
            dummy_usage=od.dummy_usage,
            partial=od.device.granularity not in (0, 8),
            in_use=lambda cob_id: self._users().get(cob_id, communication) != communication,
        )

    def _lookup(self, index: int, subindex: int) -> MappingTarget | AbortCode:
        entry = self._store.od.get(index, subindex)
        if entry is None:
            known = self._store.od.subindices(index)
            return AbortCode.NO_SUBINDEX if known else AbortCode.NO_OBJECT
        return MappingTarget(entry.data_type.bits or 0, entry.rpdo_mappable, entry.tpdo_mappable)

    def _communication_guard(self, rules: PdoRules) -> Guard:
        def judge(entry: Entry, value: Value) -> Value:
            present = self.parameters(entry.index)
            refuse(rules.check_communication(entry.subindex, int(value), present))
            return value

        return judge

    def _mapping_guard(self, rules: PdoRules, communication: int) -> Guard:
        def judge(entry: Entry, value: Value) -> Value:
            present, count = self.parameters(communication), self._store.number(entry.index)
            if entry.subindex:
                refuse(rules.check_mapping_entry(entry.subindex, int(value), present, count))
            else:
                entries = [self._store.number(entry.index, sub) for sub in range(1, rules.max_entries + 1)]
                refuse(rules.check_mapping_count(int(value), entries, present))
            return value

        return judge

    def _users(self) -> dict[int, int]:
        """Return which record has an 11-bit identifier, by its index: 0x1005 and 0x1014, else the first PDO."""
        store = self._store
        users: dict[int, int] = {}
        for index, default in ((_SYNC, 0x80), (_EMCY, INVALID_BIT)):
            value = store.number(index, 0, default)
            if index == _SYNC or not value & INVALID_BIT:
                users.setdefault(value & 0x7FF, index)
        for index in self._communication:
            own = PdoParameters.from_value(store.number(index, 1, INVALID_BIT))
            if own.enabled and not own.extended:
                users.setdefault(own.cob_id, index)
        return users

    def is_valid(self, communication: int) -> bool:
        """Whether a communication record says that its PDO is there."""
        return not self._store.number(communication, 1, INVALID_BIT) & INVALID_BIT

    def parameters(self, communication: int) -> PdoParameters:
        """Return what a communication record says."""
        number = self._store.number
        found = PdoParameters.from_value(
            number(communication, 1, INVALID_BIT),
            transmission_type=number(communication, 2, 255),
            inhibit_time_100us=number(communication, 3),
            event_timer_ms=number(communication, 5),
            sync_start=number(communication, 6),
        )
        taken = found.enabled and not found.extended and self._users().get(found.cob_id) != communication
        return replace(found, enabled=False) if taken else found

    def _mapping(self, record: int) -> list[tuple[MappedObject, Entry | None]]:
        """Return the mapped objects; a record that names what does not exist maps nothing."""
        objects: list[tuple[MappedObject, Entry | None]] = []
        for sub in range(1, min(64, self._store.number(record)) + 1):
            index, subindex, bits = parse_mapping_entry(self._store.number(record, sub))
            entry = self._store.od.get(index, subindex)
            if index in DUMMY_TYPES:
                objects.append((dummy(DUMMY_TYPES[index]), None))
            elif entry is not None:
                objects.append((MappedObject(index, subindex, bits, entry.data_type), entry))
            else:
                return []
        return objects

    def codec(self, record: int) -> tuple[PdoCodec, tuple[Entry | None, ...]]:
        """Return the codec of a mapping record, and the mapped entries; None: a gap."""
        objects = self._mapping(record)
        try:
            return PdoCodec([mapped for mapped, _ in objects]), tuple(entry for _, entry in objects)
        except LocalProtocolError:  # a default mapping that cannot be
            return PdoCodec(()), ()
