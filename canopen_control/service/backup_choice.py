"""Which objects of a node a backup holds, which of them belong to one device alone, and which follow its node id.

An EDS does not say what is volatile. A parameter is what can be read and written (rw, rww, rwr) and is none of these:

- what ObjFlags say a tool shall not write or read (CiA 306-1, bits 0 and 1);
- commands and live values, by CiA 301, CiA 302 and CiA 402, or by the maker; outputs of the device's profile;
- counts of records and arrays, but for those of PDO mappings; DOMAINs.

Protected parameters are those of one device: node id and bit rate, and calibration to its own encoder.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Final

from canopen_control.cia402.objects import (
    DIGITAL_OUTPUTS,
    HOME_OFFSET,
    MODES_OF_OPERATION,
    MOTION,
    TOUCH_PROBE_FUNCTION,
    axis_of,
)
from canopen_control.frame import is_restricted
from canopen_control.od.model import SCALAR_CODES, DataType
from canopen_control.od.pdos import COUNT, MAPPING, is_cob_id
from canopen_control.profiles.device_type import profile_of
from canopen_control.profiles.profile_tables import profile_signals

if TYPE_CHECKING:
    from collections.abc import Mapping

    from canopen_control.od.model import Address, Entry, ObjectDictionary, Value

__all__ = ["follows_node_id", "parameters_of", "protection_of", "without_unused_slots"]

_MAPPINGS: Final = tuple(range(first, first + COUNT) for first in MAPPING.values())
_MOST_MAPPED: Final = 64  # above it a count stands for an MPDO
_NO_TRANSFER: Final = 0b11  # of ObjFlags: refuse the write of a download, the read of a scan
_COMMANDS: Final = frozenset((0x1003, 0x1010, 0x1011, 0x1013, *range(0x1023, 0x1027), 0x1F25, 0x1F82, 0x1F83))
_PROGRAM: Final = range(0x1F50, 0x1F59)  # CiA 302-3
_DRIVE_COMMANDS: Final = (MOTION | {TOUCH_PROBE_FUNCTION}) - {MODES_OF_OPERATION}
_VENDOR_COMMANDS: Final = {
    0x286: frozenset((0x210B, 0x2700, 0x2701)),  # Trinamic: position of the motion controller, store and restore
}
_OWN_TO_THE_DEVICE: Final = {HOME_OFFSET: "is calibrated to the encoder of its own drive"}
_VENDOR_OWN: Final = {0x286: dict.fromkeys((0x2704, 0x2705, 0x2706), "is the node id or the bit rate")}
_MANUFACTURER: Final = range(0x2000, 0x6000)
_OWN_NAMES: Final = re.compile(r"node[ _-]?id\b|baud|bit[ _-]?rate|serial[ _-]?(number|no\b|nr\b)", re.IGNORECASE)
_EMCY: Final = (0x1014, 0)
_NODE_BITS: Final = 0x7F  # of an identifier of the predefined connection set
_IDENTIFIER: Final = 0x1FFF_FFFF


def parameters_of(od: ObjectDictionary) -> list[Entry]:
    """Return what a backup of a node with this dictionary holds, by address."""
    signals = profile_signals(od, profile_of(od)).values()
    outputs = frozenset(signal.index for signal in signals if signal.output)
    commands = outputs | _VENDOR_COMMANDS.get(_vendor(od), frozenset())
    chosen = (entry for entry in od if _can_be_kept(od, entry) and not _is_command(entry, commands))
    return sorted(chosen, key=lambda entry: entry.address)


def protection_of(od: ObjectDictionary, entry: Entry, *, same_device: bool = False) -> str:
    """Return why a parameter stays as it is, "" where it does not; a calibration is written into its own device."""
    index = axis_of(entry.index)[0]
    own = _VENDOR_OWN.get(_vendor(od), {}).get(index, "")
    if not own and not same_device:
        own = _OWN_TO_THE_DEVICE.get(index, "")
    info = od.objects.get(entry.index)
    names = f"{entry.name}\n{info.name if info is not None else ''}"
    if not own and index in _MANUFACTURER and _OWN_NAMES.search(names):
        return "is named as node id, bit rate or serial number"
    return own


def without_unused_slots(values: Mapping[Address, Value]) -> dict[Address, Value]:
    """Return the values without mapping entries above the count of their PDO: what stands there means nothing."""
    kept = {}
    for (index, subindex), value in values.items():
        count = values.get((index, 0)) if any(index in records for records in _MAPPINGS) else None
        if not (isinstance(count, int) and count <= _MOST_MAPPED and subindex > count):
            kept[index, subindex] = value
    return kept


def follows_node_id(entry: Entry, value: Value, node_id: int) -> bool:
    """Whether a value of the node `node_id` is made of that id, so that another node has it with its own.

    True for what the file writes with $NODEID, and for identifiers of the predefined connection set that end in it.
    """
    if not isinstance(value, int) or entry.data_type is not DataType.UNSIGNED32:
        return False
    if entry.relative and isinstance(entry.default, int) and not (value - entry.default) & _IDENTIFIER:
        return True
    of_messages = is_cob_id(*entry.address) or entry.address == _EMCY
    identifier = value & _IDENTIFIER
    is_own = identifier & _NODE_BITS == node_id and 0x80 < identifier < 0x600
    return of_messages and is_own and (entry.address == _EMCY or not is_restricted(identifier))


def _can_be_kept(od: ObjectDictionary, entry: Entry) -> bool:
    if not (entry.readable and entry.writable) or entry.data_type is DataType.DOMAIN or entry.obj_flags & _NO_TRANSFER:
        return False
    info = od.objects.get(entry.index)
    is_count = entry.subindex == 0 and (info is None or info.code not in SCALAR_CODES)
    return not is_count or any(entry.index in records for records in _MAPPINGS)


def _is_command(entry: Entry, commands: frozenset[int]) -> bool:
    index, _ = axis_of(entry.index)
    if entry.index in _COMMANDS or entry.index in _PROGRAM or entry.index in commands or index in _DRIVE_COMMANDS:
        return True
    return (index, entry.subindex) == (DIGITAL_OUTPUTS, 1)


def _vendor(od: ObjectDictionary) -> int:
    entry = od.get(0x1018, 1)
    value = entry.value if entry is not None and entry.value is not None else od.device.vendor_number
    return value if isinstance(value, int) else 0
