"""PDOs of a node during its boot: reading, comparing, writing and verifying (CiA 302-2, configuration; CiA 301, 7.2.2).

A PDO that cannot be configured as planned is used with the node's own mapping if that contains all needed objects; else
the PDO is left invalid.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import groupby
from typing import TYPE_CHECKING

from canopen_control.cia301.pdo import INVALID_BIT, MAX_BITS, NO_RTR_BIT, MappedObject, parse_mapping_entry
from canopen_control.errors import SdoAbort, SdoLengthError, SdoTimeout
from canopen_control.frame import EXTENDED_BIT, is_restricted
from canopen_control.master.plan_builder import PlannedPdo
from canopen_control.master.requests import Answer, BootTransfers, Request, boot_error, reason_of
from canopen_control.od.model import DataType
from canopen_control.od.pdos import COMMUNICATION, MAPPING

if TYPE_CHECKING:
    from collections.abc import Generator, Mapping, Sequence

    from canopen_control.master.plan import NodePlan
    from canopen_control.master.plan_builder import PlannedWrite

# Comparison of a plan with the values in a node: differences, and the writes that remove them.
#
# The writes of one PDO form a group, and every other write is a separate group. Bit 30 of a PDO's COB-ID belongs to the
# device and is never a difference; for a PDO that is planned as invalid only bit 31 is compared. Values are compared
# in the type of the object, so that an object that a drive answers with more bytes than the EDS declares is not written
# again at each boot.


_TEXT = (DataType.VISIBLE_STRING, DataType.UNICODE_STRING)
_COB_ID = 1  # subindex of a communication record
_INVALID = INVALID_BIT.to_bytes(4, "little")


def groups(writes: Sequence[PlannedWrite]) -> list[list[PlannedWrite]]:
    """Group writes in order: the writes of each PDO in one list, every other write in its own list."""
    grouped: list[list[PlannedWrite]] = []
    for pdo, members in groupby(writes, key=lambda write: write.pdo):
        group = list(members)
        grouped += [[write] for write in group] if pdo is None else [group]
    return grouped


def is_cob_id(write: PlannedWrite) -> bool:
    """Whether a write changes the COB-ID of a PDO."""
    return write.pdo is not None and write.index == cob_id_of(write.pdo) and write.subindex == _COB_ID


def cob_id_of(pdo: tuple[str, int]) -> int:
    """Return the index of the object whose subindex 1 is a PDO's COB-ID, its communication record."""
    return COMMUNICATION[pdo[0]] + pdo[1] - 1


def final_values(group: Sequence[PlannedWrite]) -> dict[tuple[int, int], PlannedWrite]:
    """Return the last write to each address, by address; it has the final value."""
    return {write.address: write for write in group}


def reads_of(group: Sequence[PlannedWrite]) -> list[tuple[int, int]]:
    """Return the addresses of a group that must be read and compared before writing."""
    return [address for address, write in final_values(group).items() if write.compare]


def keep_rtr_bit(planned: bytes, current: bytes | None) -> bytes:
    """Return the planned COB-ID with bit 30 (no RTR) copied from the COB-ID in the device."""
    if current is None or len(current) != len(planned):
        return planned
    value, device = int.from_bytes(planned, "little"), int.from_bytes(current, "little")
    return (value & ~NO_RTR_BIT | device & NO_RTR_BIT).to_bytes(len(planned), "little")


def matches(write: PlannedWrite, current: bytes | None) -> bool:
    """Whether the `current` value in the node equals the value of a write."""
    if current is None:
        return False
    if is_cob_id(write):
        planned, device = int.from_bytes(write.data, "little"), int.from_bytes(current, "little")
        # CiA 301, 7.5.2.35 and 7.5.2.37: bit 31 makes a PDO invalid; the other bits have no effect then
        if planned & INVALID_BIT:
            return bool(device & INVALID_BIT)
        return planned & ~NO_RTR_BIT == device & ~NO_RTR_BIT
    if current == write.data:
        return True
    if write.data_type in _TEXT:
        return current.rstrip(b"\0") == write.data.rstrip(b"\0")
    if write.data_type is None or not write.data_type.is_integer:
        return False
    signed = write.data_type.signed
    return int.from_bytes(current, "little", signed=signed) == int.from_bytes(write.data, "little", signed=signed)


