"""Restores a parameter set for `restore` and `clone`: their options, the progress, and the report that they print."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from canopen_control.cli.support.output import Progress, json_text
from canopen_control.rpc.messages.declare import Document
from canopen_control.service.guarded_restore import RestoreOptions, first_of, guarded_restore
from canopen_control.service.restore_journal import Reached

if TYPE_CHECKING:
    import argparse

    from canopen_control.service.guarded_restore import RestoreReport
    from canopen_control.service.node_session import NodeSession
    from canopen_control.service.parameter_set import ParameterSet

__all__ = ["RestoreDocument", "add_restore_arguments", "reached", "restore_into"]


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
        help="do not write these: an address as in '0x2*', or a name (repeatable)",
    )
    parser.add_argument("--include-protected", action="store_true", help="also write the calibration of another drive")
    parser.add_argument("--keep", action="store_true", help="keep the accepted values if the drive refuses others")
    parser.add_argument("--store", action="store_true", help="store in the drive (0x1010) after verification")
    parser.add_argument("--json", action="store_true", help="print JSON")


def reached(args: argparse.Namespace) -> Reached:
    """Return how the arguments reach a node, for commands that are told to the user."""
    include = bool(getattr(args, "include_protected", False))
    return Reached(getattr(args, "can", None) or "", getattr(args, "name", None) or "", include)


def restore_into(session: NodeSession, source: ParameterSet, args: argparse.Namespace) -> int:
    """Write `source` into the node, print the report, and return the exit code."""
    options = RestoreOptions(args.protect, args.include_protected, args.keep, args.store, reached(args))
    with Progress(f"writing {session}", "groups") as progress:
        report = guarded_restore(session, source, options, note=_note, told=progress.at)
    _print(report, session, as_json=args.json)
    return 1 if report.refused else 0


def _note(line: str) -> None:
    print(f"canopen-control: {line}", file=sys.stderr)


def _print(report: RestoreReport, session: NodeSession, *, as_json: bool) -> None:
    if as_json:
        document = RestoreDocument(
            source=report.source,
            node_id=session.node_id,
            written=report.written,
            verified=report.verified,
            protected=report.protected,
            foreign=report.foreign,
            refused=report.refused,
            undone=report.undone,
            stored=report.stored,
        )
        print(json_text(document))
        return
    for line in report.refused:
        _note(f"refused: {line}")
    for line in report.protected:
        print(f"kept as it is: {line}")
    if report.foreign:
        print(f"never written (read-only, commands, live values): {first_of(report.foreign)}")
    print(report.words(session) + ("" if report.refused or report.stored else " (--store)"))
