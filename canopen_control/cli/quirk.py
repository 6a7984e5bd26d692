"""Enable and disable quirks of a running virtual drive, such as the quirks of a manufacturer.

A quirk is a documented way in which a healthy drive departs from CiA 301 or CiA 402; a malfunction is a fault. `quirk
list` explains every quirk, its strength and its source. `quirk NODE NAME on|off` switches one, for all axes of the
drive or for one of them: NAME, NAME=VALUE, NAME@AXIS or NAME=VALUE@AXIS. `quirk NODE` lists the active quirks. NODE is
a node or a joint of a running robot, by name; or a node-ID, with --can CHANNEL if no robot runs. To give a drive quirks
from its start, use `drive --quirk`.

Exit codes: 0 done; 1 refused, not active, or no answer; 2 wrong usage, no such node or quirk.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.cli.support.arguments import one_name, switched_on
from canopen_control.cli.support.known_nodes import connect_to, drive_of
from canopen_control.cli.support.output import json_text, print_entry
from canopen_control.errors import ConfigError, ControlError
from canopen_control.rpc.messages.drive import GetDriveState, SwitchQuirk
from canopen_control.virtual.quirks import QUIRKS, parse_quirk

if TYPE_CHECKING:
    import argparse


EXAMPLE = """canopen-control quirk list
         canopen-control quirk left_drive brake_delay=0.5 on
         canopen-control quirk left_drive brake_delay off
         canopen-control quirk 3 --can local:robby"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.usage = (
        "canopen-control quirk list [--json]\n"
        "       canopen-control quirk NODE [NAME[=VALUE][@AXIS] on|off] [--can CHANNEL]"
    )
    parser.add_argument(
        "what",
        type=one_name,
        metavar="list|NODE",
        help="list: explain all quirks; otherwise a node, a joint or a node-ID",
    )
    parser.add_argument(
        "name", nargs="?", metavar="NAME", help="name of the quirk; without a name the active quirks are listed"
    )
    parser.add_argument("state", nargs="?", choices=["on", "off"], help="switch the quirk on or off")
    parser.add_argument("--can", metavar="CHANNEL", help="channel of the drive (default: channel of the running robot)")


def run(args: argparse.Namespace) -> int:
    """Run the verb; raise ConfigError for a wrong argument, RemoteError if the drive is not running or refuses."""
    if args.what == "list":
        return _list(args)
    if args.name is not None:
        parse_quirk(args.name)
    channel, node_id = drive_of(args.what, args.can)
    with connect_to(channel, node_id) as client:
        if args.name is None:
            active = client.ask(GetDriveState()).quirks
        else:
            on = switched_on(args, "quirk")
            before = client.ask(GetDriveState()).quirks
            active = client.ask(SwitchQuirk(quirk=args.name, on=on)).active
            if not on and active == before:
                raise ControlError(f"node {node_id}: nothing was switched off, because {args.name} was not on")
    if args.json:
        print(json_text({"node_id": node_id, "active": active}, indent=None))
    else:
        print(f"node {node_id}: {', '.join(active) or 'no active quirk'}")
    return 0


def _list(args: argparse.Namespace) -> int:
    if args.name is not None:
        raise ConfigError("quirk list takes no arguments; for one drive: quirk NODE --can CHANNEL")
    listings = [quirk.listing() for quirk in QUIRKS.values()]
    if args.json:
        keys = ("name", "acts", "does", "clause", "source", "unit", "default", "low", "high")
        print(json_text([{key: getattr(listing, key) for key in keys} for listing in listings]))
        return 0
    for listing in listings:
        strength = ""
        if listing.default is not None:
            strength = (
                f" Strength: {listing.low:.10g} to {listing.high:.10g} {listing.unit} (default: {listing.default:g})."
            )
        clause = listing.clause or "no clause"
        text = f"The drive {listing.does}.{strength} Departs from {clause}. Source: {listing.source}."
        print_entry(listing.name, text)
    return 0
