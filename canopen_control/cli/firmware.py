"""Load a program into a node over CANopen (CiA 302-3), start it, and check that it runs.

The program is stopped and cleared (0x1F51), sent (0x1F50, by block transfer) and started. Then the flash status
(0x1F57), the program identification (0x1F56) and its date (0x1F52) are read. An interrupted transfer restarts from the
first byte; after a loss of power the same command finds the boot-loader and starts again. The file is sent unchanged:
its format is up to the manufacturer. The following are refused: a moving node, a node that a running robot controls, a
product other than that of the EDS, and a node without these objects, which may need the manufacturer's own tool.

Exit codes: 0 the new program runs; 1 it does not; 2 wrong usage, wrong file or wrong product.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from canopen_control.cli.support.job_verb import add_job_options, job_options, print_run, verb_run
from canopen_control.cli.support.open_session import add_session_arguments, open_session
from canopen_control.cli.support.target import refuse_as_node
from canopen_control.commissioning.jobs import FIRMWARE
from canopen_control.commissioning.program_download import load_program, refuse_no_program
from canopen_control.errors import ConfigError

if TYPE_CHECKING:
    import argparse


EXAMPLE = """canopen-control firmware 3 drive-1.4.bin --can can0
         canopen-control firmware 3 drive-1.4.bin --can can0 --eds drive.eds --expect 0x1A2B3C4D
         canopen-control firmware 3 drive-1.4.bin --can can0 --expect-date 2026-11-21"""
_BUS_TIMEOUT_S = 1.0  # an erase or a write of flash delays answers


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add_session_arguments(parser)
    parser.add_argument("file", metavar="FILE", help="the firmware file as supplied by the manufacturer")
    add_job_options(parser, FIRMWARE)


def run(args: argparse.Namespace) -> int:
    """Run the verb."""
    refuse_as_node(args, args.node, f"firmware {args.file} {args.node}", file=args.file)
    image = _file(args.file)
    if args.timeout is None and args.can is not None:
        args.timeout = _BUS_TIMEOUT_S
    with open_session(args) as session, verb_run(FIRMWARE) as run:
        sentence = load_program(session, run, image, job_options(args, FIRMWARE))
    return print_run(args, run, sentence)


def _file(name: str) -> bytes:
    try:
        image = Path(name).expanduser().read_bytes()
    except OSError as error:
        raise ConfigError(f"{name} cannot be read: {error.strerror}") from None
    refuse_no_program(image, name)
    return image
