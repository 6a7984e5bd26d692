"""Load a program into a node over CANopen (CiA 302-3), start it, and check that it runs.

The program is stopped and cleared (0x1F51), sent (0x1F50, by block transfer) and started. Then the flash status
(0x1F57), the program identification (0x1F56) and its date (0x1F52) are read. An interrupted transfer restarts from the
first byte; after a loss of power the same command finds the boot loader and starts again. The file is sent unchanged:
its format is up to the manufacturer. The following are refused: a moving node, a node that a running robot controls, a
product other than that of the EDS, and a node without these objects, which may need the manufacturer's own tool.

Exit codes: 0 the new program runs; 1 it does not; 2 wrong usage, wrong file or wrong product.
"""

from __future__ import annotations

import argparse
import datetime
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from canopen_control.cli.support.arguments import whole, whole_number
from canopen_control.cli.support.open_session import add_session_arguments, open_session
from canopen_control.cli.support.output import Progress, json_text, watched
from canopen_control.commissioning.program_download import (
    DownloadProgress,
    ProgramDate,
    ProgramOptions,
    boot_check,
    download,
    interrupted_words,
    is_loader,
    refuse_no_program,
    refuse_other_product,
)
from canopen_control.commissioning.restore import quiet_node
from canopen_control.errors import CanopenError, ConfigError, DriveError

if TYPE_CHECKING:
    from canopen_control.commissioning.node_session import NodeSession


EXAMPLE = """canopen-control firmware 3 drive-1.4.bin --can can0
         canopen-control firmware 3 drive-1.4.bin --can can0 --eds drive.eds --expect 0x1A2B3C4D
         canopen-control firmware 3 drive-1.4.bin --can can0 --expect-date 2026-11-21"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add_session_arguments(parser)
    parser.add_argument("file", metavar="FILE", help="the firmware file as supplied by the manufacturer")
    parser.add_argument(
        "--program",
        type=whole_number("number of a program: 1 to 254", range(1, 255)),
        default=1,
        metavar="N",
        help="number of the program in the node (default: 1)",
    )
    parser.add_argument("--expect", type=whole, metavar="ID", help="required 0x1F56 before the program is started")
    parser.add_argument(
        "--expect-date",
        type=_date,
        metavar="DAY[TTIME]",
        help="required 0x1F52 of the running program: 2026-11-21, or 2026-11-21T14:30:00",
    )
    parser.add_argument(
        "--confirm", action="store_true", help="confirm a program that runs on trial (0x80, as Zephyr's)"
    )


def run(args: argparse.Namespace) -> int:
    """Run the verb."""
    image = _file(args.file)
    if args.timeout is None and args.can is not None:
        args.timeout = 1.0
    options = ProgramOptions(args.program, args.expect, args.expect_date, confirm=args.confirm)
    progress = DownloadProgress()
    with open_session(args) as session:
        identity = session.identity()
        refuse_other_product(session, identity)
        if is_loader(identity):
            print(f"canopen-control: {session} is in its boot-loader", file=sys.stderr)
        with quiet_node(session, starts_again=False):
            _download(session, image, options, progress)
        boot_check(session, identity)
    if args.json:
        document = {
            "node_id": session.node_id,
            "program": args.program,
            "bytes": len(image),
            "old": progress.old,  # 0x1F56 and, as a date, 0x1F52; null where the node has none
            "new": progress.new,
            "old_date": _text(progress.old_date),
            "new_date": _text(progress.new_date),
            "tries": progress.tries,
            "notes": progress.notes,
        }
        print(json_text(document))
        return 0
    for note in progress.notes:
        print(f"{session}: {note}")
    old, new = _program(progress.old, progress.old_date), _program(progress.new, progress.new_date)
    print(f"{session}: program {args.program} of {len(image)} bytes runs: {old} -> {new}")
    return 0


def _file(name: str) -> bytes:
    try:
        image = Path(name).expanduser().read_bytes()
    except OSError as error:
        raise ConfigError(f"{name} cannot be read: {error.strerror}") from None
    refuse_no_program(image, name)
    return image


def _download(session: NodeSession, image: bytes, options: ProgramOptions, progress: DownloadProgress) -> None:
    """Download with a progress bar; print the state of an interrupted download."""
    bar = Progress(f"loading {session}", "bytes", rate=True)
    try:
        with watched(bar, session.transfers.progress):
            download(session, image, options, progress)
    except (CanopenError, KeyboardInterrupt) as error:
        if progress.untouched:
            raise
        raise DriveError(interrupted_words(session, progress, error)) from error


def _date(text: str) -> ProgramDate:
    """Read a day, or a day and a time, of an argument."""
    day, _, time = text.partition("T")
    try:
        of_day = datetime.time.fromisoformat(time) if time else None
        milliseconds = None if of_day is None else _milliseconds(of_day)
        return ProgramDate(datetime.date.fromisoformat(day), milliseconds)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a date: 2026-11-21, or 2026-11-21T14:30:00") from None


def _milliseconds(time: datetime.time) -> int:
    return ((time.hour * 60 + time.minute) * 60 + time.second) * 1000 + time.microsecond // 1000


def _program(number: int | None, date: ProgramDate | None) -> str:
    value = "unknown" if number is None else f"0x{number:08X}"
    return value if date is None else f"{value} of {date}"


def _text(date: ProgramDate | None) -> str | None:
    return None if date is None else str(date)
