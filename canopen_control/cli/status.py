"""`status`: what a running robot is doing, once, as JSON, or as a live table."""

from __future__ import annotations

import json
import sys
from typing import TYPE_CHECKING, Any

from canopen_control.cia402.modes import INTERFACE_MODES
from canopen_control.cli.table import Table
from canopen_control.client import RobotClient
from canopen_control.errors import RemoteError

if TYPE_CHECKING:
    import argparse

__all__ = ["add_arguments", "render", "run"]

EXAMPLE = "canopen-control status --watch"
RATE = 5.0  # Hz of the live table
PLAIN_RATE = 1.0  # Hz where it is printed line by line
_COLUMNS = ("node", "NMT", "CiA 402", "joint", "target", "actual rad/s", "position rad", "age ms")

_ENDS = ("stopping", "stopped")
#: of a target, by the mode of operation that takes it
_UNITS = {
    mode.name: {"position": "rad", "velocity": "rad/s", "effort": "Nm"}[interface]
    for interface, modes in INTERFACE_MODES.items()
    for mode in modes
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--json", action="store_true", help="print everything as JSON")
    parser.add_argument("--watch", action="store_true", help="print a live table until Ctrl-C")
    parser.add_argument("--name", help="the robot (default: the only one that runs)")


def run(args: argparse.Namespace) -> int:
    """Run the verb."""
    with RobotClient.connect(args.name) as robot:
        if args.watch:
            return _watch(robot, as_json=args.json)
        status = robot.call("status")
    if args.json:
        print(json.dumps(status, indent=2))
    else:
        more = [*_boot(status), *_events(status)]
        print("\n".join([*render(status), *([""] if more else []), *more]))
    return 0


def render(state: dict[str, Any]) -> list[str]:
    """Return the table of one sample: a line of the robot, then a line for each axis."""
    cycle = state["cycle"]
    active = [name for name, each in state["controllers"].items() if each == "active"]
    head = f"{state['state']}, cycle {cycle['count']} of {1e3 * cycle['period_s']:g} ms, {cycle['missed']} missed"
    table = Table(_COLUMNS)
    for name, node in state["nodes"].items():
        for axis in node["axes"] or [{}]:
            table.add(_row(name, node, axis, state["joints"]))
    for name, joint in () if state["nodes"] else state["joints"].items():
        table.add(("no drive", "-", "-", name, *_numbers(joint), "-"))  # mock, or simulated
    errors = [
        f"  {node['error']}" if name in node["error"] else f"  node {node['node_id']} ({name}): {node['error']}"
        for name, node in state["nodes"].items()
        if node["error"]
    ]
    held = [f"STOP is latched (by {state['latched_by']}): canopen-control stop --release"] if state["latched"] else []
    return [f"{head}, active: {', '.join(active) or 'none'}", *held, *table.lines(), *errors]


def _row(name: str, node: dict[str, Any], axis: dict[str, Any], joints: dict[str, Any]) -> tuple[str, ...]:
    joint = axis.get("joint", "-")
    age = node["age_s"]
    return (
        f"{name} ({node['node_id']})",
        _words(node["nmt_state"]),
        _words(axis.get("cia402_state")),
        joint,
        *_numbers(joints.get(joint, {}), _UNITS.get(axis.get("mode") or "", "")),
        "-" if age is None else f"{1e3 * age:.0f}",
    )


def _numbers(joint: dict[str, Any], unit: str = "") -> tuple[str, ...]:
    target, *actual = (_number(joint.get(key)) for key in ("command", "velocity", "position"))
    return (target if target == "-" else f"{target} {unit}".rstrip(), *actual)


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"


def _words(state: str | None) -> str:
    return "-" if state is None else state.replace("_", " ")


def _boot(status: dict[str, Any]) -> list[str]:
    """Return how long each boot step of each node took, and its SDO traffic."""
    steps: dict[str, list[str]] = {}
    for step in status["boot"]:
        failed = f" failed: {step['error']}" if step["error"] else ""
        steps.setdefault(step["node"], []).append(f"{step['step']} {1e3 * step['seconds']:.1f} ms{failed}")
    return [f"boot of {node}: {', '.join(each)}{_traffic(status, node)}" for node, each in steps.items()]


def _traffic(status: dict[str, Any], node: str) -> str:
    """Say how many SDO requests the node has had, since the robot started."""
    sdo = status["nodes"].get(node, {}).get("sdo")
    return f"; SDO: {sdo['reads']} read, {sdo['writes']} written, {sdo['failed']} failed" if sdo else ""


def _events(status: dict[str, Any]) -> list[str]:
    return [f"{event['level']}: {event['text']}" for event in status["events"] if event["level"] != "info"]


def _watch(robot: RobotClient, *, as_json: bool) -> int:
    """Print sample after sample: over each other on a terminal, line by line elsewhere."""
    live = sys.stdout.isatty() and not as_json
    robot.call("subscribe", state_rate=PLAIN_RATE if not (live or as_json) else RATE, events=True)
    height = 0
    ended = False
    try:
        for message in robot.messages(None):
            ended = ended or message.get("event", {}).get("kind") in _ENDS
            if (state := message.get("state")) is None:
                continue
            if as_json:
                print(json.dumps(state), flush=True)
                continue
            lines = render(state)
            up = f"\x1b[{height}A" if live and height else ""
            end = "\x1b[K\n" if live else "\n"
            print(up + end.join(lines) + end + ("\x1b[J" if live else ""), end="", flush=True)
            height = len(lines)
    except RemoteError as error:
        if error.kind != "BusClosed":
            raise
        if not ended:  # it has died, and the last sample is no longer true
            print(f"canopen-control: {error}", file=sys.stderr)
    return 0
