"""Compare the parameters of two nodes, two DCF files, or a file with a node.

When comparing a file with a node, only the objects in the file are read; no EDS is needed, since the file is a complete
DCF. COB-IDs that depend on the node-ID are compared without it. Differences in product, revision or software
version are printed to standard error and do not count as parameter differences.

Exit codes, as in the program diff: 0 equal; 1 different, or a node did not answer; 2 wrong usage.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from canopen_control.cli.support.open_session import add_session_arguments, read_both
from canopen_control.cli.support.output import Table, json_text
from canopen_control.commissioning.parameter_jobs import compared

if TYPE_CHECKING:
    import argparse

    from canopen_control.commissioning.parameter_jobs import DiffReport
    from canopen_control.od.model import Address


EXAMPLE = """canopen-control diff left_drive right_drive
         canopen-control diff node3.dcf 3 --can can0"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    for name in ("a", "b"):
        parser.add_argument(name, metavar="FILE|NODE", help="a DCF file, or a node by name or node-ID")
    add_session_arguments(parser, node=False)


def run(args: argparse.Namespace) -> int:
    """Run the verb."""
    a, b = read_both(args.a, args.b, args)
    result = compared(a.parameters, b.parameters)
    if args.json:
        print(json_text(result))
    else:
        _print(result, {unread.entry.address: unread.why for side in (a, b) for unread in side.left_out})
    return 1 if result.differences else 0


def _print(result: DiffReport, why: dict[Address, str]) -> None:
    for line in result.identity:
        print(f"canopen-control: {line}", file=sys.stderr)
    if not result.differences:
        print(f"{result.a} and {result.b}: {result.compared} parameters, equal")
        return
    table = Table(("object", "name", result.a, result.b))
    for row in result.rows(why):
        table.add(row)
    print("\n".join(table.lines()))
