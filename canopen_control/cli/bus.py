"""Channels: what there is, who is on them, interfaces up and down, and faults on a local bus.

A channel is local:NAME, a CAN interface such as can0 or vcan0, or a python-can adapter as INTERFACE:CHANNEL.
"""

from __future__ import annotations

import dataclasses
import json
import sys
from typing import TYPE_CHECKING, Any

from canopen_control.bus import link as links
from canopen_control.bus.channel import ChannelKind, ChannelSpec, parse_channel
from canopen_control.bus.hubclient import ask_hub
from canopen_control.cli.bus_interfaces import render_interface, status_of_interfaces
from canopen_control.cli.numbers import whole
from canopen_control.cli.table import Table
from canopen_control.errors import ConfigError, InterfaceNotFound
from canopen_control.host.sockets import list_sockets

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable

__all__ = ["EXAMPLE", "add_arguments", "run"]

EXAMPLE = "canopen-control bus fault local:robby cut left_drive"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    listing = actions.add_parser("list", help="interfaces, local buses, python-can adapters")
    status = actions.add_parser("status", help="who is there, load and counters")
    status.add_argument("channel", nargs="?", metavar="CHANNEL", help="default: all local buses and CAN interfaces")
    for action in (listing, status):
        action.add_argument("--json", action="store_true", help="print JSON")
    up = actions.add_parser("up", help="bring a CAN interface up; a vcan is made first")
    up.add_argument("interface", metavar="INTERFACE")
    up.add_argument("--bitrate", type=int, metavar="BIT/S", help="for real interfaces")
    up.add_argument("--restart-ms", type=int, metavar="MS", help="restart that long after bus-off; 0: never")
    up.add_argument("--sample-point", type=float, metavar="0.875")
    down = actions.add_parser("down", help="take a CAN interface down")
    down.add_argument("interface", metavar="INTERFACE")
    _add_faults(actions.add_parser("fault", help="break and mend a local bus"))


