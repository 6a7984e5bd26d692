"""Assign node-IDs and bit rates to nodes on a bare bus (CiA 305).

First put exactly one slave into configuration mode: use `switch configuration` with its four identity numbers (without
them if it is the only slave on the bus), or `fast-scan`, which finds a slave without a node-ID. `node-id`,
`bit-timing`, `store` and `inquire` then address it, and `switch waiting` ends the configuration mode.

A new node-ID takes effect after `switch waiting` if the slave had none, otherwise after `nmt reset-comm`. A new bit
rate takes effect after `activate`, for all slaves in configuration mode; change the bit rate of this computer's
interface too. Without `store` both are lost at the next power-on.

`find` searches for slaves without a node-ID in two ways, each for 0.1 s: with the service `identify non-configured`,
and with the first request of a fast scan, because some slaves answer only this request. It changes no slave.

Exit codes: 0 success; 1 no slave answered or it refused; 2 wrong usage.
"""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from canopen_control.cia301.lss import (
    AUTOMATIC_BIT_TIMING,
    BIT_TIMINGS,
    UNCONFIGURED,
    LssIdentity,
    LssMode,
    bit_timing_index,
)
from canopen_control.cli.support.arguments import whole_number
from canopen_control.cli.support.output import json_text, print_result
from canopen_control.cli.support.target import LABEL, robot_on
from canopen_control.errors import ConfigError, RemoteProtocolError, SdoTimeout
from canopen_control.master.direct import DirectBus

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.cia301.lss import LssMaster, LssRequest


EXAMPLE = """canopen-control lss fast-scan --can can0
         canopen-control lss node-id 5 --can can0
         canopen-control lss bit-timing 500000 --can can0
         canopen-control lss store --can can0
         canopen-control lss inquire --can can0
         canopen-control lss activate 100 --can can0
         canopen-control lss find --can can0
         canopen-control lss switch waiting --can can0"""

PARTS = LssIdentity._fields
NODE_ID = "node-id"
AUTO = "auto"
FIND_S = 0.1  # for each request of `find`: enough for slow slaves
_U32 = 0xFFFFFFFF
_TAKEN_S = 0.2  # as in `scan`


_number = whole_number("whole number of at most 32 bits, decimal or 0x", range(_U32 + 1))


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    switch = actions.add_parser("switch", help="switch all slaves, or the slave with an identity, to a mode")
    switch.add_argument("mode", choices=[mode.name.lower() for mode in LssMode])
    inquire = actions.add_parser("inquire", help="print identity and node-ID of the slave in configuration mode")
    inquire.add_argument("part", nargs="?", choices=(*PARTS, NODE_ID), help="print only this part")
    node_id = actions.add_parser("node-id", help="assign a node-ID to the slave in configuration mode")
    node_id.add_argument("node_id", type=_number, metavar="N", help="node-ID, 1 to 127, or 255 for none")
    timing = actions.add_parser("bit-timing", help="assign a bit rate to the slave in configuration mode")
    timing.add_argument("bitrate", metavar="BITRATE", help=f"bit/s: {_rates()}, or {AUTO}")
    store = actions.add_parser("store", help="store node-ID and bit rate of the slave in configuration mode")
    activate = actions.add_parser("activate", help="switch all slaves in configuration mode to their new bit rate")
    activate.add_argument(
        "delay_ms", type=_number, metavar="DELAY_MS", help="delay in ms before the change, and silence after the change"
    )
    scan = actions.add_parser("fast-scan", help="find a slave without a node-ID, switch it to configuration mode")
    find = actions.add_parser("find", help="report whether there are slaves without a node-ID")
    for part in PARTS:
        switch.add_argument(
            f"--{part}", type=_number, metavar="N", help="identity of the slave to switch; give all four"
        )
        scan.add_argument(
            f"--{part}", type=_number, metavar="N", help="known part of the identity, which makes the scan faster"
        )
    parser.add_argument(
        "--can", metavar="CHANNEL", help="channel of the bus (can0, local:NAME, ...); may follow the action"
    )
    for action in (switch, inquire, node_id, timing, store, activate, scan, find):
        action.add_argument(
            "--can", default=argparse.SUPPRESS, metavar="CHANNEL", help="channel of the bus (can0, local:NAME, ...)"
        )


def run(args: argparse.Namespace) -> int:
    """Run the verb."""
    if args.can is None:
        raise ConfigError(f"name the bus: canopen-control lss {args.action} --can CHANNEL")
    owner = robot_on(args.can)
    if owner is not None:
        raise ConfigError(
            f"robot {owner[0]} runs on {args.can}; LSS would disturb its nodes; end it first: "
            f"canopen-control shutdown --name {owner[0]}"
        )
    with DirectBus.open(args.can, label=LABEL) as bus:
        return _ACTIONS[args.action](args, bus)


def _rates() -> str:
    return ", ".join(str(rate) for rate in BIT_TIMINGS.values())


def _switch(args: argparse.Namespace, bus: DirectBus) -> int:
    mode, parts = LssMode[args.mode.upper()], {part: getattr(args, part) for part in PARTS}
    missing = [f"--{part}" for part, number in parts.items() if number is None]
    if len(missing) == len(PARTS):
        bus.lss(lambda master: master.switch_global(mode))
        text = f"all slaves are requested to switch to {args.mode}; LSS defines no answer to this"
        print_result(args, {"mode": args.mode, "identity": None}, text)
        return 0
    if missing:
        raise ConfigError(f"a single slave is selected by its whole identity; add {', '.join(missing)}")
    if mode is LssMode.WAITING:
        # CiA 305: switch state selective leads to configuration mode only
        raise ConfigError("a single slave cannot be switched to waiting; omit the identity to switch all slaves")
    identity = LssIdentity(**parts)
    bus.lss(lambda master: master.switch_selective(identity))
    done = {"mode": args.mode, "identity": identity._asdict()}
    print_result(args, done, f"{_identity(identity)}: in configuration")
    return 0


