"""Configuration of a node during its boot by reading, comparing, writing and verifying objects (CiA 302-2).

Values that the node already has are not written, and written values are read back. If the node then has another value,
the boot fails for communication objects and 0x6007; for objects of the drive (such as a ramp that the drive limits)
this is only a warning. A PDO that cannot be configured is used with the node's own mapping if that contains all
needed objects; else the PDO is left invalid.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import groupby
from typing import TYPE_CHECKING

from canopen_control.cia301.heartbeat import parse_consumer_entry
from canopen_control.cia301.pdo import INVALID_BIT, MAX_BITS, NO_RTR_BIT, MappedObject, PdoCodec, parse_mapping_entry
from canopen_control.cia301.sync import PRODUCER_BIT
from canopen_control.cia402.objects import (
    AXES,
    FEED_CONSTANT,
    GEAR_RATIO,
    INTERPOLATION_TIME_PERIOD,
    MOTION,
    POLARITY,
    POSITION_ENCODER_RESOLUTION,
    axis_index,
    axis_of,
)
from canopen_control.cia402.units import counts_per_revolution
from canopen_control.errors import CanopenError, ConfigError, SdoAbort, SdoLengthError, SdoTimeout
from canopen_control.frame import EXTENDED_BIT, is_restricted
from canopen_control.master.plan_builder import PlannedPdo
from canopen_control.master.requests import Answer, BootTransfers, NextStep, Request, boot_error, reason_of
from canopen_control.od.codec import decode
from canopen_control.od.model import DataType
from canopen_control.od.pdos import COMMUNICATION, MAPPING

if TYPE_CHECKING:
    from collections.abc import Generator, Mapping, Sequence

    from canopen_control.master.plan import NodePlan
    from canopen_control.master.plan_builder import PlannedWrite
    from canopen_control.od.model import Value

# Comparison of a plan with the values in a node: differences, and the writes that remove them.
#
# The writes of one PDO form a group, and every other write is a separate group. Bit 30 of a PDO's COB-ID belongs to the
# device and is never a difference; for a PDO that is planned as invalid only bit 31 is compared. Values are compared
# in the type of the object, so that an object that a drive answers with more bytes than the EDS declares is not written
# again at each boot.


_TEXT = (DataType.VISIBLE_STRING, DataType.UNICODE_STRING)
_COB_ID = 1  # subindex of a communication record


def groups(writes: Sequence[PlannedWrite]) -> list[list[PlannedWrite]]:
    """Group writes in order: the writes of a PDO in one list, every other write in a separate list."""
    by_pdo: list[list[PlannedWrite]] = []
    for pdo, of_pdo in groupby(writes, key=lambda write: write.pdo):
        members = list(of_pdo)
        by_pdo += [members] if pdo is not None else [[write] for write in members]
    return by_pdo


def is_cob_id(write: PlannedWrite) -> bool:
    """Whether a write is to the COB-ID of a PDO."""
    return write.pdo is not None and write.index == cob_id_of(write.pdo) and write.subindex == _COB_ID


def cob_id_of(pdo: tuple[str, int]) -> int:
    """Return the index of the communication record of a PDO, whose subindex 1 is the COB-ID."""
    return COMMUNICATION[pdo[0]] + pdo[1] - 1


def final_values(group: Sequence[PlannedWrite]) -> dict[tuple[int, int], PlannedWrite]:
    """Return the last write to each address, which contains the final value."""
    return {write.address: write for write in group}


def reads_of(group: Sequence[PlannedWrite]) -> list[tuple[int, int]]:
    """Return the addresses of a group that are to be read and compared before writing."""
    return [address for address, write in final_values(group).items() if write.compare]


def keep_rtr_bit(planned: bytes, current: bytes | None) -> bytes:
    """Return a planned COB-ID with bit 30 (no RTR) as in the device's `current` COB-ID."""
    if current is None or len(current) != len(planned):
        return planned
    value, own = int.from_bytes(planned, "little"), int.from_bytes(current, "little")
    return (value & ~NO_RTR_BIT | own & NO_RTR_BIT).to_bytes(len(planned), "little")


