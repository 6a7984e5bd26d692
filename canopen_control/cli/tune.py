"""Measure how well a drive tracks, identify its load, and propose gains for its loops.

--step applies a velocity step and measures rise time, overshoot, settling and error. --bode applies a sine sweep (or a
pseudo-random binary sequence, prbs) and prints gain and phase of the velocity loop. --identify applies a torque in both
directions and prints inertia, friction and PI gains for --crossover and --phase-margin. The drive is moved as by `jog`,
on a bare bus (--can, --eds) or through a robot without controllers, within limits of speed, travel and current that you
confirm first (or with --yes). Ctrl-C, a limit, a fault or a lost terminal ends the run: the drive stops and is
disabled. This is not an emergency stop (ISO 13850): have one in reach, and keep the shaft free.

Exit codes: 0 good; 1 the run ended early or gave no usable result; 2 wrong usage, not confirmed, no such mode.
"""

from __future__ import annotations

import contextlib
import math
import sys
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final

from canopen_control.cli.support.arguments import number, seconds, whole_number
from canopen_control.cli.support.jog_robot import dead_man_words, own_robot
from canopen_control.cli.support.jog_run import SIGNALS
from canopen_control.cli.support.open_session import (
    WarningPrinter,
    add_session_arguments,
    axis_of,
    look_at_drive,
    open_session,
    running_drive,
    with_counts,
)
from canopen_control.cli.support.output import json_text
from canopen_control.cli.support.target import parse_node_id, robot_on
from canopen_control.cli.support.tune_choice import choose_tuned
from canopen_control.commissioning.jog_motion import JogKind, JogLimits, JogScale, parse_quantity
from canopen_control.commissioning.scope_capture import refuse_without_pictures
from canopen_control.commissioning.tune_gains import (
    GAIN_NAMES,
    GainPlace,
    applied,
    parse_gain,
    reverted,
    settable_gains,
)
from canopen_control.commissioning.tune_report import CSV, PICTURE, findings, identified, proposed, report
from canopen_control.commissioning.tune_run import PEAK_S, TuneRequest, TuneRun, TuneTest, torque_index_of
from canopen_control.errors import ConfigError
from canopen_control.host.signals import on_signals

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Iterator

    from canopen_control.commissioning.driven_axis import JogDrive


EXAMPLE = """canopen-control tune 5 --can can0 --eds my_drive.eds --step 30rpm
         canopen-control tune 5 --can can0 --eds my_drive.eds --identify 150 --crossover 20 --phase-margin 60 --apply
         canopen-control tune 5 --can can0 --eds my_drive.eds --revert
         canopen-control tune 5 --can can0 --eds my_drive.eds --bode -o bode.png
         canopen-control tune 5 --can can0 --eds my_drive.eds --identify 150 --yes --json"""

_MAX_SPEED = math.tau  # rad/s
_MAX_TRAVEL = 10.0 * math.tau  # rad
_MAX_CURRENT = 1000.0  # per mille of the rated one
_TORQUE = 300.0  # per mille, maximum torque of an excitation
_EFFORT_UNIT: Final = 1000.0  # per mille: default unit of an effort, a fraction of the rated torque
_DECELERATION: Final = 20.0  # rad/s^2, for a drive without own ramps


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add_session_arguments(parser)
    _add_what(parser)
    positive = number("number above 0", lambda value: value > 0)
    parser.add_argument(
        "--for", dest="seconds", type=seconds, metavar="S", help="duration in s (default: step 2, bode 8, identify 8)"
    )
    _add_proposal(parser)
    parser.add_argument("--store", action="store_true", help="store the gains in the drive (0x1010)")
    parser.add_argument("--max-speed", metavar="X[rad/s|rpm|pps]", help="speed limit (default: 60rpm)")
    parser.add_argument(
        "--max-travel", metavar="X[rad|deg|turns|counts]", help="travel limit in each direction (default: 10turns)"
    )
    parser.add_argument(
        "--max-current",
        type=positive,
        default=_MAX_CURRENT,
        metavar="PERMILLE",
        help="current limit in per mille of the rated current (default: 1000)",
    )
    period = number("period in ms: 1 to 50", lambda value: 1 <= value <= 50)
    parser.add_argument(
        "--period", type=period, default=10.0, metavar="MS", help="SYNC period on a bare bus (default: 10)"
    )
    parser.add_argument(
        "--counts", type=positive, metavar="N", help="position counts per turn, if neither EDS nor drive gives them"
    )
    axis = whole_number("axis: 0 to 7", range(8))
    parser.add_argument(
        "--axis", type=axis, default=0, metavar="N", help="axis number of a drive with several (default: 0)"
    )
    parser.add_argument("--allow-unsupervised", action="store_true", help="same as for `jog`")
    parser.add_argument("--yes", action="store_true", help="confirm limits and excitation in advance")
    parser.add_argument(
        "-o",
        "--output",
        metavar="FILE",
        help="file of the record, or with --bode of the response: NAME.csv or NAME.png",
    )
    parser.add_argument("--json", action="store_true", help="print the result as JSON, all else on standard error")


