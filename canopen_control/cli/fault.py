"""Inject and clear faults in a running virtual drive or device; set the inputs of a device.

`fault list` explains every fault and how a correct master reacts to it. `fault NODE NAME on|off` switches one. `fault
NODE` lists the active faults. `fault NODE SIGNAL=VALUE[,SIGNAL=VALUE]` sets inputs of a virtual device that is not a
drive, in their units: `di0=1`, `position=3.14`. NODE is a node or a joint of a running robot, by name; or a node-ID,
with --can CHANNEL if no robot runs. The command goes to the drive's own control socket: it needs no master, and works
while the bus is disturbed. To disturb the bus itself use `bus fault`.

Exit codes: 0 done; 1 refused, not active, or no answer; 2 wrong usage, no such node or fault.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.cli.support.arguments import one_name, switched_on
from canopen_control.cli.support.known_nodes import connect_to, drive_of
from canopen_control.cli.support.output import json_text, print_entry
from canopen_control.client.drive_client import signal_values
from canopen_control.errors import ConfigError, ControlError
from canopen_control.rpc.messages.drive import ListFaults, SetSignals, SwitchFault
from canopen_control.virtual.fault_table import FAULTS, find_fault

if TYPE_CHECKING:
    import argparse

    from canopen_control.client.drive_client import DriveClient
    from canopen_control.virtual.fault_table import Fault


EXAMPLE = """canopen-control fault list
         canopen-control fault left_drive heartbeat_lost on
         canopen-control fault left_drive heartbeat_lost off
         canopen-control fault io_module di0=1,ai0=16384
         canopen-control fault 3 --can local:robby"""

_ON_THE_BUS = ("cut", "uncut", "drop", "delay", "error-frame", "restart", "bitrate", "clear")
_BUS_FAULTS = (
    f"Faults of the bus ({', '.join(_ON_THE_BUS)}, bus-off): canopen-control bus fault CHANNEL ... (see its --help)"
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.usage = (
        "canopen-control fault list [--json]\n       canopen-control fault NODE [NAME on|off] [--can CHANNEL]\n"
        "       canopen-control fault NODE SIGNAL=VALUE[,SIGNAL=VALUE] [--can CHANNEL]"
    )
    parser.add_argument(
        "what",
        type=one_name,
        metavar="list|NODE",
        help="list: explain all faults; otherwise a node, a joint or a node-ID",
    )
    parser.add_argument(
        "name",
        nargs="?",
        metavar="NAME",
        help="name of the fault, or SIGNAL=VALUE; without a name the active faults are listed",
    )
    parser.add_argument("state", nargs="?", choices=["on", "off"], help="switch the fault on or off")
    parser.add_argument("--can", metavar="CHANNEL", help="channel of the drive (default: channel of the running robot)")


def run(args: argparse.Namespace) -> int:
    """Run the verb; raise ConfigError for a wrong argument, RemoteError if the drive is not running or refuses."""
    if args.what == "list":
        return _list(args)
    channel, node_id = drive_of(args.what, args.can)
    with connect_to(channel, node_id) as client:
        if args.name is None:
            return _report(args, [fault.name for fault in client.ask(ListFaults()) if fault.on], node_id)
        if "=" in args.name:
            return _set(args, client, node_id)
        fault = _check(args.name)
        on = switched_on(args, "fault")
        before = [fault.name for fault in client.ask(ListFaults()) if fault.on]
        active = client.ask(SwitchFault(name=args.name, on=on)).active
        if not on and set(active) == set(before):
            raise ControlError(f"node {node_id}: nothing was switched off, because {args.name} was not on")
        if fault.quirk and not args.json:
            print(f"{fault.name} is a quirk of healthy drives: canopen-control quirk {args.what} {fault.quirk} on|off")
        return _report(args, active, node_id)


# -- list of faults


def _list(args: argparse.Namespace) -> int:
    if args.name is not None:
        raise ConfigError("fault list takes no arguments; for one drive: fault NODE --can CHANNEL")
    if args.json:
        keys = ("name", "row", "acts", "does", "reaction", "once")
        print(json_text([{key: getattr(fault, key) for key in keys} for fault in FAULTS.values()]))
        return 0
    for fault in FAULTS.values():
        duration = "once" if fault.once else "until it is switched off"
        duration = f"the quirk {fault.quirk}" if fault.quirk else duration
        print_entry(fault.name, f"{_sentence(fault.does)} ({duration}). A correct master: {fault.reaction}.")
    print(f"\n{_BUS_FAULTS}")
    return 0


def _sentence(does: str) -> str:
    """Return the effect of a fault or quirk as a sentence."""
    return f"I{does[1:]}" if does.startswith("its ") else f"The drive {does}"


# -- one drive


def _set(args: argparse.Namespace, client: DriveClient, node_id: int) -> int:
    """Set inputs of a virtual device, and print the new values."""
    if args.state is not None:
        raise ConfigError(f"{args.name} {args.state}: a signal is set with SIGNAL=VALUE alone")
    values = signal_values(args.name)
    client.ask(SetSignals(values=values))
    if args.json:
        print(json_text({"node_id": node_id, "signals": values}, indent=None))
    else:
        print(f"node {node_id}: {', '.join(f'{name} is {value:g}' for name, value in values.items())}")
    return 0


def _check(name: str) -> Fault:
    if name in _ON_THE_BUS:
        raise ConfigError(f"{name} is a fault of the bus, not of a drive: canopen-control bus fault CHANNEL {name} ...")
    return find_fault(name)


def _report(args: argparse.Namespace, active: list[str], node_id: int) -> int:
    if args.json:
        print(json_text({"node_id": node_id, "active": active}, indent=None))
    else:
        print(f"node {node_id}: {', '.join(active) or 'no active fault'}")
    return 0
