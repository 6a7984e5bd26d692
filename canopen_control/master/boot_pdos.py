"""The PDOs of a node during its boot: made what the plan says, used as the node has them, or left invalid (CiA 301).

The law of this file (CiA 301, 7.5.2.35): a PDO is read before it is written, written in the standard's order (invalid,
settings, mapping, valid), and read back. If the node refuses (a constant COB-ID, a mapping that cannot be written) what
it had is put back, and used if it carries every object the plan wants there; an RPDO's others stay at what they are.
Else the PDO is left invalid and the boot fails with the objects that are missing.

An RPDO is sent as a whole, so that each object in it needs a value before the first is written: what nobody writes
stays as the node has it (`read_outputs`), and counts as 0 where the node does not show it. What moves an axis is not
among them, it begins at rest (`boot`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from canopen_control.cia301.pdo import (
    INVALID_BIT,
    MAX_BITS,
    MappedObject,
    PdoCodec,
    parse_mapping_entry,
)
from canopen_control.cia402.objects import MOTION
from canopen_control.errors import CanopenError, SdoAbort, SdoLengthError, SdoTimeout
from canopen_control.frame import EXTENDED_BIT, is_restricted
from canopen_control.master.compare import (
    cob_id_of,
    final_values,
    is_cob_id,
    keep_rtr_bit,
    matches,
    needed,
    reads_of,
)
from canopen_control.master.plan_builder import PdoLayout
from canopen_control.master.plan_pdos import MAPPING
from canopen_control.master.requests import Answer, BootTransfers, Request, Step, boot_error, reason_of
from canopen_control.od.codec import decode
from canopen_control.od.model import DataType

if TYPE_CHECKING:
    from collections.abc import Generator, Sequence

    from canopen_control.master.plan import NodePlan
    from canopen_control.master.plan_builder import PlannedWrite
    from canopen_control.od.model import Value

__all__ = ["configure_pdo", "read_outputs", "read_signals", "release_cob_ids", "value_of"]

Held = dict[tuple[int, int], bytes | None]
_UNSIGNED = {kind.bits: kind for kind in DataType if kind.name.startswith("UNSIGNED")}


@dataclass(frozen=True, slots=True)
class _Own:
    """A PDO as the node has it."""

    cob_id: int
    transmission_type: int
    objects: tuple[tuple[int, int, int], ...]  # index, subindex, bits

    def __str__(self) -> str:
        return ", ".join(f"0x{index:04X}:{subindex:02X}" for index, subindex, _ in self.objects) or "nothing"


def release_cob_ids(
    grouped: Sequence[Sequence[PlannedWrite]], transfers: BootTransfers
) -> Generator[Request, Answer, None]:
    """Make the PDOs invalid that hold the identifier which another one is to have: two users of one are refused.

    Devices check that when a PDO becomes valid (maxon EPOS4 among them).
    """
    final = {
        group[0].pdo: int.from_bytes(next(write.data for write in reversed(group) if is_cob_id(write)), "little")
        for group in grouped
        if group[0].pdo is not None and any(is_cob_id(write) for write in group)
    }
    wanted = {value & 0x7FF: pdo for pdo, value in final.items() if not value & INVALID_BIT}
    for pdo in final:
        if pdo is None:
            continue
        try:
            data = yield from transfers.held(cob_id_of(pdo), 1)
        except SdoTimeout:
            return  # told when the PDO is configured
        held = INVALID_BIT if data is None else int.from_bytes(data, "little")
        if not held & INVALID_BIT and wanted.get(held & 0x7FF, pdo) != pdo:
            yield from _try(transfers, cob_id_of(pdo), 1, (held | INVALID_BIT).to_bytes(4, "little"))


def configure_pdo(
    plan: NodePlan, group: Sequence[PlannedWrite], transfers: BootTransfers
) -> Generator[Request, Answer, None]:
    """Read, compare, write and verify the writes of one PDO; adopt what the node has where it refuses. BootError J."""
    held: Held = {}
    try:
        for address in reads_of(group):
            held[address] = yield from transfers.held(*address)
        # A setting that nothing asks for, and that the device does not have, is none of it.
        lacking = [write for write in group if write.optional and not is_cob_id(write) and held[write.address] is None]
        wanted = [_with_rtr_bit(write, held) for write in group if write not in lacking]
        writes = needed(wanted, held)
        refusal = yield from _write_all(writes, transfers)
        if refusal is None and writes:
            refusal = yield from _verify(wanted, held, transfers)
        if refusal is not None:
            yield from _refused(plan, wanted, held, refusal, transfers)
    except (SdoTimeout, SdoLengthError) as error:
        raise boot_error(
            plan, "J", f"{_name(group)}: 0x{error.index:04X}:{error.subindex:02X}: {reason_of(error)}"
        ) from error


def _with_rtr_bit(write: PlannedWrite, held: Held) -> PlannedWrite:
    return replace(write, data=keep_rtr_bit(write.data, held.get(write.address))) if is_cob_id(write) else write


def _write_all(writes: Sequence[PlannedWrite], transfers: BootTransfers) -> Generator[Request, Answer, str | None]:
    """Write in order; return why the node refused, None if it did not."""
    for write in writes:
        try:
            yield from transfers.write(*write.address, write.data)
        except SdoAbort as error:
            return f"it refuses {write.name} 0x{write.index:04X}:{write.subindex:02X}: {reason_of(error)}"
    return None


def _verify(
    wanted: Sequence[PlannedWrite], held: Held, transfers: BootTransfers
) -> Generator[Request, Answer, str | None]:
    """Read back what was written; return what the node did not keep."""
    for address, write in final_values(wanted).items():
        if held.get(address) is None:
            continue  # cannot be read
        after = yield from transfers.held(*address)
        if after is not None and not matches(write, after):
            where = f"0x{address[0]:04X}:{address[1]:02X}"
            return f"{where} holds 0x{after[::-1].hex()} after 0x{write.data[::-1].hex()} was written"
    return None


def _refused(
    plan: NodePlan, wanted: Sequence[PlannedWrite], held: Held, refusal: str, transfers: BootTransfers
) -> Generator[Request, Answer, None]:
    """Fall back to the node's own PDO, or leave it invalid."""
    pdo = wanted[0].pdo or ("", 0)
    layout = _layout(plan, pdo)
    if layout is None:
        if not any(write.optional for write in wanted):
            raise boot_error(plan, "J", f"{_name(wanted)} cannot be made invalid: {refusal}")
        transfers.warnings.append(f"{_name(wanted)}, which nobody configured, stays live: {refusal}")
        return
    own = yield from _own(pdo, held, transfers)
    if own.cob_id & EXTENDED_BIT or is_restricted(own.cob_id & 0x7FF):
        text = f"{_name(wanted)}: {refusal}; its own COB-ID 0x{own.cob_id:X} is none a PDO may have (CiA 301, table 42)"
        raise boot_error(plan, "J", text)
    missing = [mapped for mapped in layout.objects if _address(mapped) not in {each[:2] for each in own.objects}]
    if missing or sum(bits for _, _, bits in own.objects) > MAX_BITS:
        yield from _try(transfers, cob_id_of(pdo), 1, (own.cob_id | INVALID_BIT).to_bytes(4, "little"))
        lacks = ", ".join(f"0x{mapped.index:04X}:{mapped.subindex:02X}" for mapped in missing)
        raise boot_error(plan, "J", f"{_name(wanted)}: {refusal}; its own mapping ({own}) lacks {lacks}; left invalid")
    own = yield from _enable(plan, wanted, own, refusal, transfers)
    known = {_address(mapped): mapped for each in (*plan.rpdos, *plan.tpdos) for mapped in each.objects}
    adopted = _adopted(layout, own, known)
    transfers.adopted.append((pdo[0], adopted))
    for mapped in adopted.objects if pdo[0] == "rpdo" else ():
        if _address(mapped) not in known and (value := (yield from transfers.number(*_address(mapped)))) is not None:
            transfers.presets[_address(mapped)] = value
    transfers.warnings.append(f"{_name(wanted)} is used as the node has it ({own}): {refusal}")


