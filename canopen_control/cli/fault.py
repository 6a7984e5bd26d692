"""`fault`: break a running virtual drive, and mend it again.

`fault list` explains every fault and what a good master makes of it. `fault NODE NAME on|off --can CHANNEL` switches
one, `fault NODE --can CHANNEL` tells which are on. It speaks to the drive's own control socket: no master is needed,
and the bus may be broken. What breaks the wire itself is `bus fault`.
"""

from __future__ import annotations

import json
import textwrap
from typing import TYPE_CHECKING, Any

from canopen_control.bus.channel import parse_channel
from canopen_control.errors import ConfigError, RemoteError
from canopen_control.host.lineclient import LineClient
from canopen_control.host.sockets import list_sockets
from canopen_control.virtual.control import control_path
from canopen_control.virtual.faults import FAULTS, find_fault

if TYPE_CHECKING:
    import argparse

__all__ = ["EXAMPLE", "add_arguments", "run"]

EXAMPLE = """canopen-control fault list
         canopen-control fault 3 heartbeat_lost on --can local:robby"""

_WIDTH = 110
_ON_THE_BUS = ("cut", "uncut", "drop", "delay", "error-frame", "restart", "bitrate", "clear")
_BUS_FAULTS = (
    f"The wire itself ({', '.join(_ON_THE_BUS)}, bus-off): canopen-control bus fault CHANNEL ..., see bus fault --help"
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.usage = "canopen-control fault list [--json]\n       canopen-control fault NODE [NAME on|off] --can CHANNEL"
    parser.add_argument("what", metavar="list|NODE", help="list: explain all faults; else the node id of the drive")
    parser.add_argument("name", nargs="?", metavar="NAME", help="of the fault; without: which are on")
    parser.add_argument("state", nargs="?", choices=["on", "off"], help="default: on")
    parser.add_argument("--can", metavar="CHANNEL", help="the bus the drive is on: local:NAME, vcan0, ...")
    parser.add_argument("--json", action="store_true", help="print JSON")


def run(args: argparse.Namespace) -> int:
    """Run the verb: 0 good, 1 the drive is not there, 2 wrong usage."""
    if args.what == "list":
        return _list(args)
    if args.can is None:
        raise ConfigError("which bus is the drive on? --can CHANNEL, as in --can local:robby")
    channel = str(parse_channel(args.can))
    node_id = _node_id(args.what)
    with _connect(channel, node_id) as client:
        if args.name is None:
            faults = _call(client, "faults")
            return _tell(args, [fault["name"] for fault in faults if fault["on"]], node_id)
        _check(args.name)
        answer = _call(client, "fault", name=args.name, on=args.state != "off")
        return _tell(args, answer["active"], node_id)


# -- what there is


def _list(args: argparse.Namespace) -> int:
    if args.name is not None:
        raise ConfigError("fault list takes no more words; those of one drive: fault NODE --can CHANNEL")
    if args.json:
        keys = ("name", "row", "acts", "does", "reaction", "once")
        print(json.dumps([{key: getattr(fault, key) for key in keys} for fault in FAULTS.values()], indent=2))
        return 0
    for fault in FAULTS.values():
        how = "once" if fault.once else "until it is switched off"
        text = f"{_sentence(fault.does)} ({how}). A good master: {fault.reaction}."
        print(fault.name)
        print(textwrap.fill(text, _WIDTH, initial_indent="    ", subsequent_indent="    "))
    print(f"\n{_BUS_FAULTS}")
    return 0


def _sentence(does: str) -> str:
    """Say what a broken drive does, or what is wrong with what is its own."""
    return f"I{does[1:]}" if does.startswith("its ") else f"The drive {does}"


# -- one drive


def _node_id(text: str) -> int:
    try:
        node_id = int(text, 0)
    except ValueError:
        node_id = 0
    if not 1 <= node_id <= 127:
        raise ConfigError(f"{text!r} is no node id: 1 to 127, or list")
    return node_id


def _check(name: str) -> None:
    if name in _ON_THE_BUS:
        raise ConfigError(f"{name} breaks the wire, not a drive: canopen-control bus fault CHANNEL {name} ...")
    find_fault(name)


def _connect(channel: str, node_id: int) -> LineClient:
    path = control_path(channel, node_id)
    bus = path.stem.removeprefix("drive-").rpartition("-")[0]
    try:
        return LineClient(path, label=f"the virtual drive {node_id} on {channel}")
    except RemoteError as error:
        there = _others(bus)
        raise RemoteError(error.kind, f"no virtual drive with node id {node_id} runs on {channel}; {there}") from error


def _others(bus: str) -> str:
    """Say which virtual drives there are: on this bus, else anywhere."""
    found: dict[str, list[int]] = {}
    for other, _, number in (name.rpartition("-") for name in list_sockets("drive")):
        if number.isdecimal():
            found.setdefault(other, []).append(int(number))
    if bus in found:
        return f"there are: {', '.join(map(str, sorted(found[bus])))}"
    if not found:
        return "there is none; canopen-control drive starts one"
    elsewhere = "; ".join(f"{', '.join(map(str, sorted(ids)))} on the bus {name}" for name, ids in found.items())
    return f"there are: {elsewhere}"


def _call(client: LineClient, method: str, **params: object) -> Any:  # noqa: ANN401 - whatever the method answers
    client.send({"id": 1, "method": method, "params": params})
    while (answer := client.receive()) is not None:
        if answer.get("id") != 1:
            continue  # the greeting, and events
        if "error" not in answer:
            return answer["result"]
        error = answer["error"]
        if error["kind"] == "ConfigError":
            raise ConfigError(error["message"])
        raise RemoteError(error["kind"], error["message"])
    raise RemoteError("Timeout", f"{client.label} does not answer; does it hang?")


def _tell(args: argparse.Namespace, active: list[str], node_id: int) -> int:
    if args.json:
        print(json.dumps({"node_id": node_id, "active": active}))
    else:
        print(f"node {node_id}: {', '.join(active) or 'no fault is on'}")
    return 0