def needed_writes(group: Sequence[PlannedWrite], current: Mapping[tuple[int, int], bytes | None]) -> list[PlannedWrite]:
    """Return the writes of a group that the `current` values require, in order; [] if nothing differs."""
    final = final_values(group)
    different = {
        address for address, write in final.items() if not write.compare or not matches(write, current.get(address))
    }
    if not different:
        return []
    if group[0].pdo is None:
        return list(group)
    communication = cob_id_of(group[0].pdo)
    remaps = any(index != communication for index, _ in different)
    return [write for write in group if _is_needed(write, communication, remaps, different, current)]


def _is_needed(
    write: PlannedWrite,
    communication: int,
    remaps: bool,
    different: set[tuple[int, int]],
    current: Mapping[tuple[int, int], bytes | None],
) -> bool:
    """Whether a write belongs to the sequence that makes a PDO invalid, changes it, and makes it valid again."""
    if write.index != communication:
        # CiA 301, 7.5.2.36: number of objects 0, entries, number of objects
        return remaps  # a mapping is always written completely
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


DeviceValues = dict[tuple[int, int], bytes | None]
_UNSIGNED = {kind.bits: kind for kind in DataType if kind.name.startswith("UNSIGNED")}


@dataclass(frozen=True, slots=True)
class _DevicePdo:
    """Configuration of a PDO as read from the node."""

    cob_id: int
    transmission_type: int
    objects: tuple[tuple[int, int, int], ...]  # index, subindex, bits

    def __str__(self) -> str:
        return ", ".join(f"0x{index:04X}:{subindex:02X}" for index, subindex, _ in self.objects) or "nothing"


def release_cob_ids(
    grouped: Sequence[Sequence[PlannedWrite]], transfers: BootTransfers
) -> Generator[Request, Answer, DeviceValues]:
    """Invalidate all PDOs that use a COB-ID planned for another PDO; return the COB-IDs read and left unchanged.

    Some devices, such as the maxon EPOS4, refuse to make a PDO valid if another valid PDO has the same COB-ID.
    """
    final = {
        group[0].pdo: int.from_bytes(next(write.data for write in reversed(group) if is_cob_id(write)), "little")
        for group in grouped
        if group[0].pdo is not None and any(is_cob_id(write) for write in group)
    }
    claimed = {value & 0x7FF: pdo for pdo, value in final.items() if not value & INVALID_BIT}
    read_values: DeviceValues = {}
    for pdo in final:
        if pdo is None:
            continue
        address = cob_id_of(pdo), _COB_ID
        try:
            read_values[address] = yield from transfers.read_optional(*address)
        except SdoTimeout:
            break  # reported when the PDO is configured
        current = int.from_bytes(read_values[address] or _INVALID, "little")
        if not current & INVALID_BIT and claimed.get(current & 0x7FF, pdo) != pdo:
            del read_values[address]
            yield from _write_unless_refused(transfers, *address, (current | INVALID_BIT).to_bytes(4, "little"))
    return read_values


