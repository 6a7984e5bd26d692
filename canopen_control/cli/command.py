"""`command`: send values to a controller, at 10 Hz until Ctrl-C, then zeros; positions are held where they are then."""

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
from canopen_control.rpc.messages.robot import CommandController

if TYPE_CHECKING:
    import argparse

__all__ = ["add_arguments", "run"]

EXAMPLE = "canopen-control command robby_forward_controller 10 10 --for 3"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("controller", help="its name in ros2_controllers.yaml")
    parser.add_argument(
        "values", nargs="+", type=finite, metavar="VALUE", help="one for each joint, SI units (rad/s, rad, Nm)"
    )
    add_repeat_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Run the verb."""
    controllers = ask_for_controllers(args.name)
    last = values_at_the_end(controllers, args.controller, args.values)
    meant = target_interface(controllers, args.controller)
    dead_man = not args.once  # it ends as soon as the connection is gone
    moving, zeros = (
        CommandController(
            controller=args.controller, values=values, source="command", dead_man=dead_man, interface=meant
        )
        for values in (args.values, last)
    )
    return send(args, moving, zeros)
