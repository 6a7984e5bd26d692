"""Builds the plan of a node: encodes and marks its SDO writes, and reports what does not fit.

The law of the file: a write is encoded here once, as the EDS types its object, so that all speak of the same bytes.
What can be read back is compared before it is written and verified after; what cannot (objects without read access, the
signatures of 0x1010 and 0x1011, an address that is written several times with different values: such a sequence is a
procedure) is always written.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from canopen_control.od.codec import encode
from canopen_control.od.limits import outside_limits
from canopen_control.od.model import DataType
from canopen_control.od.pdos import pdo_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from canopen_control.cia301.pdo import MappedObject
    from canopen_control.master.keys import NodeConfig
    from canopen_control.od.model import ObjectDictionary, Value

__all__ = ["STORED", "PdoLayout", "PlanBuilder", "PlannedWrite"]

STORED = "as in the EDS, but the device may have stored something else"
"""The reason of a write that changes nothing where the device is as its file says."""
_PROCEDURES = frozenset((0x1010, 0x1011))  # what is read there is no value that was written
_BYTES = frozenset((DataType.OCTET_STRING, DataType.DOMAIN))


@dataclass(frozen=True, slots=True)
class PlannedWrite:
    """One SDO download; `reason` is empty for what bus.yml asks for, `optional` ones may be refused by the node.

    `pdo` names the PDO whose records the write belongs to; `compare`: it can be read back.
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

    @property
    def address(self) -> tuple[int, int]:
        """The pair (index, subindex)."""
        return self.index, self.subindex


@dataclass(frozen=True, slots=True)
class PdoLayout:
    """A PDO that will be live: its COB-ID and what it carries, in order; `event_ms` is its event timer, 0: none."""

    number: int
    cob_id: int
    transmission_type: int
    objects: tuple[MappedObject, ...]
    event_ms: int = 0