def configure_pdo(
    plan: NodePlan, group: Sequence[PlannedWrite], transfers: BootTransfers, read_values: DeviceValues
) -> Generator[Request, Answer, None]:
    """Read, compare, write and verify one PDO; if the node refuses a write, use its own configuration.

    Raise BootError J if that is unusable, too, or if the node does not answer.
    Values in `read_values` were already read in this boot, and are not read again.
    """
    current: DeviceValues = {}
    try:
        for address in reads_of(group):
            current[address] = (
                read_values[address] if address in read_values else (yield from transfers.read_optional(*address))
            )
        # An optional setting that is absent in the device is not written.
        absent = [
            write
            for write in group
            if write.optional and not is_cob_id(write) and current.get(write.address, b"") is None
        ]
        planned = [_with_rtr_bit(write, current) for write in group if write not in absent]
        writes = needed_writes(planned, current)
        refused = yield from _write_pdo(writes, planned, current, transfers)
        if refused is not None and _keep_transmission(plan, refused[0], current, transfers):
            planned = [write for write in planned if write.address != refused[0].address]
            refused = yield from _write_pdo(needed_writes(planned, current), planned, current, transfers)
        refusal = None if refused is None else refused[1]
        if refusal is None and writes:
            refusal = yield from _verify(planned, current, transfers)
        if refusal is not None:
            yield from _use_own_or_disable(plan, planned, current, refusal, transfers)
    except (SdoTimeout, SdoLengthError) as error:
        raise boot_error(
            plan, "J", f"{_name(group)}: 0x{error.index:04X}:{error.subindex:02X}: {reason_of(error)}"
        ) from error


def _keep_transmission(plan: NodePlan, refused: PlannedWrite, current: DeviceValues, transfers: BootTransfers) -> bool:
    """Accept the transmission type of an RPDO if the node refuses to change it.

    Return whether the refused write was such a transmission type.
    """
    pdo = refused.pdo or ("", 0)
    layout, device = _layout(plan, pdo), current.get(refused.address)
    if pdo[0] != "rpdo" or refused.address != (cob_id_of(pdo), 2) or layout is None or not device:
        return False
    words = f"{_name([refused])} keeps transmission type {device[0]}, which cannot be changed to {refused.data[0]}"
    transfers.warnings.append(words)
    transfers.adopted.append((pdo[0], replace(layout, transmission_type=device[0])))
    return True


def _with_rtr_bit(write: PlannedWrite, current: DeviceValues) -> PlannedWrite:
    return replace(write, data=keep_rtr_bit(write.data, current.get(write.address))) if is_cob_id(write) else write


_Refusal = tuple["PlannedWrite", str]


