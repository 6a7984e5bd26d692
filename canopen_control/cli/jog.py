"""Move one drive with the arrow keys; this needs only the EDS of the drive.

On a bare bus (--can CHANNEL --eds FILE) the drive is configured as `init` would do it, booted, supervised, enabled and
moved slowly; at the end it is stopped along its ramp and disabled. Nothing is stored in it; its mode (0x6060), its
SYNC period (0x60C2) and its reaction to a lost master (0x6007) remain changed until it is reset or switched off. A
drive of a running robot without controllers is moved through that robot. The drive moves while you hold an arrow key;
with --for or --position it moves at once, and any key ends the motion. It stops when you release the key, at Ctrl-C, at
a limit and when the terminal is lost. If this program is killed, the drive stops on its own, because it monitors this
program. This is not an emergency stop (ISO 13850): have one within reach, and keep the shaft free.

Exit codes: 0 success; 1 the drive failed or has a fault, nothing turned, or jog was suspended (Ctrl-Z); 2 wrong usage,
wrong EDS or node; 130 interrupted by SIGINT or SIGTERM.
"""

from __future__ import annotations

import contextlib
import math
import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from canopen_control.cli.support.arguments import number
from canopen_control.cli.support.job_verb import add_job_options, job_options
from canopen_control.cli.support.jog_robot import choose_jog, dead_man_words, own_robot
from canopen_control.cli.support.jog_run import JogRun, reset_fault
from canopen_control.cli.support.open_session import (
    WarningPrinter,
    add_session_arguments,
    axis_of,
    read_bare_drive,
    running_drive,
    with_counts,
)
from canopen_control.cli.support.output import json_alone, print_result
from canopen_control.cli.support.target import parse_node_id, robot_on
from canopen_control.commissioning.jobs import JOG
from canopen_control.commissioning.jog_motion import MAX_SPEED, JogKind, limits_of
from canopen_control.commissioning.quantity import JogScale, Quantity, parse_quantity
from canopen_control.errors import ConfigError

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator

    from canopen_control.commissioning.driven_axis import JogDrive
    from canopen_control.commissioning.jobs import MotionOptions
    from canopen_control.commissioning.jog_motion import JogLimits
    from canopen_control.scaffold.drive_choice import AxisChoice
    from canopen_control.scaffold.new_robot import NewRobot


EXAMPLE = """canopen-control jog 5 --can can0 --eds my_drive.eds
         canopen-control jog 5 --can can0 --eds my_drive.eds --velocity 20rpm --for 3
         canopen-control jog 5 --can can0 --eds my_drive.eds --position 90deg"""

_SPEED: Final = 1.0  # rad/s, also for position moves
_TORQUE: Final = 300.0  # per mille of the rated torque
_KINDS: Final = {"velocity": JogKind.VELOCITY, "position": JogKind.POSITION, "torque": JogKind.TORQUE}
_MODES: Final = {JogKind.VELOCITY: "PV", JogKind.POSITION: "PP", JogKind.TORQUE: "TQ"}  # through a running robot


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add_session_arguments(parser)
    group = parser.add_mutually_exclusive_group()
    group.add_argument("--velocity", metavar="X[rad/s|rpm|pps]", help="velocity (default: 1 rad/s)")
    group.add_argument("--position", metavar="X[rad|deg|counts]", help="distance from the current position")
    per_mille = number("torque in per mille of the rated torque, -300 to 300", lambda value: abs(value) <= _TORQUE)
    group.add_argument("--torque", metavar="PERMILLE", type=per_mille, help="torque, in per mille of the rated torque")
    group.add_argument("--fault-reset", action="store_true", help="reset the fault of the drive; nothing moves")
    add_job_options(parser, JOG)