def _add_faults(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("channel", metavar="CHANNEL", help="local:NAME")
    faults = parser.add_subparsers(dest="fault", metavar="FAULT", required=True)
    for name, text in _ON_ONE.items():
        faults.add_parser(name, help=text).add_argument("label", metavar="LABEL")
    drop = faults.add_parser("drop", help="lose frames that LABEL, or anybody, sends")
    drop.add_argument("--id", dest="can_id", type=whole, metavar="COB-ID", help="only this identifier")
    drop.add_argument("--every", type=int, metavar="N", help="only every Nth of them")
    drop.add_argument("--count", type=int, metavar="N", help="N of them, then no more")
    delay = faults.add_parser("delay", help="deliver late what LABEL, or anybody, sends")
    delay.add_argument("--ms", type=int, required=True, metavar="MS", help="0 ends it")
    error = faults.add_parser("error-frame", help="let the controller of LABEL, or all, report an error")
    error.add_argument("--kind", choices=["bus-error", "error-passive", "error-active", "overrun"], default="bus-error")
    for fault in (drop, delay, error):
        fault.add_argument("label", nargs="?", default="", metavar="LABEL")
    rate = faults.add_parser("bitrate", help="make frames take their time, with arbitration; off ends it")
    rate.add_argument("bitrate", metavar="BIT/S")
    faults.add_parser("clear", help="mend everything but the bit rate")


_ON_ONE = {
    "cut": "cut the cable of LABEL: nothing from it, nothing to it",
    "uncut": "mend the cable of LABEL",
    "bus-off": "send the controller of LABEL off the bus",
    "restart": "restart the controller of LABEL after bus-off",
}


def run(args: argparse.Namespace) -> int:
    """Run the verb."""
    return _ACTIONS[args.action](args)


# list ----------------------------------------------------------------------------------------------------------------


def _list(args: argparse.Namespace) -> int:
    interfaces = _links()
    local = [f"local:{name}" for name in list_sockets("bus")]
    adapters = _adapters()
    if args.json:
        found = {"interfaces": [_plain(link) for link in interfaces], "local": local, "python_can": adapters}
        print(json.dumps(found, indent=2))
        return 0
    names = [f"{link.name} ({'up' if link.is_up else 'down'})" for link in interfaces]
    print(f"CAN interfaces:      {', '.join(names) or 'none'}")
    print(f"local buses:         {', '.join(local) or 'none is open'}")
    print(f"python-can adapters: {', '.join(adapters)}")
    return 0


def _links() -> list[links.Link]:
    """Return the CAN interfaces; where iproute2 is missing there is a hint instead, and none."""
    try:
        return links.list_links()
    except ConfigError as error:
        print(f"canopen-control: {error}", file=sys.stderr)
        return []


def _adapters() -> list[str]:
    from canopen_control.bus.pythoncan import known_interfaces  # python-can is slow to import

    return known_interfaces()


def _plain(link: links.Link) -> dict[str, Any]:
    return dataclasses.asdict(link)


# status --------------------------------------------------------------------------------------------------------------


def _status(args: argparse.Namespace) -> int:
    if args.channel is None:
        specs = [ChannelSpec(ChannelKind.LOCAL, name) for name in list_sockets("bus")]
        found = {str(spec): _status_of(spec) for spec in specs} | status_of_interfaces(_links())
    else:
        spec = parse_channel(args.channel)
        found = {str(spec): _status_of(spec)}
    if args.json:
        print(json.dumps(found, indent=2))
        return 0
    lines = [line for channel, status in found.items() for line in _render(channel, status)]
    print("\n".join(lines) or "no local bus is open, and there is no CAN interface")
    return 0


def _status_of(spec: ChannelSpec) -> dict[str, Any]:
    if spec.kind is ChannelKind.LOCAL:
        return ask_hub(spec.name, "status")
    if spec.kind is not ChannelKind.SOCKETCAN:
        raise ConfigError(f"{spec}: only local: buses and CAN interfaces can be looked at from outside")
    link = links.find_link(spec.name)
    if link is None:
        raise InterfaceNotFound(spec.name, "what there is: canopen-control bus list")
    return status_of_interfaces([link])[link.name]


def _render(channel: str, status: dict[str, Any]) -> list[str]:
    return _render_hub(channel, status) if "members" in status else render_interface(status)


def _render_hub(channel: str, status: dict[str, Any]) -> list[str]:
    load = "" if status["load"] is None else f", {status['bitrate']} bit/s, load {100 * status['load']:.0f} %"
    lines = [f"{channel}: process {status['pid']}, {status['frames']} frames, {status['dropped']} dropped{load}"]
    table = Table(("label", "process", "sent", "received", "lost", "waiting", "state"))
    for member in status["members"]:
        state = [word for word in ("cut", "bus_off") if member["label"] in status[word]]
        numbers = (str(member[key]) for key in ("pid", "tx", "rx", "lost", "queued"))
        table.add((member["label"], *numbers, " ".join(state).replace("_", "-")))
    lines += [f"  {line}" for line in table.lines()]
    lines += [f"  delay of {label or 'everybody'}: {delay:g} ms" for label, delay in status["delays_ms"].items()]
    return lines + [f"  drop: {_rule(rule)}" for rule in status["drops"]]


def _rule(rule: dict[str, Any]) -> str:
    which = "every frame" if rule["every"] == 1 else f"one in {rule['every']} frames"
    identifier = "" if rule["can_id"] is None else f" 0x{rule['can_id']:03X}"
    limit = "" if rule["count"] is None else f" of {rule['count']}"
    return f"{which}{identifier} from {rule['label'] or 'anybody'}, {rule['lost']}{limit} lost"


# up, down, fault -----------------------------------------------------------------------------------------------------


def _interface(args: argparse.Namespace) -> str:
    name: str = args.interface
    if ":" in name:
        raise ConfigError(f"{name} is no interface of the kernel: it is there as soon as somebody opens it")
    return name


def _up(args: argparse.Namespace) -> int:
    links.bring_up(
        _interface(args), print, bitrate=args.bitrate, restart_ms=args.restart_ms, sample_point=args.sample_point
    )
    return 0


def _down(args: argparse.Namespace) -> int:
    links.bring_down(_interface(args), print)
    return 0


def _fault(args: argparse.Namespace) -> int:
    spec = parse_channel(args.channel)
    if spec.kind is not ChannelKind.LOCAL:
        raise ConfigError(
            f"{spec}: faults can be switched on local: buses only; a vcan has its own: tc qdisc ... netem"
        )
    params = {
        key: value
        for key in ("label", "can_id", "every", "count", "ms", "kind", "bitrate")
        if (value := getattr(args, key, None)) is not None
    }
    if args.fault == "bitrate":
        params["bitrate"] = _bitrate(args.bitrate)
    ask_hub(spec.name, args.fault.replace("-", "_"), **params)
    return 0


def _bitrate(text: str) -> int:
    if text == "off":
        return 0
    if not text.isdecimal():
        raise ConfigError(f"{text!r} is no bit rate: write bit/s, such as 500000, or off")
    return int(text)


_ACTIONS: dict[str, Callable[[argparse.Namespace], int]] = {
    "list": _list,
    "status": _status,
    "up": _up,
    "down": _down,
    "fault": _fault,
}
