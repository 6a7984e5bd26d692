"""`twist`: send a velocity to a base controller, at 10 Hz until Ctrl-C, then zeros."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from canopen_control.cli.commanded import send_and_warn
from canopen_control.cli.repeat import add_repeat_arguments, finite

if TYPE_CHECKING:
    import argparse

__all__ = ["add_arguments", "run"]

EXAMPLE = "canopen-control twist robby_base_controller 0.2 0.5 --for 3"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("controller", help="its name in ros2_controllers.yaml")
    parser.add_argument("linear", type=finite, help="forward, m/s")
    parser.add_argument("angular", type=finite, help="to the left, rad/s")
    add_repeat_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Run the verb."""
    params: dict[str, Any] = {"controller": args.controller, "source": "twist"}
    moving = {**params, "linear": args.linear, "angular": args.angular}
    return send_and_warn(args, "twist", moving, {**params, "linear": 0.0, "angular": 0.0})
