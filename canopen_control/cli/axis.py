"""Enable, disable, halt, quick-stop, fault-reset or home the drives of a running robot, or set their mode.

Ctrl-C during `home` or `enable` ends it: the axes ramp down to a standstill and are disabled.

Exit codes: 0 done; 1 the robot or a drive refused it; 2 wrong usage, no robot runs, or no such node.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from canopen_control.cli.support.arguments import one_name
from canopen_control.cli.support.output import print_result
from canopen_control.cli.support.parsers import add_robot_name
from canopen_control.client import RobotClient
from canopen_control.rpc.messages.robot import AxisRequest

if TYPE_CHECKING:
    import argparse


EXAMPLE = "canopen-control axis enable all"
ACTIONS = ("enable", "disable", "halt", "quick-stop", "fault-reset", "home", "mode")
TIMEOUT_S = 20.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("action", choices=ACTIONS)
    parser.add_argument("node", type=one_name, metavar="NODE", help="name or node-ID in bus.yml, or all")
    parser.add_argument(
        "mode",
        nargs="?",
        metavar="MODE",
        help="target mode (only with `mode`): PP, VL, PV, TQ, HM, IP, CSP, CSV, CST or its number",
    )
    parser.add_argument(
        "--joint", type=one_name, metavar="NAME", help="for a node with several axes: the axis that moves this joint"
    )
    parser.add_argument("--method", type=int, help="with `home`: homing method (default: the value of 0x6098)")
    add_robot_name(parser)
    parser.set_defaults(usage=parser.error)


def run(args: argparse.Namespace) -> int:
    """Send the request to the robot, wait for the reply, and print the result."""
    if (args.action == "mode") is not (args.mode is not None):
        args.usage("MODE is only for the action mode, which needs it: axis mode NODE MODE")
    if args.method is not None and args.action != "home":
        args.usage("--method goes with axis home")
    request = AxisRequest(
        action=args.action, node=args.node, joint=args.joint, method=args.method, mode=args.mode, source="axis"
    )
    try:
        with RobotClient.connect(args.name) as robot:
            answer = robot.ask(request, request.timeout_s(TIMEOUT_S))
    except KeyboardInterrupt:
        if args.action == "home":
            _end_homing(args)
        raise
    note = f" ({answer.text})" if answer.text else ""
    done = {"action": args.action, "node": args.node, "joint": args.joint, "mode": args.mode, "text": answer.text}
    print_result(args, done, f"{args.action} {args.node}{f' {args.mode}' if args.mode else ''}: done{note}")
    return 0


def _end_homing(args: argparse.Namespace) -> None:
    """Wait until the axes of a homing, which the robot ends when its client disconnects, are disabled."""
    with RobotClient.connect(args.name) as robot:
        robot.ask(AxisRequest(action="disable", node=args.node, joint=args.joint, source="axis"), TIMEOUT_S)
    print("canopen-control: interrupted: the homing has ended, and its drives are disabled", file=sys.stderr)
