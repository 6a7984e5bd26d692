"""What a verb asks a robot before it commands it: what of the command is a position, and which drives are not enabled.

The law of this file: a command ends without a new motion. Zero ends a velocity and an effort; for a position zero is a
place to go to, so a position is given up instead, and the joint holds where it is.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

from canopen_control.cli.repeat import send
from canopen_control.client import RobotClient

if TYPE_CHECKING:
    import argparse

    Json = dict[str, Any]


__all__ = ["not_enabled", "positions_of", "send_and_warn"]

_ENABLED = "OPERATION_ENABLED"


def send_and_warn(args: argparse.Namespace, method: str, params: Json, zeros: Json) -> int:
    """Do what `send` does; say first which drives will not move, and give positions up at the end."""
    with RobotClient.connect(args.name) as robot:
        controllers, status = robot.call("controllers"), robot.call("status")
    told = [] if status["latched"] else not_enabled(status, _joints_of(controllers, args.controller))
    for line in told:  # a latched STOP refuses the command, which says it better
        print(f"canopen-control: {line}", file=sys.stderr)
    positions = positions_of(controllers, args.controller)
    if any(positions) and not args.once and len(positions) == len(params.get("values", ())):
        # dead_man: the joints hold where they are as soon as the connection is gone
        params = {**params, "dead_man": True}
        last = zip(params["values"], zeros["values"], positions, strict=True)
        zeros = {**zeros, "values": [value if position else zero for value, zero, position in last]}
    return send(args, method, params, zeros)


def positions_of(controllers: list[Json], name: str) -> list[bool]:
    """Return for each value of a controller's command whether it is a position; nothing for an unknown controller."""
    return [interface.endswith("/position") for interface in _interfaces_of(controllers, name)]


def _joints_of(controllers: list[Json], name: str) -> set[str]:
    return {interface.rpartition("/")[0] for interface in _interfaces_of(controllers, name)}


def _interfaces_of(controllers: list[Json], name: str) -> list[str]:
    return [each for one in controllers if one["name"] == name for each in one["required_command_interfaces"]]


def not_enabled(status: Json, joints: set[str] | None = None) -> list[str]:
    """Return a sentence that names the drives of these joints (default: all) that are not enabled, if there are any."""
    states = {
        name: {axis["cia402_state"] for axis in node["axes"] if joints is None or axis.get("joint") in joints}
        for name, node in status["nodes"].items()
    }
    waiting = [name for name, each in states.items() if each - {_ENABLED}]
    if not waiting:
        return []
    are = "is" if len(waiting) == 1 else "are"
    faulty = any(state and state.startswith("FAULT") for name in waiting for state in states[name])
    first = "canopen-control axis fault-reset all, then " if faulty else ""
    return [f"{', '.join(waiting)} {are} not enabled and will not move: {first}canopen-control axis enable all"]