def matches(write: PlannedWrite, current: bytes | None) -> bool:
    """Whether the `current` value in the node equals the value of a write."""
    if current is None:
        return False
    if is_cob_id(write):
        planned, own = int.from_bytes(write.data, "little"), int.from_bytes(current, "little")
        if planned & INVALID_BIT:
            return bool(own & INVALID_BIT)
        return planned & ~NO_RTR_BIT == own & ~NO_RTR_BIT
    if current == write.data:
        return True
    if write.data_type in _TEXT:
        return current.rstrip(b"\0") == write.data.rstrip(b"\0")
    if write.data_type is None or not write.data_type.is_integer:
        return False
    signed = write.data_type.signed
    return int.from_bytes(current, "little", signed=signed) == int.from_bytes(write.data, "little", signed=signed)


def needed(group: Sequence[PlannedWrite], current: Mapping[tuple[int, int], bytes | None]) -> list[PlannedWrite]:
    """Return the writes of a group that are required, in order, for the `current` values; [] if nothing differs."""
    final = final_values(group)
    different = {
        address for address, write in final.items() if not write.compare or not matches(write, current.get(address))
    }
    if not different:
        return []
    if group[0].pdo is None:
        return list(group)
    communication = cob_id_of(group[0].pdo)
    mapping = any(index != communication for index, _ in different)
    return [write for write in group if _is_needed(write, communication, mapping, different, current)]


def _is_needed(
    write: PlannedWrite,
    communication: int,
    remap: bool,
    different: set[tuple[int, int]],
    current: Mapping[tuple[int, int], bytes | None],
) -> bool:
    """Whether a write of a PDO is required, so that the PDO is made invalid, changed, and made valid again."""
    if write.index != communication:
        # CiA 301, 7.5.2.36: number of objects 0, entries, number of objects
        return remap  # a mapping is always written completely: count 0, entries, count
    if write.subindex != _COB_ID or write.fixed:
        return write.address in different
    # CiA 301, 7.5.2.35 and 7.5.2.37: bit 31 of subindex 1, the PDO does not exist
    if write.data[-1] & INVALID_BIT >> 24:
        present = current.get(write.address)
        return present is None or not present[-1:] or not present[-1] & INVALID_BIT >> 24
    return True


# PDOs of a node during its boot: configured as planned, used as configured in the node, or left invalid (CiA 301).
#
# Rules (CiA 301, 7.5.2.35): a PDO is read before it is written, written in the standard's order (invalid, settings,
# mapping, valid), and read back. If the node refuses (a constant COB-ID, a mapping that cannot be written), its
# previous configuration is restored, and used if it contains every planned object; other objects of an RPDO keep their
# values. Otherwise the PDO is left invalid and the boot fails with an error that names the missing objects.
#
# An RPDO is always sent completely, so that every mapped object needs a value before the first transmission: objects
# that nothing commands keep the node's value (`read_outputs`), or are 0 if the node does not allow reading. This does
# not apply to objects that move an axis, whose initial values are set in `boot`.


Held = dict[tuple[int, int], bytes | None]
_UNSIGNED = {kind.bits: kind for kind in DataType if kind.name.startswith("UNSIGNED")}


@dataclass(frozen=True, slots=True)
class _Own:
    """Configuration of a PDO as read from the node."""

    cob_id: int
    transmission_type: int
    objects: tuple[tuple[int, int, int], ...]  # index, subindex, bits

    def __str__(self) -> str:
        return ", ".join(f"0x{index:04X}:{subindex:02X}" for index, subindex, _ in self.objects) or "nothing"


def release_cob_ids(
    grouped: Sequence[Sequence[PlannedWrite]], transfers: BootTransfers
) -> Generator[Request, Answer, None]:
    """Make those PDOs invalid whose COB-ID is planned for another PDO.

    Some devices, such as the maxon EPOS4, refuse to make a PDO valid if another valid PDO has the same COB-ID.
    """
    final = {
        group[0].pdo: int.from_bytes(next(write.data for write in reversed(group) if is_cob_id(write)), "little")
        for group in grouped
        if group[0].pdo is not None and any(is_cob_id(write) for write in group)
    }
    claimed = {value & 0x7FF: pdo for pdo, value in final.items() if not value & INVALID_BIT}
    for pdo in final:
        if pdo is None:
            continue
        try:
            data = yield from transfers.held(cob_id_of(pdo), 1)
        except SdoTimeout:
            return  # reported when the PDO is configured
        current = INVALID_BIT if data is None else int.from_bytes(data, "little")
        if not current & INVALID_BIT and claimed.get(current & 0x7FF, pdo) != pdo:
            yield from _try(transfers, cob_id_of(pdo), 1, (current | INVALID_BIT).to_bytes(4, "little"))


