"""The configuration of a node during its boot: read, compare, write, verify (CiA 302-2, "download configuration").

The law of this file: what the node holds already is not written again, and what was written is read back. A node that
holds something else than it was told is refused where the object is the network's (communication objects, 0x6007), and
warned of where it is the drive's (a ramp that the drive limits). A PDO that cannot be made what it should be is either
used as the node has it, where it carries what is needed, or left invalid, and never half done.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.cia402.objects import AXES, INTERPOLATION_TIME_PERIOD, axis_index
from canopen_control.errors import SdoAbort, SdoTimeout
from canopen_control.master.boot_pdos import configure_pdo
from canopen_control.master.compare import final_values, groups, matches, needed, reads_of
from canopen_control.master.requests import boot_error, reason_of

if TYPE_CHECKING:
    from collections.abc import Generator, Sequence

    from canopen_control.master.plan import NodePlan
    from canopen_control.master.plan_builder import PlannedWrite
    from canopen_control.master.requests import Answer, BootTransfers, Request

__all__ = ["compare_only", "configure", "store"]

STORE, RESTORE = 0x1010, 0x1011
SAVE = b"save"
STORE_NS = 20_000_000_000  # a node that writes its flash answers late
_FIRST_OWN = 0x2000  # below it stand the objects of the network
_ABORT_CONNECTION = 0x6007
_INTERPOLATION = frozenset(axis_index(INTERPOLATION_TIME_PERIOD, axis) for axis in range(AXES))
_SUPERVISION = frozenset((0x1016, 0x1017, 0x1029, _ABORT_CONNECTION))


def configure(plan: NodePlan, transfers: BootTransfers) -> Generator[Request, Answer, None]:
    """Bring the node to what the plan says; raises BootError J."""
    for group in groups(plan.writes):
        if group[0].pdo is not None:
            yield from configure_pdo(plan, group, transfers)
        elif group[0].index == STORE:
            if transfers.changed:  # else nothing new would be stored, and flash wears out
                yield from _write(plan, group[0], transfers)
        else:
            yield from _configure_object(plan, group[0], transfers)


def compare_only(plan: NodePlan, transfers: BootTransfers) -> Generator[Request, Answer, list[PlannedWrite]]:
    """Return what the node would have to be told, without telling it."""
    missing: list[PlannedWrite] = []
    for group in groups(plan.writes):
        held = yield from _held(group, transfers)
        missing += [write for write in needed(group, held) if write.compare]
    return list(final_values(missing).values())


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
    if not (yield from _write(plan, write, transfers)) or held is None:
        return  # refused and done without, or not to be read
    after = yield from transfers.held(*write.address)
    if after is not None and not matches(write, after):
        _differs(plan, write, after, transfers)


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
    if write.index < _FIRST_OWN or write.index == _ABORT_CONNECTION:
        raise boot_error(plan, "J", text)
    why = "; the node limits or rounds it"
    if write.index in _INTERPOLATION:
        why = "; the node rounds it: positions are interpolated over another time than SYNC's; take another sync_period"
    transfers.warnings.append(text + why)


def _what(write: PlannedWrite) -> str:
    return f"{write.name} 0x{write.index:04X}:{write.subindex:02X}"
