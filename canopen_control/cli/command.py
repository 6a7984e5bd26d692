"""Send values to a controller at 10 Hz until Ctrl-C, then send zeros; position joints hold their current position.

Outputs of a GPIO command controller can be named, as in `io/lamp=1`; the others keep their values. When the command
ends, the named outputs go to their safe values.

Exit codes: 0 sent; 1 the robot refused the command or stopped, or a joint does not follow; 2 wrong usage, no robot
runs, no such controller or output, or a wrong number of values.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.cli.support.arguments import finite
from canopen_control.cli.support.commands import (
    add_repeat_arguments,
    ask_for_controllers,
    send,
    target_interface,
    values_at_the_end,
)
from canopen_control.errors import ConfigError
from canopen_control.rpc.messages.robot import CommandByName, CommandController

if TYPE_CHECKING:
    import argparse


EXAMPLE = """canopen-control command robby_forward_controller 10 10 --for 3
         canopen-control command io_controller io/lamp=1 --once"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("controller", metavar="CONTROLLER", help="controller name in ros2_controllers.yaml")
    parser.add_argument(
        "values",
        nargs="+",
        type=_value,
        metavar="VALUE",
        help="one value for each joint, in SI units (rad/s, rad, Nm); or NAME=VALUE for outputs of <gpio> parts",
    )
    add_repeat_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Run the verb."""
    dead_man = not args.once  # the command ends when the connection is lost
    named = {name: value for name, value in args.values if name}
    if named:
        if len(named) != len(args.values):
            raise ConfigError(
                f"{args.controller}: write all values as NAME=VALUE, each name once, or all without names"
            )
        outputs = CommandByName(controller=args.controller, values=named, source="command", dead_man=dead_man)
        return send(args, outputs, None)
    values = [value for _, value in args.values]
    controllers = ask_for_controllers(args.name)
    last = values_at_the_end(controllers, args.controller, values)
    target = target_interface(controllers, args.controller)
    command, zeros = (
        CommandController(controller=args.controller, values=row, source="command", dead_man=dead_man, interface=target)
        for row in (values, last or [])
    )
    return send(args, command, zeros if last is not None else None)


def _value(text: str) -> tuple[str, float]:
    """Return the name and the value of NAME=VALUE; the name is "" for a plain VALUE."""
    name, _, value = text.rpartition("=")
    return name, finite(value)
