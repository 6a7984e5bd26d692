"""Changing a PDO by SDO: the writes of a client in the order that strict devices demand, and a server's refusals.

The order (CiA 301, 7.5.2.36 and 7.5.2.38): invalidate the COB-ID, set the count to 0, write the entries, set the
count, write type and times while invalid, validate the COB-ID. Bit 30 (no RTR) stays as the device had it, since many
refuse to lose it. `PdoRules` is the same law seen from the server; both know only tables and never each other.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

from canopen_control.cia301.abort import AbortCode
from canopen_control.cia301.pdo import (
    DUMMY_TYPES,
    INVALID_BIT,
    MAX_BITS,
    NO_RTR_BIT,
    RTR_EVENT,
    RTR_SYNCHRONOUS,
    PdoParameters,
    is_reserved,
    mapping_entry,
    parse_mapping_entry,
)
from canopen_control.errors import LocalProtocolError

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Sequence

    from canopen_control.cia301.pdo import MappedObject

__all__ = [
    "MappingTarget",
    "PdoRules",
    "SdoWrite",
    "disable_writes",
    "is_restricted",
    "remap_checks",
    "remap_writes",
    "rpdo_indices",
    "tpdo_indices",
]

SdoWrite = tuple[int, int, bytes]  # index, subindex, data
MAX_PDOS = 512
MAX_ENTRIES = 64
COB_ID, TRANSMISSION_TYPE, INHIBIT_TIME, COMPATIBILITY, EVENT_TIMER, SYNC_START = range(1, 7)


def rpdo_indices(number: int) -> tuple[int, int]:
    """Return the indices of communication and mapping record of RPDO `number`, 1 to 512."""
    return _indices(0x1400, 0x1600, number)


def tpdo_indices(number: int) -> tuple[int, int]:
    """Return the indices of communication and mapping record of TPDO `number`, 1 to 512."""
    return _indices(0x1800, 0x1A00, number)


def _indices(communication: int, mapping: int, number: int) -> tuple[int, int]:
    if not 1 <= number <= MAX_PDOS:
        msg = f"PDO {number}: they are numbered 1 to {MAX_PDOS}"
        raise LocalProtocolError(msg)
    return communication + number - 1, mapping + number - 1


def disable_writes(communication: int, cob_id_value: int) -> list[SdoWrite]:
    """Return the write that invalidates a PDO whose COB-ID entry was read as `cob_id_value`."""
    return [(communication, COB_ID, (cob_id_value | INVALID_BIT).to_bytes(4, "little"))]


def remap_writes(
    indices: tuple[int, int],
    parameters: PdoParameters,
    mapping: Sequence[MappedObject] | None = None,
    *,
    present: int | None = None,
    subindices: Collection[int] | None = None,
) -> list[SdoWrite]:
    """Return the SDO writes that give a PDO `parameters` and, unless None, `mapping`.

    `indices` are those of its two records; `present` is its COB-ID entry as read, whose bit 30 is kept; `subindices`
    are those its communication record has: the type, inhibit time, event timer and SYNC start among them are written.
    Without it the type is, and of the others those that are not zero. LocalProtocolError for more than 64 bits.
    """
    communication, record = indices
    final = _final(parameters, present)
    before = final.cob_id_value() if present is None else present
    writes = disable_writes(communication, before)
    if mapping is not None:
        writes += _mapping_writes(record, mapping)
    for subindex, size, value in _settings(parameters):
        wanted = subindex == TRANSMISSION_TYPE or value if subindices is None else subindex in subindices
        if wanted:
            writes.append((communication, subindex, value.to_bytes(size, "little")))
    last = (communication, COB_ID, final.cob_id_value().to_bytes(4, "little"))
    return writes if writes == [last] else [*writes, last]


def remap_checks(
    indices: tuple[int, int],
    parameters: PdoParameters,
    mapping: Sequence[MappedObject] | None = None,
    *,
    present: int | None = None,
) -> list[SdoWrite]:
    """Return what a client must read back after `remap_writes`: index, subindex and the bytes they must hold."""
    communication, record = indices
    checks = [(communication, COB_ID, _final(parameters, present).cob_id_value().to_bytes(4, "little"))]
    if mapping is not None:
        checks += _mapping_writes(record, mapping)[1:]
    return checks


def _final(parameters: PdoParameters, present: int | None) -> PdoParameters:
    return parameters if present is None else replace(parameters, rtr_allowed=not present & NO_RTR_BIT)


def _mapping_writes(record: int, mapping: Sequence[MappedObject]) -> list[SdoWrite]:
    bits = sum(mapped.bits for mapped in mapping)
    if bits > MAX_BITS or len(mapping) > MAX_ENTRIES:
        msg = f"0x{record:04X}: a PDO holds {MAX_BITS} bits, the mapping has {bits}; leave out an object"
        raise LocalProtocolError(msg)
    entries = [
        (record, number, mapping_entry(mapped).to_bytes(4, "little")) for number, mapped in enumerate(mapping, 1)
    ]
    return [(record, 0, b"\0"), *entries, (record, 0, bytes((len(mapping),)))]


def _settings(parameters: PdoParameters) -> tuple[tuple[int, int, int], ...]:
    return (
        (TRANSMISSION_TYPE, 1, parameters.transmission_type),
        (INHIBIT_TIME, 2, parameters.inhibit_time_100us),
        (EVENT_TIMER, 2, parameters.event_timer_ms),
        (SYNC_START, 1, parameters.sync_start),
    )


# CiA 301, table 42: identifiers that no configurable object may take.
_RESTRICTED = ((0x000, 0x07F), (0x101, 0x180), (0x581, 0x5FF), (0x601, 0x67F), (0x6E0, 0x6FF), (0x701, 0x7FF))


def is_restricted(cob_id: int) -> bool:
    """Whether the standard keeps an 11-bit identifier for itself."""
    return any(low <= cob_id <= high for low, high in _RESTRICTED)


class MappingTarget(NamedTuple):
    """What the object dictionary says of an object that a mapping names."""

    bits: int
    rpdo_mappable: bool
    tpdo_mappable: bool


@dataclass(frozen=True, slots=True)
class PdoRules:
    """What a device accepts for one PDO; every check returns the abort code of a write, or None: accepted.

    `lookup` finds an object, or says why not (NO_OBJECT, NO_SUBINDEX). `partial`: objects may be mapped in part, as
    bit-granular devices allow. `wrong_state` is the refusal of mapping changes while the PDO is valid or its count is
    not 0; devices differ there.
    """

    is_tpdo: bool
    lookup: Callable[[int, int], MappingTarget | AbortCode]
    max_entries: int = MAX_ENTRIES
    rtr_supported: bool = True
    extended_supported: bool = False
    dummy_usage: frozenset[int] = frozenset()
    partial: bool = False
    wrong_state: AbortCode = AbortCode.INVALID_VALUE

    def check_communication(self, subindex: int, value: int, present: PdoParameters) -> AbortCode | None:
        """Judge a write to the communication record while it holds `present`."""
        if subindex == 0:
            return AbortCode.READ_ONLY
        if subindex == COB_ID:
            return self._check_cob_id(value, present)
        if subindex == TRANSMISSION_TYPE:
            return self._check_type(value, present)
        if subindex == INHIBIT_TIME:
            return _fixed_while_valid(value, present.inhibit_time_100us, present)
        if subindex == SYNC_START and self.is_tpdo:
            return AbortCode.INVALID_VALUE if value > 240 else _fixed_while_valid(value, present.sync_start, present)
        return None if subindex == EVENT_TIMER else AbortCode.NO_SUBINDEX

    def check_mapping_entry(self, subindex: int, value: int, present: PdoParameters, count: int) -> AbortCode | None:
        """Judge a write to subindex 1 and following of the mapping record while its count is `count`."""
        if not 1 <= subindex <= self.max_entries:
            return AbortCode.NO_SUBINDEX
        if present.enabled or count:
            return self.wrong_state
        return self._check_target(value) if value else None

    def check_mapping_count(self, value: int, entries: Sequence[int], present: PdoParameters) -> AbortCode | None:
        """Judge a write to subindex 0 of the mapping record whose subindices 1 and following hold `entries`."""
        if present.enabled:
            return self.wrong_state
        if value > MAX_ENTRIES:
            return AbortCode.INVALID_VALUE  # 254 and 255 would make it a multiplexed PDO
        if value > min(self.max_entries, len(entries)):
            return AbortCode.MAPPING_TOO_LONG
        mapped = entries[:value]
        for entry in mapped:
            refusal = self._check_target(entry)
            if refusal is not None:
                return refusal
        bits = sum(parse_mapping_entry(entry)[2] for entry in mapped)
        return AbortCode.MAPPING_TOO_LONG if bits > MAX_BITS else None

    def _check_cob_id(self, value: int, present: PdoParameters) -> AbortCode | None:
        new = PdoParameters.from_value(value, transmission_type=present.transmission_type)
        if (new.rtr_allowed and not self.rtr_supported) or (new.extended and not self.extended_supported):
            return AbortCode.INVALID_VALUE
        if not new.enabled:
            return None
        moved = (new.cob_id, new.extended) != (present.cob_id, present.extended)
        if (moved and present.enabled) or (not new.extended and is_restricted(new.cob_id)):
            return AbortCode.INVALID_VALUE
        return self._check_type(new.transmission_type, new)

    def _check_type(self, value: int, present: PdoParameters) -> AbortCode | None:
        on_remote = value in (RTR_SYNCHRONOUS, RTR_EVENT)
        if is_reserved(value) or (on_remote and not (self.is_tpdo and present.rtr_allowed)):
            return AbortCode.INVALID_VALUE
        return None

    def _check_target(self, value: int) -> AbortCode | None:
        index, subindex, bits = parse_mapping_entry(value)
        if index in DUMMY_TYPES:
            allowed = not self.is_tpdo and index in self.dummy_usage and subindex == 0
            return None if allowed and bits == DUMMY_TYPES[index].bits else AbortCode.NOT_MAPPABLE
        target = self.lookup(index, subindex)
        if isinstance(target, AbortCode):
            return target
        mappable = target.tpdo_mappable if self.is_tpdo else target.rpdo_mappable
        fits = 0 < bits < target.bits if self.partial and bits != target.bits else bits == target.bits
        return None if mappable and fits else AbortCode.NOT_MAPPABLE


def _fixed_while_valid(value: int, held: int, present: PdoParameters) -> AbortCode | None:
    return AbortCode.INVALID_VALUE if value != held and present.enabled else None
