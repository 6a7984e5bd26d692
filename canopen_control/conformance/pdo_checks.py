"""Checks of process data: records, mapping rules, transmission types, times and lengths (CiA 301, 7.2.2, 7.5.2.35-38).

The checks use the device's first RPDO and first TPDO. An RPDO is sent with the present values of the mapped objects, so
that nothing moves. `T` in a comment is the number of the case in CiA's conformance test tool 3.0.3.
"""

from __future__ import annotations

from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import TYPE_CHECKING

from canopen_control.cia301.abort import AbortCode
from canopen_control.cia301.nmt import NmtCommand
from canopen_control.cia301.pdo import DUMMY_TYPES, parse_mapping_entry
from canopen_control.cia402.objects import CONTROLWORD, MODES_OF_OPERATION
from canopen_control.cia402.state import HALT_BIT
from canopen_control.conformance.check import (
    CheckLevel,
    CheckList,
    CheckTouch,
    expect,
    expect_emergency,
    expect_refused,
)
from canopen_control.conformance.checked_node import CheckFailed, NotApplicable
from canopen_control.errors import RemoteProtocolError, SdoAbort
from canopen_control.frame import EXTENDED_BIT, can_id_of, is_restricted
from canopen_control.od.indices import RPDO, TPDO

if TYPE_CHECKING:
    from collections.abc import Iterator

    from canopen_control.conformance.checked_node import CheckedNode
    from canopen_control.frame import CanFrame
    from canopen_control.od.model import Address


PDO_CHECKS = CheckList("301")
_add = PDO_CHECKS.add
_SHOULD, _CONFIGURE = CheckLevel.SHOULD, CheckTouch.CONFIGURE
_OFF, _NO_RTR = 1 << 31, 1 << 30
_SEARCHED = 8  # number of records per direction that are read
SYNC_PERIOD_S = 0.01
_REFUSALS = (
    AbortCode.UNSUPPORTED_ACCESS,
    AbortCode.NOT_MAPPABLE,
    AbortCode.INVALID_VALUE,
    AbortCode.READ_ONLY,
    AbortCode.SUB0_NOT_ZERO,
    AbortCode.DEVICE_STATE,
)
_COMMUNICATION, _MAPPING = "7.5.2.35 and 7.5.2.37", "7.5.2.36 and 7.5.2.38"


@dataclass(frozen=True, slots=True)
class PdoRecord:
    """PDO of the device: index of its communication record, COB-ID, and mapping entries."""

    index: int
    cob_id: int
    entries: tuple[int, ...]

    @property
    def can_id(self) -> int:
        """CAN identifier of the PDO, with the flag of a 29-bit identifier."""
        return can_id_of(self.cob_id)

    @property
    def length(self) -> int:
        return (sum(parse_mapping_entry(entry)[2] for entry in self.entries) + 7) // 8

    @property
    def mapping(self) -> int:
        return self.index + 0x200


def pdo_records(node: CheckedNode, base: int) -> list[PdoRecord]:
    """Return the PDOs of one direction among its first eight records, including disabled PDOs."""
    records = []
    for index in range(base, base + _SEARCHED):
        try:
            cob_id = int.from_bytes(node.read(index, 1), "little")
            count = int.from_bytes(node.read(index + 0x200), "little")
        except SdoAbort:
            continue
        entries = [int.from_bytes(node.read(index + 0x200, sub), "little") for sub in range(1, min(count, 64) + 1)]
        records.append(PdoRecord(index, cob_id, tuple(entries)))
    return records


def first_pdo(node: CheckedNode, base: int = RPDO) -> PdoRecord:
    """Return the first valid PDO that maps an object; raise NotApplicable if none does."""
    for record in pdo_records(node, base):
        if record.entries and not record.cob_id & _OFF:
            return record
    name = "RPDO" if base == RPDO else "TPDO"
    raise NotApplicable(f"no {name} of the first {_SEARCHED} is valid and maps an object")


