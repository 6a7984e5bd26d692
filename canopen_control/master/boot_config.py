"""Configuration of a node during its boot: reading, comparing, writing and verifying objects (CiA 302-2).

Values that the node already has are not written, and written values are read back. If the node then has another value,
the boot fails for communication objects and 0x6007; for objects of the drive (such as a ramp that the drive limits)
this is only a warning. PDOs are configured by `boot_pdos`.

An RPDO is always sent completely, so that every mapped object needs a value before the first transmission: objects
that nothing commands keep the node's value (`read_outputs`), or are 0 if the node does not allow reading. This does
not apply to objects that move an axis, whose initial values are set in `boot`.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from canopen_control.cia301.heartbeat import parse_consumer_entry
from canopen_control.cia301.pdo import INVALID_BIT, MappedObject, PdoCodec
from canopen_control.cia301.sync import PRODUCER_BIT
from canopen_control.cia402.objects import (
    ABORT_CONNECTION_OPTION,
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
from canopen_control.errors import CanopenError, ConfigError, SdoAbort, SdoTimeout
from canopen_control.master.boot_pdos import (
    address_of,
    configure_pdo,
    final_values,
    groups,
    matches,
    needed_writes,
    reads_of,
    release_cob_ids,
)
from canopen_control.master.plan import SUPERVISION
from canopen_control.master.requests import Answer, BootTransfers, NextStep, Request, boot_error, reason_of
from canopen_control.od.codec import decode
from canopen_control.od.indices import (
    COB_ID_EMCY,
    COB_ID_SYNC,
    CYCLE_PERIOD,
    FIRST_OBJECT,
    HEARTBEAT_CONSUMER,
    RESTORE,
    STORE,
    SYNC_OVERFLOW,
)

if TYPE_CHECKING:
    from collections.abc import Generator, Mapping, Sequence

    from canopen_control.master.plan import NodePlan
    from canopen_control.master.plan_builder import PlannedWrite
    from canopen_control.od.model import Value


def read_outputs(plan: NodePlan, transfers: BootTransfers) -> Generator[Request, Answer, None]:
    """Read the initial values of RPDO objects into `transfers.presets`, except objects that move an axis.

    A refused object gets 0. Raise BootError J if the node does not answer.
    """
    motion = {index + offset for index in MOTION for offset in plan.axes}
    mapped = {entry[:2]: entry for layout in plan.rpdos for entry in layout.objects}
    outputs = {
        address: output
        for address, output in mapped.items()
        if address not in transfers.presets and output.index not in motion and output.index >= FIRST_OBJECT
    }
    if outputs:
        yield NextStep("outputs")
    for address, output in outputs.items():
        value = yield from _read_value(plan, output, "mapped into an RPDO", transfers)
        transfers.presets[address] = 0 if value is None else value


def read_signals(plan: NodePlan, transfers: BootTransfers) -> Generator[Request, Answer, None]:
    """Read the initial values and scales of a device's signals into `transfers.presets`.

    This is necessary because an input that is sent on change may stay the same for hours. Refused objects are skipped.
    """
    reads = [read for read in plan.reads if address_of(read) not in transfers.presets]
    if reads:
        yield NextStep("inputs")
    for request in reads:
        value = yield from _read_value(plan, request, "a signal", transfers)
        if value is not None:
            transfers.presets[address_of(request)] = value


def _read_value(
    plan: NodePlan, mapped: MappedObject, title: str, transfers: BootTransfers
) -> Generator[Request, Answer, Value | None]:
    """Read a mapped object; return None if the node refuses, raise BootError J if it does not answer."""
    index, subindex = address_of(mapped)
    try:
        data = yield from transfers.try_read(index, subindex)
    except SdoTimeout as error:
        place = f"0x{index:04X}:{subindex:02X}"
        raise boot_error(plan, "J", f"reading {place}, {title}: {reason_of(error)}") from error
    return None if data is None else value_of(mapped, data)


def value_of(mapped: MappedObject, data: bytes) -> Value | None:
    """Decode SDO data as a mapped object's value; return None if it is invalid or does not fit into the mapping."""
    try:
        value = decode(data, mapped.data_type)
        PdoCodec((mapped,)).pack([value])
    except (ValueError, CanopenError):
        return None
    return value


