"""Start, stop or reset nodes, and check that they reach the commanded state.

NODE is a node of a running robot (name or node-ID in bus.yml) or, with --can, any node on a bare bus (node-ID); or all.
An NMT command has no answer: heartbeats and boot-ups show its effect. A running robot takes a node that leaves
OPERATIONAL out of its process data, and boots it again with `start`; then `axis fault-reset` and `axis enable` let it
move.

Exit codes: 0 confirmed, or sent to nodes without heartbeat; 1 no answer, or another state; 2 wrong usage.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING

from canopen_control.cia301.nmt import COMMAND_NAMES, EXPECTED_STATE, RESETS, NmtCommand, NmtConfirmed, NmtState
from canopen_control.cli.support.arguments import one_name, timeout_seconds
from canopen_control.cli.support.output import json_text
from canopen_control.cli.support.target import (
    ALL,
    LABEL,
    NMT_TIMEOUT_S,
    RESET_TIMEOUT_S,
    ROBOT_TIMEOUTS,
    RobotTarget,
    add_target_arguments,
    parse_node_id,
)
from canopen_control.client import RobotClient
from canopen_control.errors import ConfigError, SdoAbort, SdoTimeout
from canopen_control.frame import BROADCAST
from canopen_control.master.direct import DirectBus

if TYPE_CHECKING:
    import argparse


EXAMPLE = """canopen-control nmt preop left_drive
         canopen-control nmt reset-node all --can can0"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("command", choices=COMMAND_NAMES)
    parser.add_argument(
        "node", type=one_name, metavar="NODE", help="name or node-ID, on a bare bus the node-ID; or all"
    )
    parser.add_argument(
        "--wait",
        type=timeout_seconds,
        metavar="S",
        help="time to wait for the confirmation in s (default: 1.5, resets 5)",
    )
    add_target_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Run the verb."""
    command = COMMAND_NAMES[args.command]
    if args.can is not None:
        node_id = BROADCAST if args.node == ALL else parse_node_id(args.node)
        with DirectBus.open(args.can, label=LABEL) as bus:
            return _on_bus(args, bus, command, node_id)
    with RobotTarget(RobotClient.connect(args.name)) as robot:
        return _through_robot(args, robot, command)


_ABSENT = "nor an SDO answer or a boot-up; is the node powered and its node-ID right?"


@dataclass(frozen=True, slots=True)
class NmtResult:
    """Result of an NMT command for one node; `confirmed` is None if no heartbeat was received."""

    node_id: int
    label: str
    state: str | None
    confirmed: bool | None
    error: str | None = None


def _on_bus(args: argparse.Namespace, bus: DirectBus, command: NmtCommand, node_id: int) -> int:
    timeout = args.wait or (RESET_TIMEOUT_S if command in RESETS and node_id else NMT_TIMEOUT_S)
    # a stopped node answers no SDO (CiA 301, 7.3.2.2.5), so it is asked before
    answered = command is NmtCommand.STOP and node_id != BROADCAST and _answers(bus, node_id)
    outcomes = []
    for result in bus.command(command, node_id, timeout):
        node = f"node {result.node_id}"
        if isinstance(result, NmtConfirmed):
            outcomes.append(NmtResult(result.node_id, node, EXPECTED_STATE[command].name, True))
        else:
            state = None if result.state is None else result.state.name
            # every node reports its reset by a boot-up (CiA 301, 7.3.2.2.1)
            present = state is None and (answered or (command not in RESETS and _answers(bus, node_id)))
            error = None if present or state is not None else _ABSENT
            outcomes.append(NmtResult(result.node_id, node, state, None if present else False, error))
    if not outcomes and not args.json:
        print(f"{args.command} was sent to all; no heartbeat arrived within {timeout:g} s")
    code = _report(args, outcomes, timeout)
    return 1 if command in RESETS and not outcomes else code


def _answers(bus: DirectBus, node_id: int) -> bool:
    """Whether a node answers a read of its device type (0x1000), even by an abort."""
    try:
        bus.read(node_id, 0x1000)
    except SdoTimeout:
        return False
    except SdoAbort:
        pass
    return True


def _through_robot(args: argparse.Namespace, target: RobotTarget, command: NmtCommand) -> int:
    nodes_asked = target.sessions if args.node == ALL else [target.session(args.node)]
    if not nodes_asked:
        raise ConfigError(f"robot {target.robot.robot} has no nodes: it runs on mock hardware or in a simulation")
    timeout = args.wait or ROBOT_TIMEOUTS.get(command, NMT_TIMEOUT_S)
    waiting, nodes = target.command(command, nodes_asked, timeout, all_nodes=args.node == ALL)
    outcomes = []
    for requested in nodes_asked:
        node = nodes[requested.name]
        confirmed = requested not in waiting
        state = EXPECTED_STATE[command].name if confirmed else node.nmt_state
        outcomes.append(NmtResult(requested.node_id, str(requested), state, confirmed, node.error))
    return _report(args, outcomes, timeout)


def _report(args: argparse.Namespace, outcomes: list[NmtResult], timeout: float) -> int:
    """Print the state of each node after the command; return 1 if `confirmed` is False for a node, else 0."""
    if args.json:
        keys = ("node_id", "state", "confirmed", "error")
        print(json_text([{key: getattr(outcome, key) for key in keys} for outcome in outcomes]))
    for result in outcomes if not args.json else ():
        if result.confirmed:
            print(f"{result.label}: {_words(result.state or '')}")
        elif result.confirmed is None:
            print(f"{result.label}: {args.command} was sent; no heartbeat confirmed it within {timeout:g} s")
        else:
            _complain(result.label, result.state, args.command, timeout, result.error)
    return 1 if any(outcome.confirmed is False for outcome in outcomes) else 0


def _words(name: str) -> str:
    return "has booted" if name == NmtState.INITIALISING.name else name.replace("_", " ")


def _complain(node: str, state: str | None, command: str, timeout: float, error: str | None = None) -> None:
    shown = "it sent no heartbeat" if state is None else f"it shows {state.replace('_', ' ')}"
    why = f" ({error.removeprefix(f'{node}: ')})" if error else ""
    print(f"canopen-control: {node}: {command} was not confirmed within {timeout:g} s; {shown}{why}", file=sys.stderr)