def present_values(node: CheckedNode, record: PdoRecord) -> bytes:
    """Return RPDO data with the current values of the mapped objects; raise NotApplicable if one cannot be read."""
    image, shift = 0, 0
    for entry in record.entries:
        index, subindex, bits = parse_mapping_entry(entry)
        if index not in DUMMY_TYPES:
            image |= (node.number(index, subindex) & (1 << bits) - 1) << shift
        shift += bits
    return image.to_bytes(record.length, "little")


@contextmanager
def reconfigured(
    node: CheckedNode, record: PdoRecord, values: dict[int, int], *, cob_id: int | None = None
) -> Iterator[None]:
    """Context with an enabled PDO whose communication parameters are replaced by `values`, by subindex, until exit."""
    index = record.index
    with node.kept(index, 1):
        node.put(index, 1, record.cob_id | _OFF, 4)
        before = {subindex: node.optional(index, subindex) for subindex in values}
        try:
            for subindex, value in values.items():
                node.put(index, subindex, value, len(before[subindex]))
            node.put(index, 1, (record.cob_id if cob_id is None else cob_id) & ~_OFF, 4)
            yield
        finally:
            with suppress(RemoteProtocolError):
                node.put(index, 1, record.cob_id | _OFF, 4)
                for subindex, data in before.items():
                    node.write(index, subindex, data)


@contextmanager
def _invalid(node: CheckedNode, record: PdoRecord) -> Iterator[None]:
    """Context with a disabled PDO whose mapping can be written; on exit COB-ID and mapping are restored."""
    mapping = record.mapping
    before = _all_entries(node, mapping)
    with node.kept(record.index, 1):
        node.put(record.index, 1, record.cob_id | _OFF, 4)
        try:
            yield
        finally:
            with suppress(RemoteProtocolError):
                node.put(mapping, 0, 0, 1)
                for number, entry in enumerate(before, 1):
                    node.put(mapping, number, entry, 4)
                node.put(mapping, 0, len(record.entries), 1)


def _all_entries(node: CheckedNode, mapping: int) -> list[int]:
    """Read the entries of a mapping record, including entries above the number of mapped objects."""
    entries = []
    for number in range(1, 65):
        try:
            entries.append(int.from_bytes(node.read(mapping, number), "little"))
        except SdoAbort:
            break
    return entries


def _mappable(node: CheckedNode, base: int = TPDO) -> PdoRecord:
    """Return the first PDO of a direction; raise NotApplicable if the EDS declares its mapping as not writable."""
    record = first_pdo(node, base)
    entry = node.described(record.mapping)
    if entry is not None and not entry.writable:
        raise NotApplicable(f"the mapping 0x{record.mapping:04X} is constant in the EDS")
    return record


def _map_one(node: CheckedNode, record: PdoRecord, entry: int) -> None:
    """Map one object into a PDO that is invalid."""
    node.put(record.mapping, 0, 0, 1)
    node.put(record.mapping, 1, entry, 4)
    node.put(record.mapping, 0, 1, 1)


class CountedSync:
    """Sender of SYNC with the identifier in 0x1005, and with a counter unless 0x1019 is 0 (CiA 301, 7.2.5)."""

    def __init__(self, node: CheckedNode) -> None:
        self._node, self._can_id = node, node.number(0x1005) & 0x7FF
        self._overflow = node.number(0x1019) if node.has(0x1019) else 0
        self._counter = 0

    def send(self) -> None:
        if self._overflow:
            self._counter = self._counter % self._overflow + 1
        self._node.send(self._can_id, bytes((self._counter,)) if self._overflow else b"")


def _syncs(node: CheckedNode, count: int, can_id: int) -> list[tuple[int, int]]:
    """Send `count` SYNCs; return the number (from 1) of each SYNC followed by frames, and the count of its frames."""
    sync = CountedSync(node)
    node.listen(SYNC_PERIOD_S)
    turns = []
    for number in range(1, count + 1):
        sync.send()
        frames = node.frames(can_id, SYNC_PERIOD_S)
        if frames:
            turns.append((number, len(frames)))
    return turns


# -- records


