"""Copy all parameters of a drive to a replacement of the same product, and verify that both are equal.

The new drive keeps its node-ID, bit rate, identity and encoder calibration. COB-IDs that depend on the node-ID are
adapted to the new one. Everything else works as in `restore`: only differences are written, everything is read
back, after a refused value the previous values are restored, and nothing is stored without --store. If the old drive
has failed, use `restore` with its backup.

Exit codes: 0 both are equal; 1 the new drive refused a value, or a drive did not answer; 2 wrong usage.
"""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING

from canopen_control.cli.support.arguments import one_name
from canopen_control.cli.support.job_verb import add_job_options, job_options, print_restored, verb_run
from canopen_control.cli.support.open_session import add_session_arguments, open_sessions, reached
from canopen_control.cli.support.target import refuse_as_node
from canopen_control.commissioning.jobs import CLONE
from canopen_control.commissioning.parameter_jobs import run_clone
from canopen_control.errors import ConfigError

if TYPE_CHECKING:
    import argparse


EXAMPLE = """canopen-control clone 3 4 --can can0 --eds TMCM-1270.eds --store"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("a", type=one_name, metavar="A", help="drive to read")
    parser.add_argument("b", type=one_name, metavar="B", help="drive to write")
    add_session_arguments(parser, node=False)
    add_job_options(parser, CLONE)


def run(args: argparse.Namespace) -> int:
    """Run the verb."""
    refuse_as_node(args, args.a, f"restore {args.a} {args.b}")
    refuse_as_node(args, args.b, f"backup {args.a} -o {args.b}")
    if args.a == args.b:
        raise ConfigError(f"{args.a} and {args.b} are the same node; name the old drive, then the new one")
    options = job_options(args, CLONE, reached=reached(args))
    with open_sessions(args, [args.a, args.b]) as (sessions, _), verb_run(CLONE) as run:
        sentence = run_clone(sessions[args.b], run, contextlib.nullcontext(sessions[args.a]), options)
    return print_restored(args, run, sentence)
