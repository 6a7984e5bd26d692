"""Write the parameters of a DCF file to a node, and verify them.

The node is read first and only differences are written, in an order that devices accept: PDOs are disabled while they
are changed, resolutions are written before values, limits before the values they limit. Everything is read back. If the
node refuses a value, the reason is printed and all previous values are written back, unless you give --keep. Nothing is
stored without --store. The previous values are saved to the disk before anything is written: if a restore was killed
half-way, the same command continues it, and any other restore prints how to restore the previous values.

The following are refused: another product, an axis with torque, a node that a running robot controls, and a drive whose
node-ID and serial number both differ from the file (--any-node). Node-ID and bit rate are never written, and the
calibration of another drive only with --include-protected.

Exit codes: 0 the node has all values; 1 it refused a value, or did not answer; 2 wrong usage or wrong file.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.cli.support.job_verb import add_job_options, job_options, print_restored, verb_run
from canopen_control.cli.support.open_session import add_session_arguments, backup_file, open_session, reached
from canopen_control.cli.support.target import refuse_as_node
from canopen_control.commissioning.jobs import RESTORE
from canopen_control.commissioning.parameter_jobs import run_restore

if TYPE_CHECKING:
    import argparse


EXAMPLE = """canopen-control restore node3.dcf 3 --can can0 --store
         canopen-control restore node3.dcf 3 --can can0 --protect '0x2*' --protect 'Home offset'"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("file", metavar="FILE", help="a DCF of `backup` or another tool")
    add_session_arguments(parser)
    add_job_options(parser, RESTORE)


def run(args: argparse.Namespace) -> int:
    """Run the verb."""
    refuse_as_node(args, args.node, f"restore {args.node} {args.file}", file=args.file)
    file, options = backup_file(args.file), job_options(args, RESTORE, reached=reached(args))
    with open_session(args) as session, verb_run(RESTORE) as run:
        sentence = run_restore(session, run, file, options)
    return print_restored(args, run, sentence)