def configure_pdo(
    plan: NodePlan, group: Sequence[PlannedWrite], transfers: BootTransfers
) -> Generator[Request, Answer, None]:
    """Read, compare, write and verify one PDO; if refused, use the node's own configuration, else BootError J."""
    current: Held = {}
    try:
        for address in reads_of(group):
            current[address] = yield from transfers.held(*address)
        # An optional setting that the device lacks is not written.
        lacking = [
            write for write in group if write.optional and not is_cob_id(write) and current[write.address] is None
        ]
        planned = [_with_rtr_bit(write, current) for write in group if write not in lacking]
        writes = needed(planned, current)
        refused = yield from _write_pdo(writes, planned, current, transfers)
        if refused is not None and _keep_transmission(plan, refused[0], current, transfers):
            planned = [write for write in planned if write.address != refused[0].address]
            refused = yield from _write_pdo(needed(planned, current), planned, current, transfers)
        refusal = None if refused is None else refused[1]
        if refusal is None and writes:
            refusal = yield from _verify(planned, current, transfers)
        if refusal is not None:
            yield from _refused(plan, planned, current, refusal, transfers)
    except (SdoTimeout, SdoLengthError) as error:
        raise boot_error(
            plan, "J", f"{_name(group)}: 0x{error.index:04X}:{error.subindex:02X}: {reason_of(error)}"
        ) from error


def _keep_transmission(plan: NodePlan, refused: PlannedWrite, current: Held, transfers: BootTransfers) -> bool:
    """Accept the node's transmission type of an RPDO if the node refuses to change that.

    Return whether the refused write was such a transmission type.
    """
    pdo = refused.pdo or ("", 0)
    layout, own = _layout(plan, pdo), current.get(refused.address)
    if pdo[0] != "rpdo" or refused.address != (cob_id_of(pdo), 2) or layout is None or not own:
        return False
    words = f"{_name([refused])} keeps transmission type {own[0]}, which cannot be changed to {refused.data[0]}"
    transfers.warnings.append(words)
    transfers.adopted.append((pdo[0], replace(layout, transmission_type=own[0])))
    return True


def _with_rtr_bit(write: PlannedWrite, current: Held) -> PlannedWrite:
    return replace(write, data=keep_rtr_bit(write.data, current.get(write.address))) if is_cob_id(write) else write


_Refusal = tuple["PlannedWrite", str]


def _write_pdo(
    writes: Sequence[PlannedWrite], planned: Sequence[PlannedWrite], current: Held, transfers: BootTransfers
) -> Generator[Request, Answer, _Refusal | None]:
    """Write a PDO; return the refused write and the reason, None if the node accepted all writes.

    Drives whose COB-IDs cannot be written accept the mapping while the PDO is valid: count 0, mapping, count (Elmo;
    ros-industrial/ros_canopen, issue 151). Other drives need an invalid PDO although their EDS declares the COB-ID
    constant.
    """
    final = final_values(planned)
    refused = yield from _write_all(writes, final, current, transfers)
    cob_id = next((write for write in reversed(planned) if is_cob_id(write)), None)
    if refused is None or cob_id is None:
        return refused
    present = current.get(cob_id.address)
    if is_cob_id(refused[0]):
        if present and not present[-1] & INVALID_BIT >> 24 and not _is_off(cob_id):
            kind, number = cob_id.pdo or ("", 0)
            own = int.from_bytes(present, "little") & 0x7FF
            key = f"{kind}.{number} `cob_id: 0x{own:03X}`"
            return refused[0], f"{refused[1]}; it has 0x{own:03X}: give {key} in bus.yml"
    elif cob_id.fixed:
        off = replace(cob_id, data=(int.from_bytes(cob_id.data, "little") | INVALID_BIT).to_bytes(4, "little"))
        parameters = [write for write in writes if not is_cob_id(write)]
        again = yield from _write_all([off, *parameters, cob_id], {}, current, transfers)
        refused = None if again is None else refused
    return refused


def _is_off(write: PlannedWrite) -> bool:
    """Whether a write sets the invalid bit of a COB-ID (bit 31)."""
    return bool(write.data[-1] & INVALID_BIT >> 24)