@_add("P01", _COMMUNICATION, "the COB-IDs of the PDOs are legal and unique")  # T 3.1
def _cob_ids(node: CheckedNode) -> None:
    records = [record for base in (RPDO, TPDO) for record in pdo_records(node, base)]
    if not records:
        raise NotApplicable("the device has no PDO")
    valid = [record for record in records if not record.cob_id & _OFF]
    for record in valid:
        legal = bool(record.cob_id & EXTENDED_BIT) or not is_restricted(record.cob_id & 0x7FF)
        expect(legal, f"0x{record.cob_id:08X} in 0x{record.index:04X}:01", "an identifier that is not restricted")
    users = [record.can_id for record in valid]
    twice = sorted({can_id for can_id in users if users.count(can_id) > 1})
    expect(not twice, ", ".join(f"0x{can_id:X}" for can_id in twice), "one PDO per identifier")


@_add("P01d", _COMMUNICATION, "the COB-IDs of PDOs 1 to 4 are the defaults of the node-ID", _SHOULD)  # T 3.2
def _default_ids(node: CheckedNode) -> None:
    wrong = []
    for base, first in ((RPDO, 0x200), (TPDO, 0x180)):
        for record in pdo_records(node, base):
            number, can_id = record.index - base, record.cob_id & 0x7FF
            default = first + 0x100 * number + node.node_id
            if number < 4 and not record.cob_id & _OFF and can_id != default:
                wrong.append(f"0x{record.index:04X}: 0x{can_id:X}, not 0x{default:X}")
    expect(not wrong, "; ".join(wrong), "the identifiers of the pre-defined connection set")


@_add("P02", _MAPPING, "each mapped object exists, and a PDO has at most 64 bits")  # T 3.21
def _mapped_objects(node: CheckedNode) -> None:
    for base in (RPDO, TPDO):
        for record in pdo_records(node, base):
            expect(record.length <= 8, f"{record.length} bytes in 0x{record.mapping:04X}", "at most 8")
            for entry in record.entries:
                index, subindex, _ = parse_mapping_entry(entry)
                od = None if node.eds is None else node.eds.od
                mappable = index in DUMMY_TYPES or od is None or od.get(index, subindex) is not None
                expect(mappable, f"0x{index:04X}:{subindex:02X} in 0x{record.mapping:04X}", "an object of the EDS")


@_add("P02d", _MAPPING, "the mappings are the defaults of the EDS", _SHOULD)
def _default_mapping(node: CheckedNode) -> None:
    if node.eds is None:
        raise NotApplicable("no EDS to compare with; give one with --eds")
    wrong = []
    for record in (record for base in (RPDO, TPDO) for record in pdo_records(node, base)):
        for number, entry in enumerate((len(record.entries), *record.entries)):
            described = node.eds.od.get(record.mapping, number)
            if described is not None and isinstance(described.default, int) and described.default != entry:
                wrong.append(f"0x{record.mapping:04X}:{number:02X} = 0x{entry:X}, not 0x{described.default:X}")
    expect(not wrong, "; ".join(wrong[:5]), "the defaults of the EDS")


# -- transmission


def _event_driven(node: CheckedNode, record: PdoRecord) -> dict[int, int]:
    """Return communication parameters, by subindex, for an event-driven TPDO without inhibit time and event timer."""
    values = {2: 255}
    for subindex in (3, 5):
        with suppress(NotApplicable):
            node.optional(record.index, subindex)
            values[subindex] = 0
    return values


@_add("P03", "7.2.2.2", "an event-driven TPDO is sent at NMT start, with the mapped length", _SHOULD, _CONFIGURE)
def _event_at_start(node: CheckedNode) -> None:
    record = first_pdo(node, TPDO)
    with reconfigured(node, record, _event_driven(node, record)), node.operational():
        frames = node.frames(record.can_id, 0.2)
    _expect_length(record, frames)
    expect(bool(frames), "no frame in 0.2 s", "a frame")


def _expect_length(record: PdoRecord, frames: list[tuple[int, CanFrame]]) -> None:
    for _, frame in frames:
        expect(len(frame.data) == record.length, f"{len(frame.data)} bytes", f"{record.length} bytes, as mapped")


