"""Print all current object values of a node, as a table, as CSV, or as a DCF.

Every readable object is read once, one after the other; DOMAINs and objects that ObjFlags exclude from scanning are
left out. The DCF has a ParameterValue for each writable object, including live values; to write values back later,
use a `backup` instead. A node of a running robot is read through that robot, slowly enough not to delay it.

Exit codes: 0 success; 1 the node does not answer or no object could be read; 2 wrong usage, a file that cannot be
written.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from canopen_control.cli.support.object_table import csv_text, live_objects, table_lines, values_of
from canopen_control.cli.support.open_session import add_session_arguments, open_session
from canopen_control.cli.support.output import print_result
from canopen_control.commissioning.object_rows import rows_of, select_objects
from canopen_control.errors import CanopenError
from canopen_control.host.files import write_whole
from canopen_control.od.dcf import dcf_text

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Sequence

    from canopen_control.commissioning.node_session import NodeSession
    from canopen_control.commissioning.object_rows import LiveObject


EXAMPLE = """canopen-control dump left_drive "0x60*"
         canopen-control dump left_drive "0x1*" --format csv -o left_drive.csv
         canopen-control dump 3 --format dcf -o node3.dcf"""

_BITRATE: Final = 1_000_000  # if the file has no bit rate


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add_session_arguments(parser)
    parser.add_argument("what", nargs="*", metavar="WHAT", help="same as for `objects` (default: all)")
    parser.add_argument("--format", choices=list(_FORMATS), default="table", help="output format (default: table)")
    parser.add_argument("-o", "--output", metavar="FILE", help="file to write (default: standard output)")


def run(args: argparse.Namespace) -> int:
    """Run the verb."""
    with open_session(args) as session:
        objects = live_objects(session, select_objects(session.dictionary, args.what))
        if all(entry.value is None for entry in objects):
            raise CanopenError(f"{session}: none of these objects can be read")
        rows = rows_of(session.dictionary, objects, session.node_id)
        text = _FORMATS[args.format](session, objects)
    if args.output is None:
        print_result(args, rows, text.removesuffix("\n"))
        return 0
    write_whole(args.output, text.encode())
    count = sum(entry.value is not None for entry in objects)
    done = {"node_id": session.node_id, "file": args.output, "read": count, "objects": len(objects)}
    print_result(args, done, f"{session}: {count} of {len(objects)} objects to {args.output}")
    return 0


def _table(session: NodeSession, objects: Sequence[LiveObject]) -> str:
    rows = rows_of(session.dictionary, objects, session.node_id)
    return "".join(f"{line}\n" for line in table_lines(rows, live=True))


def _csv(session: NodeSession, objects: Sequence[LiveObject]) -> str:
    return csv_text(rows_of(session.dictionary, objects, session.node_id))


def _dcf(session: NodeSession, objects: Sequence[LiveObject]) -> str:
    od = session.dictionary
    return dcf_text(od, session.node_id, od.bitrate or _BITRATE, values_of(objects), node_name=session.name)


_FORMATS: dict[str, Callable[[NodeSession, Sequence[LiveObject]], str]] = {"table": _table, "csv": _csv, "dcf": _dcf}
