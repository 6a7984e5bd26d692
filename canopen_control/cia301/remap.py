"""Rules for changing a PDO of a device by SDO (CiA 301, 7.5.2.36 and 7.5.2.38).

Mapping and times can be changed only while the PDO is invalid, in this order: set bit 31 of the COB-ID, set the
number of mapped objects to 0, write the mapping entries, set the number, write the times, clear bit 31. A write out of
this order is refused.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from canopen_control.cia301.abort import AbortCode
from canopen_control.cia301.pdo import (
    DUMMY_TYPES,
    INVALID_BIT,
    MAX_BITS,
    RTR_EVENT,
    RTR_SYNCHRONOUS,
    PdoParameters,
    is_reserved,
    parse_mapping_entry,
)
from canopen_control.frame import is_restricted

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence


MAX_ENTRIES = 64
COB_ID, TRANSMISSION_TYPE, INHIBIT_TIME, COMPATIBILITY, EVENT_TIMER, SYNC_START = range(1, 7)


class MappingTarget(NamedTuple):
    """Attributes of an object that a mapping entry refers to."""

    bits: int
    rpdo_mappable: bool
    tpdo_mappable: bool


@dataclass(frozen=True, slots=True)
class PdoRules:
    """Checks of SDO writes to the parameters of one PDO; each returns the abort code, or None if accepted.

    `rtr_supported` concerns bit 30 of a TPDO's COB-ID, "no RTR allowed" (CiA 301, 7.5.2.37): a device that does not
    answer remote frames may require it. In an RPDO the bit is reserved, "do not care" (7.5.2.35): the bit is stored as
    written and ignored.

    `lookup` returns the attributes of an object or the reason why it cannot be mapped (NO_OBJECT, NO_SUBINDEX).
    `partial` permits the mapping of single bits of an object. `in_use` returns whether another service of the device
    uses a CAN identifier; some devices do not check. `wrong_state` is the abort code of a mapping change while the PDO
    is valid or its number of objects is not 0; it differs between devices.
    """

    is_tpdo: bool
    lookup: Callable[[int, int], MappingTarget | AbortCode]
    max_entries: int = MAX_ENTRIES
    rtr_supported: bool = True
    extended_supported: bool = False
    dummy_usage: frozenset[int] = frozenset()
    partial: bool = False
    in_use: Callable[[int], bool] = lambda _cob_id: False
    wrong_state: AbortCode = AbortCode.INVALID_VALUE

    def check_communication(self, subindex: int, value: int, present: PdoParameters) -> AbortCode | None:
        """Check a write to a communication parameter; `present` contains the current values."""
        # CiA 301, 7.5.2.35 and 7.5.2.37: the highest subindex is constant
        if subindex == 0:
            return AbortCode.READ_ONLY
        if subindex == COB_ID:
            return self._check_cob_id(value, present)
        if subindex == TRANSMISSION_TYPE:
            return self._check_type(value, present)
        # CiA 301, 7.5.2.37: inhibit time and SYNC start value must not change while the PDO is valid
        if subindex == INHIBIT_TIME:
            return _fixed_while_valid(value, present.inhibit_time_100us, present)
        # CiA 301, 7.5.2.37: SYNC start value 0 to 240, for TPDOs only
        if subindex == SYNC_START and self.is_tpdo:
            return AbortCode.INVALID_VALUE if value > 240 else _fixed_while_valid(value, present.sync_start, present)
        return None if subindex == EVENT_TIMER else AbortCode.NO_SUBINDEX

    def check_mapping_entry(self, subindex: int, value: int, present: PdoParameters, count: int) -> AbortCode | None:
        """Check a write to a mapping entry (subindex 1 and above) while the number of mapped objects is `count`."""
        if not 1 <= subindex <= self.max_entries:
            return AbortCode.NO_SUBINDEX
        # CiA 301, 7.5.2.36 and 7.5.2.38: entries are written while the PDO is invalid and its number of objects 0
        if present.enabled or count:
            return self.wrong_state
        return self._check_target(value) if value else None

    def check_mapping_count(self, value: int, entries: Sequence[int], present: PdoParameters) -> AbortCode | None:
        """Check a write to the number of mapped objects; `entries` are the current mapping entries."""
        # CiA 301, 7.5.2.36 and 7.5.2.38: the number of objects is written while the PDO is invalid
        if present.enabled:
            return self.wrong_state
        if value > MAX_ENTRIES:
            return AbortCode.INVALID_VALUE  # 254 and 255 would make it a multiplexed PDO (CiA 301, 7.5.2.36)
        # CiA 301, table 22: 0x06040042, number and length of the objects would exceed the PDO length
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
        without_rtr = self.is_tpdo and not self.rtr_supported
        # CiA 301, 7.5.2.37: bit 30 is "no RTR allowed", bit 29 selects a 29-bit identifier
        if (new.rtr_allowed and without_rtr) or (new.extended and not self.extended_supported):
            return AbortCode.INVALID_VALUE
        # CiA 301, 7.5.2.35 and 7.5.2.37: bit 31 makes the PDO invalid, at any time
        if value & INVALID_BIT:
            return None
        # CiA 301, 7.5.2.35 and 7.5.2.37: bits 0 to 29 must not change while the PDO is valid
        moved = (new.cob_id, new.extended) != (present.cob_id, present.extended)
        # CiA 301, 7.3.5: restricted identifiers
        in_use = not new.extended and (is_restricted(new.cob_id) or self.in_use(new.cob_id))
        if (moved and present.enabled) or in_use:
            return AbortCode.INVALID_VALUE
        return self._check_type(new.transmission_type, new)

    def _check_type(self, value: int, present: PdoParameters) -> AbortCode | None:
        # CiA 301, 7.5.2.35 and 7.5.2.37: 241 to 251 are reserved, 252 and 253 exist only for TPDOs
        on_remote = value in (RTR_SYNCHRONOUS, RTR_EVENT)
        if is_reserved(value) or (on_remote and not (self.is_tpdo and present.rtr_allowed)):
            return AbortCode.INVALID_VALUE
        return None

    def _check_target(self, value: int) -> AbortCode | None:
        index, subindex, bits = parse_mapping_entry(value)
        # CiA 301, 7.4.1.2: dummy entries exist only in RPDOs, as CiA 306's [DummyUsage] allows
        if index in DUMMY_TYPES:
            allowed = not self.is_tpdo and index in self.dummy_usage and subindex == 0
            return None if allowed and bits == DUMMY_TYPES[index].bits else AbortCode.NOT_MAPPABLE
        target = self.lookup(index, subindex)
        if isinstance(target, AbortCode):
            return target
        # CiA 301, table 22: 0x06040041, the object cannot be mapped
        mappable = target.tpdo_mappable if self.is_tpdo else target.rpdo_mappable
        fits = 0 < bits < target.bits if self.partial and bits != target.bits else bits == target.bits
        return None if mappable and fits else AbortCode.NOT_MAPPABLE


def _fixed_while_valid(value: int, current: int, present: PdoParameters) -> AbortCode | None:
    return AbortCode.INVALID_VALUE if value != current and present.enabled else None