@_add("P04", "7.5.2.37", "an event timer of 100 ms sends ten frames in a second", touch=_CONFIGURE)  # T 3.5
def _event_timer(node: CheckedNode) -> None:
    record = first_pdo(node, TPDO)
    node.optional(record.index, 5)
    with node.kept(record.index, 2), reconfigured(node, record, {2: 255, 5: 100}), node.operational():
        node.listen(0.05)
        frames = node.frames(record.can_id, 1.0)
    _expect_length(record, frames)
    expect(len(frames) >= 9, f"{len(frames)} frames in 1 s", "at least 9")
    gaps = [second[0] - first[0] for first, second in pairwise(frames)]
    expect(max(gaps) <= 130_000_000, f"{max(gaps) / 1e6:.0f} ms between two frames", "at most 100 ms")


def _turns(node: CheckedNode, kind: int, count: int, more: dict[int, int] | None = None) -> list[tuple[int, int]]:
    record = first_pdo(node, TPDO)
    with reconfigured(node, record, {2: kind, **(more or {})}), node.operational():
        return _syncs(node, count, record.can_id)


@_add("P05", "7.5.2.37", "transmission type 1: one frame at each SYNC", touch=_CONFIGURE)  # T 3.6
def _every_sync(node: CheckedNode) -> None:
    turns = _turns(node, 1, 5)
    expected = [(number, 1) for number in range(1, 6)]
    expect(turns == expected, f"{len(turns)} of 5 SYNC were followed by a frame", "one frame after each")


@_add("P06", "7.5.2.37", "transmission type 3: a frame at every third SYNC", touch=_CONFIGURE)  # T 3.6
def _every_third(node: CheckedNode) -> None:
    numbers = [number for number, _ in _turns(node, 3, 9)]
    good = len(numbers) == 3 and all(b - a == 3 for a, b in pairwise(numbers))
    expect(good, f"frames after SYNC {', '.join(map(str, numbers)) or 'none'}", "one after each third of 9")


@_add("P06h", "7.5.2.37", "transmission type 240: a frame at every 240th SYNC", touch=_CONFIGURE)  # T 3.6
def _every_240th(node: CheckedNode) -> None:
    record = first_pdo(node, TPDO)
    sync = node.number(0x1005) & 0x7FF
    if node.has(0x1019) and node.number(0x1019):
        raise NotApplicable("SYNC has a counter")
    with reconfigured(node, record, {2: 240}), node.operational():
        node.listen(SYNC_PERIOD_S)
        count = 0
        for _ in range(480):
            node.send(sync)
            count += len(node.frames(record.can_id, 0.001))
    expect(count == 2, f"{count} frames after 480 SYNC", "2")


@_add("P07", "7.5.2.37", "transmission type 0: frames are sent only after a SYNC", touch=_CONFIGURE)  # T 3.7
def _acyclic(node: CheckedNode) -> None:
    record = first_pdo(node, TPDO)
    with reconfigured(node, record, {2: 0}), node.operational():
        alone = node.frames(record.can_id, 0.2)
        expect(not alone, f"{len(alone)} frames without a SYNC", "none")
        turns = _syncs(node, 5, record.can_id)
    expect(all(number == 1 for _, number in turns), "several frames after one SYNC", "at most one")


@_add("P08", "7.5.2.37", "SYNC start value 3: the first frame comes at counter 3", touch=_CONFIGURE)  # T 3.8
def _sync_start(node: CheckedNode) -> None:
    record = first_pdo(node, TPDO)
    node.optional(record.index, 6)
    with node.kept(0x1019), node.kept(0x1006):
        node.put(0x1006, 0, 0, 4)
        node.put(0x1019, 0, 10, 1)
        with reconfigured(node, record, {2: 1, 6: 3}), node.operational():
            numbers = [number for number, _ in _syncs(node, 8, record.can_id)]
    expect(numbers[:1] == [3], f"first frame at counter {numbers[0] if numbers else 'none'}", "3")


