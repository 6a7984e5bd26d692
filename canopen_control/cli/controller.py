"""`controller`: the controllers of a running robot, as `ros2 control` has them: list, load, configure, switch, unload.

A controller of ros2_controllers.yaml is loaded and configured (then it is inactive), then activated: `activate` does
what is missing of that. Two controllers cannot command one interface: `switch` deactivates one and activates the other
in the same cycle. Activating enables drives; nothing moves before a command comes.

Exit codes: 0 good; 1 the robot refused, and nothing was changed; 2 wrong usage, or no robot runs.
"""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from canopen_control.cli.table import Table
from canopen_control.client import RobotClient
from canopen_control.errors import ConfigError

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable

__all__ = ["EXAMPLE", "add_arguments", "run"]

EXAMPLE = """canopen-control controller list
         canopen-control controller switch --activate robby_base_controller --deactivate robby_forward_controller
         canopen-control controller load robby_base_controller"""

_STEPS = {
    "load": "load and configure it, as its section of ros2_controllers.yaml says",
    "configure": "configure it again, if it is not active",
    "activate": "let it command, loaded and configured if need be",
    "deactivate": "let go of its interfaces; velocity and effort targets become 0",
    "unload": "forget it, if it is not active",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    lists = [
        actions.add_parser("list", help="the controllers, their states and interfaces"),
        actions.add_parser("types", help="what the `type` of a controller may be"),
        actions.add_parser("hardware", help="the hardware components and their interfaces"),
    ]
    steps = {action: actions.add_parser(action, help=text) for action, text in _STEPS.items()}
    switch = actions.add_parser("switch", help="deactivate some and activate others, in one cycle")
    for step in steps.values():
        step.add_argument("controller", metavar="CONTROLLER", nargs="+", help="its name in ros2_controllers.yaml")
    for option in ("activate", "deactivate"):
        switch.add_argument(f"--{option}", metavar="CONTROLLER", nargs="+", default=[], help=f"{option} these")
    for action in (switch, steps["activate"], steps["deactivate"]):
        action.add_argument("--best-effort", action="store_true", help="do what is possible, and leave out the rest")
    for action in lists:
        action.add_argument("--json", action="store_true", help="print JSON")
    for action in (*lists, *steps.values(), switch):
        action.add_argument("--name", help="the robot (default: the only one that runs)")


def run(args: argparse.Namespace) -> int:
    """Run the verb."""
    if args.action == "switch" and not (args.activate or args.deactivate):
        raise ConfigError("switch what? --activate CONTROLLER..., --deactivate CONTROLLER..., or both")
    with RobotClient.connect(args.name) as robot:
        return _ACTIONS[args.action](args, robot)


# -- what there is


def _list(args: argparse.Namespace, robot: RobotClient) -> int:
    controllers = robot.call("controllers")
    if args.json:
        print(json.dumps(controllers, indent=2))
        return 0
    table = Table(("controller", "type", "state", "commands", "joints"))
    for each in controllers:
        required = each["required_command_interfaces"]
        commands = each["interface"] or ", ".join(required) or "nothing: it broadcasts"
        table.add((each["name"], each["type"], each["state"], commands, ", ".join(each["joints"]) or "-"))
    print("\n".join(table.lines()) if controllers else "no controller is loaded; canopen-control controller load NAME")
    return 0


def _types(args: argparse.Namespace, robot: RobotClient) -> int:
    types = robot.call("controller_types")
    print(json.dumps(types, indent=2) if args.json else "\n".join(types))
    return 0


def _hardware(args: argparse.Namespace, robot: RobotClient) -> int:
    components = robot.call("hardware")
    if args.json:
        print(json.dumps(components, indent=2))
        return 0
    for each in components:
        print(f"{each['name']}: {each['state']}, {each['type']}, {each['plugin']}, {each['rate']} Hz")
        for kind in ("command", "state"):
            for interface in each[f"{kind}_interfaces"]:
                print(f"  {kind:<8} {interface['name']}{_words(interface)}")
    return 0


def _words(interface: dict[str, Any]) -> str:
    words = ["claimed"] if interface.get("claimed") else []
    words += [] if interface["available"] else ["not available"]
    return f" ({', '.join(words)})" if words else ""


# -- what changes something


def _one_by_one(args: argparse.Namespace, robot: RobotClient) -> int:
    for name in args.controller:
        robot.call(args.action, controller=name)
        print(f"{name}: {_states(robot).get(name, 'unloaded')}")
    return 0


def _switch(args: argparse.Namespace, robot: RobotClient) -> int:
    wanted: dict[str, list[str]] = {
        "activate": args.controller if args.action == "activate" else getattr(args, "activate", []),
        "deactivate": args.controller if args.action == "deactivate" else getattr(args, "deactivate", []),
    }
    before = _states(robot)
    robot.call("switch", **wanted, strict=not args.best_effort)
    after = _states(robot)
    for name in [*wanted["deactivate"], *wanted["activate"]]:
        print(f"{name}: {after.get(name, 'not loaded')}{'' if after.get(name) != before.get(name) else ', as before'}")
    return 0


def _states(robot: RobotClient) -> dict[str, str]:
    return {each["name"]: each["state"] for each in robot.call("controllers")}


_ACTIONS: dict[str, Callable[[argparse.Namespace, RobotClient], int]] = {
    "list": _list,
    "types": _types,
    "hardware": _hardware,
    "load": _one_by_one,
    "configure": _one_by_one,
    "unload": _one_by_one,
    "activate": _switch,
    "deactivate": _switch,
    "switch": _switch,
}