SAVE = b"save"
STORE_NS = 20_000_000_000  # writing flash memory delays the answer
_SYNC_COUNTER = (CYCLE_PERIOD, SYNC_OVERFLOW)
_FIRST_OWN = 0x2000  # smaller indexes are communication objects
_INTERPOLATION = frozenset(axis_index(INTERPOLATION_TIME_PERIOD, axis) for axis in range(AXES))
_SUPERVISION = SUPERVISION | {ABORT_CONNECTION_OPTION}


def configure(plan: NodePlan, transfers: BootTransfers) -> Generator[Request, Answer, None]:
    """Configure a node as planned; raise BootError J if an essential object cannot be configured."""
    grouped = groups(plan.writes)
    counter = [group for group in grouped if group[0].index in _SYNC_COUNTER]
    for group in counter:  # first, because a SYNC with an unexpected counter causes EMCY 0x8240
        yield from _configure_object(plan, group[0], transfers)
    yield from check_expected(plan, transfers)
    cob_ids = yield from release_cob_ids(grouped, transfers)
    for group in grouped:
        if group in counter:
            continue
        if group[0].pdo is not None:
            yield from configure_pdo(plan, group, transfers, cob_ids)
        elif group[0].index == STORE:
            if transfers.changed:  # without a change storing is unnecessary, and wears the flash memory
                yield from _write(plan, group[0], transfers)
        else:
            yield from _configure_object(plan, group[0], transfers)


