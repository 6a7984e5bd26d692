"""`run --world FILE` without a robot: all robots that the file of a world names, each with the options that are given.

What says which robot, which bus or which drives is the file's; ROS names of each robot begin with its name.
"""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final

from canopen_control.errors import ConfigError

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable

__all__ = ["run_shared"]

_FLAGS: Final = ("ros", "view", "teleop", "strict", "peer_merge", "allow_unsupervised")
_OF_THE_FILE: Final = ("name", "can", "controller", "namespace", "real", "mock", "no_drives", "plant", "kernel_sync",
                       "realtime", "cpu", "full_speed", "ros_args")  # fmt: skip


def run_shared(args: argparse.Namespace) -> int:
    """Run the robots of a world until they end; ConfigError for options that are none of theirs."""
    for name in _OF_THE_FILE:
        if getattr(args, name):
            option = name.replace("_", "-")
            raise ConfigError(
                f"--{option}: without a robot --world runs all that its file names; leave --{option} away"
            )
    _require_parts(args)
    from canopen_control.runtime.shared_world import SharedRun, read_shared

    world = Path(args.world)
    robots = read_shared(world)
    run = SharedRun(
        robots, world, partial(print, file=sys.stdout, flush=True), options=_options(args), of_each=_namespace(args)
    )
    run.run()
    return 0


def _require_parts(args: argparse.Namespace) -> None:
    if args.ros:
        from canopen_control.ros.installation import require_ros

        require_ros()
    if args.view:
        from canopen_control.view import require_view

        require_view()
    elif args.teleop:
        raise ConfigError("--teleop is for the pages; show them with --view")


def _options(args: argparse.Namespace) -> list[str]:
    """Return the options that each robot gets."""
    options = [f"--{name.replace('_', '-')}" for name in _FLAGS if getattr(args, name)]
    if not args.flight_recorder:
        options.append("--no-flight-recorder")
    if args.duration is not None:
        options += ["--for", f"{args.duration:g}"]
    return options


def _namespace(args: argparse.Namespace) -> Callable[[str], list[str]]:
    return lambda name: ["--namespace", name] if args.ros else []
