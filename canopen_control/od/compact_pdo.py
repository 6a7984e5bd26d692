"""The PDO records that an EDS leaves out with CompactPDO (CiA 306-1, 4.5).

Bit k of CompactPDO says that every PDO has subindex k + 1 of the communication parameter; NrOfRXPDO and NrOfTXPDO
say how many PDOs there are. What the file describes by itself stays as it is.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from canopen_control.od.model import DataType, Entry, ObjectCode, ObjectInfo
from canopen_control.od.pdos import INVALID

if TYPE_CHECKING:
    from canopen_control.od.issues import Report
    from canopen_control.od.model import ObjectDictionary

__all__ = ["expand_compact_pdos"]

_HIGHEST = 512  # PDOs of each direction
_SLOTS = 64
_PREDEFINED = 4  # PDOs with a COB-ID in the predefined connection set
_COMMUNICATION = (  # subindex 1 to 6: name, type, default (the COB-ID's depends on the PDO)
    ("COB-ID", DataType.UNSIGNED32, 0),
    ("Transmission type", DataType.UNSIGNED8, 255),
    ("Inhibit time", DataType.UNSIGNED16, 0),
    ("Reserved", DataType.UNSIGNED8, 0),
    ("Event timer", DataType.UNSIGNED16, 0),
    ("SYNC start value", DataType.UNSIGNED8, 0),
)


class _Direction(NamedTuple):
    name: str
    communication: int
    mapping: int
    cob_id: int  # of the first one, without the node id


_RPDO = _Direction("RPDO", 0x1400, 0x1600, 0x200)
_TPDO = _Direction("TPDO", 0x1800, 0x1A00, 0x180)


def expand_compact_pdos(od: ObjectDictionary, report: Report) -> None:
    """Add to `od` the records that CompactPDO stands for."""
    mask = od.device.compact_pdo & 0x3F
    if not mask:
        return
    before = len(od.objects)
    for direction, count in ((_RPDO, od.device.rpdo_count), (_TPDO, od.device.tpdo_count)):
        if not 0 <= count <= _HIGHEST:
            report.warning(
                0, "compact-count", f"there cannot be {count} {direction.name}s; {_HIGHEST} at most are made"
            )
        for offset in range(min(max(count, 0), _HIGHEST)):
            _add_communication(od, direction, offset, mask)
            _add_mapping(od, direction, offset)
    made = len(od.objects) - before
    if made:
        report.note(0, "compact-pdo", f"CompactPDO stands for {made} PDO records that have no section; they were made")


def _add_communication(od: ObjectDictionary, direction: _Direction, offset: int, mask: int) -> None:
    index = direction.communication + offset
    if index in od.objects:
        return
    name = f"{direction.name}{offset + 1} communication parameter"
    od.objects[index] = ObjectInfo(index, name, ObjectCode.RECORD)
    _add_sub0(od, index, mask.bit_length(), "const")
    for subindex, (label, data_type, default) in enumerate(_COMMUNICATION, 1):
        if mask >> (subindex - 1) & 1:
            entry = Entry(index, subindex, label, data_type, "rw", default=default)
            od.entries[index, subindex] = entry if subindex > 1 else _cob_id(od, direction, offset, entry)


def _cob_id(od: ObjectDictionary, direction: _Direction, offset: int, model: Entry) -> Entry:
    predefined = offset < _PREDEFINED
    default = direction.cob_id + 0x100 * offset + (od.node_id or 0) if predefined else INVALID
    return Entry(model.index, model.subindex, model.name, model.data_type, "rw", default=default, relative=predefined)


def _add_mapping(od: ObjectDictionary, direction: _Direction, offset: int) -> None:
    index = direction.mapping + offset
    if index in od.objects:
        return
    od.objects[index] = ObjectInfo(index, f"{direction.name}{offset + 1} mapping parameter", ObjectCode.RECORD)
    _add_sub0(od, index, 0, "rw")
    for subindex in range(1, _SLOTS + 1):
        name = f"Mapped object {subindex}"
        od.entries[index, subindex] = Entry(index, subindex, name, DataType.UNSIGNED32, "rw", default=0)


def _add_sub0(od: ObjectDictionary, index: int, count: int, access: str) -> None:
    od.entries[index, 0] = Entry(index, 0, "Highest sub-index supported", DataType.UNSIGNED8, access, default=count)
