"""`view`: the robot on a page of this computer: 3D, plots, drives, events, and a large STOP.

The page is for this computer alone unless --host says otherwise; then its address holds a token. --teleop adds buttons
that drive while they are held. STOP is a function of this program, no safety function (ISO 13850).
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

from canopen_control.cli.support.arguments import whole_number
from canopen_control.view import require_view

if TYPE_CHECKING:
    import argparse

__all__ = ["EXAMPLE", "add_arguments", "run"]

EXAMPLE = """canopen-control view
         canopen-control view --teleop --port 9000"""
NICENESS = 5  # the robot goes first


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--name", help="the robot (default: the only one that runs)")
    parser.add_argument("--teleop", action="store_true", help="buttons that drive the robot while they are held")
    parser.add_argument(
        "--host", default="127.0.0.1", metavar="ADDRESS", help="where to listen (default: this computer alone)"
    )
    parser.add_argument(
        "--port",
        type=whole_number("port: 0 to 65535", range(65536)),
        help="default: 8080, or the next that is free; 0: any",
    )


def run(args: argparse.Namespace) -> int:
    """Run the verb until Ctrl-C."""
    require_view()
    os.nice(NICENESS)  # before anything is imported: a thread has the niceness that its maker had when it began
    from canopen_control.view.view_app import main

    main(args.name, args.host, args.port, teleop=args.teleop)
    return 0
