"""Save the parameters of a node as a DCF file.

The file holds all read/write objects except commands and live values, each as ParameterValue, with identity, software
version and date. `diff` compares it, `restore` writes it back, and a bus.yml can name it as `dcf`. Everything is read
twice; values that differ between reads, and objects the node refuses, are omitted and listed. Nothing is written to the
node, so this works while a robot runs. On a bare bus (--can) give the EDS.

Exit codes: 0 good; 1 the node did not answer, or the disk is full; 2 wrong usage.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

from canopen_control.cli.support.open_session import add_session_arguments, open_session, reached, read_all
from canopen_control.cli.support.output import json_text
from canopen_control.commissioning.parameter_set import backup_file_text
from canopen_control.commissioning.restore import unfinished_words
from canopen_control.errors import CanopenError, ConfigError
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
    path = Path(args.output).expanduser()
    if path.is_dir() or not path.parent.is_dir():
        raise ConfigError(f"{args.output} cannot be written: {'it is a folder' if path.is_dir() else 'no such folder'}")
    with open_session(args) as session:
        if unfinished := unfinished_words(session, reached(args)):
            print(f"canopen-control: {unfinished}", file=sys.stderr)
        side = read_all(session)
        name = session.name
    if not side.parameters.values:
        raise CanopenError(
            f"{side.parameters.where} has no parameter that can be read and written; nothing was written"
        )
    text, lost = backup_file_text(side.parameters, name)
    write_whole(path, text.encode())
    left_out = [*map(str, side.left_out), *lost]
    count = len(side.parameters.values) - len(lost)
    if args.json:
        node = {"node_id": side.parameters.node_id, "node": name or None}
        print(json_text({**node, "file": args.output, "parameters": count, "left_out": left_out}))
        return 0
    for line in left_out:
        print(f"canopen-control: left out: {line}", file=sys.stderr)
    print(f"{side.parameters.where}: {count} parameters to {args.output}")
    return 0