@dataclass(slots=True)
class PlanBuilder:
    """The plan in the making; `complain(key, text)` reports a mistake and goes on, `warn` a doubt.

    `note` is told of keys without effect, `remark` of a choice.
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
    layouts: dict[str, list[PdoLayout]] = field(default_factory=lambda: {"rpdo": [], "tpdo": []})
    _downloaded: dict[tuple[int, int], bytes] = field(init=False)
    _records: dict[tuple[str, int], dict[tuple[int, int], tuple[int, bytes]]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._downloaded = {(index, subindex): data for index, subindex, data in self.downloads}
        for place, each in enumerate(self.node.boot.sdo):
            pdo, entry = pdo_of(each.index), self.od.get(each.index, each.sub_index)
            if pdo is None or entry is None:
                continue  # what the EDS lacks is told where the list is planned
            try:
                data = encode(_bytes_of(each.value, entry.data_type), entry.data_type)
            except ValueError as error:
                self.complain(f"sdo[{place}]", f"0x{each.index:04X}:{each.sub_index:02X} {entry.name}: {error}")
                continue
            self._records.setdefault(pdo, {})[each.index, each.sub_index] = place, data
            self._downloaded[each.index, each.sub_index] = data

    def listed_pdos(self, kind: str) -> set[int]:
        """Return the numbers of the PDOs that the `sdo:` list of bus.yml writes to."""
        return {number for which, number in self._records if which == kind}

    def listed_records(self, kind: str, number: int) -> dict[tuple[int, int], tuple[int, bytes]]:
        """Return what the `sdo:` list writes to the records of a PDO: by address its last place in it, and the data."""
        return self._records.get((kind, number), {})

    @property
    def file(self) -> str:
        """The file that describes the device, for messages."""
        return self.node.identity.dcf

    @property
    def download_reason(self) -> str:
        """Who asks for the downloads."""
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
        """Add one write, encoded as the EDS types the object; `key` is where bus.yml asks for it.

        What cannot be written is an error where bus.yml asks for it, and done without where this package adds it
        (`reason`): the user is told.
        """
        entry = self.od.get(index, subindex)
        if entry is None:
            self._cannot(key, reason, f"0x{index:04X}:{subindex:02X} is not in {self.file}")
            return
        where = f"0x{index:04X}:{subindex:02X} {entry.name}"
        if not entry.writable and not pdo:  # PDO records: many an EDS says `ro` or `const` of what can be written
            if not reason or self.default(index, subindex) != value:  # else it is as it is to be
                self._cannot(key, reason, f"{where} is {entry.access}, it cannot be written")
            return
        try:
            data = encode(_bytes_of(value, entry.data_type), entry.data_type)
        except ValueError as error:
            self._cannot(key, reason, f"{where}: {error}")
            return
        if isinstance(value, int | float) and value != entry.value and outside_limits(entry, value):
            self.warn(key, f"{where}: {value} is outside the limits of the EDS, {entry.low} to {entry.high}")
        self._add(index, subindex, data, reason, optional, pdo)

    def can_write(self, index: int, subindex: int) -> bool:
        """Whether the EDS has the object and lets it be written."""
        entry = self.od.get(index, subindex)
        return entry is not None and entry.writable

    def _cannot(self, key: str, reason: str, text: str) -> None:
        if reason:
            self.warn(key, f"{text}; done without ({reason})")
        else:
            self.complain(key, text)

    def write_raw(
        self, index: int, subindex: int, data: bytes, reason: str, *, pdo: tuple[str, int] | None = None
    ) -> None:
        """Add one write of bytes that come from a file."""
        entry = self.od.get(index, subindex)
        where = f"0x{index:04X}:{subindex:02X}"
        key = "configuration_file" if self.node.boot.configuration_file else "dcf"
        if entry is None:
            self.warn(key, f"{where} is written {self.download_reason} and is not in {self.file}")
        elif (bits := entry.data_type.bits) is not None and len(data) != (bits + 7) // 8:
            self.complain(key, f"{where} {entry.name}: {len(data)} bytes, {entry.data_type.name} has {(bits + 7) // 8}")
            return
        self._add(index, subindex, data, reason, False, pdo)

    def write_downloaded(self, index: int, subindex: int) -> None:
        """Add the write that a file asks for there, unless the `sdo:` list of bus.yml has another one."""
        data = self._downloaded.get((index, subindex))
        if data is not None and self.listed_value(index, subindex) is None:
            self.write_raw(index, subindex, data, self.download_reason)

    def listed_value(self, index: int, subindex: int = 0) -> int | None:
        """Return the number that the `sdo:` list of bus.yml writes there last."""
        for entry in reversed(self.node.boot.sdo):
            if (entry.index, entry.sub_index) == (index, subindex):
                return int(entry.value) if isinstance(entry.value, int) else None
        return None

    def downloaded_value(self, index: int, subindex: int = 0) -> int | None:
        """Return the number that a file writes there."""
        data = self._downloaded.get((index, subindex))
        found = self.od.get(index, subindex)
        signed = found is not None and found.data_type.signed
        return None if data is None else int.from_bytes(data, "little", signed=signed)

    def final(self, index: int, subindex: int) -> int | None:
        """Return the number that the object holds after all writes so far; the default of the EDS where there is none.

        A file's value counts where it is written, not before.
        """
        entry = self.od.get(index, subindex)
        signed = entry is not None and entry.data_type.signed
        for write in reversed(self.writes):
            if write.address == (index, subindex):
                return int.from_bytes(write.data, "little", signed=signed)
        return self._held(index, subindex)

    def _held(self, index: int, subindex: int) -> int | None:
        """Return what the EDS says that the node holds; the ParameterValue of a DCF counts once it is written."""
        entry = self.od.get(index, subindex)
        value = None if entry is None else entry.default if entry.writable else entry.value
        return value if isinstance(value, int) else None

    def note_overruled(self, index: int, subindex: int, key: str) -> None:
        """Note that a value of the file, or warn that one of the `sdo:` list, is not what the node holds in the end."""
        final, where = self.final(index, subindex), f"0x{index:04X}:{subindex:02X}"
        listed, downloaded = self.listed_value(index, subindex), self.downloaded_value(index, subindex)
        if listed is not None and listed != final:
            self.warn("sdo", f"{where} = 0x{listed:X} is overruled by {key}, which is written last: 0x{final or 0:X}")
        elif downloaded is not None and downloaded != final and final is not None:
            self.remark("dcf", f"{where} = 0x{downloaded:X} {self.download_reason} is overruled by {key}: 0x{final:X}")

    def asked_for(self, index: int) -> bool:
        """Whether the `sdo:` list of bus.yml or a file writes the object."""
        return any(entry.index == index for entry in self.node.boot.sdo) or any(
            each[0] == index for each in self.downloads
        )

    def asked_value(self, index: int, subindex: int = 0) -> int | None:
        """Return the number that the `sdo:` list or a file writes there last."""
        if any((entry.index, entry.sub_index) == (index, subindex) for entry in self.node.boot.sdo):
            return self.listed_value(index, subindex)
        return self.downloaded_value(index, subindex)

    def default(self, index: int, subindex: int) -> int | None:
        """Return what the object holds before bus.yml changes it: from a file, else from the EDS."""
        data = self._downloaded.get((index, subindex))
        return self._held(index, subindex) if data is None else int.from_bytes(data, "little")

    def signed_default(self, index: int, subindex: int) -> int | None:
        """Return what a signed object holds before bus.yml changes it, also where the EDS makes it unsigned."""
        entry, value = self.od.get(index, subindex), self.default(index, subindex)
        bits = None if entry is None else entry.data_type.bits
        if value is None or bits is None:
            return value
        return value - (1 << bits) if value >= 1 << bits - 1 else value

    def ordered_writes(self) -> tuple[PlannedWrite, ...]:
        """Return the writes; those of an address with several values are marked as always to be written."""
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
        name = "not in the EDS" if entry is None else entry.name
        data_type = None if entry is None else entry.data_type
        self.writes.append(PlannedWrite(index, subindex, data, name, reason, optional, pdo, compare, data_type))


def _bytes_of(value: object, data_type: DataType) -> Value:
    """Return hex digits as the bytes they stand for where an object wants bytes."""
    if isinstance(value, str) and data_type in _BYTES:
        try:
            return bytes.fromhex(value)
        except ValueError:
            raise ValueError(f"{value!r} is no {data_type.name}: hex digits are wanted") from None
    return value  # type: ignore[return-value]  # encode checks the type of the value