def _add_proposal(parser: argparse.ArgumentParser) -> None:
    """Declare the options for the proposed gains and their writing."""
    positive = number("number above 0", lambda value: value > 0)
    parser.add_argument(
        "--crossover",
        type=positive,
        default=20.0,
        metavar="HZ",
        help="crossover frequency of the proposal (default: 20)",
    )
    margin = number("phase margin in degrees: 20 to 85", lambda value: 20 <= value <= 85)
    parser.add_argument(
        "--phase-margin", type=margin, default=60.0, metavar="DEG", help="phase margin of the proposal (default: 60)"
    )
    parser.add_argument(
        "--loop-delay",
        type=positive,
        default=0.5,
        metavar="MS",
        help="dead time of the drive's own loop (default: 0.5)",
    )
    parser.add_argument("--apply", action="store_true", help="write the gains that --identify proposes")
    parser.add_argument(
        "--gain",
        metavar="NAME=0xINDEX:SUB*SCALE",
        action="append",
        default=[],
        help=f"object that holds a gain ({', '.join(GAIN_NAMES)}) and the value of 1 in it (repeatable)",
    )


def _add_what(parser: argparse.ArgumentParser) -> None:
    """Declare the tests, which are mutually exclusive."""
    group = parser.add_mutually_exclusive_group(required=True)
    group.add_argument("--step", metavar="X[rad/s|rpm|pps]", help="apply a velocity step")
    group.add_argument(
        "--bode",
        nargs="?",
        const="chirp",
        choices=("chirp", "prbs"),
        help="measure gain and phase of the velocity loop (default: chirp)",
    )
    torque = number("torque in per mille of the rated one, above 0 to 300", lambda value: 0 < value <= _TORQUE)
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
    request = _request(args)
    say = partial(print, file=sys.stderr if args.json else sys.stdout, flush=True)
    output = None if args.output is None else _output(args.output)
    if args.apply:
        _find_gains(args)
    with contextlib.ExitStack() as stack:
        owner = None if args.can is None else robot_on(args.can)
        if args.can is None or owner is not None:
            mode = "PV" if request.kind is JogKind.VELOCITY else "TQ"
            drive, scale = running_drive(args, args.name if owner is None else owner[0], mode, stack)
            limits = _limits(args, request, scale)
            _confirm([*_plan(request, scale, limits)], args, say)
            effort_unit = None
        else:
            drive, scale, limits = stack.enter_context(_own(args, request, say))
            effort_unit = _EFFORT_UNIT
        excitation = request.excitation(scale)
        tune = TuneRun(
            drive,
            request.kind,
            excitation,
            limits,
            deceleration=_DECELERATION,
            effort_unit=effort_unit,
            torque_index=torque_index_of(args.axis),
        )
        with on_signals(SIGNALS, tune.leave):
            record = tune.run()
    if record.lost:
        print(
            f"canopen-control: {record.lost} of {record.lost + len(record.samples)} cycles were lost", file=sys.stderr
        )
    say("\n".join(report(record, request, scale, output)))
    if args.json:
        print(json_text(asdict(findings(record, request, scale))))
    if args.apply:
        gains = proposed(identified(record), request)
        with open_session(args) as session:
            say("\n".join(_hinted(applied(session, gains, scale.counts / math.tau, _place(args)), args)))
        target = f"--can {args.can} --eds {args.eds}" if args.can else f"--name {args.name}" if args.name else ""
        say(f"taken back by: canopen-control tune {args.node} {target} --revert".replace("  ", " "))
    return 0


def _check_gains(args: argparse.Namespace) -> None:
    """Refuse options that do not belong together; ConfigError."""
    if args.apply and args.identify is None:
        raise ConfigError("--apply sets the gains that --identify proposes; the other tests propose none")
    if args.store and not (args.apply or args.revert):
        raise ConfigError("--store: nothing is set without --apply or --revert")
    if args.gain and not args.apply:
        raise ConfigError("--gain says which objects --apply sets; leave it away, or say --apply")
    if args.json and args.revert:
        raise ConfigError("--json prints what a test has found; --revert is none")
    for gain in args.gain:
        parse_gain(gain)


def _place(args: argparse.Namespace) -> GainPlace:
    return GainPlace(args.axis, tuple(args.gain), args.can or "", args.store)


def _hinted(lines: Iterator[str], args: argparse.Namespace) -> Iterator[str]:
    """Yield lines; the last one names the option that stores."""
    *first, last = lines
    yield from first
    yield last if args.store else f"{last} (--store)"


