"""Writes a parameter set into a node for `restore` and `clone`: checks before, state meanwhile, report after.

Nothing is written into another product, into another drive of the kind by mistake, into an axis with torque, or into a
node that a running robot controls. The node is PRE-OPERATIONAL meanwhile, so that no PDO acts on what is half written.
"""

from __future__ import annotations

import contextlib
import fnmatch
import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from canopen_control.cia301.nmt import NmtCommand, NmtState
from canopen_control.cli.support.output import Progress, json_text
from canopen_control.cli.support.restore_journal import RestoreJournal
from canopen_control.errors import CanopenError, ConfigError, DriveError
from canopen_control.rpc.messages.declare import Document
from canopen_control.service.backup_choice import protection_of
from canopen_control.service.read_parameters import device_identity, entry_label
from canopen_control.service.restore import Restore, RestoreStep, check_device, refuse_moving, store

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator

    from canopen_control.od.model import Address, Entry, ObjectDictionary
    from canopen_control.service.node_session import NodeSession
    from canopen_control.service.parameter_set import ParameterSet

__all__ = ["RestoreDocument", "add_restore_arguments", "protected", "quiet_node", "restore_into"]

_SHOWN = 8  # of what was written, where a restore was interrupted, and of what is never written


class RestoreDocument(Document, frozen=True, kw_only=True):
    """What `restore --json` and `clone --json` print; `refused` and `protected` name objects with the reason.

    `foreign` are objects of the file that no restore writes: read-only ones, commands, live values.
    """

    source: str
    node_id: int
    written: int
    verified: int
    protected: list[str]
    foreign: list[str]
    refused: list[str]
    undone: bool
    stored: bool


def add_restore_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what restore and clone have in common."""
    parser.add_argument(
        "--protect",
        metavar="GLOB",
        action="append",
        default=[],
        help="leave these as they are: an address as in '0x2*', or a name (repeatable)",
    )
    parser.add_argument("--include-protected", action="store_true", help="write calibration of another drive too")
    parser.add_argument("--keep", action="store_true", help="keep what the drive took, where it refuses some")
    parser.add_argument("--store", action="store_true", help="store in the drive (0x1010), once all is proven")
    parser.add_argument("--json", action="store_true", help="print JSON")


def protected(
    od: ObjectDictionary, addresses: Iterator[Address], globs: list[str], *, same_device: bool
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


def restore_into(session: NodeSession, source: ParameterSet, args: argparse.Namespace) -> int:
    """Write `source` into the node, print the report, and return the exit code."""
    identity = device_identity(session)
    for line in check_device(source, identity, session):
        print(f"canopen-control: {line}", file=sys.stderr)
    same_device = source.identity.serial is not None and source.identity.serial == identity.serial
    wanted = source.for_node(session.node_id)
    od = source.od.for_node(session.node_id)
    left = protected(od, iter(wanted), args.protect, same_device=same_device or args.include_protected)
    journal = RestoreJournal(session, identity, args)
    if journal.unfinished and Path(source.where) != journal.path:
        print(f"canopen-control: {journal.unfinished}", file=sys.stderr)
    restore = Restore(session, od, {address: value for address, value in wanted.items() if address not in left})
    restore.keep_held = partial(journal.begin, od)
    stored = False
    with quiet_node(session), _told(restore, journal):
        good = restore.run(keep=args.keep)
        journal.end(restore)
        if good and args.store:
            store(session)
            stored = True
    document = RestoreDocument(
        source=source.where,
        node_id=session.node_id,
        written=len(restore.written),
        verified=restore.verified,
        protected=[f"{entry_label(od[address])}: {why}" for address, why in left.items()],
        foreign=[entry_label(od[address]) for address in source.foreign],
        refused=restore.refused,
        undone=restore.undone,
        stored=stored,
    )
    _print(document, session, as_json=args.json)
    return 1 if restore.refused else 0


@contextlib.contextmanager
def _told(restore: Restore, journal: RestoreJournal) -> Iterator[None]:
    """Tell the progress of a restore, and what it has written where it is interrupted."""
    with Progress(f"writing {restore.session}", "groups") as progress:
        restore.told = progress.at
        try:
            yield
        except (CanopenError, KeyboardInterrupt) as error:
            if restore.step in (RestoreStep.READING, RestoreStep.DONE):
                raise
            progress.end()
            raise DriveError(_interrupted(restore, journal, error)) from error


def _interrupted(restore: Restore, journal: RestoreJournal, error: BaseException) -> str:
    names = ", ".join(restore.written[:_SHOWN]) + (", ..." if len(restore.written) > _SHOWN else "")
    what = f"{len(restore.written)} of {restore.planned} were written{f' ({names})' if names else ''}"
    reason = str(error) or "interrupted"
    return (
        f"{restore.session}: the restore ended while {restore.step.value}: {reason}; {what}, nothing was stored; "
        f"the same command again writes what is missing, {journal.undo_words} what the node held"
    )


def _print(document: RestoreDocument, session: NodeSession, *, as_json: bool) -> None:
    if as_json:
        print(json_text(document))
        return
    for line in document.refused:
        print(f"canopen-control: refused: {line}", file=sys.stderr)
    for line in document.protected:
        print(f"kept as it is: {line}")
    if document.foreign:
        names = ", ".join(document.foreign[:_SHOWN]) + (", ..." if len(document.foreign) > _SHOWN else "")
        print(f"never written (read-only, commands, live values): {names}")
    if document.refused:
        end = "the drive is as it was" if document.undone else "what it took is kept, and not stored"
        print(f"{session}: {len(document.refused)} parameters refused; {end}")
        return
    end = "stored" if document.stored else "not stored: a power cycle undoes it (--store)"
    print(f"{session}: {document.verified} parameters as in {document.source}, {document.written} written; {end}")
