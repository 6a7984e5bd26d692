"""`where`: print the joint positions of a running robot."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from canopen_control import Robot

if TYPE_CHECKING:
    import argparse

EXAMPLE = "canopen-control where --json"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument("--name", help="name of the robot (default: the only one running)")


def run(args: argparse.Namespace) -> int:
    """Run the verb; return 0."""
    with Robot.attach(args.name) as robot:
        positions = {name: joint.position for name, joint in robot.joints().items()}
    if args.json:
        print(json.dumps(positions))
        return 0
    for name, position in positions.items():
        print(f"{name}: {'unknown' if position is None else f'{position:.3f} rad'}")
    return 0