@_add("P09", "7.2.2.2", "a remote frame of a TPDO is answered only in OPERATIONAL", _SHOULD, _CONFIGURE)  # T 3.9
def _remote(node: CheckedNode) -> None:
    record = first_pdo(node, TPDO)
    if record.cob_id & _NO_RTR:
        raise NotApplicable("bit 30 of the COB-ID forbids remote frames")
    with reconfigured(node, record, {2: 253}):
        before = node.ask_remote(record.can_id, 0.1)
        expect(before is None, "an answer in PRE-OPERATIONAL", "silence")
        with node.operational():
            node.listen(0.02)
            answer = node.ask_remote(record.can_id, 0.1)
    expect(answer is not None, "no answer in OPERATIONAL", "a frame")


@_add("P10", "7.3.2.2.2", "PRE-OPERATIONAL: no TPDO, not even at SYNC", touch=_CONFIGURE)  # T 3.10
def _silent_preop(node: CheckedNode) -> None:
    record = first_pdo(node, TPDO)
    with reconfigured(node, record, {2: 1}):
        turns = _syncs(node, 5, record.can_id)
    expect(not turns, f"frames after SYNC {turns}", "none")


@_add("P10s", "7.3.2.2.4", "STOPPED: no TPDO, not even at SYNC", touch=_CONFIGURE)  # T 3.16
def _silent_stopped(node: CheckedNode) -> None:
    record = first_pdo(node, TPDO)
    sync = CountedSync(node)
    with reconfigured(node, record, {2: 1}):
        node.nmt(NmtCommand.START)
        node.nmt(NmtCommand.STOP)
        node.listen(SYNC_PERIOD_S)
        count = 0
        for _ in range(3):
            sync.send()
            count += len(node.frames(record.can_id, SYNC_PERIOD_S))
        node.nmt(NmtCommand.ENTER_PRE_OPERATIONAL)
        node.listen(SYNC_PERIOD_S)
    expect(not count, f"{count} frames", "none")


@_add("P20", "7.5.2.37", "an inhibit time of 100 ms separates two frames", touch=_CONFIGURE)
def _inhibit(node: CheckedNode) -> None:
    record = first_pdo(node, TPDO)
    for subindex in (3, 5):
        node.optional(record.index, subindex)
    with reconfigured(node, record, {2: 255, 3: 1000, 5: 20}), node.operational():
        frames = node.frames(record.can_id, 0.55)
    gaps = [second[0] - first[0] for first, second in pairwise(frames)]
    shortest = min(gaps, default=100_000_000)
    expect(shortest >= 98_000_000, f"{shortest / 1e6:.1f} ms between two frames", "at least 100 ms")


@_add("P20n", "7.5.2.37", "without an inhibit time an event timer of 10 ms is met", _SHOULD, _CONFIGURE)
def _no_inhibit(node: CheckedNode) -> None:
    record = first_pdo(node, TPDO)
    for subindex in (3, 5):
        node.optional(record.index, subindex)
    with reconfigured(node, record, {2: 255, 3: 0, 5: 10}), node.operational():
        node.listen(0.05)
        count = len(node.frames(record.can_id, 0.2))
    expect(count >= 16, f"{count} frames in 0.2 s", "20")


@_add("P21", _COMMUNICATION, "the reserved transmission types 241 and 251 are refused", _SHOULD, _CONFIGURE)
def _reserved_types(node: CheckedNode) -> None:
    for base in (RPDO, TPDO):
        record = first_pdo(node, base)
        with node.kept(record.index, 1), node.kept(record.index, 2):
            node.put(record.index, 1, record.cob_id | _OFF, 4)
            for kind in (241, 251):
                codes = AbortCode.INVALID_VALUE, AbortCode.VALUE_TOO_HIGH
                expect_refused(node, record.index, 2, bytes((kind,)), *codes)


