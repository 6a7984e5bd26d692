"""List channels and their members, bring interfaces up and down, and disturb a local bus.

A channel is local:NAME, a CAN interface such as can0 or vcan0, or a python-can adapter as INTERFACE:CHANNEL.

Exit codes: 0 done; 1 refused, the bus is gone, or no such fault to clear; 2 wrong usage, or no such channel or member.
"""

from __future__ import annotations

import sys
from dataclasses import asdict
from typing import TYPE_CHECKING, TypeAlias, get_args

from canopen_control.bus import can_interfaces
from canopen_control.bus.can_interfaces import Listener, count_hearing, find_listeners, measure
from canopen_control.bus.channel import ChannelKind, ChannelSpec, parse_channel
from canopen_control.bus.local import ask_hub
from canopen_control.cli.support.arguments import whole
from canopen_control.cli.support.known_nodes import find_node, known_nodes
from canopen_control.cli.support.output import Table, json_alone, json_text, print_result
from canopen_control.errors import ConfigError, ControlError, InterfaceNotFound
from canopen_control.host.sockets import list_sockets
from canopen_control.rpc.messages import hub
from canopen_control.rpc.messages.declare import Document
from canopen_control.rpc.wire import plain

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Sequence

    from canopen_control.bus.can_interfaces import CanInterface, Traffic
    from canopen_control.cli.support.known_nodes import KnownNode
    from canopen_control.rpc.messages.declare import Done, Request

    Status: TypeAlias = "hub.HubStatus | InterfaceStatus"


# Report of `bus status` on CAN interfaces: state, counters, load, and the processes that have them open.


MEASURE_S = 0.5
_COMMAND_LENGTH = 60


class InterfaceStatus(Document, frozen=True, kw_only=True):
    """CAN interface in `bus status`; unknown values are None. The first fields are those of CanInterface.

    `unnamed_listeners` is the number of sockets that belong to other users.
    """

    name: str
    kind: str
    is_up: bool
    queue_length: int
    state: str | None
    bitrate: int | None
    sample_point: float | None
    restart_ms: int | None
    error_counters: tuple[int, int] | None
    counters: dict[str, int]
    traffic: dict[str, int]
    frames_per_second: float | None
    load: float | None
    listeners: list[Listener]
    unnamed_listeners: int


def status_of_interfaces(links: Sequence[CanInterface]) -> dict[str, InterfaceStatus]:
    """Measure the traffic of interfaces for half a second and return their status by name."""
    traffic = measure(links, MEASURE_S)
    return {link.name: _interface_status(link, traffic.get(link.name)) for link in links}


def _interface_status(link: CanInterface, traffic: Traffic | None) -> InterfaceStatus:
    listeners = find_listeners(link.name)
    named = sum(listener.interface is not None and listener.identifiers != 0 for listener in listeners)
    return InterfaceStatus(
        **asdict(link),
        frames_per_second=None if traffic is None else traffic.frames_per_second,
        load=None if traffic is None else traffic.load,
        listeners=listeners,
        unnamed_listeners=max(0, count_hearing(link.name) - named),
    )


def render_interface(status: InterfaceStatus) -> list[str]:
    """Format the status of an interface as lines of text."""
    words = [status.kind, "up" if status.is_up else "down"]
    words += [status.state] if status.state else []
    words += [f"{status.bitrate} bit/s"] if status.bitrate else []
    if status.error_counters:
        words.append("transmit errors {}, receive errors {}".format(*status.error_counters))
    words += [] if status.frames_per_second is None else [f"{status.frames_per_second:.0f} frames/s"]
    words += [] if status.load is None else [f"load {100 * status.load:.0f} %"]
    lines = [f"{status.name}: {', '.join(words)}"]
    for counters in (status.counters, status.traffic):
        counts = [f"{name} {number}" for name, number in counters.items() if number]
        lines += [f"  {', '.join(counts)}"] if counts else []
    return lines + [f"  {line}" for line in _listeners(status)]


def _listeners(status: InterfaceStatus) -> list[str]:
    lines = [_listener(listener) for listener in status.listeners]
    unnamed = status.unnamed_listeners
    return lines + ([f"{unnamed} more, of other users: run this with sudo to see their names"] if unnamed else [])