@dataclass(frozen=True, slots=True)
class _Request:
    """Motion requested by the arguments, in the user's units, since the drive's scale is not known yet."""

    kind: JogKind
    value: Quantity | float  # a number is in SI or per mille

    def limits(self, scale: JogScale, options: MotionOptions) -> tuple[float, JogLimits]:
        """Return the value in SI or per mille, and the limits; raise ConfigError if the value exceeds them."""
        limits = limits_of(options, scale, _SPEED if self.kind is JogKind.POSITION else MAX_SPEED)
        value = scale.si(self.value) if isinstance(self.value, Quantity) else self.value
        limit = {JogKind.VELOCITY: limits.speed, JogKind.POSITION: limits.travel}.get(self.kind, math.inf)
        if abs(value) > limit * (1 + 1e-9):
            option = "--max-speed" if self.kind is JogKind.VELOCITY else "--max-travel"
            words = scale.velocity_words if self.kind is JogKind.VELOCITY else scale.position_words
            raise ConfigError(
                f"{self.value} exceeds the limit of {words(limit)}; if safe, raise the limit with {option}"
            )
        return value, limits


def run(args: argparse.Namespace) -> int:
    """Run the verb."""
    request = _request(args)
    if not (args.seconds or request.kind is JogKind.POSITION or args.fault_reset or sys.stdin.isatty()):
        raise ConfigError("standard input is not a terminal, so keys cannot be read; give a duration with --for S")
    with contextlib.ExitStack() as stack:
        owner = None if args.can is None else robot_on(args.can)
        if args.can is None or owner is not None:
            drive, scale = running_drive(args, args.name if owner is None else owner[0], _MODES[request.kind], stack)
        else:
            drive, scale = stack.enter_context(_bare_drive(args, request))
        place = {"node": args.node, "joint": None if drive.alone else drive.joint}
        if args.fault_reset:
            print_result(args, {**place, "fault_reset": True}, reset_fault(drive))
            return 0
        value, limits = request.limits(scale, job_options(args, JOG))
        jog = JogRun(drive, scale, request.kind, value, limits, args.seconds)
        with json_alone(args):
            code = jog.run()
        print_result(args, {**place, "ended": jog.ended.value, "travelled": jog.travelled})
        return code


def _request(args: argparse.Namespace) -> _Request:
    """Return the motion requested by the arguments; raise ConfigError for an invalid quantity or 0."""
    kind = next((name for name in _KINDS if getattr(args, name) is not None), "velocity")
    value: Quantity | float = _SPEED
    if kind == "torque":
        value = float(args.torque)
        if not value:
            raise ConfigError("--torque 0 moves nothing; give another value")
    elif getattr(args, kind) is not None:
        value = parse_quantity(getattr(args, kind), kind)
        if not value.value:
            raise ConfigError(f"--{kind} {value} moves nothing; give another value")
    return _Request(_KINDS[kind], value)


@contextlib.contextmanager
def _bare_drive(args: argparse.Namespace, request: _Request) -> Iterator[tuple[JogDrive, JogScale]]:
    """Context that identifies a drive on a bare bus and runs a robot that consists of this drive alone."""
    if args.eds is None:
        raise ConfigError(f"node {args.node}: give the EDS of the drive: --eds FILE (bundled: generic_cia402.eds, ...)")
    parse_node_id(args.node)
    device = read_bare_drive(args, with_fault=args.fault_reset)
    robot = choose_jog(device, request.kind.value, allow_unsupervised=args.allow_unsupervised)
    axis = axis_of(robot, args)
    scale = JogScale(args.counts or axis.counts, is_known=args.counts is not None or axis.is_known)
    _, limits = request.limits(scale, job_options(args, JOG))
    with json_alone(args):
        print("\n".join(_lines(robot, axis, scale, limits)), flush=True)
    robot = with_counts(robot, args.counts)
    with own_robot(robot, axis_of(robot, args), args.can, limits.speed, WarningPrinter()) as drive:
        yield drive, scale


def _lines(robot: NewRobot, axis: AxisChoice, scale: JogScale, limits: JogLimits) -> Iterator[str]:
    node = robot.nodes[0]
    product = " ".join(filter(None, (node.device.od.device.vendor_name, node.device.od.device.product_name)))
    yield f"node {node.device.node_id}{f', {product}' if product else ''}: {axis.interface} in {axis.mode.name}"
    turn = (
        f"{scale.counts:g} counts per turn"
        if scale.is_known
        else "counts per turn unknown, as neither EDS nor drive contains them (--counts N)"
    )
    yield f"limits: {scale.velocity_words(limits.speed)}, {scale.position_words(limits.travel)} in each direction,"
    yield f"        current {limits.current / 10:g} % of the rated current; {turn}"
    yield f"dead-man: {dead_man_words(node.supervision)}"
