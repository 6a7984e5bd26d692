"""Jobs for the parameters of a node: backup, comparison with a file, restore, and clone.

A job function gets a session and the run that the user watches, and returns the final sentence. Errors have the same
text in all user interfaces.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from canopen_control.commissioning.parameter_set import backup_file_text, differences, read_parameters, read_same
from canopen_control.commissioning.restore import first_of, guarded_restore, refuse_other_drive, unfinished_words
from canopen_control.errors import CanopenError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from contextlib import AbstractContextManager

    from canopen_control.commissioning.jobs import JobRun, Reached, RestoreOptions
    from canopen_control.commissioning.node_session import NodeSession
    from canopen_control.commissioning.parameter_set import DifferentParameter, ParameterSet
    from canopen_control.od.model import Address


@dataclass(frozen=True, slots=True)
class BackupReport:
    """Result of a backup: number of parameters in the file, and omitted parameters with the reasons."""

    node_id: int
    node: str | None
    file: str
    parameters: int
    left_out: list[str]


def run_backup(session: NodeSession, run: JobRun, reached: Reached, name: str = "") -> str:
    """Read all parameters twice and create a DCF; the file `name` defaults to the name of the node."""
    if unfinished := unfinished_words(session, reached):
        run.note(unfinished)
    name = name or f"{session.name or f'node{session.node_id}'}.dcf"
    parameters, refused = _all_of(session, run)
    if not parameters.values:
        raise CanopenError(f"{session} has no readable and writable parameter; no file was written")
    text, lost = backup_file_text(parameters, session.name)
    left_out, count = [*refused, *lost], len(parameters.values) - len(lost)
    for reason in left_out:
        run.note(f"omitted: {reason}")
    run.file = name, text.encode()
    run.document = BackupReport(session.node_id, session.name or None, name, count, left_out)
    return f"{session}: {count} parameters to {name}"


def _all_of(session: NodeSession, run: JobRun) -> tuple[ParameterSet, list[str]]:
    run.part(f"reading {session}", "objects")
    parameters, left_out = read_parameters(session, progress=run.at)
    return parameters, list(map(str, left_out))


@dataclass(frozen=True, slots=True)
class DiffReport:
    """Result of a comparison: number of compared parameters, and the differences in identity and parameters."""

    a: str
    b: str
    compared: int
    identity: list[str]
    differences: list[DifferentParameter]

    def rows(self, why: Mapping[Address, str]) -> Iterator[tuple[str, str, str, str]]:
        """Yield address, name and both values of each difference; `why` explains missing values by address."""
        for change in self.differences:
            missing = why.get((change.index, change.subindex), "-")
            place = f"0x{change.index:04X}:{change.subindex:02X}"
            yield place, change.name, change.a or missing, change.b or missing


def compared(a: ParameterSet, b: ParameterSet) -> DiffReport:
    """Compare two parameter sets, including the identities of the devices."""
    identity = [*a.identity.strangers(b.identity), *a.identity.variations(b.identity)]
    return DiffReport(a.where, b.where, len({*a.values, *b.values}), identity, list(differences(a, b)))


def run_diff(session: NodeSession, run: JobRun, file: ParameterSet) -> str:
    """Compare the parameters of a file with those of the node, by address."""
    run.part(f"reading {session}", "objects")
    node, left_out = read_same(session, file, run.at)
    result = compared(file, node)
    run.document, run.lines = result, [*result.identity]
    run.table = list(result.rows({unread.entry.address: unread.why for unread in left_out}))
    if not result.differences:
        return f"{file.where} and {session}: {result.compared} parameters, equal"
    return f"{file.where} and {session}: {len(result.differences)} of {result.compared} parameters differ"


def run_restore(session: NodeSession, run: JobRun, file: ParameterSet, options: RestoreOptions) -> str:
    """Write the parameters of a file to the node and verify them; the job fails if the node refuses one."""
    like_file(session, file)
    if not options.any_node:
        refuse_other_drive(file, session)
    run.part(f"writing {session}", "groups")
    report = guarded_restore(session, file, options, note=run.note, progress=run.at)
    run.document, run.failed = report, bool(report.refused)
    for line in report.refused:
        run.note(f"refused: {line}")
    run.lines += [f"not written: {line}" for line in report.protected]
    if report.foreign:
        run.lines.append(f"never written (read-only, commands, live values): {first_of(report.foreign)}")
    return report.words(session)


def run_clone(
    session: NodeSession, run: JobRun, source: AbstractContextManager[NodeSession], options: RestoreOptions
) -> str:
    """Read all parameters of another node through its session `source`, and restore them to this node."""
    with source as other:
        parameters, _ = _all_of(other, run)
    return run_restore(session, run, parameters, replace(options, any_node=True))


def like_file(session: NodeSession, file: ParameterSet) -> NodeSession:
    """Give a session without an EDS the object dictionary of the DCF; return the session."""
    if session.od is None:
        session.od = file.od.for_node(session.node_id)
    return session
