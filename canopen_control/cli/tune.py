"""Measure how well a drive tracks, identify its load, and propose gains for its loops.

--step applies a velocity step and measures rise time, overshoot, settling and error. --bode applies a sine sweep (or a
pseudo-random binary sequence, prbs) and prints gain and phase of the velocity loop. --identify applies a torque in both
directions and prints inertia, friction and PI gains for --crossover and --phase-margin. The drive is moved as by `jog`,
on a bare bus (--can, --eds) or through a robot without controllers, within limits of speed, travel and current that you
confirm first (or with --yes). Ctrl-C, a limit, a fault or a lost terminal ends the run: the drive stops and is
disabled. This is not an emergency stop (ISO 13850): have one within reach, and keep the shaft free.

Exit codes: 0 success; 1 the run ended early or gave no usable result; 2 wrong usage, not confirmed, no such mode.
"""

from __future__ import annotations

import contextlib
import math
import signal
import sys
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final

from canopen_control.cli.support.arguments import number
from canopen_control.cli.support.job_verb import add_job_options, job_options
from canopen_control.cli.support.jog_robot import choose_tuned, dead_man_words, own_robot
from canopen_control.cli.support.jog_run import SIGNALS
from canopen_control.cli.support.open_session import (
    WarningPrinter,
    add_session_arguments,
    axis_of,
    open_session,
    read_bare_drive,
    running_drive,
    with_counts,
)
from canopen_control.cli.support.output import json_text
from canopen_control.cli.support.target import parse_node_id, robot_on
from canopen_control.commissioning.jobs import TUNE
from canopen_control.commissioning.jog_motion import JogEnd, JogKind
from canopen_control.commissioning.quantity import JogScale, parse_quantity
from canopen_control.commissioning.scope_capture import refuse_without_pictures
from canopen_control.commissioning.tune_gains import (
    GAIN_NAMES,
    GainPlace,
    applied,
    parse_gain,
    reverted,
    settable_gains,
)
from canopen_control.commissioning.tune_job import TunePlan, excite, request_of
from canopen_control.commissioning.tune_report import CSV, PICTURE, findings, identified, proposed, report
from canopen_control.commissioning.tune_run import MAX_TORQUE, TuneTest
from canopen_control.errors import ConfigError
from canopen_control.host.signals import on_signals

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Iterator

    from canopen_control.commissioning.driven_axis import JogDrive
    from canopen_control.commissioning.jobs import TuneOptions
    from canopen_control.commissioning.tune_run import TuneRequest


EXAMPLE = """canopen-control tune 5 --can can0 --eds my_drive.eds --step 30rpm
         canopen-control tune 5 --can can0 --eds my_drive.eds --identify 150 --crossover 20 --phase-margin 60 --apply
         canopen-control tune 5 --can can0 --eds my_drive.eds --revert
         canopen-control tune 5 --can can0 --eds my_drive.eds --bode -o bode.png
         canopen-control tune 5 --can can0 --eds my_drive.eds --identify 150 --yes --json"""

_EFFORT_UNIT: Final = 1000.0  # per mille: default unit of an effort, a fraction of the rated torque


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add_session_arguments(parser)
    _add_tests(parser)
    add_job_options(parser, TUNE)
    period = number("period in ms: 1 to 50", lambda value: 1 <= value <= 50)
    parser.add_argument(
        "--period", type=period, default=10.0, metavar="MS", help="SYNC period on a bare bus (default: 10)"
    )
    parser.add_argument("--apply", action="store_true", help="write the gains that --identify proposes")
    parser.add_argument(
        "--gain",
        metavar="NAME=0xINDEX:SUB*SCALE",
        action="append",
        default=[],
        help=f"object that holds a gain ({', '.join(GAIN_NAMES)}) and the value of 1 in it (repeatable)",
    )
    parser.add_argument("--yes", action="store_true", help="confirm limits and excitation in advance")
    parser.add_argument(
        "-o",
        "--output",
        metavar="FILE",
        help="file of the record, or with --bode of the response: NAME.csv or NAME.png",
    )
    parser.add_argument("--json", action="store_true", help="print the result as JSON, all else on standard error")


def _add_tests(parser: argparse.ArgumentParser) -> None:
    """Declare the tests and --revert, which are mutually exclusive."""
    group = parser.add_mutually_exclusive_group(required=True)
    group.add_argument("--step", metavar="X[rad/s|rpm|pps]", help="apply a velocity step")
    group.add_argument(
        "--bode",
        nargs="?",
        const="chirp",
        choices=("chirp", "prbs"),
        help="measure gain and phase of the velocity loop (default: chirp)",
    )
    torque = number("torque in per mille of the rated torque, above 0 to 300", lambda value: 0 < value <= MAX_TORQUE)
    group.add_argument(
        "--identify", metavar="PERMILLE", type=torque, help="apply a torque; identify inertia, friction and gains"
    )
    group.add_argument("--revert", action="store_true", help="write back the gains from before --apply")