def _write_pdo(
    writes: Sequence[PlannedWrite], planned: Sequence[PlannedWrite], current: DeviceValues, transfers: BootTransfers
) -> Generator[Request, Answer, _Refusal | None]:
    """Write a PDO; return the refused write and the reason, or None if the node accepted all writes.

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
            device = int.from_bytes(present, "little") & 0x7FF
            key = f"{kind}.{number} `cob_id: 0x{device:03X}`"
            return refused[0], f"{refused[1]}; its COB-ID is 0x{device:03X}: set {key} in bus.yml"
    elif cob_id.fixed:
        off = replace(cob_id, data=(int.from_bytes(cob_id.data, "little") | INVALID_BIT).to_bytes(4, "little"))
        parameters = [write for write in writes if not is_cob_id(write)]
        refused_again = yield from _write_all([off, *parameters, cob_id], {}, current, transfers)
        refused = None if refused_again is None else refused
    return refused


def _is_off(write: PlannedWrite) -> bool:
    return bool(write.data[-1] & INVALID_BIT >> 24)


def _write_all(
    writes: Sequence[PlannedWrite],
    final: Mapping[tuple[int, int], PlannedWrite],
    current: DeviceValues,
    transfers: BootTransfers,
) -> Generator[Request, Answer, _Refusal | None]:
    """Execute writes in order; return the refused write and the reason, or None.

    The refusal of an object that already has its `final` value is ignored; the result is verified afterwards.
    """
    for write in writes:
        try:
            yield from transfers.write(*write.address, write.data)
        except SdoAbort as error:
            last = final.get(write.address)
            if last is None or not matches(last, current.get(write.address)):
                return write, f"it refuses {write.label}: {reason_of(error)}"
    return None


def _verify(
    planned: Sequence[PlannedWrite], current: DeviceValues, transfers: BootTransfers
) -> Generator[Request, Answer, str | None]:
    """Read written values back; return a text about the first value that differs, or None."""
    for address, write in final_values(planned).items():
        if current.get(address) is None:
            continue  # cannot be read
        after = yield from transfers.read_optional(*address)
        if after is not None and not matches(write, after):
            place = f"0x{address[0]:04X}:{address[1]:02X}"
            return f"{place} holds 0x{after[::-1].hex()} after 0x{write.data[::-1].hex()} was written"
    return None


def _use_own_or_disable(
    plan: NodePlan, planned: Sequence[PlannedWrite], current: DeviceValues, refusal: str, transfers: BootTransfers
) -> Generator[Request, Answer, None]:
    """Use the node's own configuration of a refused PDO; raise BootError J if a required PDO cannot work with it."""
    pdo = planned[0].pdo or ("", 0)
    layout = _layout(plan, pdo)
    if layout is None:
        if any(write.optional for write in planned):
            state = "remains valid"
            if (kept := int.from_bytes(current.get((cob_id_of(pdo), 1)) or b"", "little")) and is_restricted(
                kept & 0x7FF
            ):
                state = f"keeps the COB-ID 0x{kept:X}, which is not allowed for PDOs (CiA 301, table 40)"
            transfers.warnings.append(f"{_name(planned)}, which bus.yml does not list, {state}: {refusal}")
        elif (yield from _clear_mapping(pdo, transfers)):
            transfers.warnings.append(f"{_name(planned)} is disabled by an empty mapping: {refusal}")
        else:
            raise boot_error(plan, "J", f"{_name(planned)} cannot be made invalid: {refusal}")
        return
    device = yield from _restore_own(pdo, current, transfers)
    if plan.motors is not None:
        device_mapping = (MappedObject(*entry, _UNSIGNED.get(entry[2], DataType.BOOLEAN)) for entry in device.objects)
        device = replace(device, objects=tuple(entry[:3] for entry in plan.motors.split(device_mapping)))
    # CiA 301, 7.3.5: restricted identifiers
    if device.cob_id & EXTENDED_BIT or is_restricted(device.cob_id & 0x7FF):
        text = f"its own COB-ID 0x{device.cob_id:X} is not allowed for PDOs (CiA 301, table 40)"
        raise boot_error(plan, "J", f"{_name(planned)}: {refusal}; {text}")
    missing = [mapped for mapped in layout.objects if address_of(mapped) not in {entry[:2] for entry in device.objects}]
    if missing or sum(bits for _, _, bits in device.objects) > MAX_BITS:
        yield from _write_unless_refused(
            transfers, cob_id_of(pdo), 1, (device.cob_id | INVALID_BIT).to_bytes(4, "little")
        )
        lacks = ", ".join(f"0x{mapped.index:04X}:{mapped.subindex:02X}" for mapped in missing)
        present = yield from transfers.number(cob_id_of(pdo), 1)
        outcome = "the PDO is invalid now" if present is None or present & INVALID_BIT else "the PDO is unchanged"
        raise boot_error(plan, "J", f"{_name(planned)}: {refusal}; its own mapping ({device}) lacks {lacks}; {outcome}")
    device = yield from _enable(plan, planned, device, refusal, transfers)
    by_address = {address_of(mapped): mapped for each in (*plan.rpdos, *plan.tpdos) for mapped in each.objects}
    adopted = _adopted(layout, device, by_address)
    transfers.adopted.append((pdo[0], adopted))
    for mapped in adopted.objects if pdo[0] == "rpdo" else ():
        if (
            address_of(mapped) not in by_address
            and (value := (yield from transfers.number(*address_of(mapped)))) is not None
        ):
            transfers.presets[address_of(mapped)] = value
    transfers.warnings.append(f"{_name(planned)} is used with the node's own mapping ({device}): {refusal}")


def _clear_mapping(pdo: tuple[str, int], transfers: BootTransfers) -> Generator[Request, Answer, bool]:
    """Clear the mapping of a PDO; return whether the mapping is now empty."""
    mapping = MAPPING[pdo[0]] + pdo[1] - 1
    yield from _write_unless_refused(transfers, mapping, 0, b"\0")
    return (yield from transfers.number(mapping)) == 0


