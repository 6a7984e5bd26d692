"""Write the parameters of a DCF file to a node, and verify them.

The node is read first and only differences are written, in an order that devices accept: PDOs are disabled while they
are changed, resolutions are written before values, limits before the values they limit. Everything is read back. If the
node refuses a value, the reason is printed and all previous values are written back, unless you give --keep. Nothing is
stored without --store. The previous values are kept on the disk before anything is written: after a restore that was
killed half-way the same command continues it, and the next one prints how to restore the previous values.

The following are refused: another product, an axis with torque, a node that a running robot controls, and a drive whose
node id and serial number both differ from the file (--any-node). Node id and bit rate are never written, and the
calibration of another drive only with --include-protected.

Exit codes: 0 the node holds all of it; 1 it refused a value, or did not answer; 2 wrong usage or wrong file.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.cli.support.open_session import (
    add_restore_arguments,
    add_session_arguments,
    backup_file,
    like_file,
    open_session,
    restore_into,
)
from canopen_control.commissioning.restore import refuse_other_drive

if TYPE_CHECKING:
    import argparse


EXAMPLE = """canopen-control restore node3.dcf 3 --can can0 --store
         canopen-control restore node3.dcf 3 --can can0 --protect '0x2*' --protect 'Home offset'"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("file", metavar="FILE", help="a DCF of `backup` or another tool")
    add_session_arguments(parser)
    parser.add_argument("--any-node", action="store_true", help="accept a drive with another node id and serial number")
    add_restore_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Run the verb."""
    file = backup_file(args.file)
    with open_session(args) as session:
        if not args.any_node:
            refuse_other_drive(file, like_file(session, file))
        return restore_into(like_file(session, file), file, args)