@_add("P21t", _COMMUNICATION, "a TPDO accepts the transmission types 1, 240 and 255", _SHOULD, _CONFIGURE)
def _legal_types(node: CheckedNode) -> None:
    record = first_pdo(node, TPDO)
    for kind in (1, 240, 255):
        with reconfigured(node, record, {2: kind}):
            value = node.number(record.index, 2)
            expect(value == kind, f"{value}", f"{kind}")


@_add("P22", _COMMUNICATION, "another identifier is refused while the PDO is valid", _SHOULD, _CONFIGURE)
def _id_while_valid(node: CheckedNode) -> None:
    record = first_pdo(node, TPDO)
    with node.kept(record.index, 1):
        data = (record.cob_id ^ 1).to_bytes(4, "little")
        expect_refused(node, record.index, 1, data, *_REFUSALS)


@_add("P22o", _COMMUNICATION, "a PDO becomes invalid and valid by bit 31 of its COB-ID", touch=_CONFIGURE)
def _switched_off(node: CheckedNode) -> None:
    record = first_pdo(node, TPDO)
    entry = node.described(record.index, 1)
    if entry is not None and not entry.writable:
        raise NotApplicable("the COB-ID is constant in the EDS")
    with reconfigured(node, record, {2: 1}):
        node.put(record.index, 1, record.cob_id | _OFF, 4)
        with node.operational():
            turns = _syncs(node, 3, record.can_id)
        expect(not turns, "frames while bit 31 is set", "none")


# -- mapping


@_add("P11", _MAPPING, "a TPDO can be remapped by the procedure of CiA 301", touch=_CONFIGURE)  # T 3.22
def _remapped(node: CheckedNode) -> None:
    record = _mappable(node)
    entry = record.entries[0]
    with _invalid(node, record):
        _map_one(node, record, entry)
        shorter = PdoRecord(record.index, record.cob_id, (entry,))
        with reconfigured(node, shorter, {2: 1}), node.operational():
            sync = CountedSync(node)
            node.listen(SYNC_PERIOD_S)
            sync.send()
            frames = node.frames(record.can_id, SYNC_PERIOD_S)
    expect(bool(frames), "no frame after SYNC", "a frame")
    _expect_length(shorter, frames)


@_add("P11m", _MAPPING, "a PDO accepts as many objects as its record has entries", _SHOULD, _CONFIGURE)
def _many_objects(node: CheckedNode) -> None:
    record = _mappable(node)
    if node.eds is None:
        raise NotApplicable("no EDS that lists the entries; give one with --eds")
    od = node.eds.od
    small = next((e for e in od if e.tpdo_mappable and e.data_type.bits == 8), None)
    room = min(8, max(sub for sub in od.subindices(record.mapping)))
    if small is None:
        raise NotApplicable("no object of 8 bits can be mapped")
    with _invalid(node, record):
        node.put(record.mapping, 0, 0, 1)
        for number in range(1, room + 1):
            node.put(record.mapping, number, small.index << 16 | small.subindex << 8 | 8, 4)
        node.put(record.mapping, 0, room, 1)


@_add("P12", _MAPPING, "a mapping entry is refused while subindex 0 is not 0", touch=_CONFIGURE)
def _entry_while_counted(node: CheckedNode) -> None:  # T 3.23
    record = _mappable(node)
    with _invalid(node, record):
        expect_refused(node, record.mapping, 1, record.entries[0].to_bytes(4, "little"), *_REFUSALS)


@_add("P12s", _MAPPING, "the number of entries can be set to 0 in an invalid PDO", touch=_CONFIGURE)
def _count_zero(node: CheckedNode) -> None:
    record = _mappable(node)
    with _invalid(node, record):
        node.put(record.mapping, 0, 0, 1)
        value = node.number(record.mapping)
        expect(value == 0, f"{value}", "0")


@_add("P13", _MAPPING, "the mapping is refused while the PDO is valid", touch=_CONFIGURE)  # T 3.24
def _mapped_while_valid(node: CheckedNode) -> None:
    record = _mappable(node)
    try:
        expect_refused(node, record.mapping, 0, b"\0", *_REFUSALS)
    except CheckFailed:
        with _invalid(node, record):
            raise