def _find_gains(args: argparse.Namespace) -> None:
    """Find the gain objects of the drive before it moves; ConfigError if they are unknown."""
    with open_session(args) as session:
        if session.robot and args.counts is None:
            raise ConfigError(
                f"{session}: --apply through a running robot needs --counts N, the user units of 0x6064 of one turn of "
                "its joint, since gains are in these"
            )
        settable_gains(session, args.axis, args.gain, 1.0)


def _request(args: argparse.Namespace) -> TuneRequest:
    """Parse the request; ConfigError."""
    speed = parse_quantity(args.step, "velocity") if args.step is not None else None
    if speed is not None and not speed.value:
        raise ConfigError(f"--step {speed}: that moves nothing")
    test = TuneTest.STEP if speed is not None else TuneTest.BODE if args.bode else TuneTest.IDENTIFY
    return TuneRequest(
        test=test,
        speed=speed,
        torque=args.identify or 0.0,
        signal=args.bode or "prbs",
        seconds=args.seconds or test.seconds,
        period=args.period / 1e3,
        crossover=args.crossover * math.tau,
        margin=math.radians(args.phase_margin),
        loop_delay=args.loop_delay / 1e3,
    )


def _output(name: str) -> Path:
    path = Path(name).expanduser()
    if path.suffix not in (CSV, PICTURE) or not path.parent.is_dir():
        kinds = f"NAME{CSV} for a table or NAME{PICTURE} for a picture"
        raise ConfigError(f"-o {name}: give {kinds}, in a folder that is there")
    if path.suffix == PICTURE:
        refuse_without_pictures()
    return path


def _limits(args: argparse.Namespace, request: TuneRequest, scale: JogScale) -> JogLimits:
    """Return the limits; ConfigError if the excitation exceeds them."""
    speed = None if args.max_speed is None else parse_quantity(args.max_speed, "velocity")
    travel = None if args.max_travel is None else parse_quantity(args.max_travel, "position")
    limits = JogLimits(
        _MAX_SPEED if speed is None else abs(scale.si(speed)),
        _MAX_TRAVEL if travel is None else abs(scale.si(travel)),
        args.max_current,
    )
    request.check(limits, scale)
    return limits


@contextlib.contextmanager
def _own(
    args: argparse.Namespace, request: TuneRequest, say: Callable[[str], None]
) -> Iterator[tuple[JogDrive, JogScale, JogLimits]]:
    """Identify the drive on its bare bus, confirm the limits, then run a robot with this drive alone."""
    if args.eds is None:
        raise ConfigError(f"node {args.node}: give the EDS of the drive: --eds FILE (bundled: generic_cia402.eds, ...)")
    parse_node_id(args.node)
    device = look_at_drive(args)
    period_us = round(args.period * 1e3)
    robot = choose_tuned(device, request.kind, period_us, allow_unsupervised=args.allow_unsupervised)
    axis = axis_of(robot, args)
    scale = JogScale(args.counts or axis.counts, told=args.counts is not None or axis.told)
    limits = _limits(args, request, scale)
    node = robot.nodes[0]
    lines = [f"node {node.device.node_id}: {axis.interface} in {axis.mode.name}, a sample every {args.period:g} ms"]
    _confirm([*lines, *_plan(request, scale, limits), f"dead-man: {dead_man_words(node.supervision)}"], args, say)
    robot = with_counts(robot, args.counts)
    with own_robot(robot, axis_of(robot, args), args.can, limits.speed, WarningPrinter()) as drive:
        yield drive, scale, limits


def _plan(request: TuneRequest, scale: JogScale, limits: JogLimits) -> Iterator[str]:
    """Yield the lines to confirm."""
    yield f"excitation: {request.words(scale)}"
    yield f"limits: {scale.velocity_words(limits.speed)}, {scale.position_words(limits.travel)} each way,"
    yield f"        current {limits.current / 10:g} % of the rated one, more for {PEAK_S:g} s at most"


def _confirm(lines: list[str], args: argparse.Namespace, say: Callable[[str], None]) -> None:
    """Print the planned motion and its limits, and ask for confirmation; ConfigError without it."""
    say("\n".join(lines))
    if args.yes:
        return
    if not sys.stdin.isatty():
        raise ConfigError("nothing moves unless the limits are confirmed: say --yes, or ask at a terminal")
    question = "the shaft is free, and it may move so? [y/N] "
    if args.json:
        say(question)
    try:
        answer = input("" if args.json else question)
    except (EOFError, KeyboardInterrupt):
        answer = ""
    if answer.strip().lower() not in ("y", "yes"):
        raise ConfigError("not confirmed; nothing moved")
