"""Builder of a node's plan: encodes the SDO writes and reports errors.

A write is encoded once, in the data type of the object in the EDS; all steps of the boot use the same bytes. An object
that can be read back is compared before it is written and verified afterwards. Objects without read access, the
signatures of 0x1010 and 0x1011, and objects that are written several times with different values (such a sequence is a
procedure) are always written.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Final

from canopen_control.od.codec import encode, outside_limits
from canopen_control.od.model import DataType
from canopen_control.od.pdos import COMMUNICATION, pdo_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from canopen_control.cia301.pdo import MappedObject
    from canopen_control.master.keys import NodeConfig, SdoEntry
    from canopen_control.od.model import ObjectDictionary, Value


STORED = "as in the EDS, but the device may have stored another value"
"""Reason of a write that has no effect if the device has the values of its EDS."""
_PROCEDURES = frozenset((0x1010, 0x1011))  # objects that do not return the written value
_BYTES = frozenset((DataType.OCTET_STRING, DataType.DOMAIN))
_WHOLE = re.compile(r"\s*[-+]?[0-9]{1,20}\s*", re.ASCII)
_HEX = re.compile(r"\s*[-+]?0[xX][0-9A-Fa-f]{1,16}\s*", re.ASCII)


UNKNOWN: Final = "not in the EDS"
"""Name of a planned write to an object that is not in the EDS."""


@dataclass(frozen=True, slots=True)
class PlannedWrite:
    """SDO download of a plan; `reason` is "" if bus.yml requests it; the node may refuse an `optional` write.

    `pdo` is kind and number of the PDO to whose records the object belongs. `compare` is set if the object can be read
    back. `fixed` is set for a COB-ID that is read-only in the EDS and has this value there: such a COB-ID is written
    only if the node has another one.
    """

    index: int
    subindex: int
    data: bytes
    name: str
    reason: str = ""
    optional: bool = False
    pdo: tuple[str, int] | None = None
    compare: bool = True
    data_type: DataType | None = None
    fixed: bool = False

    @property
    def address(self) -> tuple[int, int]:
        """Address of the object, as (index, subindex)."""
        return self.index, self.subindex

    @property
    def label(self) -> str:
        """Name and address, for messages."""
        place = f"0x{self.index:04X}:{self.subindex:02X}"
        return f"object {place} ({UNKNOWN})" if self.name == UNKNOWN else f"{self.name} {place}"


@dataclass(frozen=True, slots=True)
class PlannedPdo:
    """Enabled PDO with COB-ID and mapped objects in order; `event_ms` is the event timer in ms, 0 for none."""

    number: int
    cob_id: int
    transmission_type: int
    objects: tuple[MappedObject, ...]
    event_ms: int = 0


@dataclass(slots=True)
class PlanBuilder:
    """Builder of a node's plan; `complain(key, text)` receives errors and `warn(key, text)` warnings.

    `note` receives keys without effect, `remark` further information. Building continues after an error.
    """

    node: NodeConfig
    od: ObjectDictionary
    complain: Callable[[str, str], None]
    warn: Callable[[str, str], None]
    note: Callable[[str, str], None]
    spare_cob_ids: Iterator[int]
    downloads: tuple[tuple[int, int, bytes], ...] = ()
    remark: Callable[[str, str], None] = lambda _key, _text: None
    writes: list[PlannedWrite] = field(default_factory=list)
    reads: list[MappedObject] = field(default_factory=list)
    layouts: dict[str, list[PlannedPdo]] = field(default_factory=lambda: {"rpdo": [], "tpdo": []})
    _downloaded: dict[tuple[int, int], bytes] = field(init=False)
    _records: dict[tuple[str, int], dict[tuple[int, int], tuple[int, bytes]]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        sdo = [_with_numbers(entry, self.od) for entry in self.node.boot.sdo]
        self.node = replace(self.node, boot=replace(self.node.boot, sdo=sdo))
        self._downloaded = {(index, subindex): data for index, subindex, data in self.downloads}
        for place, write in enumerate(self.node.boot.sdo):
            pdo, entry = pdo_of(write.index), self.od.get(write.index, write.sub_index)
            if pdo is None or entry is None:
                continue  # objects missing from the EDS are reported when the list is planned
            try:
                data = encode(_encodable(write.value, entry.data_type), entry.data_type)
            except ValueError as error:
                self.complain(f"sdo[{place}]", f"0x{write.index:04X}:{write.sub_index:02X} {entry.name}: {error}")
                continue
            self._records.setdefault(pdo, {})[write.index, write.sub_index] = place, data
            self._downloaded[write.index, write.sub_index] = data

    def listed_pdos(self, kind: str) -> set[int]:
        """Return the numbers of the PDOs of a kind whose records the `sdo:` list of bus.yml writes."""
        return {number for which, number in self._records if which == kind}

    def listed_records(self, kind: str, number: int) -> dict[tuple[int, int], tuple[int, bytes]]:
        """Return the `sdo:` list's writes to the records of a PDO, as (position in the list, data) by address."""
        return self._records.get((kind, number), {})

    @property
    def file(self) -> str:
        """Name of the EDS or DCF in bus.yml, for messages."""
        return self.node.identity.dcf

    @property
    def download_reason(self) -> str:
        """Text with the name of the file that contains the downloads, for messages."""
        name = self.node.boot.configuration_file or self.file
        return f"from {name}"

    def write(
        self,
        index: int,
        subindex: int,
        value: object,
        key: str,
        reason: str = "",
        *,
        optional: bool = False,
        pdo: tuple[str, int] | None = None,
    ) -> None:
        """Add a write, encoded in the data type of the object in the EDS; `key` is the related key of bus.yml.

        An impossible write is an error if bus.yml requests the write; with a `reason`, because this package adds the
        write, it is left out with a warning.
        """
        entry = self.od.get(index, subindex)
        if entry is None:
            self._cannot(key, reason, f"0x{index:04X}:{subindex:02X} is not in {self.file}")
            return
        place = f"0x{index:04X}:{subindex:02X} {entry.name}"
        if not entry.writable and not pdo:  # many EDS declare writable PDO records `ro` or `const`
            if not reason or self.default(index, subindex) != value:  # else the object has the value already
                self._cannot(key, reason, f"{place} is {entry.access}, it cannot be written")
            return
        try:
            data = encode(_encodable(value, entry.data_type), entry.data_type)
        except ValueError as error:
            self._cannot(key, reason, f"{place}: {error}")
            return
        if isinstance(value, int | float) and value != entry.value and outside_limits(entry, value):
            self.warn(key, f"{place}: {value} is outside the limits of the EDS, {entry.low} to {entry.high}")
        self._add(index, subindex, data, reason, optional, pdo)

    def can_write(self, index: int, subindex: int) -> bool:
        """Whether the EDS has an object and declares it writable."""
        entry = self.od.get(index, subindex)
        return entry is not None and entry.writable

    def is_fixed_cob_id(self, index: int, subindex: int, value: int) -> bool:
        """Whether this is a PDO's COB-ID that is read-only in the EDS and has this value as its default."""
        pdo = pdo_of(index)
        is_cob_id = pdo is not None and index == COMMUNICATION[pdo[0]] + pdo[1] - 1 and subindex == 1
        return is_cob_id and not self.can_write(index, subindex) and self.default(index, subindex) == value

    def _cannot(self, key: str, reason: str, text: str) -> None:
        if reason:
            self.warn(key, f"{text}; not written ({reason})")
        else:
            self.complain(key, text)

    def write_raw(
        self, index: int, subindex: int, data: bytes, reason: str, *, pdo: tuple[str, int] | None = None
    ) -> None:
        """Add a write of bytes from a file; report a missing object or a wrong length."""
        entry = self.od.get(index, subindex)
        place = f"0x{index:04X}:{subindex:02X}"
        key = "configuration_file" if self.node.boot.configuration_file else "dcf"
        if entry is None:
            self.warn(key, f"{place} is written {self.download_reason}, but is not in {self.file}")
        elif (bits := entry.data_type.bits) is not None and len(data) != (bits + 7) // 8:
            self.complain(key, f"{place} {entry.name}: {len(data)} bytes, {entry.data_type.name} has {(bits + 7) // 8}")
            return
        self._add(index, subindex, data, reason, False, pdo)

    def write_downloaded(self, index: int, subindex: int) -> None:
        """Add the write of the value that a file gives for an object, unless `sdo:` in bus.yml writes a number."""
        data = self._downloaded.get((index, subindex))
        if data is not None and self.listed_value(index, subindex) is None:
            self.write_raw(index, subindex, data, self.download_reason)

    def listed_value(self, index: int, subindex: int = 0) -> int | None:
        """Return the last number that the `sdo:` list of bus.yml writes to an object, or None."""
        for entry in reversed(self.node.boot.sdo):
            if (entry.index, entry.sub_index) == (index, subindex):
                return int(entry.value) if isinstance(entry.value, int) else None
        return None

    def downloaded_value(self, index: int, subindex: int = 0) -> int | None:
        """Return the number that a file (for PDO records also the `sdo:` list) writes to an object, or None."""
        data = self._downloaded.get((index, subindex))
        entry = self.od.get(index, subindex)
        signed = entry is not None and entry.data_type.signed
        return None if data is None else int.from_bytes(data, "little", signed=signed)

    def final(self, index: int, subindex: int) -> int | None:
        """Return the number in the last planned write of an object, else in the EDS; None if unknown.

        The value of a file counts only after its write was added.
        """
        entry = self.od.get(index, subindex)
        signed = entry is not None and entry.data_type.signed
        for write in reversed(self.writes):
            if write.address == (index, subindex):
                return int.from_bytes(write.data, "little", signed=signed)
        return self._eds_value(index, subindex)

    def _eds_value(self, index: int, subindex: int) -> int | None:
        """Return the number that the EDS gives an object, or None; a DCF's ParameterValue only if it is read-only."""
        entry = self.od.get(index, subindex)
        value = None if entry is None else entry.default if entry.writable else entry.value
        return value if isinstance(value, int) else None

    def note_overruled(self, index: int, subindex: int, key: str) -> None:
        """Report a value that a later write replaces: a warning for the `sdo:` list, a remark for a file."""
        final, place = self.final(index, subindex), f"0x{index:04X}:{subindex:02X}"
        listed, downloaded = self.listed_value(index, subindex), self.downloaded_value(index, subindex)
        if listed is not None and listed != final:
            self.warn("sdo", f"{place} = 0x{listed:X} is replaced by {key}, which is written later: 0x{final or 0:X}")
        elif downloaded is not None and downloaded != final and final is not None:
            self.remark("dcf", f"{place} = 0x{downloaded:X} {self.download_reason} is replaced by {key}: 0x{final:X}")

    def is_requested(self, index: int) -> bool:
        """Whether the `sdo:` list of bus.yml or a file writes an object, at any subindex."""
        return any(entry.index == index for entry in self.node.boot.sdo) or any(
            download[0] == index for download in self.downloads
        )

    def requested_value(self, index: int, subindex: int = 0) -> int | None:
        """Return the last number that the `sdo:` list, else a file, writes to an object, or None."""
        if any((entry.index, entry.sub_index) == (index, subindex) for entry in self.node.boot.sdo):
            return self.listed_value(index, subindex)
        return self.downloaded_value(index, subindex)

    def default(self, index: int, subindex: int) -> int | None:
        """Return the number that a file (for PDO records also `sdo:`), else the EDS, gives an object, or None."""
        data = self._downloaded.get((index, subindex))
        return self._eds_value(index, subindex) if data is None else int.from_bytes(data, "little")

    def signed_default(self, index: int, subindex: int) -> int | None:
        """Return `default` of an object as a signed number, even if the object is unsigned in the EDS."""
        entry, value = self.od.get(index, subindex), self.default(index, subindex)
        bits = None if entry is None else entry.data_type.bits
        if value is None or bits is None:
            return value
        return value - (1 << bits) if value >= 1 << bits - 1 else value

    def ordered_writes(self) -> tuple[PlannedWrite, ...]:
        """Return the writes in order; objects that are given several values are marked as not to be compared."""
        values: dict[tuple[int, int], set[bytes]] = {}
        for write in self.writes:
            if write.pdo is None:
                values.setdefault(write.address, set()).add(write.data)
        return tuple(
            replace(write, compare=False) if len(values.get(write.address, ())) > 1 else write for write in self.writes
        )

    def _add(
        self, index: int, subindex: int, data: bytes, reason: str, optional: bool, pdo: tuple[str, int] | None
    ) -> None:
        entry = self.od.get(index, subindex)
        compare = index not in _PROCEDURES and (entry is None or entry.readable)
        name = UNKNOWN if entry is None else entry.name
        data_type = None if entry is None else entry.data_type
        fixed = pdo is not None and self.is_fixed_cob_id(index, subindex, int.from_bytes(data, "little"))
        planned = PlannedWrite(index, subindex, data, name, reason, optional, pdo, compare, data_type, fixed)
        self.writes.append(planned)