def run(args: argparse.Namespace) -> int:
    """Run the verb."""
    _check_gains(args)
    if args.revert:
        with open_session(args) as session:
            print("\n".join(_hinted(reverted(session, _place(args)), args)))
        return 0
    options = job_options(args, TUNE)
    request = _request(args, options)
    show = partial(print, file=sys.stderr if args.json else sys.stdout, flush=True)
    output = None if args.output is None else _output(args.output)
    if args.apply:
        _find_gains(args)
    with contextlib.ExitStack() as stack:
        owner = None if args.can is None else robot_on(args.can)
        if args.can is None or owner is not None:
            mode = "PV" if request.kind is JogKind.VELOCITY else "TQ"
            drive, scale = running_drive(args, args.name if owner is None else owner[0], mode, stack)
            plan = TunePlan.of(request, options, scale)
            _confirm(plan.lines(scale), args, show)
        else:
            drive, scale, plan = stack.enter_context(_bare_drive(args, request, options, show))
        run = excite(drive, plan, scale, _EFFORT_UNIT if drive.alone else None)
        suspended = partial(run.leave, JogEnd.SUSPENDED)
        with on_signals(SIGNALS, run.leave), on_signals((signal.SIGCONT,), suspended):
            record = run.run()
    if record.lost:
        print(
            f"canopen-control: {record.lost} of {record.lost + len(record.samples)} cycles were lost", file=sys.stderr
        )
    show("\n".join(report(record, request, scale, output)))
    if args.json:
        print(json_text(asdict(findings(record, request, scale))))
    if args.apply:
        gains = proposed(identified(record), request)
        with open_session(args) as session:
            show("\n".join(_hinted(applied(session, gains, scale.counts / math.tau, _place(args)), args)))
        target = f"--can {args.can} --eds {args.eds}" if args.can else f"--name {args.name}" if args.name else ""
        show(f"undo with: canopen-control tune {args.node} {target} --revert".replace("  ", " "))
    return 0


def _check_gains(args: argparse.Namespace) -> None:
    """Raise ConfigError for options that cannot be combined, or for an invalid --gain."""
    if args.apply and args.identify is None:
        raise ConfigError("--apply sets the gains that --identify proposes; the other tests propose none")
    if args.store and not (args.apply or args.revert):
        raise ConfigError("--store requires --apply or --revert")
    if args.gain and not args.apply:
        raise ConfigError("--gain names the objects that --apply sets; omit it, or add --apply")
    if args.json and args.revert:
        raise ConfigError("--json prints the result of a test; omit it with --revert")
    for gain in args.gain:
        parse_gain(gain)


def _place(args: argparse.Namespace) -> GainPlace:
    return GainPlace(args.axis, tuple(args.gain), args.can or "", args.store)


def _hinted(lines: Iterator[str], args: argparse.Namespace) -> Iterator[str]:
    """Yield lines; without --store, a hint about this option is appended to the last line."""
    *first, last = lines
    yield from first
    yield last if args.store else f"{last} (--store)"


def _find_gains(args: argparse.Namespace) -> None:
    """Raise ConfigError, before the drive moves, if its gain objects or the units of the gains are unknown."""
    with open_session(args) as session:
        if session.robot and args.counts is None:
            raise ConfigError(
                f"{session}: --apply through a running robot needs --counts N, the user units of 0x6064 per turn of "
                "its joint, because the gains are in these units"
            )
        settable_gains(session, args.axis, args.gain, 1.0)


def _request(args: argparse.Namespace, options: TuneOptions) -> TuneRequest:
    """Return the test requested by the arguments; raise ConfigError for an invalid value."""
    speed = parse_quantity(args.step, "velocity") if args.step is not None else None
    test = TuneTest.STEP if speed is not None else TuneTest.BODE if args.bode else TuneTest.IDENTIFY
    torque, signal = args.identify or 0.0, args.bode or "prbs"
    return request_of(test, options, args.period / 1e3, speed=speed, torque=torque, signal=signal)


def _output(name: str) -> Path:
    path = Path(name).expanduser()
    if path.suffix not in (CSV, PICTURE) or not path.parent.is_dir():
        kinds = f"NAME{CSV} for a table or NAME{PICTURE} for a picture"
        raise ConfigError(f"-o {name}: give {kinds}, in an existing folder")
    if path.suffix == PICTURE:
        refuse_without_pictures()
    return path


@contextlib.contextmanager
def _bare_drive(
    args: argparse.Namespace, request: TuneRequest, options: TuneOptions, show: Callable[[str], None]
) -> Iterator[tuple[JogDrive, JogScale, TunePlan]]:
    """Context that identifies a drive on a bare bus, asks to confirm limits, and runs a robot of this drive alone."""
    if args.eds is None:
        raise ConfigError(f"node {args.node}: give the EDS of the drive: --eds FILE (bundled: generic_cia402.eds, ...)")
    parse_node_id(args.node)
    device = read_bare_drive(args)
    period_us = round(args.period * 1e3)
    robot = choose_tuned(device, request.kind, period_us, allow_unsupervised=args.allow_unsupervised)
    axis = axis_of(robot, args)
    scale = JogScale(args.counts or axis.counts, is_known=args.counts is not None or axis.is_known)
    plan = TunePlan.of(request, options, scale)
    node = robot.nodes[0]
    lines = [f"node {node.device.node_id}: {axis.interface} in {axis.mode.name}, a sample every {args.period:g} ms"]
    _confirm([*lines, *plan.lines(scale), f"dead-man: {dead_man_words(node.supervision)}"], args, show)
    robot = with_counts(robot, args.counts)
    with own_robot(robot, axis_of(robot, args), args.can, plan.limits.speed, WarningPrinter()) as drive:
        yield drive, scale, plan


def _confirm(lines: list[str], args: argparse.Namespace, show: Callable[[str], None]) -> None:
    """Print the planned motion and its limits, and ask the user; raise ConfigError unless the user agrees."""
    show("\n".join(lines))
    if args.yes:
        return
    if not sys.stdin.isatty():
        raise ConfigError("nothing moves unless the limits are confirmed: give --yes, or confirm at a terminal")
    question = "is the shaft free, and may it move like this? [y/N] "
    if args.json:
        show(question)
    try:
        answer = input("" if args.json else question)
    except (EOFError, KeyboardInterrupt):
        answer = ""
    if answer.strip().lower() not in ("y", "yes"):
        raise ConfigError("not confirmed; nothing moved")
