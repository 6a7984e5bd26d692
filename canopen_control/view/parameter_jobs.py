"""The long work of the Parameters tab at one node: backup, comparison, restore, clone. No toolkit; runs on threads.

Each takes a session and the piece of work that pages look at, and returns the sentence at its end. What must not be is
refused by the room `service`, in the same words as by the verbs.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.errors import ConfigError, DriveError
from canopen_control.service.guarded_restore import RestoreOptions, guarded_restore, refuse_other_drive
from canopen_control.service.parameter_diff import differences
from canopen_control.service.parameter_set import backup_file_text, parse_backup
from canopen_control.service.read_parameters import read_parameters, read_same
from canopen_control.service.restore_journal import Reached, unfinished_words

if TYPE_CHECKING:
    from canopen_control.service.node_session import NodeSession
    from canopen_control.service.parameter_set import ParameterSet
    from canopen_control.view.node_desk import NodeDesk, NodeWork

__all__ = ["MOST_BYTES", "backup", "clone_from", "compare", "restore", "uploaded"]

MOST_BYTES = 4_000_000  # of a DCF
_FEWEST = 1


def uploaded(data: bytes, name: str) -> ParameterSet:
    """Read a DCF that somebody has chosen; ConfigError or EdsError for what is none."""
    if not data:
        raise ConfigError(f"{name} is empty")
    return parse_backup(data, name)


def backup(session: NodeSession, work: NodeWork) -> str:
    """Read all parameters and keep them as a file."""
    if unfinished := unfinished_words(session, Reached(robot=session.robot)):
        work.lines.append(unfinished)
    parameters, left_out = read_parameters(session, told=work.at)
    if len(parameters.values) < _FEWEST:
        raise DriveError(f"{session} has no parameter that can be read and written")
    text, lost = backup_file_text(parameters, session.name)
    work.lines += [f"left out: {each}" for each in (*map(str, left_out), *lost)]
    name = f"{session.name or f'node{session.node_id}'}.dcf"
    work.file = name, text.encode()
    return f"{session}: {len(parameters.values) - len(lost)} parameters in {name}"


def compare(session: NodeSession, work: NodeWork, file: ParameterSet) -> str:
    """Read what a file holds and keep what differs as a table: address, name, file, node."""
    node, left_out = read_same(session, file, work.at)
    why = {each.entry.address: each.why for each in left_out}
    found = differences(file, node)
    work.lines += [*file.identity.strangers(node.identity), *file.identity.variations(node.identity)]
    work.table = [
        (
            f"0x{each.entry.index:04X}:{each.entry.subindex:02X}",
            each.name,
            each.a_text or "-",
            each.b_text or why.get(each.entry.address, "-"),
        )
        for each in found
    ]
    compared = len({*file.values, *node.values})
    if not found:
        return f"{file.where} and {session}: {compared} parameters, equal"
    return f"{file.where} and {session}: {len(found)} of {compared} parameters differ"


def restore(
    session: NodeSession, work: NodeWork, file: ParameterSet, options: RestoreOptions, *, any_node: bool = False
) -> str:
    """Write what a file holds and prove it; DriveError where the node has refused some."""
    if session.od is None:
        session.od = file.od.for_node(session.node_id)
    if not any_node:
        refuse_other_drive(file, session)
    report = guarded_restore(session, file, options, note=work.lines.append, told=work.at)
    work.lines += [f"refused: {each}" for each in report.refused]
    work.lines += [f"kept as it is: {each}" for each in report.protected]
    if report.refused:
        raise DriveError(report.words(session))
    return report.words(session)


def clone_from(session: NodeSession, work: NodeWork, source: NodeDesk, options: RestoreOptions) -> str:
    """Read all parameters of another node and write them into this one."""
    work.doing = f"reading {source.place.name}"
    parameters = source.with_session(lambda other: read_parameters(other, told=work.at)[0])
    work.doing = f"writing {session.name or session}"
    work.done, work.total = 0, None
    return restore(session, work, parameters, options, any_node=True)