def _refused_entry(node: CheckedNode, base: int, entry: int) -> None:
    record = _mappable(node, base)
    codes = AbortCode.NOT_MAPPABLE, AbortCode.NO_OBJECT, AbortCode.NO_SUBINDEX, AbortCode.INVALID_VALUE
    with _invalid(node, record):
        node.put(record.mapping, 0, 0, 1)
        expect_refused(node, record.mapping, 1, entry.to_bytes(4, "little"), *codes)


@_add("P14", _MAPPING, "more than 64 bits are refused", touch=_CONFIGURE)  # T 3.26
def _too_many_bits(node: CheckedNode) -> None:
    record = _mappable(node)
    widest = max(record.entries, key=lambda entry: entry & 0xFF)
    count = 64 // (widest & 0xFF) + 1
    codes = AbortCode.MAPPING_TOO_LONG, AbortCode.UNSUPPORTED_ACCESS, AbortCode.NOT_MAPPABLE, AbortCode.NO_SUBINDEX
    with _invalid(node, record):
        node.put(record.mapping, 0, 0, 1)
        try:
            for number in range(1, count + 1):
                node.put(record.mapping, number, widest, 4)
            node.put(record.mapping, 0, count, 1)
        except SdoAbort as error:
            expect(error.code in codes, f"abort 0x{error.code:08X}", "abort 0x06040042")
        else:
            raise CheckFailed(f"{count} objects of {widest & 0xFF} bits were accepted", "abort 0x06040042")


@_add("P14c", _MAPPING, "a number of entries above 64 is refused", touch=_CONFIGURE)  # T 3.25
def _count_too_high(node: CheckedNode) -> None:
    record = _mappable(node)
    codes = AbortCode.MAPPING_TOO_LONG, AbortCode.INVALID_VALUE, AbortCode.VALUE_TOO_HIGH, *_REFUSALS
    with _invalid(node, record):
        expect_refused(node, record.mapping, 0, bytes((65,)), *codes)


for _id, _title, _entry in (
    ("P15", "an object that does not exist cannot be mapped", 0x1004_00_20),  # T 3.28
    ("P15u", "an object that must not be mapped (0x1018) is refused", 0x1018_01_20),  # T 3.29
):
    _add(_id, _MAPPING, _title, touch=_CONFIGURE)(partial(_refused_entry, base=TPDO, entry=_entry))


@_add("P15r", _MAPPING, "a read-only object cannot be mapped into an RPDO", touch=_CONFIGURE)  # T 3.31
def _read_only_object(node: CheckedNode) -> None:
    record = first_pdo(node, TPDO)
    for entry in record.entries:
        described = node.described(*parse_mapping_entry(entry)[:2])
        if described is not None and not described.writable:
            _refused_entry(node, RPDO, entry)
            return
    raise NotApplicable("no object of the first TPDO is read-only in the EDS")


@_add("P16", "7.5.2.36", "a dummy object of the EDS (0x0005) can be mapped", _SHOULD, _CONFIGURE)  # T 3.33
def _dummy_object(node: CheckedNode) -> None:
    if node.eds is None or 5 not in node.eds.od.dummy_usage:
        raise NotApplicable("the EDS has no Dummy0005=1")
    record = _mappable(node, RPDO)
    with _invalid(node, record):
        _map_one(node, record, 0x00050008)


@_add("P16f", _MAPPING, "a PDO can be mapped while its COB-ID is another node's", _SHOULD, _CONFIGURE)
def _foreign_id(node: CheckedNode) -> None:
    record = _mappable(node)
    other = record.cob_id & ~0x7F | (1 if node.node_id != 1 else 2)
    with _invalid(node, record):
        node.put(record.index, 1, other | _OFF, 4)
        _map_one(node, record, record.entries[0])


@_add("P16o", _MAPPING, "a mapping is accepted in OPERATIONAL", _SHOULD, _CONFIGURE)
def _mapped_operational(node: CheckedNode) -> None:
    record = _mappable(node)
    with node.operational(), _invalid(node, record):
        _map_one(node, record, record.entries[0])