def _write_all(
    writes: Sequence[PlannedWrite],
    final: Mapping[tuple[int, int], PlannedWrite],
    current: Held,
    transfers: BootTransfers,
) -> Generator[Request, Answer, _Refusal | None]:
    """Execute writes in order; return the refused write and the reason, None if none was refused.

    The refusal of an object that already has its `final` value is ignored; the result is verified afterwards.
    """
    for write in writes:
        try:
            yield from transfers.write(*write.address, write.data)
        except SdoAbort as error:
            last = final.get(write.address)
            if last is None or not matches(last, current.get(write.address)):
                return write, f"it refuses {write.name} 0x{write.index:04X}:{write.subindex:02X}: {reason_of(error)}"
    return None


def _verify(
    planned: Sequence[PlannedWrite], current: Held, transfers: BootTransfers
) -> Generator[Request, Answer, str | None]:
    """Read written values back; return a text about the first value that differs, None if all are as written."""
    for address, write in final_values(planned).items():
        if current.get(address) is None:
            continue  # cannot be read
        after = yield from transfers.held(*address)
        if after is not None and not matches(write, after):
            place = f"0x{address[0]:04X}:{address[1]:02X}"
            return f"{place} holds 0x{after[::-1].hex()} after 0x{write.data[::-1].hex()} was written"
    return None


def _refused(
    plan: NodePlan, planned: Sequence[PlannedWrite], current: Held, refusal: str, transfers: BootTransfers
) -> Generator[Request, Answer, None]:
    """Use a refused PDO as configured in the node; if that is not possible, BootError J for a needed PDO."""
    pdo = planned[0].pdo or ("", 0)
    layout = _layout(plan, pdo)
    if layout is None:
        if any(write.optional for write in planned):
            state = "stays live"
            if (kept := int.from_bytes(current.get((cob_id_of(pdo), 1)) or b"", "little")) and is_restricted(
                kept & 0x7FF
            ):
                state = f"keeps the COB-ID 0x{kept:X}, which no PDO may have (CiA 301, table 40)"
            transfers.warnings.append(f"{_name(planned)}, which bus.yml does not list, {state}: {refusal}")
        elif (yield from _empty(pdo, transfers)):
            transfers.warnings.append(f"{_name(planned)} is off by an empty mapping: {refusal}")
        else:
            raise boot_error(plan, "J", f"{_name(planned)} cannot be made invalid: {refusal}")
        return
    own = yield from _own(pdo, current, transfers)
    if plan.motors is not None:
        mapped_here = (MappedObject(*entry, _UNSIGNED.get(entry[2], DataType.BOOLEAN)) for entry in own.objects)
        own = replace(own, objects=tuple(entry[:3] for entry in plan.motors.split(mapped_here)))
    if own.cob_id & EXTENDED_BIT or is_restricted(own.cob_id & 0x7FF):
        text = (
            f"{_name(planned)}: {refusal}; its own COB-ID 0x{own.cob_id:X} is none a PDO may have (CiA 301, table 40)"
        )
        raise boot_error(plan, "J", text)
    missing = [mapped for mapped in layout.objects if _address(mapped) not in {entry[:2] for entry in own.objects}]
    if missing or sum(bits for _, _, bits in own.objects) > MAX_BITS:
        yield from _try(transfers, cob_id_of(pdo), 1, (own.cob_id | INVALID_BIT).to_bytes(4, "little"))
        lacks = ", ".join(f"0x{mapped.index:04X}:{mapped.subindex:02X}" for mapped in missing)
        present = yield from transfers.number(cob_id_of(pdo), 1)
        end = "left invalid" if present is None or present & INVALID_BIT else "it stays as it was"
        raise boot_error(plan, "J", f"{_name(planned)}: {refusal}; its own mapping ({own}) lacks {lacks}; {end}")
    own = yield from _enable(plan, planned, own, refusal, transfers)
    by_address = {_address(mapped): mapped for rpdo in (*plan.rpdos, *plan.tpdos) for mapped in rpdo.objects}
    adopted = _adopted(layout, own, by_address)
    transfers.adopted.append((pdo[0], adopted))
    for mapped in adopted.objects if pdo[0] == "rpdo" else ():
        if (
            _address(mapped) not in by_address
            and (value := (yield from transfers.number(*_address(mapped)))) is not None
        ):
            transfers.presets[_address(mapped)] = value
    transfers.warnings.append(f"{_name(planned)} is used as the node has it ({own}): {refusal}")


