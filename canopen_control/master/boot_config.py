"""The configuration of a node during its boot: read, compare, write, verify (CiA 302-2, "download configuration").

The law of this file: what the node holds already is not written again, and what was written is read back. A node that
holds something else than it was told is refused where the object is the network's (communication objects, 0x6007), and
warned of where it is the drive's (a ramp that the drive limits). A PDO that cannot be made what it should be is either
used as the node has it, where it carries what is needed, or left invalid, and never half done.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from canopen_control.cia301.heartbeat import parse_consumer_entry
from canopen_control.cia301.pdo import INVALID_BIT
from canopen_control.cia301.sync import PRODUCER_BIT
from canopen_control.cia402.objects import (
    AXES,
    FEED_CONSTANT,
    GEAR_RATIO,
    INTERPOLATION_TIME_PERIOD,
    POLARITY,
    POSITION_ENCODER_RESOLUTION,
    axis_index,
    axis_of,
)
from canopen_control.cia402.units import counts_per_revolution
from canopen_control.errors import ConfigError, SdoAbort, SdoTimeout
from canopen_control.master.boot_pdos import configure_pdo, release_cob_ids
from canopen_control.master.compare import final_values, groups, matches, needed, reads_of
from canopen_control.master.requests import boot_error, reason_of

if TYPE_CHECKING:
    from collections.abc import Generator, Mapping, Sequence

    from canopen_control.master.plan import NodePlan
    from canopen_control.master.plan_builder import PlannedWrite
    from canopen_control.master.requests import Answer, BootTransfers, Request

__all__ = ["check_expected", "compare_only", "configure", "store", "watch_running"]

STORE, RESTORE = 0x1010, 0x1011
SAVE = b"save"
STORE_NS = 20_000_000_000  # a node that writes its flash answers late
_SYNC_COUNTER = (0x1006, 0x1019)
_SYNC, _EMCY, _CONSUMER = 0x1005, 0x1014, 0x1016
_FIRST_OWN = 0x2000  # below it stand the objects of the network
_ABORT_CONNECTION = 0x6007
_INTERPOLATION = frozenset(axis_index(INTERPOLATION_TIME_PERIOD, axis) for axis in range(AXES))
_SUPERVISION = frozenset((0x100C, 0x100D, 0x1016, 0x1017, 0x1029, _ABORT_CONNECTION))


def configure(plan: NodePlan, transfers: BootTransfers) -> Generator[Request, Answer, None]:
    """Bring the node to what the plan says; raises BootError J."""
    grouped = groups(plan.writes)
    counter = [group for group in grouped if group[0].index in _SYNC_COUNTER]
    for group in counter:  # at once: until then each SYNC with a counter is an error of the node, EMCY 0x8240
        yield from _configure_object(plan, group[0], transfers)
    yield from check_expected(plan, transfers)
    yield from release_cob_ids(grouped, transfers)
    for group in grouped:
        if group in counter:
            continue
        if group[0].pdo is not None:
            yield from configure_pdo(plan, group, transfers)
        elif group[0].index == STORE:
            if transfers.changed:  # else nothing new would be stored, and flash wears out
                yield from _write(plan, group[0], transfers)
        else:
            yield from _configure_object(plan, group[0], transfers)


def check_expected(plan: NodePlan, transfers: BootTransfers) -> Generator[Request, Answer, None]:
    """Compare what the scales of bus.yml count on and nothing writes; BootError J where the drive holds something else.

    Other factors are taken where they make the counts of a turn that bus.yml has, and those of the EDS do not: bus.yml
    was written for this drive.
    """
    held: dict[tuple[int, int], int] = {}
    by_file: dict[tuple[int, int], int] = {}
    for write in plan.expected:
        data = yield from _present(plan, write, transfers)
        if data is not None:
            held[write.address], by_file[write.address] = (
                int.from_bytes(each, "little") for each in (data, write.data)
            )
    for write in plan.expected:
        value, planned = held.get(write.address), by_file.get(write.address)
        if value == planned:
            continue
        index, offset = axis_of(write.index)[0], 0x800 * axis_of(write.index)[1]
        if index != POLARITY and (not value or (_makes(plan, offset, held) and not _makes(plan, offset, by_file))):
            continue  # 0 revolutions or counts: the drive does not say
        line = f"{{index: 0x{write.index:04X}, sub_index: {write.subindex}, value: {value}}}"
        raise boot_error(
            plan,
            "J",
            f"{_what(write)} holds {value}, {plan.source} says {planned}, and bus.yml does not say for which its scale "
            f"was made: add `{line}` under `sdo:` to go on with {value}, or with {planned} to have that written",
        )


def _makes(plan: NodePlan, offset: int, held: Mapping[tuple[int, int], int]) -> bool:
    """Whether what a drive holds makes the counts of a turn that bus.yml has."""

    def pair(index: int) -> tuple[int, int] | None:
        found = held.get((index + offset, 1)), held.get((index + offset, 2))
        return None if None in found else (found[0] or 0, found[1] or 0)

    encoder, gear = pair(POSITION_ENCODER_RESOLUTION), pair(GEAR_RATIO)
    turns, feed = plan.turns.get(offset), pair(FEED_CONSTANT)
    try:
        made = counts_per_revolution(encoder or (1, 1), gear or (1, 1), None if feed == (1, 1) else feed)
    except ConfigError:
        return False
    return turns is not None and math.isclose(made, turns, rel_tol=1e-3)


def compare_only(plan: NodePlan, transfers: BootTransfers) -> Generator[Request, Answer, list[PlannedWrite]]:
    """Return what the node would have to be told, without telling it."""
    missing: list[PlannedWrite] = []
    for group in groups(plan.writes):
        held = yield from _held(group, transfers)
        missing += [write for write in needed(group, held) if write.compare]
    return list(final_values(missing).values())


def watch_running(
    plan: NodePlan, missing: Sequence[PlannedWrite], transfers: BootTransfers
) -> Generator[Request, Answer, list[PlannedWrite]]:
    """Write the supervision that a running node lacks, and return what else it lacks.

    Its death must be noticed, and it must notice ours, whoever configured it. What is sent and received must be what
    the node sends and receives: BootError J where a PDO in use differs, since none can be changed while it runs.
    """
    used = {("rpdo", each.number) for each in plan.rpdos} | {("tpdo", each.number) for each in plan.tpdos}
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
    """Let the node store its configuration, if this boot has changed it; a refusal is a warning."""
    if not plan.save or not transfers.changed:
        return
    try:
        yield from transfers.write(STORE, plan.save, SAVE, STORE_NS)
    except (SdoAbort, SdoTimeout) as error:
        transfers.warnings.append(f"it cannot store its configuration (0x1010:{plan.save:02X}): {reason_of(error)}")


def _held(
    group: Sequence[PlannedWrite], transfers: BootTransfers
) -> Generator[Request, Answer, dict[tuple[int, int], bytes | None]]:
    found: dict[tuple[int, int], bytes | None] = {}
    for address in reads_of(group):
        found[address] = yield from transfers.held(*address)
    return found


def _configure_object(
    plan: NodePlan, write: PlannedWrite, transfers: BootTransfers
) -> Generator[Request, Answer, None]:
    """Read, compare, write, verify one object."""
    held = None
    if write.compare:
        held = yield from _present(plan, write, transfers)
        if matches(write, held):
            return
    if held is not None and write.index in (_SYNC, _EMCY):
        yield from _release(write, held, transfers)
    if write.index == _CONSUMER:
        yield from _clear_double(plan, write, transfers)
    if not (yield from _write(plan, write, transfers)) or held is None:
        return  # refused and done without, or not to be read
    after = yield from transfers.held(*write.address)
    if after is not None and not matches(write, after):
        _differs(plan, write, after, transfers)


def _release(write: PlannedWrite, held: bytes, transfers: BootTransfers) -> Generator[Request, Answer, None]:
    """Make a COB-ID changeable: a valid EMCY and a produced SYNC keep theirs (CiA 301, 7.5.2.5 and 7.5.2.17)."""
    value = int.from_bytes(held, "little")
    changeable = value & ~PRODUCER_BIT if write.index == _SYNC else value | INVALID_BIT
    if changeable != value and not matches(write, changeable.to_bytes(4, "little")):
        try:
            yield from transfers.write(*write.address, changeable.to_bytes(4, "little"))
        except SdoAbort:
            return  # what follows is told


def _clear_double(plan: NodePlan, write: PlannedWrite, transfers: BootTransfers) -> Generator[Request, Answer, None]:
    """Clear other entries of 0x1016 that a device has stored for the same node: it refuses a second one (7.5.2.19)."""
    node_id, ms = parse_consumer_entry(int.from_bytes(write.data, "little"))
    if not ms:
        return
    planned = {each.subindex for each in plan.writes if each.index == _CONSUMER}
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
    """Write; return False for an addition that the node refuses and that is not vital."""
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
    """Judge a node that took a value and holds another."""
    text = f"{_what(write)} holds 0x{after[::-1].hex()} after 0x{write.data[::-1].hex()} was written"
    if (write.index < _FIRST_OWN and write.index != _EMCY) or axis_of(write.index)[0] == _ABORT_CONNECTION:
        raise boot_error(plan, "J", text)
    why = "; the node limits or rounds it"
    if write.index in _INTERPOLATION:
        why = "; the node rounds it: positions are interpolated over another time than SYNC's; take another sync_period"
    transfers.warnings.append(text + why)


def _what(write: PlannedWrite) -> str:
    return f"{write.name} 0x{write.index:04X}:{write.subindex:02X}"
