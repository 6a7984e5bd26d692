"""Writes a parameter set into a node as `restore` and `clone` do: checks before, state meanwhile, report after.

Nothing is written into another product, into another drive of the kind by mistake, into an axis with torque, or into a
node that a running robot controls. The node is PRE-OPERATIONAL meanwhile, so that no PDO acts on what is half written.
"""

from __future__ import annotations

import contextlib
import fnmatch
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final

from canopen_control.cia301.nmt import NmtCommand, NmtState
from canopen_control.errors import CanopenError, ConfigError, DriveError
from canopen_control.service.backup_choice import protection_of
from canopen_control.service.read_parameters import device_identity, entry_label
from canopen_control.service.restore import Restore, RestoreStep, check_device, refuse_moving, store
from canopen_control.service.restore_journal import Reached, RestoreJournal

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from canopen_control.od.model import Address, Entry, ObjectDictionary
    from canopen_control.service.node_session import NodeSession
    from canopen_control.service.parameter_set import ParameterSet

__all__ = ["RestoreOptions", "RestoreReport", "guarded_restore", "protected", "quiet_node", "refuse_other_drive"]

_SHOWN: Final = 8  # of what was written, where a restore was interrupted


@dataclass(frozen=True, slots=True)
class RestoreOptions:
    """How to restore: `protect` are globs of what stays as it is, `keep` what was taken where some was refused."""

    protect: Sequence[str] = ()
    include_protected: bool = False
    keep: bool = False
    store: bool = False
    reached: Reached = field(default_factory=Reached)


@dataclass(frozen=True, slots=True)
class RestoreReport:
    """What came of it; `refused` and `protected` name objects with the reason."""

    source: str
    written: int
    verified: int
    protected: list[str]
    refused: list[str]
    undone: bool
    stored: bool

    def words(self, session: NodeSession) -> str:
        """Return the sentence at the end."""
        if self.refused:
            end = "the drive is as it was" if self.undone else "what it took is kept, and not stored"
            return f"{session}: {len(self.refused)} parameters refused; {end}"
        end = "stored" if self.stored else "not stored: a power cycle undoes it"
        return f"{session}: {self.verified} parameters as in {self.source}, {self.written} written; {end}"


def refuse_other_drive(file: ParameterSet, session: NodeSession) -> None:
    """Refuse the backup of another drive on another place; a replacement on the old place is what a backup is for."""
    if file.node_id == session.node_id:
        return
    serial = device_identity(session).serial
    if serial is None or serial != file.identity.serial:
        raise ConfigError(
            f"{file.where} is of node {file.node_id}, and {session} is another drive; nothing was written: name node "
            f"{file.node_id}, or say --any-node if it is meant to have these parameters"
        )


def protected(
    od: ObjectDictionary, addresses: Iterator[Address], globs: Sequence[str], *, same_device: bool
) -> dict[Address, str]:
    """Return the parameters that stay as they are, with the reason; ConfigError for a glob that fits none."""
    found: dict[Address, str] = {}
    used: set[str] = set()
    for address in addresses:
        entry = od[address]
        fitting = [glob for glob in globs if _fits(od, entry, glob)]
        used.update(fitting)
        reason = protection_of(od, entry, same_device=same_device) or (f"--protect {fitting[0]}" if fitting else "")
        if reason:
            found[address] = reason
    if unused := [glob for glob in globs if glob not in used]:
        raise ConfigError(f"--protect {unused[0]}: fits no parameter; write an address as in '0x2*', or a name")
    return found


def _fits(od: ObjectDictionary, entry: Entry, glob: str) -> bool:
    info = od.objects.get(entry.index)
    address = f"0x{entry.index:04x}"
    names = (address, f"{address}:{entry.subindex:02x}", entry.name, "" if info is None else info.name)
    return any(fnmatch.fnmatchcase(name.lower(), glob.lower()) for name in names)


@contextlib.contextmanager
def quiet_node(session: NodeSession, *, starts_again: bool = True) -> Iterator[None]:
    """Have the node PRE-OPERATIONAL and without torque meanwhile; DriveError where that is not to be had."""
    refuse_moving(session)
    state = session.nmt_state()
    again = state if starts_again else None
    if session.robot:
        if state is not NmtState.PRE_OPERATIONAL or not session.transfers.taken_out():
            raise DriveError(
                f"{session} is controlled by the running robot {session.robot}; nothing was written: end the robot "
                f"with `shutdown` and use --can, or take the node out: `nmt preop {session.name or session.node_id}`"
            )
        yield
        return
    session.transfers.command(NmtCommand.ENTER_PRE_OPERATIONAL)
    try:
        yield
    except BaseException:
        with contextlib.suppress(CanopenError):  # what went wrong is told, and not what followed from it
            _start_again(session, again)
        raise
    _start_again(session, again)


def _start_again(session: NodeSession, state: NmtState | None) -> None:
    if state is NmtState.OPERATIONAL:
        session.transfers.command(NmtCommand.START)


def guarded_restore(
    session: NodeSession,
    source: ParameterSet,
    options: RestoreOptions,
    *,
    note: Callable[[str], None],
    told: Callable[[int, int], None] | None = None,
) -> RestoreReport:
    """Write `source` into the node and prove it.

    `note` hears what is to be known before, `told(done, of)` how far the writing is. ConfigError and DriveError for
    what must not be; DriveError with what was written where it ended half-way.
    """
    identity = device_identity(session)
    for line in check_device(source, identity, session):
        note(line)
    same_device = source.identity.serial is not None and source.identity.serial == identity.serial
    wanted = source.for_node(session.node_id)
    od = source.od.for_node(session.node_id)
    left = protected(od, iter(wanted), options.protect, same_device=same_device or options.include_protected)
    journal = RestoreJournal(session, identity, options.reached)
    if journal.unfinished and Path(source.where) != journal.path:
        note(journal.unfinished)
    restore = Restore(session, od, {address: value for address, value in wanted.items() if address not in left}, told)
    restore.keep_held = partial(journal.begin, od)
    stored = False
    with quiet_node(session), _half_way_told(restore, journal):
        good = restore.run(keep=options.keep)
        journal.end(restore)
        if good and options.store:
            store(session)
            stored = True
    kept = [f"{entry_label(od[address])}: {why}" for address, why in left.items()]
    written = len(restore.written)
    return RestoreReport(source.where, written, restore.verified, kept, restore.refused, restore.undone, stored)


@contextlib.contextmanager
def _half_way_told(restore: Restore, journal: RestoreJournal) -> Iterator[None]:
    """Tell what a restore has written where it is interrupted."""
    try:
        yield
    except (CanopenError, KeyboardInterrupt) as error:
        if restore.step in (RestoreStep.READING, RestoreStep.DONE):
            raise
        raise DriveError(_interrupted(restore, journal, error)) from error


def _interrupted(restore: Restore, journal: RestoreJournal, error: BaseException) -> str:
    names = ", ".join(restore.written[:_SHOWN]) + (", ..." if len(restore.written) > _SHOWN else "")
    what = f"{len(restore.written)} of {restore.planned} were written{f' ({names})' if names else ''}"
    reason = str(error) or "interrupted"
    return (
        f"{restore.session}: the restore ended while {restore.step.value}: {reason}; {what}, nothing was stored; "
        f"the same command again writes what is missing, {journal.undo_words} what the node held"
    )
