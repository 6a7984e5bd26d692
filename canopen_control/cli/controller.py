"""List, load, configure, switch and unload the controllers of a running robot, like `ros2 control`.

A controller of ros2_controllers.yaml is loaded and configured (then it is inactive), then activated. `activate` does
the missing steps. Two controllers cannot command one interface: `switch` deactivates one and activates the other in the
same cycle. Activating enables drives; nothing moves before a command arrives.

Exit codes: 0 success; 1 the robot refused, and nothing was changed; 2 wrong usage, or no robot runs.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.cli.support.arguments import Names
from canopen_control.cli.support.output import Table, json_text, print_result
from canopen_control.cli.support.parsers import add_robot_name
from canopen_control.client import RobotClient
from canopen_control.errors import ConfigError
from canopen_control.rpc.messages.robot import (
    ConfigureController,
    ListControllers,
    ListControllerTypes,
    ListHardware,
    LoadController,
    SwitchControllers,
    UnloadController,
)

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable

    from canopen_control.rpc.messages.declare import Done, Request
    from canopen_control.rpc.messages.robot import InterfaceReading
    from canopen_control.rpc.messages.state import ControllerReading


EXAMPLE = """canopen-control controller list
         canopen-control controller types
         canopen-control controller hardware
         canopen-control controller load robby_base_controller
         canopen-control controller configure robby_base_controller
         canopen-control controller unload robby_base_controller
         canopen-control controller switch --activate robby_base_controller --deactivate robby_forward_controller
         canopen-control controller deactivate robby_base_controller
         canopen-control controller activate robby_base_controller"""

_STEPS = {
    "load": "load and configure controllers by their section in ros2_controllers.yaml",
    "configure": "configure inactive controllers again",
    "activate": "activate controllers; load and configure them first if needed",
    "deactivate": "deactivate controllers: release their interfaces, set velocities and efforts to 0",
    "unload": "unload inactive controllers",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    lists = [
        actions.add_parser("list", help="list controllers, their states and interfaces"),
        actions.add_parser("types", help="list the controller types"),
        actions.add_parser("hardware", help="list the hardware components and their interfaces"),
    ]
    steps = {action: actions.add_parser(action, help=text) for action, text in _STEPS.items()}
    switch = actions.add_parser("switch", help="deactivate some and activate others, in one cycle")
    for step in steps.values():
        step.add_argument(
            "controller",
            metavar="CONTROLLER",
            nargs="+",
            action=Names,
            help="controller names in ros2_controllers.yaml",
        )
    for option in ("activate", "deactivate"):
        switch.add_argument(
            f"--{option}", metavar="CONTROLLER", nargs="+", action=Names, help=f"controllers to {option}"
        )
    for action in (switch, steps["activate"], steps["deactivate"]):
        action.add_argument("--best-effort", action="store_true", help="do what is possible and skip the rest")
    for action in (*lists, *steps.values(), switch):
        add_robot_name(action)


def run(args: argparse.Namespace) -> int:
    """Run the verb."""
    if args.action == "switch" and not (args.activate or args.deactivate):
        raise ConfigError("nothing to switch; give --activate CONTROLLER..., --deactivate CONTROLLER..., or both")
    with RobotClient.connect(args.name) as robot:
        return _ACTIONS[args.action](args, robot)


# -- queries


def _list(args: argparse.Namespace, robot: RobotClient) -> int:
    controllers = robot.ask(ListControllers(all=True))
    if args.json:
        print(json_text(controllers))
        return 0
    table = Table(("controller", "type", "state", "commands", "joints"))
    for controller in controllers:
        table.add(
            (
                controller.name,
                controller.type,
                controller.state,
                _commands(controller),
                ", ".join(controller.joints) or "-",
            )
        )
    print("\n".join(table.lines()) if controllers else "no controller is loaded: canopen-control controller load NAME")
    return 0


def _commands(controller: ControllerReading) -> str:
    """Return the command interfaces of a controller as text; "-" if it has none or is not loaded."""
    if controller.state == "unloaded":
        return "-"
    nothing = "none (broadcaster)" if controller.is_broadcaster else "-"
    return controller.interface or ", ".join(controller.required_command_interfaces) or nothing


def _types(args: argparse.Namespace, robot: RobotClient) -> int:
    types = robot.ask(ListControllerTypes())
    print(json_text(types) if args.json else "\n".join(types))
    return 0


def _hardware(args: argparse.Namespace, robot: RobotClient) -> int:
    components = robot.ask(ListHardware())
    if args.json:
        print(json_text(components))
        return 0
    for component in components:
        print(f"{component.name}: {component.state}, {component.type}, {component.plugin}, {component.rate} Hz")
        for kind, interfaces in (("command", component.command_interfaces), ("state", component.state_interfaces)):
            for interface in interfaces:
                print(f"  {kind:<8} {interface.name}{_words(interface)}")
    return 0


def _words(interface: InterfaceReading) -> str:
    words = ["claimed"] if interface.claimed else []
    words += [] if interface.available else ["not available"]
    return f" ({', '.join(words)})" if words else ""


# -- state changes


def _one_by_one(args: argparse.Namespace, robot: RobotClient) -> int:
    states: dict[str, str] = {}
    for name in args.controller:
        robot.ask(_STEP_REQUESTS[args.action](controller=name))
        states[name] = _states(robot).get(name, "unloaded")
        if not args.json:
            print(f"{name}: {states[name]}")
    print_result(args, [{"name": name, "state": state} for name, state in states.items()])
    return 0


def _switch(args: argparse.Namespace, robot: RobotClient) -> int:
    activate = args.controller if args.action == "activate" else getattr(args, "activate", [])
    deactivate = args.controller if args.action == "deactivate" else getattr(args, "deactivate", [])
    before = _states(robot)
    robot.ask(SwitchControllers(activate=tuple(activate), deactivate=tuple(deactivate), strict=not args.best_effort))
    after = _states(robot)
    names = [*deactivate, *activate]
    lines = [
        f"{name}: {after.get(name, 'not loaded')}{'' if after.get(name) != before.get(name) else ', unchanged'}"
        for name in names
    ]
    print_result(args, [{"name": name, "state": after.get(name, "unloaded")} for name in names], "\n".join(lines))
    return 0


def _states(robot: RobotClient) -> dict[str, str]:
    return {controller.name: controller.state for controller in robot.ask(ListControllers())}


_STEP_REQUESTS: dict[str, Callable[..., Request[Done]]] = {
    "load": LoadController,
    "configure": ConfigureController,
    "unload": UnloadController,
}
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