def _empty(pdo: tuple[str, int], transfers: BootTransfers) -> Generator[Request, Answer, bool]:
    """Clear the mapping of a PDO; return whether the mapping is empty afterwards."""
    mapping = MAPPING[pdo[0]] + pdo[1] - 1
    yield from _try(transfers, mapping, 0, b"\0")
    return (yield from transfers.number(mapping)) == 0


def _own(pdo: tuple[str, int], current: Held, transfers: BootTransfers) -> Generator[Request, Answer, _Own]:
    """Restore the former mapping of a PDO as far as the node accepts that, and return the PDO as read back."""
    communication, mapping = cob_id_of(pdo), MAPPING[pdo[0]] + pdo[1] - 1
    count = current.get((mapping, 0))
    if count is not None and (yield from transfers.held(mapping, 0)) != count:
        for (index, subindex), data in current.items():
            if index == mapping and subindex and data is not None:
                yield from _try(transfers, index, subindex, data)
        yield from _try(transfers, mapping, 0, count)
    objects = []
    for slot in range(1, ((yield from transfers.number(mapping)) or 0) + 1):
        entry = (yield from transfers.number(mapping, slot)) or 0
        objects.append(parse_mapping_entry(entry))
    cob_id = (yield from transfers.number(communication, 1)) or INVALID_BIT
    kind = yield from transfers.number(communication, 2)
    return _Own(cob_id, 255 if kind is None else kind, tuple(objects))


def _enable(
    plan: NodePlan, writes: Sequence[PlannedWrite], own: _Own, refusal: str, transfers: BootTransfers
) -> Generator[Request, Answer, _Own]:
    """Make a PDO with the node's own mapping valid, with the planned COB-ID if accepted; BootError J if impossible."""
    pdo = writes[0].pdo or ("", 0)
    communication = cob_id_of(pdo)
    planned = next(write.data for write in reversed(writes) if is_cob_id(write))
    yield from _try(transfers, communication, 1, (own.cob_id | INVALID_BIT).to_bytes(4, "little"))
    for write in writes:
        if write.index == communication and write.subindex > 1:
            yield from _try(transfers, *write.address, write.data)
    for value in (int.from_bytes(planned, "little"), own.cob_id & ~INVALID_BIT):
        yield from _try(transfers, communication, 1, value.to_bytes(4, "little"))
        present = yield from transfers.number(communication, 1)
        if present is not None and not present & INVALID_BIT:
            kind = yield from transfers.number(communication, 2)
            return replace(own, cob_id=present, transmission_type=own.transmission_type if kind is None else kind)
    raise boot_error(plan, "J", f"{_name(writes)}: {refusal}; it cannot be made valid again")


def _try(transfers: BootTransfers, index: int, subindex: int, data: bytes) -> Generator[Request, Answer, None]:
    try:
        yield from transfers.write(index, subindex, data)
    except SdoAbort:
        return


def _layout(plan: NodePlan, pdo: tuple[str, int]) -> PlannedPdo | None:
    layouts = plan.rpdos if pdo[0] == "rpdo" else plan.tpdos
    return next((layout for layout in layouts if layout.number == pdo[1]), None)


def _adopted(layout: PlannedPdo, own: _Own, by_address: dict[tuple[int, int], MappedObject]) -> PlannedPdo:
    objects = tuple(
        by_address.get((index, subindex)) or MappedObject(index, subindex, bits, _UNSIGNED.get(bits, DataType.BOOLEAN))
        for index, subindex, bits in own.objects
    )
    return PlannedPdo(layout.number, own.cob_id & 0x7FF, own.transmission_type, objects, layout.event_ms)


def _address(mapped: MappedObject) -> tuple[int, int]:
    return mapped.index, mapped.subindex


def _name(group: Sequence[PlannedWrite]) -> str:
    kind, number = group[0].pdo or ("pdo", 0)
    return f"{kind.upper()} {number}"


_FIRST_OBJECT = 0x1000  # smaller indexes are data types, mapped as dummy entries