def _own(pdo: tuple[str, int], held: Held, transfers: BootTransfers) -> Generator[Request, Answer, _Own]:
    """Put back what the mapping was, as far as the node lets it, and read the PDO as it is."""
    communication, mapping = cob_id_of(pdo), MAPPING[pdo[0]] + pdo[1] - 1
    count = held.get((mapping, 0))
    if count is not None and (yield from transfers.held(mapping, 0)) != count:
        for (index, subindex), data in held.items():
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
    plan: NodePlan, wanted: Sequence[PlannedWrite], own: _Own, refusal: str, transfers: BootTransfers
) -> Generator[Request, Answer, _Own]:
    """Make the node's own PDO valid, under the planned COB-ID if it takes that, else under its own."""
    pdo = wanted[0].pdo or ("", 0)
    communication = cob_id_of(pdo)
    planned = next(write.data for write in reversed(wanted) if is_cob_id(write))
    yield from _try(transfers, communication, 1, (own.cob_id | INVALID_BIT).to_bytes(4, "little"))
    for write in wanted:
        if write.index == communication and write.subindex > 1:
            yield from _try(transfers, *write.address, write.data)
    for value in (int.from_bytes(planned, "little"), own.cob_id & ~INVALID_BIT):
        yield from _try(transfers, communication, 1, value.to_bytes(4, "little"))
        present = yield from transfers.number(communication, 1)
        if present is not None and not present & INVALID_BIT:
            kind = yield from transfers.number(communication, 2)
            return replace(own, cob_id=present, transmission_type=own.transmission_type if kind is None else kind)
    raise boot_error(plan, "J", f"{_name(wanted)}: {refusal}; it cannot be made valid again")