def _listener(listener: Listener) -> str:
    command = listener.command
    if len(command) > _COMMAND_LENGTH:
        command = command[: _COMMAND_LENGTH - 3] + "..."
    return f"{command} (pid {listener.pid}) {', '.join(_does(listener))}"


def _does(listener: Listener) -> list[str]:
    """Return phrases about what a CAN socket receives, or makes the kernel send, and on which interfaces."""
    tasks = [f"has the kernel send 0x{can_id:03X} every {us / 1000:g} ms" for can_id, us in listener.tasks]
    if tasks or listener.protocol == "CAN_BCM":
        return tasks or ["uses the kernel's broadcast manager"]
    if listener.protocol != "CAN_RAW":
        return [f"has a socket of {listener.protocol}"]
    identifiers = listener.identifiers
    words = [_HEARS.get(identifiers, f"receives {identifiers} identifiers")]
    scope = {None: "on an interface that only root can see", "": "of all interfaces"}.get(listener.interface)
    return words + ([scope] if scope else [])


_HEARS = {None: "receives some identifiers", -1: "receives everything", 0: "only sends", 1: "receives one identifier"}


EXAMPLE = """canopen-control bus list
         canopen-control bus status local:robby
         canopen-control bus up can0 --bitrate 1000000
         canopen-control bus down can0
         canopen-control bus fault local:robby cut left_drive
         canopen-control bus fault local:robby uncut left_drive
         canopen-control bus fault local:robby bus-off left_drive
         canopen-control bus fault local:robby restart left_drive
         canopen-control bus fault local:robby drop left_drive --id 0x183 --count 5
         canopen-control bus fault local:robby delay left_drive --ms 2
         canopen-control bus fault local:robby error-frame left_drive
         canopen-control bus fault local:robby bitrate 1000000
         canopen-control bus fault local:robby bitrate off
         canopen-control bus fault local:robby clear"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    actions.add_parser("list", help="list interfaces, local buses and python-can adapters")
    status = actions.add_parser("status", help="show members, load and counters")
    status.add_argument(
        "channel", nargs="?", metavar="CHANNEL", help="channel (default: all local buses and CAN interfaces)"
    )
    up = actions.add_parser("up", help="bring a CAN interface up; a missing vcan is created")
    up.add_argument("interface", metavar="INTERFACE")
    up.add_argument("--bitrate", type=int, metavar="BIT/S", help="bit rate of a real interface")
    up.add_argument(
        "--restart-ms", type=int, metavar="MS", help="time from bus-off to the restart, in ms; 0: no restart"
    )
    up.add_argument("--sample-point", type=float, metavar="0.875")
    down = actions.add_parser("down", help="take a CAN interface down")
    down.add_argument("interface", metavar="INTERFACE")
    _add_faults(actions.add_parser("fault", help="inject and clear faults on a local bus"))


def _add_faults(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("channel", metavar="CHANNEL", help="local:NAME")
    faults = parser.add_subparsers(dest="fault", metavar="FAULT", required=True)
    for name, text in _ON_ONE.items():
        faults.add_parser(name, help=text).add_argument("label", metavar="WHO", help=_LABEL_HELP)
    drop = faults.add_parser("drop", help="drop frames of WHO, or of all members")
    drop.add_argument("--id", dest="can_id", type=whole, metavar="COB-ID", help="only this identifier")
    drop.add_argument("--every", type=int, default=1, metavar="N", help="drop only every Nth frame")
    drop.add_argument("--count", type=int, metavar="N", help="drop N frames, then stop")
    delay = faults.add_parser("delay", help="delay frames of WHO, or of all members")
    delay.add_argument("--ms", type=int, required=True, metavar="MS", help="delay in ms; 0: no delay")
    error = faults.add_parser("error-frame", help="make the CAN controllers of WHO, or of all members, report an error")
    error.add_argument("--kind", choices=get_args(hub.ErrorKind), default="bus-error")
    for fault in (drop, delay, error):
        fault.add_argument("label", nargs="?", default="", metavar="WHO", help=_LABEL_HELP)
    rate = faults.add_parser("bitrate", help="simulate a bit rate, with arbitration; off: no bit rate")
    rate.add_argument("bitrate", metavar="BIT/S")
    faults.add_parser("clear", help="clear all faults; the bit rate stays")


_LABEL_HELP = "a node's name, node-ID or joint; master; or a label that `bus status` shows"
_ON_ONE = {
    "cut": "cut the cable of WHO, in both directions",
    "uncut": "reconnect the cable of WHO",
    "bus-off": "put the CAN controller of WHO into bus-off",
    "restart": "restart the CAN controller of WHO after bus-off",
}


def run(args: argparse.Namespace) -> int:
    """Run the verb."""
    return _ACTIONS[args.action](args)


# -- list


def _list(args: argparse.Namespace) -> int:
    interfaces = _links()
    local = [f"local:{name}" for name in list_sockets("bus")]
    adapters = _adapters()
    if args.json:
        document = {"interfaces": plain(interfaces), "local": local, "python_can": adapters}
        print(json_text(document))
        return 0
    names = [f"{link.name} ({'up' if link.is_up else 'down'})" for link in interfaces]
    print(f"CAN interfaces:      {', '.join(names) or 'none'}")
    print(f"local buses:         {', '.join(local) or 'none is open'}")
    print(f"python-can adapters: {', '.join(adapters)}")
    return 0


def _links() -> list[can_interfaces.CanInterface]:
    """Return the CAN interfaces; if `ip` is not available, print a hint and return an empty list."""
    try:
        return can_interfaces.list_can_interfaces()
    except ConfigError as error:
        print(f"canopen-control: {error}", file=sys.stderr)
        return []


def _adapters() -> list[str]:
    from canopen_control.bus.pythoncan import known_interfaces  # python-can is slow to import

    return known_interfaces()


# -- status


def _status(args: argparse.Namespace) -> int:
    if args.channel is None:
        specs = [ChannelSpec(ChannelKind.LOCAL, name) for name in list_sockets("bus")]
        states: dict[str, Status] = {str(spec): _status_of(spec) for spec in specs}
        states |= status_of_interfaces(_links())
    else:
        spec = parse_channel(args.channel)
        states = {str(spec): _status_of(spec)}
    if args.json:
        print(json_text(states))
        return 0
    lines = [line for channel, status in states.items() for line in _render(channel, status)]
    print("\n".join(lines) or "no local bus is open, and this computer has no CAN interface")
    return 0


def _status_of(spec: ChannelSpec) -> Status:
    if spec.kind is ChannelKind.LOCAL:
        return ask_hub(spec.name, hub.GetHubStatus())
    if spec.kind is not ChannelKind.SOCKETCAN:
        raise ConfigError(f"{spec}: only local: buses and CAN interfaces have a status")
    link = can_interfaces.find_can_interface(spec.name)
    if link is None:
        raise InterfaceNotFound(spec.name, "list the channels with: canopen-control bus list")
    return status_of_interfaces([link])[link.name]


def _render(channel: str, status: Status) -> list[str]:
    if isinstance(status, InterfaceStatus):
        return render_interface(status)
    return _render_hub(channel, status, known_nodes(channel))


def _render_hub(channel: str, status: hub.HubStatus, nodes: Sequence[KnownNode]) -> list[str]:
    load = "" if status.load is None else f", {status.bitrate} bit/s, load {100 * status.load:.0f} %"
    lines = [f"{channel}: process {status.pid}, {status.frames} frames, {status.dropped} dropped{load}"]
    table = Table(("label", "process", "sent", "received", "lost", "waiting", "state"))
    silenced = {"cut": status.cut, "bus-off": status.bus_off}
    for member in status.members:
        state = " ".join(word for word, labels in silenced.items() if member.label in labels)
        numbers = map(str, (member.pid, member.tx, member.rx, member.lost, member.queued))
        table.add((_named(member.label, nodes), *numbers, state))
    lines += [f"  {line}" for line in table.lines()]
    delays = {_named(label, nodes) or "all members": delay for label, delay in status.delays_ms.items()}
    lines += [f"  delay of {name}: {delay:g} ms" for name, delay in delays.items()]
    return lines + [f"  drop: {_rule(rule, nodes)}" for rule in status.drops]


def _rule(rule: hub.DropState, nodes: Sequence[KnownNode]) -> str:
    frames = "every frame" if rule.every == 1 else f"one in {rule.every} frames"
    identifier = "" if rule.can_id is None else f" 0x{rule.can_id:03X}"
    limit = "" if rule.count is None else f" of {rule.count}"
    return f"{frames}{identifier} from {_named(rule.label, nodes) or 'all members'}, {rule.lost}{limit} lost"


# -- up, down, fault


def _interface(args: argparse.Namespace) -> str:
    name: str = args.interface
    if ":" in name:
        raise ConfigError(
            f"{name} is not a kernel interface, so it is not brought up or down: the program that uses it opens it"
        )
    return name


def _up(args: argparse.Namespace) -> int:
    options = {"bitrate": args.bitrate, "restart_ms": args.restart_ms, "sample_point": args.sample_point}
    with json_alone(args):
        can_interfaces.bring_up(_interface(args), print, **options)
    print_result(args, {"interface": args.interface, "up": True})
    return 0


def _down(args: argparse.Namespace) -> int:
    with json_alone(args):
        can_interfaces.bring_down(_interface(args), print)
    print_result(args, {"interface": args.interface, "up": False})
    return 0


def _fault(args: argparse.Namespace) -> int:
    spec = parse_channel(args.channel)
    if spec.kind is not ChannelKind.LOCAL:
        raise ConfigError(f"{spec}: faults can be injected into local: buses only; for a vcan use: tc qdisc ... netem")
    if getattr(args, "label", ""):
        args.label = _label(spec, args.label)
    label = getattr(args, "label", "")
    active = _ENDED.get(args.fault)
    if active is not None and not active(ask_hub(spec.name, hub.GetHubStatus()), label):
        raise ControlError(f"{spec}: {args.fault} {label}".rstrip() + ": no such fault is active, nothing was changed")
    ask_hub(spec.name, _REQUESTS[args.fault](args))
    print_result(args, {"channel": str(spec), "fault": args.fault, "label": getattr(args, "label", "")})
    return 0


_REQUESTS: dict[str, Callable[[argparse.Namespace], Request[Done]]] = {
    "cut": lambda args: hub.Cut(args.label),
    "uncut": lambda args: hub.Uncut(args.label),
    "bus-off": lambda args: hub.ForceBusOff(args.label),
    "restart": lambda args: hub.Restart(args.label),
    "drop": lambda args: hub.DropFrames(label=args.label, can_id=args.can_id, every=args.every, count=args.count),
    "delay": lambda args: hub.DelayFrames(label=args.label, ms=args.ms),
    "error-frame": lambda args: hub.SendErrorFrame(label=args.label, kind=args.kind),
    "bitrate": lambda args: hub.SetBitrate(_bitrate(args.bitrate)),
    "clear": lambda _args: hub.ClearFaults(),
}

#: for the requests that end faults: whether one is active
_ENDED: dict[str, Callable[[hub.HubStatus, str], bool]] = {
    "uncut": lambda status, label: label in status.cut,
    "restart": lambda status, label: label in status.bus_off,
    "clear": lambda status, _label: bool(status.cut or status.bus_off or status.delays_ms or status.drops),
}


def _label(spec: ChannelSpec, word: str) -> str:
    """Return the label of the bus member that `word` names (node, node-ID, joint or label).

    Raise ConfigError if no member matches.
    """
    status = ask_hub(spec.name, hub.GetHubStatus())
    labels = [member.label for member in status.members]
    present = {*labels, *status.cut, *status.bus_off, *status.delays_ms}  # a disconnected member may have left
    nodes = known_nodes(str(spec))
    node = find_node(word, nodes)
    candidates = [word, _DRIVE.format(word if node is None else node.node_id)]
    match = next((label for label in candidates if label in present), None)
    if match is None:
        choices = ", ".join(_named(label, nodes) for label in labels) or "none"
        raise ConfigError(f"no member called {word!r} on {spec}; available: {choices}")
    return match


def _named(label: str, nodes: Sequence[KnownNode]) -> str:
    """Return a member's label, preceded by the node's name in the running robot: ``left_drive (drive 3)``."""
    name = next((node.name for node in nodes if _DRIVE.format(node.node_id) == label), None)
    return label if name is None else f"{name} ({label})"


_DRIVE = "drive {}"  # the label of a virtual drive, by its node-ID


def _bitrate(text: str) -> int:
    if text == "off":
        return 0
    if not text.isdecimal():
        raise ConfigError(f"{text!r} is not a bit rate: write bit/s, such as 500000, or off")
    return int(text)


_ACTIONS: dict[str, Callable[[argparse.Namespace], int]] = {
    "list": _list,
    "status": _status,
    "up": _up,
    "down": _down,
    "fault": _fault,
}
