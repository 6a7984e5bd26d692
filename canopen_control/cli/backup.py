"""Save the parameters of a node as a DCF file.

The file contains all read/write objects except commands and live values, each as a ParameterValue, with identity,
software version and date. `diff` compares it, `restore` writes it back, and a bus.yml can name it as `dcf`. Everything
is read twice; values that differ between reads, and objects the node refuses, are omitted and listed. Nothing is
written to the node, so this works while a robot runs. On a bare bus (--can), --eds is needed.

Exit codes: 0 success; 1 the node did not answer, or the disk is full; 2 wrong usage.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from canopen_control.cli.support.job_verb import print_run, verb_run
from canopen_control.cli.support.open_session import add_session_arguments, open_session, reached
from canopen_control.cli.support.target import names_file, refuse_as_node
from canopen_control.commissioning.jobs import BACKUP
from canopen_control.commissioning.parameter_jobs import run_backup
from canopen_control.errors import ConfigError
from canopen_control.host.files import write_whole

if TYPE_CHECKING:
    import argparse


EXAMPLE = """canopen-control backup left_drive -o left_drive.dcf
         canopen-control backup 3 -o node3.dcf --can can0 --eds TMCM-1270.eds"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add_session_arguments(parser)
    parser.add_argument(
        "-o", "--output", metavar="FILE.dcf", required=True, help="file to write; an existing one is overwritten"
    )


def run(args: argparse.Namespace) -> int:
    """Run the verb."""
    node = "NODE" if names_file(args.output) else args.output
    refuse_as_node(args, args.node, f"backup {node} -o {args.output if node == 'NODE' else args.node}")
    if args.output == "-":
        raise ConfigError("-o -: a backup is written to a file; give its name, such as -o node3.dcf")
    path = Path(args.output).expanduser()
    if path.is_dir() or not path.parent.is_dir():
        raise ConfigError(f"{args.output} cannot be written: {'it is a folder' if path.is_dir() else 'no such folder'}")
    with open_session(args) as session, verb_run(BACKUP) as run:
        sentence = run_backup(session, run, reached(args), args.output)
    if run.file is not None:
        write_whole(path, run.file[1])
    return print_run(args, run, sentence)