def _try(transfers: BootTransfers, index: int, subindex: int, data: bytes) -> Generator[Request, Answer, None]:
    try:
        yield from transfers.write(index, subindex, data)
    except SdoAbort:
        return


def _layout(plan: NodePlan, pdo: tuple[str, int]) -> PdoLayout | None:
    layouts = plan.rpdos if pdo[0] == "rpdo" else plan.tpdos
    return next((each for each in layouts if each.number == pdo[1]), None)


def _adopted(layout: PdoLayout, own: _Own, known: dict[tuple[int, int], MappedObject]) -> PdoLayout:
    objects = tuple(
        known.get((index, subindex)) or MappedObject(index, subindex, bits, _UNSIGNED.get(bits, DataType.BOOLEAN))
        for index, subindex, bits in own.objects
    )
    return PdoLayout(layout.number, own.cob_id & 0x7FF, own.transmission_type, objects, layout.event_ms)


def _address(mapped: MappedObject) -> tuple[int, int]:
    return mapped.index, mapped.subindex


def _name(group: Sequence[PlannedWrite]) -> str:
    kind, number = group[0].pdo or ("pdo", 0)
    return f"{kind.upper()} {number}"


_FIRST_OBJECT = 0x1000  # below it are the types, which fill gaps


def read_outputs(plan: NodePlan, transfers: BootTransfers) -> Generator[Request, Answer, None]:
    """Read what the RPDOs begin with, axes apart, into `transfers.presets`; BootError J for a silent node."""
    motion = {index + offset for index in MOTION for offset in plan.axes}
    mapped = {each[:2]: each for layout in plan.rpdos for each in layout.objects}
    wanted = {
        address: each
        for address, each in mapped.items()
        if address not in transfers.presets and each.index not in motion and each.index >= _FIRST_OBJECT
    }
    if wanted:
        yield Step("outputs")
    for address, each in wanted.items():
        value = yield from _read_value(plan, each, "which an RPDO carries", transfers)
        transfers.presets[address] = 0 if value is None else value


def read_signals(plan: NodePlan, transfers: BootTransfers) -> Generator[Request, Answer, None]:
    """Read what the inputs of a device begin with and how it scales them, into `transfers.presets`.

    An input that is sent when it changes may not change for hours. What the node does not show is left out.
    """
    wanted = [each for each in plan.reads if _address(each) not in transfers.presets]
    if wanted:
        yield Step("inputs")
    for each in wanted:
        value = yield from _read_value(plan, each, "a signal", transfers)
        if value is not None:
            transfers.presets[_address(each)] = value


def _read_value(
    plan: NodePlan, mapped: MappedObject, what: str, transfers: BootTransfers
) -> Generator[Request, Answer, Value | None]:
    """Read one object, None where the node does not show it; BootError J for a silent node."""
    index, subindex = _address(mapped)
    try:
        data = yield from transfers.try_read(index, subindex)
    except SdoTimeout as error:
        where = f"0x{index:04X}:{subindex:02X}"
        raise boot_error(plan, "J", f"reading {where}, {what}: {reason_of(error)}") from error
    return None if data is None else value_of(mapped, data)


def value_of(mapped: MappedObject, data: bytes) -> Value | None:
    """Return the value that an RPDO packs for what SDO transfers as `data`; None where it cannot be one."""
    try:
        value = decode(data, mapped.data_type)
        PdoCodec((mapped,)).pack([value])
    except (ValueError, CanopenError):
        return None
    return value