def read_outputs(plan: NodePlan, transfers: BootTransfers) -> Generator[Request, Answer, None]:
    """Read the initial values of objects in RPDOs, except those that move an axis, into `transfers.presets`.

    A refused object gets 0; BootError J without an answer.
    """
    motion = {index + offset for index in MOTION for offset in plan.axes}
    mapped = {entry[:2]: entry for layout in plan.rpdos for entry in layout.objects}
    outputs = {
        address: output
        for address, output in mapped.items()
        if address not in transfers.presets and output.index not in motion and output.index >= _FIRST_OBJECT
    }
    if outputs:
        yield NextStep("outputs")
    for address, output in outputs.items():
        value = yield from _read_value(plan, output, "which an RPDO carries", transfers)
        transfers.presets[address] = 0 if value is None else value


def read_signals(plan: NodePlan, transfers: BootTransfers) -> Generator[Request, Answer, None]:
    """Read initial values and scales of a device's signals into `transfers.presets`.

    This is necessary because an input that is sent on change may not change for hours. Refused objects are skipped.
    """
    reads = [read for read in plan.reads if _address(read) not in transfers.presets]
    if reads:
        yield NextStep("inputs")
    for request in reads:
        value = yield from _read_value(plan, request, "a signal", transfers)
        if value is not None:
            transfers.presets[_address(request)] = value


def _read_value(
    plan: NodePlan, mapped: MappedObject, title: str, transfers: BootTransfers
) -> Generator[Request, Answer, Value | None]:
    """Read one mapped object, None if the node refuses; BootError J without an answer."""
    index, subindex = _address(mapped)
    try:
        data = yield from transfers.try_read(index, subindex)
    except SdoTimeout as error:
        place = f"0x{index:04X}:{subindex:02X}"
        raise boot_error(plan, "J", f"reading {place}, {title}: {reason_of(error)}") from error
    return None if data is None else value_of(mapped, data)


def value_of(mapped: MappedObject, data: bytes) -> Value | None:
    """Decode SDO data to a value of a mapped object, None if the value does not fit into the mapping."""
    try:
        value = decode(data, mapped.data_type)
        PdoCodec((mapped,)).pack([value])
    except (ValueError, CanopenError):
        return None
    return value


STORE, RESTORE = 0x1010, 0x1011
SAVE = b"save"
STORE_NS = 20_000_000_000  # writing flash memory delays the answer
_SYNC_COUNTER = (0x1006, 0x1019)
_SYNC, _EMCY, _CONSUMER = 0x1005, 0x1014, 0x1016
_FIRST_OWN = 0x2000  # smaller indexes are communication objects
_ABORT_CONNECTION = 0x6007
_INTERPOLATION = frozenset(axis_index(INTERPOLATION_TIME_PERIOD, axis) for axis in range(AXES))
_SUPERVISION = frozenset((0x100C, 0x100D, 0x1016, 0x1017, 0x1029, _ABORT_CONNECTION))


def configure(plan: NodePlan, transfers: BootTransfers) -> Generator[Request, Answer, None]:
    """Configure a node by its plan; BootError J if an essential object cannot be configured."""
    grouped = groups(plan.writes)
    counter = [group for group in grouped if group[0].index in _SYNC_COUNTER]
    for group in counter:  # first, because a SYNC with an unexpected counter causes EMCY 0x8240
        yield from _configure_object(plan, group[0], transfers)
    yield from check_expected(plan, transfers)
    yield from release_cob_ids(grouped, transfers)
    for group in grouped:
        if group in counter:
            continue
        if group[0].pdo is not None:
            yield from configure_pdo(plan, group, transfers)
        elif group[0].index == STORE:
            if transfers.changed:  # else storing is unnecessary, and wears the flash memory
                yield from _write(plan, group[0], transfers)
        else:
            yield from _configure_object(plan, group[0], transfers)


