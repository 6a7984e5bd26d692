"""List the object dictionary of a node: names, units, defaults, and current values.

WHAT is an address (0x6081, 0x1018:01), a pattern (0x60*, *velocity*) or a part of a name; several arguments select all
objects that match any of them. --live reads each object, explains its value, and marks values that differ from the
default with *. Without it the node is not read, and with --eds no node is needed.

Exit codes: 0 success; 1 the node does not answer, or --changed found nothing; 2 wrong usage, no such object.
"""

from __future__ import annotations

import contextlib
import sys
from typing import TYPE_CHECKING

from canopen_control.cli.support.object_table import live_objects, table_lines, tree_lines
from canopen_control.cli.support.open_session import add_session_arguments, open_session
from canopen_control.cli.support.output import json_text
from canopen_control.cli.support.target import find_eds, parse_node_id
from canopen_control.commissioning.object_rows import LiveObject, rows_of, select_objects
from canopen_control.od.eds import read_eds

if TYPE_CHECKING:
    import argparse

    from canopen_control.od.model import ObjectDictionary


EXAMPLE = """canopen-control objects left_drive "0x60*" --live
         canopen-control objects left_drive velocity
         canopen-control objects 3 "0x1*" --changed
         canopen-control objects 3 --eds TMCM-1270.eds --tree"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add_session_arguments(parser)
    parser.add_argument("what", nargs="*", metavar="WHAT", help="address, pattern or part of a name (default: all)")
    parser.add_argument("--live", action="store_true", help="read each object from the node")
    parser.add_argument(
        "--changed", action="store_true", help="list only values that differ from the default; reads them"
    )
    shape = parser.add_mutually_exclusive_group()
    shape.add_argument("--tree", action="store_true", help="show subindices below their objects")
    shape.add_argument("--json", action="store_true", help="print JSON")


def run(args: argparse.Namespace) -> int:
    """Run the verb."""
    live = args.live or args.changed
    if live or args.eds is None:
        with open_session(args) as session:
            od, node_id = session.dictionary, session.node_id
            entries = select_objects(od, args.what)
            objects = live_objects(session, entries) if live else [LiveObject(entry) for entry in entries]
    else:
        od, node_id = _of_file(args)
        objects = [LiveObject(entry) for entry in select_objects(od, args.what)]
    if args.changed:
        objects = [entry for entry in objects if entry.changed]
        if not objects:
            print("canopen-control: every object has its default value", file=sys.stderr)
            return 1
    rows = rows_of(od, objects, node_id)
    if args.json:
        print(json_text(rows))
    else:
        print("\n".join(tree_lines(od, rows, live=live) if args.tree else table_lines(rows, live=live)))
    return 0


def _of_file(args: argparse.Namespace) -> tuple[ObjectDictionary, int]:
    """Return the object dictionary of --eds and the node-ID, which is 1 if NODE is not a number."""
    node_id = None
    with contextlib.suppress(ValueError):
        int(args.node, 0)
        node_id = parse_node_id(args.node)
    return read_eds(find_eds(args.eds), node_id).od, node_id or 1