def _restore_own(
    pdo: tuple[str, int], current: DeviceValues, transfers: BootTransfers
) -> Generator[Request, Answer, _DevicePdo]:
    """Restore the previous mapping of a PDO as far as the node accepts it; return the PDO as read back."""
    communication, mapping = cob_id_of(pdo), MAPPING[pdo[0]] + pdo[1] - 1
    count = current.get((mapping, 0))
    if count is not None and (yield from transfers.read_optional(mapping, 0)) != count:
        for (index, subindex), data in current.items():
            if index == mapping and subindex and data is not None:
                yield from _write_unless_refused(transfers, index, subindex, data)
        yield from _write_unless_refused(transfers, mapping, 0, count)
    objects = []
    for slot in range(1, ((yield from transfers.number(mapping)) or 0) + 1):
        mapped = parse_mapping_entry((yield from transfers.number(mapping, slot)) or 0)
        if mapped[2]:  # an entry of 0 maps nothing, as in a plan
            objects.append(mapped)
    cob_id = (yield from transfers.number(communication, 1)) or INVALID_BIT
    kind = yield from transfers.number(communication, 2)
    return _DevicePdo(cob_id, 255 if kind is None else kind, tuple(objects))


def _enable(
    plan: NodePlan, writes: Sequence[PlannedWrite], device: _DevicePdo, refusal: str, transfers: BootTransfers
) -> Generator[Request, Answer, _DevicePdo]:
    """Make a PDO valid with the mapping in the node, at the planned COB-ID or, if refused, at the COB-ID it had.

    Return the PDO as read back; raise BootError J if the node accepts neither COB-ID.
    """
    pdo = writes[0].pdo or ("", 0)
    communication = cob_id_of(pdo)
    planned = next(write.data for write in reversed(writes) if is_cob_id(write))
    yield from _write_unless_refused(transfers, communication, 1, (device.cob_id | INVALID_BIT).to_bytes(4, "little"))
    for write in writes:
        if write.index == communication and write.subindex > 1:
            yield from _write_unless_refused(transfers, *write.address, write.data)
    for value in (int.from_bytes(planned, "little"), device.cob_id & ~INVALID_BIT):
        yield from _write_unless_refused(transfers, communication, 1, value.to_bytes(4, "little"))
        present = yield from transfers.number(communication, 1)
        if present is not None and not present & INVALID_BIT:
            kind = yield from transfers.number(communication, 2)
            return replace(device, cob_id=present, transmission_type=device.transmission_type if kind is None else kind)
    raise boot_error(plan, "J", f"{_name(writes)}: {refusal}; it cannot be made valid again")


def _write_unless_refused(
    transfers: BootTransfers, index: int, subindex: int, data: bytes
) -> Generator[Request, Answer, None]:
    """Write an object; an abort by the node has no effect."""
    try:
        yield from transfers.write(index, subindex, data)
    except SdoAbort:
        return


def _layout(plan: NodePlan, pdo: tuple[str, int]) -> PlannedPdo | None:
    layouts = plan.rpdos if pdo[0] == "rpdo" else plan.tpdos
    return next((layout for layout in layouts if layout.number == pdo[1]), None)


def _adopted(layout: PlannedPdo, device: _DevicePdo, by_address: dict[tuple[int, int], MappedObject]) -> PlannedPdo:
    objects = tuple(
        by_address.get((index, subindex)) or MappedObject(index, subindex, bits, _UNSIGNED.get(bits, DataType.BOOLEAN))
        for index, subindex, bits in device.objects
    )
    return PlannedPdo(layout.number, device.cob_id & 0x7FF, device.transmission_type, objects, layout.event_ms)


def address_of(mapped: MappedObject) -> tuple[int, int]:
    """Return the index and subindex of a mapped object."""
    return mapped.index, mapped.subindex


def _name(group: Sequence[PlannedWrite]) -> str:
    kind, number = group[0].pdo or ("pdo", 0)
    return f"{kind.upper()} {number}"
