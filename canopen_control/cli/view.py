"""Serve a web page of the robot: 3D, plots, drives, events, and a large STOP.

The page is reachable from this computer only, unless you give --host, and only with its token: anyone who has the full
address can use the page. --address prints it again. --teleop adds buttons that drive while they are held. STOP is a
function of this program, not a safety function (ISO 13850).

Exit codes: 0 after Ctrl-C; 1 the page cannot be served; 2 wrong usage, no robot runs, or the extra [view] is missing.
"""

from __future__ import annotations

import os
import sys
from typing import TYPE_CHECKING

from canopen_control.cli.support.arguments import whole_number
from canopen_control.cli.support.parsers import add_robot_name
from canopen_control.errors import CanopenError
from canopen_control.view import require_view

if TYPE_CHECKING:
    import argparse


EXAMPLE = """canopen-control view
         canopen-control view --teleop --port 9000
         canopen-control view --address"""
NICENESS = 5  # the robot has priority


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add_robot_name(parser)
    parser.add_argument("--teleop", action="store_true", help="add buttons that drive the robot while they are held")
    parser.add_argument(
        "--host", default="127.0.0.1", metavar="ADDRESS", help="address to listen on (default: this computer only)"
    )
    parser.add_argument(
        "--port",
        type=whole_number("port: 0 to 65535", range(65536)),
        help="port (default: 8080, or the next free one; 0: any)",
    )
    parser.add_argument(
        "--address", action="store_true", help="print the address of the page that is being served, with its token"
    )


def run(args: argparse.Namespace) -> int:
    """Run the verb until Ctrl-C."""
    if args.address:
        return _print_addresses(args.name)
    require_view()
    os.nice(NICENESS)  # before the imports, because threads inherit the niceness of their creator
    from canopen_control.view.view_app import main

    main(args.name, args.host, args.port, teleop=args.teleop)
    return 0


def _print_addresses(name: str | None) -> int:
    from canopen_control.view.page_address import page_addresses

    addresses = page_addresses(name)
    if not addresses:
        robot = "a robot" if name is None else f"robot {name}"
        raise CanopenError(f"no page of {robot} is served; start it: canopen-control view")
    sys.stdout.writelines(f"{url}\n" for url in addresses.values())
    return 0
