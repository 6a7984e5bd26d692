"""Send a velocity to a base controller at 10 Hz until Ctrl-C, then send zeros.

Exit codes: 0 sent; 1 the robot refused the command or stopped; 2 wrong usage, no robot runs, or no such controller.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.cli.support.arguments import finite
from canopen_control.cli.support.commands import add_repeat_arguments, send
from canopen_control.rpc.messages.robot import TwistController

if TYPE_CHECKING:
    import argparse


EXAMPLE = """canopen-control controller switch --activate robby_base_controller --deactivate robby_forward_controller
         canopen-control twist robby_base_controller 0.2 0.5 --for 3
         canopen-control twist mecanum_base_controller 0 0 --lateral 0.2 --for 3"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("controller", metavar="CONTROLLER", help="controller name in ros2_controllers.yaml")
    parser.add_argument("linear", metavar="LINEAR", type=finite, help="forward velocity in m/s")
    parser.add_argument("angular", metavar="ANGULAR", type=finite, help="angular velocity to the left in rad/s")
    parser.add_argument(
        "--lateral",
        type=finite,
        default=0.0,
        metavar="V",
        help="velocity to the left in m/s, if the base can (default: 0)",
    )
    add_repeat_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Run the verb."""
    dead_man = not args.once  # the command ends when the connection is lost
    command, zeros = (
        TwistController(
            controller=args.controller,
            linear=linear,
            lateral=lateral,
            angular=angular,
            source="twist",
            dead_man=dead_man,
        )
        for linear, lateral, angular in ((args.linear, args.lateral, args.angular), (0.0, 0.0, 0.0))
    )
    return send(args, command, zeros)