def check_expected(plan: NodePlan, transfers: BootTransfers) -> Generator[Request, Answer, None]:
    """Compare objects on which the scales of bus.yml depend and that are not written; BootError J for a difference.

    Different factors are accepted if they result in the counts per revolution of bus.yml and those of the EDS do not:
    then bus.yml was written for this drive.
    """
    values: dict[tuple[int, int], int] = {}
    by_file: dict[tuple[int, int], int] = {}
    for write in plan.expected:
        data = yield from _present(plan, write, transfers)
        if data is not None:
            values[write.address], by_file[write.address] = (
                int.from_bytes(raw, "little") for raw in (data, write.data)
            )
    for write in plan.expected:
        value, planned = values.get(write.address), by_file.get(write.address)
        if value == planned:
            continue
        index, offset = axis_of(write.index)[0], 0x800 * axis_of(write.index)[1]
        if index != POLARITY and (not value or (_makes(plan, offset, values) and not _makes(plan, offset, by_file))):
            continue  # 0 means not defined by the drive
        line = f"{{index: 0x{write.index:04X}, sub_index: {write.subindex}, value: {value}}}"
        raise boot_error(
            plan,
            "J",
            f"{_what(write)} holds {value}, {plan.source} says {planned}, and bus.yml does not say for which its scale "
            f"was made: add `{line}` under `sdo:` to go on with {value}, or with {planned} to have that written",
        )


def _makes(plan: NodePlan, offset: int, values: Mapping[tuple[int, int], int]) -> bool:
    """Whether encoder, gear and feed factors in `values` result in the counts per revolution of bus.yml."""

    def pair(index: int) -> tuple[int, int] | None:
        pair_values = values.get((index + offset, 1)), values.get((index + offset, 2))
        return None if None in pair_values else (pair_values[0] or 0, pair_values[1] or 0)

    encoder, gear = pair(POSITION_ENCODER_RESOLUTION), pair(GEAR_RATIO)
    turns, feed = plan.turns.get(offset), pair(FEED_CONSTANT)
    try:
        counts = counts_per_revolution(encoder or (1, 1), gear or (1, 1), None if feed == (1, 1) else feed)
    except ConfigError:
        return False
    return turns is not None and math.isclose(counts, turns, rel_tol=1e-3)


def compare_only(plan: NodePlan, transfers: BootTransfers) -> Generator[Request, Answer, list[PlannedWrite]]:
    """Return the writes that a running node would need, without writing anything."""
    missing: list[PlannedWrite] = []
    for group in groups(plan.writes):
        current = yield from _held(group, transfers)
        missing += [write for write in needed(group, current) if write.compare]
    return list(final_values(missing).values())


def watch_running(
    plan: NodePlan, missing: Sequence[PlannedWrite], transfers: BootTransfers
) -> Generator[Request, Answer, list[PlannedWrite]]:
    """Write missing supervision parameters to a running node, and return the other missing writes.

    Master and node must each detect the loss of the other. BootError J if a PDO in use does not match the plan, since
    PDOs cannot be changed while the node is OPERATIONAL.
    """
    used = {("rpdo", rpdo.number) for rpdo in plan.rpdos} | {("tpdo", tpdo.number) for tpdo in plan.tpdos}
    if differs := sorted({write.pdo for write in missing if write.pdo is not None and write.pdo in used}):
        names = ", ".join(f"{kind.upper()} {number}" for kind, number in differs)
        raise boot_error(
            plan,
            "J",
            f"it runs and is to be kept alive, and its {names} is not as in bus.yml: reset_communication: true",
        )
    for write in missing:
        if axis_of(write.index)[0] in _SUPERVISION:
            yield from _configure_object(plan, write, transfers)
    return [write for write in missing if axis_of(write.index)[0] not in _SUPERVISION]


def store(plan: NodePlan, transfers: BootTransfers) -> Generator[Request, Answer, None]:
    """Store the configuration in the node (0x1010) if planned and changed by this boot; a failure is a warning."""
    if not plan.save or not transfers.changed:
        return
    try:
        yield from transfers.write(STORE, plan.save, SAVE, STORE_NS)
    except (SdoAbort, SdoTimeout) as error:
        transfers.warnings.append(f"it cannot store its configuration (0x1010:{plan.save:02X}): {reason_of(error)}")


def _held(
    group: Sequence[PlannedWrite], transfers: BootTransfers
) -> Generator[Request, Answer, dict[tuple[int, int], bytes | None]]:
    values: dict[tuple[int, int], bytes | None] = {}
    for address in reads_of(group):
        values[address] = yield from transfers.held(*address)
    return values


