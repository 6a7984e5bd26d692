"""Watch a running robot, or a bare bus, in live tables in the terminal.

For a running robot it shows drives, joints, cycle, events, emergencies and, while their tabs are open, the frames of
its buses. Space is STOP (ramp, disable, latched until released); e/d/f enable, disable and fault-reset the selected
drive, E/D/F all of them. With --can it only receives and never sends: it builds the tables from heartbeats, TPDOs and
emergencies, with the names of --config or --eds. STOP is not a safety function (ISO 13850).

Exit codes: 0 quit by the user; 1 the terminal or the robot is gone; 2 wrong usage, or no robot runs.
"""

from __future__ import annotations

import importlib.util
import os
import sys
from typing import TYPE_CHECKING

from canopen_control.cli.support.parsers import add_robot_name
from canopen_control.errors import ConfigError

if TYPE_CHECKING:
    import argparse

    from canopen_control.monitor.sources import ScreenSource


EXAMPLE = """canopen-control monitor
         canopen-control monitor --can can0 --config robby
         canopen-control monitor --can can0 --eds 3=TMCM-1270.eds"""
NICENESS = 5  # the robot has priority
FRAME_RATE = "500"  # Hz: changes are drawn within 2 ms, while the robot is idle


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    group = parser.add_mutually_exclusive_group()
    add_robot_name(group)
    group.add_argument("--can", metavar="CHANNEL", help="only listen, on this channel (can0, local:NAME, ...)")
    parser.add_argument(
        "--config", metavar="ROBOT", help="with --can: use the names of this robot, a folder or a bundled robot"
    )
    parser.add_argument("--bus", metavar="NAME", help="with --config: bus of a robot with several buses")
    parser.add_argument(
        "--eds",
        action="append",
        default=[],
        metavar="[NODE=]FILE",
        help="with --can: use the names of an EDS, for one node or all; or a folder of DCF files (repeatable)",
    )


def run(args: argparse.Namespace) -> int:
    """Run the verb."""
    if args.can is None and (args.config or args.eds or args.bus):
        raise ConfigError("--config, --bus and --eds require --can; a running robot provides its own names")
    if importlib.util.find_spec("textual") is None:
        raise ConfigError("the monitor needs textual: pip install 'canopen-control[monitor]'")
    source = _source(args)
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        raise ConfigError("the monitor needs a terminal; for a script: canopen-control status --json")
    os.environ.setdefault("TEXTUAL_FPS", FRAME_RATE)
    from canopen_control.monitor.monitor_app import MonitorApp

    os.nice(NICENESS)
    MonitorApp(source).run()
    return 0


def _source(args: argparse.Namespace) -> ScreenSource:
    from canopen_control.monitor.sources import BusSource, LiveRobot

    if args.can is None:
        from canopen_control.client import select_robot

        return LiveRobot(select_robot(args.name))
    from canopen_control.cli.support.bus_description import watched_bus
    from canopen_control.monitor.frame_tables import LABEL
    from canopen_control.trace.listen import open_listener

    watched = watched_bus(args, args.can)
    open_listener(watched.channel, LABEL, owner=watched.owner).close()  # an error appears before the screen opens
    watched.report_notes()
    return BusSource(watched.network, owner=watched.owner)