def _inquire(args: argparse.Namespace, bus: DirectBus) -> int:
    parts = [args.part] if args.part else [*PARTS, NODE_ID]
    answers: dict[str, int] = {}
    for part in parts:
        answer = bus.lss(lambda master, part=part: master.inquire(part.replace("-", "_")))  # type: ignore[misc]  # part has its type from the list
        assert isinstance(answer, int)
        answers[part] = answer
    if args.json:
        print(json_text({part.replace("-", "_"): number for part, number in answers.items()}))
        return 0
    for part, number in answers.items():
        shown = "none" if part == NODE_ID and number == UNCONFIGURED else f"{number}"
        print(f"{part}: {shown} (0x{number:0{2 if part == NODE_ID else 8}X})")
    return 0


def _node_id(args: argparse.Namespace, bus: DirectBus) -> int:
    if not 1 <= args.node_id <= 127 and args.node_id != UNCONFIGURED:
        raise ConfigError(f"node-ID {args.node_id} is not valid: use 1 to 127, or {UNCONFIGURED} for none")
    if args.node_id != UNCONFIGURED and _is_taken(bus, args.node_id):
        raise ConfigError(
            f"node-ID {args.node_id} already answers on {args.can}, and two drives with one node-ID move together; "
            f"choose a free one: canopen-control scan --can {args.can}"
        )
    bus.lss(lambda master: master.configure_node_id(args.node_id))
    text = (
        f"node-ID {args.node_id}: accepted; it takes effect after `lss switch waiting` if the slave had none, "
        "otherwise after `nmt reset-comm`; `lss store` keeps it for the next power-on"
    )
    print_result(args, {"node_id": args.node_id}, text)
    return 0


def _is_taken(bus: DirectBus, node_id: int) -> bool:
    """Whether a node-ID answers SDO requests of device type, unless it is the ID of the slave in configuration mode."""
    answer = bus.read_many([(node_id, 0x1000, 0)], timeout_s=_TAKEN_S)[node_id, 0x1000, 0]
    if isinstance(answer, SdoTimeout):
        return False
    return bus.lss(lambda master: master.inquire("node_id")) != node_id


def _bit_timing(args: argparse.Namespace, bus: DirectBus) -> int:
    rate = args.bitrate
    index = AUTOMATIC_BIT_TIMING if rate == AUTO else bit_timing_index(int(rate)) if rate.isdecimal() else None
    if index is None:
        raise ConfigError(f"bit rate {rate!r}: LSS supports {_rates()} bit/s and {AUTO}")
    bus.lss(lambda master: master.configure_bit_timing(index))
    text = f"bit rate {rate}: accepted; `lss activate` changes to it now, `lss store` keeps it for the next power-on"
    print_result(args, {"bitrate": rate if rate == AUTO else int(rate)}, text)
    return 0


def _store(args: argparse.Namespace, bus: DirectBus) -> int:
    bus.lss(lambda master: master.store())
    print_result(args, {"stored": True}, "stored")
    return 0


def _activate(args: argparse.Namespace, bus: DirectBus) -> int:
    if not 0 <= args.delay_ms <= 0xFFFF:
        raise ConfigError(f"delay {args.delay_ms} ms: valid are 0 to 65535")
    # CiA 305: the slaves send nothing for the delay before and after the change
    bus.lss(lambda master: master.activate_bit_timing(args.delay_ms))
    text = f"the slaves change in {args.delay_ms} ms; change this computer too, then wait another {args.delay_ms} ms"
    print_result(args, {"delay_ms": args.delay_ms}, text)
    return 0


def _fast_scan(args: argparse.Namespace, bus: DirectBus) -> int:
    identity = bus.lss(lambda master: master.fast_scan(**{part: getattr(args, part) for part in PARTS}))
    if identity is None:
        raise RemoteProtocolError(0, _none_answers(args, "to a fast scan"))
    assert isinstance(identity, LssIdentity)
    print_result(args, identity._asdict(), f"{_identity(identity)}: in configuration")
    return 0


def _find(args: argparse.Namespace, bus: DirectBus) -> int:
    services: tuple[tuple[str, Callable[[LssMaster], LssRequest]], ...] = (
        ("identify non-configured", lambda master: master.identify_non_configured()),
        ("fast scan", lambda master: master.open_fast_scan()),
    )
    for name, ask in services:
        if bus.lss(ask, scan_s=FIND_S):
            text = f"there are slaves without a node-ID (they answer to {name}); find one of them: canopen-control lss"
            print_result(args, {"unconfigured": True, "service": name}, f"{text} fast-scan --can {args.can}")
            return 0
    tried = " or ".join(name for name, _ in services)
    raise RemoteProtocolError(0, _none_answers(args, f"to {tried} within {FIND_S:g} s each"))


def _none_answers(args: argparse.Namespace, request: str) -> str:
    advice = f"for a slave that has one: canopen-control lss switch configuration --can {args.can}"
    return f"LSS: no slave without a node-ID answers on {args.can} {request}; {advice}"


def _identity(identity: LssIdentity) -> str:
    return ", ".join(f"{part} 0x{number:08X}" for part, number in identity._asdict().items())


_ACTIONS: dict[str, Callable[[argparse.Namespace, DirectBus], int]] = {
    "switch": _switch,
    "inquire": _inquire,
    "node-id": _node_id,
    "bit-timing": _bit_timing,
    "store": _store,
    "activate": _activate,
    "fast-scan": _fast_scan,
    "find": _find,
}