def _configure_object(
    plan: NodePlan, write: PlannedWrite, transfers: BootTransfers
) -> Generator[Request, Answer, None]:
    """Read, compare, write and verify one object; BootError J if an essential object keeps another value."""
    current = None
    if write.compare:
        current = yield from _present(plan, write, transfers)
        if matches(write, current):
            return
    if current is not None and write.index in (_SYNC, _EMCY):
        yield from _release(write, current, transfers)
    if write.index == _CONSUMER:
        yield from _clear_double(plan, write, transfers)
    if not (yield from _write(plan, write, transfers)) or current is None:
        return  # refused and not essential, or not readable
    after = yield from transfers.held(*write.address)
    if after is not None and not matches(write, after):
        _differs(plan, write, after, transfers)


def _release(write: PlannedWrite, current: bytes, transfers: BootTransfers) -> Generator[Request, Answer, None]:
    """Make the COB-ID of SYNC or EMCY changeable, by clearing or setting a bit (CiA 301, 7.5.2.5 and 7.5.2.17)."""
    value = int.from_bytes(current, "little")
    # CiA 301, 7.5.2.5: bit 30 of 0x1005, the device produces SYNC; 7.5.2.17: bit 31 of 0x1014, not valid
    changeable = value & ~PRODUCER_BIT if write.index == _SYNC else value | INVALID_BIT
    if changeable != value and not matches(write, changeable.to_bytes(4, "little")):
        try:
            yield from transfers.write(*write.address, changeable.to_bytes(4, "little"))
        except SdoAbort:
            return  # the write that follows reports the error


def _clear_double(plan: NodePlan, write: PlannedWrite, transfers: BootTransfers) -> Generator[Request, Answer, None]:
    """Clear other entries of 0x1016 for the same node, since devices refuse a second one (CiA 301, 7.5.2.19)."""
    node_id, ms = parse_consumer_entry(int.from_bytes(write.data, "little"))
    if not ms:
        return
    planned = {planned_write.subindex for planned_write in plan.writes if planned_write.index == _CONSUMER}
    subindices = {sub for index, sub in plan.entry_names if index == _CONSUMER and sub} - planned
    for subindex in sorted(subindices):
        entry = yield from transfers.number(_CONSUMER, subindex)
        if entry and parse_consumer_entry(entry)[0] == node_id:
            yield from transfers.write(_CONSUMER, subindex, bytes(4))


def _present(plan: NodePlan, write: PlannedWrite, transfers: BootTransfers) -> Generator[Request, Answer, bytes | None]:
    try:
        return (yield from transfers.held(*write.address))
    except SdoTimeout as error:
        raise boot_error(plan, "J", f"reading {_what(write)}: {reason_of(error)}") from error


def _write(plan: NodePlan, write: PlannedWrite, transfers: BootTransfers) -> Generator[Request, Answer, bool]:
    """Write an object; return False if the node refuses an optional write, BootError J for any other failure."""
    try:
        yield from transfers.write(*write.address, write.data, STORE_NS if write.index in (STORE, RESTORE) else None)
    except (SdoAbort, SdoTimeout) as error:
        if isinstance(error, SdoAbort) and write.optional:
            why = f" ({write.reason})" if write.reason else ""
            transfers.warnings.append(f"it refuses {_what(write)}{why}: {reason_of(error)}")
            return False
        hint = "; `allow_unsupervised: true` with `heartbeat_consumer: false` does without" if _vital(write) else ""
        raise boot_error(plan, "J", f"writing {_what(write)}: {reason_of(error)}{hint}") from error
    return True


def _vital(write: PlannedWrite) -> bool:
    return bool(write.reason) and write.index in _SUPERVISION


def _differs(plan: NodePlan, write: PlannedWrite, after: bytes, transfers: BootTransfers) -> None:
    """Report an object that does not have the written value: BootError J for communication objects, else a warning."""
    text = f"{_what(write)} holds 0x{after[::-1].hex()} after 0x{write.data[::-1].hex()} was written"
    if (write.index < _FIRST_OWN and write.index != _EMCY) or axis_of(write.index)[0] == _ABORT_CONNECTION:
        raise boot_error(plan, "J", text)
    why = "; the node limits or rounds it"
    if write.index in _INTERPOLATION:
        why = "; the node rounds it: positions are interpolated over another time than SYNC's; take another sync_period"
    transfers.warnings.append(text + why)


def _what(write: PlannedWrite) -> str:
    return f"{write.name} 0x{write.index:04X}:{write.subindex:02X}"