def check_expected(plan: NodePlan, transfers: BootTransfers) -> Generator[Request, Answer, None]:
    """Compare polarity and factors with the EDS values that the scales of bus.yml assume.

    Raise BootError J if they differ or cannot be read. Different factors are accepted if they result in the counts per
    revolution of bus.yml and those of the EDS do not: then bus.yml was written for this drive.
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
        if index != POLARITY and (
            not value or (_fits_scale(plan, offset, values) and not _fits_scale(plan, offset, by_file))
        ):
            continue  # 0 means not defined by the drive
        line = f"{{index: 0x{write.index:04X}, sub_index: {write.subindex}, value: {value}}}"
        raise boot_error(
            plan,
            "J",
            f"{write.label} is {value}, but {planned} in {plan.source}, and bus.yml has a scale for one of them only: "
            f"add `{line}` under `sdo:` to keep {value}, or the same with {planned} to write {planned}",
        )


def _fits_scale(plan: NodePlan, offset: int, values: Mapping[tuple[int, int], int]) -> bool:
    """Whether encoder, gear and feed factors in `values` yield the counts per revolution of bus.yml."""

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
    """Return the writes that a running node would need; nothing is written."""
    missing: list[PlannedWrite] = []
    for group in groups(plan.writes):
        current = yield from _held(group, transfers)
        missing += [write for write in needed_writes(group, current) if write.compare]
    return list(final_values(missing).values())


def watch_running(
    plan: NodePlan, missing: Sequence[PlannedWrite], transfers: BootTransfers
) -> Generator[Request, Answer, list[PlannedWrite]]:
    """Write the missing supervision parameters to a running node; return the other missing writes.

    Master and node must each detect the loss of the other. Raise BootError J if a PDO in use does not match the plan,
    since PDOs cannot be changed while the node is OPERATIONAL.
    """
    used = {("rpdo", rpdo.number) for rpdo in plan.rpdos} | {("tpdo", tpdo.number) for tpdo in plan.tpdos}
    if differs := sorted({write.pdo for write in missing if write.pdo is not None and write.pdo in used}):
        names = ", ".join(f"{kind.upper()} {number}" for kind, number in differs)
        raise boot_error(
            plan,
            "J",
            f"it runs and must be kept alive, but {names} differ from bus.yml; set reset_communication: true",
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
        # CiA 301, 7.5.2.13: the signature "save"
        yield from transfers.write(STORE, plan.save, SAVE, STORE_NS)
    except (SdoAbort, SdoTimeout) as error:
        transfers.warnings.append(f"it cannot store its configuration (0x1010:{plan.save:02X}): {reason_of(error)}")


def _held(
    group: Sequence[PlannedWrite], transfers: BootTransfers
) -> Generator[Request, Answer, dict[tuple[int, int], bytes | None]]:
    values: dict[tuple[int, int], bytes | None] = {}
    for address in reads_of(group):
        values[address] = yield from transfers.read_optional(*address)
    return values


def _configure_object(
    plan: NodePlan, write: PlannedWrite, transfers: BootTransfers
) -> Generator[Request, Answer, None]:
    """Read, compare, write and verify one object; raise BootError J if this fails for an essential object."""
    current = None
    if write.compare:
        current = yield from _present(plan, write, transfers)
        if matches(write, current):
            return
    if current is not None and write.index in (COB_ID_SYNC, COB_ID_EMCY):
        yield from _release(write, current, transfers)
    if write.index == HEARTBEAT_CONSUMER:
        yield from _clear_double(plan, write, transfers)
    if not (yield from _write(plan, write, transfers)) or current is None:
        return  # refused and not essential, or not readable
    after = yield from transfers.read_optional(*write.address)
    if after is not None and not matches(write, after):
        _report_difference(plan, write, after, transfers)


def _release(write: PlannedWrite, current: bytes, transfers: BootTransfers) -> Generator[Request, Answer, None]:
    """Make the COB-ID of SYNC or EMCY changeable, by clearing or setting a bit (CiA 301, 7.5.2.5 and 7.5.2.17)."""
    value = int.from_bytes(current, "little")
    # CiA 301, 7.5.2.5: bit 30 of 0x1005, the device produces SYNC; 7.5.2.17: bit 31 of 0x1014, not valid
    changeable = value & ~PRODUCER_BIT if write.index == COB_ID_SYNC else value | INVALID_BIT
    if changeable != value and not matches(write, changeable.to_bytes(4, "little")):
        try:
            yield from transfers.write(*write.address, changeable.to_bytes(4, "little"))
        except SdoAbort:
            return  # the write that follows reports the error


def _clear_double(plan: NodePlan, write: PlannedWrite, transfers: BootTransfers) -> Generator[Request, Answer, None]:
    """Clear unplanned entries of 0x1016 for the same node; devices refuse a second one (CiA 301, 7.5.2.19)."""
    node_id, ms = parse_consumer_entry(int.from_bytes(write.data, "little"))
    if not ms:
        return
    planned = {planned_write.subindex for planned_write in plan.writes if planned_write.index == HEARTBEAT_CONSUMER}
    subindices = {sub for index, sub in plan.entry_names if index == HEARTBEAT_CONSUMER and sub} - planned
    for subindex in sorted(subindices):
        entry = yield from transfers.number(HEARTBEAT_CONSUMER, subindex)
        if entry and parse_consumer_entry(entry)[0] == node_id:
            yield from transfers.write(HEARTBEAT_CONSUMER, subindex, bytes(4))


def _present(plan: NodePlan, write: PlannedWrite, transfers: BootTransfers) -> Generator[Request, Answer, bytes | None]:
    try:
        return (yield from transfers.read_optional(*write.address))
    except SdoTimeout as error:
        raise boot_error(plan, "J", f"reading {write.label}: {reason_of(error)}") from error


def _write(plan: NodePlan, write: PlannedWrite, transfers: BootTransfers) -> Generator[Request, Answer, bool]:
    """Write an object; return False if the node refuses an optional write, raise BootError J for any other failure."""
    try:
        yield from transfers.write(*write.address, write.data, STORE_NS if write.index in (STORE, RESTORE) else None)
    except (SdoAbort, SdoTimeout) as error:
        if isinstance(error, SdoAbort) and write.optional:
            why = f" ({write.reason})" if write.reason else ""
            transfers.warnings.append(f"it refuses {write.label}{why}: {reason_of(error)}")
            return False
        hint = (
            "; to boot without it set `allow_unsupervised: true` and `heartbeat_consumer: false`"
            if _is_supervision(write)
            else ""
        )
        raise boot_error(plan, "J", f"writing {write.label}: {reason_of(error)}{hint}") from error
    return True


def _is_supervision(write: PlannedWrite) -> bool:
    return bool(write.reason) and write.index in _SUPERVISION


def _report_difference(plan: NodePlan, write: PlannedWrite, after: bytes, transfers: BootTransfers) -> None:
    """Warn about an object whose value differs from the written one.

    Raise BootError J instead for 0x6007 and for communication objects other than EMCY.
    """
    text = f"{write.label} holds 0x{after[::-1].hex()} after 0x{write.data[::-1].hex()} was written"
    if (write.index < _FIRST_OWN and write.index != COB_ID_EMCY) or axis_of(write.index)[0] == ABORT_CONNECTION_OPTION:
        raise boot_error(plan, "J", text)
    why = "; the node limits or rounds it"
    if write.index in _INTERPOLATION:
        why = "; the node rounds it: positions are not interpolated over the SYNC period; change sync_period"
    transfers.warnings.append(text + why)