# -- RPDO frames


def _other_values(node: CheckedNode, record: PdoRecord) -> tuple[bytes, Address]:
    """Return RPDO data with one object changed so that nothing moves, and the address of that object."""
    data, shift = bytearray(present_values(node, record)), 0
    for entry in record.entries:
        index, subindex, bits = parse_mapping_entry(entry)
        if index not in (*DUMMY_TYPES, MODES_OF_OPERATION):
            image = int.from_bytes(data, "little") ^ (HALT_BIT if index == CONTROLWORD else 1) << shift
            return image.to_bytes(len(data), "little"), (index, subindex)
        shift += bits
    raise NotApplicable("no object of the first RPDO can have another value without an effect")


def _expect_value(node: CheckedNode, frame: bytes, address: Address, *, applied: bool) -> None:
    """Check that the device applies the value in an RPDO (or, if not `applied`, ignores it); restore the old value."""
    record = first_pdo(node)
    before = node.read(*address)
    node.send(record.can_id, frame)
    node.listen(0.05)
    after = node.read(*address)
    if after != before:
        node.write(*address, before)
    name = f"0x{address[0]:04X}:{address[1]:02X}"
    expect(
        (after != before) is applied, f"{name} is {after.hex(' ').upper()}", "the new value" if applied else "no change"
    )


def _rpdo_value(node: CheckedNode, *, added: int = 0, operational: bool = True, applied: bool) -> None:
    """Send another value in the first RPDO, with `added` bytes more than mapped; check whether it is applied."""
    record = first_pdo(node)
    if added > 0 and record.length == 8:
        raise NotApplicable("the first RPDO has 8 bytes already")
    frame, address = _other_values(node, record)
    with reconfigured(node, record, {2: 255}), node.operational() if operational else nullcontext():
        _expect_value(node, (frame + b"\0")[: record.length + added], address, applied=applied)


_add("P17", "7.2.2.5", "an RPDO that is one byte short has no effect", touch=_CONFIGURE)(  # T 5.4
    partial(_rpdo_value, added=-1, applied=False)
)


@_add("P17e", "7.2.7", "an RPDO that is too short raises EMCY 0x8210", _SHOULD, _CONFIGURE)  # T 5.4
def _short_emergency(node: CheckedNode) -> None:
    record, can_id = first_pdo(node), node.number(0x1014) & 0x7FF
    data = present_values(node, record)
    with node.operational():
        node.listen(0.02)
        node.send(record.can_id, data[:-1])
        codes = [int.from_bytes(frame.data[:2], "little") for _, frame in node.frames(can_id, 0.1)]
        node.send(record.can_id, data)
        node.listen(0.05)
    expect_emergency(codes, 0x8210)


_add("P18", "7.2.2.5", "an RPDO that is one byte longer than mapped is applied", _SHOULD, _CONFIGURE)(
    partial(_rpdo_value, added=1, applied=True)
)
_add("P18n", "7.2.2", "an RPDO of the mapped length is applied in OPERATIONAL", touch=_CONFIGURE)(
    partial(_rpdo_value, applied=True)
)
_add("P19", "7.3.2.2.2", "an RPDO in PRE-OPERATIONAL is ignored", touch=_CONFIGURE)(
    partial(_rpdo_value, operational=False, applied=False)
)


@_add("P19s", "7.5.2.35", "an RPDO of transmission type 1 takes effect at the next SYNC", touch=_CONFIGURE)
def _rpdo_at_sync(node: CheckedNode) -> None:
    record = first_pdo(node)
    frame, address = _other_values(node, record)
    with reconfigured(node, record, {2: 1}), node.operational():
        before = node.read(*address)
        node.send(record.can_id, frame)
        node.listen(SYNC_PERIOD_S)
        early = node.read(*address)
        _syncs(node, 1, record.can_id)
        after = node.read(*address)
        if after != before:
            node.write(*address, before)
    expect(early == before, "the value took effect before the SYNC", "no change")
    expect(after != before, "the value did not take effect at the SYNC", "the new value")
