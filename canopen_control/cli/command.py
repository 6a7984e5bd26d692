"""`command`: send values to a controller, at 10 Hz until Ctrl-C, then zeros; positions are held where they are then."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from canopen_control.cli.commanded import send_and_warn
from canopen_control.cli.repeat import add_repeat_arguments, finite

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
    params: dict[str, Any] = {"controller": args.controller, "source": "command"}
    return send_and_warn(
        args, "command", {**params, "values": args.values}, {**params, "values": [0.0] * len(args.values)}
    )
