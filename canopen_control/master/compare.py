"""Compares a plan with what a node holds: what differs, and what has to be written.

The writes of one PDO belong together (`groups`), everything else stands alone. Bit 30 of a PDO's
COB-ID is the device's own and never a difference; of a PDO that is to be invalid nothing but bit 31 counts. What was
planned and what is held are compared as values of the object's type, so that a drive that answers with more bytes than
the EDS says is not written for ever.
"""

from __future__ import annotations

from itertools import groupby
from typing import TYPE_CHECKING

from canopen_control.cia301.pdo import INVALID_BIT, NO_RTR_BIT
from canopen_control.master.plan_pdos import COMMUNICATION
from canopen_control.od.model import DataType

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from canopen_control.master.plan_builder import PlannedWrite

__all__ = ["cob_id_of", "final_values", "groups", "is_cob_id", "keep_rtr_bit", "matches", "needed", "reads_of"]

_TEXT = (DataType.VISIBLE_STRING, DataType.UNICODE_STRING)
_COB_ID = 1  # subindex of a communication record


def groups(writes: Sequence[PlannedWrite]) -> list[list[PlannedWrite]]:
    """Return the writes in order, those of one PDO in one list, each other in a list of its own."""
    found: list[list[PlannedWrite]] = []
    for pdo, each in groupby(writes, key=lambda write: write.pdo):
        members = list(each)
        found += [members] if pdo is not None else [[write] for write in members]
    return found


def is_cob_id(write: PlannedWrite) -> bool:
    """Whether the write is to the COB-ID of a PDO."""
    return write.pdo is not None and write.index == cob_id_of(write.pdo) and write.subindex == _COB_ID


def cob_id_of(pdo: tuple[str, int]) -> int:
    """Return the index of a PDO's communication record."""
    return COMMUNICATION[pdo[0]] + pdo[1] - 1


def final_values(group: Sequence[PlannedWrite]) -> dict[tuple[int, int], PlannedWrite]:
    """Return the last write of each address: what the node holds in the end."""
    return {write.address: write for write in group}


def reads_of(group: Sequence[PlannedWrite]) -> list[tuple[int, int]]:
    """Return the addresses to be read before the group is written; none where reading tells nothing."""
    return [address for address, write in final_values(group).items() if write.compare]


def keep_rtr_bit(planned: bytes, held: bytes | None) -> bytes:
    """Return a COB-ID with bit 30 as the device has it."""
    if held is None or len(held) != len(planned):
        return planned
    value, own = int.from_bytes(planned, "little"), int.from_bytes(held, "little")
    return (value & ~NO_RTR_BIT | own & NO_RTR_BIT).to_bytes(len(planned), "little")


def matches(write: PlannedWrite, held: bytes | None) -> bool:
    """Whether the node holds what the write would give it."""
    if held is None:
        return False
    if is_cob_id(write):
        planned, own = int.from_bytes(write.data, "little"), int.from_bytes(held, "little")
        if planned & INVALID_BIT:
            return bool(own & INVALID_BIT)
        return planned & ~NO_RTR_BIT == own & ~NO_RTR_BIT
    if held == write.data:
        return True
    if write.data_type in _TEXT:
        return held.rstrip(b"\0") == write.data.rstrip(b"\0")
    if write.data_type is None or not write.data_type.is_integer:
        return False
    signed = write.data_type.signed
    return int.from_bytes(held, "little", signed=signed) == int.from_bytes(write.data, "little", signed=signed)


def needed(group: Sequence[PlannedWrite], held: Mapping[tuple[int, int], bytes | None]) -> list[PlannedWrite]:
    """Return the writes of a group that a node which holds `held` needs, in order; none where nothing differs."""
    final = final_values(group)
    different = {
        address for address, write in final.items() if not write.compare or not matches(write, held.get(address))
    }
    if not different:
        return []
    if group[0].pdo is None:
        return list(group)
    communication = cob_id_of(group[0].pdo)
    mapping = any(index != communication for index, _ in different)
    return [write for write in group if _is_needed(write, communication, mapping, different, held)]


def _is_needed(
    write: PlannedWrite,
    communication: int,
    remap: bool,
    different: set[tuple[int, int]],
    held: Mapping[tuple[int, int], bytes | None],
) -> bool:
    """Whether one write of a PDO is needed: invalid first unless it is, then what differs, then valid."""
    if write.index != communication:
        return remap  # a mapping is written as a whole: count 0, entries, count
    if write.subindex != _COB_ID:
        return write.address in different
    if write.data[-1] & INVALID_BIT >> 24:
        present = held.get(write.address)
        return present is None or not present[-1:] or not present[-1] & INVALID_BIT >> 24
    return True