def _with_numbers(entry: SdoEntry, od: ObjectDictionary) -> SdoEntry:
    """Return an entry of `sdo:` with a whole number such as 3.0 or "3" as an integer if the object is one.

    dcfgen converts every value to an integer.
    """
    described, value = od.get(entry.index, entry.sub_index), entry.value
    if described is None or not described.data_type.is_integer:
        return entry
    if isinstance(value, float) and value.is_integer():
        return replace(entry, value=int(value))
    if isinstance(value, str) and _WHOLE.fullmatch(value):
        return replace(entry, value=int(value))
    return entry


def _encodable(value: object, data_type: DataType) -> Value:
    """Convert hexadecimal text for an OCTET_STRING or DOMAIN to bytes; return other values unchanged.

    Raise ValueError for an invalid text, an integer in quoted hexadecimal digits, and an unsigned number that is too
    large for a signed type.
    """
    if isinstance(value, str) and data_type in _BYTES:
        try:
            return bytes.fromhex(value)
        except ValueError:
            raise ValueError(f"{value!r} is not a valid {data_type.name}: expected hex digits") from None
    if isinstance(value, str) and data_type.is_integer and _HEX.fullmatch(value):
        raise ValueError(f"{value!r} is text; remove the quotes")
    if isinstance(value, int) and data_type.signed and data_type.maximum < value <= 2 * data_type.maximum + 1:
        negative = value - 2 * (data_type.maximum + 1)
        limit = f"{data_type.maximum}, the maximum of {data_type.name}"
        raise ValueError(f"{value} is more than {limit}; write {negative} if that is meant")
    return value  # type: ignore[return-value]  # encode checks the type of the value
